"""Which points to measure next: an update by the points so far, linearised about its solution.

Far from its resonance a mode of coupling k² changes Z by k² f/(2 |f − f0|), whatever its Q: it is seen by its tail. In
the middle of a gap Δ between two points it moves both by k² f/Δ. Points that depart from their neighbours by more than
`DEPARTS` times the noise are looked at closely, so that no mode above k² = `DEPARTS` √1.5 σ Δ/f is missed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from femu_piezo.inference.design import (
    Explanation,
    covariance_after,
    misfit_after_refit,
    most_informative,
    most_separating,
)
from femu_piezo.inference.fit import Fit
from femu_piezo.measurement.segments import RESOLUTION
from femu_piezo.study.expectation import labels_of
from femu_piezo.study.plan import candidate_frequencies, resonances_of
from femu_piezo.study.posterior import Posterior
from femu_piezo.threads import made_once

#: Multiple of the noise from which the error of a point against the model departs from that of its neighbours; by
#: chance with a probability of exp(−16) for one point.
DEPARTS = 4.0
#: How many times sharper than the sharpest mode of the model a further mode may be.
_SHARPER = 4.0
#: Points of the curve that is shown.
_SHOWN = 1001


class Linearised:
    """An update of one sweep, linearised about its solution.

    Attributes
    ----------
    covariance : (n_x, n_x) of the unknowns in prior standard deviations, with everything that the update counts
    """

    def __init__(self, posterior: Posterior, found: Fit, reach: float) -> None:
        self._posterior, self._found, self._reach = posterior, found, reach
        self._labels = labels_of(found.parameters.material)
        self._evaluation, self._unknowns, _ = posterior.whole_sweep(0, found)
        self._frequency = posterior.several[0].measured.fitted.frequency
        self._impedance = posterior.several[0].measured.fitted.impedance
        self._scale = found.parameters.prior_std
        self.covariance = found.covariance / np.outer(self._scale, self._scale)
        self._noise = found.data.relative_noise * min(1.0, found.level)  # a level above 1 is misfit, not noise
        self._resonances = resonances_of(self._evaluation, self._unknowns, found.x)

    def relative(self, std: np.ndarray) -> dict[str, float]:
        """Label → deviation, relative of constants, absolute of tangents; from (n_x,) in prior standard deviations."""
        found = {}
        for label, (column, size) in self._labels.items():
            deviation = std[column] * self._scale[column] * size
            found[label] = float(deviation if label.startswith("tan_") else deviation / abs(self._value(label)))
        return found

    def _value(self, label: str) -> float:
        material = self._found.parameters.material
        return getattr(material.constants(self._found.x[: self._found.parameters.of_material]), label).real

    def curve(self, band: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
        """The model over the band and at every point: Hz (m,), ohm (m,)."""
        frequency = np.union1d(np.linspace(*band, _SHOWN), candidate_frequencies(self._resonances, *band))
        return frequency, self._at(frequency)[0]

    def _at(self, frequency: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return replace(self._evaluation, omega=2 * np.pi * frequency).with_jacobian(self._unknowns, self._found.x)

    def most_informative(
        self, band: tuple[float, float], asked: list[str], count: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """`count` frequencies, Hz, that tell most of `asked`, and the deviations (n_x,) with them, over the priors'."""
        candidates = self._candidates(band)
        rows = self._rows(self._found, candidates)[0]
        wanted = np.array([self._labels[name][0] for name in asked])
        places = most_informative(rows, self.covariance, wanted, count)
        after = covariance_after(self.covariance, rows[places].reshape(-1, self._scale.size))
        return candidates[places], np.sqrt(np.diag(after))

    def most_separating(self, band: tuple[float, float], two: tuple[Fit, Fit], count: int) -> tuple[np.ndarray, float]:
        """`count` frequencies, Hz, that tell two fits apart; log odds expected from all candidates of the band."""
        candidates = self._candidates(band)
        explanations, apart = self._explanations(two, candidates)
        places = most_separating(explanations, apart, count)
        return candidates[places], _expected(explanations, apart)

    def separation(self, two: tuple[Fit, Fit], frequency: np.ndarray) -> float:
        """Log odds expected from points at frequencies (k,), Hz; the mean of those with either fit being right."""
        return _expected(*self._explanations(two, frequency))

    def _explanations(self, two: tuple[Fit, Fit], frequency: np.ndarray) -> tuple[list[Explanation], np.ndarray]:
        """Whitened slopes and covariance of each fit, and the whitened difference (k, 2) of the log Z they predict."""
        (first, first_z), (second, second_z) = (self._rows(fit, frequency) for fit in two)
        apart = np.log(first_z / second_z) * self._weight
        scales = [np.outer(fit.parameters.prior_std, fit.parameters.prior_std) for fit in two]
        covariances = [fit.covariance / scale for fit, scale in zip(two, scales, strict=True)]
        found = list(zip((first, second), covariances, strict=True))
        return found, np.stack([apart.real, apart.imag], axis=1)

    def _candidates(self, band: tuple[float, float]) -> np.ndarray:
        """Frequencies (k,), Hz, to choose from, without those measured already."""
        candidates = candidate_frequencies(self._resonances, *band)
        place = np.searchsorted(self._frequency, candidates).clip(1, self._frequency.size - 1)
        near = np.minimum(np.abs(candidates - self._frequency[place]), np.abs(candidates - self._frequency[place - 1]))
        return candidates[near > RESOLUTION]

    @made_once
    def _weight(self) -> float:
        return float(np.sqrt(2) / np.median(self._noise))

    def _rows(self, found: Fit, frequency: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Whitened slopes (k, 2, n_x) of a fit in units of its priors, and its Z (k,), ohm."""
        evaluation, unknowns, _ = self._posterior.whole_sweep(0, found)
        z, slopes = replace(evaluation, omega=2 * np.pi * frequency).with_jacobian(unknowns, found.x)
        white = slopes / z[:, None] * found.parameters.prior_std * self._weight
        return np.stack([white.real, white.imag], axis=1), z

    @made_once
    def _log_error(self) -> np.ndarray:
        """(k,) complex log Z measured less log Z of the model."""
        return np.log(self._impedance / self._at(self._frequency)[0])

    @made_once
    def _departing(self) -> np.ndarray:
        """(k,) bool: points whose error against the model departs from that of their neighbours.

        Neighbours are the nearest points, since a mode between two points moves these alone; and points half a gap of
        the watching points away, since a mode that has been measured closely is smooth from point to point.
        """
        return self._departing_from(0.0) | self._departing_from(self._reach)

    def _departing_from(self, reach: float) -> np.ndarray:
        """(k,) bool by comparison with the nearest points more than `reach`, Hz, away on either side."""
        f, error, noise = self._frequency, self._log_error, self._noise
        before = np.searchsorted(f, f - reach, side="left") - 1
        behind = np.searchsorted(f, f + reach, side="right")
        inner, found = np.flatnonzero((before >= 0) & (behind < f.size)), np.zeros(f.size, dtype=bool)
        if not inner.size:
            return found
        before, behind = before[inner], behind[inner]
        share = (f[inner] - f[before]) / (f[behind] - f[before])
        apart = error[inner] - (1 - share) * error[before] - share * error[behind]
        sigma = np.sqrt(noise[inner] ** 2 + ((1 - share) * noise[before]) ** 2 + (share * noise[behind]) ** 2)
        times = np.abs(apart) / sigma
        usual = max(1.0, _median_over(np.gradient(f)[inner], times) / np.sqrt(np.log(2)))
        found[inner] = times > DEPARTS * usual
        return found

    def next_to_departures(self, count: int) -> np.ndarray:
        """At most `count` frequencies, Hz, next to departing points, where the error against the model changes most.

        Intervals are divided until they are shorter than half the width of the sharpest mode that is looked for.
        """
        departing = self._departing
        change = np.abs(np.diff(self._log_error)) * (departing[1:] | departing[:-1])
        change[change < DEPARTS * np.hypot(self._noise[1:], self._noise[:-1])] = 0.0
        sharpest = np.min(np.abs(self._resonances.imag / self._resonances.real)) / _SHARPER
        return dividing_points(self._frequency, change, count, sharpest / 4 * self._frequency[1:])

    def departures(self) -> tuple[float, ...]:
        """Of every run of departing points, the frequency of the one with the largest error, Hz."""
        places = np.flatnonzero(self._departing)
        runs = np.split(places, np.flatnonzero(np.diff(places) > 2) + 1) if places.size else []
        error = np.abs(self._log_error)
        return tuple(float(self._frequency[run[np.argmax(error[run])]]) for run in runs)

    def least_coupling(self) -> float:
        """Least k_eff of a mode that is sure to show in the widest relative gap above half the lowest resonance."""
        lowest = np.sqrt(np.min(self._resonances.real)) / (2 * np.pi)
        above = self._frequency[1:] > lowest / 2
        gap = np.max((np.diff(self._frequency) / self._frequency[1:])[above])
        return float(np.sqrt(DEPARTS * np.sqrt(1.5) * np.median(self._noise) * gap))


def _median_over(widths: np.ndarray, values: np.ndarray) -> float:
    """Median of values (n,) weighted by the widths of band they stand for: crowded points count no more."""
    return float(np.quantile(values, 0.5, weights=widths, method="inverted_cdf"))


def _expected(explanations: Sequence[Explanation], apart: np.ndarray) -> float:
    """Half the χ² that one explanation leaves of what the other predicts, after a refit; mean of both directions."""
    errors = apart.ravel()
    left = [misfit_after_refit(rows.reshape(apart.size, -1), covariance, errors) for rows, covariance in explanations]
    return float(np.mean(left)) / 2


def dividing_points(
    frequency: np.ndarray, change: np.ndarray, count: int, least: np.ndarray | float = 0.0
) -> np.ndarray:
    """At most `count` points that divide intervals of frequencies (n,) equally, so that the largest change is small.

    change : (n − 1,) over each interval; an interval without any change gets no point
    least : least width of a part
    """
    width, inside = np.diff(frequency), np.zeros(change.size, dtype=int)
    for _ in range(count):
        of_part = np.where(width / (inside + 2) >= least, change / (inside + 1), 0.0)
        best = int(np.argmax(of_part))
        if of_part[best] <= 0:
            break
        inside[best] += 1
    parts = [
        frequency[place] + width[place] * np.arange(1, inside[place] + 1) / (inside[place] + 1)
        for place in np.flatnonzero(inside)
    ]
    return np.concatenate(parts or [np.zeros(0)])
