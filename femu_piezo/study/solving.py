"""The solving half of `update`: pole-zero iteration, then the curve fit, on reduced bases that follow the constants."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from femu_piezo.errors import ConvergenceError
from femu_piezo.forward.fundamental import dominant_index, reduced_source
from femu_piezo.forward.modal import ModalModel
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import ReducedModel
from femu_piezo.inference.blocks import CurveData, Passivity, Prior, weak_prior
from femu_piezo.inference.identifiability import Identifiability, identifiability
from femu_piezo.inference.least_squares import Fit, fit
from femu_piezo.inference.matching import match
from femu_piezo.inference.sensitivity import sensitivity
from femu_piezo.inference.starts.pole_zero import Step, propagate_covariance, update_pair, update_simplified
from femu_piezo.inference.unknowns import FreeConstants, MaterialParameters
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.material.simplified import simplify
from femu_piezo.resonances import Resonance
from femu_piezo.specimen.file import Update
from femu_piezo.study.effects import EffectCurve, effect_curve, has_effects
from femu_piezo.study.measured import Measured
from femu_piezo.study.model_cache import LEAVE, Bases
from femu_piezo.study.progress import Clock
from femu_piezo.study.results import Outcome
from femu_piezo.study.starts import pair_names

#: Bands of a sweep whose residuals count as one where neighbours are correlated.
_BANDS = 15


@dataclass(frozen=True)
class State:
    """Where the update stands."""

    constants: PiezoConstants
    free: FreeConstants
    theta: np.ndarray
    covariance: np.ndarray | None
    reduced: tuple[ReducedModel, ...]
    histories: tuple[tuple[Step, ...], ...]
    fit: Fit | None = None
    known: Identifiability | None = None
    provenance: dict[str, dict[str, float]] | None = None
    curves: tuple[CurveData | EffectCurve, ...] = ()


class Run:
    """Pole-zero iteration and curve fit on reduced bases that follow the constants."""

    def __init__(self, measured: list[Measured], method: str, clock: Clock, bases: Bases) -> None:
        self._measured, self._clock, self._bases = measured, clock, bases
        self._models = [bases.model(one, whole_curve=method == "curve") for one in measured]
        self._problem = measured[0].problem

    def solve(self, start: PiezoConstants, method: str) -> State:
        """Iterate from start constants by "pole_zero" or "curve"; ConvergenceError where it does not settle."""
        state, anchor = None, None
        constants = start
        for _ in range(6):
            free = self._problem.free(constants)
            if anchor is None or np.max(np.abs(free.start.real / anchor - 1)) > LEAVE:
                anchor, reduced = self._reduce(free)
            self._clock.step("pole-zero update")
            histories = state.histories if state else None
            state = self._pole_zero(free, reduced)
            state = state if histories is None else replace(state, histories=histories)
            if method == "curve":
                self._clock.step("curve fit")
                state = self._curve(state)
            constants = state.constants
            if np.max(np.abs(state.theta.real / anchor - 1)) <= LEAVE:
                return state
        raise ConvergenceError(
            "the constants kept leaving the range of the reduced model; start from a closer base material or free fewer"
        )

    def _reduce(self, free: FreeConstants) -> tuple[np.ndarray, tuple[ReducedModel, ...]]:
        """The free values that the bases are trained around, and the bases."""
        self._clock.step("reduce")
        around = self._bases.anchor(self._problem, free)
        return around.start.real, tuple(
            self._bases.reduced(model, around, one) for model, one in zip(self._models, self._measured, strict=True)
        )

    def _pole_zero(self, free: FreeConstants, reduced: tuple[ReducedModel, ...]) -> State:
        if has_effects(self._measured):  # poles and zeros are not those of the bare body: the curve is fitted at once
            start = (Step(free.constants(free.start), np.full(2, np.nan + 0j)),)
            return State(start[0].constants, free, free.start, None, reduced, (start,) * len(self._measured))
        constants, histories = free.constants(free.start), []
        covariance = np.zeros((2 * free.start.size, 2 * free.start.size))
        for one, basis in zip(self._measured, reduced, strict=True):
            names = pair_names(one.problem.plate)
            if not names or not set(names) <= set(free.names):
                histories.append((Step(constants, np.full(2, np.nan + 0j)),))
                continue
            found, block = self._pole_zero_one(one, basis, constants, names)
            constants = found.constants
            histories.append(found.history)
            carried = (*names, "eps33T") if block is not None and len(block) > 4 else names
            where = [2 * free.names.index(name) + part for name in carried for part in (0, 1)]
            covariance[np.ix_(where, where)] = np.nan if block is None else block
        theta = np.array([getattr(constants, name) for name in free.names])
        unknown = None if np.any(np.isnan(covariance)) else covariance
        return State(constants, free, theta, unknown, reduced, tuple(histories))

    def _pole_zero_one(self, one: Measured, basis: ReducedModel, constants: PiezoConstants, names: tuple[str, ...]):
        simplified, poling = self._problem.specimen.material.simplified, one.problem.plate.poling
        target = np.array([one.pair.pole.eigenvalue, one.pair.zero.eigenvalue])
        two = FreeConstants.of(constants, names, simplified=simplified, poling=poling)
        if simplified:
            start = simplify(constants, poling)
            found = update_simplified(reduced_source(basis), start, target, constants.eps33T)
        else:
            found = update_pair(reduced_source(basis), two, target)
        covariance = _pair_covariance(one)
        if covariance is None:
            return found, None
        if one.permittivity is None or "eps33T" not in self._problem.specimen.material.free:
            return found, propagate_covariance(found, two, covariance)
        eps = FreeConstants.of(constants, ("eps33T",), simplified=simplified, poling=poling)
        return found, propagate_covariance(found, two, covariance, eps, one.permittivity_covariance)

    def _curve(self, state: State) -> State:
        parameters = MaterialParameters.around(state.free, state.theta)
        curves = [
            effect_curve(one, model, parameters.free.at(state.theta))
            if one.problem.specimen.effects
            else CurveData(one.problem.specimen.name, basis, one.fitted, one.relative_noise)
            for one, basis, model in zip(self._measured, state.reduced, self._models, strict=True)
        ]
        known = all(one.noise_known for one in self._measured)
        wish = self._problem.specimen.update or Update()
        blocks = [*curves, self._prior(parameters), Passivity()]
        solution = fit(blocks, parameters, state.theta, noise_known=known, loss=wish.loss)
        if solution.noise_scale != 1.0:
            solution = replace(solution, groups=_correlated_groups(curves, solution))
        from_data = [curve.jacobian(parameters, solution.x) / solution.noise_scale for curve in curves]
        weak = weak_prior(parameters, solution.theta).jacobian(parameters, solution.x)
        told = identifiability(np.concatenate([*from_data, weak]), parameters.names, solution.x)
        constants = state.free.constants(solution.theta)
        return replace(
            state,
            constants=constants,
            theta=solution.theta,
            covariance=solution.theta_covariance,
            fit=solution,
            known=told,
            provenance=_provenance(parameters, curves, from_data, weak),
            curves=tuple(curves),
        )

    def _prior(self, parameters: MaterialParameters) -> Prior:
        """The weak prior around the specimen file's values, and what the file says is known better."""
        names, material = parameters.free.names, self._problem.specimen.material
        centre = np.array([getattr(self._problem.constants, name) for name in names])
        weak = weak_prior(parameters, centre)
        known = {
            name: (getattr(self._problem.constants, name).real, std * abs(getattr(self._problem.constants, name).real))
            for name, std in material.priors.items()
            if name in names
        }
        return Prior({**weak.values, **known}, name="prior")

    def outcome(self, index: int, state: State, base: PiezoConstants) -> Outcome:
        """Curves and matched resonances of one specimen at the solution."""
        one, model = self._measured[index], self._models[index]
        basis = self._bases.baseline(model, base, one)
        base_curve = basis.impedance(base.to_e_form(), one.spectrum.frequency)
        modal = state.reduced[index].modal(state.constants.to_e_form())
        updated = modal.impedance(one.spectrum.omega)
        if one.problem.specimen.effects:
            updated = state.curves[index].impedance(state.fit.parameters, state.fit.x, one.spectrum.omega)
        return Outcome(
            measured=one,
            matched=_matched(one, modal),
            base_curve=base_curve,
            updated_curve=updated,
            history=state.histories[index],
            sensitivity=sensitivity(
                one.problem.specimen.name, state.reduced[index], state.constants, one.spectrum.frequency
            ),
            unknowns=model.size,
            mesh=_mesh_words(model, state.reduced[index]),
        )


