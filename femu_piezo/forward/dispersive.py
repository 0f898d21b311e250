"""Z(f) of a reduced model whose coefficients c_q(ω) vary with frequency: dispersive constants, masses, springs.

No closed form serves all frequencies then. In the modal coordinates of the mean coefficients the modes near the
band are kept; the other modes and the inner potentials are eliminated exactly at a few Chebyshev points of log ω.
Their Schur complement has no resonance in the band, so polynomials interpolate it in between; exact values at
frequencies between the nodes decide how many nodes it takes. With x(ω) the state driven by one volt,
∂Y/∂c_q = −jω xᵗA_q x.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BarycentricInterpolator

from femu_piezo.forward.reduction import ReducedModel
from femu_piezo.threads import blas_limit

#: ω (k,) → c (k, n_terms)
Coefficients = Callable[[np.ndarray], np.ndarray]

#: Modes up to these multiples of the highest ω² are kept, and numbers of interpolation nodes, in the order tried.
_KEEP, _NODES = (2.0, 8.0, 32.0), (8, 16, 32)


@dataclass(frozen=True)
class DispersiveResponse:
    """Response at frequency-dependent coefficients.

    Attributes
    ----------
    omega : (k,) rad/s
    charge : (k,) charge per volt of the part
    states : (k, r) reduced state driven by one volt, unknowns of the reduced model
    """

    omega: np.ndarray
    charge: np.ndarray
    states: np.ndarray
    reduced: ReducedModel

    @property
    def admittance(self) -> np.ndarray:
        """Y of the specimen (k,), siemens."""
        return 1j * self.omega * self.reduced.admittance_factor * self.charge

    @property
    def impedance(self) -> np.ndarray:
        """Z of the specimen (k,), ohm."""
        return 1 / self.admittance

    def admittance_jacobian(self) -> np.ndarray:
        """∂Y(ω)/∂c_q(ω) (k, n_terms); a parameter θ gets Σ_q ∂Y/∂c_q ∂c_q(ω)/∂θ."""
        count, size, _ = self.reduced.matrices.shape
        columns = self.reduced.matrices.transpose(1, 0, 2).reshape(size, -1)
        with blas_limit():
            products = (self.states.real @ columns) + 1j * (self.states.imag @ columns)
        energy = np.einsum("kqr,kr->kq", products.reshape(-1, count, size), self.states)
        return -1j * (self.omega * self.reduced.admittance_factor)[:, None] * energy


def dispersive_response(
    reduced: ReducedModel, coefficients: Coefficients, omega: np.ndarray, *, accuracy: float = 1e-7
) -> DispersiveResponse:
    """Response at coefficients c_q(ω) of the affine terms.

    Parameters
    ----------
    coefficients : function of ω (n,) → (n, n_terms) complex, smooth in log ω
    omega : (k,) rad/s, positive
    accuracy : relative error allowed beside the one of the reduced model; where interpolation does not reach it
        (rough coefficients, a heavy mass), every frequency is solved with all unknowns. 0 asks for that at once.
    """
    omega = np.asarray(omega, dtype=float)
    with blas_limit():
        for keep in _KEEP if accuracy > 0 else ():
            system = _System.of(reduced, coefficients, omega, keep)
            for count in _NODES:
                charge, states = system.interpolated(omega, count)
                probes = _probes(charge)
                exact, _ = system.exact(omega[probes])
                if np.max(np.abs(charge[probes] / exact - 1)) < accuracy:
                    return DispersiveResponse(omega, charge, states @ system.basis.T, reduced)
        system = _System.of(reduced, coefficients, omega, _KEEP[0])
        parts = [system.exact(part) for part in np.array_split(omega, max(1, omega.size // 64))]
        charge, states = (np.concatenate(part) for part in zip(*parts, strict=True))
        return DispersiveResponse(omega, charge, states @ system.basis.T, reduced)


def _probes(charge: np.ndarray) -> np.ndarray:
    """Indices to check: eight spread over the band, the largest and the smallest charge (a pole and a zero)."""
    spread = np.linspace(0, charge.size - 1, 8).astype(int)
    return np.unique([*spread, np.argmax(np.abs(charge)), np.argmin(np.abs(charge))])


@dataclass(frozen=True)
class _System:
    """Affine terms in modal coordinates of the mean coefficients, kept unknowns first.

    terms (n_terms, r, r); coefficients c(ω); inertia (r,) diagonal of the mass; basis (r, r) the coordinates in
    unknowns of the reduced model; kept: the voltage and the modes near the band
    """

    terms: np.ndarray
    coefficients: Coefficients
    inertia: np.ndarray
    basis: np.ndarray
    kept: int

    @classmethod
    def of(cls, reduced: ReducedModel, coefficients: Coefficients, omega: np.ndarray, keep: float) -> _System:
        modal = reduced.modal_at(coefficients(omega).mean(axis=0))
        near = modal.eigenvalues.real < keep * omega.max() ** 2
        modes, u, size = modal.states[:, 1:], reduced.displacements, reduced.size
        inner = np.eye(size)[:, u : size - 1]
        basis = np.column_stack([modal.states[:, 0], modes[:, near], modes[:, ~near], inner])
        inertia = np.concatenate([[0.0], np.ones(u), np.zeros(size - 1 - u)])
        return cls(basis.T @ reduced.matrices @ basis, coefficients, inertia, basis, 1 + int(near.sum()))

    def _matrices(self, omega: np.ndarray, rows: slice, columns: slice) -> np.ndarray:
        """A(ω) − ω²M (k, …) of a block of unknowns."""
        matrix = np.tensordot(self.coefficients(omega), self.terms[:, rows, columns], axes=1)
        if rows == columns:
            index = np.arange(matrix.shape[1])
            matrix[:, index, index] -= (omega**2)[:, None] * self.inertia[rows]
        return matrix

    def exact(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Charge per volt (k,) and driven state (k, r) with all unknowns."""
        return _driven(self._matrices(omega, slice(None), slice(None)))

    def interpolated(self, omega: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """The same with the elimination of the other unknowns interpolated from `count` Chebyshev points of log ω."""
        near, far = slice(0, self.kept), slice(self.kept, None)
        low, high = np.log([omega.min(), omega.max()])
        nodes = (low + high) / 2 + (high - low) / 2 * np.cos(np.pi * (np.arange(count) + 0.5) / count)
        coupling = self._matrices(np.exp(nodes), far, near)
        follow = -np.linalg.solve(self._matrices(np.exp(nodes), far, far), coupling)
        schur = coupling.transpose(0, 2, 1) @ follow
        weights = BarycentricInterpolator(nodes, np.eye(count))(np.log(omega))
        charge, states = _driven(self._matrices(omega, near, near) + np.tensordot(weights, schur, axes=1))
        others = sum(weights[:, [node]] * (states @ follow[node].T) for node in range(count))
        return charge, np.hstack([states, others])


def _driven(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """F = −(A_vv + A_vr x_r) (k,) and x = (1, x_r), x_r = −A_rr^-1 A_rv, for matrices (k, r, r), voltage first."""
    rest = -np.linalg.solve(matrix[:, 1:, 1:], matrix[:, 1:, :1])[:, :, 0]
    charge = -(matrix[:, 0, 0] + np.einsum("kr,kr->k", matrix[:, 0, 1:], rest))
    return charge, np.column_stack([np.ones(len(rest)), rest])
