"""Reduced model: every affine term projected once on a small real basis; then Z(f; θ) costs milliseconds.

The basis starts from the Krylov vectors of the driven reference plate. Then the reduced model is made at training
constants around the reference; the residuals r of its modes there give corrections K^-1 r with the one factor that
is already at hand, and the change of Z that they bring is the a-posteriori estimate of its error. Training constants
at which it falls slowly get a factor and Krylov vectors of their own. At the end a
principal component analysis of all training states leaves the fewest vectors that keep the accuracy.
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
from femu_piezo.forward.training import TrainingSet, compressed, state_residuals, worst_change
from femu_piezo.material.constants import E_FORM, ElasticForm, PiezoConstants
from femu_piezo.threads import blas_limit, in_parallel, useful_threads

#: Constants, or constants with real coefficients of extra terms, at which the basis is trained.
TrainingPoint = PiezoConstants | tuple[PiezoConstants, Mapping[str, float]]

#: Share of the largest correction below which a direction is not added to the basis.
_KEEP = 1e-3

#: Where in the band the operator is factorised, as shares of the highest ω²; the next where the electrode's
#: potential is nearly zero there (the potential somewhere inside is larger than so many times the electrode's).
_SHIFTS, _LARGEST_LIFTING = (0.4, 0.33, 0.47), 30.0

#: A training point whose error is below this share of the accuracy is not looked at again: a larger basis serves it
#: better still.
_SETTLED = 0.03

#: A training point whose last change is more than this share of the one before gets driven vectors of its own; so many
#: points in one round. A series of changes is taken to fall by this ratio at the slowest.
_SLOW, _OWN_IN_A_ROUND, _SLOWEST = 0.2, 2, 0.9

#: Residuals below this share of the largest are not corrected, nor below this share of what would leave the accuracy:
#: the error of Z is as the square of what is left.
_LEAST_RESIDUAL, _LEFT_RESIDUAL = 1e-3, 0.1

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
    rounds, factors : enrichments made, and training points that were factorised, the reference among them
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
        """(n_terms,) coefficients of the affine terms, 0 for extra terms not named; real where all are real."""
        extra = extra or {}
        unknown = set(extra) - set(self.terms)
        if unknown:
            raise KeyError(f"the reduced model has no terms {sorted(unknown)}; it has {self.terms[len(E_FORM) :]}")
        values = np.concatenate([constants.vector(), [extra.get(name, 0.0) for name in self.terms[len(E_FORM) :]]])
        return values if np.any(values.imag) else values.real

    def modal(self, constants: ElasticForm, extra: Mapping[str, complex] | None = None) -> ModalModel:
        """Closed forms at given e-form constants (complex) and coefficients of the extra terms (0 where absent)."""
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
        around the first, whose loss tangents it follows too; of the others the real parts count.
    accuracy : aim for the estimated relative error of Z at every training point, with 0.5 % loss throughout. What was
        reached is the `estimated_error` of the result.

    Raises
    ------
    ConvergenceError : the estimate stays above 1 % (and `accuracy`) after `max_rounds` enrichments
    """
    points = _distinct([_coefficients(model, point) for point in _with_neighbours(training)])
    both = _distinct([*points, *(_coefficients(model, point) for point in _reflections(training))])
    checks = both[len(points) :]
    with blas_limit(useful_threads(model.size)):
        enriched = _enriched(model, points, checks, band_Hz, accuracy, max_rounds)
        if not enriched.error < max(_USELESS, accuracy):
            raise ConvergenceError(
                f"the reduced model reached a relative error of {enriched.error:.1e}, asked were {accuracy:.1e}: "
                "narrow the band or the range of the constants"
            )
        return _finished(model, enriched, band_Hz, accuracy)


def driven_modal(
    model: ElectroelasticModel, constants: PiezoConstants, band_Hz: float, accuracy: float = 1e-9
) -> ModalModel:
    """Closed forms at lossless constants alone, from driven Krylov vectors that give Z up to a frequency, Hz."""
    with blas_limit(useful_threads(model.size)):
        point, top = _coefficients(model, constants), (2 * np.pi * band_Hz) ** 2
        basis = _DrivenVectors(model, point, top, accuracy).basis
        return TrainingSet.of(basis.matrices(), basis.u.shape[1], point, top).modal


