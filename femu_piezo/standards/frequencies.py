"""The characteristic frequencies of a resonance by their definitions, from a smooth curve of its admittance.

IEEE Std 176-1987, section 6, and EN 50324-2 (after IEC 60483):

- fs: maximum of the conductance G, fp: maximum of the resistance R;
- fm: maximum of |Y|, fn: maximum of |Z|;
- fr, fa: resonance and antiresonance, where the reactance is zero beside fs and beside fp.

Without loss fm = fs = fr and fa = fp = fn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

Admittance = Callable[[np.ndarray], np.ndarray]
#: A real quantity (…) of an admittance (…), such as its conductance.
Part = Callable[[np.ndarray], np.ndarray]
#: Window about a pole or zero: its reach to either side, in bandwidths, and its points. About one of them a curve is a
#: polynomial through it and so many points on either side, to 1e-13: its singularities are half a bandwidth away.
_REACH, _POINTS, _BESIDE = 1.5, 301, 4
#: Exponents of t in this polynomial, and its coefficients over the values at t = −4 … 4.
_EXPONENTS = np.arange(2.0 * _BESIDE + 1)
_COEFFICIENTS = np.linalg.inv(np.vander(_EXPONENTS - _BESIDE, increasing=True))
#: Newton steps to an extremum or a crossing, of which the curve between three points is almost a parabola.
_NEWTON = 4


@dataclass(frozen=True)
class CharacteristicFrequencies:
    """Characteristic frequencies of one pole and its zero, Hz; None where the curve has no such point near them.

    Attributes
    ----------
    fs, fp : of largest G and of largest R;  fm, fn : of largest |Y| and of largest |Z|
    fr, fa : of zero reactance, the lower and the upper one
    Q_series, Q_parallel : 3 dB: fs over the width of G at half its maximum, fp over that of R
    Z_series : |Z| at fm, ohm
    """

    fs: float | None
    fp: float | None
    fm: float | None
    fn: float | None
    fr: float | None
    fa: float | None
    Q_series: float | None
    Q_parallel: float | None
    Z_series: float | None

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """The names of the six frequencies."""
        return tuple(field.name for field in fields(cls))[:6]


def characteristic_frequencies(
    admittance: Admittance, pole: complex, zero: complex, band: tuple[float, float]
) -> CharacteristicFrequencies:
    """The frequencies and 3 dB quality factors of one pole and its zero.

    Parameters
    ----------
    admittance : Y (n,) in siemens at ω (n,) in rad/s, smooth (a fitted or computed curve, not noisy points)
    pole, zero : λ, rad²/s²
    band : lowest and highest frequency where the curve is known, Hz
    """
    middle = float(np.sqrt(np.sqrt(pole.real * zero.real)) / (2 * np.pi))
    series = _Window.around(admittance, pole, band, (0.0, middle))
    parallel = _Window.around(admittance, zero, band, (middle, np.inf))
    fs, fm = (series.maximum(part) for part in (_conductance, np.abs))
    fp, fn = (parallel.maximum(part) for part in (_resistance, _magnitude))
    found = {"fs": fs, "fp": fp, "fm": fm, "fn": fn}
    found |= {"fr": series.resonance(fs), "fa": parallel.resonance(fp)}
    found |= {"Q_series": series.quality(_conductance, fs), "Q_parallel": parallel.quality(_resistance, fp)}
    return CharacteristicFrequencies(**found, Z_series=None if fm is None else series.at(fm, _magnitude))


def _conductance(y: np.ndarray) -> np.ndarray:
    return y.real


def _resistance(y: np.ndarray) -> np.ndarray:
    return (1 / y).real


def _magnitude(y: np.ndarray) -> np.ndarray:
    """|Z|."""
    return 1 / np.abs(y)


def _reactance(y: np.ndarray) -> np.ndarray:
    return (1 / y).imag


@dataclass(frozen=True)
class _Window:
    """An admittance in a band about a pole or a zero: evenly spaced frequencies (n,), Hz; Y (n,) there. n may be 0."""

    grid: np.ndarray
    values: np.ndarray

    @classmethod
    def around(
        cls, admittance: Admittance, value: complex, band: tuple[float, float], limits: tuple[float, float]
    ) -> _Window:
        frequency = float(np.sqrt(value.real) / (2 * np.pi))
        width = max(float(value.imag / value.real), 1e-9) * frequency
        low = max(frequency - _REACH * width, band[0], limits[0])
        high = min(frequency + _REACH * width, band[1], limits[1])
        grid = np.linspace(low, high, _POINTS if low < high else 0)
        return cls(grid, admittance(2 * np.pi * grid))

    def maximum(self, part: Part) -> float | None:
        """Frequency, Hz, at which a part is largest; None where that is an end of the window."""
        if not self.grid.size:
            return None
        best = int(np.argmax(part(self.values)))
        if not 0 < best < self.grid.size - 1:
            return None
        middle, coefficients = self._near(best, part)
        return self._root(middle, _EXPONENTS[1:] * coefficients[1:], best)

    def resonance(self, near: float | None) -> float | None:
        """Frequency, Hz, nearest to `near` at which the reactance is zero; None where it is not zero in the window."""
        if near is None:
            return None
        at = _changes(_reactance(self.values))
        if not at.size:
            return None
        return self._crossing(_reactance, int(at[np.argmin(np.abs(self.grid[at] - near))]), 0.0)

    def quality(self, part: Part, peak: float | None) -> float | None:
        """Frequency of the peak over its width at half height; None where the window holds only a part of it."""
        if peak is None:
            return None
        half = self.at(peak, part) / 2
        at = _changes(part(self.values) - half)
        below, above = at[self.grid[at] < peak], at[self.grid[at] >= peak]
        if not below.size or not above.size:
            return None
        low, high = (self._crossing(part, int(after), half) for after in (below[-1], above[0]))
        return peak / (high - low)

    def at(self, frequency: float, part: Part) -> float:
        """A part at a frequency of the window, Hz."""
        place = (frequency - self.grid[0]) / self._step
        middle, coefficients = self._near(int(np.rint(place)), part)
        return float(coefficients @ (place - middle) ** _EXPONENTS)

    def _crossing(self, part: Part, after: int, value: float) -> float:
        """Frequency, Hz, at which a part takes `value`, between the point `after` of the window and the next."""
        middle, coefficients = self._near(after, part)
        coefficients[0] -= value
        return self._root(middle, coefficients, after + 0.5)

    def _near(self, point: int, part: Part) -> tuple[int, np.ndarray]:
        """A part near a point as a polynomial in the steps of the window from another: this point, coefficients."""
        middle = int(np.clip(point, _BESIDE, self.grid.size - 1 - _BESIDE))
        return middle, _COEFFICIENTS @ part(self.values[middle - _BESIDE : middle + _BESIDE + 1])

    def _root(self, middle: int, coefficients: np.ndarray, near: float) -> float:
        """Frequency, Hz, of the root next to a place, in steps of the window, of such a polynomial, by Newton steps."""
        at, falling = near - middle, coefficients[::-1].tolist()
        for _ in range(_NEWTON):
            value = slope = 0.0
            for coefficient in falling:  # Horner's rule
                value, slope = value * at + coefficient, slope * at + value
            if not slope:
                break
            at -= min(max(value / slope, -0.5), 0.5)
        return float(self.grid[0] + self._step * (middle + at))

    @property
    def _step(self) -> float:
        return float(np.ptp(self.grid) / (self.grid.size - 1))


def _changes(values: np.ndarray) -> np.ndarray:
    """Indices of the values (n,) behind which the sign changes."""
    return np.flatnonzero(np.diff(values > 0))
