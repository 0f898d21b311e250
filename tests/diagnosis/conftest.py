"""A plate as an extended reduced model with every effect of the library; data of the same plate come from the
independent Ritz and spectral solvers.
"""

from __future__ import annotations

import numpy as np
import pytest
from hidden_effects.body import Surface
from hidden_effects.build import Build

from femu_piezo.effects.effect import EffectContext
from femu_piezo.effects.extended_model import extend_model
from femu_piezo.effects.library import library
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.domain import Domain
from femu_piezo.geometry.shapes import Plate
from femu_piezo.inference.free_constants import FreeConstants
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.unknowns import MaterialParameters, Unknowns, material_prior
from femu_piezo.measurement.sweeps import SweepData
from tests.materials import LOSSY

SIZE, DENSITY = (12e-3, 6.5e-3, 1.5e-3), 7500.0
FUNDAMENTAL = 117e3
AXES = {"length": (0,), "width": (1,), "thickness": (2,)}
#: From far below the fundamental to the third resonance, finer around the pole and zero of the fundamental, Hz.
FREQUENCY = np.concatenate([np.linspace(5e3, 110e3, 12), np.linspace(112e3, 126e3, 15), np.linspace(130e3, 225e3, 30)])
BAND = (float(FREQUENCY[0]), float(FREQUENCY[-1]))


class ReducedBody:
    """A body of lossy PZT-5H: constants, unknowns and x (n_x,) at their true values.

    names : of the free constants. A kind of body sets `library`, key → effect, and `evaluation`, of its reduced model.
    """

    def __init__(self, *names: str) -> None:
        self.constants, self.theta = LOSSY, LOSSY.vector()
        self.free = FreeConstants.of(LOSSY, names)
        self.material = MaterialParameters.around(self.free, self.free.start)
        self.x = self.material.x_of(self.free.start)
        self.unknowns = Unknowns(self.material, material_prior(self.free, {}, {}))

    def with_effects(self, values: dict[str, np.ndarray | float]) -> tuple[Unknowns, np.ndarray]:
        """The unknowns with effects of the library as causes, and x (n_x,) with the given parameters, SI; further
        parameters at rest.
        """
        unknowns, x = self.unknowns, self.x
        for key, parameters in values.items():
            effect = self.library[key]
            unknowns = unknowns.with_candidate(effect)
            given = np.atleast_1d(parameters)
            x = np.concatenate([x, np.append(given, effect.rest[given.size :]) / effect.scale])
        return unknowns, x

    def impedance(self, key: str = "", values=()) -> np.ndarray:
        """Z (k,) of the reduced model, with an effect at the given parameters where there is a key."""
        return self.evaluation.impedance(*self.with_effects({key: values} if key else {}))


class Setup(ReducedBody):
    """The extended reduced model of a plate with its library of effects.

    On a mesh finer than a sweep needs. With a `domain`, on that mesh and with the basis trained for all constants, as a
    study does.
    """

    def __init__(self, domain: Domain | None = None, size: tuple[float, float, float] = SIZE) -> None:
        super().__init__("s11", "d31", "eps33T")
        self.size, constants, free = size, self.constants, self.free
        context = EffectContext(FUNDAMENTAL, free.names, constants, AXES, DENSITY, size[2], 2e3, size, band_Hz=BAND)
        self.library = {effect.key: effect for effect in library(context)}
        model = self.model_of_part = ElectroelasticModel(domain or Plate(*size).domain((16, 9, 2)), DENSITY)
        if domain is None:
            training = [constants, *free.training_sets(free.start, 0.04, 3)[1:]]
            training += [constants.lossless().with_values(s12=1.08 * constants.s12.real)]
        else:
            training = free.training_for_effects(constants)
        self.model = extend_model(model, training, list(self.library.values()), FREQUENCY[-1], accuracy=1e-5)
        self.evaluation = Evaluation(self.model, 2 * np.pi * FREQUENCY)

    def data(self, impedance: np.ndarray, noise: float, known: bool = True) -> SweepData:
        """The sweep `impedance` at all frequencies, with its stated relative noise."""
        return SweepData(FREQUENCY, impedance, np.full(impedance.size, noise), known)


def unequal_films(built: Build) -> None:
    """Films of 0.3 kg/m² more on the upper electrode and less on the lower one."""
    for side in (1, -1):
        built.surfaces.append(Surface(*built.whole_face, (side,), lambda w, side=side: -(w**2) * side * 0.3))


@pytest.fixture(scope="session")
def setup() -> Setup:
    return Setup()
