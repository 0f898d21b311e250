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


def electrode_film(model: ElectroelasticModel) -> sp.csr_matrix:
    """∫ v·u over the electrodes of the computed part that are real faces, (4n, 4n), m² per unit of displacement².

    A plane of antisymmetric potential is a ground of the part but no face of the body.
    """
    basis, domain = model.basis, model.domain
    faces = [name for name in (*domain.hot, *domain.ground) if name not in domain.symmetry]
    facets = np.concatenate([basis.mesh.boundaries[face] for face in faces])
    on = skfem.FacetBasis(basis.mesh, basis.elem, facets=facets, intorder=2 * model.order + 2)
    value = np.stack([np.broadcast_to(shape[0], on.dx.shape) for shape in on.basis], axis=1)
    local = (value * on.dx[:, None]) @ value.transpose(0, 2, 1)  # (facets, shapes, shapes)
    dofs = np.asarray(on.element_dofs).T
    rows, columns = np.broadcast_to(dofs[:, :, None], local.shape), np.broadcast_to(dofs[:, None], local.shape)
    some = local != 0
    block = sp.csr_matrix((local[some], (rows[some], columns[some])), shape=(basis.N, basis.N))
    return sp.block_diag([block, block, block, sp.csr_matrix(block.shape)], format="csr")
