"""Known complex poles and zeros of the exact 1-D k31 bar (tests/k31_bar.py), independent of femu_piezo.

Poles: cos X = 0, λ_n = ((2n−1)π/L)²/(ρ s11). Zeros: (ε33T − d31²/s11) X cos X + (d31²/s11) sin X = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from tests import k31_bar
from tests.noise import with_noise

from .bounds import Truth

EPS0 = 8.854187817e-12


@dataclass(frozen=True)
class Bar:
    """Thin narrow bar, SI units; defaults: the target plate of the paper's Table 2."""

    length: float = 40e-3
    width: float = 5e-3
    thickness: float = 1e-3
    density: float = 7900.0
    s11: complex = 15.84e-12 * (1 - 0.016j)
    d31: complex = -293.25e-12 * (1 - 0.013j)
    eps33: complex = 2422.5 * EPS0 * (1 - 0.015j)

    @property
    def _given(self) -> tuple:
        """What `k31_bar` takes."""
        return (self.length, self.width, self.thickness), self.density, self.s11, self.d31, self.eps33

    def charge(self, omega):
        """Y/(jω), farad."""
        return k31_bar.charge(omega, *self._given)

    def impedance(self, frequency):
        """Z at frequency in Hz."""
        return k31_bar.impedance(2 * np.pi * np.asarray(frequency), *self._given)

    def pole(self, n: int) -> complex:
        """λ of the n-th pole, n = 1, 2, …"""
        return ((2 * n - 1) * np.pi / self.length) ** 2 / (self.density * self.s11)

    def zero(self, n: int) -> complex:
        """λ of the n-th zero, by Newton's method on a X cos X + sin X = 0 from just above the pole."""
        a = (self.eps33 - self.d31**2 / self.s11) / (self.d31**2 / self.s11)
        x = (2 * n - 1) * np.pi / 2
        x = x + 1 / (a * x)
        for _ in range(50):
            x = x - (np.sin(x) + a * x * np.cos(x)) / (np.cos(x) + a * np.cos(x) - a * x * np.sin(x))
        return (2 * x / self.length) ** 2 / (self.density * self.s11)

    def residue_of_charge(self, n: int) -> complex:
        """R_n of Y/(jω) = C + Σ R_n/(λ_n − ω²): tan X / X = Σ 2/(X_n² − X²)."""
        scale = (self.length / 2) ** 2 * self.density * self.s11
        k = self.d31**2 / self.s11
        return self.length * self.width / self.thickness * k * 2 / scale


def sweep(bar: Bar, frequency, relative: float = 0.0, additive: float = 0.0, seed: int = 0, noise: bool = False):
    """A sweep with circular complex noise; `noise=True` puts the true noise in the spectrum."""
    z = bar.impedance(frequency)
    sigma = np.hypot(relative * np.abs(z), additive)
    return ImpedanceSpectrum(frequency, with_noise(z, sigma, seed), noise=sigma if noise else None, source="bar")


def truth_of(bar: Bar, *modes: int) -> Truth:
    """The bar as a `Truth` with the given modes inside the sweep."""
    return Truth(
        bar.charge,
        tuple(bar.pole(n) for n in modes),
        tuple(bar.residue_of_charge(n) for n in modes),
        tuple(bar.zero(n) for n in modes),
    )


def close_pair(bar: Bar, apart: float = 0.01, residue: float = 0.01) -> Truth:
    """The bar with a second mode: frequency 1 + `apart` times the fundamental, `residue` times its residue."""
    second = bar.pole(1) * (1 + apart) ** 2
    strength = residue * bar.residue_of_charge(1)

    def charge(omega):
        return bar.charge(omega) + strength / (second - omega**2)

    def zero(start: complex) -> complex:
        value = start
        for _ in range(60):
            step = 1e-6 * value
            slope = (charge(np.sqrt(value + step)) - charge(np.sqrt(value - step))) / (2 * step)
            value = value - charge(np.sqrt(value)) / slope
        return value

    # at the weak pole the strong mode's field Q0 is smooth: Q0 + strength/(second − s) = 0
    weak = second + strength / bar.charge(np.sqrt(second))
    return Truth(charge, (bar.pole(1), second), (bar.residue_of_charge(1), strength), (zero(bar.zero(1)), zero(weak)))
