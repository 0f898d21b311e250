"""Where the fit begins: constants near the solution, found on a coarse mesh without effects and tolerances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from femu_piezo.effects.extended_model import ExtendedModel
from femu_piezo.errors import ConvergenceError, InputError
from femu_piezo.inference.ensemble import Share, together
from femu_piezo.inference.fit import closest
from femu_piezo.inference.free_constants import FreeConstants
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.starts.pole_zero import Step
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.measurement.sweeps import SweepData
from femu_piezo.study.effects import has_effects
from femu_piezo.study.measured import Measured, start_constants
from femu_piezo.study.model_cache import LEAVE, Bases
from femu_piezo.study.pole_zero_update import no_history, pole_zero_update
from femu_piezo.study.posterior import COARSE_BASIS, COARSE_MESH
from femu_piezo.study.results import rms
from femu_piezo.study.starts import away_from_wall, in_proportion, is_hardly_stable, pair_names
from femu_piezo.study.tolerances import has_held_tolerances

#: Relative noise of the fits; large, as meshes and bases are coarse, since their constants are only a start.
_NOISE = 1e-2
#: Relative distance of λ at which the pole-zero update ends, small beside the errors of mesh and basis.
_TOLERANCE = COARSE_BASIS / 10
#: Powers with which constants change along with ε33T while the coupling factors of bodies poled along the field stay.
_POWERS = {"eps33T": 1.0, "d31": 0.5, "d33": 0.5}
#: Constants are poor if rms |Δ log Z| is above this multiple of the noise and above this value.
_POOR, _LEAST_POOR = 10.0, 5e-3
#: Frequency over that of the expected fundamental from which the lowest mode of a sweep counts as an overtone: the next
#: ones of bars and disks lie at 2.6 and 3, and constants of the file that are off by four still put it at 2.
_OVERTONE = 2.0


@dataclass(frozen=True)
class Beginning:
    """Start constants, and for every sweep the pole-zero iterations of its specimen that led to them.

    A history is one step where there were no iterations.
    """

    constants: PiezoConstants
    histories: tuple[tuple[Step, ...], ...]


def begin(measured: Sequence[Measured], bases: Bases) -> Beginning:
    """Start constants: those of the pole-zero update, or of the file, at the level of the curves; fitted where poor.

    The file's are tried where the others stay poor; of both, those with the smaller misfit are taken. Where these are
    hardly stable with the held constants of the file, others are tried for those (`_of_another_material`).

    The pole-zero update starts from thin-body formulas, which fail where the modes of two dimensions meet, and may
    mistake another mode for the fundamental, so that the body is far too soft; the file's constants may be far away.
    Where the lowest measured mode lies so high that it is an overtone by the file's constants, these are taken.

    Constants that a fit left, stable with the held ones as it left them alone, are taken as they are.

    Raises ConvergenceError where neither settles, and InputError where the specimen has effects, which the pole-zero
    update does not know, and the file's constants are no stable material.
    """
    every, leading = measured, _one_of_each(measured)
    measured = list(leading.values())
    problem = measured[0].problem
    full = [bases.model(one, COARSE_MESH) for one in measured]
    faults = problem.fitted.physical_faults(passive=False)
    if faults and not problem.left.physical_faults(passive=False):
        return Beginning(problem.fitted, tuple(no_history(one.problem) for one in every))
    by_pole_zero = not has_effects(measured) and (bool(faults) or not any(map(_is_of_overtones, measured)))
    attempts = [lambda: _from_pole_zero(measured, full, bases)] if by_pole_zero else []
    if not faults:
        without_steps = (no_history(problem),) * len(measured)
        attempts.append(lambda: (*_fitted(measured, full, bases, problem.fitted), without_steps))
    elif not attempts:
        where, told = problem.specimen.path or problem.specimen.name, "; ".join(map(str, faults))
        raise InputError(
            f"{where}: material: {told}; with [effects] the fit starts from these constants, so correct them"
        )
    found = []
    for attempt in attempts:
        try:
            found.append(attempt())
        except ConvergenceError as error:
            reason = error
            continue
        if not _is_poor(found[-1][0], measured):
            break
    if not found:
        raise reason
    misfit, constants, histories = min(found, key=lambda item: item[0])
    if not faults and is_hardly_stable(constants, problem.fitted):
        constants = _of_another_material(measured, full, bases, constants, misfit)

    def history(one: Measured) -> tuple[Step, ...]:
        """That of a leading sweep; no other one takes part in the pole-zero update."""
        own = (steps for lead, steps in zip(measured, histories, strict=True) if lead is one)
        return next(own, no_history(one.problem))

    return Beginning(constants, tuple(map(history, every)))


def _is_of_overtones(one: Measured) -> bool:
    """Whether the lowest mode of a sweep is an overtone, by the constants of the file."""
    return one.pair.pole.frequency_Hz > _OVERTONE * one.problem.expected_pole_Hz


def _of_another_material(
    measured: list[Measured], full, bases: Bases, constants: PiezoConstants, misfit: float
) -> PiezoConstants:
    """Constants in place of those found, which are hardly stable with the held constants of the file.

    The file is of another material then, or the sweep shows an effect. Where a fit may move the held constants, they
    are changed in proportion to the free ones, and these fitted again; that is taken where it comes closer.
    """
    problem = measured[0].problem
    if has_held_tolerances(problem):
        values = {name: getattr(constants, name) for name in problem.specimen.material.free}
        try:
            closer, moved = _fitted(measured, full, bases, in_proportion(problem.fitted, values))
        except ConvergenceError:
            closer = np.inf
        if closer < misfit:
            constants = moved
    return away_from_wall(constants, problem.fitted)


def _is_poor(misfit: float, measured: Sequence[Measured]) -> bool:
    """Whether rms |Δ log Z| between curves and sweeps is large against the noise."""
    noise = float(np.median(np.concatenate([one.relative_noise for one in measured])))
    return misfit > max(_POOR * noise, _LEAST_POOR)


def _one_of_each(measured: Sequence[Measured]) -> dict[str, Measured]:
    """The first sweep of every specimen that holds its fundamental, by name of the specimen."""
    leading: dict[str, Measured] = {}
    for one in measured:
        if one.holds_fundamental:
            leading.setdefault(one.piece.name, one)
    return leading


def _from_pole_zero(measured: list[Measured], full, bases: Bases):
    """rms |Δ log Z|, constants and histories of the pole-zero update; the constants as by `_fitted`."""
    state = pole_zero_update(measured, full, bases, start_constants(measured), COARSE_BASIS, _TOLERANCE)
    return (*_fitted(measured, full, bases, state.constants), state.histories)


def _fitted(measured: list[Measured], full, bases: Bases, start: PiezoConstants) -> tuple[float, PiezoConstants]:
    """rms |Δ log Z| and constants: those given, at the level of the curves, or of a fit from there where they are poor.

    The misfit of hardly stable constants that are far from where the fit began is not known (∞): no basis follows them.
    """
    problem = measured[0].problem

    def step(free: FreeConstants, models: Sequence[ExtendedModel]):
        misfit, theta = _fit_curves(measured, models, free)
        constants = free.constants(theta)
        if not is_hardly_stable(constants, problem.fitted):
            return (misfit, constants), constants
        trusted = np.all(np.abs(theta.real / free.start.real - 1) <= LEAVE)  # the basis followed them
        return (misfit if trusted else np.inf, constants), None

    return bases.following(measured, full, start, COARSE_BASIS, step)


def _fit_curves(
    measured: list[Measured], models: Sequence[ExtendedModel], free: FreeConstants
) -> tuple[float, np.ndarray]:
    """rms |Δ log Z| and free constants (n,) complex: those given, at the level of the curves; fitted where poor."""
    pairs = zip(models, measured, strict=True)
    sweeps = together([(Share(), Evaluation(model, one.fitted.omega)) for model, one in pairs])
    impedance = np.concatenate([one.fitted.impedance for one in measured])
    data = SweepData(
        frequency=np.concatenate([one.fitted.frequency for one in measured]),
        impedance=impedance,
        relative_noise=np.full(impedance.size, _NOISE),
        noise_known=False,
        sizes=tuple(len(one.fitted) for one in measured),
    )
    unknowns, x = Unknowns.of_constants(free)
    error = np.log(sweeps.impedance(unknowns, x) / impedance)
    if not _is_poor(rms(error), measured):
        return _at_level(free, error, measured)
    x, error = closest(sweeps, data, unknowns, [x])
    return rms(error), unknowns.material.theta(x)


def _at_level(free: FreeConstants, error: np.ndarray, measured: Sequence[Measured]) -> tuple[float, np.ndarray]:
    """rms |Δ log Z| and free constants (n,) complex, those given with ε33T, d31 and d33 by the level of the curves.

    Poles and zeros, and so log Z up to a constant, stay as they are where s is kept and d² changes as ε: Z ∝ 1/ε. The
    constant is the median of Re and Im of log Z_model − log Z (k,) over all points. The constants stay as given where
    ε33T, or the d that drives one of the sweeps, is held.
    """
    driving = [pair_names(one.problem.plate)[1:] for one in measured]
    if not all(names and {*names, "eps33T"} <= set(free.names) for names in driving):
        return rms(error), free.start
    level = complex(np.median(error.real), np.median(error.imag))
    power = np.array([_POWERS.get(name, 0.0) for name in free.names])
    return rms(error - level), free.start * np.exp(level * power)