def _mesh_words(model: ElectroelasticModel, reduced: ReducedModel) -> str:
    mesh, copies = model.domain.mesh, model.domain.copies
    part = "the whole body" if copies == 1 else f"1/{copies} of the body, cut at its mirror planes"
    kind = "hexahedra" if "Hex" in type(mesh).__name__ else "tetrahedra"
    what = f"{mesh.nelements} {kind} of order {model.order} in {part}"
    return f"{what}; {model.size} unknowns, reduced to {reduced.size}"


def _provenance(
    parameters: MaterialParameters, curves: list[CurveData], from_data: list[np.ndarray], weak: np.ndarray
) -> dict[str, dict[str, float]]:
    """Where the knowledge of each constant comes from: shares of |∂residual/∂x|² of every sweep and of the prior.

    The information each sweep would give on the constant if all others were known, real part and tangent together.
    """
    result = {}
    for index, name in enumerate(parameters.free.names):
        columns = slice(2 * index, 2 * index + 2)
        parts = {
            curve.name: float(np.sum(rows[:, columns] ** 2)) for curve, rows in zip(curves, from_data, strict=True)
        }
        parts["prior"] = float(np.sum(weak[:, columns] ** 2))
        total = sum(parts.values())
        result[name] = {source: part / total for source, part in parts.items()}
    return result


