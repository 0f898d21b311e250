"""Open, short and load compensation of a raw sweep, with its uncertainty.

Keysight Impedance Measurement Handbook, 6th ed., section 4.3 (open/short: a fixture of a series residual and a stray
admittance; open/short/load: any linear two-port):

- short alone:           Z = Zm − Zs
- open alone:            Z = Zm/(1 − Zm/Zo)
- open and short:        Z = (Zm − Zs)/(1 − (Zm − Zs) Yo),  Yo = 1/(Zo − Zs)
- open, short and load:  Z = ZL (Zo − Zl)(Zm − Zs)/[(Zl − Zs)(Zo − Zm)]

Zm, Zo, Zs, Zl are raw readings of the piece, open, short and load; ZL is the true impedance of the load.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.measurement.noise import noise_at_points
from femu_piezo.measurement.spectrum import ImpedanceSpectrum


@dataclass(frozen=True)
class Load:
    """True impedance of the load: a resistance, an inductance in series, a capacitance across both; and its tolerance.

    Attributes
    ----------
    resistance : ohm;  inductance : H;  capacitance : F
    std : relative standard deviation of its impedance; an error of the load is the same at every point, so it is no
        noise but counts with the accuracy of the instrument
    """

    resistance: float
    inductance: float = 0.0
    capacitance: float = 0.0
    std: float = 0.0

    def impedance(self, omega: np.ndarray) -> np.ndarray:
        """Z (n,) in ohm at ω (n,) in rad/s."""
        series = self.resistance + 1j * omega * self.inductance
        return series / (1 + 1j * omega * self.capacitance * series)


@dataclass(frozen=True)
class Compensation:
    """Raw sweeps of the fixture; None where one was not measured.

    Attributes
    ----------
    open, short, load : raw sweeps
    standard : true impedance of the load, required with `load`
    """

    open: ImpedanceSpectrum | None = None
    short: ImpedanceSpectrum | None = None
    load: ImpedanceSpectrum | None = None
    standard: Load | None = None

    def __post_init__(self) -> None:
        if self.load is not None and (self.open is None or self.short is None or self.standard is None):
            raise InputError(f"{self.load.source}: a load needs the sweeps of open and short too, and its value")
        if self.open is None and self.short is None:
            raise InputError("a compensation needs a sweep of the open or of the shorted fixture")

    def applied(self, spectrum: ImpedanceSpectrum) -> ImpedanceSpectrum:
        """The sweep as it would be without the fixture; its noise includes that of all readings.

        The impedance of the load is taken as exact. Readings of the fixture are interpolated to the frequencies of the
        sweep, linearly in Y for the open and in Z for the others.
        Raises InputError where they do not cover the sweep, or the result is zero or infinite somewhere.
        """
        frequency, raw = spectrum.frequency, spectrum.impedance
        names = [name for name in ("open", "short", "load") if getattr(self, name) is not None]
        readings = {name: _at(getattr(self, name), frequency, name == "open") for name in names}
        known = None if self.load is None else self.standard.impedance(spectrum.omega)
        values = {name: z for name, (z, _) in readings.items()}
        with np.errstate(all="ignore"):
            found = compensated(raw, known=known, **values)
            slopes = compensation_slopes(raw, known=known, **values)
        if not np.all(np.isfinite(found)) or np.any(found == 0):
            raise InputError(
                f"{spectrum.source}: the compensated impedance is zero or infinite at "
                f"{int(np.sum(~np.isfinite(found) | (found == 0)))} points; are open and short exchanged?"
            )
        raw_noise = noise_at_points(spectrum)
        variance = np.abs(slopes["raw"]) ** 2 * raw_noise**2
        for name, (_, noise) in readings.items():
            variance = variance + np.abs(slopes[name]) ** 2 * noise**2
        largest = float(np.max(np.abs(found / raw - 1)))
        note = f"compensated by {', '.join(names)} from raw files: Z changed by up to {100 * largest:.2g} %"
        return replace(
            spectrum,
            impedance=found,
            noise=np.sqrt(variance),
            noise_estimated=not spectrum.noise_known,
            notes=(*spectrum.notes, note),
        )


def compensated(raw, open=None, short=None, load=None, known=None) -> np.ndarray:
    """Z (n,) of the piece, ohm, by the formula for the readings of the fixture that are given, all (n,) complex ohm.

    raw, open, short, load : raw readings;  known : true impedance of the load
    """
    if load is not None:
        return known * (open - load) * (raw - short) / ((load - short) * (open - raw))
    if open is None:
        return raw - short
    if short is None:
        return raw / (1 - raw / open)
    return (raw - short) / (1 - (raw - short) / (open - short))


def compensation_slopes(raw, open=None, short=None, load=None, known=None) -> dict[str, np.ndarray]:
    """∂Z/∂(raw, open, short, load), (n,) complex each, exact; only for the readings that are given."""
    found = compensated(raw, open, short, load, known)
    if load is not None:
        return {
            "raw": found * (1 / (raw - short) + 1 / (open - raw)),
            "open": found * (1 / (open - load) - 1 / (open - raw)),
            "short": found * (1 / (load - short) - 1 / (raw - short)),
            "load": -found * (1 / (open - load) + 1 / (load - short)),
        }
    if open is None:
        return {"raw": np.ones_like(raw), "short": -np.ones_like(raw)}
    if short is None:
        return {"raw": (found / raw) ** 2, "open": -((found / open) ** 2)}
    return {
        "raw": (found / (raw - short)) ** 2,
        "open": -((found / (open - short)) ** 2),
        "short": (found / (open - short)) ** 2 - (found / (raw - short)) ** 2,
    }


def _at(reading: ImpedanceSpectrum, frequency: np.ndarray, as_admittance: bool) -> tuple[np.ndarray, np.ndarray]:
    """Z and its noise, (n,) ohm, of a reading of the fixture, interpolated to the frequencies (n,) of the sweep."""
    low, high = reading.frequency[[0, -1]]
    if frequency[0] < low * (1 - 1e-9) or frequency[-1] > high * (1 + 1e-9):
        raise InputError(
            f"{reading.source}: this reading covers {low:.6g} to {high:.6g} Hz, and the sweep {frequency[0]:.6g} to "
            f"{frequency[-1]:.6g} Hz; measure the fixture over the whole sweep"
        )
    values = reading.admittance if as_admittance else reading.impedance
    between = np.interp(frequency, reading.frequency, values.real) + 1j * np.interp(
        frequency, reading.frequency, values.imag
    )
    impedance = 1 / between if as_admittance else between
    relative = np.interp(frequency, reading.frequency, noise_at_points(reading) / np.abs(reading.impedance))
    return impedance, relative * np.abs(impedance)
