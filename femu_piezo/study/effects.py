"""What the library of effects knows of a specimen, and the specimen with the effects of its file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, SweepConditions
from femu_piezo.effects.extended_model import ExtendedModel, extend_model
from femu_piezo.effects.library import Maker, from_table, with_library
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.reshaping import reshapings
from femu_piezo.geometry.shapes import EIGHTH, Plate
from femu_piezo.geometry.slab import Slab
from femu_piezo.inference.coefficients import active_effects, d_form_constants
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.study.measured import Measured, conditions_of
from femu_piezo.study.problem import Problem
from femu_piezo.study.shapes import shape_of
from femu_piezo.study.starts import is_hardly_stable
from femu_piezo.study.tolerances import tolerances

#: Name of a dimension → axes that it scales: the diameter of a disk or ring scales its whole plane, the width of a
#: trapezoid both its ends.
_ROUND = {"diameter": (0, 1), "thickness": (2,)}
_LONG = {"length": (0,), "width": (1,), "thickness": (2,)}
_AXES = {
    "plate": _LONG,
    "trapezoid": _LONG,
    "square": {"length": (0, 1), "thickness": (2,)},
    "disk": _ROUND,
    "ring": _ROUND,
}


#: Most points of a sweep that tell its pace; a longer one is read at so many equally spaced times.
_PACE = 4097


def effect_context(
    problem: Problem,
    fundamental_Hz: float,
    impedance: float,
    band_Hz: tuple[float, float],
    frequency: np.ndarray | None = None,
    conditions: SweepConditions | None = None,
) -> EffectContext:
    """What the library of effects must know of a specimen.

    Parameters
    ----------
    impedance : typical |Z|, ohm, which bounds the parameters of circuits
    band_Hz : lowest and highest frequency of the sweep, or of all sweeps that are fitted together
    frequency : (k,) its points, Hz, all of which took equally long; evenly spaced over the band where None
    conditions : how the sweep was taken; as the only one, upwards, where None
    """
    points = np.array(band_Hz) if frequency is None else frequency
    if points.size > _PACE:
        points = np.interp(np.linspace(0, 1, _PACE), np.linspace(0, 1, points.size), points)
    plate = problem.plate
    whole = isinstance(plate, Plate) and plate.mirrors == EIGHTH
    return EffectContext(
        fundamental_Hz=fundamental_Hz,
        free=tuple(problem.specimen.material.free),
        constants=problem.constants,
        axes=_AXES.get(problem.specimen.geometry.shape, {}),
        reshapings=reshapings(plate),
        density=problem.density,
        thickness=problem.plate.electrode_gap,
        impedance=impedance,
        dimensions=tuple(plate.dimensions.tolist()) if whole else None,
        radii=plate.revolved if isinstance(plate, Slab) else None,
        upper=plate.upper_face,
        poling=plate.poling,
        poling_axis=int(np.argmax(np.abs(plate.poling_direction))),
        field_axis=int(np.argmax(np.abs(plate.field_direction))),
        tolerances=tolerances(problem),
        band_Hz=band_Hz,
        density_from_mass=problem.specimen.geometry.mass is not None,
        pace_Hz=tuple(points.tolist()),
        conditions=conditions or SweepConditions(),
    )


def expected_context(
    problem: Problem, frequency: np.ndarray, conditions: SweepConditions | None = None
) -> EffectContext:
    """The context of a specimen before it is measured: pole and |Z| as its constants let expect.

    Parameters
    ----------
    frequency : (k,) points of the sweep, Hz, in ascending order; of even ones the two ends suffice
    conditions : of the sweep; those of its first where None
    """
    capacitance = abs(problem.constants.eps33T) * problem.plate.electrode_area / problem.plate.electrode_gap
    pole = problem.expected_pole_Hz
    impedance = 1 / (2 * np.pi * pole * capacitance)
    band = float(frequency[0]), float(frequency[-1])
    return effect_context(problem, pole, impedance, band, frequency, conditions or conditions_of(problem.specimen)[0])


def known_effects(
    problem: Problem, context: EffectContext, effects: Iterable[Maker] | None = None, *, fitted: bool = False
) -> tuple[tuple[Effect, np.ndarray], ...]:
    """The effects of the specimen file with their values; InputError with file and key where one cannot serve.

    effects : what the file may name in addition to the library;  fitted : whether to include the effects in [fitted]
    """
    where, specimen = str(problem.specimen.path or problem.specimen.name), problem.specimen
    of_fit = {name: table for name, table in (specimen.fitted or {}).items() if name != "material"}
    tables = {"effects": specimen.effects or {}, "fitted": of_fit if fitted else {}}
    offered = with_library(effects)
    return tuple(item for kind, table in tables.items() for item in from_table(table, context, where, offered, kind))


def has_effects(measured: Sequence[Measured]) -> bool:
    """Whether any of the specimens has an [effects] table."""
    return any(one.problem.specimen.effects for one in measured)


def effects_as_simulated(
    problem: Problem, frequency: np.ndarray, effects: Iterable[Maker] | None = None
) -> tuple[tuple[Effect, np.ndarray], ...]:
    """Effects of a simulated sweep of the specimen, with their values: those in [effects] and [fitted].

    Where the specimen has several sweeps, the conditions are those of the first.

    Parameters
    ----------
    frequency : (k,) points of the sweep, Hz, in ascending order; of even ones the two ends suffice
    effects : what the file may name in addition to the library
    """
    if not problem.specimen.effects and not set(problem.specimen.fitted or {}) - {"material"}:
        return ()
    return known_effects(problem, expected_context(problem, frequency), effects, fitted=True)


def model_with_effects(
    problem: Problem,
    model: ElectroelasticModel,
    band_Hz: tuple[float, float],
    known: Sequence[tuple[Effect, np.ndarray]],
    accuracy: float = 1e-5,
) -> ExtendedModel:
    """A model reduced so that it serves the constants `Problem.fitted`, and effects with their values, over a band.

    accuracy : aimed-for relative error of Z by the reduction

    Raises InputError where no stable material has the constants that the effects leave.
    """
    around, changed = problem.fitted, _changed_constants(problem, known, np.array(band_Hz))
    if is_hardly_stable(around, changed[0]):  # with held constants of another material
        around = changed[0]
    training = (*problem.free(around).training_for_effects(around), *changed)
    return extend_model(model, training, [effect for effect, _ in known], band_Hz[1], accuracy=accuracy)


def _changed_constants(
    problem: Problem, known: Sequence[tuple[Effect, np.ndarray]], frequency: np.ndarray
) -> list[PiezoConstants]:
    """The constants that effects leave of `Problem.fitted` at frequencies (k,), Hz; InputError where not stable."""
    unknowns, x = _unknowns_of(problem, known)
    theta = d_form_constants(unknowns, x, active_effects(unknowns, x), 2 * np.pi * frequency, tangents=False)[0]
    where = f"{problem.specimen.path or problem.specimen.name}: the constants that [effects] leave"
    return [PiezoConstants.from_vector(one).check(where, passive=False) for one in theta]


def simulated_with_effects(
    problem: Problem,
    model: ExtendedModel,
    frequency: np.ndarray,
    known: Sequence[tuple[Effect, np.ndarray]],
) -> np.ndarray:
    """Z (k,) of a specimen with effects, ohm, by the constants `Problem.fitted`.

    model : reduced so that it serves them (`model_with_effects`);  known : effects with their values
    """
    return Evaluation(model, 2 * np.pi * frequency).impedance(*_unknowns_of(problem, known))


def _unknowns_of(problem: Problem, known: Sequence[tuple[Effect, np.ndarray]]) -> tuple[Unknowns, np.ndarray]:
    """The free constants as unknowns beside known effects, and x (n_x,) at `Problem.fitted`."""
    return Unknowns.of_constants(problem.free(problem.fitted), tuple(known))


def body_as_simulated(problem: Problem, known: Sequence[tuple[Effect, np.ndarray]]) -> tuple[Problem, tuple[str, ...]]:
    """The body with the constants (at the fundamental), dimensions and density that a fit and effects give it.

    Also the names of the effects that change none of these, such as circuits and terms on the mesh.
    """
    (constants,) = _changed_constants(problem, known, np.array([problem.expected_pole_Hz]))
    stretch, density = np.ones(3), problem.density
    reshaped: dict[str, float] = {}
    for effect, values in sorted(known, key=lambda item: item[0].place):
        if effect.stretch is not None:
            stretch = stretch * effect.stretch(values)[0]
        if effect.reshaping is not None:
            reshaped[effect.name.removeprefix("wrong_")] = 1 + float(values[0])
        if effect.density is not None:
            density = density * effect.density(values)[0]
    geometry = problem.specimen.geometry
    axes = dict(_AXES.get(geometry.shape, {}))
    for name, leader in (("inner_diameter", "diameter"), ("width_end", "width")):
        if getattr(geometry, name) is not None:
            axes[name] = axes[leader]
    sizes = {
        name: getattr(geometry, name) * stretch[along[0]] * reshaped.get(name, 1.0) for name, along in axes.items()
    }
    plate = shape_of(problem.specimen.model_copy(update={"geometry": geometry.model_copy(update=sizes)}))
    body = replace(problem, plate=plate, constants=constants, density=float(density))
    hooks = ("constants", "stretch", "density", "reshaping")
    return body, tuple(effect.name for effect, _ in known if all(getattr(effect, hook) is None for hook in hooks))
