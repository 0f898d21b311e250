"""Z(f) of a reduced model whose coefficients c_q(ω) vary with frequency: dispersive constants, masses, springs.

No closed form serves all frequencies then. In the modal coordinates of the mean coefficients the modes near the
band are kept; the other modes and the inner potentials are eliminated exactly at a few Chebyshev points of log ω.
Their Schur complement has no resonance in the band, so polynomials interpolate it in between; exact values at
frequencies between the nodes decide how many nodes it takes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BarycentricInterpolator

from femu_piezo.forward.reduction import ReducedModel
from femu_piezo.forward.threads import blas_limit

#: ω (k,) → c (k, n_terms)
Coefficients = Callable[[np.ndarray], np.ndarray]

#: Modes up to these multiples of the highest ω² are kept, and numbers of interpolation nodes, in the order tried.
_KEEP, _NODES = (2.0, 8.0, 32.0), (8, 16, 32)


def dispersive_impedance(
    reduced: ReducedModel, coefficients: Coefficients, omega: np.ndarray, *, accuracy: float = 1e-7
) -> np.ndarray:
    """Z of the specimen (k,), ohm, at coefficients c_q(ω) of the affine terms.

    Parameters
    ----------
    coefficients : function of ω (n,) → (n, n_terms) complex, smooth in log ω
    omega : (k,) rad/s, positive
    accuracy : relative error allowed beside the one of the reduced model; where interpolation does not reach it
        (rough coefficients, a heavy mass), every frequency is solved with all unknowns
    """
    omega = np.asarray(omega, dtype=float)
    with blas_limit():
        charge = _interpolated(reduced, coefficients, omega, accuracy)
    if charge is None:
        return dispersive_impedance_exact(reduced, coefficients, omega)
    return 1 / (1j * omega * reduced.admittance_factor * charge)


def _interpolated(
    reduced: ReducedModel, coefficients: Coefficients, omega: np.ndarray, accuracy: float
) -> np.ndarray | None:
    """F(ω) (k,) with the fewest modes and nodes that pass the check, None where none does."""
    for keep in _KEEP:
        system = _System.of(reduced, coefficients, omega, keep)
        for count in _NODES:
            charge = system.charge(omega, count)
            probes = _probes(charge)
            if np.max(np.abs(charge[probes] / system.exact_charge(omega[probes]) - 1)) < accuracy:
                return charge
    return None


def dispersive_impedance_exact(reduced: ReducedModel, coefficients: Coefficients, omega: np.ndarray) -> np.ndarray:
    """The same by one dense solve of all reduced unknowns per frequency; arguments as `dispersive_impedance`."""
    omega = np.asarray(omega, dtype=float)
    with blas_limit():
        charge = _System.of(reduced, coefficients, omega, _KEEP[0]).exact_charge(omega)
    return 1 / (1j * omega * reduced.admittance_factor * charge)


def _probes(charge: np.ndarray) -> np.ndarray:
    """Indices to check: eight spread over the band, the largest and the smallest charge (a pole and a zero)."""
    spread = np.linspace(0, charge.size - 1, 8).astype(int)
    return np.unique([*spread, np.argmax(np.abs(charge)), np.argmin(np.abs(charge))])


@dataclass(frozen=True)
class _System:
    """Affine terms in modal coordinates of the mean coefficients, kept unknowns first.

    terms (n_terms, r, r); coefficients c(ω); inertia (r,) diagonal of the mass; kept: the voltage and the modes
    near the band
    """

    terms: np.ndarray
    coefficients: Coefficients
    inertia: np.ndarray
    kept: int

    @classmethod
    def of(cls, reduced: ReducedModel, coefficients: Coefficients, omega: np.ndarray, keep: float) -> _System:
        modal = reduced.modal_at(coefficients(omega).mean(axis=0))
        near = modal.eigenvalues.real < keep * omega.max() ** 2
        modes, u, size = modal.states[:, 1:], reduced.displacements, reduced.size
        inner = np.eye(size)[:, u : size - 1]
        basis = np.column_stack([modal.states[:, 0], modes[:, near], modes[:, ~near], inner])
        inertia = np.concatenate([[0.0], np.ones(u), np.zeros(size - 1 - u)])
        return cls(basis.T @ reduced.matrices @ basis, coefficients, inertia, 1 + int(near.sum()))

    def _matrices(self, omega: np.ndarray, rows: slice, columns: slice) -> np.ndarray:
        """A(ω) − ω²M (k, …) of a block of unknowns."""
        matrix = np.tensordot(self.coefficients(omega), self.terms[:, rows, columns], axes=1)
        if rows == columns:
            index = np.arange(matrix.shape[1])
            matrix[:, index, index] -= (omega**2)[:, None] * self.inertia[rows]
        return matrix

    def exact_charge(self, omega: np.ndarray) -> np.ndarray:
        """Charge per volt F(ω) with all unknowns."""
        parts = np.array_split(omega, max(1, omega.size // 64))
        return np.concatenate([_charge(self._matrices(part, slice(None), slice(None))) for part in parts])

    def charge(self, omega: np.ndarray, count: int) -> np.ndarray:
        """F(ω) with the Schur complement of the other unknowns interpolated from `count` Chebyshev points of log ω."""
        near, far = slice(0, self.kept), slice(self.kept, None)
        low, high = np.log([omega.min(), omega.max()])
        nodes = (low + high) / 2 + (high - low) / 2 * np.cos(np.pi * (np.arange(count) + 0.5) / count)
        coupling = self._matrices(np.exp(nodes), far, near)
        block = self._matrices(np.exp(nodes), far, far)
        schur = coupling.transpose(0, 2, 1) @ np.linalg.solve(block, coupling)
        weights = BarycentricInterpolator(nodes, np.eye(count))(np.log(omega))
        return _charge(self._matrices(omega, near, near) - np.tensordot(weights, schur, axes=1))


def _charge(matrix: np.ndarray) -> np.ndarray:
    """F = −(A_vv − A_vr A_rr^-1 A_rv) for matrices (k, r, r) with the voltage first."""
    solution = np.linalg.solve(matrix[:, 1:, 1:], matrix[:, 1:, :1])
    return -(matrix[:, 0, 0] - np.einsum("kr,kr->k", matrix[:, 0, 1:], solution[:, :, 0]))
