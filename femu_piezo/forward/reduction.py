"""Reduced model: every affine term projected once on a small real basis; then Z(f; θ) costs milliseconds.

The basis holds the open-circuit modes of the lossless reference plate up to beyond the band, the static response
to the electrode voltage, and corrections K^-1 r for the residuals r that the reduced model leaves at training
constants around the reference. Displacement and potential parts are kept apart, so that the balance between
them may change with the constants. The impedance is the energy of its own load: its Galerkin error is the
quadratic form rᵗA^-1 r, estimated with the factor that is already there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse.linalg as spla

from femu_piezo.errors import ConvergenceError
from femu_piezo.forward.linear_solver import Factorization, factorize
from femu_piezo.forward.modal import ModalModel, diagonalise
from femu_piezo.forward.model import POTENTIAL_SCALE, ElectroelasticModel
from femu_piezo.forward.projection import QuadratureGradients, apply_stiffness, project_terms
from femu_piezo.material.constants import ElasticForm, PiezoConstants


@dataclass(frozen=True)
class ReducedModel:
    """Projected affine model: r unknowns (displacements, inner potentials, hot potential in volts).

    Attributes
    ----------
    terms : names of the affine terms
    matrices : (n_terms, r, r) real symmetric VᵗA_qV; the mass is the identity on the displacements
    displacements : number of displacement unknowns
    admittance_factor : Y of the specimen / Y of the part
    basis : (m, r) real, free unknowns of the full model, to show mode shapes; may be None when loaded
    estimated_error : largest estimated relative error of Z over the training set
    band_Hz : highest frequency the basis was built for
    """

    terms: tuple[str, ...]
    matrices: np.ndarray
    displacements: int
    admittance_factor: float
    basis: np.ndarray | None = field(repr=False)
    estimated_error: float
    band_Hz: float

    @property
    def size(self) -> int:
        return self.matrices.shape[1]

    def modal(self, constants: ElasticForm, extra: Mapping[str, complex] | None = None) -> ModalModel:
        """Closed forms at given e-form constants (complex) and coefficients of the extra terms (0 where absent)."""
        extra = extra or {}
        values = np.concatenate([constants.vector(), [extra.get(name, 0.0) for name in self.terms[10:]]])
        stiffness = np.tensordot(values, self.matrices, axes=1)
        return diagonalise(stiffness, self.matrices, self.displacements, self.admittance_factor)

    def impedance(self, constants: ElasticForm, frequency_Hz: np.ndarray) -> np.ndarray:
        """Z of the specimen, (k,) complex ohm."""
        return self.modal(constants).impedance(2 * np.pi * np.asarray(frequency_Hz))


class _Basis:
    """Growing real basis: M-orthonormal displacements, orthonormal inner potentials, one lifting of the voltage."""

    def __init__(self, model: ElectroelasticModel, static: np.ndarray) -> None:
        self._mass = model.mass
        self._potential = np.asarray(self._mass.diagonal() == 0.0)
        self._potential[-1] = False
        self._lifting = np.where(self._potential, static / (static[-1] * POTENTIAL_SCALE), 0.0)
        self._lifting[-1] = 1 / POTENTIAL_SCALE
        self.u = np.zeros((model.size, 0))
        self.phi = np.zeros((model.size, 0))

    def add(self, vectors: np.ndarray, keep: float) -> int:
        """Add the parts of real vectors (m, k) that are new by more than `keep` of the largest; return how many."""
        displacement = np.where(self._potential[:, None], 0.0, vectors)
        displacement[-1] = 0.0
        inner = np.where(self._potential[:, None], vectors, 0.0)
        inner = inner - np.outer(self._lifting, vectors[-1]) * POTENTIAL_SCALE
        inner[-1] = 0.0
        new_u = _new_directions(self.u, displacement, keep, self._mass)
        new_phi = _new_directions(self.phi, inner, keep, None)
        self.u = np.hstack([self.u, new_u])
        self.phi = np.hstack([self.phi, new_phi])
        return new_u.shape[1] + new_phi.shape[1]

    @property
    def matrix(self) -> np.ndarray:
        """(m, r) displacements, inner potentials, lifting."""
        return np.hstack([self.u, self.phi, self._lifting[:, None]])


def _new_directions(old: np.ndarray, vectors: np.ndarray, keep: float, mass) -> np.ndarray:
    """Orthonormal directions of `vectors` outside span(old), by two projections and a Gram eigenproblem."""

    def weighted(x: np.ndarray) -> np.ndarray:
        return x if mass is None else mass @ x

    scale = np.sqrt(np.max(np.sum(vectors * weighted(vectors), axis=0), initial=0.0))
    if scale == 0.0:
        return vectors[:, :0]
    rest = vectors
    for _ in range(2):
        rest = rest - old @ (weighted(old).T @ rest)
    values, rotation = np.linalg.eigh(rest.T @ weighted(rest))
    chosen = values > (keep * scale) ** 2
    fresh = (rest @ rotation[:, chosen]) / np.sqrt(values[chosen])
    for _ in range(2):  # verify the own result: re-orthogonalise against old and among itself
        fresh = fresh - old @ (weighted(old).T @ fresh)
        upper = np.linalg.cholesky(fresh.T @ weighted(fresh)).T if fresh.shape[1] else np.zeros((0, 0))
        fresh = np.linalg.solve(upper.T, fresh.T).T if fresh.shape[1] else fresh
    return fresh


def reduce_model(
    model: ElectroelasticModel,
    training: Sequence[PiezoConstants],
    band_Hz: float,
    *,
    accuracy: float = 1e-5,
    max_rounds: int = 8,
) -> ReducedModel:
    """Build a reduced model good to `accuracy` in Z over 0…band_Hz at the training constants and between them.

    Parameters
    ----------
    training : sets of constants (their real parts); the basis is built around the first
    accuracy : bound on the estimated relative error of Z at every training point, with 1 % loss throughout

    Raises
    ------
    ConvergenceError : the estimate stays above `accuracy` after `max_rounds` enrichments
    """
    stiffness = model.stiffness(training[0].lossless().to_e_form())
    modes, factor, static = _reference_modes(model, stiffness, band_Hz)
    basis = _Basis(model, static)
    basis.add(np.column_stack([modes, static]), 1e-10)
    gradients = QuadratureGradients(model.basis)
    samples = [PiezoConstants.from_vector(constants.vector().real * (1 - 0.01j)) for constants in training]
    for _ in range(max_rounds):
        matrix = basis.matrix
        reduced = ReducedModel(
            terms=model.terms,
            matrices=project_terms(model, gradients, matrix),
            displacements=basis.u.shape[1],
            admittance_factor=model.domain.admittance_factor,
            basis=matrix,
            estimated_error=np.inf,
            band_Hz=band_Hz,
        )
        corrections, error = _corrections(model, gradients, reduced, samples, factor)
        if error < accuracy:
            return ReducedModel(**{**reduced.__dict__, "estimated_error": error})
        if basis.add(corrections, 0.02) == 0:
            break
    raise ConvergenceError(
        f"the reduced model reached a relative error of {error:.1e}, asked were {accuracy:.1e}: "
        "narrow the band or the range of the constants, or ask for less accuracy"
    )


def _reference_modes(model: ElectroelasticModel, stiffness, band_Hz: float):
    """All lossless open-circuit modes up to 1.2 × band, the factor of K − σM at a low shift, the static response."""
    top = (2 * np.pi * 1.2 * band_Hz) ** 2
    shift = -0.02 * top
    factor = factorize(stiffness - shift * model.mass)
    load = np.zeros(model.size)
    load[-1] = -1.0
    static = factor.solve(load)
    count = _count_below(model, stiffness, top) or 20
    count = min(count + 2, model.size // 3)
    inverse = spla.LinearOperator(stiffness.shape, matvec=factor.solve, dtype=float)
    start = factor.solve(model.mass @ np.random.default_rng(1).standard_normal(model.size))
    _, vectors = spla.eigsh(stiffness, count, M=model.mass, sigma=shift, OPinv=inverse, v0=start, tol=1e-8)
    return vectors, factor, static


def _count_below(model: ElectroelasticModel, stiffness, value: float) -> int | None:
    """Number of open-circuit eigenvalues below `value` by inertia, None where the solver does not tell."""
    inertia = factorize(stiffness - value * model.mass).inertia
    if inertia is None:
        return None
    potentials = int(np.sum(model.mass.diagonal() == 0.0))
    return inertia[1] - potentials


def _corrections(
    model: ElectroelasticModel,
    gradients: QuadratureGradients,
    reduced: ReducedModel,
    samples: list[PiezoConstants],
    factor: Factorization,
) -> tuple[np.ndarray, float]:
    """K^-1 r over the training set as real vectors, and the largest estimated relative error of Z."""
    columns, worst = [], 0.0
    load = np.zeros((model.size, 1))
    load[-1] = -1.0
    for constants in samples:
        e_form = constants.to_e_form()
        omega = 2 * np.pi * _training_frequencies(reduced, e_form)
        states = reduced.basis @ _reduced_states(reduced, e_form, omega)
        tensor = np.tensordot(e_form.vector(), model.unit_tensors, axes=1)
        applied = apply_stiffness(model, gradients, tensor, states)
        residual = load - applied + (model.mass @ states) * omega**2
        correction = factor.solve(residual)
        error = np.abs(np.einsum("ik,ik->k", residual, correction) / states[-1])
        worst = max(worst, float(error.max()))
        weight = np.sqrt(error) / np.sqrt(np.abs(np.einsum("ik,ik->k", residual, correction)))
        columns += [(correction * weight).real, (correction * weight).imag]
    return np.hstack(columns), worst


def _training_frequencies(reduced: ReducedModel, e_form: ElasticForm) -> np.ndarray:
    """The top of the band, and the poles and zeros of the reduced model within it, thinned to a dozen."""
    modal = reduced.modal(e_form)
    values = np.concatenate([modal.eigenvalues, modal.zeros[0]])
    frequency = np.sqrt(np.abs(values.real)) / (2 * np.pi)
    inside = np.sort(frequency[(frequency < reduced.band_Hz) & (values.real > 0)])
    chosen = inside[np.linspace(0, inside.size - 1, min(10, inside.size)).astype(int)] if inside.size else inside
    return np.concatenate([chosen, [0.6 * reduced.band_Hz, reduced.band_Hz]])


def _reduced_states(reduced: ReducedModel, e_form: ElasticForm, omega: np.ndarray) -> np.ndarray:
    """(r, k) reduced states for unit scaled charge at each frequency."""
    stiffness = np.tensordot(e_form.vector(), reduced.matrices, axes=1)
    mass = np.zeros(reduced.size)
    mass[: reduced.displacements] = 1.0
    load = np.zeros(reduced.size)
    load[-1] = -1.0 / POTENTIAL_SCALE
    return np.stack([np.linalg.solve(stiffness - np.diag(w**2 * mass), load) for w in omega], axis=1)
