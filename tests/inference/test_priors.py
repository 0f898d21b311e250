"""Priors of causes: the evidence under them against integrals, that it depends little on the usual size, and how
places and bounds enter.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from femu_piezo.effects.effect import Effect, EffectParameter
from femu_piezo.inference.priors import log_prior_gain


def cause(spread: float, low: float, high: float, *, tolerance: float = 0.0, placed: bool = False) -> Effect:
    """A cause with a size, and with a place between 0 and 6 m where it is placed."""
    size = EffectParameter("size", "1", low, high, 0.1, spread, tolerance=tolerance)
    place = EffectParameter("place", "m", 0.0, 6.0, 0.5, 60.0, rest=3.0)
    sites = np.array([[0.1, 1.0], [0.1, 5.0]]) if placed else None
    return Effect("one", "one", (size, place) if placed else (size,), sites=sites)


def fitted(mean: float, std: float, spread: float) -> tuple[float, float]:
    """Mean and standard deviation of the posterior of a likelihood N(mean, std) under the prior N(0, spread)."""
    variance = 1 / (1 / std**2 + 1 / spread**2)
    return variance * mean / std**2, np.sqrt(variance)


@pytest.mark.parametrize("tolerance", [0.0, 0.05])
@pytest.mark.parametrize(("mean", "std"), [(3.0, 0.5), (0.3, 0.1), (0.0, 2.0), (0.02, 0.004), (-0.05, 0.1)])
@pytest.mark.parametrize("low", [-4.0, 0.0])
def test_gain_is_that_of_the_mixture_within_its_bounds(mean, std, low, tolerance):
    """Against ∫ L π dp by quadrature, π the mean of 401 normal priors of different scales, each normalised within the
    bounds.

    Within 2 %. Where the likelihood has its maximum outside the bounds the fit is held on the bound, and 0.5 in log
    evidence is allowed.
    """
    spread, high = 1.3, 5.0
    grid = np.linspace(low, high, 6001)
    prior = np.zeros(grid.size)
    for scale in spread * 0.01 ** ((np.arange(401) + 0.5) / 401):
        effect = norm(0, max(scale, tolerance))
        prior += effect.pdf(grid) / (effect.cdf(high) - effect.cdf(low)) / 401
    integral = np.trapezoid(norm(mean, std).pdf(grid) * prior, grid)
    usual = norm(0, np.hypot(std, spread)).pdf(mean)
    estimate, deviation = np.array(fitted(mean, std, spread)) / 0.1
    effect = cause(spread, low, high, tolerance=tolerance)
    found = log_prior_gain(effect, np.array([max(estimate, low)]), np.array([[deviation**2]]))
    # a mean outside of the bounds is replaced by the bound, where the fit is held
    assert found == pytest.approx(np.log(integral / usual), abs=0.02 if mean >= low else 0.5)


def test_place_has_a_uniform_prior_over_its_range():
    """A place that the data tell has the prior density 1/6 per metre, whatever the width of the normal prior of the
    fit.

    A place that the data do not tell adds nothing to the evidence.
    """
    effect = cause(1.0, -4.0, 5.0, placed=True)
    told, untold = np.array([1e-3 / 0.1, 0.05 / 0.5]), np.array([1e-3 / 0.1, 60.0 / 0.5])
    estimate = np.array([0.5 / 0.1, 2.0 / 0.5])
    gains = []
    for spread in (60.0, 600.0):
        parameters = (effect.parameters[0], replace(effect.parameters[1], spread=spread))
        wide = replace(effect, parameters=parameters)
        normal = norm(3, np.hypot(spread, 0.05)).pdf(2.0)
        untold[1] = spread / 0.5
        gains.append(gain_of(wide, estimate, told) - gain_of(wide, estimate, untold) + np.log(normal))
    assert gains == pytest.approx([np.log(1 / 6)] * 2, abs=1e-3)


def test_evidence_depends_little_on_the_usual_size():
    """A size ten deviations from zero, with a usual size stated between 3 and 100: log evidence varies by less than
    0.7.

    Under the normal prior alone it varies by more than 3.
    """
    evidence, normal = [], []
    for spread in (3.0, 10.0, 30.0, 100.0):
        estimate, deviation = fitted(1.0, 0.1, spread)
        usual = norm(0, np.hypot(0.1, spread)).logpdf(1.0)
        gain = gain_of(cause(spread, -1e3, 1e3), np.array([estimate / 0.1]), np.array([deviation / 0.1]))
        evidence.append(usual + gain)
        normal.append(usual)
    assert np.ptp(evidence) < 0.7 < 3 < np.ptp(normal)


@pytest.mark.parametrize("size", [0.0, 0.05, 0.6])
def test_parameters_of_a_form_that_is_no_cause_share_one_scale(size):
    """Against ∫ L π dp in closed form, π the mean of 400 normal priors with one common scale; estimates of the two
    parameters are correlated.
    """
    usual, scale = np.array([0.3, 2.0]), np.array([0.1, 0.5])
    parameters = tuple(
        EffectParameter(name, "1", -1e3, 1e3, *pair)
        for name, pair in zip("ab", zip(scale, usual, strict=True), strict=True)
    )
    form = Effect("form", "form", parameters, of_unknown=True)
    mean, error = size * np.array([0.2, -1.0]), np.array([[4e-3, 5e-3], [5e-3, 1e-2]])
    evidence = [
        multivariate_normal(cov=error + np.diag((0.01 ** ((n + 0.5) / 400) * usual) ** 2)).pdf(mean) for n in range(400)
    ]
    covariance = np.linalg.inv(np.linalg.inv(error) + np.diag(usual**-2.0))
    estimate = covariance @ np.linalg.solve(error, mean)
    found = log_prior_gain(form, estimate / scale, covariance / np.outer(scale, scale))
    normal = multivariate_normal(cov=error + np.diag(usual**2)).logpdf(mean)
    assert found == pytest.approx(np.log(np.mean(evidence)) - normal, abs=0.01)


def test_gains_of_several_fits_at_once():
    """Gains computed together are those computed for each fit, for a placed cause and for a form that is no cause."""
    rng = np.random.default_rng(3)
    roots = rng.standard_normal((4, 2, 2)) * 0.3
    covariance, estimates = roots @ np.swapaxes(roots, 1, 2), rng.standard_normal((4, 2))
    effect_at_a_place = cause(1.0, -40.0, 50.0, placed=True)
    for effect in (effect_at_a_place, replace(effect_at_a_place, sites=None, of_unknown=True)):
        each = [float(log_prior_gain(effect, *fit)) for fit in zip(estimates, covariance, strict=True)]
        assert log_prior_gain(effect, estimates, covariance) == pytest.approx(each, rel=1e-12)


def gain_of(effect: Effect, estimate: np.ndarray, std: np.ndarray) -> float:
    """Gain in log evidence for uncorrelated estimates, in units of the parameters' scales."""
    return float(log_prior_gain(effect, estimate, np.diag(std**2)))
