"""Several material constants multiplied by factors at once: as one after another, with exact slopes."""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.constant_factor import ConstantFactor, multiplied


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
