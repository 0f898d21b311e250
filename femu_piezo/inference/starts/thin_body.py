"""Start values from the one-dimensional bar formulas of the IEEE standard, so that no user has to guess.

The pole of a thin k31 bar is that of s11, the zero of a slender k33 bar that of s33^D, and the pole of a thin disk that
of s11 and σ = −s12/s11; the couplings follow from pole and zero (`femu_piezo.standards.formulas`).
"""

from __future__ import annotations

import numpy as np

from femu_piezo.material.simplified import Poling
from femu_piezo.standards.formulas import (
    Number,
    disk_root,
    longitudinal_coupling,
    longitudinal_share,
    planar_coupling,
    planar_share,
    transverse_coupling,
    transverse_share,
)


def bar_coupling(poling: Poling, pole_Hz: Number, zero_Hz: Number) -> Number:
    """k31² (poling "thickness") or k33² ("length") of a bar with this pole and zero, complex with losses."""
    return (longitudinal_coupling if poling == "length" else transverse_coupling)(pole_Hz, zero_Hz)


def bar_start(
    poling: Poling, length: float, density: float, pole_Hz: Number, zero_Hz: Number, eps33T: Number
) -> dict[str, Number]:
    """s11 and d31 (poling "thickness") or s33 and d33 ("length") of a bar with this pole and zero.

    Parameters
    ----------
    length : m; density : kg/m³; eps33T : F/m;  pole_Hz, zero_Hz : √λ/2π; complex λ and ε give complex constants

    Returns
    -------
    name → SI value; d31 negative, d33 positive, as in every common ceramic
    """
    k2 = bar_coupling(poling, pole_Hz, zero_Hz)
    if poling == "thickness":
        s11 = 1 / (4 * density * length**2 * pole_Hz**2)
        return {"s11": s11, "d31": -np.sqrt(k2 * s11 * eps33T)}
    s33 = 1 / (4 * density * length**2 * zero_Hz**2 * (1 - k2))
    return {"s33": s33, "d33": np.sqrt(k2 * s33 * eps33T)}


def bar_permittivity(
    poling: Poling, pole_Hz: float, zero_Hz: float, frequency_Hz: float, admittance: complex, gap: float, area: float
) -> float:
    """ε33T of a bar with this pole and zero from one point of its sweep away from both, F/m.

    Solves Im Y = ω ε33T A/d C(f)/C^T for ε33T, with `transverse_share` for k31 and `longitudinal_share` for k33.
    """
    k2 = bar_coupling(poling, pole_Hz, zero_Hz)
    if poling == "thickness":
        share = transverse_share(np.pi / 2 * frequency_Hz / pole_Hz, k2)
    else:
        share = longitudinal_share(np.pi / 2 * frequency_Hz / zero_Hz, k2)
    return float(admittance.imag * gap / (2 * np.pi * frequency_Hz * area * share))


def disk_start(
    radius: float, density: float, poisson: float, pole_Hz: Number, zero_Hz: Number, eps33T: Number
) -> dict[str, Number]:
    """s11, s12 and d31 of a thin disk with this pole and zero of its first radial mode, complex as by `bar_start`.

    Parameters
    ----------
    radius : m; density : kg/m³; poisson : σ = −s12/s11, which one pole and one zero do not tell; eps33T : F/m

    Returns
    -------
    name → SI value; s12 = −σ s11, d31 negative
    """
    root, kp2 = disk_root(poisson), planar_coupling(poisson, pole_Hz, zero_Hz)
    s11 = (root / (2 * np.pi * pole_Hz * radius)) ** 2 / (density * (1 - poisson**2))
    return {
        "s11": s11,
        "s12": -poisson * s11,
        "d31": -np.sqrt(kp2 * s11 * (1 - poisson) * eps33T / 2),
    }


def disk_permittivity(
    poisson: float, pole_Hz: float, zero_Hz: float, frequency_Hz: float, admittance: complex, gap: float, area: float
) -> float:
    """ε33T of a thin disk with this pole and zero from one point of its sweep away from both, F/m.

    Solves Im Y = ω ε33T A/d C(f)/C^T for ε33T, with `planar_share`.
    """
    eta = disk_root(poisson) * frequency_Hz / pole_Hz
    share = planar_share(eta, poisson, planar_coupling(poisson, pole_Hz, zero_Hz))
    return float(admittance.imag * gap / (2 * np.pi * frequency_Hz * area * share))


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
