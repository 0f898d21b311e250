"""`UpperFace`: the face of a body with the largest z, where something may stick or stand."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
import skfem

#: Places on a quarter of a face that has two mirror lines; a half has twice as many, a whole four times.
_ON_A_QUARTER = 45
#: Distance of the outermost places from the edge of the box around a face, as a share of the steps between them.
_FROM_EDGE = 0.3
#: Distance over the height of a mesh within which points are at one height.
_NEAR = 1e-9


def facets_at(mesh: skfem.Mesh, z: float) -> np.ndarray:
    """Numbers of the facets of a mesh that lie at a height, m."""
    return np.flatnonzero(np.all(np.abs(mesh.p[2][mesh.facets] - z) < _NEAR * np.ptp(mesh.p[2]), axis=0))


@dataclass(frozen=True)
class UpperFace:
    """What effects at a place must know of a body that is neither a plate with three mirror planes nor round.

    Attributes
    ----------
    extents : ((x_min, x_max), (y_min, y_max)) of the part that mirror lines cut, m
    mirrors : axes of all mirror planes of the driven field, 2 among them where one lies between the electrodes
    volume : of the whole body, m³
    places : (m, 2) spread over that part of the face, m
    """

    extents: tuple[tuple[float, float], tuple[float, float]]
    mirrors: tuple[int, ...]
    volume: float
    places: np.ndarray = field(repr=False, compare=False)

    @property
    def size(self) -> float:
        """The longer side of the box around the whole face, m."""
        doubled = [2.0 if axis in self.mirrors else 1.0 for axis in range(2)]
        return max((high - low) * times for (low, high), times in zip(self.extents, doubled, strict=True))

    @classmethod
    def within(
        cls,
        extents: Iterable[float],
        mirrors: tuple[int, ...],
        volume: float,
        covers: Callable[[np.ndarray, np.ndarray], np.ndarray],
    ) -> UpperFace:
        """Of a face in the box (x_min, x_max, y_min, y_max) about the origin, m; covers : which x, y (n,) lie on it."""
        x_min, x_max, y_min, y_max = extents
        parts = tuple(
            (0.0 if axis in mirrors else float(low), float(high))
            for axis, (low, high) in enumerate(((x_min, x_max), (y_min, y_max)))
        )
        wanted = _ON_A_QUARTER * 4 // 2 ** len({0, 1} & set(mirrors))
        length, width = (high - low for low, high in parts)
        along = max(3, round(np.sqrt(wanted * length / width)))
        across = max(3, round(wanted / along))
        lines = []
        for (low, high), count in zip(parts, (along, across), strict=True):
            lines.append(low + (high - low) * (np.arange(count) + _FROM_EDGE) / (count - 1 + 2 * _FROM_EDGE))
        x, y = (grid.ravel() for grid in np.meshgrid(*lines, indexing="ij"))
        on = covers(x, y)
        return cls(parts, mirrors, volume, np.column_stack([x[on], y[on]]))
