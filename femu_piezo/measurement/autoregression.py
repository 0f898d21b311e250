"""Noise whose neighbours err alike, as filters, smoothing and averaging over neighbours make it.

Over its standard deviation the noise n of a sweep is an autoregression, the point k by those before it,

    n_k = Σ_j φ_j n_{k−j} + s e_k,    e white and of deviation 1,

with φ by Yule and Walker: with the correlations ρ_j of what a fit leaves, Σ_j φ_j ρ_{|i−j|} = ρ_i for i = 1…p and
s² = 1 − Σ_j φ_j ρ_j. The likelihood of n is that of e, which is what a fit minimises: as many points, but each tells
less. The first p points are predicted by those that they have.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.special import chdtri

#: Most neighbours before a point that predict it.
_MOST = 4
#: Probability by chance below which one more of them is taken.
_CHANCE = 1e-4
#: Correlation of nearest neighbours below which noise is taken as white: deviations are then at most a third too small.
_LEAST = 0.25


@dataclass(frozen=True)
class Autoregression:
    """How neighbouring errors follow each other.

    Attributes
    ----------
    correlations : (p,) ρ_1…ρ_p of points 1…p steps apart; none where the noise is white
    """

    correlations: tuple[float, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.correlations)

    def predictor(self, order: int) -> tuple[np.ndarray, float]:
        """φ (order,) of so many points before, the nearest first, and s."""
        return _predictor(self.correlations[:order])

    def whitened(self, errors: np.ndarray) -> np.ndarray:
        """e (k, …) of errors n (k, …) over their standard deviation, in order of frequency."""
        found = np.array(errors)
        for rows, phi, deviation in self._predictions(len(errors)):
            expected = sum(one * errors[rows.start - back : rows.stop - back] for back, one in enumerate(phi, start=1))
            found[rows] = (errors[rows] - expected) / deviation
        return found

    def transposed(self, values: np.ndarray) -> np.ndarray:
        """Aᵗ v (k, …) of values (k, …), with A the matrix of `whitened`."""
        found = np.array(values)
        for rows, phi, deviation in self._predictions(len(values)):
            found[rows] += values[rows] / deviation - values[rows]
            for back, one in enumerate(phi, start=1):
                found[rows.start - back : rows.stop - back] -= one * values[rows] / deviation
        return found

    def _predictions(self, count: int) -> Iterator[tuple[slice, np.ndarray, float]]:
        """The points after the first of so many: those that as many before predict, with φ and s."""
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


@lru_cache(maxsize=64)
def _predictor(correlations: tuple[float, ...]) -> tuple[np.ndarray, float]:
    """φ and s of ρ_1…ρ_p; kept, since all that is whitened asks for them."""
    if not correlations:
        return np.zeros(0), 1.0
    rho = np.array([1.0, *correlations])
    phi = solve_toeplitz(rho[:-1], rho[1:])
    return phi, float(np.sqrt(1 - phi @ rho[1:]))


WHITE = Autoregression()


def autoregression(errors: np.ndarray) -> Autoregression:
    """That of complex errors (k,), up to the last partial correlation that is beyond chance; real correlations.

    The partial correlation of p steps is φ_p of the order p; of white noise it has the standard deviation 1/√(2k).
    """
    power, least = float(np.sum(np.abs(errors) ** 2)), chdtri(1, _CHANCE) / (2 * errors.size)
    steps = range(1, min(_MOST, errors.size // 8) + 1) if power > 0 else ()
    rho = [float(np.sum(errors[step:] * errors[:-step].conj()).real) / power for step in steps]
    tried = [Autoregression(tuple(rho[:step])) for step in steps]
    beyond = [one for one, step in zip(tried, steps, strict=True) if one.predictor(step)[0][-1] ** 2 > least]
    return beyond[-1] if beyond and rho[0] > _LEAST else WHITE
