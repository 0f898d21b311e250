"""The exact 1-D k31 bar (METHOD section 7), independent of femu_piezo."""

from __future__ import annotations

import numpy as np


def charge(omega: np.ndarray, size: tuple[float, float, float], density: float, s11, d31, eps33) -> np.ndarray:
    """(n,) F: Y/(jω) = (L w/t) [ε33T − d31²/s11 + (d31²/s11) tan X/X], X = (ωL/2) sqrt(ρ s11), at ω in rad/s.

    size : length, width, thickness, m
    """
    length, width, thickness = size
    x = omega * length / 2 * np.sqrt(density * s11)
    k = d31**2 / s11
    return length * width / thickness * (eps33 - k + k * np.tan(x) / x)


def impedance(omega: np.ndarray, *bar) -> np.ndarray:
    """(n,) ohm: Z of the same bar."""
    return 1 / (1j * omega * charge(omega, *bar))
