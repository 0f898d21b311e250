"""What no known effect describes: a smooth function of frequency in log Z and in relative frequency.

    log Z_data = log Z_model + a(f) + b(f) ∂log Z/∂log f + noise

a and b are complex Gaussian processes over log f of one correlation length ℓ: an error of the impedance, and one of the
frequency (Im: of the loss) of whatever resonates there. Kennedy and O'Hagan (J. R. Statist. Soc. B 63 (2001) 425) put
such a function beside a model so that its errors widen the intervals by themselves. Each process is the sum of its
principal components (Karhunen-Loève).

A sweep knows both by the change of log Z that they make, so σ is the rms of that change over a sweep, and a share w of
σ² is due to b: a has the standard deviation σ √(1 − w), b has σ √w / g with g the rms of |∂log Z/∂log f| (up to Q at a
resonance, about 1 far from it). ℓ, σ and w are learned from the evidence; w may be 0, 1 or, as neither is known to be
the larger, ½.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from scipy.special import logsumexp

from femu_piezo.measurement.sweeps import SweepData, stacked

#: Correlation lengths, as shares of the sweep in log f, and standard deviations that compete (equal prior weight each).
_LENGTHS, _SIGMAS = (1 / 4, 1 / 12, 1 / 40), np.geomspace(1e-6, 0.3, 23)
#: Shares of the variance that errors of frequency have, which compete likewise.
_SHARES = (0.0, 0.5, 1.0)
#: Prior probability that a sweep holds something that the model does not describe.
PRIOR = 0.1
#: Share of the largest variance below which a component is left out.
_NEGLIGIBLE = 1e-4


#: Correlation of a process at distances (…) in correlation lengths.
Kernel = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Discrepancy:
    """A discrepancy with its learned size.

    Attributes
    ----------
    sigma : rms over a sweep of the change of log Z that it makes, at the noise level found with it
    length : correlation length as a share of the sweep in log f
    share : of its variance that is an error of the frequency
    level : factor on the noise found with it
    log_evidence : gain over none, averaged over sizes, lengths and shares
    columns : (2k, m) change by every coefficient at its standard deviation, whitened and over the noise level: a fit
        whose noise has the level s has the discrepancy s² Σ columns columnsᵗ
    """

    sigma: float
    length: float
    share: float
    level: float
    log_evidence: float
    columns: np.ndarray

    @property
    def probable(self) -> bool:
        """Whether it is more probable than none."""
        return self.log_evidence > np.log(1 / PRIOR - 1)

    @property
    def factor(self) -> np.ndarray:
        """(2k, 2k) lower Cholesky factor of the covariance of noise and discrepancy, whitened, over s²."""
        return np.linalg.cholesky(np.eye(len(self.columns)) + self.columns @ self.columns.T)


def squared_exponential(distance: np.ndarray) -> np.ndarray:
    """(k, m) correlation exp(−d²/2) of a process without any roughness, d (k, m) in correlation lengths."""
    return np.exp(-0.5 * distance**2)


def matern(distance: np.ndarray) -> np.ndarray:
    """(k, m) correlation (1 + √3 d) exp(−√3 d) of a process with a slope and no curvature (Matérn, 3/2)."""
    return (1 + np.sqrt(3) * distance) * np.exp(-np.sqrt(3) * distance)


def components(log_frequency: np.ndarray, length: float, kernel: Kernel = squared_exponential) -> np.ndarray:
    """(k, m) values of the principal components of a process of unit variance at log f (k,), scaled by their σ."""
    return _components(np.ascontiguousarray(log_frequency, dtype=float).tobytes(), length, kernel)


@lru_cache(maxsize=32)
def _components(frequencies: bytes, length: float, kernel: Kernel) -> np.ndarray:
    """Of the same, kept: the fits of a sweep ask for them again and again."""
    log_frequency = np.frombuffer(frequencies)
    low, high = float(log_frequency.min()), float(log_frequency.max())
    at = np.linspace(low, high, int(np.ceil(6 / length)) + 1)
    scale = length * (high - low)
    values, vectors = np.linalg.eigh(kernel(np.abs(at[:, None] - at) / scale))
    kept = values > _NEGLIGIBLE * values[-1]
    return kernel(np.abs(log_frequency[:, None] - at) / scale) @ vectors[:, kept] / np.sqrt(values[kept])


def _features(
    data: SweepData, log_slope: np.ndarray, lengths: Sequence[float], shares: Sequence[float], kernel: Kernel
) -> Iterator[tuple[float, float, np.ndarray]]:
    """ℓ, w and whitened columns (2k, m) of both processes at σ = 1, for every ℓ and w; each sweep has its own."""
    for length, share in product(lengths, shares):
        blocks = []
        for sweep in data.sweeps:
            own, slope = components(np.log(data.frequency[sweep]), length, kernel), log_slope[sweep, None]
            steep = np.sqrt(np.mean(np.abs(slope) ** 2)) or 1.0
            parts = [np.sqrt(1 - share) * own] if share < 1 else []
            parts += [np.sqrt(share) / steep * own * slope] if share > 0 else []
            block = np.zeros((data.impedance.size, 2 * sum(part.shape[1] for part in parts)), dtype=complex)
            block[sweep] = np.hstack([turn * part for part in parts for turn in (1, 1j)])
            blocks.append(stacked(data.over_noise(block)))
        yield length, share, np.hstack(blocks)


def learn_discrepancy(
    data: SweepData,
    log_slope: np.ndarray,
    residual: np.ndarray,
    span: np.ndarray,
    weight: np.ndarray | float = 1.0,
    lengths: Sequence[float] = _LENGTHS,
    shares: Sequence[float] = _SHARES,
    kernel: Kernel = squared_exponential,
) -> Discrepancy:
    """The discrepancy that the residual of a fit asks for, all unknowns of the fit marginalised (linear).

    With P = I − Q Qᵗ, Q the span of the unknowns within their priors, the residual r = P r_0 of data and priors and
    columns Φ, G = Φᵗ P Φ = V diag(g) Vᵗ, the evidence over none at the noise level s, τ = (σ/s)², is

        ½ Σ [ (vᵗΦᵗr/s)² τ/(1 + τ g) − log(1 + τ g) ].

    Parameters
    ----------
    log_slope : (k,) complex ∂log Z/∂log f of the model
    residual : (2k + m,) r, whitened, the data first;  span : (2k, n) Q, the rows of the data
    weight : (2k,) that a robust loss gives the readings, in squares of residual and span
    lengths : correlation lengths that compete, as shares of the sweep in log f
    shares : of the variance that errors of frequency have, which compete
    kernel : correlation over the distance in correlation lengths
    """
    rows, chi_square = len(span), float(residual @ residual)
    found, plain = [], profiled(chi_square, rows, data.level_std)
    best = (-np.inf,)
    for length, share, columns in _features(data, log_slope, lengths, shares, kernel):
        columns = columns * np.reshape(np.sqrt(weight), (-1, 1))
        inside = span.T @ columns
        values, vectors = np.linalg.eigh(columns.T @ columns - inside.T @ inside)
        values = np.maximum(values, 0.0)
        along = (vectors.T @ (columns.T @ residual[:rows])) ** 2
        grown = 1 + _SIGMAS[:, None] ** 2 * values
        left = chi_square - (_SIGMAS[:, None] ** 2 / grown) @ along
        gains = profiled(left, rows, data.level_std) - 0.5 * np.sum(np.log(grown), axis=1) - plain
        found.append(gains)
        most = int(np.argmax(gains))
        if gains[most] > best[0]:
            best = gains[most], left[most], _SIGMAS[most], length, share, columns
    gain = float(logsumexp(found) - np.log(np.size(found)))
    _, left, size, length, share, columns = best
    level = float(noise_level(left, rows, data.level_std))
    return Discrepancy(float(size * level), length, share, level, gain, size * columns)


#: Standard deviations of its logarithm below which a noise level is not taken to be.
_FLOOR = 3.0


def noise_level(chi_square: np.ndarray | float, freedom: float, level_std: float) -> np.ndarray | float:
    """Factor s on the noise: the most probable one, its logarithm known beforehand to `level_std`.

    chi_square : one, or (m,), each of which has its own factor

    Maximises −n log s − χ²/(2 s²) + log p(log s). The prior p is Gaussian near 1. Its tail above is that of Cauchy's
    distribution, since a stated noise may be a mere guess; below it ends at −3 level_std, since what was seen between
    neighbours, and the error of the model, is there.
    """
    given, floor = np.asarray(chi_square, dtype=float), -_FLOOR * level_std
    level = np.stack([np.zeros_like(given), 0.5 * np.log(np.maximum(given, 1e-12) / freedom)])
    for _ in range(60):
        pull, hold = given * np.exp(-2 * level), 2 / (2 * level_std**2 + level**2)
        old, level = level, np.maximum(level + (pull - freedom - hold * level) / (2 * pull + hold), floor)
        if np.max(np.abs(level - old)) < 1e-12:
            break
    first, second = (_log_likelihood(one, given, freedom, level_std) for one in level)
    return np.exp(np.where(first > second, *level))[()]


def log_level_prior(level: np.ndarray | float, level_std: float) -> np.ndarray | float:
    """log p of the logarithm of a noise level (one, or an array (m,) of them), up to a constant."""
    return -np.log1p(0.5 * (level / level_std) ** 2)


def _log_likelihood(level, chi_square, freedom: float, level_std: float):
    return -freedom * level - 0.5 * chi_square * np.exp(-2 * level) + log_level_prior(level, level_std)


def profiled(chi_square: np.ndarray | float, freedom: float, level_std: float) -> np.ndarray | float:
    """log likelihood of χ² (one, or (m,)) at its most probable noise level, up to a constant."""
    level = np.log(noise_level(chi_square, freedom, level_std))
    return _log_likelihood(level, chi_square, freedom, level_std)
