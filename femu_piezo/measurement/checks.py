"""Faults of measured sweeps: what is wrong, where, and what to do about it.

`order_points` puts the points of a file in order; `check_spectrum` looks at the physics: a piece of piezoceramic is
a passive capacitor with resonances, so Re Z ≥ 0 and its locus turns clockwise as the frequency rises.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.measurement.spectrum import ImpedanceSpectrum

FEWEST_POINTS = 8


@dataclass(frozen=True)
class DataFault:
    """One fault of a sweep.

    Attributes
    ----------
    kind : "too_few", "khz_for_hz", "phase_turned", "columns_exchanged", "resistance_sign", "reactance_sign",
        "not_passive" or "rough"
    message : one sentence with the numbers and the remedy
    indices : (k,) int, the points concerned, counted from 0; empty where it is the whole sweep
    fatal : whether the sweep cannot be used as it is
    """

    kind: str
    message: str
    indices: np.ndarray
    fatal: bool = True


def order_points(
    frequency: np.ndarray, impedance: np.ndarray, noise: np.ndarray | None, lines: np.ndarray, source: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, tuple[str, ...]]:
    """Points in order of frequency, repeated frequencies averaged; and notes on both.

    Raises InputError for frequencies that are not positive, impedances that are zero or infinite, and frequencies
    that repeat at more than a tenth of the points.
    """
    if np.any(frequency <= 0):
        row = int(np.argmax(frequency <= 0))
        raise InputError(
            f"{source}, line {lines[row]}: the frequency is {frequency[row]:g} Hz, and zero or less at "
            f"{int(np.sum(frequency <= 0))} points; remove these lines, or check which column is the frequency"
        )
    bad = (impedance == 0) | ~np.isfinite(impedance)
    if np.any(bad):
        row = int(np.argmax(bad))
        raise InputError(
            f"{source}, line {lines[row]}: the impedance at {frequency[row]:g} Hz is {impedance[row]:g} ohm, and zero "
            f"or infinite at {int(bad.sum())} points; measure these points again or remove their lines"
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
    return sorted((fault for fault in faults if fault), key=lambda fault: not fault.fatal)


def turning_sense(impedance: np.ndarray) -> float:
    """½ ∫ |Γ|² dφ of the reflection Γ = (Z − Z0)/(Z + Z0), Z0 the geometric mean of |Z|; rad.

    Negative (clockwise) for every passive one-port over rising frequency (Foster; for losses the positive-real
    functions); positive where the sign of the reactance is wrong. The noise of single points averages out.
    """
    impedance = impedance[impedance.real >= 0]  # the others, of noise or a fault, may have an infinite reflection
    reference = np.exp(np.mean(np.log(np.abs(impedance)))) if impedance.size else 1.0
    reflection = (impedance - reference) / (impedance + reference)
    return float(0.5 * np.sum(np.imag(np.conj(reflection[:-1]) * reflection[1:])))


def _frequency_unit(spectrum: ImpedanceSpectrum, hertz_stated: bool) -> DataFault | None:
    """Frequencies of a few hundred "Hz" that must be kHz."""
    low, high = spectrum.frequency[[0, -1]]
    if high >= 5000:
        return None
    angle = np.angle(spectrum.impedance)
    resonant = spectrum.impedance.imag.max() > 0 > spectrum.impedance.imag.min() or np.ptp(angle) > 0.5
    told = f"the sweep runs from {low:.6g} to {high:.6g} Hz"
    whole = np.array([], dtype=int)
    if high < 1000 and not hertz_stated:
        message = f"{told} by a header without a unit, which looks like kHz or MHz; write frequency_kHz or frequency_Hz"
        return DataFault("khz_for_hz", message, whole)
    if not resonant:
        return None
    message = (
        f"{told} and has a resonance, which for a piece of ceramic means a length of metres; if the frequencies are "
        "in kHz, write frequency_kHz in the header"
    )
    return DataFault("khz_for_hz", message, whole, fatal=bool(high < 1000))


def _roughness(spectrum: ImpedanceSpectrum) -> DataFault | None:
    """Neighbouring points without relation, as after exchanged columns."""
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
    """Negative resistance and a locus that turns the wrong way."""
    z = spectrum.impedance
    negative = np.flatnonzero(z.real < 0)
    share = negative.size / z.size
    told = f"Re Z is negative at {negative.size} of {z.size} points"
    if share > 0.5 and _mostly_turned(z):
        counter_clockwise = turning_sense(-z) > 0.2
        exchanged = z.imag + 1j * z.real
        if counter_clockwise and np.mean(exchanged.real >= 0) > 0.9:
            message = f"{told} while Im Z is positive; the columns of resistance and reactance are exchanged"
            return [DataFault("columns_exchanged", message, negative)]
        if counter_clockwise:
            message = f"{told} and the locus turns counter-clockwise; change the sign of the resistance column"
            return [DataFault("resistance_sign", message, negative)]
        message = (
            f"{told}: the phase is turned by 180°; set correct_phase = true in [measurement] of the specimen file "
            "(or --correct-phase) to turn it back"
        )
        return [DataFault("phase_turned", message, negative)]
    faults = []
    if turning_sense(z if share <= 0.5 else -z) > 0.2:
        message = (
            "the locus of Z turns counter-clockwise with rising frequency, against any passive piece; the sign of the "
            "reactance (or phase, or susceptance) is swapped: change the sign of that column, or exchange the two"
        )
        faults.append(DataFault("reactance_sign", message, np.array([], dtype=int)))
    if negative.size:
        worst = negative[np.argmin(z.real[negative] / np.abs(z[negative]))]
        first = ", ".join(f"{f:.6g}" for f in spectrum.frequency[negative[:3]])
        message = (
            f"{told} (at {first}{' …' if negative.size > 3 else ''} Hz; the phase reaches "
            f"{np.degrees(np.angle(z[worst])):.2f}° at {spectrum.frequency[worst]:.6g} Hz), which no passive piece "
            "does; check the compensation of the fixture, or leave these points out"
        )
        faults.append(DataFault("not_passive", message, negative, fatal=False))
    return faults


def _mostly_turned(impedance: np.ndarray) -> bool:
    """Whether Re Z is negative in earnest, not by a small error of the phase near ±90°."""
    cosine = impedance.real / np.abs(impedance)
    strongest = np.argsort(np.abs(cosine))[-max(3, cosine.size // 20) :]
    return bool(np.median(cosine[strongest]) < -0.1)
