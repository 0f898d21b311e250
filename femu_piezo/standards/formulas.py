"""The formulas of the standards: couplings and constants of thin bodies from fs, fp and the free capacitance.

IEEE Std 176-1987, section 6.4, and EN 50324-2; all are those of bodies in which one dimension alone counts. With
X = (π/2) fp/fs and Δ = fp − fs:

- k31 bar, poled across:  k31²/(1 − k31²) = (π/2)(fp/fs) tan[(π/2) Δ/fs],  s11E = 1/(4 ρ l² fs²);
- k33 bar, poled along:   k33² = (π/2)(fs/fp) tan[(π/2) Δ/fp],  s33D = 1/(4 ρ l² fp²),  s33E = s33D/(1 − k33²);
- thickness extension kt and shear k15: the same law,  c33D or c55D = 4 ρ t² fp²,  c^E = c^D (1 − k²);
- thin disk: η1 J0(η1) = (1 − σ) J1(η1),  kp²/(1 − kp²) = [(1 − σ) − η J0(η)/J1(η)]/(1 + σ) with η = η1 fp/fs,
  s11E = η1²/[(2π fs a)² ρ (1 − σ²)];
- narrow ring, breathing: k31² = 1 − (fs/fp)²,  s11E = 1/[ρ (2π fs r)²].
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from scipy.optimize import brentq
from scipy.special import jv

#: Frequencies and couplings, complex with losses: f = √λ/2π of an eigenvalue λ = ω²(1 + jη).
Number = TypeVar("Number", float, complex)


def transverse_coupling(fs: Number, fp: Number) -> Number:
    """k² of a body excited across its length (k31): k²/(1 − k²) = (π/2)(fp/fs) tan[(π/2)(fp − fs)/fs]."""
    ratio = np.pi / 2 * fp / fs * np.tan(np.pi / 2 * (fp - fs) / fs)
    return (ratio / (1 + ratio)).item()


def longitudinal_coupling(fs: Number, fp: Number) -> Number:
    """k² of a body excited along its motion (k33, kt, k15): k² = (π/2)(fs/fp) tan[(π/2)(fp − fs)/fp]."""
    return (np.pi / 2 * fs / fp * np.tan(np.pi / 2 * (fp - fs) / fp)).item()


def disk_root(poisson: float, overtone: int = 0) -> float:
    """η of a radial pole of a thin disk, the fundamental at 0: η J0(η) = (1 − σ) J1(η)."""

    def mismatch(eta: float) -> float:
        return eta * jv(0, eta) - (1 - poisson) * jv(1, eta)

    bounds = ((0.5, 2.4048), (3.8317, 5.5201))[overtone]
    return float(brentq(mismatch, *bounds, xtol=1e-14))


def planar_coupling(poisson: float, fs: Number, fp: Number) -> Number:
    """kp² of a thin disk from its fundamental: kp²/(1 − kp²) = [(1 − σ) − η J0(η)/J1(η)]/(1 + σ), η = η1 fp/fs."""
    eta = disk_root(poisson) * fp / fs
    odds = ((1 - poisson) - eta * jv(0, eta) / jv(1, eta)) / (1 + poisson)
    return (odds / (1 + odds)).item()


def disk_poisson(ratio: float) -> float | None:
    """σ of a thin disk from its first overtone over its fundamental pole, fs2/fs1; None outside 0 … 0.6."""

    def mismatch(poisson: float) -> float:
        return disk_root(poisson, 1) / disk_root(poisson) - ratio

    if mismatch(0.0) * mismatch(0.6) > 0:
        return None
    return float(brentq(mismatch, 0.0, 0.6, xtol=1e-12))


def transverse_share(x: float, k2: float) -> float:
    """C(f)/C^T of a body excited across its length: 1 − k² + k² tan X/X with X = (π/2) f/fs."""
    return float(1 - k2 + k2 * np.tan(x) / x)


def longitudinal_share(x: float, k2: float) -> float:
    """C(f)/C^T of a body excited along its motion: (1 − k²)/(1 − k² tan X/X) with X = (π/2) f/fp."""
    return float((1 - k2) / (1 - k2 * np.tan(x) / x))


def planar_share(eta: float, poisson: float, k2: float) -> float:
    """C(f)/C^T of a thin disk: 1 − kp² + kp² (1 + σ) J1(η)/(η J0(η) − (1 − σ) J1(η)), η = η1 f/fs."""
    return float(1 - k2 + k2 * (1 + poisson) * jv(1, eta) / (eta * jv(0, eta) - (1 - poisson) * jv(1, eta)))


def single_mode_share(ratio: float, k2: float) -> float:
    """C(f)/C^T of a body with one mode: 1 + k² x²/(1 − x²) with x = f/fs and k² = 1 − (fs/fp)²."""
    return float(1 - k2 + k2 / (1 - ratio**2))
