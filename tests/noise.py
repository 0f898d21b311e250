"""Circular complex Gaussian noise of known size, as an ideal instrument adds it to an impedance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np


def circular_noise(count: int, std, seed) -> np.ndarray:
    """(count,) complex errors e with sqrt(E|e|²) = `std`, one number or (count,).

    seed : of a generator of its own, or a generator that draws them
    """
    real, imag = np.random.default_rng(seed).standard_normal((2, count))
    return std * (real + 1j * imag) / np.sqrt(2)


def with_noise(z: np.ndarray, std, seed) -> np.ndarray:
    """Z (n,) plus errors of `std`, ohm."""
    return z + circular_noise(z.size, std, seed)


def noisy(z: np.ndarray, level: float, seed) -> np.ndarray:
    """Z (n,) with errors of `level` relative to it."""
    return z * (1 + circular_noise(z.size, level, seed))


def noisy_sweep(sweep, level: float, seed):
    """The sweep with errors of `level` relative to its impedance."""
    return replace(sweep, impedance=noisy(sweep.impedance, level, seed))
