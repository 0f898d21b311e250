"""Closed forms of thin bodies: the radial modes of a thin disk, and first frequencies of thin rings and bars.

Thin disk poled through its thickness (IEEE Std 176-1987, section 4.1.3; Mason 1948): with the planar constants

    σ = −s12/s11,  c11p = 1/(s11 (1 − σ²)),  kp² = 2 d31² / ((s11 + s12) ε33T),  εp = ε33T (1 − kp²),
    η = ω a sqrt(ρ / c11p),   Y = jω (π a²/t) εp [1 + kp²/(1 − kp²) · (1 + σ) J1(η) / (η J0(η) − (1 − σ) J1(η))],

exact for complex constants. Poles: η J0(η) = (1 − σ) J1(η).
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq
from scipy.special import jv

from femu_piezo.errors import ConvergenceError
from femu_piezo.material.constants import PiezoConstants

#: Ratio of the inner to the outer diameter from which a ring counts as narrow.
NARROW_RING = 0.3


def _planar(constants: PiezoConstants) -> tuple[complex, complex, complex]:
    """σ, 1/c11p and kp²."""
    sigma = -constants.s12 / constants.s11
    return sigma, constants.s11 * (1 - sigma**2), constants.coupling["kp"] ** 2


def thin_disk_admittance(
    constants: PiezoConstants, density: float, radius: float, thickness: float, frequency_Hz: np.ndarray
) -> np.ndarray:
    """Y of a thin disk at real frequencies (n,), siemens, complex constants."""
    omega = 2 * np.pi * np.asarray(frequency_Hz, dtype=float)
    sigma, compliance, kp2 = _planar(constants)
    eta = omega * radius * np.sqrt(density * compliance)
    fraction = (1 + sigma) * jv(1, eta) / (eta * jv(0, eta) - (1 - sigma) * jv(1, eta))
    clamped = constants.eps33T * (1 - kp2) * np.pi * radius**2 / thickness
    return 1j * omega * clamped * (1 + kp2 / (1 - kp2) * fraction)


def thin_disk_eigenvalues(
    constants: PiezoConstants, density: float, radius: float, count: int, circuit: str = "short"
) -> np.ndarray:
    """The first λ (count,) complex, rad²/s², of the radial modes: "short" the poles of Y, "open" its zeros."""
    sigma, compliance, kp2 = _planar(constants)
    factor = (1 - sigma) if circuit == "short" else (1 - sigma) - (1 + sigma) * kp2 / (1 - kp2)

    def mismatch(eta: complex, factor: complex) -> complex:
        return eta * jv(0, eta) - factor * jv(1, eta)

    grid = np.arange(0.05, 3.3 * count + 3.0, 0.05)
    signs = np.sign(mismatch(grid, factor.real))
    starts = np.flatnonzero(signs[1:] != signs[:-1])[:count]
    roots = [
        _newton(lambda eta: mismatch(eta, factor), brentq(mismatch, grid[i], grid[i + 1], args=(factor.real,)))
        for i in starts
    ]
    return np.array(roots) ** 2 / (radius**2 * density * compliance)


def _newton(function, start: float) -> complex:
    """The complex root of an entire function near a real start, by Newton's method with central differences of 1e-6."""
    eta = complex(start)
    for _ in range(30):
        slope = (function(eta + 1e-6) - function(eta - 1e-6)) / 2e-6
        step = function(eta) / slope
        eta -= step
        if abs(step) < 1e-13 * abs(eta):
            return eta
    raise ConvergenceError(f"the root of the thin-disk equation near {start:.6g} was not found; is the loss realistic?")


def thin_disk_frequency(constants: PiezoConstants, density: float, radius: float) -> float:
    """Frequency of the first radial pole without loss, Hz."""
    eigenvalue = thin_disk_eigenvalues(constants.lossless(), density, radius, 1)[0]
    return float(np.sqrt(eigenvalue.real) / (2 * np.pi))


def thin_ring_frequency(constants: PiezoConstants, density: float, mean_radius: float) -> float:
    """Frequency of the breathing mode of a narrow ring, Hz: hoop stress only, ω = 1/(r sqrt(ρ s11))."""
    return float(1 / (2 * np.pi * mean_radius * np.sqrt(density * constants.s11.real)))


def thin_bar_frequency(compliance: complex, density: float, length: float) -> float:
    """Frequency of the first extensional mode of a thin bar, Hz: 1 / (2 L sqrt(ρ s))."""
    return float(1 / (2 * length * np.sqrt(density * complex(compliance).real)))
