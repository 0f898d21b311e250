"""What the library of effects knows of a specimen, and the specimen with the effects of its file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext
from femu_piezo.effects.extended_model import extend_model
from femu_piezo.effects.library import Maker, from_table, with_library
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.shapes import EIGHTH, Plate
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.unknowns import MaterialParameters, Unknowns, material_prior
from femu_piezo.study.measured import Measured
from femu_piezo.study.problem import Problem
from femu_piezo.study.tolerances import tolerances

#: Dimensions by name as axes; all radii of a disk or a ring go with its diameter.
_ROUND = {"diameter": (0, 1), "thickness": (2,)}
_AXES = {
    "plate": {"length": (0,), "width": (1,), "thickness": (2,)},
    "square": {"length": (0, 1), "thickness": (2,)},
    "disk": _ROUND,
    "ring": _ROUND,
}


def effect_context(
    problem: Problem, fundamental_Hz: float, impedance: float, band_Hz: tuple[float, float]
) -> EffectContext:
    """What the library of effects must know of a specimen.

    Parameters
    ----------
    impedance : typical |Z|, ohm, which bounds the parameters of circuits
    band_Hz : lowest and highest frequency of the sweep
    """
    plate = problem.plate
    whole = isinstance(plate, Plate) and plate.mirrors == EIGHTH
    return EffectContext(
        fundamental_Hz=fundamental_Hz,
        free=tuple(problem.specimen.material.free),
        constants=problem.constants,
        axes=_AXES.get(problem.specimen.geometry.shape, {}),
        density=problem.density,
        thickness=problem.plate.electrode_gap,
        impedance=impedance,
        dimensions=tuple(plate.dimensions.tolist()) if whole else None,
        poling=plate.poling,
        tolerances=tolerances(problem),
        band_Hz=band_Hz,
        weighed=problem.specimen.geometry.mass is not None,
    )


def known_effects(
    problem: Problem, context: EffectContext, effects: Iterable[Maker] | None = None, *, fitted: bool = False
) -> tuple[tuple[Effect, np.ndarray], ...]:
    """The effects of the specimen file with their values; InputError with file and key where one cannot serve.

    effects : that its names may be of beside the library;  fitted : also where a fit left what has a tolerance
    """
    where, specimen = str(problem.specimen.path or problem.specimen.name), problem.specimen
    tables = [specimen.effects or {}, (specimen.fitted or {}) if fitted else {}]
    offered = with_library(effects)
    return tuple(item for table in tables for item in from_table(table, context, where, offered))


def has_effects(measured: Sequence[Measured]) -> bool:
    """Whether any of the specimens has an [effects] table."""
    return any(one.problem.specimen.effects for one in measured)


def simulated_with_effects(
    problem: Problem, model: ElectroelasticModel, frequency: np.ndarray, effects: Iterable[Maker] | None = None
) -> np.ndarray:
    """Z (k,) of a specimen with the effects of its file, ohm; `effects` as of `known_effects`."""
    capacitance = abs(problem.constants.eps33T) * problem.plate.electrode_area / problem.plate.electrode_gap
    typical = 1 / (2 * np.pi * problem.expected_pole_Hz * capacitance)
    band = (float(frequency[0]), float(frequency[-1]))
    context = effect_context(problem, problem.expected_pole_Hz, typical, band)
    known = known_effects(problem, context, effects, fitted=True)
    free = problem.free(problem.constants)
    extended = extend_model(model, [problem.constants], [effect for effect, _ in known], float(frequency[-1]))
    material = MaterialParameters.around(free, free.start)
    unknowns = Unknowns(material, material_prior(free, {}, {}), fixed=known)
    return Evaluation(extended, 2 * np.pi * frequency).impedance(unknowns, material.x_of(free.start))
