"""Projection of the affine terms on a small basis, through field gradients at the quadrature points.

Every bulk term is A_q = Dᵗ (w H_q) D with D the gradients of the four fields at the quadrature points, w the
quadrature weights and H_q the extended tensor of one unit constant. On a basis V only the gradients D V are
needed: VᵗA_qV = (D V)ᵗ (w H_q) (D V), all terms from one set of inner products and no sparse A_q formed.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import skfem

from femu_piezo.forward.gradient_products import FIELDS
from femu_piezo.forward.model import ElectroelasticModel

#: Voigt strains as combinations of displacement gradients u_i,j, then −E as gradients of φ.
_CHUNK_BYTES = 256e6


class QuadratureGradients:
    """Gradient operators D_a at the quadrature points, scaled by the square root of the weights.

    Attributes
    ----------
    operators : three (p, n) sparse matrices: sqrt(w) ∂_a of a nodal field at the p points
    """

    def __init__(self, basis: skfem.Basis) -> None:
        root = np.sqrt(basis.dx)
        gradient = np.stack([shape[0].grad for shape in basis.basis])  # (shapes, 3, elements, points)
        count, _, elements, points = gradient.shape
        columns = np.repeat(np.asarray(basis.element_dofs).T, points, axis=0).ravel()
        indptr = np.arange(elements * points + 1) * count
        shape = (elements * points, basis.N)
        self.operators = [
            sp.csr_matrix(((gradient[:, a] * root).transpose(1, 2, 0).ravel(), columns, indptr), shape=shape)
            for a in range(3)
        ]

    def of(self, fields: np.ndarray) -> np.ndarray:
        """Gradients of nodal fields (F, n, k) → (F, 3, p, k), scaled by sqrt(w)."""
        count, n, k = fields.shape
        flat = np.ascontiguousarray(np.moveaxis(fields, 0, 1).reshape(n, count * k))
        stacked = np.stack([operator @ flat for operator in self.operators])
        return stacked.reshape(3, -1, count, k).transpose(2, 0, 1, 3)

    def transpose(self, flux: np.ndarray) -> np.ndarray:
        """Dᵗ applied to a flux (F, 3, p, k) → (F, n, k): the nodal forces of stresses."""
        count, _, p, k = flux.shape
        result = sum(self.operators[a].T @ flux[:, a].transpose(1, 0, 2).reshape(p, count * k) for a in range(3))
        return result.reshape(-1, count, k).transpose(1, 0, 2)


def project_terms(model: ElectroelasticModel, gradients: QuadratureGradients, basis: np.ndarray) -> np.ndarray:
    """VᵗA_qV for every affine term, (n_terms, r, r) real.

    Parameters
    ----------
    basis : (m, r) real basis V in free unknowns
    """
    full = (model.prolongation @ basis).reshape(FIELDS, -1, basis.shape[1])
    field = gradients.of(full).reshape(FIELDS * 3, -1, basis.shape[1])
    active = [index for index in range(FIELDS * 3) if np.any(field[index])]
    inner = {(i, j): field[i].T @ field[j] for i in active for j in active if i <= j}
    count = len(model.unit_tensors)
    result = np.zeros((count + len(model.extra_terms), basis.shape[1], basis.shape[1]))
    for q, tensor in enumerate(model.unit_tensors):
        matrix = tensor.reshape(FIELDS * 3, FIELDS * 3)
        for i, j in zip(*np.nonzero(matrix), strict=True):
            if i in active and j in active:
                block = inner[i, j] if i <= j else inner[j, i].T
                result[q] += matrix[i, j] * block
    for q, matrix in enumerate(model.extra_terms.values(), start=count):
        result[q] = basis.T @ (matrix @ basis)
    return (result + result.transpose(0, 2, 1)) / 2


def apply_stiffness(
    model: ElectroelasticModel, gradients: QuadratureGradients, tensor: np.ndarray, vectors: np.ndarray
) -> np.ndarray:
    """A x for many vectors (m, k) and one extended tensor (4, 3, 4, 3), without forming A."""
    full = (model.prolongation @ vectors).reshape(FIELDS, -1, vectors.shape[1])
    flux = np.einsum("fagb,gbpk->fapk", tensor, gradients.of(full), optimize=True)
    return model.prolongation.T @ gradients.transpose(flux).reshape(-1, vectors.shape[1])
