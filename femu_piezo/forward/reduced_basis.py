"""The growing basis of a reduced model: orthonormal displacements, orthonormal inner potentials, one lifting.

Displacement and potential parts are kept apart, so that the balance between them may change with the constants.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from femu_piezo.forward.model import POTENTIAL_SCALE, ElectroelasticModel
from femu_piezo.forward.projection import TermImages


class ReducedBasis:
    """Real basis with the images of all affine terms on it.

    Parameters
    ----------
    stiffness : (m, m) real operator of the reference constants; its dielectric part measures the potentials
    static : (m,) response to a charge, whose potential becomes the lifting of the electrode voltage

    Attributes
    ----------
    u : (n_u, k_u) displacements, uᵗMu = 1
    p : (n_p, k_p) potentials, hot electrode last; first the lifting (hot electrode at 1 V), then inner potentials
    """

    def __init__(self, model: ElectroelasticModel, stiffness: sp.csr_matrix, static: np.ndarray) -> None:
        self.images = TermImages(model)
        self.split = self.images.displacements
        self.mass = self.images.mass
        self._dielectric = -stiffness[self.split : -1, self.split : -1]
        self.u = np.zeros((self.split, 0))
        self.p = (static[self.split :] / (static[-1] * POTENTIAL_SCALE))[:, None]
        self.images.add("p", self.p)

    def add(self, vectors: np.ndarray, keep: float) -> int:
        """Add what is new by more than `keep` of the largest in vectors (m, k); return the number of new columns."""
        new_u = new_directions(self.u, vectors[: self.split], keep, self.mass)
        inner = vectors[self.split : -1] - np.outer(self.p[:-1, 0], vectors[-1] * POTENTIAL_SCALE)
        new_p = new_directions(self.p[:-1, 1:], inner, keep, self._dielectric)
        new_p = np.concatenate([new_p, np.zeros((1, new_p.shape[1]))])
        self.images.add("u", new_u)
        self.images.add("p", new_p)
        self.u = np.hstack([self.u, new_u])
        self.p = np.hstack([self.p, new_p])
        return new_u.shape[1] + new_p.shape[1]

    def matrices(self) -> np.ndarray:
        """VᵗA_qV (n_terms, r, r); unknowns: displacements, inner potentials, hot potential in volts."""
        return self.images.project(self.u, self.p)

    @property
    def matrix(self) -> np.ndarray:
        """V (m, r) in free unknowns."""
        ku, kp = self.u.shape[1], self.p.shape[1]
        result = np.zeros((self.split + self.p.shape[0], ku + kp))
        result[: self.split, :ku] = self.u
        result[self.split :, ku:-1] = self.p[:, 1:]
        result[self.split :, -1] = self.p[:, 0]
        return result


def new_directions(old: np.ndarray, vectors: np.ndarray, keep: float, weight: sp.spmatrix) -> np.ndarray:
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
