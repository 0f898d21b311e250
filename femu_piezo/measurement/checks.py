"""Faults of measured sweeps: what is wrong, where, and what to do about it.

`order_points` puts the points of a file in order; `check_spectrum` looks at the physics: a piece of piezoceramic is
a passive capacitor with resonances, so Re Z ≥ 0 and its locus turns clockwise as the frequency rises.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.measurement.data_fault import DataFault as DataFault
from femu_piezo.measurement.faults import local_faults
from femu_piezo.measurement.orientation import misread_as
from femu_piezo.measurement.spectrum import ImpedanceSpectrum

FEWEST_POINTS = 8
#: Speed of sound above that of most ceramics, m/s; frequencies, Hz, above which a first resonance of bulk ceramic is
#: doubtful, and above which there is none.
_SPEED, _THIN, _NONE = 5000.0, 1e9, 1e10
_CAUSES = {
    "phase_turned": "{told}: the phase is turned by 180°; set correct_phase = true in [measurement] of the specimen "
    "file (or --correct-phase, in Python correct_phase=True) to turn it back",
    "no_reactance": "the impedance has no imaginary part at any point; give complex numbers, or |Z| with its phase",
    "reactance_sign": "the locus of Z turns counter-clockwise as the frequency rises, which no passive piece does; the "
    "sign of the reactance (or phase, or susceptance) is wrong: change the sign of that column",
    "resistance_sign": "{told} and the locus turns counter-clockwise; change the sign of the resistance column",
    "columns_exchanged": "{told} and the piece looks like a resistor; the columns of resistance and reactance are "
    "exchanged: exchange them or their names",
    "admittance_exchanged": "the piece looks like a resistor over most of the sweep; the columns of conductance and "
    "susceptance are exchanged: exchange them or their names",
}


def order_points(
    frequency: np.ndarray, impedance: np.ndarray, noise: np.ndarray | None, lines: np.ndarray, source: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, tuple[str, ...]]:
    """Frequency, impedance and noise (m,) in order of frequency, repeated frequencies averaged; notes on these changes.

    Parameters
    ----------
    frequency, impedance, noise : (n,) Hz, complex ohm, ohm; noise None where it is not known
    lines : (n,) line of the file that each point stands in

    Raises InputError for frequencies that are not positive, impedances that are zero or infinite, and frequencies
    that repeat at more than a tenth of the points.
    """
    if np.any(frequency <= 0):
        row = int(np.argmax(frequency <= 0))
        raise InputError(
            f"{source}, line {lines[row]}: the frequency is {frequency[row]:g} Hz, and it is zero or less at "
            f"{int(np.sum(frequency <= 0))} points; remove these lines, or check which column is the frequency"
        )
    bad = (impedance == 0) | ~np.isfinite(impedance)
    if np.any(bad):
        row = int(np.argmax(bad))
        raise InputError(
            f"{source}, line {lines[row]}: the impedance at {frequency[row]:g} Hz is {impedance[row]:g} ohm, and it is "
            f"zero or infinite at {int(bad.sum())} points; measure these points again or remove their lines"
        )
    notes = []
    steps = np.diff(frequency)
    if np.any(steps < 0):
        order = np.argsort(frequency, kind="stable")
        frequency, impedance = frequency[order], impedance[order]
        noise = None if noise is None else noise[order]
        how = "descending" if np.all(steps < 0) else f"unsorted (they fall {int(np.sum(steps < 0))} times)"
        notes.append(f"the frequencies were {how} and have been sorted")
    _, first, count = np.unique(frequency, return_index=True, return_counts=True)
    if np.any(count > 1):
        repeated = frequency[first[count > 1]]
        extra = frequency.size - first.size
        told = f"{repeated.size} frequencies occur more than once, the first is {repeated[0]:.10g} Hz"
        if repeated.size == 1:
            told = f"the frequency {repeated[0]:.10g} Hz occurs {count.max()} times"
        if extra > frequency.size / 10:
            raise InputError(
                f"{source}: {told}; export one sweep only, with enough digits of the frequency to tell its points apart"
            )
        frequency = frequency[first]
        impedance = np.add.reduceat(impedance, first) / count
        noise = None if noise is None else np.sqrt(np.add.reduceat(noise**2, first)) / count
        notes.append(f"{told}; such points were averaged")
    return frequency, impedance, noise, tuple(notes)


def check_spectrum(spectrum: ImpedanceSpectrum, *, hertz_stated: bool = True) -> list[DataFault]:
    """The faults of a spectrum, fatal ones first; empty where nothing is wrong.

    `hertz_stated` : whether the data came with the unit of the frequency, so that kHz cannot be taken for Hz unnoticed.
    """
    whole = np.array([], dtype=int)
    if len(spectrum) < FEWEST_POINTS:
        message = f"the sweep has {len(spectrum)} points, and at least {FEWEST_POINTS} are needed; measure more points"
        return [DataFault("too_few", message, whole)]
    faults = [_frequency_unit(spectrum, hertz_stated), _roughness(spectrum), *_passivity(spectrum)]
    if not any(faults):  # single points cannot be judged in a sweep that is wrong as a whole
        faults = local_faults(spectrum)
    return sorted((fault for fault in faults if fault), key=lambda fault: not fault.fatal)


def _frequency_unit(spectrum: ImpedanceSpectrum, hertz_stated: bool) -> DataFault | None:
    """The fault of frequencies of a few hundred "Hz" that must be kHz, or of a first resonance at GHz."""
    low, high = spectrum.frequency[[0, -1]]
    if high >= _THIN:
        return _above_any_ceramic(spectrum)
    if high >= 5000:
        return None
    angle = np.angle(spectrum.impedance)
    resonant = spectrum.impedance.imag.max() > 0 > spectrum.impedance.imag.min() or np.ptp(angle) > 0.5
    told = f"the sweep runs from {low:.6g} to {high:.6g} Hz"
    whole = np.array([], dtype=int)
    if high < 1000 and not hertz_stated:
        message = (
            f"{told} if its frequencies are in Hz, but they look like kHz or MHz, and the header gives no unit; write "
            "frequency_kHz or frequency_Hz in the header"
        )
        return DataFault("khz_for_hz", message, whole)
    if not resonant:
        return None
    message = (
        f"{told} and has a resonance there, as only a piece of ceramic metres long would have; if the frequencies are "
        "in kHz, write frequency_kHz in the header of the file, or multiply those of an array by 1000"
    )
    return DataFault("khz_for_hz", message, whole, fatal=bool(high < 1000))


def _above_any_ceramic(spectrum: ImpedanceSpectrum) -> DataFault | None:
    """The fault of a sweep that is capacitive up to a first resonance above `_THIN`."""
    first = float(spectrum.frequency[np.argmax(spectrum.impedance.imag > 0)])
    if spectrum.impedance.imag[0] > 0 or first < _THIN or not np.any(spectrum.impedance.imag > 0):
        return None
    message = (
        f"the first resonance is at {first / 1e9:.4g} GHz, as only ceramic of less than {_SPEED / 2 / first * 1e6:.2g} "
        "micrometres would have it; check the unit of the frequencies, which the header of the file gives"
    )
    return DataFault("hz_for_khz", message, np.array([], dtype=int), fatal=first > _NONE)


def _roughness(spectrum: ImpedanceSpectrum) -> DataFault | None:
    """The fault of a sweep whose neighbouring points form no smooth curve, as after exchanged columns."""
    logs = np.log(spectrum.impedance)
    difference = 2 * logs[1:-1] - logs[:-2] - logs[2:]
    turn = (difference.imag + np.pi) % (2 * np.pi) - np.pi
    typical = float(np.median(np.hypot(difference.real, turn))) / np.sqrt(6)
    if typical < 0.25:
        return None
    message = (
        f"half of the points differ from their neighbours by more than {typical:.0%} and form no smooth curve; "
        "check which column is which, and measure with closer steps or less noise"
    )
    return DataFault("rough", message, np.array([], dtype=int), fatal=False)


def _passivity(spectrum: ImpedanceSpectrum) -> list[DataFault]:
    """The fault of wrong signs or exchanged columns; else that of the points with negative resistance."""
    cause = misread_as(spectrum.impedance)
    if cause is not None and not spectrum.impedance.imag.any():
        cause = "no_reactance"
    negative = np.flatnonzero(spectrum.impedance.real < 0)
    told = f"Re Z is negative at {negative.size} of {len(spectrum)} points"
    if cause is not None:
        return [DataFault(cause, _CAUSES[cause].format(told=told), negative)]
    if not negative.size:
        return []
    cosine = spectrum.impedance.real / np.abs(spectrum.impedance)
    worst = int(np.argmin(cosine))
    first = ", ".join(f"{f:.6g}" for f in spectrum.frequency[negative[:3]])
    message = (
        f"{told} (at {first}{' …' if negative.size > 3 else ''} Hz; the phase is "
        f"{np.degrees(np.angle(spectrum.impedance[worst])):.2f}° at {spectrum.frequency[worst]:.6g} Hz), which no "
        "passive piece does; check the compensation of the fixture, or leave these points out"
    )
    return [DataFault("not_passive", message, negative, fatal=False)]
