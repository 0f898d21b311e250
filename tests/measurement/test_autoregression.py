"""Correlated noise of neighbouring points: learned from its correlations, whitened, and weighted as its likelihood
requires.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.stats import multivariate_normal

from femu_piezo.measurement.autoregression import WHITE, Autoregression, autoregression
from femu_piezo.measurement.sweeps import SweepData

MEMORY = Autoregression((0.66, 0.3))
COUNT = 12


def correlations(memory: Autoregression, count: int) -> np.ndarray:
    """(count, count) matrix of the autoregression, its Yule-Walker equations continued beyond its order."""
    phi, rho = memory.predictor(len(memory.correlations))[0], [1.0, *memory.correlations]
    while len(rho) < count:
        rho.append(float(phi @ np.array(rho[-1 : -1 - phi.size : -1])))
    return toeplitz(rho[:count])


def drawn(seed: int, count: int, neighbours: int) -> np.ndarray:
    """Complex errors of standard deviation 1, each the scaled mean of `neighbours` white ones."""
    normal = np.random.default_rng(seed).standard_normal((2, count + neighbours - 1))
    mean = np.lib.stride_tricks.sliding_window_view(normal, neighbours, 1).sum(axis=2) / np.sqrt(2 * neighbours)
    return mean[0] + 1j * mean[1]


def test_equations_of_yule_and_walker() -> None:
    """Coefficients and remaining variance of the predictor of order 2."""
    phi, s = MEMORY.predictor(2)
    rho = np.array([1.0, *MEMORY.correlations])
    np.testing.assert_allclose([rho[0] * phi[0] + rho[1] * phi[1], rho[1] * phi[0] + rho[0] * phi[1]], rho[1:])
    assert s**2 == pytest.approx(1 - phi @ rho[1:])


def test_likelihood_is_that_of_a_normal_distribution() -> None:
    """Differences of log density against the multivariate normal distribution with these correlations; colouring
    inverts whitening.
    """
    normal = multivariate_normal(np.zeros(COUNT), correlations(MEMORY, COUNT))
    first, second = np.random.default_rng(2).standard_normal((2, COUNT))
    squares = [np.sum(MEMORY.whitened(errors) ** 2) for errors in (first, second)]
    assert (squares[1] - squares[0]) / 2 == pytest.approx(normal.logpdf(first) - normal.logpdf(second))
    np.testing.assert_allclose(MEMORY.coloured(MEMORY.whitened(first)), first, atol=1e-14)
    np.testing.assert_array_equal(WHITE.whitened(first), first)


def test_columns_are_whitened_as_each_by_itself() -> None:
    """Whitening acts on each column alone, and on each row with the rows before it."""
    columns = np.random.default_rng(3).standard_normal((COUNT, 2, 3))
    found = MEMORY.whitened(columns)
    np.testing.assert_allclose(found[:, 1, 2], MEMORY.whitened(columns[:, 1, 2]))
    np.testing.assert_array_equal(MEMORY.whitened(columns[:2])[:2], found[:2])


@pytest.mark.parametrize("count", [COUNT, 2, 1])
def test_transposed_whitening_is_that_of_the_matrix(count: int) -> None:
    values = drawn(5, count, 1)[:, None] * [1, 2j]
    np.testing.assert_allclose(MEMORY.transposed(values), MEMORY.whitened(np.eye(count)).T @ values, atol=1e-14)


@pytest.mark.parametrize("count", [1, 3, 40])
def test_transposed_colouring_is_that_of_the_matrix(count: int) -> None:
    """L is the inverse of the matrix of whitening."""
    memory, rng = Autoregression((0.8, 0.5, 0.3)), np.random.default_rng(4)
    matrix = np.linalg.inv(memory.whitened(np.eye(count)))
    values = rng.normal(size=(count, 2)) + 1j * rng.normal(size=(count, 2))
    assert memory.coloured_transposed(values) == pytest.approx(matrix.T @ values, rel=1e-9)
    assert WHITE.coloured_transposed(values) == pytest.approx(values)


@pytest.mark.parametrize("neighbours", [2, 3, 4])
def test_smoothed_noise_is_recognised_and_whitened(neighbours: int) -> None:
    """Correlations of a moving average fall linearly with the distance; whitened, neighbours are uncorrelated and
    the variance is 1.
    """
    errors = drawn(neighbours, 2001, neighbours)
    memory = autoregression(errors)
    expected = [1 - step / neighbours for step in range(1, neighbours)]
    np.testing.assert_allclose(memory.correlations[: neighbours - 1], expected, atol=0.06)
    white = memory.whitened(errors)
    assert abs(np.sum(white[1:] * white[:-1].conj()) / np.sum(np.abs(white) ** 2)) < 0.1
    assert np.mean(np.abs(white) ** 2) == pytest.approx(1.0, abs=0.1)


def test_white_noise_is_white() -> None:
    """200 sweeps of white noise, none with correlations found."""
    assert all(autoregression(drawn(seed, 301, 1)) == WHITE for seed in range(200))


def test_each_sweep_has_its_own_correlations() -> None:
    """Of two sweeps the first is correlated and the second white."""
    frequency, z = np.tile(np.linspace(1e4, 2e4, COUNT), 2), np.ones(2 * COUNT, complex)
    noise = np.full(2 * COUNT, 1e-3)
    data = SweepData(frequency, z, noise, True, sizes=(COUNT, COUNT), noise_memory=(MEMORY, WHITE))
    error = 1e-3 * drawn(1, 2 * COUNT, 1)
    found = data.over_noise(error)
    np.testing.assert_allclose(found[:COUNT], MEMORY.whitened(error[:COUNT]) * np.sqrt(2) / 1e-3)
    np.testing.assert_allclose(found[COUNT:], error[COUNT:] * np.sqrt(2) / 1e-3)
    np.testing.assert_allclose(data.from_noise(found), error, atol=1e-15)
