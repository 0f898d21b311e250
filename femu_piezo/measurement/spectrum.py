"""`ImpedanceSpectrum`: a sweep of complex impedance over frequency, in the form that all of the package takes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from femu_piezo.errors import InputError
from femu_piezo.measurement.columns import reach_half_pi, to_impedance
from femu_piezo.units import hertz

#: Endings of the names of files that may be sweeps.
ENDINGS = (".csv", ".txt", ".tsv", ".dat", ".asc", ".prn", ".s1p", ".s2p", ".y1p", ".z1p")

_SOURCE = "sweep"
#: Ratio of the largest |Z| to the least (without a tenth of the points) of a piece that is no resistor. Where the phase
#: is φ degrees, |Z| varies with the power φ/90 of the frequency (Bode): within 1.6° by a fifth over four decades.
_VARYING = 1.25


@dataclass(frozen=True, repr=False)
class ImpedanceSpectrum:
    """Complex impedance of a one-port over frequency.

    Attributes
    ----------
    frequency : (n,) Hz, strictly increasing, positive
    impedance : (n,) complex ohm, time factor e^{jωt} (a capacitor has negative reactance)
    noise : (n,) standard deviation of the complex impedance, ohm, sqrt(E|δZ|²); each of Re, Im has noise/√2.
        None where the file gives none
    noise_estimated : whether `noise` follows from the roughness of readings, and so is known to 25 to 40 % only
    source : where the data came from, for messages and reports
    notes : sentences about what was corrected or is doubtful in the data
    checked : whether the data have passed the checks of `read_spectrum` or `accept_spectrum`

    Sweeps in memory: `from_impedance`, `from_resistance_reactance`, `from_magnitude_phase` and
    `from_conductance_susceptance` take lists or arrays in the order they were measured.
    """

    frequency: np.ndarray
    impedance: np.ndarray
    noise: np.ndarray | None = None
    source: str = "spectrum"
    notes: tuple[str, ...] = ()
    checked: bool = False
    noise_estimated: bool = False

    @classmethod
    def from_impedance(
        cls,
        frequency_Hz: ArrayLike,
        impedance_ohm: ArrayLike,
        *,
        relative_noise: ArrayLike | None = None,
        source: str = _SOURCE,
    ) -> ImpedanceSpectrum:
        """A sweep of complex impedance (n,) over frequency (n,), sorted by frequency.

        Parameters
        ----------
        relative_noise : standard deviation of the complex impedance over |Z|, one number or (n,); None where unknown
        source : what to call it in messages and reports

        Raises
        ------
        InputError : the columns hold no numbers or are not of one length, or a frequency repeats or is not positive
        """
        _refuse_unequal(source, frequency_Hz=frequency_Hz, impedance_ohm=impedance_ohm, relative_noise=relative_noise)
        frequency = _real(source, "frequency_Hz", frequency_Hz)
        impedance = _numbers(source, "impedance_ohm", impedance_ohm, complex)
        noise = None
        if relative_noise is not None:
            noise = _real(source, "relative_noise", relative_noise) * np.abs(impedance)
        notes: tuple[str, ...] = ()
        if frequency.ndim == 1 and frequency.shape == impedance.shape and np.any(np.diff(frequency) < 0):
            order = np.argsort(frequency, kind="stable")
            frequency, impedance = frequency[order], impedance[order]
            noise = None if noise is None else noise[order]
            notes = ("the frequencies were not ascending and have been sorted",)
        return cls(frequency, impedance, noise, source, notes)

    @classmethod
    def from_resistance_reactance(
        cls, frequency_Hz: ArrayLike, resistance_ohm: ArrayLike, reactance_ohm: ArrayLike, **options
    ) -> ImpedanceSpectrum:
        """A sweep of R and X, (n,) each; `options` as of `from_impedance`."""
        columns = {"frequency_Hz": frequency_Hz, "resistance_ohm": resistance_ohm, "reactance_ohm": reactance_ohm}
        resistance, reactance = _pair(options.get("source", _SOURCE), columns)
        return cls.from_impedance(frequency_Hz, resistance + 1j * reactance, **options)

    @classmethod
    def from_magnitude_phase(
        cls, frequency_Hz: ArrayLike, magnitude_ohm: ArrayLike, phase: ArrayLike, *, degrees: bool = True, **options
    ) -> ImpedanceSpectrum:
        """A sweep of |Z| and phase, (n,) each, the phase in degrees or rad; `options` as of `from_impedance`.

        Negative magnitudes are refused, phases in radians that are given as degrees, and degrees given as radians.
        """
        source = options.get("source", _SOURCE)
        columns = {"frequency_Hz": frequency_Hz, "magnitude_ohm": magnitude_ohm, "phase": phase}
        magnitude, angle = _pair(source, columns)
        radians = np.radians(angle) if degrees else angle
        impedance = to_impedance(("abs_z", "phase_z"), magnitude, radians, np.asarray(frequency_Hz), source)
        if not degrees and np.nanmax(np.abs(angle), initial=0.0) > 2 * np.pi:
            raise InputError(
                f"{source}: the phases reach {np.nanmax(np.abs(angle)):.4g} rad, more than a turn; "
                "leave out degrees = False if they are in degrees"
            )
        if degrees and reach_half_pi(angle) and _varies(magnitude):
            raise InputError(
                f"{source}: the phases reach {np.nanmax(np.abs(angle)):.4g} at most, as radians do near π/2 = 1.571, "
                "and no piece with phases of so few degrees has a |Z| that varies so; give degrees = False for radians"
            )
        return cls.from_impedance(frequency_Hz, impedance, **options)

    @classmethod
    def from_conductance_susceptance(
        cls, frequency_Hz: ArrayLike, conductance_S: ArrayLike, susceptance_S: ArrayLike, **options
    ) -> ImpedanceSpectrum:
        """A sweep of G and B, (n,) each, siemens; `options` as of `from_impedance`."""
        columns = {"frequency_Hz": frequency_Hz, "conductance_S": conductance_S, "susceptance_S": susceptance_S}
        source = options.get("source", _SOURCE)
        conductance, susceptance = _pair(source, columns)
        impedance = to_impedance(("g", "b"), conductance, susceptance, np.asarray(frequency_Hz), source)
        return cls.from_impedance(frequency_Hz, impedance, **options)

    def __repr__(self) -> str:
        if not len(self):
            return f"ImpedanceSpectrum({self.source!r}, no points)"
        low, high = self.frequency[[0, -1]]
        return f"ImpedanceSpectrum({self.source!r}, {len(self)} points from {hertz(low)} to {hertz(high)} Hz)"

    def __post_init__(self) -> None:
        frequency = np.asarray(self.frequency, dtype=float)
        impedance = np.asarray(self.impedance, dtype=complex)
        if frequency.ndim != 1 or impedance.shape != frequency.shape:
            raise InputError(
                f"{self.source}: frequency and impedance must be two columns of one length, "
                f"got shapes {frequency.shape} and {impedance.shape}"
            )
        if frequency.size and not (np.all(np.diff(frequency) > 0) and frequency[0] > 0):
            raise InputError(
                f"{self.source}: frequencies must be positive and strictly increasing; sort them, and average those "
                "that repeat"
            )
        object.__setattr__(self, "frequency", frequency)
        object.__setattr__(self, "impedance", impedance)
        if self.noise is not None:
            object.__setattr__(self, "noise", np.broadcast_to(np.asarray(self.noise, float), frequency.shape))

    @property
    def noise_known(self) -> bool:
        """Whether the noise was given with the data."""
        return self.noise is not None and not self.noise_estimated

    @property
    def admittance(self) -> np.ndarray:
        """(n,) complex Y = 1/Z, siemens."""
        return 1.0 / self.impedance

    @property
    def omega(self) -> np.ndarray:
        """(n,) angular frequency, rad/s."""
        return 2 * np.pi * self.frequency

    def __len__(self) -> int:
        return self.frequency.size

    def select(self, keep: np.ndarray) -> ImpedanceSpectrum:
        """The points where the boolean (or index) array `keep` says so."""
        noise = None if self.noise is None else self.noise[keep]
        return replace(self, frequency=self.frequency[keep], impedance=self.impedance[keep], noise=noise)

    def band(self, low: float, high: float) -> ImpedanceSpectrum:
        """The points with low ≤ frequency ≤ high (Hz)."""
        return self.select((self.frequency >= low) & (self.frequency <= high))


def _refuse_unequal(source: str, **columns: ArrayLike | None) -> None:
    """InputError where lists of values are not of one length; a single number stands for a whole column."""
    sizes = {name: np.shape(values)[0] for name, values in columns.items() if values is not None and np.ndim(values)}
    if len(set(sizes.values())) > 1:
        told = ", ".join(f"{name} has {size}" for name, size in sizes.items())
        raise InputError(
            f"{source}: the columns are of unequal lengths: {told}; give one value of each for every point"
        )


def _numbers(source: str, name: str, values: ArrayLike, kind: type) -> np.ndarray:
    """Values as an array of float or complex; InputError where they are no numbers."""
    try:
        return np.asarray(values, dtype=kind)
    except (TypeError, ValueError):
        raise InputError(f"{source}: {name} does not hold numbers alone; give a list or an array of numbers") from None


def _real(source: str, name: str, values: ArrayLike) -> np.ndarray:
    """Values as an array of float; InputError where they are no numbers, or complex ones."""
    found = _numbers(source, name, values, complex if np.iscomplexobj(values) else float)
    if found.imag.any():
        raise InputError(f"{source}: {name} is real, and complex numbers are given; check the order of the arguments")
    return np.array(found.real)


def _pair(source: str, columns: dict[str, ArrayLike]) -> list[np.ndarray]:
    """The two columns after the frequency, as arrays of float; InputError where they cannot be."""
    _refuse_unequal(source, **columns)
    return [_real(source, name, values) for name, values in list(columns.items())[1:]]


def _varies(magnitude: np.ndarray) -> bool:
    """Whether |Z| (n,) varies by more than a resistor's."""
    finite = magnitude[np.isfinite(magnitude)]
    low, high = np.quantile(finite, [0.05, 0.95]) if finite.size else (1.0, 1.0)
    return bool(high > _VARYING * low > 0)


def evenly(count: int, most: int) -> np.ndarray:
    """(m,) indices of at most `most` of `count` points, evenly spaced."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))
