"""What a fit leaves unexplained: size and whiteness of residuals, share and bands of the misfit, strain of priors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from femu_piezo.inference.fit import Fit, with_discrepancy

#: Lags of the whiteness test; rate of false alarms of each test.
_LAGS, _LEVEL = 6, 2e-3
#: χ² per degree of freedom below which structure is well below the noise and does not count.
_BELOW = 0.4
#: Number of parts of each sweep whose misfit is judged one by one.
_PARTS = 24


@dataclass(frozen=True)
class Remaining:
    """Tests of the residuals of a fit.

    Attributes
    ----------
    size : χ² / degrees of freedom
    p_size : probability of a χ² as large for a right model and noise; None where the noise was estimated
    p_white : probability of correlations of neighbouring residuals as large, for white noise
    worst_Hz : bands (low, high) whose share of the misfit stands out, worst first
    worst_sweep : number of the sweep of each of these bands
    """

    size: float
    p_size: float | None
    p_white: float
    worst_Hz: tuple[tuple[float, float], ...]
    worst_sweep: tuple[int, ...] = ()

    def of(self, sweep: int) -> Remaining:
        """The same tests, with the worst bands of one sweep alone."""
        own = tuple(band for band, number in zip(self.worst_Hz, self.worst_sweep, strict=True) if number == sweep)
        return replace(self, worst_Hz=own, worst_sweep=(sweep,) * len(own))

    @property
    def correlated(self) -> bool:
        """Whether neighbouring residuals are correlated beyond chance."""
        return self.p_white < _LEVEL

    @property
    def structured(self) -> bool:
        """Whether something is left beyond noise; false alarms at most 0.4 % (tests/diagnosis/test_residuals.py).

        What lies well below the noise (which is never taken to be less than the error of the model) does not count.
        """
        if self.size < _BELOW:
            return False
        return self.correlated or (self.p_size is not None and self.p_size < _LEVEL)


def remaining(
    residual: np.ndarray,
    unknowns: float,
    frequency: np.ndarray,
    noise_known: bool,
    sweeps: list[np.ndarray] | None = None,
) -> Remaining:
    """Judge whitened residuals (2k,), Re then Im, of a fit at frequencies (k,).

    unknowns : number of unknowns that the data determine
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
    """Judge the whitened residuals of a fit."""
    return remaining(fit.residual, fit.determined, fit.data.frequency, fit.data.noise_known, fit.data.sweeps)


def strain_of(fit: Fit) -> float:
    """Probability that parameters of effects lie as far from their prior means as in the fit, for a right model.

    Their distances z, over prior deviations, are then normal of covariance M = I − posterior over prior covariance, so
    zᵗz has the mean tr M and the variance 2 tr M²: as a χ² of (tr M)²/tr M² degrees of freedom times tr M²/tr M
    (Satterthwaite).
    """
    of_effects = slice(fit.parameters.of_material, fit.x.size)
    away, std = fit.further_residual[of_effects], fit.parameters.prior_std[of_effects]
    known = np.eye(away.size) - fit.precision_inverse[of_effects, of_effects] / np.outer(std, std)
    mean, square = np.trace(known), np.sum(known**2)
    if square == 0:
        return 1.0
    return float(chdtrc(mean**2 / square, away @ away * mean / square))


def noise_level_of(final: Fit, significant: float) -> float:
    """Factor on the noise that the fit finds besides a discrepancy, limited to the uncertainty of the noise level.

    A noise estimated from the roughness of the sweep is too low where errors of neighbouring points are correlated.

    significant : standard deviations by which the logarithm of the noise level may be off
    """
    return min(final.noise_scale, float(np.exp(significant * final.data.level_std)))


def unexplained_share(before: Fit, final: Fit, significant: float) -> float:
    """√[(χ²_final − n s²)/(χ²_before − n s²)] within 0…1; 0 where χ²_before is not above n s².

    A right model leaves χ² = n s², n the number of residuals of the data and s the noise level; no χ² counts a
    discrepancy. The result is the larger of two shares. One has χ² of data and priors, since a tolerance that has to be
    off by many of its deviations is as unexplained as data that are. The other has χ² of bands as predicted by fits
    that do not see them (`HeldOut.misfit`), since causes that only imitate the fitted curve go wrong there.
    """
    count = final.residual.size
    by_noise = count * noise_level_of(final, significant) ** 2
    final, before = (with_discrepancy(fit, None) for fit in (final, before))
    fitted = final.chi_square, before.chi_square
    predicted = count * final.held_out.misfit**2, count * before.held_out.misfit**2
    shares = [(after - by_noise) / (whole - by_noise) for after, whole in (fitted, predicted) if whole > by_noise]
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
