"""A plate as measured in a laboratory, with every quantity known only within its tolerance: a small and quick model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from femu_piezo.effects.effect import EffectContext
from femu_piezo.effects.extended_model import extend_model
from femu_piezo.effects.library import library
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.shapes import Plate
from femu_piezo.inference.free_constants import FreeConstants
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.unknowns import MaterialParameters, Unknowns, material_prior
from femu_piezo.material.constants import D_FORM
from femu_piezo.measurement.sweeps import SweepData
from tests.materials import LOSSY as CONSTANTS
from tests.noise import noisy

SIZE, DENSITY, FUNDAMENTAL = (12e-3, 3e-3, 1e-3), 7500.0, 118e3
AXES = {"length": (0,), "width": (1,), "thickness": (2,)}
FREE = ("s11", "d31", "eps33T")
#: 12 points far below the fundamental of 118 kHz, for the permittivity, and 48 points around it, Hz.
FREQUENCY = np.concatenate([np.geomspace(2e3, 90e3, 12), np.linspace(100e3, 140e3, 48)])
NOISE = 5e-4
#: Standard deviations of calliper, balance, held constants and their tangents, residue of the fixture, and instrument.
TOLERANCES = {
    "length": 0.02e-3 / SIZE[0],
    "width": 0.02e-3 / SIZE[1],
    "thickness": 0.005e-3 / SIZE[2],
    "density": 0.003,
    "resistance": 0.02,
    "inductance": 10e-9,
    "capacitance": 0.1e-12,
    "accuracy": 8e-4,
    "phase_accuracy": 8e-4,
} | {key: std for name in D_FORM if name not in FREE for key, std in ((name, 0.03), (f"tan_{name}", 0.003))}


class Response:
    """A response that stands for a model at any factor of the frequency; its kinds give `with_jacobian`."""

    def at(self, factor):
        return self

    def impedance(self, parameters, x):
        return self.with_jacobian(parameters, x)[0]


class Laboratory:
    """The reduced model and two sets of unknowns.

    `unknowns` are the free constants with a weak prior and all quantities with a tolerance; `ideal` are the free
    constants alone, everything else as exactly known.
    """

    def __init__(self) -> None:
        self.free = FreeConstants.of(CONSTANTS, FREE)
        self.material = MaterialParameters.around(self.free, self.free.start)
        context = EffectContext(
            FUNDAMENTAL,
            FREE,
            CONSTANTS,
            AXES,
            DENSITY,
            SIZE[2],
            2e3,
            tolerances=TOLERANCES,
            band_Hz=(FREQUENCY[0], FREQUENCY[-1]),
        )
        self.library = {effect.key: effect for effect in library(context)}
        self.tolerances = tuple(effect for effect in self.library.values() if effect.has_tolerance)
        self.unknowns = Unknowns(self.material, material_prior(self.free, {}, {}), self.tolerances)
        lossless = CONSTANTS.lossless()
        training = [CONSTANTS, *self.free.training_sets(self.free.start, 0.05, 3)[1:]]
        training += [
            lossless.with_values(**{name: getattr(lossless, name) * (1 + step)})
            for name, step in (("s12", 0.08), ("s13", 0.08), ("s33", 0.1), ("d33", -0.1))
        ]
        model = ElectroelasticModel(Plate(*SIZE).domain((8, 3, 1)), DENSITY)
        self.model = extend_model(model, training, list(self.library.values()), FREQUENCY[-1], accuracy=1e-6)
        self.evaluation = Evaluation(self.model, 2 * np.pi * FREQUENCY)
        self.ideal = Unknowns(self.material, self.unknowns.prior)

    def truth(self, seed: int) -> np.ndarray:
        """(n_x,) unknowns of a drawn specimen.

        Free constants scatter by 3 % about those of the file, their tangents lie within 15 %, and all else is off by
        its tolerance.
        """
        rng = np.random.default_rng([1905, seed])
        x = self.unknowns.prior_mean + self.unknowns.prior_std * rng.standard_normal(self.unknowns.count)
        constants = self.material.x_of(self.free.start)
        constants[0::2] *= 1 + 0.03 * rng.standard_normal(len(FREE))
        constants[1::2] *= rng.uniform(0.85, 1.15, len(FREE))
        x[: constants.size] = constants
        return x

    def near(self, truth: np.ndarray) -> np.ndarray:
        """A start for a fit: the true constants and tangents, as a first rough fit finds them, all else at its prior
        mean.
        """
        x = self.unknowns.prior_mean.copy()
        x[: self.unknowns.of_material] = truth[: self.unknowns.of_material]
        return x

    def measured(self, impedance: np.ndarray, seed: int, noise: float = NOISE, known: bool = True) -> SweepData:
        """The sweep of a specimen with circular complex noise of relative size `noise` (rms of |δZ/Z|)."""
        return SweepData(FREQUENCY, noisy(impedance, noise, [1906, seed]), np.full(impedance.size, noise), known)


def shifted(unknowns: Unknowns, column: int, by: float) -> Unknowns:
    """The unknowns with the prior mean of one of them moved by `by` of its standard deviations."""
    if column < unknowns.of_material:
        name = unknowns.names[column]
        mean, std = unknowns.prior[name]
        return replace(unknowns, prior={**unknowns.prior, name: (mean + by * abs(std), std)})
    effects = list(unknowns.effects)
    for number, effect in enumerate(effects):
        places = unknowns.columns(number)
        if places.start <= column < places.stop:
            parameters = list(effect.parameters)
            parameter = parameters[column - places.start]
            step = by * unknowns.prior_std[column] * parameter.scale
            parameters[column - places.start] = replace(parameter, rest=parameter.rest + step)
            effects[number] = replace(effect, parameters=tuple(parameters))
    return replace(unknowns, effects=tuple(effects))
