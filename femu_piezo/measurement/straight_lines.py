"""Points that lie on straight lines between others: a sweep that was read off a picture or resampled."""

from __future__ import annotations

import numpy as np

from femu_piezo.measurement.data_fault import DataFault
from femu_piezo.measurement.spectrum import ImpedanceSpectrum

#: Bend of a straight piece over the largest bend around it, and how many points to either side are around it.
_STRAIGHT, _AROUND = 1e-6, 12
#: Share of straight points, in both columns, beyond which a sweep counts as interpolated.
_SHARE = 0.15


def interpolated(spectrum: ImpedanceSpectrum) -> DataFault | None:
    """The fault of a sweep whose points were joined by straight lines, in R and X, G and B, or |Z| and phase.

    Measured points scatter and simulated curves bend; three points in a row on one line, to a millionth of the bends
    around them, do neither. Where more than 15 % of both columns are such points, the sweep has been interpolated.
    """
    z, y = spectrum.impedance, spectrum.admittance
    readings = {
        "resistance and reactance": (z.real, z.imag),
        "conductance and susceptance": (y.real, y.imag),
        "|Z| and phase": (np.abs(z), np.angle(z)),
        "log |Z| and phase": (np.log(np.abs(z)), np.angle(z)),
    }
    for name, parts in readings.items():
        if all(straight_share(spectrum.frequency, part) > _SHARE for part in parts):
            share = min(straight_share(spectrum.frequency, part) for part in parts)
            message = (
                f"{share:.0%} of the points lie on straight lines of {name} between others, as in a curve read off a "
                "picture or resampled: they are interpolated, not measured, so the standard deviations are too small; "
                "use the original points"
            )
            return DataFault("interpolated", message, np.array([], dtype=int), fatal=False)
    return None


def straight_share(frequency: np.ndarray, values: np.ndarray) -> float:
    """Share of points (n,) that lie on the line through both neighbours, while some of the points around do not."""
    slopes = np.diff(values) / np.diff(frequency)
    bend = np.abs(np.diff(slopes)) * (frequency[2:] - frequency[:-2])
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(bend, _AROUND), 2 * _AROUND + 1)
    around = windows.max(axis=1)
    level = np.abs(values[1:-1]) * 1e-9  # size of bends that are only rounding in a file
    return float(np.mean((bend < _STRAIGHT * around) & (around > 1e3 * level)))
