"""Reduced model: every affine term projected once on a small real basis; then Z(f; θ) costs milliseconds.

The basis starts from the Krylov vectors of the driven reference plate. In each round, the reduced model is evaluated at
training constants around the reference. The residuals r of its states there give corrections K_σ^-1 r, with the factor
of K_σ = K − σM at the reference, which exists already; the change of Z that the corrections bring is the a-posteriori
estimate of the error. At training constants where this error falls slowly, the operator is factorised too and its
driven Krylov vectors are added. At the end, a principal component analysis of all training states reduces the basis to
the fewest vectors that keep the accuracy.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from femu_piezo.errors import ConvergenceError
from femu_piezo.forward.krylov import LOSS, driven_krylov
from femu_piezo.forward.linear_solver import Factorization
from femu_piezo.forward.modal import ModalModel, diagonalise
from femu_piezo.forward.model import POTENTIAL_SCALE, ElectroelasticModel
from femu_piezo.forward.reduced_basis import ReducedBasis
from femu_piezo.forward.training import TrainingSet, leading_residuals, worst_change
from femu_piezo.material.constants import E_FORM, ElasticForm, PiezoConstants
from femu_piezo.threads import blas_limit, in_parallel, useful_threads

#: Constants, or constants with real coefficients of extra terms, at which the basis is trained.
TrainingPoint = PiezoConstants | tuple[PiezoConstants, Mapping[str, float]]

#: Share of the largest correction below which a direction is not added to the basis.
_KEEP = 1e-3

#: Shifts σ of the factorised K − σM, as shares of the highest ω² of the band. The next shift is tried where the
#: electrode's potential nearly vanishes: the potential inside exceeds `_LARGEST_LIFTING` times that of the electrode.
_SHIFTS, _LARGEST_LIFTING = (0.4, 0.33, 0.47), 30.0

#: A training point whose error is below this share of the accuracy is not evaluated again: a larger basis only lowers
#: its error.
_SETTLED = 0.03

#: A training point whose last change exceeds `_SLOW` times the change before gets its own driven vectors, at most
#: `_POINTS_PER_ROUND` points in one round. `_SLOWEST`: upper limit of the ratio of successive changes.
_SLOW, _POINTS_PER_ROUND, _SLOWEST = 0.2, 2, 0.9

#: Residuals below `_LEAST_RESIDUAL` of the largest are not corrected, nor below `_UNCORRECTED_SHARE` of the share that
#: would reach the accuracy: the error of Z grows with the square of the residuals that are not corrected.
_LEAST_RESIDUAL, _UNCORRECTED_SHARE = 1e-3, 0.1

#: Number of residuals that are corrected at a time: each takes several vectors of the full model.
_COLUMNS = 64

#: Estimated error of Z above which a basis that misses its target is of no use.
_USELESS = 1e-2


@dataclass(frozen=True)
class ReducedModel:
    """Projected affine model: r unknowns (displacements, inner potentials, hot potential in volts).

    Attributes
    ----------
    terms : names of the affine terms
    matrices : (n_terms, r, r) real symmetric VᵗA_qV; the mass is the identity on the displacements
    displacements : number of displacement unknowns
    admittance_factor : Y of the specimen / Y of the part
    basis : (m, r) real, free unknowns of the full model, to show mode shapes
    estimated_error : estimated relative error of Z at the training points, with 0.5 % loss
    band_Hz : highest frequency the basis was built for
    training : (n_points, n_terms) real coefficients of all affine terms at which the basis was trained
    rounds, factors : number of enrichments, and of training points that were factorised, the reference included
    """

    terms: tuple[str, ...]
    matrices: np.ndarray = field(repr=False)
    displacements: int
    admittance_factor: float
    basis: np.ndarray = field(repr=False)
    estimated_error: float
    band_Hz: float
    training: np.ndarray = field(repr=False)
    rounds: int = 0
    factors: int = 0

    @property
    def size(self) -> int:
        """Number of reduced unknowns r."""
        return self.matrices.shape[1]

    def coefficients(self, constants: ElasticForm, extra: Mapping[str, complex] | None = None) -> np.ndarray:
        """(n_terms,) coefficients of the affine terms, 0 for omitted extra terms; real where all are real."""
        extra = extra or {}
        unknown = set(extra) - set(self.terms)
        if unknown:
            raise KeyError(f"the reduced model has no terms {sorted(unknown)}; it has {self.terms[len(E_FORM) :]}")
        values = np.concatenate([constants.vector(), [extra.get(name, 0.0) for name in self.terms[len(E_FORM) :]]])
        return values if np.any(values.imag) else values.real

    def modal(self, constants: ElasticForm, extra: Mapping[str, complex] | None = None) -> ModalModel:
        """Closed forms at given e-form constants (complex) and coefficients of the extra terms (0 where omitted)."""
        return self.modal_at(self.coefficients(constants, extra))

    def modal_at(self, coefficients: np.ndarray) -> ModalModel:
        """Closed forms at given coefficients (n_terms,) of all affine terms."""
        with blas_limit():
            stiffness = np.tensordot(coefficients, self.matrices, axes=1)
            return diagonalise(stiffness, self.matrices, self.displacements, self.admittance_factor)

    def impedance(
        self, constants: ElasticForm, frequency_Hz: np.ndarray, extra: Mapping[str, complex] | None = None
    ) -> np.ndarray:
        """Z of the specimen, (k,) complex ohm."""
        return self.modal(constants, extra).impedance(2 * np.pi * np.asarray(frequency_Hz))


def reduce_model(
    model: ElectroelasticModel,
    training: Sequence[TrainingPoint],
    band_Hz: float,
    *,
    accuracy: float = 1e-5,
    max_rounds: int = 10,
) -> ReducedModel:
    """Build a reduced model good to `accuracy` in Z over 0…band_Hz at the training points and between them.

    Parameters
    ----------
    training : constants, each alone or with real coefficients of the model's extra terms. The basis is built
        around the first. Of the points with the same extra coefficients, it follows the loss tangents of the first
        lossy one; of all others the real parts count.
    accuracy : target of the estimated relative error of Z at every training point, with 0.5 % loss throughout. The
        error reached is the `estimated_error` of the result.

    Raises
    ------
    ConvergenceError : the estimate stays above 1 % (and `accuracy`) after `max_rounds` enrichments, or the
        elastic or dielectric energy of the constants, in which the basis is orthonormal, is not positive
    """
    points = _distinct([_coefficients(model, point) for point in _with_neighbours(training)])
    every = _distinct([*points, *(_coefficients(model, point) for point in _reflections(training))])
    checks = every[len(points) :]
    with blas_limit(useful_threads(model.size)):
        try:
            enriched = _enriched(model, points, checks, band_Hz, accuracy, max_rounds)
            if not enriched.error < max(_USELESS, accuracy):
                raise ConvergenceError(
                    f"the relative error of the reduced model is {enriched.error:.1e}, more than {accuracy:.1e}: "
                    "narrow the band or the range of the constants"
                )
            return _finished(model, enriched, band_Hz, accuracy)
        except np.linalg.LinAlgError:
            raise ConvergenceError("no reduced model follows constants whose energy is not positive") from None


def driven_modal(
    model: ElectroelasticModel, constants: PiezoConstants, band_Hz: float, accuracy: float = 1e-9
) -> ModalModel:
    """Closed forms at one set of constants, taken lossless, from driven Krylov vectors.

    Parameters
    ----------
    band_Hz : highest frequency;  accuracy : relative, of Z up to that frequency
    """
    with blas_limit(useful_threads(model.size)):
        point, top = _coefficients(model, constants), (2 * np.pi * band_Hz) ** 2
        basis = _DrivenVectors(model, point, top, accuracy).basis
        return TrainingSet.of(basis.matrices(), basis.u.shape[1], point, top).modal


@dataclass(frozen=True)
class _Enriched:
    """An enriched basis, the reduced models at all training points and checks, the estimated error and the effort."""

    basis: ReducedBasis
    sets: list[TrainingSet]
    error: float
    rounds: int
    factors: int


def _enriched(
    model: ElectroelasticModel,
    points: list[np.ndarray],
    checks: list[np.ndarray],
    band_Hz: float,
    accuracy: float,
    max_rounds: int,
) -> _Enriched:
    """Basis enriched until the estimate at points and checks is at most half of `accuracy`, or a round adds nothing.

    Residuals are corrected with the factor at the reference. Where these corrections reduce the error slowly, because
    the constants are far from the reference or two modes lie close together, the point's own driven vectors are added.

    Parameters
    ----------
    points, checks : (n_terms,) coefficients, where the error is estimated; the first round corrects residuals of
        `points` alone
    """
    top, everywhere = (2 * np.pi * band_Hz) ** 2, [*points, *checks]
    driven = _DrivenVectors(model, points[0], top, 0.1 * accuracy)
    basis = driven.basis
    sets = _train(basis, everywhere, top)
    change, error, factors, rounds = np.full(len(sets), np.inf), np.full(len(sets), np.inf), {0}, 0
    states, uncorrected = max(item.states.shape[1] for item in sets), 0.0
    active, slow, watched = np.arange(len(points)), [], np.arange(len(sets))
    while error.max() > 0.5 * accuracy and rounds < max_rounds:
        share = max(_LEAST_RESIDUAL, _UNCORRECTED_SHARE * float(np.sqrt(0.5 * accuracy / error.max())))
        added = driven.correct(leading_residuals(basis, [sets[i] for i in active], driven.scale, share))
        added += sum(driven.add(everywhere[index]) for index in slow)
        factors.update(slow)
        rounds, watched = rounds + 1, np.flatnonzero(error > _SETTLED * accuracy)
        fresh = _train(basis, [everywhere[index] for index in watched], top)
        last = np.array([worst_change(sets[i], new) for i, new in zip(watched, fresh, strict=True)])
        ratio = _ratios(change[watched], last, uncorrected)
        change[watched], error[watched] = last, _predicted(last, ratio)
        uncorrected = states * share**2 * last.max()  # change of Z that residuals which were not corrected may cause
        for index, new in zip(watched, fresh, strict=True):
            sets[index] = new
        if added == 0:
            break
        active = np.flatnonzero(error > 0.1 * accuracy)
        stagnant = watched[(error[watched] > 0.5 * accuracy) & (ratio > _SLOW)]
        slow = [index for index in stagnant[np.argsort(-error[stagnant])] if index not in factors][:_POINTS_PER_ROUND]
    if watched.size < len(sets):
        sets = _train(basis, everywhere, top)
    return _Enriched(basis, sets, float(error.max()), rounds, len(factors))


def _train(basis: ReducedBasis, points: list[np.ndarray], top: float) -> list[TrainingSet]:
    matrices = basis.matrices()
    return list(in_parallel(lambda point: TrainingSet.of(matrices, basis.u.shape[1], point, top), points))


def _ratios(before: np.ndarray, change: np.ndarray, uncorrected: float) -> np.ndarray:
    """(n,) ratio q of the last change of each training point to the change before; 0 where there was none before.

    Where the change before does not exceed `uncorrected`, the change that the corrections left out may cause, the ratio
    says nothing about the point: the largest ratio of the other points is used, `_SLOWEST` where there is none.
    """
    known = np.isfinite(before) & (before > uncorrected)
    ratio = np.divide(change, before, out=np.zeros_like(change), where=known)
    ratio[np.isfinite(before) & ~known] = ratio.max() if np.any(known) else _SLOWEST
    return np.minimum(_SLOWEST, ratio)


def _predicted(change: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """(n,) remaining error at each training point, from the last change and its ratio q to the change before.

    Changes usually fall faster than by a constant ratio; √q times the last change was above the true error in every
    case measured. Where they fall slowly, q > 0.38, the sum q/(1 − q) of a geometric series of changes is larger and is
    used. A first change (q = 0) counts as the error itself.
    """
    return np.where(ratio > 0, change * np.maximum(np.sqrt(ratio), ratio / (1 - ratio)), change)


def _with_neighbours(training: Sequence[TrainingPoint]) -> list[TrainingPoint]:
    """The training points θ and, for the losses, further real points Re θ + 2 Im θ.

    States are analytic in the constants, so a basis that follows them along a real direction follows them along the
    same imaginary direction. One further point is added for each set of extra coefficients, from its first lossy point.
    A single lossless point gets two neighbours: one with elastic constants, one with elastic and piezoelectric
    constants (of the d-form) that are lower by 3 %.
    """
    points = [point if isinstance(point, tuple) else (point, {}) for point in training]
    first, result = points[0][0].vector(), list(points)
    if len(points) == 1 and not np.any(first.imag):
        shares = [np.where(np.arange(10) < count, 0.97, 1.0) for count in (5, 8)]
        return result + [(PiezoConstants.from_vector(share * first.real), points[0][1]) for share in shares]
    seen = []
    for constants, extra in points:
        values = constants.vector()
        if np.any(values.imag) and extra not in seen:
            seen.append(extra)
            result.append((PiezoConstants.from_vector(values.real + 2 * values.imag), extra))
    return result


def _reflections(training: Sequence[TrainingPoint]) -> list[TrainingPoint]:
    """Reflections 2 θ_0 − θ of the training points θ about the first, where stable: further checks of the error."""
    points = [point if isinstance(point, tuple) else (point, {}) for point in training]
    first = points[0][0].vector().real
    mirrored = [(PiezoConstants.from_vector(2 * first - item.vector().real), extra) for item, extra in points[1:]]
    return [(constants, extra) for constants, extra in mirrored if not constants.physical_faults()]


def _distinct(points: list[np.ndarray]) -> list[np.ndarray]:
    """The points in their order without repetitions."""
    result = []
    for point in points:
        if not any(np.allclose(point, other, rtol=1e-9, atol=0.0) for other in result):
            result.append(point)
    return result


def _coefficients(model: ElectroelasticModel, point: TrainingPoint) -> np.ndarray:
    """(n_terms,) real coefficients of the affine terms at a training point, without its losses."""
    constants, extra = point if isinstance(point, tuple) else (point, {})
    e_form = constants.lossless().to_e_form().vector().real
    return np.concatenate([e_form, [float(extra.get(name, 0.0)) for name in model.terms[len(E_FORM) :]]])


class _DrivenVectors:
    """A reduced basis of driven Krylov vectors at the reference and at further constants.

    Attributes
    ----------
    basis : the basis so far
    factor : of K − σM at the reference, σ inside the band
    scale : (m,) |diagonal of K| at the reference, which scales residuals
    """

    def __init__(self, model: ElectroelasticModel, reference: np.ndarray, top: float, accuracy: float) -> None:
        self._model, self._top, self._accuracy = model, top, accuracy
        self.scale = np.abs(model.diagonal(reference))
        for share in _SHIFTS:
            self.factor, static = self._static(reference, share)
            self.basis = ReducedBasis(model, reference, static)
            if np.abs(self.basis.p).max() * POTENTIAL_SCALE < _LARGEST_LIFTING:
                break
        self._krylov(self.factor, static, share)

    def add(self, coefficients: np.ndarray) -> int:
        """Add the driven vectors at other coefficients of the affine terms; return the number of new columns."""
        factor, static = self._static(coefficients, _SHIFTS[0])
        return self._krylov(factor, static, _SHIFTS[0])

    def correct(self, residuals: np.ndarray) -> int:
        """Add the corrections K_σ^-1 r of residuals (m, k), longest first; return the number of new columns."""
        starts = range(0, residuals.shape[1], _COLUMNS)
        return self.basis.add_all((self.factor.solve(residuals[:, at : at + _COLUMNS]) for at in starts), _KEEP)

    def _static(self, coefficients: np.ndarray, share: float) -> tuple[Factorization, np.ndarray]:
        """Factor of K − σM at a share of the band's highest ω², and its response to a charge."""
        factor = self._model.factorize(coefficients, share * self._top)
        load = np.zeros(self._model.size)
        load[-1] = -1.0
        return factor, factor.solve(load)

    def _krylov(self, factor: Factorization, static: np.ndarray, share: float) -> int:
        vectors = driven_krylov(factor, self.basis.mass, static, share * self._top, self._top, self._accuracy)
        return self.basis.add(vectors / np.linalg.norm(vectors[: self.basis.split], axis=0), 1e-8)


