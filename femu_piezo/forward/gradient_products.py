"""All unit-constant matrices from nine scalar assemblies.

With four fields (u_x, u_y, u_z, φ) on one scalar basis, every bulk form of the problem is

    Σ_{f,g} Σ_{a,b} H[f,a,g,b] ∫ ∂_a v_f ∂_b w_g,

where H is the extended constitutive tensor of Barnett and Lothe (1975): c_iakb for two displacements, e_bia
for a displacement and the potential, −ε_ab for the potential. So the products G_ab = ∫ ∂_aφ_i ∂_bφ_j contain
every unit-constant matrix, for any crystal orientation.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import skfem

from femu_piezo.forward.tensor_grid import TensorGrid
from femu_piezo.material.constants import ElasticForm
from femu_piezo.material.voigt import piezoelectric_tensor, stiffness_tensor
from femu_piezo.threads import made_once

FIELDS = 4  #: u_x, u_y, u_z, φ


def extended_tensor(constants: ElasticForm, rotation: np.ndarray) -> np.ndarray:
    """H (4, 3, 4, 3) of e-form constants, x_crystal = R x_specimen; complex, SI."""
    r = rotation
    tensor = np.zeros((FIELDS, 3, FIELDS, 3), dtype=complex)
    c = stiffness_tensor(constants.stiffness())
    e = piezoelectric_tensor(constants.piezoelectric())
    tensor[:3, :, :3, :] = np.einsum("pqrs,pi,qj,rk,sl->ijkl", c, r, r, r, r, optimize=True)
    rotated = np.einsum("pqr,pi,qj,rk->ijk", e, r, r, r, optimize=True)
    tensor[:3, :, 3, :] = np.einsum("kij->ijk", rotated)
    tensor[3, :, :3, :] = rotated
    tensor[3, :, 3, :] = -r.T @ constants.permittivity() @ r
    return tensor


def unit_tensors(rotation: np.ndarray) -> np.ndarray:
    """(10, 4, 3, 4, 3) real: H of each unit constant, in the order of `ElasticForm.names()`."""
    return np.array([extended_tensor(ElasticForm.from_vector(unit), rotation).real for unit in np.eye(10)])


class ScalarProducts(ABC):
    """The products G_ab = ∫ w ∂_aφ_i ∂_bφ_j of a scalar basis, with a weight w, and the bulk forms made of them.

    Attributes
    ----------
    size : number n of shape functions
    nodes : (m,) numbers of the functions whose rows of G_ab are not zero, in the order that `times` uses; a slice of
        all where that is the order of the basis
    """

    size: int
    nodes: np.ndarray | slice

    @abstractmethod
    def times(self, a: int, b: int, vectors: np.ndarray) -> np.ndarray:
        """G_ab times vectors (m, k) on `nodes`: (m, k)."""

    def applied(self, tensors: Sequence[np.ndarray], fields: np.ndarray) -> np.ndarray:
        """(n_tensors, 4, n, k): A w of extended tensors, each (4, 3, 4, 3), on fields w (4, n, k), no A formed."""
        tensors, values = np.asarray(tensors), fields[:, self.nodes]
        found = np.zeros((len(tensors), *values.shape))
        nonzero = np.any(values, axis=(1, 2))[:, None]
        for a, g, b in zip(*np.nonzero(np.any(tensors, axis=(0, 1)) & nonzero), strict=True):
            image = self.times(a, b, values[g])
            for number, f in zip(*np.nonzero(tensors[:, :, a, g, b]), strict=True):
                found[number, f] += tensors[number, f, a, g, b] * image
        if isinstance(self.nodes, slice):
            return found
        whole = np.zeros((len(tensors), *fields.shape))
        whole[:, :, self.nodes] = found
        return whole

    def between(self, left: np.ndarray, right: np.ndarray, tensors: Sequence[np.ndarray]) -> np.ndarray:
        """(n_tensors, k, l): vᵗA w of extended tensors on all pairs of fields v and w, no A formed.

        Parameters
        ----------
        left, right : (4, n, k) and (4, n, l) fields;  tensors : each (4, 3, 4, 3)
        """
        tensors, found = np.asarray(tensors), np.zeros((len(tensors), left.shape[2], right.shape[2]))
        rows, columns = (self._nonzero_columns(side) for side in (left, right))
        for a, g, b in zip(*np.nonzero(np.any(tensors, axis=(0, 1))), strict=True):
            after, image = columns[g][0], None
            for f, (before, values) in enumerate(rows):
                components = tensors[:, f, a, g, b]
                if before.size and after.size and np.any(components):
                    image = self.times(a, b, columns[g][1]) if image is None else image
                    product = values.T @ image
                    for number in np.flatnonzero(components):
                        found[number][np.ix_(before, after)] += components[number] * product
        return found

    def _nonzero_columns(self, fields: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """For u_x, u_y, u_z and φ of fields (4, n, k): numbers of the nonzero columns, and their values on `nodes`.

        Many fields have displacements alone or a potential alone.
        """
        chosen = [np.flatnonzero(np.any(part, axis=0)) for part in fields]
        return [(columns, part[self.nodes][:, columns]) for columns, part in zip(chosen, fields, strict=True)]

    def within(self, fields: np.ndarray, tensors: Sequence[np.ndarray]) -> np.ndarray:
        """(n_tensors, k, k): `between` of fields (4, n, k) with themselves, for tensors H[f, a, g, b] = H[g, b, f, a].

        The parts of H[f, a, g, b] and H[g, b, f, a] are transposes of each other, so only one of them is computed.
        """
        values = fields[:, self.nodes]
        nonzero = np.any(values, axis=(1, 2))
        tensors = np.asarray(tensors) * nonzero[:, None, None, None] * nonzero[:, None]
        wanted = np.any(tensors, axis=0).reshape(3 * FIELDS, 3 * FIELDS)
        half = np.zeros((len(tensors), values.shape[2], values.shape[2]))
        for column in range(3 * FIELDS):
            g, b = divmod(column, 3)
            for a in range(3):
                rows = [f for f in range(FIELDS) if 3 * f + a <= column and wanted[3 * f + a, column]]
                image = self.times(a, b, values[g]) if rows else None
                for f in rows:
                    product, components = values[f].T @ image, tensors[:, f, a, g, b]
                    for number in np.flatnonzero(components):
                        half[number] += (0.5 if (f, a) == (g, b) else 1.0) * components[number] * product
        return half + half.transpose(0, 2, 1)


@dataclass(frozen=True)
class GradientProducts(ScalarProducts):
    """The gradient products and the mass as scalar sparse matrices on one sparsity pattern.

    Attributes
    ----------
    indices, indptr : CSR pattern of the scalar basis, n × n
    gradients : (3, 3, nnz) data of ∫ ∂_aφ_i ∂_bφ_j
    mass : (nnz,) data of ∫ φ_i φ_j
    grid : the same products as Kronecker products, where the nodes form a grid; else None
    """

    indices: np.ndarray
    indptr: np.ndarray
    gradients: np.ndarray
    mass: np.ndarray
    grid: TensorGrid | None = None

    @property
    def nodes(self) -> np.ndarray | slice:
        """All nodes: (n,) in the order of the grid where there is one, else a slice."""
        return slice(None) if self.grid is None else self.grid.order

    def times(self, a: int, b: int, vectors: np.ndarray) -> np.ndarray:
        """G_ab times vectors (n, k) on `nodes`, by the Kronecker structure where there is one."""
        return self.gradient_matrices[a][b] @ vectors if self.grid is None else self.grid.times(a, b, vectors)

    def mass_times(self, vectors: np.ndarray) -> np.ndarray:
        """∫ φ_i φ_j times vectors (n, k)."""
        return self.scalar(self.mass) @ vectors if self.grid is None else self.grid.mass(vectors)

    def diagonal(self, a: int, b: int) -> np.ndarray:
        """(n,) diagonal of G_ab."""
        return self.gradient_matrices[a][b].diagonal()

    @property
    def size(self) -> int:
        """n"""
        return self.indptr.size - 1

    def scalar(self, data: np.ndarray) -> sp.csr_matrix:
        """The (n, n) matrix with given data on the common pattern."""
        return sp.csr_matrix((data, self.indices, self.indptr), shape=(self.size, self.size))

    @made_once
    def gradient_matrices(self) -> list[list[sp.csr_matrix]]:
        """G_ab as sparse matrices, [a][b]."""
        return [[self.scalar(self.gradients[a, b]) for b in range(3)] for a in range(3)]

    def combine(self, coefficients: np.ndarray) -> np.ndarray | None:
        """(nnz,) data of Σ h_ab G_ab for h (3, 3), None where h = 0."""
        total = None
        for a, b in zip(*np.nonzero(coefficients), strict=True):
            part = coefficients[a, b] * self.gradients[a, b]
            total = part if total is None else total + part
        return total

    def stiffness(self, tensor: np.ndarray) -> sp.csr_matrix:
        """(4n, 4n) matrix of the extended tensor H (4, 3, 4, 3), fields one after another."""
        blocks = [
            [
                None if block is None else self.scalar(block)
                for block in (self.combine(tensor[f, :, g, :]) for g in range(FIELDS))
            ]
            for f in range(FIELDS)
        ]
        for f in range(FIELDS):  # bmat needs one block to know each size
            if blocks[f][f] is None:
                blocks[f][f] = sp.csr_matrix((self.size, self.size))
        return sp.bmat(blocks, format="csr")

    def mass_matrix(self, density: float) -> sp.csr_matrix:
        """(4n, 4n) matrix of ∫ρ v·u (kg), zero in the potential."""
        block = self.scalar(density * self.mass)
        return sp.block_diag([block, block, block, sp.csr_matrix((self.size, self.size))], format="csr")


def assemble_gradient_products(basis: skfem.Basis) -> GradientProducts:
    """Assemble the nine gradient products and the mass on a scalar scikit-fem basis."""
    dx, (value, slopes) = basis.dx[:, None, :], _shapes(basis)
    summed, indices, indptr = _scatter(basis)
    gradients = np.empty((3, 3, indices.size))
    for a, b in itertools.product(range(3), repeat=2):
        gradients[a, b] = summed((slopes[a] * dx) @ slopes[b].transpose(0, 2, 1))
    mass = summed((value * dx) @ value.transpose(0, 2, 1))
    return GradientProducts(indices, indptr, gradients, mass, TensorGrid.of(basis))


def reshaped_products(
    basis: skfem.Basis, gradient: Callable[[np.ndarray], np.ndarray]
) -> tuple[GradientProducts, GradientProducts]:
    """Change of the products under a map x → x + p g(x) of the body: the coefficients of p and of p².

    With G = ∂g/∂x, ∇ → (1 − p Gᵗ + p² Gᵗ²) ∇ and dV → (1 + p v₁ + p² v₂ + …) dV, v₁ = tr G, v₂ = (v₁² − tr G²)/2. For
    products of a = ∇φ_i and b = ∇φ_j the coefficients are

        p:   v₁ a bᵗ − (Gᵗa) bᵗ − a (Gᵗb)ᵗ
        p²:  v₂ a bᵗ − v₁ [(Gᵗa) bᵗ + a (Gᵗb)ᵗ] + (Gᵗa)(Gᵗb)ᵗ + (Gᵗ²a) bᵗ + a (Gᵗ²b)ᵗ

    gradient : points (3, m, q) in m → G (3, 3, m, q), for the q Gauss points of m cells
    """
    g = gradient(np.asarray(basis.global_coordinates()))
    trace = np.einsum("aa...->...", g)
    v1, v2 = trace[:, None], ((trace**2 - np.einsum("ab...,ba...->...", g, g)) / 2)[:, None]
    value, plain = _shapes(basis)
    once = np.einsum("ba...,b...->a...", g[:, :, :, None], plain)  # Gᵗ∇φ
    twice = np.einsum("ba...,b...->a...", g[:, :, :, None], once)  # Gᵗ²∇φ
    # for p and p²: the growth of the volume, and pairs (factor in φ_i, factor in φ_j) whose products are summed
    orders = (
        (v1, ((v1 * plain - once, plain), (-plain, once))),
        (v2, ((v2 * plain - v1 * once + twice, plain), (once - v1 * plain, once), (plain, twice))),
    )
    dx, (summed, indices, indptr) = basis.dx[:, None, :], _scatter(basis)
    found = []
    for growth, pairs in orders:
        gradients = np.empty((3, 3, indices.size))
        for a, b in itertools.product(range(3), repeat=2):
            gradients[a, b] = summed(sum((dx * left[a]) @ right[b].transpose(0, 2, 1) for left, right in pairs))
        mass = summed((value * dx * growth) @ value.transpose(0, 2, 1))
        found.append(GradientProducts(indices, indptr, gradients, mass))
    return found[0], found[1]


def _shapes(basis: skfem.Basis) -> tuple[np.ndarray, np.ndarray]:
    """Values (m, n, q) of the n shape functions of a cell at the q Gauss points of m cells, and slopes (3, m, n, q)."""
    value = np.stack([np.broadcast_to(shape[0], basis.dx.shape) for shape in basis.basis], axis=1)
    return value, np.stack([np.stack([shape[0].grad[axis] for shape in basis.basis], axis=1) for axis in range(3)])


def _scatter(basis: skfem.Basis) -> tuple[Callable[[np.ndarray], np.ndarray], np.ndarray, np.ndarray]:
    """CSR assembly: function from element matrices (elements, shapes, shapes) to data, column indices, row pointers."""
    dofs = np.asarray(basis.element_dofs, dtype=np.int64).T  # (elements, shapes)
    key = (dofs[:, :, None] * basis.N + dofs[:, None, :]).ravel()
    order = np.argsort(key, kind="stable")
    key = key[order]
    starts = np.flatnonzero(np.r_[True, key[1:] != key[:-1]])
    unique = key[starts]
    indptr = np.searchsorted(unique, np.arange(basis.N + 1, dtype=np.int64) * basis.N).astype(np.int32)
    return lambda local: np.add.reduceat(local.ravel()[order], starts), (unique % basis.N).astype(np.int32), indptr
