"""Training of a reduced basis: real states at training constants, their residuals, and the change of Z they cause.

All operators are lossless here, hence real and symmetric; a uniform loss factor η enters in closed form,
F(ω) = (1+jη) [C∞ + Σ g²/(λ − ω²/(1+jη))].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from femu_piezo.forward.krylov import LOSS
from femu_piezo.forward.modal import ModalModel, diagonalise
from femu_piezo.forward.reduced_basis import ReducedBasis
from femu_piezo.threads import in_parallel

#: Modes up to `_BEYOND` times the top ω² are trained; at most `_MOST_CORRECTIONS` directions are corrected in a round.
_BEYOND, _MOST_CORRECTIONS = 1.5, 400


@dataclass(frozen=True)
class TrainingSet:
    """The lossless reduced model at one training point.

    Attributes
    ----------
    coefficients : (n_terms,) real coefficients of the affine terms
    modal : its poles and zeros, real
    states : (r, k) reduced states: open-circuit modes z_n with λ_n < 1.5 top, then the remainder t(s) of the driven
        state without these modes at s = 0, top/2 and top. Their energy is one, except for modes that the terminals
        hardly drive: there it is the share of the resonance in Z.
    inertia : (k_u, k) displacements on which the mass acts in the equation of each state: λz for a mode, as
        (A − λM)z = 0, and s t + Σ h_n z_n for the remainder, as x = t − Σ h_n z_n/(λ_n − s) is the driven state:
        A t − M (s t + Σ h_n z_n) = load
    top : ω² at the top of the band
    """

    coefficients: np.ndarray
    modal: ModalModel
    states: np.ndarray
    inertia: np.ndarray
    top: float

    @classmethod
    def of(cls, matrices: np.ndarray, displacements: int, coefficients: np.ndarray, top: float) -> TrainingSet:
        """Diagonalise projected terms (n_terms, r, r) at real coefficients (n_terms,)."""
        stiffness = np.tensordot(coefficients, matrices, axes=1)
        modal = diagonalise(stiffness, matrices, displacements, 1.0)
        values, modes, amplitudes = modal.zeros[0], modal.zero_states(), modal.zero_amplitudes
        inside = values < _BEYOND * top
        outside = modes[:, ~inside] * amplitudes[~inside]
        below = np.array([0.0, 0.5, 1.0]) * top
        clamped = modal.states[:, 0] / modal.clamped_capacitance
        rest = np.column_stack([clamped - outside @ (1 / (values[~inside] - s)) for s in below])
        states = np.column_stack([modes[:, inside], rest])
        inertia = np.column_stack([modes[:, inside] * values[inside], rest * below])[:displacements]
        inertia[:, -3:] += (modes[:displacements, inside] @ amplitudes[inside])[:, None]
        energy = np.einsum("ik,ik->k", states, stiffness @ states)
        size = np.sqrt(np.abs(energy) + 0.01 * top * np.sum(states[:displacements] ** 2, axis=0))
        driven = np.abs(amplitudes[inside] ** 2 * modal.clamped_capacitance) / (LOSS * size[:-3] ** 2)
        weight = np.append(np.sqrt(driven / (1 + driven)), np.ones(3)) / size
        return cls(coefficients, modal, states * weight, inertia * weight, top)

    @staticmethod
    def principal_components(
        sets: list[TrainingSet], matrices: np.ndarray, displacements: int, tolerance: float
    ) -> tuple[np.ndarray, int]:
        """Matrix (r, r') from the principal components of the states of all sets, and their number of displacements.

        Components whose singular value exceeds `tolerance` times the largest one of the displacements are kept.
        Displacements are measured in elastic energy of the first set, inner potentials in dielectric energy, in which
        the basis is orthonormal.
        """
        ku, size = displacements, matrices.shape[1]
        states = np.hstack([item.states for item in sets])
        elastic = np.tensordot(sets[0].coefficients, matrices[:, :ku, :ku], axes=1)
        lower = np.linalg.cholesky(elastic + 0.01 * sets[0].top * np.eye(ku))
        left, values, _ = np.linalg.svd(lower.T @ states[:ku], full_matrices=False)
        u = np.linalg.solve(lower.T, left[:, values > tolerance * values[0]])
        u = np.linalg.qr(u)[0]
        left, inner, _ = np.linalg.svd(states[ku:-1], full_matrices=False)
        p = left[:, inner > tolerance * values[0]]
        rotation = np.zeros((size, u.shape[1] + p.shape[1] + 1))
        rotation[:ku, : u.shape[1]] = u
        rotation[ku:-1, u.shape[1] : -1] = p
        rotation[-1, -1] = 1.0
        return rotation, u.shape[1]


def state_residuals(basis: ReducedBasis, item: TrainingSet) -> np.ndarray:
    """Residuals (m, k) of the states of a training set, made orthogonal to the lifting by a charge on the electrode."""
    residual = basis.images(item.coefficients, item.states)
    residual[: basis.split] -= basis.mass @ (basis.u @ item.inertia)
    lifting = basis.p[:, 0]
    residual[-1] -= lifting @ residual[basis.split :] / lifting[-1]
    return residual


def leading_residuals(basis: ReducedBasis, sets: Sequence[TrainingSet], scale: np.ndarray, share: float) -> np.ndarray:
    """(m, j) leading principal directions of the residuals of the states of several sets, longest first.

    They are as long as the residuals are along them. The residuals are the largest object of a reduction, so there is
    one copy of them.

    Parameters
    ----------
    scale : (m,) diagonal of the operator; the length of a residual is that of residual / √scale
    share : directions shorter than this share of the longest are dropped
    """
    ends = np.cumsum([0, *(item.states.shape[1] for item in sets)])
    scaled, root = np.empty((scale.size, ends[-1])), np.sqrt(scale)[:, None]
    every = in_parallel(lambda item: state_residuals(basis, item), sets)
    for start, end, residuals in zip(ends[:-1], ends[1:], every, strict=True):
        np.divide(residuals, root, out=scaled[:, start:end])
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    chosen = values > share**2 * values[-1]
    directions = scaled @ vectors[:, chosen][:, : -_MOST_CORRECTIONS - 1 : -1]
    directions *= root
    return directions


def worst_change(old: TrainingSet, new: TrainingSet) -> float:
    """Largest relative change of Z between two reduced models, with the loss factor `LOSS`.

    Z is compared at poles and zeros of the new one in the band, and at 40 equally spaced frequencies.
    """
    squares = np.concatenate([new.modal.eigenvalues, new.modal.zeros[0]])
    inside = squares[(squares > 1e-4 * new.top) & (squares < new.top)]
    grid = np.concatenate([inside, np.linspace(0.02, 1.0, 40) ** 2 * new.top]) / (1 + 1j * LOSS)

    def charge(modal: ModalModel) -> np.ndarray:
        return modal.clamped_capacitance + (1 / (modal.eigenvalues - grid[:, None])) @ modal.charges**2

    return float(np.max(np.abs(charge(old.modal) / charge(new.modal) - 1)))
