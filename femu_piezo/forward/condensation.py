"""Static condensation: private unknowns are eliminated cell by cell, shared unknowns by a sparse factorisation.

With i the private unknowns of a cell, which belong to no other cell and no further term, and b its shared unknowns,

    A_bb ← A_bb − A_bi A_ii⁻¹ A_ib,    x_i = A_ii⁻¹ r_i − A_ii⁻¹ A_ib x_b,

which is exact for A = K − σM at one shift σ. In a mesh of one layer of cells of order p, only the nodes on the upright
sides of the cells and the hot electrode are shared. Cell matrices are formed, eliminated and dropped one after another.
So memory holds only the LU factors of A_ii and A_ii⁻¹ A_ib of each cell, and the sparse matrix of the shared unknowns,
never the whole operator or its pattern.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from femu_piezo.forward.gradient_products import FIELDS
from femu_piezo.forward.layers import LayeredProducts
from femu_piezo.forward.linear_solver import Analysis, SymmetricSolver


@dataclass(frozen=True)
class _Cell:
    """A cell whose private unknowns are eliminated.

    Attributes
    ----------
    private : (i,) private unknowns of the model;  shared : (b,) positions in the list of shared unknowns, growing
    factor : LU of A_ii and its pivots;  response : (i, b) A_ii⁻¹ A_ib
    """

    private: np.ndarray
    shared: np.ndarray
    factor: tuple[np.ndarray, np.ndarray]
    response: np.ndarray


class Condensation:
    """Division of a model's unknowns into private and shared ones, and the sparsity pattern of the shared ones.

    Parameters
    ----------
    products : gradient products on n nodes
    prolongation : (4n, m) from free unknowns to all, the hot electrode last; each row has at most one entry
    further : matrices (m, m) of further terms, whose unknowns count as shared
    """

    def __init__(self, products: LayeredProducts, prolongation: sp.csr_matrix, further: Iterable[sp.spmatrix]) -> None:
        self._products, self._size = products, prolongation.shape[1]
        entries = np.diff(prolongation.indptr)
        self._free = np.full(FIELDS * products.size, -1)
        self._free[entries == 1] = prolongation.indices
        self._free = self._free.reshape(FIELDS, -1)
        self._scale = np.array([1.0, 1.0, 1.0, np.abs(prolongation.data).max()])
        self._further = [sp.coo_matrix(matrix) for matrix in further]
        self._shared = np.flatnonzero(self._is_shared())
        self._number = np.full(self._size, -1)
        self._number[self._shared] = np.arange(self._shared.size)
        self._pattern, self._analysis = self._lower_pattern(), Analysis()
        # the symbolic analysis takes memory, so it is made before there are cells
        self._analysis.of(self._matrix(np.ones(self._pattern.nnz)))

    def _unknowns(self, cell: int) -> np.ndarray:
        """(4 m³,) free unknown of every field and shape function of a cell, −1 where it is held."""
        return self._free[:, self._products.cell_nodes(cell)].ravel()

    def _is_shared(self) -> np.ndarray:
        """(m,) whether an unknown belongs to several cells, to a further term or to the hot electrode."""
        cells = np.zeros(self._size, dtype=int)
        for cell in range(self._products.cells):
            unknowns = np.unique(self._unknowns(cell))
            cells[unknowns[unknowns >= 0]] += 1
        shared = cells > 1
        shared[-1] = True
        for matrix in self._further:
            shared[matrix.row] = True
        return shared

    def _lower_pattern(self) -> sp.csc_matrix:
        """Lower triangle of the sparsity pattern of the shared unknowns."""
        unknowns = map(self._unknowns, range(self._products.cells))
        groups = [np.unique(self._number[of_cell[of_cell >= 0]]) for of_cell in unknowns]
        groups = [group[group >= 0] for group in groups]
        starts, every = np.cumsum([0, *(group.size for group in groups)]), np.concatenate(groups)
        size, ones = self._shared.size, np.ones(every.size, dtype=np.int8)
        member = sp.csr_matrix((ones, every, starts), shape=(len(groups), size))
        pattern = member.T.astype(bool) @ member.astype(bool)
        for matrix in self._further:
            at = (self._number[matrix.row], self._number[matrix.col])
            pattern = pattern + sp.csr_matrix((np.ones(matrix.nnz, dtype=bool), at), shape=pattern.shape)
        lower = sp.tril(pattern, format="csc")
        lower.sort_indices()
        return lower

    def factorize(self, tensor: np.ndarray, inertia: float, further: Iterable[float]) -> CondensedSolver:
        """Solver of the stiffness of an extended tensor (4, 3, 4, 3) − inertia · mass + Σ factor · further term.

        inertia : density times ω²;  further : factor of each further term
        """
        scaled = tensor * self._scale[:, None, None, None] * self._scale[:, None]
        data, cells = np.zeros(self._pattern.nnz), []
        for number in range(self._products.cells):
            cell, rest = self._eliminated(self._products.cell_operator(scaled, inertia, number), self._unknowns(number))
            self._add(data, cell.shared, rest)
            cells.append(cell)
        for factor, matrix in zip(further, self._further, strict=True):
            if factor != 0:
                self._add_entries(data, self._number[matrix.row], self._number[matrix.col], factor * matrix.data)
        return CondensedSolver(cells, self._shared, self._analysis.solver(self._matrix(data)))

    def _matrix(self, data: np.ndarray) -> sp.csc_matrix:
        return sp.csc_matrix((data, self._pattern.indices, self._pattern.indptr), shape=self._pattern.shape)

    def _eliminated(self, operator: np.ndarray, unknowns: np.ndarray) -> tuple[_Cell, np.ndarray]:
        """The eliminated cell, and the Schur complement (b, b) that it adds to its shared unknowns."""
        number = np.where(unknowns >= 0, self._number[unknowns], -1)
        private = np.flatnonzero((unknowns >= 0) & (number < 0))
        shared, group = np.unique(number[number >= 0], return_inverse=True)
        # all nodes of the hot electrode are one unknown: rows and columns of equal numbers are added
        collect = sp.csr_matrix(
            (np.ones(group.size), (group, np.flatnonzero(number >= 0))), shape=(shared.size, unknowns.size)
        )
        coupling = operator[private] @ collect.T
        rest = collect @ (operator @ collect.T)
        factor = sl.lu_factor(operator[np.ix_(private, private)], overwrite_a=True, check_finite=False)
        response = sl.lu_solve(factor, coupling, check_finite=False)
        return _Cell(unknowns[private], shared, factor, response), rest - coupling.T @ response

    def _add(self, data: np.ndarray, shared: np.ndarray, rest: np.ndarray) -> None:
        """Add the lower triangle of a Schur complement (b, b), whose unknowns have growing numbers."""
        indptr, indices = self._pattern.indptr, self._pattern.indices
        for position, column in enumerate(shared):
            start, end = indptr[column : column + 2]
            data[start + np.searchsorted(indices[start:end], shared[position:])] += rest[position:, position]

    def _add_entries(self, data: np.ndarray, rows: np.ndarray, columns: np.ndarray, values: np.ndarray) -> None:
        """Add those entries of a symmetric matrix that lie in the lower triangle."""
        indptr, indices = self._pattern.indptr, self._pattern.indices
        for row, column, value in zip(rows, columns, values, strict=True):
            if row >= column:
                start, end = indptr[column : column + 2]
                data[start + np.searchsorted(indices[start:end], row)] += value


@dataclass(frozen=True)
class CondensedSolver:
    """Solves with the whole operator: forward through the cells, then the shared unknowns, then back into the cells.

    Attributes
    ----------
    shared : (s,) the shared unknowns;  solver : of their matrix (s, s)
    """

    cells: list[_Cell]
    shared: np.ndarray
    solver: SymmetricSolver

    def solve(self, right: np.ndarray) -> np.ndarray:
        """A⁻¹ right, (m,) or (m, k)."""
        at_shared = right[self.shared]
        for cell in self.cells:
            at_shared[cell.shared] -= cell.response.T @ right[cell.private]
        at_shared = self.solver.solve(at_shared)
        found = np.empty_like(right)
        found[self.shared] = at_shared
        for cell in self.cells:
            inside = sl.lu_solve(cell.factor, right[cell.private], check_finite=False)
            found[cell.private] = inside - cell.response @ at_shared[cell.shared]
        return found
