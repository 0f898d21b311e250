"""Losses of residuals, some of them robust against outliers, and the noise level of a fit with a loss."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from femu_piezo.measurement.discrepancy import noise_level

#: Loss ρ of a squared residual z, its weight ρ', and a power n with which ρ'ⁿ z of a robust loss is never far above 1.
_Curve = Callable[[np.ndarray], np.ndarray]
LOSS: dict[str, tuple[_Curve, _Curve, int]] = {
    "linear": (lambda z: z, np.ones_like, 1),
    "soft_l1": (lambda z: 2 * (np.sqrt(1 + z) - 1), lambda z: (1 + z) ** -0.5, 2),
    "huber": (lambda z: np.where(z <= 1, z, 2 * np.sqrt(z) - 1), lambda z: np.maximum(z, 1.0) ** -0.5, 2),
    "cauchy": (np.log1p, lambda z: 1 / (1 + z), 1),
}


def weight_of(loss: str, residual: np.ndarray) -> np.ndarray:
    """ρ' (m,) of residuals (m,) in units of the noise."""
    return LOSS[loss][1](residual**2)


def level_of(squares: np.ndarray, weight: np.ndarray | float, loss: str, freedom: float, level_std: float) -> float:
    """Noise level of squared residuals ρ' z (m,), which contain the weights ρ' (m,) of a loss.

    For normal noise the mean of ρ'ⁿ z is known. So a robust fit finds the level of the noise, whatever outliers there
    are (Huber's second proposal, Ann. Math. Statist. 35 (1964) 73).
    """
    power = LOSS[loss][2]
    return float(noise_level(float(np.sum(squares * weight ** (power - 1))) / _normal(loss), freedom, level_std))


@cache
def _normal(loss: str) -> float:
    """E[ρ'ⁿ z] of squares z of normal residuals of deviation 1."""
    at = np.linspace(-8, 8, 2001)
    return float(np.average(weight_of(loss, at) ** LOSS[loss][2] * at**2, weights=np.exp(-0.5 * at**2)))
