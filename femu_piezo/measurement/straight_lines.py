"""Points that lie on straight lines between others: a sweep that was read off a picture or resampled."""

from __future__ import annotations

import numpy as np

from femu_piezo.measurement.data_fault import DataFault
from femu_piezo.measurement.spectrum import ImpedanceSpectrum

#: Bend of a straight piece against the largest bend of its surroundings, and how many points those reach.
_STRAIGHT, _AROUND = 1e-6, 12
#: Least share of straight points, in both parts of the reading, of a sweep that is told.
_SHARE = 0.15


def interpolated(spectrum: ImpedanceSpectrum) -> DataFault | None:
    """The fault of a sweep whose points were joined by straight lines, in R and X, G and B, or |Z| and phase.

    Measured points scatter, those of a simulation bend: three in a row on one line to a millionth of the bends around
    them are neither. Where at least 15 % are, in both parts, the sweep has been interpolated.
    """
    z, y = spectrum.impedance, spectrum.admittance
    readings = {
        "resistance and reactance": (z.real, z.imag),
        "conductance and susceptance": (y.real, y.imag),
        "|Z| and phase": (np.abs(z), np.angle(z)),
        "log |Z| and phase": (np.log(np.abs(z)), np.angle(z)),
    }
    for name, parts in readings.items():
        share = min(straight_share(spectrum.frequency, part) for part in parts)
        if share > _SHARE:
            message = (
                f"{share:.0%} of the points lie on straight lines of {name} between others, as in a curve read off a "
                "picture or resampled: they are not measurements of their own, so stated deviations are too small; "
                "use the original points"
            )
            return DataFault("interpolated", message, np.array([], dtype=int), fatal=False)
    return None


def straight_share(frequency: np.ndarray, values: np.ndarray) -> float:
    """Share of points (n,) that lie on the line through both neighbours, next to others that do not."""
    slopes = np.diff(values) / np.diff(frequency)
    bend = np.abs(np.diff(slopes)) * (frequency[2:] - frequency[:-2])
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(bend, _AROUND), 2 * _AROUND + 1)
    around = windows.max(axis=1)
    level = np.abs(values[1:-1]) * 1e-9  # what rounding in a file leaves is no bend
    return float(np.mean((bend < _STRAIGHT * around) & (around > 1e3 * level)))
