"""Reduced model: every affine term projected once on a small real basis; then Z(f; θ) costs milliseconds.

The basis starts from the Krylov vectors of the driven reference plate. Then the reduced model is made at training
constants around the reference; the residuals r of its modes there give corrections K^-1 r with the one factor that
is already at hand, and the change of Z that they bring is the a-posteriori estimate of its error. At the end a
principal component analysis of all training states leaves the fewest vectors that keep the accuracy.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from femu_piezo.errors import ConvergenceError
from femu_piezo.forward.krylov import LOSS, driven_krylov
from femu_piezo.forward.linear_solver import factorize
from femu_piezo.forward.modal import ModalModel, diagonalise
from femu_piezo.forward.model import POTENTIAL_SCALE, ElectroelasticModel
from femu_piezo.forward.reduced_basis import ReducedBasis
from femu_piezo.forward.training import TrainingSet, compressed, state_residuals, worst_change
from femu_piezo.material.constants import E_FORM, ElasticForm, PiezoConstants
from femu_piezo.threads import blas_limit, useful_threads

#: Constants, or constants with real coefficients of extra terms, at which the basis is trained.
TrainingPoint = PiezoConstants | tuple[PiezoConstants, Mapping[str, float]]

#: Share of the largest correction below which a direction is not added to the basis.
_KEEP = 1e-3

#: Where in the band the operator is factorised, as shares of the highest ω²; the next where the electrode's
#: potential is nearly zero there (the potential somewhere inside is larger than so many times the electrode's).
_SHIFTS, _LARGEST_LIFTING = (0.4, 0.33, 0.47), 30.0


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
    """

    terms: tuple[str, ...]
    matrices: np.ndarray = field(repr=False)
    displacements: int
    admittance_factor: float
    basis: np.ndarray = field(repr=False)
    estimated_error: float
    band_Hz: float
    training: np.ndarray = field(repr=False)

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
    accuracy : bound on the estimated relative error of Z at every training point, with 0.5 % loss throughout

    Raises
    ------
    ConvergenceError : the estimate stays above `accuracy` after `max_rounds` enrichments
    """
    points = _distinct([_coefficients(model, point) for point in _with_neighbours(training)])
    both = _distinct([*points, *(_coefficients(model, point) for point in _reflections(training))])
    checks = both[len(points) :]
    with blas_limit(useful_threads(model.size)):
        basis, sets, error = _enriched(model, points, checks, band_Hz, accuracy, max_rounds)
        return _finished(model, basis, sets, band_Hz, accuracy, error)


def _enriched(
    model: ElectroelasticModel,
    points: list[np.ndarray],
    checks: list[np.ndarray],
    band_Hz: float,
    accuracy: float,
    max_rounds: int,
) -> tuple[ReducedBasis, list[TrainingSet], float]:
    """Basis enriched until the estimate at points and checks is below half of `accuracy`; errors as `reduce_model`."""
    top = (2 * np.pi * band_Hz) ** 2
    basis, factor, scale = _reference_basis(model, points[0], top, accuracy)
    sets = _train(basis, [*points, *checks], top)
    change, active = np.full(len(sets), np.inf), np.arange(len(points))
    for _ in range(max_rounds):
        residuals = np.hstack([state_residuals(basis, sets[index]) for index in active])
        added = basis.add(factor.solve(compressed(residuals, scale)), _KEEP)
        fresh = _train(basis, [*points, *checks], top)
        before, change = change, np.array([worst_change(old, new) for old, new in zip(sets, fresh, strict=True)])
        sets, error = fresh, _predicted(before, change)
        active = np.flatnonzero(error > 0.1 * accuracy)
        if error.max() < 0.5 * accuracy:
            return basis, sets, float(error.max())
        if added == 0:
            break
    raise ConvergenceError(
        f"the reduced model reached a relative error of {error.max():.1e}, asked were {accuracy:.1e}: "
        "narrow the band or the range of the constants, or ask for less accuracy"
    )


def _train(basis: ReducedBasis, points: list[np.ndarray], top: float) -> list[TrainingSet]:
    matrices = basis.matrices()
    return [TrainingSet.of(matrices, basis.u.shape[1], point, top) for point in points]


def _predicted(before: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Error left at each training point: the last change, times the root of its ratio to the one before.

    Changes fall faster than by a constant ratio; the root was above the true error in every case measured.
    """
    known = np.isfinite(before) & (before > 0)
    return change * np.sqrt(np.minimum(1.0, np.divide(change, before, out=np.ones_like(change), where=known)))


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


def _reference_basis(model: ElectroelasticModel, coefficients: np.ndarray, top: float, accuracy: float):
    """Krylov basis at the reference, the factor of K − σM inside the band, and the diagonal that scales residuals."""
    constants = ElasticForm.from_vector(coefficients[: len(E_FORM)])
    extra = dict(zip(model.terms[len(E_FORM) :], coefficients[len(E_FORM) :], strict=True))
    stiffness = model.stiffness(constants, extra)
    load = np.zeros(model.size)
    load[-1] = -1.0
    for share in _SHIFTS:
        factor = factorize(stiffness - share * top * model.mass)
        static = factor.solve(load)
        basis = ReducedBasis(model, stiffness, static)
        if np.abs(basis.p).max() * POTENTIAL_SCALE < _LARGEST_LIFTING:
            break
    vectors = driven_krylov(factor, basis.mass, static, share * top, top, 0.1 * accuracy)
    basis.add(vectors / np.linalg.norm(vectors[: basis.split], axis=0), 1e-8)
    return basis, factor, np.abs(stiffness.diagonal())


def _finished(model, basis: ReducedBasis, sets, band_Hz: float, accuracy: float, error: float) -> ReducedModel:
    """Compress to the leading principal components of the training states that keep the accuracy."""
    ku, matrices = basis.u.shape[1], basis.matrices()
    rotation, new_ku, loss = np.eye(matrices.shape[1]), ku, 0.0
    for tolerance in np.sqrt(accuracy * LOSS) * np.array([1.0, 0.5, 0.25, 0.1, 0.03, 0.01]):
        few, few_ku = TrainingSet.principal_components(sets, matrices, ku, tolerance)
        small = few.T @ matrices @ few
        new = [TrainingSet.of(small, few_ku, item.coefficients, item.top) for item in sets]
        change = max(worst_change(less, all_) for less, all_ in zip(new, sets, strict=True))
        if change < 0.25 * accuracy:
            rotation, new_ku, loss = few, few_ku, change
            break
    return ReducedModel(
        terms=model.terms,
        matrices=rotation.T @ matrices @ rotation,
        displacements=new_ku,
        admittance_factor=model.domain.admittance_factor,
        basis=basis.matrix @ rotation,
        estimated_error=error + loss,
        band_Hz=band_Hz,
        training=np.array([item.coefficients for item in sets]),
    )
