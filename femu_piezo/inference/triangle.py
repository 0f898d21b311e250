"""Triangular systems of small size, by LAPACK itself: the wrapper of scipy takes ten times as long as the solution."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dtrtrs


def solved(triangle: np.ndarray, right: np.ndarray, *, transposed: bool = False) -> np.ndarray:
    """x (n,) or (n, k) of R x = right, or of Rᵗ x = right, for an upper triangle R (n, n).

    Raises numpy.linalg.LinAlgError where R is singular, ValueError where a number is not finite.
    """
    if not triangle.size or not right.size:
        return np.zeros(np.shape(right))
    found, singular = dtrtrs(triangle, right, trans=int(transposed))
    if singular:
        raise np.linalg.LinAlgError(f"the triangle is singular at row {singular}")
    if not np.all(np.isfinite(found)):
        raise ValueError("a triangular system must not contain infs or NaNs")
    return found
