"""Effects along a k33 bar against the independent spectral solver: the change of log Z over a sweep.

A coupling that varies along the poling makes fields along it, which move next to nothing.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hidden_effects.body import Surface
from hidden_effects.build import Build

from diagnosis.conftest import AXES, DENSITY, ReducedBody
from femu_piezo.effects.effect import EffectContext
from femu_piezo.effects.extended_model import extend_model
from femu_piezo.effects.library import library
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.shapes import Plate
from femu_piezo.inference.response import Evaluation

SIZE, HALF = (8e-3, 2e-3, 1.6e-3), 4e-3
FUNDAMENTAL, FREQUENCY = 170e3, np.linspace(30e3, 400e3, 81)


class Bar(ReducedBody):
    """The extended reduced model of the bar, with a basis as a study makes it."""

    def __init__(self, spread: float, accuracy: float) -> None:
        super().__init__("s33", "d33", "eps33T")
        plate, band = Plate(*SIZE, poling="length"), (float(FREQUENCY[0]), float(FREQUENCY[-1]))
        context = EffectContext(
            FUNDAMENTAL,
            self.free.names,
            self.constants,
            AXES,
            DENSITY,
            SIZE[0],
            2e3,
            SIZE,
            poling="length",
            poling_axis=0,
            field_axis=0,
            band_Hz=band,
        )
        self.library = {effect.key: effect for effect in library(context)}
        model = ElectroelasticModel(plate.domain_for(1e-5, band[1], 1900.0), DENSITY)
        training = self.free.training_for_effects(self.constants, spread)
        self.model = extend_model(model, training, list(self.library.values()), band[1], accuracy=accuracy)
        self.evaluation = Evaluation(self.model, 2 * np.pi * FREQUENCY)


def varied(name: str, odd: float, even: float = 0.0):
    """A property of the body that varies along it with odd and even part."""

    def change(built: Build) -> None:
        getattr(built, name).append(lambda x: 1 + odd * x / HALF + even * ((x / HALF) ** 2 - 1 / 3))

    return change


def tapered(built: Build) -> None:
    built.taper = 0.03


def wedge(built: Build) -> None:
    built.wedge = 0.05


def mass(built: Build) -> None:
    own, side = 1e-6, 0.6e-3
    place = ((2.5e-3 - side / 2, 2.5e-3 + side / 2), (0.3e-3 - side / 2, 0.3e-3 + side / 2))
    built.surfaces.append(Surface(*place, (1,), lambda w: -(w**2) * own / side**2))


def support(built: Build) -> None:
    area = 2 * 0.8e-3 * SIZE[1]
    built.surfaces.append(Surface((-0.4e-3, 0.4e-3), built.whole_face[1], (1, -1), lambda w: (1e6 + 4j * w) / area))


#: Case → parameters of the effect, function that builds it, and the error allowed as a share of the change, rms.
CASES = {
    "poling_gradient": ((0.25, 0.04), varied("piezoelectric", 0.25, 0.04), 3e-4),
    "poling_gradient, curved": ((0.0, 0.3), varied("piezoelectric", 0.0, 0.3), 3e-4),
    "poling_gradient, steep": ((0.6, 0.0), varied("piezoelectric", 0.6), 5e-3),
    "uneven_body, density": ((0.1,), varied("heaviness", 0.1), 3e-4),
    "tapered_width": ((0.03,), tapered, 5e-3),
    "wedge": ((0.05,), wedge, 1e-3),
    "point_mass": ((1e-6, 2.5e-3, 0.3e-3, 0.6e-3 / np.sqrt(np.pi)), mass, 0.01),
    "mounting": ((1e6, 4.0, 0.8e-3), support, 0.02),
}


def build(bar: Bar) -> Build:
    """The bar without effects."""
    return Build(np.array(SIZE), DENSITY, bar.theta, FUNDAMENTAL, poling=0)


@pytest.fixture(scope="module")
def bare() -> SimpleNamespace:
    """The bar, and its Z by the independent solver."""
    bar = Bar(0.05, 1e-5)
    return SimpleNamespace(bar=bar, exact=build(bar).impedance(FREQUENCY))


def change_and_error(bar: Bar, exact: np.ndarray, case: str) -> tuple[float, float]:
    """rms of the change of log Z by the independent solver, and of the law's error in it."""
    values, change, _ = CASES[case]
    built = build(bar)
    change(built)
    found = np.log(built.impedance(FREQUENCY) / exact)
    error = np.log(bar.impedance(case.partition(",")[0], values) / bar.impedance()) - found
    return tuple(float(np.sqrt(np.mean(np.abs(part) ** 2))) for part in (found, error))


@pytest.mark.parametrize("case", CASES)
def test_change_of_impedance_against_independent_solution(bare, case):
    size, error = change_and_error(bare.bar, bare.exact, case)
    assert size > 1e-3
    assert error < CASES[case][2] * size, f"{error / size:.1e}"


def test_a_finer_basis_does_not_lose_the_field_along_the_poling(bare):
    """With potentials tied to displacements it missed 1.4e-3 of the change, and one of 355 unknowns half of it."""
    size, error = change_and_error(Bar(0.25, 1e-7), bare.exact, "poling_gradient")
    assert error < 3e-4 * size, f"{error / size:.1e}"
