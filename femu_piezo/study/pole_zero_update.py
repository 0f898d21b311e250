"""The paper's updates: its iteration on the fundamental of each specimen, on reduced bases that follow the constants,
and what poles and zeros say of any free constants (appendix A), all tolerances of the specimen files counted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from femu_piezo.effects.extended_model import ExtendedModel
from femu_piezo.errors import InputError
from femu_piezo.forward.fundamental import reduced_source
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.inference.free_constants import FreeConstants
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.starts.many_modes import LowEnd, ManyModes, MeasuredModes, update_many
from femu_piezo.inference.starts.pole_zero import TOLERANCE, PoleZeroUpdate, Step, update_pair, update_simplified
from femu_piezo.inference.unknowns import Unknowns, material_prior
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.material.simplified import simplify
from femu_piezo.study.measured import Measured
from femu_piezo.study.model_cache import Bases
from femu_piezo.study.posterior import Posterior
from femu_piezo.study.problem import Problem
from femu_piezo.study.starts import pair_names

#: Prior standard deviation, relative, of constants that the fundamental alone determines, and that of their tangents.
_OPEN = 10.0


@dataclass(frozen=True)
class PoleZeroState:
    """Constants that give the measured fundamentals within a tolerance, and the iterations that led there."""

    constants: PiezoConstants
    histories: tuple[tuple[Step, ...], ...]


def from_poles_and_zeros(posterior: Posterior, start: PiezoConstants, *, fundamental: bool) -> ManyModes:
    """The most probable constants by poles and zeros, from start constants; all tolerances marginalised.

    fundamental : use the fundamental alone, which determines the free constants without a prior

    InputError where a sweep has no deviations of its poles and zeros; ConvergenceError where it does not settle.
    """
    for one in posterior.several:
        if one.measured.extraction.resonances.covariance is None:
            raise InputError(f"{one.measured.spectrum.source}: no standard deviations of its poles and zeros are known")

    def estimate(unknowns: Unknowns, begin: np.ndarray) -> ManyModes:
        if fundamental:
            free = unknowns.material.free
            wide = dict.fromkeys(free.names, _OPEN)
            unknowns = replace(unknowns, prior=material_prior(free, wide, wide), readings=())
        modes = [_modes(posterior, index, fundamental) for index in range(len(posterior.several))]
        return update_many(modes, unknowns, begin)

    return posterior.following(start, estimate)


def no_history(problem: Problem) -> tuple[Step, ...]:
    """The history of a specimen without iterations on its fundamental: one step, at the constants of the file."""
    return (Step(problem.constants, np.full(2, np.nan + 0j)),)


def _modes(posterior: Posterior, index: int, fundamental: bool) -> MeasuredModes:
    one, model = posterior.several[index], posterior.models[index]
    measured = one.measured
    found, low_end = measured.extraction.resonances, None
    if measured.permittivity is not None:
        omega = 2 * np.pi * measured.low_frequency
        low_end = LowEnd(measured.permittivity, measured.permittivity_covariance, omega)
    frequency = np.array([resonance.frequency_Hz for resonance in (*found.poles, *found.zeros)])
    return MeasuredModes(
        resonances=found,
        evaluation=Evaluation(model, measured.spectrum.omega),
        share=one.share,
        model_error=posterior.mesh_error_at(index, frequency),
        low_end=low_end,
        selected=(measured.pair.pole, measured.pair.zero) if fundamental else None,
    )


def pole_zero_update(
    measured: Sequence[Measured],
    full: Sequence[ElectroelasticModel],
    bases: Bases,
    start: PiezoConstants,
    accuracy: float,
    tolerance: float = TOLERANCE,
) -> PoleZeroState:
    """Iterate from start constants on bases within `accuracy` of Z; ConvergenceError where it does not settle.

    tolerance : relative distance of λ of pole and zero at which the iteration ends
    """
    histories = []  # by every basis; those by the first one led to the constants

    def step(free: FreeConstants, models: Sequence[ExtendedModel]) -> tuple[PoleZeroState, PiezoConstants]:
        state = _iterated(measured, models, free, tolerance)
        histories.append(state.histories)
        return state, state.constants

    return replace(bases.following(measured, full, start, accuracy, step), histories=histories[0])


def _iterated(
    measured: Sequence[Measured], models: Sequence[ExtendedModel], free: FreeConstants, tolerance: float
) -> PoleZeroState:
    constants, histories = free.constants(free.start), []
    for one, model in zip(measured, models, strict=True):
        names = pair_names(one.problem.plate)
        if not names or not set(names) <= set(free.names):
            histories.append((Step(constants, np.full(2, np.nan + 0j)),))
            continue
        found = _of_one(one, model, constants, names, tolerance)
        constants = found.constants
        histories.append(found.history)
    return PoleZeroState(constants, tuple(histories))


def _of_one(
    one: Measured, model: ExtendedModel, constants: PiezoConstants, names: tuple[str, ...], tolerance: float
) -> PoleZeroUpdate:
    simplified, poling = one.problem.specimen.material.simplified, one.problem.plate.poling
    target = np.array([one.pair.pole.eigenvalue, one.pair.zero.eigenvalue])
    if simplified:
        simple = simplify(constants, poling)
        return update_simplified(reduced_source(model), simple, target, constants.eps33T, tolerance=tolerance)
    free = FreeConstants.of(constants, names, poling=poling)
    return update_pair(reduced_source(model), free, target, tolerance=tolerance)
