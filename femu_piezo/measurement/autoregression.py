"""Noise that is correlated between neighbouring points, as filters, smoothing and averaging over neighbours make it.

The noise n of a sweep, in units of its standard deviation, is an autoregression of order p, each point k predicted by
the points before it,

    n_k = Σ_j φ_j n_{k−j} + s e_k,    e white with standard deviation 1.

The coefficients φ solve the equations of Yule and Walker, Σ_j φ_j ρ_{|i−j|} = ρ_i for i = 1…p, with the correlations
ρ_j of the residual of a fit, and s² = 1 − Σ_j φ_j ρ_j. The likelihood of n is that of e, so a fit minimises Σ|e|²: the
points are as many, but each carries less information. The first p points are predicted by fewer points than p.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.special import chdtri

#: Highest order p.
_MOST = 4
#: Probability by chance, of white noise, below which a partial correlation counts.
_CHANCE = 1e-4
#: ρ_1 below which noise is taken as white: standard deviations are then at most a third too small.
_LEAST = 0.25


@dataclass(frozen=True)
class Autoregression:
    """The autoregression of the errors of a sweep.

    Attributes
    ----------
    correlations : (p,) ρ_1…ρ_p of points 1…p steps apart; none where the noise is white
    """

    correlations: tuple[float, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.correlations)

    def predictor(self, order: int) -> tuple[np.ndarray, float]:
        """φ (order,) and s of the prediction by the `order` points before, the nearest first."""
        return _predictor(self.correlations[:order])

    def whitened(self, errors: np.ndarray) -> np.ndarray:
        """White e (k, …) of errors n (k, …) in units of their standard deviation, in order of frequency."""
        found = np.array(errors)
        for rows, phi, deviation in self._predictions(len(errors)):
            expected = sum(
                coefficient * errors[rows.start - lag : rows.stop - lag] for lag, coefficient in enumerate(phi, start=1)
            )
            found[rows] = (errors[rows] - expected) / deviation
        return found

    def transposed(self, values: np.ndarray) -> np.ndarray:
        """Aᵗ v (k, …) of values v (k, …), with A the matrix of `whitened`, e = A n."""
        found = np.array(values)
        for rows, phi, deviation in self._predictions(len(values)):
            found[rows] += values[rows] / deviation - values[rows]
            for lag, coefficient in enumerate(phi, start=1):
                found[rows.start - lag : rows.stop - lag] -= coefficient * values[rows] / deviation
        return found

    def _predictions(self, count: int) -> Iterator[tuple[slice, np.ndarray, float]]:
        """Slices of the points 1…count − 1, each predicted by equally many points before, with φ and s."""
        most = min(len(self.correlations), count)
        for order in range(1, most + 1):
            yield slice(order, count if order == most else order + 1), *self.predictor(order)

    def coloured(self, white: np.ndarray) -> np.ndarray:
        """n (k, …) of e (k, …): the inverse of `whitened`."""
        found = np.array(white)
        for point in range(1, len(white) if self else 0):
            phi, deviation = self.predictor(min(point, len(self.correlations)))
            found[point] = phi @ found[point - phi.size : point][::-1] + deviation * white[point]
        return found

    def coloured_transposed(self, values: np.ndarray) -> np.ndarray:
        """Lᵗ v (k, …) of values v (k, …), with L the matrix of `coloured`, n = L e."""
        found = np.array(values)
        for point in range(len(values) - 1, 0, -1) if self else ():
            phi, deviation = self.predictor(min(point, len(self.correlations)))
            for lag, coefficient in enumerate(phi, start=1):
                found[point - lag] += coefficient * found[point]
            found[point] *= deviation
        return found


@lru_cache(maxsize=64)
def _predictor(correlations: tuple[float, ...]) -> tuple[np.ndarray, float]:
    """φ (p,) and s from ρ_1…ρ_p; cached, since every whitening needs them."""
    if not correlations:
        return np.zeros(0), 1.0
    rho = np.array([1.0, *correlations])
    phi = solve_toeplitz(rho[:-1], rho[1:])
    return phi, float(np.sqrt(1 - phi @ rho[1:]))


WHITE = Autoregression()


def autoregression(errors: np.ndarray) -> Autoregression:
    """The autoregression of complex errors (k,), whose order is the last with a partial correlation beyond chance.

    The partial correlation of p steps is φ_p of the order p; for white noise its standard deviation is 1/√(2k). The
    correlations are real parts. White where ρ_1 is no larger than `_LEAST`.
    """
    power, least = float(np.sum(np.abs(errors) ** 2)), chdtri(1, _CHANCE) / (2 * errors.size)
    steps = range(1, min(_MOST, errors.size // 8) + 1) if power > 0 else ()
    rho = [float(np.sum(errors[step:] * errors[:-step].conj()).real) / power for step in steps]
    tried = [Autoregression(tuple(rho[:step])) for step in steps]
    beyond = [model for model, step in zip(tried, steps, strict=True) if model.predictor(step)[0][-1] ** 2 > least]
    return beyond[-1] if beyond and rho[0] > _LEAST else WHITE
