"""Posterior samples against a problem whose posterior is known."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from laboratory import Response

from femu_piezo.errors import InputError
from femu_piezo.inference.fit import fit
from femu_piezo.inference.free_constants import FreeConstants
from femu_piezo.inference.sampling import _drawn, sample_posterior
from femu_piezo.inference.unknowns import MaterialParameters, Unknowns
from femu_piezo.material.library import library_material
from femu_piezo.measurement.sweeps import SweepData
from tests.noise import circular_noise

NOISE = 1e-3
PRIOR = {"s11": (17e-12, 0.2e-12), "tan_s11": (0.02, 0.003)}


class Exponential(Response):
    """A response log Z = m·(x − x0), so that the posterior under a Gaussian prior is Gaussian."""

    def __init__(self, slopes: np.ndarray, x0: np.ndarray) -> None:
        self.slopes, self.x0 = slopes, x0

    def with_jacobian(self, parameters, x):
        z = np.exp(self.slopes @ (x - self.x0))
        return z, z[:, None] * self.slopes


@pytest.fixture(scope="module")
def problem():
    """Response, fit, and mean and covariance of the posterior of x by normal equations."""
    free = FreeConstants.of(library_material("pzt-5h").constants, ("s11",))
    unknowns = Unknowns(MaterialParameters.around(free, free.start), PRIOR)
    rng = np.random.default_rng(3)
    slopes = 0.06 * rng.standard_normal((40, 2)) * (1 + 0.5j)
    response = Exponential(slopes, np.array([1.0, 0.02]))
    z = np.exp(circular_noise(40, NOISE, rng))
    data = SweepData(np.linspace(1e3, 2e3, 40), z, np.full(40, NOISE), True)
    solution = fit(response, data, unknowns, [unknowns.prior_mean])
    weight = np.sqrt(2) / NOISE / solution.noise_scale
    rows = np.concatenate([slopes.real, slopes.imag]) * weight
    target = np.concatenate([np.log(z).real, np.log(z).imag]) * weight + rows @ response.x0
    precision = rows.T @ rows + np.diag(1 / unknowns.prior_std**2)
    mean = np.linalg.solve(precision, rows.T @ target + unknowns.prior_mean / unknowns.prior_std**2)
    return response, solution, mean, np.linalg.inv(precision)


@pytest.mark.slow
def test_samples_have_the_known_mean_width_and_intervals(problem):
    response, solution, mean, covariance = problem
    posterior = sample_posterior(response, solution, 2000)
    assert posterior.names == ("s11", "tan_s11")
    scale = np.array([solution.parameters.material.scale[0], 1.0])
    for column, (exact, std) in enumerate(zip(mean * scale, np.sqrt(np.diag(covariance)) * scale, strict=True)):
        values = posterior.values[:, column]
        assert values.mean() == pytest.approx(exact, abs=0.05 * std)
        assert values.std() == pytest.approx(std, rel=0.04)
    low, high = posterior.interval("s11", 0.95)
    assert (high - low) / (np.sqrt(covariance[0, 0]) * scale[0]) == pytest.approx(2 * 1.96, rel=0.06)
    correlation = np.corrcoef(posterior.values.T)[0, 1]
    assert correlation == pytest.approx(covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1]), abs=0.05)


class Ridge(Exponential):
    """A response that determines only the product of the two unknowns, to 1e-4 of the width that the prior leaves to
    each.
    """

    def with_jacobian(self, parameters, x):
        z = np.exp(self.slopes[:, 0] * (x[0] * x[1] - self.x0[0] * self.x0[1]))
        return z, z[:, None] * self.slopes[:, :1] * np.array([x[1], x[0]])


def test_a_ridge_far_narrower_than_it_bends_is_followed():
    """Samples keep the product to 1e-4 and spread along the ridge at least half as far as the prior, cut by the
    ridge, allows.

    Draws of the Gaussian approximation leave the ridge: their products scatter more than 50 times as much.
    """
    free = FreeConstants.of(library_material("pzt-5h").constants, ("s11",))
    prior = {"s11": (17e-12, 1.7e-12), "tan_s11": (0.02, 0.004)}
    unknowns = Unknowns(MaterialParameters.around(free, free.start), prior)
    slopes = 20 * np.random.default_rng(5).standard_normal((40, 2)) * (1 + 0.5j)
    start = unknowns.prior_mean
    response = Ridge(slopes, start)
    data = SweepData(np.linspace(1e3, 2e3, 40), np.ones(40, complex), np.full(40, 1e-5), True)
    solution = fit(response, data, unknowns, [start])
    found = sample_posterior(response, solution, 200).values / np.array([unknowns.material.scale[0], 1.0])
    product, exact = found[:, 0] * found[:, 1], start[0] * start[1]
    assert np.std(product) / exact < 1e-4
    normal = np.random.default_rng(1).multivariate_normal(solution.x, solution.covariance, 500)
    assert np.std(normal[:, 0] * normal[:, 1]) / exact > 50 * np.std(product) / exact
    assert np.std(found[:, 0]) > 0.5 * unknowns.prior_std[0] / np.sqrt(2)


def test_drawn_errors_are_those_of_the_data_before_the_loss_weighs_them():
    """Laws, mesh and discrepancy of a fit hold the square root of the weight of a robust loss, which a fit to drawn
    data applies again: the covariance of 20 000 draws is that without it, within 5 %.
    """
    rng, weight = np.random.default_rng(5), np.array([1.0, 0.25, 0.01, 1.0])
    law, mesh, columns = (rng.standard_normal((4, count)) for count in (2, 1, 3))
    share, scale = np.sqrt(weight)[:, None], 1.5
    solution = SimpleNamespace(
        residual=np.zeros(4),
        noise_scale=scale,
        weight=weight,
        law=share * law,
        mesh=share * mesh,
        discrepancy=SimpleNamespace(columns=share * columns),
    )
    draws = np.array([_drawn(solution, rng) for _ in range(20_000)])
    expected = scale**2 * (np.eye(4) + columns @ columns.T) + law @ law.T + mesh @ mesh.T
    np.testing.assert_allclose(np.cov(draws.T), expected, atol=0.05 * np.max(expected))


def test_too_few_samples_are_refused(problem):
    with pytest.raises(InputError, match="50 at least"):
        sample_posterior(*problem[:2], 10)
