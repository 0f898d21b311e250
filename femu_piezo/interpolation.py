"""Interpolation between Chebyshev nodes."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BarycentricInterpolator


def chebyshev_nodes(low: float, high: float, count: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (count,) from `low` to `high`, and the weights (k, count) that interpolate from them to x (k,)."""
    cosines = np.cos(np.pi * (np.arange(count) + 0.5) / count)
    nodes = (low + high) / 2 + (high - low) / 2 * cosines
    return nodes, BarycentricInterpolator(nodes, np.eye(count), rng=0)(x)
