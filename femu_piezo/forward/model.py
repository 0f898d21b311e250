"""`ElectroelasticModel`: the affine operator A(ω, θ) = Σ c_q(θ) A_q − ω² M of one domain."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
import skfem

from femu_piezo.errors import InputError
from femu_piezo.forward.condensation import Condensation
from femu_piezo.forward.electrodes import prolongation
from femu_piezo.forward.free_pattern import FreePattern
from femu_piezo.forward.gradient_products import (
    FIELDS,
    GradientProducts,
    assemble_gradient_products,
    unit_tensors,
)
from femu_piezo.forward.hex_element import ElementHexP, node_places
from femu_piezo.forward.layers import LayeredProducts
from femu_piezo.forward.linear_solver import Analysis, Factorization
from femu_piezo.geometry.domain import Domain
from femu_piezo.material.constants import E_FORM, ElasticForm
from femu_piezo.material.voigt import axes_with_poling
from femu_piezo.threads import by_columns, made_once

#: Elements of tetrahedral meshes by order; hexahedra are `ElementHexP` of any order.
_TETRAHEDRA = {1: skfem.ElementTetP1, 2: skfem.ElementTetP2}

#: Volts per unit of the scaled potential: about sqrt(c/ε) of a piezoceramic, which balances the blocks.
POTENTIAL_SCALE = 1e9


class ElectroelasticModel:
    """Coupled electro-elastic operator of a domain; unknowns as in `femu_piezo.forward.electrodes`.

    Parameters
    ----------
    domain : mesh, electrodes, symmetry
    density : kg/m³
    order : polynomial order of the elements, that of the domain where None; at most 2 for tetrahedra
    extra_terms : name → (4n, 4n) matrix of a further term, e.g. the mass of a solder dot

    Attributes
    ----------
    terms : names of the affine terms: the ten e-form constants, the tensor terms, the extra terms
    tensor_terms : name → extended tensor (4, 3, 4, 3) of a further term (`with_terms`)
    order : polynomial order of the elements
    size : number m of free unknowns, the hot electrode's potential last
    displacements : number of displacements among the free unknowns, which come first
    products : gradient products of the mesh, by which the operator is applied
    analysis : symbolic analysis of the sparse matrices K − ω² M, shared with the copies made by `with_terms`
    """

    def __init__(
        self,
        domain: Domain,
        density: float,
        order: int | None = None,
        extra_terms: Mapping[str, sp.spmatrix] | None = None,
    ) -> None:
        self.domain = domain
        self.density = density
        self.order = domain.order if order is None else order
        self.basis = scalar_basis(domain.mesh, self.order)
        layered = LayeredProducts.of(self.basis)
        self.products: GradientProducts | LayeredProducts = (
            assemble_gradient_products(self.basis) if layered is None else layered
        )
        self.rotation = axes_with_poling(np.array(domain.poling))
        self.unit_tensors = unit_tensors(self.rotation)
        self.prolongation = prolongation(self.basis, domain, POTENTIAL_SCALE)
        self.analysis = Analysis()
        self.tensor_terms: dict[str, np.ndarray] = {}
        self.extra_terms = {name: self._constrained(matrix) for name, matrix in (extra_terms or {}).items()}

    def with_terms(self, tensors: Mapping[str, np.ndarray], matrices: Mapping[str, sp.spmatrix]) -> ElectroelasticModel:
        """A copy of the model with further terms, which shares mesh, basis, products and analysis.

        Parameters
        ----------
        tensors : name → extended tensor (4, 3, 4, 3), symmetric in (f,a) ↔ (g,b);  matrices : name → (4n, 4n)
        """
        other = copy.copy(self)
        other.__dict__.pop("_condensation", None)
        other.tensor_terms = {**self.tensor_terms, **tensors}
        other.extra_terms = {**self.extra_terms, **{name: self._constrained(a) for name, a in matrices.items()}}
        return other

    @property
    def terms(self) -> tuple[str, ...]:
        return (*E_FORM, *self.tensor_terms, *self.extra_terms)

    @property
    def tensors(self) -> np.ndarray:
        """(n, 4, 3, 4, 3) extended tensors of the unit constants and of the tensor terms."""
        return np.array([*self.unit_tensors, *self.tensor_terms.values()])

    @property
    def size(self) -> int:
        return self.prolongation.shape[1]

    @made_once
    def displacements(self) -> int:
        return int(np.count_nonzero(self.prolongation.tocoo().row < 3 * self.basis.N))

    @made_once
    def assembled(self) -> GradientProducts:
        """The gradient products as sparse matrices; assembled on first use where `products` are `LayeredProducts`."""
        return self.products if isinstance(self.products, GradientProducts) else assemble_gradient_products(self.basis)

    def term(self, name: str) -> sp.csr_matrix:
        """A_q (m, m) real: the operator of one unit constant, which is also ∂A/∂c_q."""
        if name in self.extra_terms:
            return self.extra_terms[name]
        return self._pattern.stiffness(self.tensors[self.terms.index(name)])

    def stiffness(self, constants: ElasticForm, extra: Mapping[str, complex] | None = None) -> sp.csr_matrix:
        """Σ c_q A_q (m, m): real where every constant is real, else complex symmetric."""
        values = constants.vector()
        values = values if np.any(values.imag) else values.real
        extra = dict(extra or {})
        tensor = np.tensordot(values, self.unit_tensors, axes=1)
        for name in extra.keys() & self.tensor_terms.keys():
            tensor = tensor + extra.pop(name) * self.tensor_terms[name]
        matrix = self._pattern.stiffness(tensor)
        for name, coefficient in extra.items():
            matrix = matrix + coefficient * self.extra_terms[name]
        return matrix

    def operator(self, coefficients: np.ndarray, shift: float = 0.0) -> spla.LinearOperator:
        """K − shift · M (m, m) at real coefficients (n_terms,) of the affine terms, applied without being formed."""
        tensor, extra = self._combined(coefficients)
        extra_matrix = _total(extra)

        def times(vectors: np.ndarray) -> np.ndarray:
            return by_columns(image, vectors.reshape(self.size, -1))

        def image(vectors: np.ndarray) -> np.ndarray:
            fields = (self.prolongation @ vectors).reshape(FIELDS, self.basis.N, -1)
            images = self.products.applied([tensor], fields)[0]
            if shift:
                for f in range(3):
                    images[f] -= shift * self.density * self.products.mass_times(fields[f])
            found = self.prolongation.T @ images.reshape(-1, vectors.shape[1])
            return found if extra_matrix is None else found + extra_matrix @ vectors

        return spla.LinearOperator((self.size,) * 2, matvec=times, matmat=times, dtype=float)

    def diagonal(self, coefficients: np.ndarray) -> np.ndarray:
        """(m,) diagonal of K at real coefficients (n_terms,) of the affine terms.

        The entry of the hot electrode is the sum of the diagonal entries of its nodes, without the coupling among them.
        """
        tensor, extra = self._combined(coefficients)
        nodal = np.zeros((FIELDS, self.basis.N))
        for f, a, b in zip(*np.nonzero(np.einsum("fafb->fab", tensor)), strict=True):
            nodal[f] += tensor[f, a, f, b] * self.products.diagonal(a, b)
        found = self.prolongation.power(2).T @ nodal.ravel()
        return found + sum(factor * matrix.diagonal() for factor, matrix in extra)

    def factorize(self, coefficients: np.ndarray, shift: float) -> Factorization:
        """K − shift · M at real coefficients (n_terms,) of the affine terms, factorised."""
        tensor, extra = self._combined(coefficients)
        if self._condensation is None:
            matrix, extra_matrix = self._pattern.stiffness(tensor, shift * self.density), _total(extra)
            return self.analysis.factorize(
                matrix if extra_matrix is None else self._pattern.added(matrix, extra_matrix)
            )
        solver = self._condensation.factorize(tensor, shift * self.density, [factor for factor, _ in extra])
        return Factorization(self.operator(coefficients, shift), solver, self.diagonal(coefficients))

    def _combined(self, coefficients: np.ndarray) -> tuple[np.ndarray, list[tuple[float, sp.csr_matrix]]]:
        """Extended tensor (4, 3, 4, 3) at coefficients (n_terms,), and (coefficient, matrix) of every extra term."""
        count = len(self.terms) - len(self.extra_terms)
        tensor = np.tensordot(coefficients[:count], self.tensors, axes=1)
        return tensor, list(zip(coefficients[count:], self.extra_terms.values(), strict=True))

    @made_once
    def _condensation(self) -> Condensation | None:
        if not isinstance(self.products, LayeredProducts):
            return None
        return Condensation(self.products, self.prolongation, self.extra_terms.values())

    @made_once
    def mass(self) -> sp.csr_matrix:
        """M (m, m), zero in the potential rows."""
        return self._constrained(self.assembled.mass_matrix(self.density))

    def displacement(self, vector: np.ndarray) -> np.ndarray:
        """(3, n) displacement at the degrees of freedom of the scalar basis, m per unit of the vector."""
        return (self.prolongation @ vector).reshape(FIELDS, -1)[:3]

    def potential(self, vector: np.ndarray) -> np.ndarray:
        """(n,) electric potential at the degrees of freedom, V per unit of the vector."""
        return (self.prolongation @ vector).reshape(FIELDS, -1)[3]

    @made_once
    def _pattern(self) -> FreePattern:
        return FreePattern(self.assembled, sp.csr_matrix(self.prolongation))

    def _constrained(self, matrix: sp.spmatrix) -> sp.csr_matrix:
        return (self.prolongation.T @ matrix @ self.prolongation).tocsr()


def _total(terms: Iterable[tuple[float, sp.csr_matrix]]) -> sp.csr_matrix | None:
    """Σ factor · matrix; None where all factors are zero."""
    found = [factor * matrix for factor, matrix in terms if factor]
    return sum(found) if found else None


def scalar_basis(mesh: skfem.Mesh, order: int) -> skfem.CellBasis:
    """Scalar Lagrange elements of an order on a mesh; the quadrature is exact in cells with an affine map."""
    if mesh.elem.refdom is skfem.refdom.RefHex:
        basis = skfem.Basis(mesh, ElementHexP(order), intorder=2 * order)
        basis.doflocs = node_places(basis)
        return basis
    if order not in _TETRAHEDRA:
        raise InputError(f"no element of order {order} for meshes of type {type(mesh).__name__}")
    return skfem.Basis(mesh, _TETRAHEDRA[order](), intorder=2 * order)
