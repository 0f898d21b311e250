"""Several material constants multiplied by factors at once: as one after another, with exact slopes."""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.constant_factor import ConstantFactor, multiplied
from femu_piezo.effects.effect import Effect, EffectParameter
from femu_piezo.inference.coefficients import active_effects, d_form_constants
from femu_piezo.material.constants import D_FORM


def test_several_at_once_are_as_one_after_another():
    """Three of the ten constants at two frequencies: values, tangents in the unknowns, and slopes in the factors."""
    rng = np.random.default_rng(1)
    theta = rng.standard_normal((2, 10, 2)) @ [1, 1j]
    tangents = rng.standard_normal((2, 10, 4, 2)) @ [1, 1j]
    which, p = np.array([1, 4, 8]), rng.uniform(-0.2, 0.2, (3, 2))
    values, moved, slopes = multiplied(theta, tangents, which, p)
    for number, index in enumerate(which):
        theta, tangents, slope = ConstantFactor(index)(theta, tangents, np.ones(2), p[number])
        np.testing.assert_array_equal(slope[:, index], slopes[:, number])
        assert np.count_nonzero(np.any(slope != 0, axis=(0, 2))) == 1
    np.testing.assert_array_equal(theta, values)
    np.testing.assert_array_equal(tangents, moved)


def test_slopes_are_those_of_differences():
    """Slopes in the relative error p of the value and in the change t of the tangent."""
    theta, none = np.arange(1, 11)[None] * (1 - 0.02j), np.zeros((1, 10, 0), dtype=complex)
    factor, p, step = ConstantFactor(3), np.array([0.1, 0.03]), 1e-6
    slopes = factor(theta, none, np.ones(1), p)[2]
    for number, move in enumerate(step * np.eye(2)):
        ahead, behind = (factor(theta, none, np.ones(1), p + sign * move)[0] for sign in (1, -1))
        np.testing.assert_allclose(slopes[:, :, number], (ahead - behind) / (2 * step), atol=1e-8)


def test_two_errors_of_one_constant_both_act(lab):
    """s12 → s12 (1 + p)(1 + q): a further effect on a constant that has a tolerance, with slopes by differences."""
    parameters = tuple(EffectParameter(name, "1", -0.5, 0.5, 0.1, 0.1) for name in ("further", "tan_further"))
    own = Effect("own", "own", parameters, constants=ConstantFactor(D_FORM.index("s12")))
    unknowns, omega = lab.unknowns.with_candidate(own), np.ones(1)
    x = unknowns.prior_mean.copy()
    columns = [unknowns.columns(unknowns.index(key)).start for key in ("own", "wrong_insensitive_parameter:s12")]
    x[columns] = 0.1 / own.scale[0], 0.2 / lab.library["wrong_insensitive_parameter:s12"].scale[0]

    def s12(y: np.ndarray) -> tuple[complex, np.ndarray]:
        values, tangents = d_form_constants(unknowns, y, active_effects(unknowns, y), omega)
        return values[0, D_FORM.index("s12")], tangents[0, D_FORM.index("s12")]

    value, slopes = s12(x)
    assert np.isclose(value, 1.1 * 1.2 * s12(unknowns.prior_mean)[0], rtol=1e-12)
    for column in columns:
        step = 1e-6 * np.eye(x.size)[column]
        difference = (s12(x + step)[0] - s12(x - step)[0]) / 2e-6
        assert np.isclose(slopes[column], difference, rtol=1e-7)
