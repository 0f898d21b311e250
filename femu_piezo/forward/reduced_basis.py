"""The growing basis of a reduced model: orthonormal displacements, orthonormal inner potentials, and one lifting.

The lifting is a potential field with 1 V on the hot electrode. Displacements and potentials are separate basis vectors,
so that the ratio between them can change with the constants.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from femu_piezo.forward.model import POTENTIAL_SCALE, ElectroelasticModel
from femu_piezo.forward.projection import TermProjections


class ReducedBasis:
    """Real basis with the projections of all affine terms on it.

    Parameters
    ----------
    reference : (n_terms,) real coefficients of the affine terms; their dielectric part is the norm of potentials
    static : (m,) response to a charge; its potential, scaled to 1 V on the electrode, becomes the lifting

    Attributes
    ----------
    u : (n_u, k_u) displacements, uᵗMu = 1
    p : (n_p, k_p) potentials, hot electrode in the last row; the first column is the lifting, then inner potentials
    split : n_u;  mass : M (n_u, n_u) of the displacements
    """

    def __init__(self, model: ElectroelasticModel, reference: np.ndarray, static: np.ndarray) -> None:
        self._model, self._projections = model, TermProjections(model)
        self.split = model.displacements
        self.mass = self._projections.mass
        self._dielectric = self._dielectric_of(model.operator(reference))
        self.u = np.zeros((self.split, 0))
        self.p = (static[self.split :] / (static[-1] * POTENTIAL_SCALE))[:, None]

    def add(self, vectors: np.ndarray, keep: float) -> int:
        """Add the directions of vectors (m, k) outside the basis; return the number of new columns.

        keep : directions smaller than this share of the largest vector are dropped
        """
        return self.add_all([vectors], keep)

    def add_all(self, blocks: Iterable[np.ndarray], keep: float) -> int:
        """`add` of several blocks of vectors, each (m, k); a vector counts as the largest in its block and later ones.

        So the largest vectors come first.
        """
        before, largest_u, largest_p = self.u.shape[1] + self.p.shape[1], 0.0, 0.0
        for vectors in blocks:
            moved = vectors[: self.split]
            largest_u = max(largest_u, largest_norm(moved, self.mass))
            new_u = new_directions(self.u, moved, keep * largest_u, self.mass)
            inner = vectors[self.split : -1] - np.outer(self.p[:-1, 0], vectors[-1] * POTENTIAL_SCALE)
            largest_p = max(largest_p, largest_norm(inner, self._dielectric))
            new_p = new_directions(self.p[:-1, 1:], inner, keep * largest_p, self._dielectric)
            self.u = np.hstack([self.u, new_u])
            self.p = np.hstack([self.p, np.concatenate([new_p, np.zeros((1, new_p.shape[1]))])])
        return self.u.shape[1] + self.p.shape[1] - before

    def matrices(self) -> np.ndarray:
        """VᵗA_qV (n_terms, r, r); unknowns: displacements, inner potentials, hot potential in volts."""
        return self._projections.project(self.u, self.p)

    def images(self, coefficients: np.ndarray, states: np.ndarray) -> np.ndarray:
        """Σ c_q A_q V y, (m, k), for reduced states y (r, k) and real coefficients c (n_terms,)."""
        ku = self.u.shape[1]
        potentials = np.concatenate([states[-1:], states[ku:-1]])
        return self._model.operator(coefficients) @ np.concatenate([self.u @ states[:ku], self.p @ potentials])

    def _dielectric_of(self, operator: spla.LinearOperator) -> spla.LinearOperator:
        """(n, n) −A on inner potentials alone: the dielectric energy, positive definite."""
        inner = slice(self.split, operator.shape[0] - 1)

        def times(potentials: np.ndarray) -> np.ndarray:
            vectors = np.zeros((operator.shape[0], potentials.reshape(inner.stop - inner.start, -1).shape[1]))
            vectors[inner] = potentials.reshape(vectors[inner].shape)
            return -(operator @ vectors)[inner]

        return spla.LinearOperator((inner.stop - inner.start,) * 2, matvec=times, matmat=times, dtype=float)

    @property
    def matrix(self) -> np.ndarray:
        """V (m, r): the basis in free unknowns, columns ordered as the unknowns of `matrices`."""
        ku, kp = self.u.shape[1], self.p.shape[1]
        result = np.zeros((self.split + self.p.shape[0], ku + kp))
        result[: self.split, :ku] = self.u
        result[self.split :, ku:-1] = self.p[:, 1:]
        result[self.split :, -1] = self.p[:, 0]
        return result


def largest_norm(vectors: np.ndarray, weight: sp.spmatrix | spla.LinearOperator) -> float:
    """The largest √(vᵗ W v) of vectors (n, k); 0 where there are none."""
    return float(np.sqrt(np.max(np.sum(vectors * (weight @ vectors), axis=0), initial=0.0)))


def new_directions(
    old: np.ndarray, vectors: np.ndarray, least: float, weight: sp.spmatrix | spla.LinearOperator
) -> np.ndarray:
    """Weight-orthonormal directions of `vectors` (n, k) outside span(old), larger than `least`.

    Two projections and a Gram eigenproblem find them; two orthonormalisations of the result remove rounding errors.
    """
    rest = vectors
    for _ in range(2):
        rest = rest - old @ (old.T @ (weight @ rest))
    values, rotation = np.linalg.eigh(rest.T @ (weight @ rest))
    chosen = values > least**2
    fresh = (rest @ rotation[:, chosen]) / np.sqrt(values[chosen])
    for _ in range(2 if fresh.shape[1] else 0):
        weighted = weight @ fresh
        fresh = fresh - old @ (old.T @ weighted)
        lower = np.linalg.cholesky(fresh.T @ (weight @ fresh))
        fresh = np.linalg.solve(lower, fresh.T).T
    return fresh
