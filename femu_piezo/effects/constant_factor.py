"""One constant has another value: θ → θ (1 + p)(1 − j t)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ConstantFactor:
    """The hook of an effect that multiplies one of the ten constants, that of number `index`."""

    index: int

    def __call__(
        self, theta: np.ndarray, tangents: np.ndarray, omega: np.ndarray, p: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As `femu_piezo.effects.effect.ConstantsHook`."""
        slopes = np.zeros((*theta.shape, 2), dtype=complex)
        theta, tangents, by_p = multiplied(theta, tangents, np.array([self.index]), np.asarray(p)[None])
        slopes[:, self.index] = by_p[:, 0]
        return theta, tangents, slopes


def multiplied(
    theta: np.ndarray, tangents: np.ndarray, which: np.ndarray, p: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Constants (k, 10) and tangents (k, 10, n) with some constants multiplied, and slopes (k, m, 2) in p and t.

    which : (m,) their numbers;  p : (m, 2) p and t of each
    """
    real, turn, before = 1 + p[:, 0], 1 - 1j * p[:, 1], theta[:, which]
    theta, tangents = theta.copy(), tangents.copy()
    theta[:, which] = before * (real * turn)
    tangents[:, which] *= (real * turn)[:, None]
    return theta, tangents, np.stack([before * turn, -1j * before * real], axis=2)
