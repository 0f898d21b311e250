"""`UpperFace`: the face of a body with the largest z, where an added mass may stick or a support may stand."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import skfem

#: Number of candidate places on a quarter of a face with two mirror lines; half a face has twice as many, a whole face
#: four times as many.
_ON_A_QUARTER = 45
#: Share of that number that has to lie on the face; where less do, the places are spread more closely over its box, up
#: to so many.
_LEAST, _MOST = 1 / 3, 1_000_000
#: Distance of the outermost places from the edge of the box around a face, as a share of the spacing of the places.
_FROM_EDGE = 0.3
#: Differences of height below this share of the height of a mesh count as zero.
_NEAR = 1e-9


def facets_at(mesh: skfem.Mesh, z: float) -> np.ndarray:
    """Numbers of the facets of a mesh that lie at a height, m."""
    return np.flatnonzero(np.all(np.abs(mesh.p[2][mesh.facets] - z) < _NEAR * np.ptp(mesh.p[2]), axis=0))


@dataclass(frozen=True)
class UpperFace:
    """The upper face of a body that is neither a plate with three mirror planes nor round, for effects at a place.

    Attributes
    ----------
    extents : ((x_min, x_max), (y_min, y_max)) of the part of the face that its mirror lines cut out, m
    mirrors : axes of all mirror planes of the driven field, including 2 where one lies at mid-height
    volume : of the whole body, m³;  height : its extent along z, m
    places : (m, 2) candidate places, spread over that part of the face, m
    """

    extents: tuple[tuple[float, float], tuple[float, float]]
    mirrors: tuple[int, ...]
    volume: float
    height: float
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
        height: float,
        covers: Callable[[np.ndarray, np.ndarray], np.ndarray],
    ) -> UpperFace:
        """The upper face of a body from its outline.

        Parameters
        ----------
        extents : box (x_min, x_max, y_min, y_max) around the face, about the origin, m
        covers : function of x, y (n,), m: which points lie on the face
        """
        x_min, x_max, y_min, y_max = extents
        parts = tuple(
            (0.0 if axis in mirrors else float(low), float(high))
            for axis, (low, high) in enumerate(((x_min, x_max), (y_min, y_max)))
        )
        wanted, places = _ON_A_QUARTER * 4 // 2 ** len({0, 1} & set(mirrors)), np.zeros((0, 2))
        count = wanted
        while len(places) < _LEAST * wanted and count < _MOST:  # of a narrow ring or frame the box is nearly empty
            grid = _grid(parts, count)
            places, count = grid[covers(*grid.T)], 2 * count
        return cls(parts, mirrors, volume, height, places)


def _grid(box: Sequence[tuple[float, float]], wanted: int) -> np.ndarray:
    """(m, 2) places spread over a box ((x_min, x_max), (y_min, y_max)), about as many as wanted."""
    length, width = (high - low for low, high in box)
    along = max(3, round(np.sqrt(wanted * length / width)))
    across = max(3, round(wanted / along))
    lines = [
        low + (high - low) * (np.arange(count) + _FROM_EDGE) / (count - 1 + 2 * _FROM_EDGE)
        for (low, high), count in zip(box, (along, across), strict=True)
    ]
    return np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
