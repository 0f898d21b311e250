"""The growing basis of a reduced model: orthonormal displacements, orthonormal inner potentials, one lifting.

Displacement and potential parts are kept apart, so that the balance between them may change with the constants.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from femu_piezo.forward.model import POTENTIAL_SCALE, ElectroelasticModel
from femu_piezo.forward.projection import TermProjections


class ReducedBasis:
    """Real basis with the projections of all affine terms on it.

    Parameters
    ----------
    reference : (n_terms,) real coefficients of the affine terms; their dielectric part measures the potentials
    static : (m,) response to a charge, whose potential becomes the lifting of the electrode voltage

    Attributes
    ----------
    u : (n_u, k_u) displacements, uᵗMu = 1
    p : (n_p, k_p) potentials, hot electrode last; first the lifting (hot electrode at 1 V), then inner potentials
    """

    def __init__(self, model: ElectroelasticModel, reference: np.ndarray, static: np.ndarray) -> None:
        self._model, self._projections = model, TermProjections(model)
        self.split = model.displacements
        self.mass = self._projections.mass
        self._dielectric = self._dielectric_of(model.operator(reference))
        self.u = np.zeros((self.split, 0))
        self.p = (static[self.split :] / (static[-1] * POTENTIAL_SCALE))[:, None]

    def add(self, vectors: np.ndarray, keep: float) -> int:
        """Add what is new by more than `keep` of the largest in vectors (m, k); return the number of new columns."""
        new_u = new_directions(self.u, vectors[: self.split], keep, self.mass)
        inner = vectors[self.split : -1] - np.outer(self.p[:-1, 0], vectors[-1] * POTENTIAL_SCALE)
        new_p = new_directions(self.p[:-1, 1:], inner, keep, self._dielectric)
        new_p = np.concatenate([new_p, np.zeros((1, new_p.shape[1]))])
        self.u = np.hstack([self.u, new_u])
        self.p = np.hstack([self.p, new_p])
        return new_u.shape[1] + new_p.shape[1]

    def matrices(self) -> np.ndarray:
        """VᵗA_qV (n_terms, r, r); unknowns: displacements, inner potentials, hot potential in volts."""
        return self._projections.project(self.u, self.p)

    def images(self, coefficients: np.ndarray, states: np.ndarray) -> np.ndarray:
        """Σ c_q A_q V y, (m, k), for reduced states y (r, k) and real coefficients c (n_terms,)."""
        ku = self.u.shape[1]
        potentials = np.concatenate([states[-1:], states[ku:-1]])
        return self._model.operator(coefficients) @ np.concatenate([self.u @ states[:ku], self.p @ potentials])

    def _dielectric_of(self, operator: spla.LinearOperator) -> spla.LinearOperator:
        """(n, n) − the operator on inner potentials alone."""
        inner = slice(self.split, operator.shape[0] - 1)

        def times(potentials: np.ndarray) -> np.ndarray:
            vectors = np.zeros((operator.shape[0], potentials.reshape(inner.stop - inner.start, -1).shape[1]))
            vectors[inner] = potentials.reshape(vectors[inner].shape)
            return -(operator @ vectors)[inner]

        return spla.LinearOperator((inner.stop - inner.start,) * 2, matvec=times, matmat=times, dtype=float)

    @property
    def matrix(self) -> np.ndarray:
        """V (m, r) in free unknowns."""
        ku, kp = self.u.shape[1], self.p.shape[1]
        result = np.zeros((self.split + self.p.shape[0], ku + kp))
        result[: self.split, :ku] = self.u
        result[self.split :, ku:-1] = self.p[:, 1:]
        result[self.split :, -1] = self.p[:, 0]
        return result


def new_directions(
    old: np.ndarray, vectors: np.ndarray, keep: float, weight: sp.spmatrix | spla.LinearOperator
) -> np.ndarray:
    """Weight-orthonormal directions of `vectors` (n, k) outside span(old), larger than `keep` of the largest vector.

    Two projections and a Gram eigenproblem find them; two more orthonormalisations verify the own result.
    """
    scale = np.sqrt(np.max(np.sum(vectors * (weight @ vectors), axis=0), initial=0.0))
    if scale == 0.0:
        return vectors[:, :0]
    rest = vectors
    for _ in range(2):
        rest = rest - old @ (old.T @ (weight @ rest))
    values, rotation = np.linalg.eigh(rest.T @ (weight @ rest))
    chosen = values > (keep * scale) ** 2
    fresh = (rest @ rotation[:, chosen]) / np.sqrt(values[chosen])
    for _ in range(2 if fresh.shape[1] else 0):
        weighted = weight @ fresh
        fresh = fresh - old @ (old.T @ weighted)
        lower = np.linalg.cholesky(fresh.T @ (weight @ fresh))
        fresh = np.linalg.solve(lower, fresh.T).T
    return fresh
