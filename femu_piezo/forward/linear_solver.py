"""Sparse symmetric indefinite factorisation: `factorize`, and `Analysis` for many matrices of one sparsity pattern.

rslab factorises LDLᵗ (real symmetric or complex symmetric, A = Aᵗ); scipy's SuperLU replaces it where rslab is missing
or fails. `Factorization.solve` checks every solution by its residual and refines it once if necessary. `Analysis` keeps
the symbolic analysis of a pattern for sweeps over frequency or constants.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from femu_piezo.errors import ConvergenceError
from femu_piezo.threads import import_to_stay, useful_threads

try:
    rslab: Any = import_to_stay("rslab")
except ImportError:  # no wheel for this platform
    rslab = None

#: Relative residual above which a solution is refined, and above which it is refused with an error.
REFINE_ABOVE, REFUSE_ABOVE = 1e-11, 1e-7
#: Number of random sums of columns whose residuals are computed in place of those of all columns (Freivalds 1979).
_SUMS = 3


class Solver(Protocol):
    """Solves with a factorised matrix, without a check of the residual."""

    def solve(self, right: np.ndarray) -> np.ndarray:
        """A^-1 right, (n,) or (n, k), in the type of the factor."""
        ...


@dataclass(frozen=True)
class SymmetricSolver:
    """A sparse matrix factorised by rslab or SuperLU.

    Attributes
    ----------
    factor : the object of that library;  backend : "rslab" or "scipy"
    """

    factor: Any
    backend: str

    def solve(self, right: np.ndarray) -> np.ndarray:
        """A^-1 right, (n,) or (n, k), in the type of the factor; k may be 0, which the libraries do not accept."""
        if right.size == 0:
            return right
        if self.backend == "scipy":
            return self.factor.solve(np.asfortranarray(right))
        return self.factor.solve(right) if right.ndim == 1 else self.factor.solve_many(np.ascontiguousarray(right))


class Factorization:
    """A factorised symmetric matrix: `solve` for one or many right-hand sides, each solution checked and refined.

    Parameters
    ----------
    matrix : A, of which only `@` and `dtype` are used, for residuals
    solver : solves with A
    diagonal : (n,) diagonal of A. Residuals are divided by the square roots of its magnitudes, which measures them in
        energy: in meshes with cells of very different sizes, forces on the smallest cells have the largest rounding
        errors and the least effect.
    """

    def __init__(self, matrix: sp.csc_matrix | spla.LinearOperator, solver: Solver, diagonal: np.ndarray) -> None:
        self._matrix, self._solver = matrix, solver
        size = np.abs(diagonal)
        self._weight = 1 / np.sqrt(np.where(size > 0, size, 1.0))

    def solve(self, right: np.ndarray) -> np.ndarray:
        """A^-1 right, shape (n,) or (n, k); ConvergenceError where the residual stays large."""
        solution = self.solve_unchecked(right)
        if self._error(solution, right) > REFINE_ABOVE:
            solution = solution + self.solve_unchecked(right - self._matrix @ solution)
            self.check(solution, right)
        return solution

    def solve_unchecked(self, right: np.ndarray) -> np.ndarray:
        """A^-1 right, (n,) or (n, k), not checked or refined: for callers that `check` several solutions at once."""
        if np.iscomplexobj(right) and not np.issubdtype(self._matrix.dtype, np.complexfloating):
            return self.solve_unchecked(right.real) + 1j * self.solve_unchecked(right.imag)
        return self._solver.solve(np.asarray(right, dtype=self._matrix.dtype))

    def check(self, solution: np.ndarray, right: np.ndarray) -> None:
        """Raise ConvergenceError where the residual of solutions (n,) or (n, k) is large."""
        error = self._error(solution, right)
        if not error < REFUSE_ABOVE:
            raise ConvergenceError(
                f"the linear solver left a relative residual of {error:.1e}; the operator is nearly singular "
                "here (a frequency on a lossless resonance, or a floating part): move the frequency or add loss"
            )

    def _error(self, solution: np.ndarray, right: np.ndarray) -> float:
        """Relative residual of a column, or of a few random sums of many columns, which have the same mean square."""
        if right.ndim == 2 and right.shape[1] > _SUMS:
            signs = np.random.default_rng(0).choice([-1.0, 1.0], (right.shape[1], _SUMS))
            solution, right = solution @ signs, right @ signs
        return self._size(right - self._matrix @ solution) / (self._size(right) or 1.0)

    def _size(self, loads: np.ndarray) -> float:
        return float(np.linalg.norm((self._weight * loads.T).T))


@dataclass(frozen=True)
class _Symbolic:
    """The symbolic analysis of one sparsity pattern (CSC, sorted).

    Attributes
    ----------
    lower : positions of the lower triangle in the data, which rslab reads; all where a matrix is given by it alone
    """

    indptr: np.ndarray
    indices: np.ndarray
    lower: np.ndarray | slice
    symbolic: Any

    @classmethod
    def of(cls, matrix: sp.csc_matrix) -> _Symbolic:
        size = matrix.shape[0]
        columns = np.repeat(np.arange(size, dtype=np.int32), np.diff(matrix.indptr))
        symbolic = rslab.analyze(matrix, path="ldlt", ordering="auto", threads=useful_threads(size))
        below = matrix.indices >= columns
        return cls(matrix.indptr, matrix.indices, slice(None) if below.all() else np.flatnonzero(below), symbolic)

    def serves(self, matrix: sp.csc_matrix) -> bool:
        """Whether the matrix has this pattern."""
        return np.array_equal(matrix.indptr, self.indptr) and np.array_equal(matrix.indices, self.indices)


class Analysis:
    """Symbolic analysis of a sparsity pattern, kept from one matrix to the next for as long as the pattern stays.

    Parameters
    ----------
    backend : None for the best at hand, "scipy" to force SuperLU (which keeps no analysis)
    """

    def __init__(self, backend: str | None = None) -> None:
        self._rslab = rslab is not None and backend != "scipy"
        self._latest: _Symbolic | None = None  # one object, replaced as a whole: threads share an analysis
        self.analyses = 0  #: symbolic analyses made so far

    def __getstate__(self) -> dict[str, Any]:
        """Without the analysis, which cannot be copied or pickled and is made anew."""
        return self.__dict__ | {"_latest": None}

    def of(self, matrix: sp.csc_matrix) -> _Symbolic | None:
        """The symbolic analysis of a pattern (CSC, sorted), the latest where it serves; None without rslab."""
        latest = self._latest
        if self._rslab and (latest is None or not latest.serves(matrix)):
            self._latest = latest = _Symbolic.of(matrix)
            self.analyses += 1
        return latest

    def factorize(self, matrix: sp.spmatrix) -> Factorization:
        """Factorise a real or complex symmetric matrix (A = Aᵗ, not Hermitian)."""
        matrix = _canonical(matrix)
        return Factorization(matrix, self.solver(matrix), matrix.diagonal())

    def solver(self, matrix: sp.csc_matrix) -> SymmetricSolver:
        """Factorise a symmetric matrix that is given by all of its entries or by its lower triangle (CSC, sorted)."""
        if self._rslab:
            latest = self.of(matrix)
            try:
                return SymmetricSolver(latest.symbolic.factor(matrix.data[latest.lower]), "rslab")
            except RuntimeError as error:
                warnings.warn(
                    f"rslab could not factorise the matrix ({error}); SuperLU is used", RuntimeWarning, stacklevel=2
                )
        return SymmetricSolver(_superlu(_whole(matrix)), "scipy")


def factorize(matrix: sp.spmatrix, backend: str | None = None) -> Factorization:
    """Factorise a real or complex symmetric sparse matrix (A = Aᵗ, not Hermitian).

    Parameters
    ----------
    backend : None for the best at hand, "scipy" to force SuperLU
    """
    return Analysis(backend).factorize(matrix)


def _canonical(matrix: sp.spmatrix) -> sp.csc_matrix:
    """CSC with sorted indices; a CSR matrix is its own transpose here, so no conversion is made."""
    if matrix.format == "csr":
        matrix = matrix.T
    matrix = sp.csc_matrix(matrix)
    if not matrix.has_sorted_indices:
        matrix = matrix.sorted_indices()
    return matrix


def _whole(matrix: sp.csc_matrix) -> sp.csc_matrix:
    """All entries of a symmetric matrix that is given by them or by its lower triangle."""
    above = sp.triu(matrix, 1)
    return matrix if above.nnz else sp.csc_matrix(matrix + sp.tril(matrix, -1).T)


def _superlu(matrix: sp.csc_matrix):
    data = np.ascontiguousarray(matrix.data)
    matrix = sp.csc_matrix((data, matrix.indices, matrix.indptr), shape=matrix.shape)
    options = {"SymmetricMode": True}
    return spla.splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.1, options=options)