def _loss(matrices: np.ndarray, displacements: int, item: TrainingSet) -> float:
    """Largest relative change of Z at a training point when the terms are projected on fewer vectors (`matrices`)."""
    return worst_change(TrainingSet.of(matrices, displacements, item.coefficients, item.top), item)


def _finished(model: ElectroelasticModel, enriched: _Enriched, band_Hz: float, accuracy: float) -> ReducedModel:
    """The reduced model on the fewest leading principal components of the training states that keep the accuracy."""
    basis, sets = enriched.basis, enriched.sets
    ku, matrices = basis.u.shape[1], basis.matrices()
    rotation, new_ku, loss = np.eye(matrices.shape[1]), ku, 0.0
    for tolerance in np.sqrt(accuracy * LOSS) * np.array([1.0, 0.5, 0.25, 0.1, 0.03, 0.01]):
        few, few_ku = TrainingSet.principal_components(sets, matrices, ku, tolerance)
        change = max(in_parallel(partial(_loss, few.T @ matrices @ few, few_ku), sets))
        if change < 0.25 * accuracy:
            rotation, new_ku, loss = few, few_ku, change
            break
    return ReducedModel(
        terms=model.terms,
        matrices=rotation.T @ matrices @ rotation,
        displacements=new_ku,
        admittance_factor=model.domain.admittance_factor,
        basis=basis.matrix @ rotation,
        estimated_error=enriched.error + loss,
        band_Hz=band_Hz,
        training=np.array([item.coefficients for item in sets]),
        rounds=enriched.rounds,
        factors=enriched.factors,
    )
