"""Displacements on the upper face of any mesh, or at another height, at any point there."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
import skfem
from skfem.refdom import RefHex

from femu_piezo.effects.local.faces import Face, mirrored
from femu_piezo.forward.hex_element import shapes_at
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.upper_face import facets_at

#: Points along each side of a facet or element from which its extent is taken.
_SAMPLES = 5
#: Elements in which a point is looked for, the nearest first.
_CANDIDATES = 6
#: Distance over the height of the mesh within which points are the same.
_NEAR = 1e-9
#: Distance outside an element, over its size, up to which its polynomials are extrapolated.
_OUTSIDE = 0.25
#: Steps of Newton's method to the place in an element.
_STEPS = 12


class LevelOfMesh:
    """The elements of a mesh at one height: in which of them a point lies, and the shape functions there.

    Parameters
    ----------
    model : the mesh with its basis of n functions, and its mirror planes
    height : 0 for the smallest z of the mesh, 1 for the largest, where it has a face

    Attributes
    ----------
    planes : axes of all mirror planes, growing;  mirrors : those of x and y among them
    """

    def __init__(self, model: ElectroelasticModel, height: float = 1.0) -> None:
        mesh, basis = model.domain.mesh, model.basis
        lowest, self._thickness = float(mesh.p[2].min()), float(np.ptp(mesh.p[2]))
        self._basis, self._z = basis, lowest + height * self._thickness
        facets = facets_at(mesh, self._z)
        self._is_hexahedral = mesh.elem.refdom is RefHex
        cut = self._cut(mesh)
        if facets.size and not cut.size:
            self._cells, places = mesh.f2t[0, facets], mesh.mapping().G(self._samples(2), find=facets)
            self._nodes = np.flatnonzero(np.abs(basis.doflocs[2] - self._z) < _NEAR * self._thickness)
        else:
            self._cells = np.union1d(mesh.f2t[0, facets], cut)
            places = mesh.mapping().F(self._samples(3), tind=self._cells)
            self._nodes = np.unique(basis.element_dofs[:, self._cells])
        self._low, self._high = places[:2].min(axis=2), places[:2].max(axis=2)
        self._number = np.full(basis.N, -1)
        self._number[self._nodes] = np.arange(self._nodes.size)
        self.planes = tuple(sorted(model.domain.symmetry.values()))
        self.mirrors = tuple(axis for axis in self.planes if axis < 2)

    def _cut(self, mesh: skfem.Mesh) -> np.ndarray:
        """Numbers of the elements through which the plane at the height goes."""
        heights, near = mesh.p[2][mesh.t], _NEAR * self._thickness
        return np.flatnonzero((heights.min(axis=0) < self._z - near) & (heights.max(axis=0) > self._z + near))

    def _samples(self, dimension: int) -> np.ndarray:
        """(dimension, samples) points of a reference facet or element."""
        sides = np.meshgrid(*dimension * [np.linspace(0, 1, _SAMPLES)], indexing="ij")
        found = np.stack(sides).reshape(dimension, -1)
        return found if self._is_hexahedral else found[:, found.sum(axis=0) < 1 + _NEAR]

    def of(self, fields: np.ndarray) -> np.ndarray:
        """(nodes, 3, k) displacements in fields (4, n, k) at the nodes that matter at this height."""
        return np.ascontiguousarray(fields[:3, self._nodes].transpose(1, 0, 2))

    def probe(self, points: np.ndarray) -> list[sp.csr_matrix]:
        """Values and slopes along x and y, each (m, nodes), at points (m, 2) in m.

        Slightly outside the face the polynomials of the nearest element are extrapolated; farther out the values are
        those at the nearest point at which they still are.
        """
        cells, at = self._located(points)
        value, gradient = shapes_at(self._basis, at, cells)  # (functions, m), (3, functions, m)
        slopes = np.einsum("bfm,bam->afm", gradient, self._followed(at, cells))
        columns = self._number[self._basis.element_dofs[:, cells]]
        on, rows = columns >= 0, np.broadcast_to(np.arange(len(points)), columns.shape)
        shape = (len(points), self._nodes.size)
        return [sp.csr_matrix((part[on], (rows[on], columns[on])), shape=shape) for part in (value, *slopes[:2])]

    def _located(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Number of the element (m,) nearest to each point, and the reference point (3, m) in it."""
        gap = np.maximum(self._low.T - points[:, None], points[:, None] - self._high.T)
        nearest = np.argsort(np.linalg.norm(np.maximum(gap, 0.0), axis=2), axis=1)[:, :_CANDIDATES]
        cells, found, least = np.zeros(len(points), dtype=int), np.zeros((3, len(points))), np.full(len(points), np.inf)
        places = np.column_stack([points, np.full(len(points), self._z)]).T
        for candidates in nearest.T:
            outside = np.flatnonzero(least > _NEAR)  # points that lie in none of the elements tried so far
            if outside.size == 0:
                break
            tried = self._cells[candidates[outside]]
            at = self._within(places[:, outside], tried)
            away = np.linalg.norm(places[:, outside] - self._basis.mapping.F(at[:, :, None], tried)[:, :, 0], axis=0)
            distance = np.linalg.norm(np.maximum(self._beyond(at), 0.0), axis=0) + away / self._thickness
            better = distance < least[outside]
            chosen = outside[better]
            cells[chosen], found[:, chosen], least[chosen] = tried[better], at[:, better], distance[better]
        return cells, found

    def _beyond(self, at: np.ndarray) -> np.ndarray:
        """(6 or 4, m) distance of reference points (3, m) beyond each plane that bounds an element, < 0 inside."""
        upper = at - 1 if self._is_hexahedral else at.sum(axis=0, keepdims=True) - 1
        return np.concatenate([-at, upper])

    def _within(self, places: np.ndarray, cells: np.ndarray) -> np.ndarray:
        """Reference points (3, m), in elements enlarged by `_OUTSIDE`, nearest to places (3, m), by Newton's method."""
        mapping, at = self._basis.mapping, np.full((3, cells.size, 1), 1 / 3)
        for _ in range(_STEPS):
            step = np.einsum("ijkl,jkl->ikl", mapping.invDF(at, cells), places[:, :, None] - mapping.F(at, cells))
            at = np.clip(at + step, -_OUTSIDE, 1.0 + _OUTSIDE)
            if not self._is_hexahedral:
                at = at - np.maximum(at.sum(axis=0) - 1.0 - _OUTSIDE, 0.0) / 3
        return at[:, :, 0]

    def _followed(self, at: np.ndarray, cells: np.ndarray) -> np.ndarray:
        """(3, 3, m) derivative of the point that is used by the place asked for, at reference points (3, m).

        It is zero across a bounding plane of the enlarged element on which the point is held.
        """
        held = self._beyond(at) > _OUTSIDE - _NEAR
        outward = np.concatenate([-np.eye(3), np.eye(3) if self._is_hexahedral else np.ones((1, 3)) / np.sqrt(3)])
        kept = np.eye(3)[:, :, None] - np.einsum("pi,pj,pm->ijm", outward, outward, held.astype(float))
        mapping, X = self._basis.mapping, at[:, :, None]
        return np.einsum("ijm,jkm,klm->ilm", mapping.DF(X, cells)[..., 0], kept, mapping.invDF(X, cells)[..., 0])


