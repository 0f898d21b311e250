"""The part of c^E that remains where a body is free of stress on planes across an axis."""

from __future__ import annotations

import numpy as np


def unstressed(whole: np.ndarray, axis: int) -> np.ndarray:
    """c_abcd − c_abkn (c_knln)^-1 c_lncd (4, 3, 4, 3) of an extended tensor, n the axis: c^E at T_kn = 0, no field."""
    c = whole[:3, :, :3]
    found = np.zeros_like(whole)
    normal = np.linalg.inv(c[:, axis, :, axis])
    found[:3, :, :3] = c - np.einsum("iak,kl,ljb->iajb", c[:, :, :, axis], normal, c[:, axis])
    return found
