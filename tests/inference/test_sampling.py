"""Posterior samples against a problem whose posterior is known."""

from __future__ import annotations

import numpy as np
import pytest

from femu_piezo.errors import ConvergenceError
from femu_piezo.inference.fit import fit
from femu_piezo.inference.sampling import sample_posterior
from femu_piezo.inference.unknowns import FreeConstants, MaterialParameters, Unknowns
from femu_piezo.material.library import library_material
from femu_piezo.measurement.sweeps import SweepData

emcee = pytest.importorskip("emcee")
NOISE = 1e-3
PRIOR = {"s11": (17e-12, 0.2e-12), "tan_s11": (0.02, 0.003)}


class Exponential:
    """log Z = m·(x − x0), so that data and a Gaussian prior have a Gaussian posterior."""

    def __init__(self, slopes: np.ndarray, x0: np.ndarray) -> None:
        self.slopes, self.x0 = slopes, x0

    def at(self, factor):
        return self

    def with_jacobian(self, parameters, x):
        z = np.exp(self.slopes @ (x - self.x0))
        return z, z[:, None] * self.slopes


@pytest.fixture(scope="module")
def problem():
    """Response, fit, and mean and covariance of the posterior over x by normal equations."""
    free = FreeConstants.of(library_material("pzt-5h").constants, ("s11",))
    unknowns = Unknowns(MaterialParameters.around(free, free.start), PRIOR)
    rng = np.random.default_rng(3)
    slopes = 0.06 * rng.standard_normal((40, 2)) * (1 + 0.5j)
    response = Exponential(slopes, np.array([1.0, 0.02]))
    normal = rng.standard_normal((2, 40))
    z = np.exp(NOISE * (normal[0] + 1j * normal[1]) / np.sqrt(2))
    data = SweepData(np.linspace(1e3, 2e3, 40), z, np.full(40, NOISE), True)
    solution = fit(response, data, unknowns, [unknowns.prior_mean])
    weight = np.sqrt(2) / NOISE / solution.noise_scale
    rows = np.concatenate([slopes.real, slopes.imag]) * weight
    target = np.concatenate([np.log(z).real, np.log(z).imag]) * weight + rows @ response.x0
    precision = rows.T @ rows + np.diag(1 / unknowns.prior_std**2)
    mean = np.linalg.solve(precision, rows.T @ target + unknowns.prior_mean / unknowns.prior_std**2)
    return response, solution, mean, np.linalg.inv(precision)


def test_samples_have_the_known_mean_width_and_intervals(problem):
    response, solution, mean, covariance = problem
    posterior = sample_posterior(response, solution, steps=6000)
    assert posterior.names == ("s11", "tan_s11")
    scale = np.array([solution.parameters.material.scale[0], 1.0])
    for column, (exact, std) in enumerate(zip(mean * scale, np.sqrt(np.diag(covariance)) * scale, strict=True)):
        values = posterior.samples[:, column]
        assert values.mean() == pytest.approx(exact, abs=0.1 * std)
        assert values.std() == pytest.approx(std, rel=0.08)
    low, high = posterior.interval("s11", 0.95)
    assert (high - low) / (np.sqrt(covariance[0, 0]) * scale[0]) == pytest.approx(2 * 1.96, rel=0.1)
    correlation = np.corrcoef(posterior.samples.T)[0, 1]
    assert correlation == pytest.approx(covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1]), abs=0.08)


def test_a_short_chain_is_refused_with_the_length_it_needs(problem):
    with pytest.raises(ConvergenceError, match=r"ask for \d+ steps"):
        sample_posterior(*problem[:2], steps=50)
