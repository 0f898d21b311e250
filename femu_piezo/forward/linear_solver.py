"""Sparse symmetric indefinite factorisation behind one small function.

rslab's LDLᵗ (real symmetric or complex symmetric, A = Aᵗ) does the work; scipy's SuperLU stands in where rslab
is missing or gives up. Every solution is checked by its residual and refined once if need be.
"""

from __future__ import annotations

import warnings

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from femu_piezo.errors import ConvergenceError

try:
    import rslab
except ImportError:  # no wheel for this platform
    rslab = None

#: Relative residual above which a solution is refined, and above which it is refused.
REFINE_ABOVE, REFUSE_ABOVE = 1e-11, 1e-7


class Factorization:
    """A factorised symmetric matrix: `solve` for one or many right-hand sides.

    Attributes
    ----------
    inertia : (positive, negative, zero) eigenvalue counts of a real matrix, None where the backend has none
    backend : "rslab" or "scipy"
    """

    def __init__(self, matrix: sp.spmatrix, backend: str | None = None) -> None:
        self._matrix = sp.csc_matrix(matrix)
        self.backend, self._factor = _factor(self._matrix, backend)
        real = not np.iscomplexobj(self._matrix.data)
        self.inertia = tuple(self._factor.inertia) if self.backend == "rslab" and real else None

    def solve(self, right: np.ndarray) -> np.ndarray:
        """A^-1 right, shape (n,) or (n, k); ConvergenceError where the residual stays large."""
        solution = self._raw(right)
        residual = right - self._matrix @ solution
        scale = np.linalg.norm(right)
        if np.linalg.norm(residual) > REFINE_ABOVE * scale:
            solution = solution + self._raw(residual)
            error = np.linalg.norm(right - self._matrix @ solution) / scale
            if not error < REFUSE_ABOVE:
                raise ConvergenceError(
                    f"the linear solver left a relative residual of {error:.1e}; the operator is nearly singular "
                    "here (a frequency on a lossless resonance, or a floating part): move the frequency or add loss"
                )
        return solution

    def _raw(self, right: np.ndarray) -> np.ndarray:
        if np.iscomplexobj(right) and not np.iscomplexobj(self._matrix.data):
            return self._raw(right.real) + 1j * self._raw(right.imag)
        right = np.asarray(right, dtype=self._matrix.dtype)
        if self.backend == "scipy":
            return self._factor.solve(np.asfortranarray(right))
        return self._factor.solve(right) if right.ndim == 1 else self._factor.solve_many(np.ascontiguousarray(right))


def _factor(matrix: sp.csc_matrix, backend: str | None):
    if rslab is not None and backend != "scipy":
        try:
            return "rslab", rslab.ldlt(matrix, ordering="metis")
        except RuntimeError as error:
            warnings.warn(f"rslab could not factorise ({error}); SuperLU is used", RuntimeWarning, stacklevel=3)
    options = {"SymmetricMode": True}
    data = np.ascontiguousarray(matrix.data)
    matrix = sp.csc_matrix((data, matrix.indices, matrix.indptr), shape=matrix.shape)
    return "scipy", spla.splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.1, options=options)


def factorize(matrix: sp.spmatrix, backend: str | None = None) -> Factorization:
    """Factorise a real or complex symmetric sparse matrix (A = Aᵗ, not Hermitian).

    Parameters
    ----------
    backend : None for the best at hand, "scipy" to force SuperLU
    """
    return Factorization(matrix, backend)
