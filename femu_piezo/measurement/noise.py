"""The noise of a sweep, estimated from the sweep itself.

In a short window of neighbouring points an impedance is a rational function of frequency of low degree, with or without
a resonance; the residual of such a function is noise. The median over the windows ignores single bad windows.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.special import gammaincinv

from femu_piezo.errors import InputError
from femu_piezo.measurement.local_fits import rational_values
from femu_piezo.measurement.spectrum import ImpedanceSpectrum

_WINDOW = 13
_DEGREES = ((3, 2), (4, 3))
_MOST_WINDOWS = 100
_CROSSINGS = 61
_GAIN_OF_ADDITIVE = 0.93


@dataclass(frozen=True)
class NoiseModel:
    """Standard deviation of the complex impedance: sqrt((relative |Z|)² + additive²), ohm.

    Attributes
    ----------
    relative : part proportional to |Z|, dimensionless
    additive : part that does not depend on Z, ohm
    """

    relative: float
    additive: float

    def std(self, impedance: np.ndarray) -> np.ndarray:
        """(n,) standard deviation sqrt(E|δZ|²) at the complex impedances (n,), ohm."""
        return np.hypot(self.relative * np.abs(impedance), self.additive)


def noise_at_points(spectrum: ImpedanceSpectrum) -> np.ndarray:
    """(n,) standard deviation of Z at every point, ohm: the spectrum's own, else that of its `estimate_noise`."""
    return spectrum.noise if spectrum.noise is not None else estimate_noise(spectrum).std(spectrum.impedance)


def estimate_noise(spectrum: ImpedanceSpectrum) -> NoiseModel:
    """The noise model of a spectrum: of its own `noise` where that is known, else estimated from its roughness.

    Accuracy on simulated sweeps of a k31 bar (relative noise 1e-4 … 3e-3, tests/measurement/test_noise.py): within
    25 % from 201 points on and within 40 % at 61 points. A sweep so coarse that a pole and its zero lie three steps
    apart gives up to twice the noise. Noise that is correlated between neighbouring points (smoothing, interpolation)
    is not seen.

    Raises InputError below 8 points.
    """
    size = len(spectrum)
    if size < 8:
        raise InputError(f"{spectrum.source}: {size} points are too few to estimate the noise; measure at least 8")
    magnitude = np.abs(spectrum.impedance)
    if spectrum.noise is not None:
        return _fit_model((spectrum.noise / magnitude) ** 2, magnitude)
    return _estimated(spectrum.frequency.tobytes(), spectrum.impedance.tobytes())


@lru_cache(maxsize=8)
def _estimated(frequencies: bytes, impedances: bytes) -> NoiseModel:
    """The noise model from the roughness of a sweep; cached, since checks, extraction and fit all need it."""
    frequency, impedance = np.frombuffer(frequencies), np.frombuffer(impedances, dtype=complex)
    size = frequency.size
    window = min(_WINDOW, size)
    candidates = []
    for degrees in _DEGREES if size >= _WINDOW else ((2, 1),):
        variance, freedom = _window_variances(frequency, impedance, degrees, window)
        # the median of a variance with 2·freedom real degrees of freedom lies below its mean
        candidates.append(variance * freedom / gammaincinv(freedom, 0.5))
    variance = min(candidates, key=np.median)
    typical = np.median(sliding_window_view(np.abs(impedance), window), axis=1)
    return _fit_model(variance, typical[:: _stride(size - window + 1)])


def _stride(windows: int) -> int:
    """Distance of the windows that are used, so that they are `_MOST_WINDOWS` at most."""
    return -(-windows // _MOST_WINDOWS)


def _window_variances(
    frequency: np.ndarray, impedance: np.ndarray, degrees: tuple[int, int], window: int
) -> tuple[np.ndarray, int]:
    """Relative variance of Z in each window about its best rational function; complex degrees of freedom.

    degrees : of numerator and denominator. Returns (windows,) and window − (number of coefficients).
    """
    step = _stride(frequency.size - window + 1)
    f = sliding_window_view(frequency, window)[::step]
    z = sliding_window_view(impedance, window)[::step]
    fit = rational_values(f, z, np.ones(f.shape), degrees)
    freedom = window - (degrees[0] + degrees[1] + 1)
    return np.sum(np.abs(fit / z - 1) ** 2, axis=1) / freedom, freedom


def _fit_model(variance: np.ndarray, magnitude: np.ndarray) -> NoiseModel:
    """The model relative² + (additive/|Z|)² nearest to given relative variances (windows,) at |Z| (windows,), ohm.

    The ratio of both parts has the least mean absolute deviation of log variances, the level is their median. An
    additive part is taken only where it lowers that deviation clearly (`_GAIN_OF_ADDITIVE`). A variance of zero is
    raised to the square of the rounding of floating-point numbers.
    """
    rounding = np.finfo(float).eps
    logs = np.log(np.maximum(variance, rounding**2))
    # candidates of the |Z| at which both parts are equal, one row each; 0 has no additive part
    crossings = np.concatenate([[0.0], np.geomspace(magnitude.min() / 10, magnitude.max() * 10, _CROSSINGS)])
    shapes = np.log1p((crossings[:, None] / magnitude) ** 2)
    levels = np.median(logs - shapes, axis=1)
    misfit = np.mean(np.abs(logs - shapes - levels[:, None]), axis=1)
    best = int(np.argmin(misfit))
    independent = max(2.0, variance.size / _WINDOW)  # few windows explain anything by chance
    if misfit[best] > min(_GAIN_OF_ADDITIVE, 1 - 1 / independent) * misfit[0]:
        best = 0
    relative = float(np.exp(levels[best] / 2))
    return NoiseModel(relative, relative * float(crossings[best]))
