"""An error of the inner diameter of a ring or of the second width of a trapezoid: the law against meshes with that
dimension.
"""

from __future__ import annotations

import numpy as np
import pytest

from diagnosis.conftest import DENSITY, ReducedBody
from femu_piezo.effects.effect import Effect, EffectContext
from femu_piezo.effects.extended_model import extend_model
from femu_piezo.effects.library import library
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry import catalogue
from femu_piezo.geometry.reshaping import reshapings
from femu_piezo.geometry.slab import Slab
from femu_piezo.inference.response import Evaluation

FREQUENCY = np.linspace(20e3, 200e3, 181)
#: Dimension → function that gives the body with this dimension 1 + p times as large, and axes of the other dimensions.
BODIES = {
    "inner_diameter": (lambda p: catalogue.ring(20e-3, 8e-3 * (1 + p), 1.2e-3), {"diameter": (0, 1)}),
    "width_end": (
        lambda p: catalogue.trapezoid(15e-3, 6e-3, 3e-3 * (1 + p), 1e-3),
        {"length": (0,), "width": (1,), "thickness": (2,)},
    ),
}


class Body(ReducedBody):
    """A body as a reduced model, with the effect of an error of `dimension`."""

    def __init__(self, dimension: str, p: float) -> None:
        make, axes = BODIES[dimension]
        self.shape: Slab = make(p)
        super().__init__("s11", "s12", "d31", "eps33T")
        constants = self.constants
        context = EffectContext(
            100e3, self.free.names, constants, axes, DENSITY, self.shape.thickness, reshapings=reshapings(self.shape)
        )
        self.library = {effect.key: effect for effect in library(context)}
        self.effect: Effect = self.library[f"wrong_{dimension}"]
        self.full = ElectroelasticModel(self.shape.domain_for(1e-6, FREQUENCY[-1], 1900.0), DENSITY)
        stretched = [effect for effect in self.library.values() if effect.stretch is not None]
        self.model = extend_model(self.full, [constants], [*stretched, self.effect], FREQUENCY[-1], accuracy=1e-6)
        self.evaluation = Evaluation(self.model, 2 * np.pi * FREQUENCY)

    def impedance(self, p: float | None = None) -> np.ndarray:
        """Z (k,) as drawn, or with the dimension 1 + p times as large by the effect."""
        if p is None:
            return self.evaluation.impedance(self.unknowns, self.x)
        return self.with_slopes(p)[0]

    def with_slopes(self, p: float) -> tuple[np.ndarray, np.ndarray]:
        """Z (k,) and its slopes (k, n_x) with the dimension 1 + p times as large by the effect."""
        unknowns = self.unknowns.with_candidate(self.effect)
        return self.evaluation.with_jacobian(unknowns, np.append(self.x, p / self.effect.scale))


@pytest.fixture(scope="module", params=BODIES)
def body(request) -> tuple[str, Body]:
    return request.param, Body(request.param, 0.0)


@pytest.mark.parametrize(("p", "share"), [(0.003, 0.005), (-0.02, 0.02), (0.05, 0.05)])
def test_a_reshaped_body_is_that_of_the_other_dimension(body, p, share):
    """Against a mesh and a basis of the reshaped body; the error as a share of the change (rms).

    It grows with p, since the basis is that of the body as drawn.
    """
    name, drawn = body
    exact = np.log(Body(name, p).impedance() / drawn.impedance())
    by_effect = np.log(drawn.impedance(p) / drawn.impedance())
    error, size = (np.sqrt(np.mean(np.abs(part) ** 2)) for part in (by_effect - exact, exact))
    print(f"{name} {p:+.3f}: changes {size:.3g}, error {error / size:.2g} of it")
    assert error < share * size


def test_slopes_are_those_of_differences(body):
    _, drawn = body
    step = 1e-5
    ahead, behind = (drawn.impedance(0.01 + way * step) for way in (1, -1))
    difference = (ahead - behind) / (2 * step) * drawn.effect.scale[0]
    slopes = drawn.with_slopes(0.01)[1][:, -1]
    assert np.max(np.abs(slopes - difference)) < 1e-6 * np.max(np.abs(difference))


def test_displacement_maps_against_their_formulas(body):
    """Gradients against differences of the map g that the module documents, determinants against the volume."""
    name, drawn = body
    one = reshapings(drawn.shape)[name]

    def g(x: np.ndarray) -> np.ndarray:
        if name == "inner_diameter":
            r = np.hypot(x[0], x[1])
            return one.inner * (one.outer - r) / (one.outer - one.inner) * np.stack([x[0] / r, x[1] / r, 0 * r])
        s = x[0] / one.length + 0.5
        width = (1 - s) * one.width + s * one.width_end
        return np.stack([0 * s, x[1] * s * one.width_end / width, 0 * s])

    x = np.array([[5e-3, 2e-3, 0.1e-3], [6e-3, -0.7e-3, 0.2e-3]]).T
    steps = 1e-7 * np.eye(3)
    differences = np.stack([(g(x + h[:, None]) - g(x - h[:, None])) / 2e-7 for h in steps], axis=1)
    np.testing.assert_allclose(one.gradient(x), differences, atol=1e-7)
    basis, p = drawn.full.basis, 0.03
    places = np.asarray(basis.global_coordinates())
    mapped = np.eye(3)[:, :, None, None] + p * one.gradient(places)
    volume = np.sum(basis.dx * np.linalg.det(np.moveaxis(mapped, (0, 1), (-2, -1)))) / np.sum(basis.dx)
    factor, slope = one.volume(p)
    assert volume == pytest.approx(factor, rel=1e-7)
    assert slope == pytest.approx((one.volume(p + 1e-6)[0] - one.volume(p - 1e-6)[0]) / 2e-6, rel=1e-6)
    larger = BODIES[name][0](p)
    assert larger.volume / drawn.shape.volume == pytest.approx(factor, rel=1e-12, abs=0)
