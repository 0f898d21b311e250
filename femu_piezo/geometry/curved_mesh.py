"""`CurvedHexahedra`: hexahedra whose cells are curved as exactly as polynomials of high order can be.

scikit-fem keeps the vertices and their topology; how a cell fills the space between them is a tensor product of
Chebyshev polynomials, so elements of any order find a geometry that is more exact than they are.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import skfem
from numpy.polynomial import chebyshev
from skfem.mapping import MappingIsoparametric

#: Order of the polynomials along an arc: a quarter turn is followed to 1e-12 of its radius.
GEOMETRY_ORDER = 10


@dataclass(repr=False)
class CurvedHexahedra(skfem.MeshHex1):
    """A hexahedral mesh with a smooth map of each cell.

    Attributes
    ----------
    maps : (3, cells, i, j, k) Chebyshev coefficients of x, y, z in the reference coordinates 2X − 1 of each cell, m;
        at the corners they are the vertices
    """

    maps: np.ndarray = field(default_factory=lambda: np.zeros((3, 0, 1, 1, 1)))

    def _mapping(self) -> CurvedMapping:
        if not hasattr(self, "_cached_mapping"):
            self._cached_mapping = CurvedMapping(self)
        return self._cached_mapping


class CurvedMapping(MappingIsoparametric):
    """The maps of a `CurvedHexahedra` mesh, with their derivatives, as scikit-fem asks for them."""

    def __init__(self, mesh: CurvedHexahedra) -> None:
        super().__init__(mesh, mesh.elem(), mesh.bndelem)
        corners = self.F(mesh.elem.refdom.p.astype(float))
        if not np.allclose(corners, mesh.p[:, mesh.t].transpose(0, 2, 1), rtol=0, atol=1e-9 * np.ptp(mesh.p)):
            raise ValueError("the vertices of a curved mesh were moved without its maps")

    def F(self, X: np.ndarray, tind: np.ndarray | None = None) -> np.ndarray:
        """(3, cells, points) places of reference points (3, points), or (3, cells, points) of each cell, m."""
        return self._sum(X, tind, None)

    def DF(self, X: np.ndarray, tind: np.ndarray | None = None, J=None) -> np.ndarray:
        """(3, 3, cells, points) ∂x_i/∂X_j."""
        return np.array(J) if J is not None else np.stack([self._sum(X, tind, j) for j in range(3)], axis=1)

    def J(self, i: int, j: int, X: np.ndarray, tind: np.ndarray | None = None) -> np.ndarray:
        """(cells, points) ∂x_i/∂X_j; the last points asked for are kept."""
        asked = (X, tind)
        if not hasattr(self, "_last") or any(old is not new for old, new in zip(self._last[0], asked, strict=True)):
            self._last = asked, self.DF(X, tind)
        return self._last[1][i, j]

    def G(self, X: np.ndarray, find: np.ndarray | None = None) -> np.ndarray:
        """(3, facets, points) places of points (2, points) of the reference facet."""
        cells, at, _ = self._on_facets(X, find)
        return self.F(at, cells)

    def detDG(self, X: np.ndarray, find: np.ndarray | None = None) -> np.ndarray:
        """(facets, points) area of a facet over that of the reference facet, m²."""
        cells, at, along = self._on_facets(X, find)
        tangents = np.einsum("ijfp,kjfp->kifp", self.DF(at, cells), along)
        return np.linalg.norm(np.cross(tangents[0], tangents[1], axis=0), axis=0)

    def invF(self, x: np.ndarray, tind: np.ndarray | None = None) -> np.ndarray:
        """(3, cells, points) reference points of places in given cells, by Newton's method."""
        return super().invF(x, tind, newton_tol=1e-9)

    def _on_facets(self, X: np.ndarray, find: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The cell of each facet, the reference points there (3, facets, points), and their slopes (2, 3, …)."""
        mesh = self.mesh
        find = np.arange(mesh.facets.shape[1]) if find is None else np.asarray(find)
        cells = mesh.f2t[0, find]
        local = np.argmax(mesh.t[:, None, cells] == mesh.facets[:, find], axis=0)  # (4, facets) corners in the cell
        corners = mesh.elem.refdom.p.astype(float)[:, local]
        shapes = [self.bndelem.lbasis(X, i) for i in range(4)]
        at = sum(corners[:, i, :, None] * value for i, (value, _) in enumerate(shapes))
        along = [sum(corners[:, i, :, None] * slope[k] for i, (_, slope) in enumerate(shapes)) for k in range(2)]
        return cells, at, np.array(along)

    def _sum(self, X: np.ndarray, tind: np.ndarray | None, derivative: int | None) -> np.ndarray:
        """Σ c_abc T_a(X_0) T_b(X_1) T_c(X_2) of each cell, or its slope along one axis."""
        maps = self.mesh.maps if tind is None else self.mesh.maps[:, tind]
        if derivative is not None:
            maps = 2 * chebyshev.chebder(maps, axis=derivative + 2)
        at = 2 * np.asarray(X, dtype=float) - 1
        at = np.broadcast_to(at.reshape(3, -1, at.shape[-1]), (3, maps.shape[1], at.shape[-1]))
        lines = [chebyshev.chebvander(at[axis], maps.shape[axis + 2] - 1) for axis in range(3)]
        return np.einsum("icabd,cpa,cpb,cpd->icp", maps, *lines, optimize=True)


def polar_cells(radii: np.ndarray, angles: np.ndarray, heights: np.ndarray) -> CurvedHexahedra:
    """Cells between growing radii (m, above 0), angles (rad, a full turn at most) and heights (m)."""
    grid = (1 - np.cos(np.pi * np.arange(GEOMETRY_ORDER + 1) / GEOMETRY_ORDER)) / 2
    inverse = np.linalg.inv(chebyshev.chebvander(2 * grid - 1, GEOMETRY_ORDER))
    along = angles[:-1, None] + np.diff(angles)[:, None] * grid
    arcs = np.array([np.cos(along), np.sin(along)]) @ inverse.T  # (2, cells around, order + 1)
    linear = [np.array([line[1:] + line[:-1], np.diff(line)]).T / 2 for line in (radii, heights)]
    shape = (radii.size - 1, angles.size - 1, heights.size - 1)
    maps = np.zeros((3, *shape, 2, GEOMETRY_ORDER + 1, 2))
    maps[:2, ..., 0] = np.einsum("ri,xaj->xraij", linear[0], arcs)[:, :, :, None]
    maps[2, ..., 0, 0, :] = linear[1]
    closed = angles[-1] - angles[0] > 2 * np.pi - 1e-9
    around = np.arange(angles.size) % (angles.size - closed)
    number = np.arange(radii.size * (angles.size - closed) * heights.size).reshape(radii.size, -1, heights.size)
    ends = [np.array([line[:-1], line[1:]]) for line in (np.arange(radii.size), around, np.arange(heights.size))]
    corners = CurvedHexahedra.elem.refdom.p.astype(int)
    t = np.array([number[np.ix_(*(ends[axis][corner[axis]] for axis in range(3)))].ravel() for corner in corners.T])
    r, angle, z = np.meshgrid(radii, angles[: angles.size - closed], heights, indexing="ij")
    p = np.array([r * np.cos(angle), r * np.sin(angle), z]).reshape(3, -1)
    return CurvedHexahedra(p, t, maps=maps.reshape(3, -1, *maps.shape[4:]))