@dataclass(frozen=True)
class MeshFace(Face):
    """Displacements at a height of a part, such as its face, and by parity at the mirror images of the part.

    Attributes
    ----------
    level : the elements at that height
    coefficients : (nodes, 3, u) of every displacement unknown
    flipped : (3, u) whether the parity of each unknown about the plane normal to an axis is not the driven one
    """

    level: LevelOfMesh
    coefficients: np.ndarray = field(repr=False)
    flipped: np.ndarray = field(repr=False)
    group: np.ndarray = field(repr=False)
    copies: int

    @property
    def bends(self) -> np.ndarray | None:
        """(u,) whether in-plane displacements are odd in z; None where no mirror plane is normal to z."""
        return self.flipped[2] if 2 in self.level.planes else None

    def at_all(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """N (m, 3, u) and its slopes ∂N/∂x, ∂N/∂y (m, 2, 3, u) at points (m, 2), m."""
        folded, parity, sign = mirrored(points, self.level.mirrors, self.flipped)
        flat = self.coefficients.reshape(self.coefficients.shape[0], -1)
        value, *slopes = ((part @ flat).reshape(len(points), 3, -1) for part in self.level.probe(folded))
        along = np.stack([slope * parity * way[:, None, None] for slope, way in zip(slopes, sign.T, strict=True)], 1)
        return value * parity, along

    def at(self, x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
        """N (3, u) and its slopes ∂N/∂x, ∂N/∂y (2, 3, u) at a point, m."""
        value, slopes = self.at_all(np.array([[x, y]]))
        return value[0], slopes[0]
