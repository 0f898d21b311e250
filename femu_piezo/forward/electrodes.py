"""Electrode and symmetry conditions as one prolongation from free unknowns to all degrees of freedom.

Free unknowns: displacements not held by a symmetry plane, potentials away from electrodes, and LAST the
potential of the hot electrode, one unknown for its whole equipotential. The open-circuit operator is the whole;
the short-circuit operator is the same without its last row and column. The potential is scaled so that elastic
and dielectric entries have one magnitude.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp
import skfem

from femu_piezo.errors import InputError
from femu_piezo.forward.gradient_products import FIELDS
from femu_piezo.geometry.domain import Domain

if TYPE_CHECKING:
    from femu_piezo.forward.model import ElectroelasticModel


def boundary_dofs(basis: skfem.Basis, names: tuple[str, ...]) -> np.ndarray:
    """(k,) degrees of freedom of a scalar basis on named boundaries, each once."""
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


class _Faces:
    """The electrodes of the computed part that are real faces, with the shapes of a scalar basis on them.

    A plane of antisymmetric potential is a ground of the part but no face of the body.
    """

    def __init__(self, model: ElectroelasticModel) -> None:
        basis, domain = model.basis, model.domain
        faces = [name for name in (*domain.hot, *domain.ground) if name not in domain.symmetry]
        facets = np.concatenate([basis.mesh.boundaries[face] for face in faces])
        on = skfem.FacetBasis(basis.mesh, basis.elem, facets=facets, intorder=2 * model.order + 2)
        self._dofs, self._dx, self._size, self._shapes = np.asarray(on.element_dofs).T, on.dx, basis.N, on.basis

    def values(self) -> np.ndarray:
        """(facets, shapes, points) values of the shapes."""
        return np.stack([np.broadcast_to(shape[0], self._dx.shape) for shape in self._shapes], axis=1)

    def slopes(self, axis: int) -> np.ndarray:
        """(facets, shapes, points) their derivatives along an axis."""
        return np.stack([np.broadcast_to(shape[0].grad[axis], self._dx.shape) for shape in self._shapes], axis=1)

    def product(self, left: np.ndarray, right: np.ndarray) -> sp.csr_matrix:
        """∫ left_i right_j dS (n, n)."""
        local = (left * self._dx[:, None]) @ right.transpose(0, 2, 1)  # (facets, shapes, shapes)
        rows, columns = (np.broadcast_to(own, local.shape) for own in (self._dofs[:, :, None], self._dofs[:, None]))
        some = local != 0
        return sp.csr_matrix((local[some], (rows[some], columns[some])), shape=(self._size, self._size))


def electrode_film(model: ElectroelasticModel, directions: tuple[int, ...] = (0, 1, 2)) -> sp.csr_matrix:
    """∫ v·u over the electrodes that are real faces, (4n, 4n), m² per unit of displacement².

    directions : components of u that take part
    """
    faces = _Faces(model)
    block = faces.product(faces.values(), faces.values())
    none = sp.csr_matrix(block.shape)
    return sp.block_diag([block if axis in directions else none for axis in range(FIELDS)], format="csr")


def electrode_membrane(model: ElectroelasticModel, poisson: float) -> sp.csr_matrix:
    """Plane stress of a film on electrodes normal to z, (4n, 4n), per N/m of E h/(1 − ν²).

    ∫ ε_xx² + ε_yy² + 2ν ε_xx ε_yy + (1 − ν)/2 γ_xy² dS as a quadratic form
    """
    faces = _Faces(model)
    x, y = faces.slopes(0), faces.slopes(1)
    shear = (1 - poisson) / 2
    mixed = poisson * faces.product(x, y) + shear * faces.product(y, x)
    along, across = faces.product(x, x), faces.product(y, y)
    none = sp.csr_matrix((2 * along.shape[0],) * 2)
    plane = sp.bmat([[along + shear * across, mixed], [mixed.T, across + shear * along]])
    return sp.block_diag([plane, none], format="csr")