def _correlated_groups(curves: list[CurveData], solution: Fit) -> np.ndarray | None:
    """Bands of each sweep as groups of residuals where neighbours are correlated; None where they are not.

    A misfit smooth in frequency is an error of model or instrument; treating its points as independent would give
    intervals far too narrow.
    """
    labels, correlated, start = np.full(solution.residual.size, -1), False, 0
    for number, curve in enumerate(curves):
        size = len(curve.spectrum)
        parts = solution.residual[start : start + 2 * size].reshape(2, size)
        neighbours = np.sum(parts[:, 1:] * parts[:, :-1]) / np.sum(parts**2)
        correlated |= bool(neighbours > max(0.2, 4 / np.sqrt(2 * size)))
        band = np.arange(size) * _BANDS // size
        labels[start : start + 2 * size] = np.tile(band + number * _BANDS, 2)
        start += 2 * size
    return labels if correlated else None


def _matched(one: Measured, modal: ModalModel) -> tuple[tuple[Resonance, Resonance], ...]:
    """Every extracted resonance with the model's; only the fundamental where the model has fewer modes."""
    found = one.extraction.resonances
    try:
        poles = match(found.poles, modal.eigenvalues, modal.charges)
        zeros = match(found.zeros, modal.zeros[0], modal.zero_amplitudes)
    except ConvergenceError:
        near = one.pair.pole.frequency_Hz
        pole = modal.eigenvalues[dominant_index(modal.eigenvalues, modal.charges, near)]
        zero = modal.zeros[0][dominant_index(modal.zeros[0], modal.zero_amplitudes, near)]
        return ((one.pair.pole, Resonance("pole", complex(pole))), (one.pair.zero, Resonance("zero", complex(zero))))
    pairs = [(r, Resonance("pole", complex(modal.eigenvalues[i]))) for r, i in zip(found.poles, poles, strict=True)]
    pairs += [(r, Resonance("zero", complex(modal.zeros[0][i]))) for r, i in zip(found.zeros, zeros, strict=True)]
    return tuple(pairs)


def _pair_covariance(one: Measured) -> np.ndarray | None:
    """(4, 4) joint covariance of (Re λ, Im λ) of the fundamental pole and zero out of the set's."""
    resonances = one.extraction.resonances
    if resonances.covariance is None:
        return None
    pole = resonances.poles.index(one.pair.pole)
    zero = len(resonances.poles) + resonances.zeros.index(one.pair.zero)
    where = [2 * pole, 2 * pole + 1, 2 * zero, 2 * zero + 1]
    return resonances.covariance[np.ix_(where, where)]
