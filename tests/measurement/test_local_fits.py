"""Distances of points and steps from local fits depend on the data alone, not on rounding or on the unit of Z."""

from __future__ import annotations

import numpy as np
import pytest

from femu_piezo.measurement.local_fits import _least_moved, left_out, stepped
from tests.noise import with_noise

from .sweeps import HARD, SOFT, bar_impedance

WINDOWS = ((14, (2, 1)), (16, (3, 2)), (22, (4, 3)))


def all_distances(frequency: np.ndarray, impedance: np.ndarray, level: float) -> np.ndarray:
    """Distances (2 · 3 windows, n) of every point, and of a step behind it, from fits to their neighbours."""
    sigma, after = np.full(frequency.size, level), np.arange(8, frequency.size - 8)
    rows = []
    for shape in WINDOWS:
        rows.append(left_out(frequency, impedance, sigma, sigma, after, np.ones_like(after), shape)[0])
        rows.append(stepped(frequency, impedance, sigma, after, shape, np.zeros(after.size))[1])
    return np.array(rows)


@pytest.mark.kernels
@pytest.mark.parametrize("material", [SOFT, HARD])
@pytest.mark.parametrize("level", [1e-4, 1e-3])
def test_rounding_and_the_unit_of_impedance_do_not_matter(material: dict, level: float) -> None:
    """The same to 1e-4 (measured: 5e-6) with a relative change of 1e-14, 1e-10 of the lower noise, and with Z in
    kilo-ohm.
    """
    frequency = np.linspace(30e3, 50e3, 101)
    impedance = bar_impedance(frequency, **material)
    impedance = with_noise(impedance, level * np.abs(impedance), 3)
    distances = all_distances(frequency, impedance, level)
    rounded = impedance * (1 + 1e-14 * np.random.default_rng(0).standard_normal(frequency.size))
    for same in (rounded, impedance / 1e3):
        np.testing.assert_allclose(all_distances(frequency, same, level), distances, rtol=1e-4, atol=1e-4)


def test_a_whole_turn_of_the_phase_is_no_step() -> None:
    """A step of 2πj in log Z is taken out, so that neither step nor distance remains."""
    frequency = np.linspace(30e3, 50e3, 101)
    impedance = bar_impedance(frequency, **SOFT)
    impedance = with_noise(impedance, 1e-3 * np.abs(impedance), 3)
    after, sigma = np.array([20, 50, 80]), np.full(101, 1e-3)
    step, distance, _ = stepped(frequency, impedance, sigma, after, WINDOWS[0], np.full(3, 2j * np.pi))
    assert np.all(np.abs(step) < 0.01) and np.all(distance < 4)


@pytest.mark.parametrize("smallest", [1.0, 1e-3, 1e-9, 1e-15, 0.0])
def test_the_direction_moved_least_is_that_of_the_singular_value_decomposition(smallest):
    """|R x| exceeds the least singular value by 1 % at most, also where that is tiny or the next one is only 1.2
    times as large.
    """
    rng = np.random.default_rng(1)
    random = rng.normal(size=(2, 40, 9, 9))
    left, right = np.linalg.qr(random[0] + 1j * random[1])[0], np.linalg.qr(random[1] - 1j * random[0])[0]
    values = np.geomspace(1.0, 1e-3, 9) * np.ones((40, 1))
    values[:, -1] = smallest * values[:, -2]
    values[20:, -2] = values[20:, -1] * 1.2
    triangle = np.linalg.qr((left * values[:, None]) @ right, mode="r")
    found = _least_moved(triangle)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, rtol=1e-12)
    moved = np.linalg.norm(triangle @ found[:, :, None], axis=(1, 2))
    assert np.all(moved <= 1.01 * values[:, -1] + 3e-15)


def test_a_triangle_of_zeros_has_any_direction():
    """For R = 0 some unit vectors are returned."""
    found = _least_moved(np.zeros((2, 3, 3), dtype=complex))
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0)
