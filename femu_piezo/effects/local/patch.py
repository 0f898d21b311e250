"""A small round patch of a face: how the modes of a reduced body move it."""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.local.faces import Face
from femu_piezo.threads import made_once

#: Usual radius of a patch, over the length of the body; the smallest and the largest radius, over the usual one.
PATCH, SMALLEST, LARGEST = 1 / 25, 1 / 5, 6.0
#: Gauss points over a patch, and their weights.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)


def spread_points(face: Face, x: float, y: float, radius: float, shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """N (m, 3, u) at points (x, y) + radius · shares (m, 2), and its slopes in x, y, radius (m, 3, 3, u)."""
    values, along = face.at_all((x, y) + radius * shares)
    grown = np.einsum("gd,gdcu->gcu", shares, along)
    return values, np.concatenate([along, grown[:, None]], axis=1)


class Patch:
    """Means over a patch, a square of the area of a disk of the radius, by Gauss points; slopes in x, y and the radius.

    Attributes
    ----------
    mean : (3, u) mean of N;  mean_slopes : (3, 3, u) of it in x, y, radius
    """

    def __init__(self, face: Face, x: float, y: float, radius: float) -> None:
        shares = np.stack(np.meshgrid(*2 * [_NODES], indexing="ij"), axis=-1).reshape(-1, 2) * np.sqrt(np.pi) / 2
        self._weights = np.multiply.outer(_WEIGHTS, _WEIGHTS).ravel() / 4
        self._values, self._moved = spread_points(face, x, y, radius, shares)
        self.mean = np.tensordot(self._weights, self._values, axes=1)
        self.mean_slopes = np.tensordot(self._weights, self._moved, axes=1)

    @made_once
    def spread(self) -> np.ndarray:
        """(u, u) mean of NᵗN less the product of the means ⟨N⟩ᵗ⟨N⟩."""
        around = self._values - self.mean
        return np.einsum("g,gcu,gcv->uv", self._weights, around, around, optimize=True)

    @made_once
    def spread_slopes(self) -> np.ndarray:
        """(3, u, u) slopes of `spread` in x, y, radius."""
        around, away = self._values - self.mean, self._moved - self.mean_slopes
        half = np.einsum("g,gdcu,gcv->duv", self._weights, away, around, optimize=True)
        return half + half.transpose(0, 2, 1)