@dataclass(frozen=True)
class _Enriched:
    """A basis that was enriched: the reduced models at all training points, the estimated error, and the effort."""

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
    """Basis enriched until the estimate at points and checks is below half of `accuracy`, or as far as it goes.

    Residuals are corrected with the factor at the reference. Where that brings too little, the constants are far from
    the reference or two modes lie close together: there the basis gets the driven vectors of the point itself.
    """
    top, everywhere = (2 * np.pi * band_Hz) ** 2, [*points, *checks]
    driven = _DrivenVectors(model, points[0], top, 0.1 * accuracy)
    basis = driven.basis
    sets = _train(basis, everywhere, top)
    change, error, factors, rounds = np.full(len(sets), np.inf), np.full(len(sets), np.inf), {0}, 0
    states, left_out = max(item.states.shape[1] for item in sets), 0.0
    active, slow, watched = np.arange(len(points)), [], np.arange(len(sets))
    while error.max() > 0.5 * accuracy and rounds < max_rounds:
        residuals = np.hstack(list(in_parallel(lambda item: state_residuals(basis, item), [sets[i] for i in active])))
        share = max(_LEAST_RESIDUAL, _LEFT_RESIDUAL * float(np.sqrt(0.5 * accuracy / error.max())))
        added = basis.add(driven.factor.solve(compressed(residuals, driven.scale, share)), _KEEP)
        added += sum(driven.add(everywhere[index]) for index in slow)
        factors.update(slow)
        rounds, watched = rounds + 1, np.flatnonzero(error > _SETTLED * accuracy)
        fresh = _train(basis, [everywhere[index] for index in watched], top)
        last = np.array([worst_change(sets[i], new) for i, new in zip(watched, fresh, strict=True)])
        ratio = _ratios(change[watched], last, left_out)
        change[watched], error[watched] = last, _predicted(last, ratio)
        left_out = states * share**2 * last.max()  # what residuals that were not corrected may hold of a point
        for index, new in zip(watched, fresh, strict=True):
            sets[index] = new
        if added == 0:
            break
        active = np.flatnonzero(error > 0.1 * accuracy)
        stagnant = watched[(error[watched] > 0.5 * accuracy) & (ratio > _SLOW)]
        slow = [index for index in stagnant[np.argsort(-error[stagnant])] if index not in factors][:_OWN_IN_A_ROUND]
    if watched.size < len(sets):
        sets = _train(basis, everywhere, top)
    return _Enriched(basis, sets, float(error.max()), rounds, len(factors))


def _train(basis: ReducedBasis, points: list[np.ndarray], top: float) -> list[TrainingSet]:
    matrices = basis.matrices()
    return list(in_parallel(lambda point: TrainingSet.of(matrices, basis.u.shape[1], point, top), points))


def _ratios(before: np.ndarray, change: np.ndarray, left_out: float) -> np.ndarray:
    """(n,) ratio q of the last change of each training point to the one before; 0 where there was none.

    A change before that is no more than what was left out of the corrections tells no ratio of its point: the slowest
    of the others is taken.
    """
    told = np.isfinite(before) & (before > left_out)
    ratio = np.divide(change, before, out=np.zeros_like(change), where=told)
    ratio[np.isfinite(before) & ~told] = ratio.max() if np.any(told) else _SLOWEST
    return np.minimum(_SLOWEST, ratio)


def _predicted(change: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """(n,) error left at each training point, from the last change and its ratio q to the one before.

    Changes usually fall faster than by a constant ratio; √q of the last was above the true error in every case
    measured. Where they fall slowly, by q > 0.38, what a series of that ratio would still bring is more: q/(1 − q).
    """
    return np.where(ratio > 0, change * np.maximum(np.sqrt(ratio), ratio / (1 - ratio)), change)


def _with_neighbours(training: Sequence[TrainingPoint]) -> list[TrainingPoint]:
    """The training points, and beside the lossy ones the real point that the imaginary part leads to.

    States are analytic in the constants, so a basis that follows them along a real direction follows them along
    the same imaginary one; the direction of the first point serves all with the same extra terms. A lossless point
    that is alone gets elastic, then piezoelectric neighbours 3 % away.
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
    """The training points mirrored at the first where that is a stable material: there the error is watched too."""
    points = [point if isinstance(point, tuple) else (point, {}) for point in training]
    first = points[0][0].vector().real
    mirrored = [(PiezoConstants.from_vector(2 * first - item.vector().real), extra) for item, extra in points[1:]]
    return [(constants, extra) for constants, extra in mirrored if not constants.physical_faults()]


def _distinct(points: list[np.ndarray]) -> list[np.ndarray]:
    """The points in their order without those that repeat an earlier one."""
    result = []
    for point in points:
        if not any(np.allclose(point, other, rtol=1e-9, atol=0.0) for other in result):
            result.append(point)
    return result


def _coefficients(model: ElectroelasticModel, point: TrainingPoint) -> np.ndarray:
    constants, extra = point if isinstance(point, tuple) else (point, {})
    e_form = constants.lossless().to_e_form().vector().real
    return np.concatenate([e_form, [float(extra.get(name, 0.0)) for name in model.terms[len(E_FORM) :]]])


class _DrivenVectors:
    """A basis of driven Krylov vectors, of the reference and of further constants.

    Attributes
    ----------
    basis : the basis so far
    factor : of K − σM at the reference, σ inside the band
    scale : (m,) diagonal of K at the reference, which scales residuals
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
    """Relative change of Z at a training point by projection on fewer vectors."""
    return worst_change(TrainingSet.of(matrices, displacements, item.coefficients, item.top), item)


def _finished(model: ElectroelasticModel, enriched: _Enriched, band_Hz: float, accuracy: float) -> ReducedModel:
    """Compress to the leading principal components of the training states that keep the accuracy."""
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
