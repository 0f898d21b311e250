"""Sparse symmetric indefinite factorisation behind one small function.

rslab's LDLᵗ (real symmetric or complex symmetric, A = Aᵗ) does the work; scipy's SuperLU stands in where rslab
is missing or gives up. Every solution is checked by its residual and refined once if need be. The symbolic
analysis of a pattern is kept by `Analysis`, for sweeps over frequency or constants.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from femu_piezo.errors import ConvergenceError
from femu_piezo.threads import useful_threads

try:
    import rslab
except ImportError:  # no wheel for this platform
    rslab = None

#: Relative residual above which a solution is refined, and above which it is refused.
REFINE_ABOVE, REFUSE_ABOVE = 1e-11, 1e-7
#: Random sums of columns whose residuals are looked at in place of those of all (Freivalds 1979).
_SUMS = 3


class Solver(Protocol):
    """What a factor does, without a look at what it leaves."""

    def solve(self, right: np.ndarray) -> np.ndarray:
        """A^-1 right, (n,) or (n, k), in the type of the factor."""
        ...


@dataclass(frozen=True)
class SymmetricSolver:
    """A factor of a sparse matrix by one of the libraries.

    Attributes
    ----------
    backend : "rslab" or "scipy"
    """

    factor: Any
    backend: str

    def solve(self, right: np.ndarray) -> np.ndarray:
        """A^-1 right, (n,) or (n, k), in the type of the factor; k may be 0, of which the libraries know nothing."""
        if right.size == 0:
            return right
        if self.backend == "scipy":
            return self.factor.solve(np.asfortranarray(right))
        return self.factor.solve(right) if right.ndim == 1 else self.factor.solve_many(np.ascontiguousarray(right))


class Factorization:
    """A factorised symmetric matrix: `solve` for one or many right-hand sides, each solution checked and refined.

    Parameters
    ----------
    matrix : what the residuals belong to; has `@` and `dtype`
    solver : of the same matrix
    diagonal : (n,) of the matrix, which measures residuals as they count in energy: among cells of very different sizes
        the forces on the smallest are rounded most and mean least
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
        """A^-1 right, (n,) or (n, k), as the factor gives it: for those who `check` several solutions at once."""
        if np.iscomplexobj(right) and not np.issubdtype(self._matrix.dtype, np.complexfloating):
            return self.solve_unchecked(right.real) + 1j * self.solve_unchecked(right.imag)
        return self._solver.solve(np.asarray(right, dtype=self._matrix.dtype))

    def check(self, solution: np.ndarray, right: np.ndarray) -> None:
        """ConvergenceError where what solutions (n,) or (n, k) leave of the right-hand sides is large."""
        error = self._error(solution, right)
        if not error < REFUSE_ABOVE:
            raise ConvergenceError(
                f"the linear solver left a relative residual of {error:.1e}; the operator is nearly singular "
                "here (a frequency on a lossless resonance, or a floating part): move the frequency or add loss"
            )

    def _error(self, solution: np.ndarray, right: np.ndarray) -> float:
        """Relative residual; of several columns that of a few random sums of them, whose mean square is the same."""
        if right.ndim == 2 and right.shape[1] > _SUMS:
            signs = np.random.default_rng(0).choice([-1.0, 1.0], (right.shape[1], _SUMS))
            solution, right = solution @ signs, right @ signs
        return self._size(right - self._matrix @ solution) / (self._size(right) or 1.0)

    def _size(self, loads: np.ndarray) -> float:
        return float(np.linalg.norm((self._weight * loads.T).T))


@dataclass(frozen=True)
class _Symbolic:
    """The analysis of one pattern (CSC, sorted), and the places of its lower triangle, which rslab reads; all of them
    where that alone is given."""

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
        return np.array_equal(matrix.indptr, self.indptr) and np.array_equal(matrix.indices, self.indices)


class Analysis:
    """Symbolic analysis of a sparsity pattern, kept from one matrix to the next for as long as the pattern stays.

    Parameters
    ----------
    backend : None for the best at hand, "scipy" to force SuperLU (which keeps no analysis)
    """

    def __init__(self, backend: str | None = None) -> None:
        self._rslab = rslab is not None and backend != "scipy"
        self._latest: _Symbolic | None = None  # in one piece: threads share an analysis
        self.analyses = 0  #: symbolic analyses made so far

    def of(self, matrix: sp.csc_matrix) -> _Symbolic | None:
        """The analysis of a pattern (CSC, sorted), the latest where it serves; None without rslab."""
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
        """Factorise a symmetric matrix by all of its entries or its lower triangle (CSC, sorted)."""
        if self._rslab:
            latest = self.of(matrix)
            try:
                return SymmetricSolver(latest.symbolic.factor(matrix.data[latest.lower]), "rslab")
            except RuntimeError as error:
                warnings.warn(f"rslab could not factorise ({error}); SuperLU is used", RuntimeWarning, stacklevel=2)
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
