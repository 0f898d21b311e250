"""Poles and zeros: the small type that extraction and simulation share.

A *pole* is a pole of the admittance Y (series resonance, short circuit); a *zero* is a zero of Y, that is a
pole of Z (parallel resonance, open circuit). Both are described by the eigenvalue λ = ω²(1 + jη) of Cong et
al. (2022), eq 14.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

Kind = Literal["pole", "zero"]


@dataclass(frozen=True, repr=False)
class Resonance:
    """One pole or zero of an impedance function.

    Attributes
    ----------
    kind : "pole" (of Y, short circuit) or "zero" (of Y, open circuit)
    eigenvalue : complex λ = ω²(1 + jη), rad²/s²
    covariance : (2, 2) covariance of (Re λ, Im λ), rad⁴/s⁴; None where no uncertainty is known
    residue : complex residue of Y at a pole (S·rad/s) or of Z at a zero (Ω·rad/s), at the point p = j√λ of the upper
        half plane (`pole_s`), time factor e^{jωt}; None where unknown
    """

    kind: Kind
    eigenvalue: complex
    covariance: np.ndarray | None = None
    residue: complex | None = None

    def __repr__(self) -> str:
        return f"Resonance({self.kind!r}, {self.frequency_Hz:.8g} Hz, loss {self.loss:.5g})"

    @property
    def frequency_Hz(self) -> float:
        """sqrt(Re λ) / 2π, Hz."""
        return float(np.sqrt(np.real(self.eigenvalue)) / (2 * np.pi))

    @property
    def loss(self) -> float:
        """η = Im λ / Re λ (eq 14), dimensionless; 1/Q for small loss."""
        return float(np.imag(self.eigenvalue) / np.real(self.eigenvalue))

    @property
    def quality_factor(self) -> float:
        """Q = 1/η."""
        return 1.0 / self.loss

    @property
    def pole_s(self) -> complex:
        """Laplace-plane point p with p² = −λ in the upper half plane, rad/s (p ≈ −ωη/2 + jω)."""
        return complex(1j * np.sqrt(complex(self.eigenvalue)))

    @property
    def std_Hz(self) -> float | None:
        """Standard deviation of `frequency_Hz`, Hz, to first order."""
        if self.covariance is None:
            return None
        slope = 1.0 / (2 * (2 * np.pi) ** 2 * self.frequency_Hz)
        return float(np.sqrt(self.covariance[0, 0]) * slope)

    @property
    def std_loss(self) -> float | None:
        """Standard deviation of `loss`, to first order."""
        if self.covariance is None:
            return None
        real, imag = np.real(self.eigenvalue), np.imag(self.eigenvalue)
        gradient = np.array([-imag / real**2, 1.0 / real])
        return float(np.sqrt(gradient @ self.covariance @ gradient))

    def to_json(self) -> dict[str, float | None]:
        """The contract's record of one resonance: frequency, loss and their standard deviations."""
        return {
            "frequency_Hz": self.frequency_Hz,
            "loss": self.loss,
            "std_Hz": self.std_Hz,
            "std_loss": self.std_loss,
        }


@dataclass(frozen=True)
class ResonanceSet:
    """Poles and zeros in order of frequency, with their joint covariance.

    `covariance` is over (Re λ, Im λ) of the poles, then of the zeros, shape (2(n_p+n_z), 2(n_p+n_z)),
    rad⁴/s⁴; None where unknown. `notes` are sentences about what is missing or doubtful.
    """

    poles: tuple[Resonance, ...]
    zeros: tuple[Resonance, ...]
    covariance: np.ndarray | None = field(default=None, repr=False)
    notes: tuple[str, ...] = ()


def effective_coupling(pole: Resonance, zero: Resonance) -> float:
    """k_eff = sqrt(1 − Re λ_pole / Re λ_zero), IEEE 176 effective coupling factor of one pole-zero pair.

    Returns nan where the zero lies below its pole (these two are no pair).
    """
    ratio = np.real(pole.eigenvalue) / np.real(zero.eigenvalue)
    return float(np.sqrt(1 - ratio)) if ratio <= 1 else float("nan")
