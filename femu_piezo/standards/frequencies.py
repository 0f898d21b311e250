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
from scipy.optimize import brentq

Admittance = Callable[[np.ndarray], np.ndarray]
#: A real quantity (…) of an admittance (…), such as its conductance.
Part = Callable[[np.ndarray], np.ndarray]
#: Window about a pole or zero in which extrema are looked for: its reach to either side, in bandwidths, and its points.
#: Subdivision, in shares, of the interval that holds a maximum, and length of the last interval, in bandwidths: a
#: maximum is known to the root of the rounding of the compared values.
_REACH, _POINTS, _CLOSER, _CLOSE = 1.5, 301, np.linspace(0, 1, 33), 2e-9


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
    curve = _Curve(admittance)
    series = _Window.around(curve, pole, band, (0.0, middle))
    parallel = _Window.around(curve, zero, band, (middle, np.inf))
    fs, fm = curve.maxima(series, [_conductance, np.abs])
    fp, fn = curve.maxima(parallel, [_resistance, _magnitude])
    found = {"fs": fs, "fp": fp, "fm": fm, "fn": fn}
    found |= {"fr": curve.resonance(series, fs), "fa": curve.resonance(parallel, fp)}
    found["Q_series"] = curve.quality(series, _conductance, fs)
    found["Q_parallel"] = curve.quality(parallel, _resistance, fp)
    return CharacteristicFrequencies(**found, Z_series=None if fm is None else float(_magnitude(curve.at(fm))))


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
    """A band about a pole or a zero: its bandwidth, Hz; frequencies (n,) over it, Hz; Y (n,) there. n may be 0."""

    width: float
    grid: np.ndarray
    values: np.ndarray

    @classmethod
    def around(cls, curve: _Curve, value: complex, band: tuple[float, float], limits: tuple[float, float]) -> _Window:
        frequency = float(np.sqrt(value.real) / (2 * np.pi))
        width = max(float(value.imag / value.real), 1e-9) * frequency
        low = max(frequency - _REACH * width, band[0], limits[0])
        high = min(frequency + _REACH * width, band[1], limits[1])
        grid = np.linspace(low, high, _POINTS if low < high else 0)
        return cls(width, grid, curve.at(grid))


@dataclass(frozen=True)
class _Curve:
    """An admittance, evaluated at many points at once, which costs hardly more than at one."""

    admittance: Admittance

    def at(self, frequency: np.ndarray | float) -> np.ndarray:
        """Y (…), siemens, at frequencies (…), Hz."""
        given = np.asarray(frequency, dtype=float)
        return self.admittance(2 * np.pi * given.ravel()).reshape(given.shape) if given.size else given.astype(complex)

    def maxima(self, window: _Window, parts: list[Part]) -> list[float | None]:
        """Frequency, Hz, at which each part is largest; None where that is an end of the window."""
        if not window.grid.size:
            return [None] * len(parts)
        grid, best = window.grid, np.array([np.argmax(part(window.values)) for part in parts])
        inside = (best > 0) & (best < grid.size - 1)
        best, every = best.clip(1, grid.size - 2), np.arange(len(parts))
        # offsets from a point of the grid resolve more finely than frequencies
        low, high = grid[best - 1] - grid[best], grid[best + 1] - grid[best]
        while np.max(high - low) > _CLOSE * window.width:
            steps = low[:, None] + (high - low)[:, None] * _CLOSER
            values = self.at(grid[best, None] + steps)
            top = np.array([np.argmax(part(row)) for part, row in zip(parts, values, strict=True)])
            low, high = steps[every, np.maximum(top - 1, 0)], steps[every, np.minimum(top + 1, _CLOSER.size - 1)]
        found = grid[best] + (low + high) / 2
        return [float(one) if ok else None for one, ok in zip(found, inside, strict=True)]

    def resonance(self, window: _Window, near: float | None) -> float | None:
        """Frequency, Hz, nearest to `near` at which the reactance is zero; None where it is not zero in the window."""
        if near is None:
            return None
        at = _changes(_reactance(window.values))
        if not at.size:
            return None
        nearest = at[np.argmin(np.abs(window.grid[at] - near))]
        return self._crossing(window, _reactance, nearest, 0.0)

    def quality(self, window: _Window, part: Part, peak: float | None) -> float | None:
        """Frequency of the peak over its width at half height; None where the window holds only a part of it."""
        if peak is None:
            return None
        half = float(part(self.at(peak))) / 2
        at = _changes(part(window.values) - half)
        below, above = at[window.grid[at] < peak], at[window.grid[at] >= peak]
        if not below.size or not above.size:
            return None
        low, high = (self._crossing(window, part, after, half) for after in (below[-1], above[0]))
        return peak / (high - low)

    def _crossing(self, window: _Window, part: Part, after: int, value: float) -> float:
        """Frequency, Hz, at which a part takes `value`, between the point `after` of the window and the next."""
        return float(brentq(lambda f: float(part(self.at(f))) - value, *window.grid[after : after + 2], rtol=1e-14))


def _changes(values: np.ndarray) -> np.ndarray:
    """Indices of the values (n,) behind which the sign changes."""
    return np.flatnonzero(np.diff(values > 0))
