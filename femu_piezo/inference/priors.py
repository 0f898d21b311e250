"""What the prior of a cause is beside the normal one that a fit has, as a factor on its evidence.

A fit holds every parameter p of a cause by a normal prior N(p; r, τ) about rest, r. The prior of a hypothesis is

    π(p) = ∫ N(p; r, uτ) / P(low < p < high | uτ) d(ln u)/ln U,   1/U < u < 1,   low < p < high,

for a size, and the same with u = 1 for any other parameter. Within its bounds it is a probability: a place that may be
anywhere along an edge has the density of one over the edge. And τ is how large a cause may usually be; how large it is
may be smaller by two orders of magnitude, U = 100: odds depend little on τ, and a small cause that is plain to see does
not pay for the large ones that might have been (a mixture of scales, as Liang et al., J. Am. Stat. Assoc. 103 (2008)
410, have it for sets of regressors). All other unknowns integrated out, the likelihood of p is taken as normal:

    ln L(p) = h (p − r) − ½ q (p − r)² + constant,    q = 1/σ² − 1/τ²,  h = (p̂ − r)/σ²

of the estimate p̂ ± σ of the fit. So is known, for every u, what the evidence gains over that of the fit.
"""

from __future__ import annotations

import numpy as np
from scipy.special import logsumexp, ndtr

from femu_piezo.effects.effect import Effect

#: U, and values of u that stand for all, evenly in ln u.
_ORDERS, _STEPS = 100.0, 40
_SHARES = _ORDERS ** -((np.arange(_STEPS) + 0.5) / _STEPS)
#: Least share of the variance of the prior by which the data have to narrow it.
_TOLD = 1e-12


def log_prior_gain(effect: Effect, estimate: np.ndarray, std: np.ndarray) -> np.ndarray:
    """ln ∫ L π dp − ln ∫ L N(p; r, τ) dp of a cause, its parameters one by one; of one fit () or of k fits (k,).

    Parameters
    ----------
    estimate, std : (n,) or (k, n) parameters and deviations, all other unknowns integrated out, in their scales
    """
    found, low_high = np.zeros(estimate.shape[:-1]), effect.bounds / effect.scale[:, None]
    for number, (low, high) in enumerate(low_high):
        scale = effect.scale[number]
        usual, least = effect.spread[number] / scale, effect.tolerance[number] / scale
        if usual > 0:
            spreads = np.atleast_1d(usual)
            if number in effect.sizes and not effect.of_unknown:
                spreads = np.maximum(usual * _SHARES, least)
            rest = effect.rest[number] / scale
            ends = low - rest, high - rest
            found += _gain(estimate[..., [number]] - rest, std[..., [number]], ends, usual, spreads)
    return found


def _gain(
    away: np.ndarray, std: np.ndarray, ends: tuple[float, float], usual: float, spreads: np.ndarray
) -> np.ndarray:
    """The same of one parameter, estimated at `away` (1,) or (k, 1) from rest, of m priors for the usual one."""
    variance = np.minimum(std**2, usual**2 * (1 - _TOLD))
    natural, precision = away / variance, 1 / variance - 1 / usual**2
    with_usual, with_each = 1 + precision * usual**2, 1 + precision * spreads**2
    density = -0.5 * np.log(with_each / with_usual)
    density -= 0.5 * natural**2 * (usual**2 - spreads**2) / with_usual / with_each
    narrowed = spreads / np.sqrt(with_each)
    inside = _log_inside(np.clip(natural * narrowed**2, *ends), narrowed, ends) - _log_inside(0.0, spreads, ends)
    return logsumexp(density + inside, axis=-1) - np.log(spreads.size)


def _log_inside(mean: np.ndarray | float, std: np.ndarray, ends: tuple[float, float]) -> np.ndarray:
    """ln P(low < p < high) of normal p, for means between the ends."""
    low, high = (ends[0] - mean) / std, (ends[1] - mean) / std
    return np.log(ndtr(high) - ndtr(low))
