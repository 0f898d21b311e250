"""Start values from the one-dimensional bar formulas of the IEEE standard, so that no user has to guess.

Thin k31 bar: the pole is that of s11, and k31²/(1 − k31²) = (π/2)(f_z/f_p) tan[(π/2)(f_z − f_p)/f_p].
Slender k33 bar: the zero is that of s33^D, and k33² = (π/2)(f_p/f_z) tan[(π/2)(f_z − f_p)/f_z].
(IEEE Std 176-1987, sections 6.4.1 and 6.4.2.)
Thin disk: with σ = −s12/s11 and η = ω a sqrt(ρ s11 (1 − σ²)), the pole is η J0(η) = (1 − σ) J1(η), and at the zero
kp²/(1 − kp²) = [(1 − σ) − η J0(η)/J1(η)]/(1 + σ)  (the same, section 4.1.3; `femu_piezo.forward.thin_limits`).
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq
from scipy.special import jv

from femu_piezo.material.simplified import Poling


def bar_coupling(poling: Poling, pole_Hz: float, zero_Hz: float) -> float:
    """k31² (poling "thickness") or k33² ("length") of a bar with this pole and zero."""
    half = np.pi / 2
    if poling == "length":
        return float(half * pole_Hz / zero_Hz * np.tan(half * (zero_Hz - pole_Hz) / zero_Hz))
    ratio = half * zero_Hz / pole_Hz * np.tan(half * (zero_Hz - pole_Hz) / pole_Hz)
    return float(ratio / (1 + ratio))


def bar_start(
    poling: Poling, length: float, density: float, pole_Hz: float, zero_Hz: float, eps33T: float
) -> dict[str, float]:
    """Real s11 and d31 (poling "thickness") or s33 and d33 ("length") of a bar with this pole and zero.

    Parameters
    ----------
    length : m; density : kg/m³; eps33T : F/m

    Returns
    -------
    name → SI value; d31 negative, d33 positive, as in every common ceramic
    """
    k2 = bar_coupling(poling, pole_Hz, zero_Hz)
    if poling == "thickness":
        s11 = 1 / (4 * density * length**2 * pole_Hz**2)
        return {"s11": s11, "d31": -float(np.sqrt(k2 * s11 * eps33T))}
    s33 = 1 / (4 * density * length**2 * zero_Hz**2 * (1 - k2))
    return {"s33": s33, "d33": float(np.sqrt(k2 * s33 * eps33T))}


def bar_permittivity(
    poling: Poling, pole_Hz: float, zero_Hz: float, frequency_Hz: float, admittance: complex, gap: float, area: float
) -> float:
    """ε33T of a bar with this pole and zero from one point of its sweep away from both, F/m.

    Solves the bar formulas below for ε33T: Im Y = ω ε33T A/d [1 − k² + k² tan X/X] with X = (π/2) f/f_p for k31,
    Im Y = ω ε33T A/d (1 − k²)/[1 − k² tan X/X] with X = (π/2) f/f_z for k33.
    """
    k2 = bar_coupling(poling, pole_Hz, zero_Hz)
    if poling == "thickness":
        x = np.pi / 2 * frequency_Hz / pole_Hz
        share = 1 - k2 + k2 * np.tan(x) / x
    else:
        x = np.pi / 2 * frequency_Hz / zero_Hz
        share = (1 - k2) / (1 - k2 * np.tan(x) / x)
    return float(admittance.imag * gap / (2 * np.pi * frequency_Hz * area * share))


def disk_start(
    radius: float, density: float, poisson: float, pole_Hz: float, zero_Hz: float, eps33T: float
) -> dict[str, float]:
    """Real s11, s12 and d31 of a thin disk with this pole and zero of its first radial mode.

    Parameters
    ----------
    radius : m; density : kg/m³; poisson : σ = −s12/s11, which one pole and one zero do not tell; eps33T : F/m

    Returns
    -------
    name → SI value; s12 = −σ s11, d31 negative
    """
    root, kp2 = _disk_root_and_coupling(poisson, zero_Hz / pole_Hz)
    s11 = (root / (2 * np.pi * pole_Hz * radius)) ** 2 / (density * (1 - poisson**2))
    return {
        "s11": float(s11),
        "s12": float(-poisson * s11),
        "d31": -float(np.sqrt(kp2 * s11 * (1 - poisson) * eps33T / 2)),
    }


def disk_permittivity(
    poisson: float, pole_Hz: float, zero_Hz: float, frequency_Hz: float, admittance: complex, gap: float, area: float
) -> float:
    """ε33T of a thin disk with this pole and zero from one point of its sweep away from both, F/m.

    Im Y = ω ε33T A/d [1 − kp² + kp² (1 + σ) J1(η)/(η J0(η) − (1 − σ) J1(η))].
    """
    root, kp2 = _disk_root_and_coupling(poisson, zero_Hz / pole_Hz)
    eta = root * frequency_Hz / pole_Hz
    share = 1 - kp2 + kp2 * (1 + poisson) * jv(1, eta) / (eta * jv(0, eta) - (1 - poisson) * jv(1, eta))
    return float(admittance.imag * gap / (2 * np.pi * frequency_Hz * area * share))


def _disk_root_and_coupling(poisson: float, ratio: float) -> tuple[float, float]:
    """η of the first pole, and kp² from the zero at `ratio` times its frequency."""
    root = brentq(lambda eta: eta * jv(0, eta) - (1 - poisson) * jv(1, eta), 0.5, 2.4048)
    eta = root * ratio
    odds = ((1 - poisson) - eta * jv(0, eta) / jv(1, eta)) / (1 + poisson)
    return float(root), float(odds / (1 + odds))


def k31_bar_admittance(
    omega: np.ndarray, length: float, width: float, thickness: float, density: float, s11, d31, eps33T
) -> np.ndarray:
    """Y (n,) in siemens at ω (n,) in rad/s, exact for a thin narrow bar; dimensions and constants in SI.

    Y = jω (L w/t)[ε33T − d31²/s11 + (d31²/s11) tan X/X], X = (ωL/2) sqrt(ρ s11).
    """
    x = omega * length / 2 * np.sqrt(density * s11)
    motional = d31**2 / s11
    return 1j * omega * length * width / thickness * (eps33T - motional + motional * np.tan(x) / x)


def k33_bar_impedance(omega: np.ndarray, length: float, area: float, density: float, s33, d33, eps33T) -> np.ndarray:
    """Z (n,) in ohm at ω (n,) in rad/s, exact for a slender bar; dimensions and constants in SI.

    Z = L/(jω A ε33T (1 − k²)) [1 − k² tan X/X], X = (ωL/2) sqrt(ρ s33(1 − k²)).
    """
    k2 = d33**2 / (s33 * eps33T)
    x = omega * length / 2 * np.sqrt(density * s33 * (1 - k2))
    return length / (1j * omega * area * eps33T * (1 - k2)) * (1 - k2 * np.tan(x) / x)
