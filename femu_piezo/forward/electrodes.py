"""Electrode and symmetry conditions as one prolongation from free unknowns to all degrees of freedom.

Free unknowns: displacements not held by a symmetry plane, potentials away from electrodes, and LAST the
potential of the hot electrode, one unknown for its whole equipotential. The whole operator is that of the open
circuit; without its last row and column it is that of the short circuit. The potential is scaled so that elastic
and dielectric entries have similar magnitudes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp
import skfem

from femu_piezo.errors import InputError
from femu_piezo.forward.gradient_products import FIELDS
from femu_piezo.geometry.domain import Domain

if TYPE_CHECKING:
    from femu_piezo.forward.model import ElectroelasticModel

#: Component of a direction below which it is rounding.
_ROUNDING = 1e-9


def boundary_dofs(basis: skfem.Basis, names: tuple[str, ...]) -> np.ndarray:
    """(k,) degrees of freedom of a scalar basis on named boundaries, without repetition."""
    return np.unique(np.concatenate([basis.get_dofs(name).all() for name in names]))


def prolongation(basis: skfem.Basis, domain: Domain, potential_scale: float) -> sp.csr_matrix:
    """(4n, m) matrix from free unknowns to all degrees of freedom, hot electrode last.

    Parameters
    ----------
    basis : scalar basis with n degrees of freedom
    potential_scale : volts per unit of the scaled potential
    """
    n = basis.N
    held = np.zeros(FIELDS * n, dtype=bool)
    for name, axis in domain.symmetry.items():
        held[axis * n + boundary_dofs(basis, (name,))] = True
    hot = boundary_dofs(basis, domain.hot)
    ground = boundary_dofs(basis, domain.ground)
    if np.intersect1d(hot, ground).size:
        raise InputError("the hot and the ground electrode share points of the mesh: they would be short-circuited")
    held[3 * n + ground] = True
    held[3 * n + hot] = True
    free = np.flatnonzero(~held)
    rows = np.concatenate([free, 3 * n + hot])
    columns = np.concatenate([np.arange(free.size), np.full(hot.size, free.size)])
    values = np.where(rows >= 3 * n, potential_scale, 1.0)
    return sp.csr_matrix((values, (rows, columns)), shape=(FIELDS * n, free.size + 1))


@dataclass(frozen=True)
class Faces:
    """Gauss points on the electrodes of a computed part that are faces of the body.

    Displacements are those along two axes in the face and along its normal, in this order, then comes the potential.

    Attributes
    ----------
    weights : (q,) weights of surface integrals, m²
    values : [f] → (q, 4n) value of field f at the points
    slopes : [f][a] → (q, 4n) gradient of field f along the two axes in the face
    """

    weights: np.ndarray
    values: Sequence[sp.csr_matrix]
    slopes: Sequence[Sequence[sp.csr_matrix]]

    def product(self, left: sp.csr_matrix, right: sp.csr_matrix) -> sp.csr_matrix:
        """∫ left right dS (4n, 4n)."""
        return (left.T @ sp.diags(self.weights) @ right).tocsr()


def of_field(matrix: sp.csr_matrix, field: int) -> sp.csr_matrix:
    """(q, 4n) matrix that applies a matrix (q, n) to one field of nodal values (4n,)."""
    rows, n = matrix.shape
    scalar = sp.csr_matrix(matrix)
    return sp.csr_matrix((scalar.data, scalar.indices + field * n, scalar.indptr), shape=(rows, FIELDS * n))


def electrode_faces(model: ElectroelasticModel) -> Faces:
    """The electrodes of a model that are faces of the body, whichever way they face.

    A plane of antisymmetric potential is not among them: it is a ground of the part but no face of the body.
    """
    basis, domain = model.basis, model.domain
    faces = [name for name in (*domain.hot, *domain.ground) if name not in domain.symmetry]
    facets = np.concatenate([basis.mesh.boundaries[face] for face in faces])
    on = skfem.FacetBasis(basis.mesh, basis.elem, facets=facets, intorder=2 * model.order + 2)
    dofs, points = np.asarray(on.element_dofs).T, on.dx.size  # (facets, shapes)

    def matrix(part: Callable[[skfem.DiscreteField], np.ndarray]) -> sp.csr_matrix:
        local = np.stack([np.broadcast_to(part(shape[0]), on.dx.shape) for shape in on.basis], axis=2)
        rows = np.broadcast_to(np.arange(points).reshape(on.dx.shape)[:, :, None], local.shape)
        columns, some = np.broadcast_to(dofs[:, None], local.shape), local != 0
        return sp.csr_matrix((local[some], (rows[some], columns[some])), shape=(points, basis.N))

    axes = _axes_of_faces(np.broadcast_to(on.normals, (3, *on.dx.shape)).reshape(3, -1))
    value = matrix(lambda shape: shape)
    gradient = [matrix(lambda shape, axis=axis: shape.grad[axis]) for axis in range(3)]
    slopes = [_along(axis, gradient) for axis in axes[:2]]

    def fields(scalar: sp.csr_matrix) -> list[sp.csr_matrix]:
        whole = [of_field(scalar, field) for field in range(FIELDS)]
        return [*(_along(axis, whole[:3]) for axis in axes), whole[3]]

    by_axis = [fields(slope) for slope in slopes]
    return Faces(on.dx.ravel(), fields(value), [list(both) for both in zip(*by_axis, strict=True)])


def _axes_of_faces(normal: np.ndarray) -> np.ndarray:
    """(3, 3, q) two axes in a face and its normal, at points with normals (3, q); x, y, z where that is along z."""
    least = np.where(np.abs(normal[0]) < 0.9, 0, 1)  # x, or y where the normal is nearly along x
    first = np.eye(3)[least].T - normal[least, np.arange(least.size)] * normal
    first = first / np.linalg.norm(first, axis=0)
    second = np.cross(normal, first, axis=0)
    found = np.array([first, second, normal])
    found[np.abs(found) < _ROUNDING] = 0.0
    return found


def _along(axis: np.ndarray, components: Sequence[sp.csr_matrix]) -> sp.csr_matrix:
    """The component (q, k) along an axis (3, q) that differs from point to point, from those along x, y and z."""
    return sum(sp.diags(share) @ part for share, part in zip(axis, components, strict=True) if np.any(share)).tocsr()


def electrode_film(faces: Faces, directions: tuple[int, ...] = (0, 1, 2)) -> sp.csr_matrix:
    """∫ v·u over the electrodes, (4n, 4n), m² per unit of displacement².

    directions : components of u in the product: 0 and 1 in the face, 2 along its normal
    """
    return sum(faces.product(faces.values[f], faces.values[f]) for f in directions)


def electrode_membrane(faces: Faces, poisson: float) -> sp.csr_matrix:
    """Membrane stiffness of a film in plane stress on the electrodes, (4n, 4n), per N/m of E h/(1 − ν²).

    ∫ ε_xx² + ε_yy² + 2ν ε_xx ε_yy + (1 − ν)/2 γ_xy² dS as a quadratic form, x and y in the face
    """
    along, across = faces.slopes[0][0], faces.slopes[1][1]
    shear = faces.slopes[0][1] + faces.slopes[1][0]
    mixed = faces.product(along, across)
    return (
        faces.product(along, along)
        + faces.product(across, across)
        + poisson * (mixed + mixed.T)
        + (1 - poisson) / 2 * faces.product(shear, shear)
    )
