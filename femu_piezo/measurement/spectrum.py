"""`ImpedanceSpectrum`: a sweep of complex impedance over frequency, the one form in which data travel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from femu_piezo.errors import InputError


@dataclass(frozen=True)
class ImpedanceSpectrum:
    """Complex impedance of a one-port over frequency.

    Attributes
    ----------
    frequency : (n,) Hz, strictly increasing, positive
    impedance : (n,) complex ohm, time factor e^{jωt} (a capacitor has negative reactance)
    noise : (n,) standard deviation of the complex impedance, ohm, sqrt(E|δZ|²); each of Re, Im has noise/√2.
        None where the file gives none
    source : where the data came from, for messages and reports
    notes : sentences about what was corrected or is doubtful in the data
    """

    frequency: np.ndarray
    impedance: np.ndarray
    noise: np.ndarray | None = None
    source: str = "spectrum"
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        frequency = np.asarray(self.frequency, dtype=float)
        impedance = np.asarray(self.impedance, dtype=complex)
        if frequency.ndim != 1 or impedance.shape != frequency.shape:
            raise InputError(
                f"{self.source}: frequency and impedance must be two columns of one length, "
                f"got shapes {frequency.shape} and {impedance.shape}"
            )
        if frequency.size and not (np.all(np.diff(frequency) > 0) and frequency[0] > 0):
            raise InputError(f"{self.source}: frequencies must be positive and strictly increasing")
        object.__setattr__(self, "frequency", frequency)
        object.__setattr__(self, "impedance", impedance)
        if self.noise is not None:
            object.__setattr__(self, "noise", np.broadcast_to(np.asarray(self.noise, float), frequency.shape))

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
