"""Complex short- and open-circuit eigenpairs of the sparse saddle-point pencil, and their exact sensitivities.

    (K − λ M) x = 0,   x = (u, φ),   λ = ω²(1 + jη)                          (eqs 14, 16-20)

K is complex symmetric, so the left eigenvector is the plain transpose of the right one, and for uᵗMu = 1

    ∂λ/∂c_q = xᵗ A_q x                                                        (eqs 56-60, uncondensed)
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.sparse.linalg as spla

from femu_piezo.errors import ConvergenceError
from femu_piezo.forward.linear_solver import factorize
from femu_piezo.forward.model import POTENTIAL_SCALE, ElectroelasticModel
from femu_piezo.material.constants import ElasticForm
from femu_piezo.resonances import Kind

Circuit = Literal["short", "open"]


@dataclass(frozen=True)
class Eigenpairs:
    """Modes of one electrical condition, sorted by frequency.

    Attributes
    ----------
    circuit : "short" (poles of Y) or "open" (zeros of Y)
    eigenvalues : (k,) complex λ, rad²/s²
    vectors : (m, k) complex, uᵗMu = 1 (plain transpose); short-circuit vectors carry a zero hot potential
    amplitudes : (k,) complex; short: charge on the hot electrode of the part, bᵗx (C per √kg·m); open: its
        potential x_h (V per √kg·m). The square is the residue: Y/(jω) = C∞ + Σ a²/(λ − ω²) for the short ones,
        −jωZ = S∞ + Σ a²/(λ − ω²) for the open ones, both for the computed part.
    """

    circuit: Circuit
    eigenvalues: np.ndarray
    vectors: np.ndarray
    amplitudes: np.ndarray

    @property
    def kind(self) -> Kind:
        """ "pole" for short circuit, "zero" for open circuit."""
        return "pole" if self.circuit == "short" else "zero"

    @property
    def participation(self) -> np.ndarray:
        """(k,) share of each mode in the sum |a²/λ| over the modes computed: how strongly the terminals drive it.

        Rigid-body modes of a whole plate (λ = 0 up to rounding) have no share.
        """
        elastic = self.eigenvalues.real > 1e-6 * np.abs(self.eigenvalues).max()
        weight = np.abs(self.amplitudes**2 / np.where(elastic, self.eigenvalues, 1.0)) * elastic
        return weight / weight.sum()

    def dominant_index(self, near_Hz: float | None = None) -> int:
        """Index of the mode that the terminals drive most, within a factor two of `near_Hz` where that is given.

        Raises ConvergenceError where no computed mode lies in that range.
        """
        weight = self.participation.copy()
        if near_Hz is not None:
            frequency = np.sqrt(np.abs(self.eigenvalues.real)) / (2 * np.pi)
            weight[(frequency < near_Hz / 2) | (frequency > near_Hz * 2)] = 0.0
        if not weight.max() > 0:
            raise ConvergenceError(f"no {self.circuit}-circuit mode was computed within a factor two of {near_Hz} Hz")
        return int(np.argmax(weight))

    def sensitivity(self, model: ElectroelasticModel, mode: int, names: Iterable[str]) -> np.ndarray:
        """∂λ/∂c_q of one mode for the named affine terms, complex (eqs 56-60)."""
        vector = self.vectors[:, mode]
        return np.array([vector @ (model.term(name) @ vector) for name in names])


def solve_eigen(
    model: ElectroelasticModel,
    constants: ElasticForm,
    circuit: Circuit,
    count: int = 8,
    near_Hz: float = 0.0,
    tolerance: float = 1e-12,
    extra: Mapping[str, complex] | None = None,
) -> Eigenpairs:
    """The `count` eigenpairs nearest to a frequency, by shift-invert Arnoldi on the sparse pencil.

    Parameters
    ----------
    constants : complex or real e-form constants
    near_Hz : frequency of the shift; with 0 the lowest modes. On the full plate six rigid-body modes come first.
    extra : coefficients of the model's extra terms

    Raises
    ------
    ConvergenceError : Arnoldi did not converge, or a residual is above 1e-8 of the diagonal of K times ‖x‖
    """
    stiffness = model.stiffness(constants, extra)
    size = model.size - (circuit == "short")
    k, m = stiffness[:size, :size], model.mass[:size, :size]
    shift = _shift(model, k, m, near_Hz)
    factor = factorize(k - shift * m)
    inverse = spla.LinearOperator(k.shape, matvec=factor.solve, dtype=k.dtype)
    rng = np.random.default_rng(1)
    start = factor.solve(m @ rng.standard_normal(size))
    solver = spla.eigs if np.iscomplexobj(k.data) else spla.eigsh
    try:
        values, vectors = solver(
            k, count, M=m, sigma=shift, OPinv=inverse, v0=start, tol=tolerance, ncv=max(2 * count + 10, 24)
        )
    except spla.ArpackNoConvergence as error:
        raise ConvergenceError(f"{circuit}-circuit eigenpairs: {error}; compute more modes, or other ones") from error
    order = np.argsort(values.real)
    values, vectors = values[order].astype(complex), vectors[:, order].astype(complex)
    vectors /= np.sqrt(np.einsum("ik,ik->k", vectors, m @ vectors))
    _check_residuals(k, m, values, vectors, circuit)
    return _with_amplitudes(circuit, stiffness, values, vectors)


def _shift(model: ElectroelasticModel, k, m, near_Hz: float) -> float:
    """Shift in λ, rad²/s²; for zero frequency below zero, because the operator of the full plate is singular there."""
    if near_Hz > 0:
        return (2 * np.pi * near_Hz) ** 2
    scale = np.abs(k.diagonal()[: m.shape[0]]).max() / m.diagonal().max()
    return -1e-6 * float(scale)


def _check_residuals(k, m, values, vectors, circuit) -> None:
    inertia = m @ vectors
    residual = np.linalg.norm(k @ vectors - inertia * values, axis=0)
    reference = np.linalg.norm(k.diagonal()) / np.sqrt(k.shape[0]) * np.linalg.norm(vectors, axis=0)
    worst = float(np.max(residual / reference))
    if not worst < 1e-8:
        raise ConvergenceError(f"{circuit}-circuit eigenpairs leave a relative residual of {worst:.1e}")


def _with_amplitudes(circuit: Circuit, stiffness, values, vectors) -> Eigenpairs:
    if circuit == "open":
        return Eigenpairs(circuit, values, vectors, vectors[-1] * POTENTIAL_SCALE)
    coupling = np.asarray(stiffness[:-1, -1].todense()).ravel() / POTENTIAL_SCALE
    vectors = np.vstack([vectors, np.zeros(vectors.shape[1])])
    return Eigenpairs(circuit, values, vectors, coupling @ vectors[:-1])
