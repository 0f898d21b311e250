"""Is anything left? Size and whiteness of whitened residuals, its share and place in frequency, strain of priors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from femu_piezo.inference.fit import Fit, with_discrepancy

#: Lags of the whiteness test; share of false alarms that each test accepts.
_LAGS, _LEVEL = 6, 2e-3
#: χ² per degree of freedom below which structure is below the noise.
_BELOW = 0.4
#: Parts of the sweep that are judged one by one.
_PARTS = 24


@dataclass(frozen=True)
class Remaining:
    """What a fit leaves over.

    Attributes
    ----------
    size : χ² / degrees of freedom
    p_size : probability of a χ² as large for a right model and noise; None where the noise was estimated
    p_white : the same for the correlation of neighbours
    worst_Hz : bands (low, high) whose share of the misfit stands out, worst first
    worst_sweep : number of the sweep that each of them lies in
    """

    size: float
    p_size: float | None
    p_white: float
    worst_Hz: tuple[tuple[float, float], ...]
    worst_sweep: tuple[int, ...] = ()

    def of(self, sweep: int) -> Remaining:
        """The same with the bands of one sweep alone."""
        own = tuple(band for band, number in zip(self.worst_Hz, self.worst_sweep, strict=True) if number == sweep)
        return replace(self, worst_Hz=own, worst_sweep=(sweep,) * len(own))

    @property
    def alike(self) -> bool:
        """Whether neighbours are alike beyond chance."""
        return self.p_white < _LEVEL

    @property
    def structured(self) -> bool:
        """Whether something is left beyond noise; false alarms at most 0.4 % (tests/diagnosis/test_residuals.py).

        What lies well below the noise (which is never taken to be less than the error of the model) does not count.
        """
        if self.size < _BELOW:
            return False
        return self.alike or (self.p_size is not None and self.p_size < _LEVEL)


def remaining(
    residual: np.ndarray,
    unknowns: float,
    frequency: np.ndarray,
    noise_known: bool,
    sweeps: list[np.ndarray] | None = None,
) -> Remaining:
    """Judge whitened residuals (2k,), Re then Im, of a fit with so many unknowns at frequencies (k,).

    sweeps : indices of the points of each sweep, where there are several
    """
    freedom = residual.size - unknowns
    square = float(residual @ residual)
    sweeps = sweeps or [np.arange(frequency.size)]
    worst = _worst(residual, frequency, square / freedom, sweeps)
    return Remaining(
        size=square / freedom,
        p_size=float(chdtrc(freedom, square)) if noise_known else None,
        p_white=whiteness(residual, sweeps),
        worst_Hz=tuple(band for _, _, band in worst),
        worst_sweep=tuple(number for _, number, _ in worst),
    )


def remaining_of(fit: Fit) -> Remaining:
    """Judge what a fit leaves over, in the sweeps that it is of."""
    return remaining(fit.residual, fit.determined, fit.data.frequency, fit.data.noise_known, fit.data.sweeps)


def strain_of(fit: Fit) -> float:
    """Probability that tolerances are found as far from their means, for right ones.

    z, over their deviations, is then normal of covariance M = I − posterior over prior covariance, so zᵗz has the mean
    tr M and the variance 2 tr M²: as a χ² of (tr M)²/tr M² degrees of freedom times tr M²/tr M (Satterthwaite).
    """
    own = slice(fit.parameters.of_material, fit.x.size)
    away, std = fit.further_residual[own], fit.parameters.prior_std[own]
    known = np.eye(away.size) - fit.precision_inverse[own, own] / np.outer(std, std)
    mean, square = np.trace(known), np.sum(known**2)
    if square == 0:
        return 1.0
    return float(chdtrc(mean**2 / square, away @ away * mean / square))


def noise_level_of(final: Fit, significant: float) -> float:
    """Factor on the noise that is left beside the discrepancy, as far as the noise is uncertain.

    An estimate from the roughness of the sweep is too low where neighbours err alike.

    significant : deviations of its logarithm by which a noise level may be off
    """
    return min(final.noise_scale, float(np.exp(significant * final.data.level_std)))


def unexplained_share(before: Fit, final: Fit, significant: float) -> float:
    """√[(χ²_final − n s²)/(χ²_before − n s²)] within 0…1; 0 where nothing was in excess before.

    A right model leaves n s² of it, n the residuals of the data and s the level of the noise. The larger one of two
    shares: with χ² of data and priors, since a tolerance that has to be off by many of its deviations is as unexplained
    as data that are; and with χ² of bands as predicted by fits that do not see them (`Fit.left_out_misfit`), since
    causes that only imitate the curve they were fitted to go wrong there.
    """
    count = final.residual.size
    by_noise = count * noise_level_of(final, significant) ** 2
    final, before = (with_discrepancy(fit, None) for fit in (final, before))
    fitted = final.chi_square, before.chi_square
    predicted = count * final.left_out_misfit**2, count * before.left_out_misfit**2
    shares = [(left - by_noise) / (whole - by_noise) for left, whole in (fitted, predicted) if whole > by_noise]
    return float(np.sqrt(np.clip(max(shares, default=0.0), 0.0, 1.0)))


def whiteness(residual: np.ndarray, sweeps: list[np.ndarray] | None = None) -> float:
    """Ljung-Box probability of the correlations of neighbours in Re and Im, lags 1 to 6; needs no noise level."""
    k = residual.size // 2
    sweeps = sweeps or [np.arange(k)]
    total = 0.0
    for part in (values[points] for values in (residual[:k], residual[k:]) for points in sweeps):
        power = np.sum(part**2)
        for lag in range(1, _LAGS + 1):
            correlation = np.sum(part[lag:] * part[:-lag]) / power
            total += part.size * (part.size + 2) / (part.size - lag) * correlation**2
    return float(chdtrc(2 * _LAGS * len(sweeps), total))


def _worst(
    residual: np.ndarray, frequency: np.ndarray, size: float, sweeps: list[np.ndarray]
) -> list[tuple[float, int, tuple[float, float]]]:
    """(excess, sweep, band) with more misfit than chance gives (1 in 1000 each), worst first; for σ² = min(1, size)."""
    k = residual.size // 2
    power = (residual[:k] ** 2 + residual[k:] ** 2) / min(1.0, size)
    found = []
    for number, sweep in enumerate(sweeps):
        for points in np.array_split(sweep, min(_PARTS, sweep.size)):
            excess = float(np.sum(power[points]))
            if chdtrc(2 * points.size, excess) < 1e-3:
                band = (float(frequency[points[0]]), float(frequency[points[-1]]))
                found.append((excess - 2 * points.size, number, band))
    return sorted(found, reverse=True)
