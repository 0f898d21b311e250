"""`CurvedHexahedra`: extruded plane cells with curved sides, whose maps are polynomials of high order.

scikit-fem keeps the vertices and their topology. The map of a cell is a plane map of x, y and a map of z, both in
Chebyshev polynomials of so high an order that the error of the geometry is below that of the elements.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import skfem
from numpy.polynomial import chebyshev
from skfem.mapping import MappingIsoparametric


@dataclass(repr=False)
class CurvedHexahedra(skfem.MeshHex1):
    """A hexahedral mesh with a smooth map of each cell: x, y of the first two reference coordinates, z of the third.

    Attributes
    ----------
    plane : (2, cells, i, j) Chebyshev coefficients of x, y in 2X_0 − 1 and 2X_1 − 1, m; the corners are the vertices
    height : (cells, k) Chebyshev coefficients of z in 2X_2 − 1, m
    """

    plane: np.ndarray = field(default_factory=lambda: np.zeros((2, 0, 1, 1)))
    height: np.ndarray = field(default_factory=lambda: np.zeros((0, 1)))

    def _mapping(self) -> CurvedMapping:
        if not hasattr(self, "_cached_mapping"):
            self._cached_mapping = CurvedMapping(self)
        return self._cached_mapping


class CurvedMapping(MappingIsoparametric):
    """The maps of a `CurvedHexahedra` mesh, with their derivatives, as scikit-fem asks for them."""

    def __init__(self, mesh: CurvedHexahedra) -> None:
        super().__init__(mesh, mesh.elem(), mesh.bndelem)
        #: Coefficients of x, y and of z (None), and of their derivatives along the reference axes on which they depend.
        self._planes = {None: mesh.plane} | {j: 2 * chebyshev.chebder(mesh.plane, axis=j + 2) for j in range(2)}
        self._heights = {None: mesh.height, 2: 2 * chebyshev.chebder(mesh.height, axis=1)}
        corners = self.F(mesh.elem.refdom.p.astype(float))
        if not np.allclose(corners, mesh.p[:, mesh.t].transpose(0, 2, 1), rtol=0, atol=1e-9 * np.ptp(mesh.p)):
            raise ValueError("the vertices of a curved mesh were moved without its maps")

    def F(self, X: np.ndarray, tind: np.ndarray | None = None) -> np.ndarray:
        """(3, cells, points) coordinates of reference points (3, points), or (3, cells, points) of each cell, m."""
        return self._maps(X, tind, None)

    def DF(self, X: np.ndarray, tind: np.ndarray | None = None, J=None) -> np.ndarray:
        """(3, 3, cells, points) ∂x_i/∂X_j."""
        return np.array(J) if J is not None else np.stack([self._maps(X, tind, j) for j in range(3)], axis=1)

    def J(self, i: int, j: int, X: np.ndarray, tind: np.ndarray | None = None) -> np.ndarray:
        """(cells, points) ∂x_i/∂X_j; the Jacobians of the latest points are kept."""
        asked, latest = (X, tind), getattr(self, "_latest", None)
        if latest is None or any(old is not new for old, new in zip(latest[0], asked, strict=True)):
            self._latest = latest = asked, self.DF(X, tind)
        return latest[1][i, j]

    def G(self, X: np.ndarray, find: np.ndarray | None = None) -> np.ndarray:
        """(3, facets, points) coordinates, m, of points (2, points) of the reference facet; the latest are kept."""
        cells, at, _ = self._on_facets(X, find)
        places = self.F(at, cells)
        self._placed = places, cells, at
        return places

    def detDG(self, X: np.ndarray, find: np.ndarray | None = None) -> np.ndarray:
        """(facets, points) area of a facet over that of the reference facet, m²."""
        cells, at, along = self._on_facets(X, find)
        tangents = np.einsum("ijfp,kjfp->kifp", self.DF(at, cells), along)
        return np.linalg.norm(np.cross(tangents[0], tangents[1], axis=0), axis=0)

    def invF(self, x: np.ndarray, tind: np.ndarray | None = None) -> np.ndarray:
        """(3, cells, points) reference points of coordinates in given cells.

        They are known for the latest result of `G`, which a basis on facets passes back; else Newton's method is used.
        """
        places, cells, at = getattr(self, "_placed", (None, None, None))
        if x is places and tind is not None and np.array_equal(tind, cells):
            return at
        return super().invF(x, tind, newton_tol=1e-9)

    def _on_facets(self, X: np.ndarray, find: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The cell (facets,) of each facet, its reference points (3, facets, points), and their slopes (2, 3, …)."""
        mesh = self.mesh
        find = np.arange(mesh.facets.shape[1]) if find is None else np.asarray(find)
        cells = mesh.f2t[0, find]
        local = np.argmax(mesh.t[:, None, cells] == mesh.facets[:, find], axis=0)  # (4, facets) corners in the cell
        corners = mesh.elem.refdom.p.astype(float)[:, local]
        shapes = [self.bndelem.lbasis(X, i) for i in range(4)]
        at = sum(corners[:, i, :, None] * value for i, (value, _) in enumerate(shapes))
        along = [sum(corners[:, i, :, None] * slope[k] for i, (_, slope) in enumerate(shapes)) for k in range(2)]
        return cells, at, np.array(along)

    def _maps(self, X: np.ndarray, tind: np.ndarray | None, derivative: int | None) -> np.ndarray:
        """(3, cells, points) x, y = Σ c_ab T_a(X_0) T_b(X_1) and z = Σ c_k T_k(X_2), or their slopes along one axis."""
        plane, height = self._planes.get(derivative), self._heights.get(derivative)
        cells = slice(None) if tind is None else tind
        at = 2 * np.asarray(X, dtype=float) - 1
        found = np.zeros((3, self.mesh.height[cells].shape[0], at.shape[-1]))
        if plane is not None:
            first, second = (chebyshev.chebvander(at[axis], plane.shape[axis + 2] - 1) for axis in range(2))
            between = first @ plane[:, cells]
            found[:2] = np.einsum("icpb,cpb->icp", between, np.broadcast_to(second, between.shape[1:]))
        if height is not None:
            found[2] = (chebyshev.chebvander(at[2], height.shape[1] - 1) @ height[cells, :, None])[..., 0]
        return found
