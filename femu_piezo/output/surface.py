"""The surface of a body as small triangles with displacement and potential, mirrored to the whole specimen."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import skfem

from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.curved_mesh import CurvedHexahedra

#: Electrode of a surface triangle.
BARE, HOT, GROUND = 0, 1, 2


@dataclass(frozen=True)
class Surface:
    """Triangles on the outer surface.

    Attributes
    ----------
    points : (p, 3) m;  triangles : (q, 3) indices of points;  electrode : (q,) BARE, HOT or GROUND
    displacement : (k, p, 3) complex, of k modes;  potential : (k, p) complex, V
    """

    points: np.ndarray
    triangles: np.ndarray
    electrode: np.ndarray
    displacement: np.ndarray
    potential: np.ndarray

    @property
    def extent(self) -> float:
        """Longest side of the bounding box, m."""
        return float(np.ptp(self.points, axis=0).max())


def surface_of(model: ElectroelasticModel, vectors: np.ndarray, subdivisions: int = 4) -> Surface:
    """Surface of the whole specimen with the modes `vectors` (m, k) of the model's free unknowns.

    Parameters
    ----------
    subdivisions : a facet of a quadratic hexahedron is drawn as subdivisions² squares of two triangles, one of a
        tetrahedron as (subdivisions/2)² triangles, so that shapes look curved; edges have order/2 times as many parts
        for higher orders, and twice as many for curved cells
    """
    mesh, domain = model.domain.mesh, model.domain
    cut = [mesh.boundaries[name] for name in domain.symmetry]
    outer = np.setdiff1d(mesh.boundary_facets(), np.concatenate(cut) if cut else [])
    arcs = 2 if isinstance(mesh, CurvedHexahedra) else 1
    points, triangles = _facet_grid(mesh, arcs * subdivisions * max(2, model.order) // 2)
    basis = skfem.FacetBasis(
        mesh, model.basis.elem, facets=outer, quadrature=(points, np.full(points.shape[1], 1.0 / points.shape[1]))
    )
    position = np.asarray(basis.global_coordinates()).reshape(3, -1).T
    fields = np.stack([fields_at_points(basis, model, vector) for vector in vectors.T])
    offsets = points.shape[1] * np.arange(outer.size)
    electrode = np.full(outer.size, BARE)
    for names, label in ((domain.hot, HOT), (domain.ground, GROUND)):
        for name in names:
            electrode[np.isin(outer, mesh.boundaries[name])] = label
    surface = Surface(
        points=position,
        triangles=(triangles[None] + offsets[:, None, None]).reshape(-1, 3),
        electrode=np.repeat(electrode, len(triangles)),
        displacement=fields[:, :3].transpose(0, 2, 1),
        potential=fields[:, 3],
    )
    for name, axis in domain.symmetry.items():
        surface = _mirrored(surface, axis, _plane(mesh, name, axis), antisymmetric=name in domain.ground)
    return surface


def fields_at_points(
    basis: skfem.assembly.basis.AbstractBasis, model: ElectroelasticModel, vector: np.ndarray
) -> np.ndarray:
    """(4, p) complex: u_x, u_y, u_z, φ at the points of a basis."""
    nodal = [*model.displacement(vector), model.potential(vector)]
    values = [
        np.asarray(basis.interpolate(np.ascontiguousarray(part.real)))
        + 1j * np.asarray(basis.interpolate(np.ascontiguousarray(part.imag)))
        for part in nodal
    ]
    return np.array(values).reshape(4, -1)


def _facet_grid(mesh: skfem.Mesh, n: int) -> tuple[np.ndarray, np.ndarray]:
    """(2, p) points on the reference facet and (q, 3) triangles between them; n parts of an edge of a square."""
    if mesh.elem.refdom.nnodes == 8:
        i, j = (grid.ravel() for grid in np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij"))
        at = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
        a, b, c, d = at[:-1, :-1].ravel(), at[1:, :-1].ravel(), at[1:, 1:].ravel(), at[:-1, 1:].ravel()
        return np.array([i, j]) / n, np.concatenate([np.array([a, b, c]).T, np.array([a, c, d]).T])
    n = max(1, n // 2)
    pairs = [(i, j) for i in range(n + 1) for j in range(n + 1 - i)]
    at = {pair: index for index, pair in enumerate(pairs)}
    triangles = [(at[i, j], at[i + 1, j], at[i, j + 1]) for i, j in pairs if i + j < n]
    triangles += [(at[i + 1, j], at[i + 1, j + 1], at[i, j + 1]) for i, j in pairs if i + j < n - 1]
    return np.array(pairs, dtype=float).T / n, np.array(triangles)


def _plane(mesh: skfem.Mesh, name: str, axis: int) -> float:
    return float(mesh.p[axis, mesh.facets[0, mesh.boundaries[name][0]]])


def _mirrored(surface: Surface, axis: int, plane: float, antisymmetric: bool) -> Surface:
    """The surface with its mirror image: u_n changes sign, and the potential where the plane is a ground."""
    flip = np.ones(3)
    flip[axis] = -1.0
    points = surface.points * flip
    points[:, axis] += 2 * plane
    electrode = surface.electrode
    if antisymmetric:  # the image of the hot electrode is the ground electrode
        electrode = np.where(electrode == HOT, GROUND, electrode)
    sign = -1.0 if antisymmetric else 1.0
    return replace(
        surface,
        points=np.concatenate([surface.points, points]),
        triangles=np.concatenate([surface.triangles, surface.triangles[:, ::-1] + len(points)]),
        electrode=np.concatenate([surface.electrode, electrode]),
        displacement=np.concatenate([surface.displacement, surface.displacement * flip], axis=1),
        potential=np.concatenate([surface.potential, sign * surface.potential], axis=1),
    )
