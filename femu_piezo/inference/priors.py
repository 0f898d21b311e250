"""The priors of causes, as a factor on the evidence of a fit, whose own priors are normal.

A fit holds every parameter p of a cause by a normal prior N(p; r, τ) about rest, r. The prior of a hypothesis is

    π(p) = ∫ N(p; r, uτ) / P(low < p < high | uτ) d(ln u)/ln U,   1/U < u < 1,   low < p < high,

for a size (`Effect.of_any_scale`), and the same with u = 1 for any other parameter. It is normalised within its bounds:
a place that may be anywhere along an edge has the density 1/(length of the edge). τ is the largest usual size of a
cause; its actual size may be smaller by two orders of magnitude, U = 100. So odds depend little on τ, and a small cause
that is plain to see does not lose evidence to large ones that might have been (a mixture of scales, as Liang et al., J.
Am. Stat. Assoc. 103 (2008) 410, have it for sets of regressors). All other unknowns integrated out, the likelihood of p
is taken as normal:

    ln L(p) = h (p − r) − ½ q (p − r)² + constant,    q = 1/σ² − 1/τ²,  h = (p̂ − r)/σ²

with p̂ ± σ the estimate of the fit. From it follows, for every u, what the evidence gains over that of the fit.

The parameters of a form that stands for unknown causes (`Effect.of_unknown`) give its size together: they share one u.
Their likelihood, normal in all of them, is a product along the eigenvectors of Σ/(τ τᵗ), Σ their covariance. Their
bounds are many of their deviations τ away and are neglected.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from femu_piezo.effects.effect import Effect

#: U, and the number of values of u, evenly spaced in ln u, whose mean stands for the integral.
_ORDERS, _STEPS = 100.0, 40
_SHARES = _ORDERS ** -((np.arange(_STEPS) + 0.5) / _STEPS)
#: Least share of the prior variance by which the variance of an estimate is taken to be below it.
_TOLD = 1e-12


def log_prior_gain(effect: Effect, estimate: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """ln ∫ L π dp − ln ∫ L N(p; r, τ) dp of a cause, its parameters one by one; of one fit () or of k fits (k,).

    Parameters
    ----------
    estimate, covariance : (n,), (n, n) or (k, n), (k, n, n) of its parameters, all other unknowns integrated out, in
        their scales
    """
    rest, spread = effect.rest / effect.scale, effect.spread / effect.scale
    if effect.of_unknown:
        free = np.flatnonzero(spread > 0)
        return _gain_of_all((estimate - rest)[..., free], covariance[..., free[:, None], free], spread[free])
    std = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    found, bounds = np.zeros(estimate.shape[:-1]), effect.bounds / effect.scale[:, None] - rest[:, None]
    for number in np.flatnonzero(spread > 0):
        usual, least = spread[number], effect.tolerance[number] / effect.scale[number]
        spreads = np.maximum(usual * _SHARES, least) if number in effect.of_any_scale else np.atleast_1d(usual)
        low, high = bounds[number]
        found += _gain(estimate[..., [number]] - rest[number], std[..., [number]], (low, high), usual, spreads)
    return found


def _gain(
    away: np.ndarray, std: np.ndarray, ends: tuple[float, float], usual: float, spreads: np.ndarray
) -> np.ndarray:
    """Gain () or (k,) of one parameter, estimated at `away` (1,) or (k, 1) from rest, by the mean of m priors."""
    density, mean, narrowed = _with_each(away, std, usual, spreads)
    inside = _log_inside(np.clip(mean, *ends), narrowed, ends) - _log_inside(0.0, spreads, ends)
    return np.logaddexp.reduce(density + inside, axis=-1) - np.log(spreads.size)


def _gain_of_all(away: np.ndarray, covariance: np.ndarray, usual: np.ndarray) -> np.ndarray:
    """Gain () or (k,) of all parameters, at `away` (n,) or (k, n) from rest, whose priors u τ share u; τ = `usual`."""
    variances, axes = np.linalg.eigh(covariance / np.outer(usual, usual))
    along = np.swapaxes(axes, -1, -2) @ (away / usual)[..., None]
    density = _with_each(along, np.sqrt(np.maximum(variances, np.finfo(float).eps))[..., None], 1.0, _SHARES)[0]
    return np.logaddexp.reduce(density.sum(axis=-2), axis=-1) - np.log(_SHARES.size)


def _with_each(
    away: np.ndarray, std: np.ndarray, usual: float, spreads: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(…, m) gain in log evidence, posterior mean and deviation with each of m priors, without bounds."""
    variance = np.minimum(std**2, usual**2 * (1 - _TOLD))
    natural, precision = away / variance, 1 / variance - 1 / usual**2
    with_usual, with_each = 1 + precision * usual**2, 1 + precision * spreads**2
    density = -0.5 * np.log(with_each / with_usual)
    density -= 0.5 * natural**2 * (usual**2 - spreads**2) / with_usual / with_each
    narrowed = spreads / np.sqrt(with_each)
    return density, natural * narrowed**2, narrowed


def _log_inside(mean: np.ndarray | float, std: np.ndarray, ends: tuple[float, float]) -> np.ndarray:
    """ln P(low < p < high) of normal p, for means between the ends."""
    low, high = (ends[0] - mean) / std, (ends[1] - mean) / std
    return np.log(ndtr(high) - ndtr(low))
