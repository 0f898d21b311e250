"""Posterior samples against a problem whose posterior is known."""

from __future__ import annotations

import pytest
from femu_piezo.inference.blocks import Prior
from femu_piezo.inference.least_squares import fit

from femu_piezo.errors import ConvergenceError
from femu_piezo.inference.sampling import sample_posterior
from femu_piezo.inference.unknowns import FreeConstants, MaterialParameters
from femu_piezo.material.library import library_material

emcee = pytest.importorskip("emcee")


@pytest.fixture(scope="module")
def gaussian():
    """Two unknowns with a Gaussian posterior: the prior alone."""
    free = FreeConstants.of(library_material("pzt-5h").constants, ("s11",))
    parameters = MaterialParameters.around(free, free.start)
    prior = Prior({"s11": (17e-12, 0.2e-12), "tan_s11": (0.02, 0.003)})
    return prior, fit([prior], parameters, free.start * (1 - 0.01j))


def test_samples_have_the_known_mean_width_and_intervals(gaussian):
    prior, solution = gaussian
    posterior = sample_posterior([prior], solution, steps=6000)
    assert posterior.names == ("s11", "tan_s11")
    for column, (mean, std) in enumerate(((17e-12, 0.2e-12), (0.02, 0.003))):
        values = posterior.samples[:, column]
        assert values.mean() == pytest.approx(mean, abs=0.1 * std)
        assert values.std() == pytest.approx(std, rel=0.08)
    low, high = posterior.interval("s11", 0.95)
    assert (high - low) / 0.2e-12 == pytest.approx(2 * 1.96, rel=0.1)


def test_a_short_chain_is_refused_with_the_length_it_needs(gaussian):
    prior, solution = gaussian
    with pytest.raises(ConvergenceError, match=r"ask for \d+ steps"):
        sample_posterior([prior], solution, steps=50)
