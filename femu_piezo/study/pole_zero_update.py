"""The paper's updates, on reduced bases that follow the constants: pole-zero iteration on the fundamental of each
specimen, and all poles and zeros together for any free constants (appendix A)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from femu_piezo.effects.extended_model import ExtendedModel
from femu_piezo.errors import InputError
from femu_piezo.forward.fundamental import reduced_source
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.inference.starts.many_modes import MeasuredModes, update_many
from femu_piezo.inference.starts.pole_zero import (
    PoleZeroUpdate,
    Step,
    propagate_covariance,
    update_pair,
    update_simplified,
)
from femu_piezo.inference.unknowns import FreeConstants, material_prior
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.material.simplified import simplify
from femu_piezo.study.measured import Measured
from femu_piezo.study.model_cache import Bases
from femu_piezo.study.problem import Problem
from femu_piezo.study.starts import pair_names


@dataclass(frozen=True)
class PoleZeroState:
    """Constants that give the measured poles and zeros.

    Attributes
    ----------
    free : the free constants around them;  covariance : (2n, 2n) over (Re θ_1, Im θ_1, …), None where unknown
    models : the rough basis of each specimen
    histories : iterations on each specimen's fundamental
    left : rms of what all poles and zeros leave over their deviation, and how many of how many they followed; None
        where it was the fundamental alone
    """

    constants: PiezoConstants
    free: FreeConstants
    covariance: np.ndarray | None
    models: tuple[ExtendedModel, ...]
    histories: tuple[tuple[Step, ...], ...]
    left: tuple[float, int, int] | None = None


def all_poles_and_zeros(
    measured: Sequence[Measured],
    full: Sequence[ElectroelasticModel],
    bases: Bases,
    start: PiezoConstants,
    accuracy: float,
) -> PoleZeroState:
    """All free constants from all poles and zeros, from start constants on bases within `accuracy` of Z.

    InputError where a sweep has no deviations of its poles and zeros; ConvergenceError where it does not settle.
    """
    problem = measured[0].problem
    material = problem.specimen.material
    prior = material_prior(problem.free(problem.constants), material.priors, material.tangent_priors)
    for one in measured:
        if one.extraction.resonances.covariance is None:
            raise InputError(f"{one.spectrum.source}: its poles and zeros have no deviations to weigh them by")

    def step(free: FreeConstants, models: Sequence[ExtendedModel]) -> tuple[PoleZeroState, PiezoConstants]:
        modes = [_modes(one, model) for one, model in zip(measured, models, strict=True)]
        found = update_many(modes, free, prior)
        every = sum(len(one.resonances.poles) + len(one.resonances.zeros) for one in modes)
        state = PoleZeroState(
            constants=found.constants,
            free=free.at(found.theta),
            covariance=found.covariance,
            models=tuple(models),
            histories=(no_history(problem),) * len(measured),
            left=(found.left, sum(map(len, found.used)), every),
        )
        return state, found.constants

    return bases.following(measured, full, start, accuracy, step)


def no_history(problem: Problem) -> tuple[Step, ...]:
    """The one step of a specimen that no iteration on its fundamental led to."""
    return (Step(problem.constants, np.full(2, np.nan + 0j)),)


def _modes(one: Measured, model: ExtendedModel) -> MeasuredModes:
    permittivity = None if one.permittivity is None else (one.permittivity, one.permittivity_covariance)
    found, error = one.extraction.resonances, model.mesh_error
    frequency = np.array([resonance.frequency_Hz for resonance in (*found.poles, *found.zeros)])
    told = np.zeros(frequency.size) if error is None else error.at(frequency)
    return MeasuredModes(found, lambda constants: model.modal(constants.to_e_form()), told, permittivity)


def pole_zero_update(
    measured: Sequence[Measured],
    full: Sequence[ElectroelasticModel],
    bases: Bases,
    start: PiezoConstants,
    accuracy: float,
) -> PoleZeroState:
    """Iterate from start constants on bases within `accuracy` of Z; ConvergenceError where it does not settle."""
    histories = []  # of every basis; the first led to the constants

    def step(free: FreeConstants, models: Sequence[ExtendedModel]) -> tuple[PoleZeroState, PiezoConstants]:
        state = _iterated(measured, models, free)
        histories.append(state.histories)
        return state, state.constants

    return replace(bases.following(measured, full, start, accuracy, step), histories=histories[0])


def _iterated(measured: Sequence[Measured], models: Sequence[ExtendedModel], free: FreeConstants) -> PoleZeroState:
    constants, histories = free.constants(free.start), []
    covariance = np.zeros((2 * free.start.size, 2 * free.start.size))
    for one, model in zip(measured, models, strict=True):
        names = pair_names(one.problem.plate)
        if not names or not set(names) <= set(free.names):
            histories.append((Step(constants, np.full(2, np.nan + 0j)),))
            continue
        found, block = _of_one(one, model, constants, names)
        constants = found.constants
        histories.append(found.history)
        carried = (*names, "eps33T") if block is not None and len(block) > 4 else names
        where = [2 * free.names.index(name) + part for name in carried for part in (0, 1)]
        covariance[np.ix_(where, where)] = np.nan if block is None else block
    theta = np.array([getattr(constants, name) for name in free.names])
    unknown = None if np.any(np.isnan(covariance)) else covariance
    return PoleZeroState(constants, free.at(theta), unknown, tuple(models), tuple(histories))


def _of_one(
    one: Measured, model: ExtendedModel, constants: PiezoConstants, names: tuple[str, ...]
) -> tuple[PoleZeroUpdate, np.ndarray | None]:
    simplified, poling = one.problem.specimen.material.simplified, one.problem.plate.poling
    target = np.array([one.pair.pole.eigenvalue, one.pair.zero.eigenvalue])
    two = FreeConstants.of(constants, names, simplified=simplified, poling=poling)
    if simplified:
        start = simplify(constants, poling)
        found = update_simplified(reduced_source(model), start, target, constants.eps33T)
    else:
        found = update_pair(reduced_source(model), two, target)
    covariance = _pair_covariance(one)
    if covariance is None:
        return found, None
    if one.permittivity is None or "eps33T" not in one.problem.specimen.material.free:
        return found, propagate_covariance(found, two, covariance)
    eps = FreeConstants.of(constants, ("eps33T",), simplified=simplified, poling=poling)
    return found, propagate_covariance(found, two, covariance, eps, one.permittivity_covariance)


def _pair_covariance(one: Measured) -> np.ndarray | None:
    """(4, 4) joint covariance of (Re λ, Im λ) of the fundamental pole and zero out of the set's."""
    resonances = one.extraction.resonances
    if resonances.covariance is None:
        return None
    pole = resonances.poles.index(one.pair.pole)
    zero = len(resonances.poles) + resonances.zeros.index(one.pair.zero)
    where = [2 * pole, 2 * pole + 1, 2 * zero, 2 * zero + 1]
    return resonances.covariance[np.ix_(where, where)]
