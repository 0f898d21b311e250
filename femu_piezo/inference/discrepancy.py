"""What no known effect describes: a smooth function of frequency in log Z and in relative frequency.

    log Z_data = log Z_model + a(f) + b(f) ∂log Z/∂log f + noise

a and b are complex Gaussian processes over log f of one standard deviation σ and one correlation length ℓ: an error of
the impedance, and an error of the frequency (Im: of the loss) of whatever resonates there. Kennedy and O'Hagan (J. R.
Statist. Soc. B 63 (2001) 425) put such a function beside a model so that its errors widen the intervals by themselves.
Each process is the sum of its principal components (Karhunen-Loève); ℓ and σ are learned from the evidence.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from femu_piezo.inference.sweeps import SweepData, stacked

#: Correlation lengths, as shares of the sweep in log f, and standard deviations that compete (equal prior weight each).
_LENGTHS, _SIGMAS = (1 / 4, 1 / 12, 1 / 40), np.geomspace(1e-6, 0.3, 23)
#: Prior probability that a sweep holds something that the model does not describe.
PRIOR = 0.1
#: Share of the largest variance below which a component is left out.
_NEGLIGIBLE = 1e-4


@dataclass(frozen=True)
class Discrepancy:
    """A discrepancy with its learned size.

    Attributes
    ----------
    sigma : standard deviation of a and of b, relative
    length : correlation length as a share of the sweep in log f
    log_evidence : gain over none, averaged over sizes and lengths
    columns : (2k, m) whitened change of the residual by every coefficient at its standard deviation
    """

    sigma: float
    length: float
    log_evidence: float
    columns: np.ndarray

    @property
    def probable(self) -> bool:
        """Whether it is more probable than none."""
        return self.log_evidence > np.log(1 / PRIOR - 1)

    @property
    def factor(self) -> np.ndarray:
        """(2k, 2k) lower Cholesky factor of the covariance of a whitened residual, noise and discrepancy."""
        return np.linalg.cholesky(np.eye(len(self.columns)) + self.columns @ self.columns.T)


def components(log_frequency: np.ndarray, length: float) -> np.ndarray:
    """(k, m) values of the principal components of a process of unit variance at log f (k,), scaled by their σ."""
    low, high = float(log_frequency.min()), float(log_frequency.max())
    at = np.linspace(low, high, int(np.ceil(6 / length)) + 1)
    kernel = np.exp(-0.5 * ((at[:, None] - at) / (length * (high - low))) ** 2)
    values, vectors = np.linalg.eigh(kernel)
    kept = values > _NEGLIGIBLE * values[-1]
    cross = np.exp(-0.5 * ((log_frequency[:, None] - at) / (length * (high - low))) ** 2)
    return cross @ vectors[:, kept] / np.sqrt(values[kept])


def _features(data: SweepData, log_slope: np.ndarray) -> Iterator[tuple[float, np.ndarray]]:
    """Length, and whitened columns (2k, m) of all processes at σ = 1, for every length; each sweep has its own."""
    for length in _LENGTHS:
        blocks = []
        for sweep in data.sweeps:
            own = components(np.log(data.frequency[sweep]), length)
            block = np.zeros((data.impedance.size, 4 * own.shape[1]), dtype=complex)
            moved = own * log_slope[sweep, None]
            block[sweep] = np.hstack([own, 1j * own, moved, 1j * moved]) * data.weight[sweep, None]
            blocks.append(stacked(block))
        yield length, np.hstack(blocks)


def learn_discrepancy(
    data: SweepData, log_slope: np.ndarray, residual: np.ndarray, span: np.ndarray
) -> Discrepancy:
    """The discrepancy that the residual of a fit asks for, all unknowns of the fit marginalised (linear).

    With P = I − Q Qᵗ, Q the span of the unknowns within their priors, the residual r = P r_0 of data and priors and
    columns Φ, G = Φᵗ P Φ = V diag(g) Vᵗ, the evidence over none at the noise level s, τ = (σ/s)², is

        ½ Σ [ (vᵗΦᵗr/s)² τ/(1 + τ g) − log(1 + τ g) ].

    Parameters
    ----------
    log_slope : (k,) complex ∂log Z/∂log f of the model
    residual : (2k + m,) r, whitened, the data first;  span : (2k, n) Q, the rows of the data
    """
    rows, chi_square = len(span), float(residual @ residual)
    found, plain = [], _profiled(chi_square, rows, data.level_std)
    for length, columns in _features(data, log_slope):
        inside = span.T @ columns
        values, vectors = np.linalg.eigh(columns.T @ columns - inside.T @ inside)
        values = np.maximum(values, 0.0)
        along = (vectors.T @ (columns.T @ residual[:rows])) ** 2
        for sigma in _SIGMAS:
            shrunk = sigma**2 / (1 + sigma**2 * values)
            left = chi_square - float(along @ shrunk)
            price = 0.5 * float(np.sum(np.log1p(sigma**2 * values)))
            found.append((_profiled(left, rows, data.level_std) - price - plain, sigma, length))
        if found[-1][2] == max(found)[2]:
            best = columns
    gain = float(logsumexp([item[0] for item in found]) - np.log(len(found)))
    _, sigma, length = max(found)
    return Discrepancy(float(sigma), float(length), gain, sigma * best)


#: Standard deviations of its logarithm below which a noise level is not taken to be.
_FLOOR = 3.0


def noise_level(chi_square: float, freedom: float, level_std: float) -> float:
    """Factor s on the noise: the most probable one, its logarithm known beforehand to `level_std`.

    Maximises −n log s − χ²/(2 s²) + log p(log s). The prior p is Gaussian near 1. Its tail above is that of Cauchy's
    distribution, since a stated noise may be a mere guess; below it ends at −3 level_std, since what was seen between
    neighbours, and the error of the model, is there.
    """
    floor = -_FLOOR * level_std
    found = []
    for level in (0.0, 0.5 * np.log(max(chi_square, 1e-12) / freedom)):
        for _ in range(60):
            pull, hold = chi_square * np.exp(-2 * level), 2 / (2 * level_std**2 + level**2)
            step = (pull - freedom - hold * level) / (2 * pull + hold)
            level = max(level + step, floor)
            if abs(step) < 1e-12 or level == floor:
                break
        found.append((_log_likelihood(level, chi_square, freedom, level_std), level))
    return float(np.exp(max(found)[1]))


def log_level_prior(level: float, level_std: float) -> float:
    """log p of the logarithm of a noise level, up to a constant."""
    return -float(np.log1p(0.5 * (level / level_std) ** 2))


def _log_likelihood(level: float, chi_square: float, freedom: float, level_std: float) -> float:
    return -freedom * level - 0.5 * chi_square * np.exp(-2 * level) + log_level_prior(level, level_std)


def _profiled(chi_square: float, freedom: float, level_std: float) -> float:
    """log likelihood of a χ² at its most probable noise level, up to a constant."""
    level = np.log(noise_level(chi_square, freedom, level_std))
    return float(_log_likelihood(level, chi_square, freedom, level_std))
