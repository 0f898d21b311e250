"""Training of a reduced basis: real modes at training constants, their residuals, and the change of Z they cause.

Everything is lossless here, hence real and symmetric; a uniform loss factor enters in closed form,
F(ω) = (1+jη) [C∞ + Σ g²/(λ − ω²/(1+jη))].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femu_piezo.forward.krylov import LOSS
from femu_piezo.forward.modal import ModalModel, diagonalise
from femu_piezo.forward.reduced_basis import ReducedBasis

#: Modes up to this multiple of the top ω² are trained; at most so many corrections in one round.
_BEYOND, _MOST_CORRECTIONS = 1.5, 120


@dataclass(frozen=True)
class TrainingSet:
    """The lossless reduced model at one training point.

    Attributes
    ----------
    coefficients : (n_terms,) real coefficients of the affine terms
    modal : its poles and zeros, real
    states : (r, k) reduced states: open-circuit modes up to beyond the band, then what all higher modes add to the
        driven state at the bottom, in the middle and at the top of the band. Their energy is one, less for modes
        that the terminals hardly drive: there it is the share of the resonance in Z.
    inertia : (k_u, k) what the mass acts on in the equation of each state: (A − λM)z = 0 for a mode, and for the
        remainder t(s) of the driven state x = t − Σ h_n z_n/(λ_n − s):  A t − M (s t + Σ h_n z_n) = load
    top : ω² at the top of the band
    """

    coefficients: np.ndarray
    modal: ModalModel
    states: np.ndarray
    inertia: np.ndarray
    top: float

    @classmethod
    def of(cls, matrices: np.ndarray, displacements: int, coefficients: np.ndarray, top: float) -> TrainingSet:
        """Diagonalise projected terms (n_terms, r, r) at real coefficients."""
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
        """Rotation (r, r') to the components of all states above `tolerance` of the largest, and their u count.

        Displacements are measured in elastic energy of the first set, inner potentials in dielectric energy (in
        which the basis is orthonormal).
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
    """Residuals (m, k) of the states of one training set, the electrode's charge taken out."""
    residual = basis.images(item.coefficients, item.states)
    residual[: basis.split] -= basis.mass @ (basis.u @ item.inertia)
    lifting = basis.p[:, 0]
    residual[-1] -= lifting @ residual[basis.split :] / lifting[-1]
    return residual


def compressed(residuals: np.ndarray, scale: np.ndarray, share: float) -> np.ndarray:
    """The leading directions of residuals (m, k), measured by the diagonal of the operator, with their size.

    share : of the largest, below which the others are left
    """
    scaled = residuals / np.sqrt(scale)[:, None]
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    chosen = values > share**2 * values[-1]
    return residuals @ vectors[:, chosen][:, -_MOST_CORRECTIONS:]


def worst_change(old: TrainingSet, new: TrainingSet) -> float:
    """Largest relative change of Z in the band between two reduced models, at poles, zeros and in between."""
    squares = np.concatenate([new.modal.eigenvalues, new.modal.zeros[0]])
    inside = squares[(squares > 1e-4 * new.top) & (squares < new.top)]
    grid = np.concatenate([inside, np.linspace(0.02, 1.0, 40) ** 2 * new.top]) / (1 + 1j * LOSS)

    def charge(modal: ModalModel) -> np.ndarray:
        return modal.clamped_capacitance + (1 / (modal.eigenvalues - grid[:, None])) @ modal.charges**2

    return float(np.max(np.abs(charge(old.modal) / charge(new.modal) - 1)))
