"""The [effects] table of a specimen: effects that simulation and update take as known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext
from femu_piezo.effects.extended_model import ExtendedModel, extend_model
from femu_piezo.effects.library import from_table
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.shapes import EIGHTH, Plate
from femu_piezo.inference.blocks import SweepBlock
from femu_piezo.inference.joint import JointParameters
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.unknowns import FreeConstants, MaterialParameters
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.study.measured import Measured
from femu_piezo.study.problem import Problem

#: Dimensions by name as axes; all radii of a disk or a ring go with its diameter.
_ROUND = {"diameter": (0, 1), "thickness": (2,)}
_AXES = {
    "plate": {"length": (0,), "width": (1,), "thickness": (2,)},
    "square": {"length": (0, 1), "thickness": (2,)},
    "disk": _ROUND,
    "ring": _ROUND,
}
#: Relative range of the free constants that the basis of an update with effects serves.
_SPREAD = 0.05


def effect_context(problem: Problem, fundamental_Hz: float, impedance: float) -> EffectContext:
    """What the library of effects must know of a specimen.

    Parameters
    ----------
    impedance : typical |Z|, ohm, which bounds the parameters of circuits
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
    )


def known_effects(problem: Problem, fundamental_Hz: float, impedance: float) -> tuple[tuple[Effect, np.ndarray], ...]:
    """The effects of the specimen file with their values; InputError with file and key where one cannot serve."""
    where = str(problem.specimen.path or problem.specimen.name)
    return from_table(problem.specimen.effects or {}, effect_context(problem, fundamental_Hz, impedance), where)


def has_effects(measured: Sequence[Measured]) -> bool:
    """Whether any of the specimens has an [effects] table."""
    return any(one.problem.specimen.effects for one in measured)


@dataclass(frozen=True)
class EffectCurve(SweepBlock):
    """A sweep explained by an extended model with known effects."""

    name: str
    model: ExtendedModel
    effects: tuple[tuple[Effect, np.ndarray], ...]
    spectrum: ImpedanceSpectrum
    relative_noise: np.ndarray

    def impedance(self, parameters: MaterialParameters, x: np.ndarray, omega: np.ndarray) -> np.ndarray:
        return Evaluation(self.model, omega).impedance(JointParameters(parameters, (), self.effects), x)

    def log_slopes(self, parameters: MaterialParameters, x: np.ndarray) -> np.ndarray:
        joint = JointParameters(parameters, (), self.effects)
        z, tangents = Evaluation(self.model, self.spectrum.omega).with_jacobian(joint, x)
        return tangents / z[:, None]


def effect_curve(one: Measured, model: ElectroelasticModel, free: FreeConstants) -> EffectCurve:
    """The block of a measured specimen with known effects, its basis made around given constants."""
    typical = float(np.median(np.abs(one.spectrum.impedance)))
    effects = known_effects(one.problem, one.pair.pole.frequency_Hz, typical)
    training = [free.constants(free.start), *free.training_sets(free.start, _SPREAD, 4)[1:]]
    extended = extend_model(model, training, [effect for effect, _ in effects], one.band_Hz)
    return EffectCurve(one.problem.specimen.name, extended, effects, one.fitted, one.relative_noise)


def simulated_with_effects(problem: Problem, model: ElectroelasticModel, frequency: np.ndarray) -> np.ndarray:
    """Z (k,) of a specimen with the effects of its file, ohm."""
    capacitance = abs(problem.constants.eps33T) * problem.plate.electrode_area / problem.plate.electrode_gap
    typical = 1 / (2 * np.pi * problem.expected_pole_Hz * capacitance)
    effects = known_effects(problem, problem.expected_pole_Hz, typical)
    free = problem.free(problem.constants)
    extended = extend_model(model, [problem.constants], [effect for effect, _ in effects], float(frequency[-1]))
    material = MaterialParameters.around(free, free.start)
    evaluation = Evaluation(extended, 2 * np.pi * frequency)
    return evaluation.impedance(JointParameters(material, (), effects), material.x_of(free.start))
