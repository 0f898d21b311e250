"""Candidates on top of a fit: which are worth a fit, from where to start, and how closely to fit.

Most candidates are far from explaining a sweep, and a rough fit says so. Only contenders are fitted closely and from
further starts. On top of a fit that leaves little, linearisation tells beforehand which candidates gain nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from femu_piezo.diagnosis.effect import Effect
from femu_piezo.diagnosis.evaluation import Evaluation
from femu_piezo.diagnosis.fitting import JointFit, SweepData, fit_joint, linear_step
from femu_piezo.diagnosis.joint import JointParameters
from femu_piezo.errors import ConvergenceError

#: A rough fit whose χ² is within this factor of the best one's, or within so much of it, makes a contender.
_FACTOR, _WITHIN = 4.0, 60.0
#: Gain in χ² by linearisation below which a further effect is not fitted; none is accepted or alike below it.
_LEAST_GAIN = 4.0
#: A rough fit this near to what linearisation promised has found the minimum there is.
_AS_PROMISED = 1.0
#: Size, over its scale, at which a parameter starts "at rest": there every slope exists.
_REST = 1e-3

Trials = tuple[tuple[Effect, JointFit | None], ...]


@dataclass(frozen=True)
class _Start:
    """Where a fit with a candidate may begin.

    Attributes
    ----------
    promised : χ² that linearisation there promises, places of the effect held
    step : (n,) Gauss-Newton step of the effect's own unknowns
    """

    x: np.ndarray
    promised: float
    step: np.ndarray


def try_all(
    evaluation: Evaluation,
    data: SweepData,
    current: JointFit,
    candidates: Sequence[Effect],
    *,
    only_gaining: bool = False,
    progress: Callable[[str], None] = lambda step: None,
) -> Trials:
    """The current fit with each candidate added, all unknowns refitted; None where a fit did not settle.

    Parameters
    ----------
    only_gaining : leave out candidates that by linearisation gain next to nothing
    progress : called with the key of each candidate
    """
    rough: list[tuple[Effect, list[_Start], JointFit | None]] = []
    for effect in candidates:
        progress(effect.key)
        parameters = current.parameters.with_effect(effect)
        starts = _starts(evaluation, data, current, effect, parameters)
        if only_gaining and current.chi_square - starts[0].promised < _LEAST_GAIN:
            continue
        rough.append((effect, starts, _fitted(evaluation, data, parameters, [starts[0].x], coarse=True)))
    best = min((fit.chi_square for _, _, fit in rough if fit is not None), default=np.inf)
    found: list[tuple[Effect, JointFit | None]] = []
    for effect, starts, fit in rough:
        if fit is None or fit.chi_square <= max(_FACTOR * best, best + _WITHIN):
            progress(effect.key)
            fit = _closely(evaluation, data, current.parameters.with_effect(effect), starts, fit)
        found.append((effect, fit))
    return tuple(found)


def try_one(evaluation: Evaluation, data: SweepData, current: JointFit, effect: Effect) -> JointFit | None:
    """The current fit with one more effect, fitted closely."""
    return try_all(evaluation, data, current, [effect])[0][1]


def listed_values(effect: Effect) -> list[np.ndarray]:
    """Values (n,) of an effect's parameters that its `starts` list, every combination; none where it lists none."""
    if not any(parameter.starts for parameter in effect.parameters):
        return []
    choices = [p.starts or (p.rest + _REST * p.scale,) for p in effect.parameters]
    return [np.array(values, dtype=float) for values in product(*choices)]


def _starts(evaluation, data, current: JointFit, effect: Effect, parameters: JointParameters) -> list[_Start]:
    """At rest and as listed, the constants as they are; the most promising first."""
    own = parameters.columns(len(parameters.effects) - 1)
    places = [i for i, p in enumerate(effect.parameters) if p.starts] if len(effect.parameters) > 1 else []
    moving = np.delete(np.arange(parameters.count), [own.start + place for place in places])
    found = []
    for values in (effect.rest + _REST * effect.scale, *listed_values(effect)):
        x = np.concatenate([current.x, values / effect.scale])
        step, promised = linear_step(evaluation, data, parameters, x, moving)
        found.append(_Start(x, promised, step[own]))
    return sorted(found, key=lambda start: start.promised)


def _closely(evaluation, data, parameters: JointParameters, starts: list[_Start], rough: JointFit | None):
    """A close fit from the rough one and, where more was promised than it holds, from further starts."""
    reached = np.inf if rough is None else rough.chi_square
    further = [] if rough is None else [rough.x]
    if abs(reached - starts[0].promised) > _AS_PROMISED:
        further.append(_alone(parameters, starts[0]))
    further += [start.x for start in starts[1:] if start.promised < reached - _AS_PROMISED]
    return _fitted(evaluation, data, parameters, further or [starts[0].x])


def _alone(parameters: JointParameters, start: _Start) -> np.ndarray:
    """The start with the effect's own step alone, within the inner half of its range."""
    own = parameters.columns(len(parameters.effects) - 1)
    low, high = parameters.bounds[own].T / 2
    return np.concatenate([start.x[: own.start], np.clip(start.x[own] + start.step, low, high)])


def _fitted(evaluation, data, parameters: JointParameters, starts, *, coarse: bool = False) -> JointFit | None:
    try:
        return fit_joint(evaluation, data, parameters, starts, coarse=coarse)
    except (ConvergenceError, np.linalg.LinAlgError):
        return None
