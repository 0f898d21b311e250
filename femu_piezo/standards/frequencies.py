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
#: Bandwidths to either side of a pole or zero in which its extrema are looked for, points there, and points between two
#: of them each time that a maximum is looked at more closely.
_REACH, _POINTS, _CLOSER = 1.5, 301, 33


@dataclass(frozen=True)
class CharacteristicFrequencies:
    """Of one pole and its zero, Hz; None where the curve has no such extremum or crossing beside them.

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
    series = _Window.around(pole, band, (0.0, middle))
    parallel = _Window.around(zero, band, (middle, np.inf))

    def y(frequency):
        return admittance(2 * np.pi * np.atleast_1d(np.asarray(frequency, dtype=float)))

    def z(frequency):
        return 1 / y(frequency)

    fs, fp = series.maximum(lambda f: y(f).real), parallel.maximum(lambda f: z(f).real)
    fm = series.maximum(lambda f: np.abs(y(f)))
    return CharacteristicFrequencies(
        fs=fs,
        fp=fp,
        fm=fm,
        fn=parallel.maximum(lambda f: np.abs(z(f))),
        fr=series.crossing(lambda f: z(f).imag, fs),
        fa=parallel.crossing(lambda f: z(f).imag, fp),
        Q_series=series.quality(lambda f: y(f).real, fs),
        Q_parallel=parallel.quality(lambda f: z(f).real, fp),
        Z_series=None if fm is None else float(np.abs(z(fm))[0]),
    )


@dataclass(frozen=True)
class _Window:
    """A band about a pole or a zero, Hz, and its bandwidth."""

    low: float
    high: float
    width: float

    @classmethod
    def around(cls, value: complex, band: tuple[float, float], limits: tuple[float, float]) -> _Window:
        frequency = float(np.sqrt(value.real) / (2 * np.pi))
        width = max(float(value.imag / value.real), 1e-9) * frequency
        low, high = max(band[0], limits[0]), min(band[1], limits[1])
        return cls(max(frequency - _REACH * width, low), min(frequency + _REACH * width, high), width)

    def maximum(self, curve) -> float | None:
        """Where the curve is largest, None where that is at an end of the window."""
        if not self.low < self.high:
            return None
        grid = np.linspace(self.low, self.high, _POINTS)
        best = int(np.argmax(curve(grid)))
        if best in (0, _POINTS - 1):
            return None
        # offsets from the grid point: a maximum is known to the root of the rounding of what is compared
        low, high = grid[best - 1] - grid[best], grid[best + 1] - grid[best]
        while high - low > 2e-9 * self.width:
            steps = np.linspace(low, high, _CLOSER)
            top = int(np.argmax(curve(grid[best] + steps)))
            low, high = steps[max(top - 1, 0)], steps[min(top + 1, _CLOSER - 1)]
        return float(grid[best] + (low + high) / 2)

    def crossing(self, curve, near: float | None) -> float | None:
        """The zero of the curve nearest to a frequency, None where there is none in the window."""
        if near is None or not self.low < self.high:
            return None
        grid = np.linspace(self.low, self.high, _POINTS)
        signs = np.sign(curve(grid))
        at = np.flatnonzero(signs[1:] * signs[:-1] < 0)
        if not at.size:
            return None
        best = at[np.argmin(np.abs(grid[at] - near))]
        return float(brentq(lambda f: float(curve(f)[0]), grid[best], grid[best + 1], rtol=1e-14))

    def quality(self, curve, peak: float | None) -> float | None:
        """Frequency of the peak over its width at half height; None where the window holds only a part of it."""
        if peak is None:
            return None
        half = float(curve(peak)[0]) / 2

        def over(f: float) -> float:
            return float(curve(f)[0]) - half

        if over(self.low) > 0 or over(self.high) > 0:
            return None
        width = brentq(over, peak, self.high, rtol=1e-14) - brentq(over, self.low, peak, rtol=1e-14)
        return float(peak / width)
