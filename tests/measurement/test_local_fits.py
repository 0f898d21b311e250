"""Local rational fits: the direction that a window determines least."""

import numpy as np
import pytest

from femu_piezo.measurement.local_fits import _least_moved


@pytest.mark.parametrize("smallest", [1.0, 1e-3, 1e-9, 1e-15, 0.0])
def test_the_direction_moved_least_is_that_of_the_singular_value_decomposition(smallest):
    """|R x| is hardly above the least singular value, however small, and where others are nearly as small."""
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
    found = _least_moved(np.zeros((2, 3, 3), dtype=complex))
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0)
