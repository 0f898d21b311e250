"""Which signs and columns of an impedance sweep are in the wrong place.

A piece of piezoceramic is passive, Re Z ≥ 0, its reflection turns clockwise as the frequency rises, and it is a
capacitor or inductor of small loss over most of any sweep. Six readings of the two columns compete; the data are
taken as they are unless another reading is plainly better.
"""

from __future__ import annotations

import numpy as np

_READINGS = {
    "phase_turned": lambda z: -z,
    "reactance_sign": np.conj,
    "resistance_sign": lambda z: -np.conj(z),
    "columns_exchanged": lambda z: z.imag + 1j * z.real,
    "admittance_exchanged": lambda z: -z.imag - 1j * z.real,
}
"""Fault of the data → the correction, as a function of Z."""


def misread_as(impedance: np.ndarray) -> str | None:
    """The fault of signs or columns in Z (n,), a key of `_READINGS`; None where they can be right as they are."""
    resistor = _resistive_share(impedance) > 0.8
    if not _is_active(impedance) and _turns(impedance) <= 0 and not resistor:
        return None
    losses = {
        fault: _resistive_share(reading(impedance))
        for fault, reading in _READINGS.items()
        if not _is_active(reading(impedance)) and _turns(reading(impedance)) < 0
    }
    best = min(losses, key=losses.__getitem__, default=None)
    if best == "resistance_sign" and np.max(np.abs(impedance.real) / np.abs(impedance)) < 0.1:
        return None  # no resonance, and Re Z so small that an error of the phase by a few degrees explains its sign
    if resistor and not _is_active(impedance) and (best is None or losses[best] > 0.3):
        return None
    if best is None and np.mean(impedance.real < 0) > 0.5:
        return "phase_turned"
    return best


def turning_sense(impedance: np.ndarray) -> float:
    """½ ∫ |Γ|² dφ of the reflection Γ = (Z − Z0)/(Z + Z0) along a sweep Z (n,), Z0 the geometric mean of |Z|; rad.

    Negative (clockwise) for a passive one-port over rising frequency (Foster; for losses the positive-real
    functions). |Γ| is taken as 1 where Re Z < 0, and steps of more than a radian, which the sweep does not resolve,
    are left out. The noise of single points averages out.
    """
    return float(np.sum(_area_steps(impedance)))


def _area_steps(impedance: np.ndarray) -> np.ndarray:
    """(n−1,) contributions of the steps to `turning_sense`."""
    reference = np.exp(np.mean(np.log(np.abs(impedance))))
    infinite = impedance == -reference
    reflection = (impedance - reference) / np.where(infinite, 1.0, impedance + reference)
    reflection = reflection / np.maximum(1.0, np.abs(reflection))
    step = np.conj(reflection[:-1]) * reflection[1:]
    return np.where(np.abs(np.angle(step)) < 1, 0.5 * step.imag, 0.0)


def _turns(impedance: np.ndarray) -> int:
    """Sense in which the reflection turns: −1 clockwise, +1 counter-clockwise, 0 where it is within the noise."""
    steps = _area_steps(impedance)
    total, scatter = np.sum(steps), np.median(np.abs(np.diff(steps)))
    return int(np.sign(total)) if abs(total) > max(1e-4, 10 * scatter) else 0


def _is_active(impedance: np.ndarray) -> bool:
    """Whether Re Z is clearly negative, not by noise or a small error of the phase near ±90°."""
    cosine = impedance.real / np.abs(impedance)
    strongest = np.argsort(np.abs(cosine))[-max(3, cosine.size // 20) :]
    return bool(np.mean(cosine < -0.05) > 0.25 or (np.median(cosine[strongest]) < 0 and np.mean(cosine < 0) > 0.5))


def _resistive_share(impedance: np.ndarray) -> float:
    """Median of |Re Z| / |Z|: near 0 for a capacitor or inductor, 1 for a resistor."""
    return float(np.median(np.abs(impedance.real) / np.abs(impedance)))
