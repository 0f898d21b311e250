"""Closed forms of a small electro-elastic pencil: poles and zeros with their exact derivatives, and Z(f).

With the inner potentials eliminated and the displacement in modal coordinates (w_nᵗw_m = δ_nm), the charge per volt of
the part is a sum of partial fractions

    F(ω) = Q/V = C∞ + Σ_n g_n²/(λ_n − ω²),      Y = jω · admittance_factor · F.

Its poles are λ_n, its zeros the eigenvalues of diag(λ) + g gᵗ/C∞.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femu_piezo.threads import blas_limit, made_once


@dataclass(frozen=True)
class ModalModel:
    """Diagonalised reduced model at fixed constants.

    Attributes
    ----------
    eigenvalues : (n,) complex λ_n of the short-circuited plate, rad²/s² (real where the constants are)
    charges : (n,) complex g_n, modal charge on the hot electrode of the part
    clamped_capacitance : complex C∞ of the part, F
    states : (r, n+1) complex, in reduced coordinates: the clamped state for one volt, then x_n of every mode
    terms : (n_terms, r, r) real projected unit matrices A_q, voltage in volts
    admittance_factor : Y of the specimen / Y of the part
    """

    eigenvalues: np.ndarray
    charges: np.ndarray
    clamped_capacitance: complex
    states: np.ndarray
    terms: np.ndarray
    admittance_factor: float

    def admittance(self, omega: np.ndarray) -> np.ndarray:
        """Y of the specimen (k,), siemens, at angular frequencies (k,)."""
        with blas_limit():
            fraction = self.clamped_capacitance + 1 / (self.eigenvalues - omega[:, None] ** 2) @ self.charges**2
        return 1j * omega * self.admittance_factor * fraction

    def impedance(self, omega: np.ndarray) -> np.ndarray:
        """Z of the specimen (k,), ohm."""
        return 1.0 / self.admittance(omega)

    @made_once
    def zeros(self) -> tuple[np.ndarray, np.ndarray]:
        """(λ, vectors) of the open circuit, in modal coordinates, vᵗv = 1, sorted by Re λ."""
        matrix = np.diag(self.eigenvalues) + np.outer(self.charges, self.charges) / self.clamped_capacitance
        return _eigen(matrix)

    @property
    def zero_amplitudes(self) -> np.ndarray:
        """(n,) complex open-circuit potential of every zero's mode, V: h = gᵗv/C∞."""
        return self.charges @ self.zeros[1] / self.clamped_capacitance

    def zero_states(self) -> np.ndarray:
        """(r, n) states of the zeros in reduced coordinates, vᵗv = 1 in the displacements."""
        return self.states[:, 1:] @ self.zeros[1] + self.states[:, :1] * self.zero_amplitudes

    def pole_sensitivity(self, index: int) -> np.ndarray:
        """∂λ_n/∂c_q of one pole, (n_terms,) complex (eqs 56-60)."""
        state = self.states[:, index + 1]
        return (self.terms @ state) @ state

    def zero_sensitivity(self, index: int) -> np.ndarray:
        """∂λ/∂c_q of one zero, (n_terms,) complex."""
        state = self.states[:, 1:] @ self.zeros[1][:, index] + self.states[:, 0] * self.zero_amplitudes[index]
        return (self.terms @ state) @ state


def _eigen(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenpairs of a symmetric matrix, real or complex, vᵗv = 1, sorted by real part."""
    if not np.iscomplexobj(matrix):
        return np.linalg.eigh(matrix)
    values, vectors = np.linalg.eig(matrix)
    order = np.argsort(values.real)
    values, vectors = values[order], vectors[:, order]
    return values, vectors / np.sqrt(np.sum(vectors**2, axis=0))


def diagonalise(stiffness: np.ndarray, terms: np.ndarray, displacements: int, admittance_factor: float) -> ModalModel:
    """Diagonalise a reduced pencil whose mass is the identity on the displacements.

    Parameters
    ----------
    stiffness : (r, r) symmetric Σ c_q A_q, real or complex; unknowns: displacements, inner potentials, hot potential
    terms : (n_terms, r, r) the unit matrices
    displacements : how many of the r unknowns are displacements
    """
    u, size = displacements, stiffness.shape[0]
    right = np.concatenate([stiffness[u:-1, :u], stiffness[u:-1, -1:]], axis=1)
    eliminated = -np.linalg.solve(stiffness[u:-1, u:-1], right)  # inner potential per displacement and per volt
    condensed = stiffness[:u, :u] + stiffness[:u, u:-1] @ eliminated[:, :-1]
    coupling = stiffness[:u, -1] + stiffness[:u, u:-1] @ eliminated[:, -1]
    clamped = -(stiffness[-1, -1] + stiffness[-1, u:-1] @ eliminated[:, -1])
    values, vectors = _eigen((condensed + condensed.T) / 2)
    states = np.zeros((size, u + 1), dtype=stiffness.dtype)
    states[u:-1, 0] = eliminated[:, -1]
    states[-1, 0] = 1.0
    states[:u, 1:] = vectors
    states[u:-1, 1:] = eliminated[:, :-1] @ vectors
    return ModalModel(values, vectors.T @ coupling, clamped.item(), states, terms, admittance_factor)
