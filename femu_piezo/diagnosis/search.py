"""Candidates on top of a fit, one by one and two at once: which are worth a fit, and how closely to fit.

Most candidates are far from explaining a sweep, and a rough fit says so: only contenders are fitted closely and from
further starts. Where linearisation promises next to nothing, the linearised fit stands for the candidate.

Two causes that act together may each explain little by itself, and then the best single one is neither of them. So
pairs are tried as pairs; those without a place, whose slopes say in a moment what any two of them promise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import combinations

import numpy as np

from femu_piezo.diagnosis.starts import Start, start_together, starts
from femu_piezo.effects.effect import Effect
from femu_piezo.errors import ConvergenceError
from femu_piezo.inference.fit import JointFit, SweepData, fit_joint
from femu_piezo.inference.joint import JointParameters
from femu_piezo.inference.response import Evaluation
from femu_piezo.threads import in_parallel

#: A rough fit makes a contender where its χ² is within so much of the best one's, and so often the excess of that.
_WITHIN, _FACTOR = 60.0, 3.0
#: Gain in χ² by linearisation below which a candidate is not fitted; none is accepted or alike below it.
_LEAST_GAIN = 4.0
#: Most pairs that are fitted roughly, and closely.
_ROUGH_PAIRS, _CLOSE_PAIRS = 40, 4
#: A rough fit this near to what linearisation promised has found the minimum there is.
_AS_PROMISED = 1.0

Trials = tuple[tuple[Effect, JointFit | None], ...]


def try_all(
    evaluation: Evaluation,
    data: SweepData,
    current: JointFit,
    candidates: Sequence[Effect],
    progress: Callable[[str], None] = lambda step: None,
) -> Trials:
    """The current fit with each candidate added, all unknowns refitted; None where a fit did not settle.

    progress : called with the key of each candidate
    """

    def roughly(effect: Effect) -> tuple[list[Start], JointFit | None]:
        places = starts(evaluation, data, current, effect)
        if current.chi_square - places[0].promised < _LEAST_GAIN:
            return [], places[0].linear
        rough = places if effect.sites is not None else places[:1]  # one wrong place says nothing of the others
        return places, _fitted(evaluation, data, places[0].linear.parameters, [p.x for p in rough], coarse=True)

    def closely(trial: tuple[list[Start], JointFit | None]) -> JointFit | None:
        places, rough = trial
        if places and (rough is None or _contends(rough, best, current, places[0])):
            return _closely(evaluation, data, places, rough)
        return rough

    keys = [effect.key for effect in candidates]
    trials = list(_told(in_parallel(roughly, candidates), keys, progress))
    best = min((fit.chi_square for _, fit in trials if fit is not None), default=np.inf)
    found = _told(in_parallel(closely, trials), keys, progress)
    return tuple(zip(candidates, found, strict=True))


def _told(results: Iterator, names: Sequence[str], progress: Callable[[str], None]) -> Iterator:
    """The results; each time the one that is waited for is named."""
    for name in names:
        progress(name)
        yield next(results)


def best_pair(
    evaluation: Evaluation,
    data: SweepData,
    current: JointFit,
    candidates: Sequence[Effect],
    progress: Callable[[str], None] = lambda step: None,
) -> JointFit | None:
    """The current fit with those two candidates added that do best together; None where none did better.

    Candidates at a place are left out. Better is a fit that also predicts bands not seen better than the current one.

    progress : called with the keys of each pair
    """
    smooth = [effect for effect in candidates if effect.sites is None]
    alone = [start for own in in_parallel(lambda e: starts(evaluation, data, current, e), smooth) for start in own]
    promised: dict[str, Start] = {}
    for two in combinations(alone, 2):
        if _differ(two):
            start = start_together(data, current, *two)
            keys = " and ".join(effect.key for effect in start.linear.parameters.effects[-2:])
            promised[keys] = min(promised.get(keys, start), start, key=lambda one: one.promised)
    most_promising = sorted(promised.items(), key=lambda item: item[1].promised)[:_ROUGH_PAIRS]
    reach = _reach(most_promising[0][1].promised, current) if most_promising else 0.0

    def roughly(start: Start) -> JointFit | None:
        return _fitted(evaluation, data, start.linear.parameters, [start.x, start.alone()], coarse=True)

    worth = {keys: start for keys, start in most_promising if start.promised <= reach}
    fits = _told(in_parallel(roughly, worth.values()), list(worth), progress)
    rough = sorted((fit for fit in fits if fit is not None), key=lambda fit: fit.bic)
    close = in_parallel(lambda fit: _fitted(evaluation, data, fit.parameters, [fit.x]), rough[:_CLOSE_PAIRS])
    sound = [fit for fit in close if fit is not None and fit.held_out_score < current.held_out_score]
    return min(sound, key=lambda fit: fit.bic, default=None)


def _differ(two: tuple[Start, Start]) -> bool:
    """Whether two starts are about two causes, not two laws of one."""
    first, second = (start.linear.parameters.effects[-1] for start in two)
    return first.title != second.title


def _reach(best: float, current: JointFit) -> float:
    """χ² up to which a rough figure may belong to the best fit, if the best such figure is this."""
    return best + _WITHIN + _FACTOR * max(0.0, best - current.freedom)


def _contends(rough: JointFit, best: float, current: JointFit, start: Start) -> bool:
    """Whether a close fit may change what is named: near the best, and with evidence for it, had or promised."""
    return rough.chi_square <= _reach(best, rough) and min(rough.bic, start.linear.bic) < current.bic


def _closely(evaluation, data, places: list[Start], rough: JointFit | None) -> JointFit | None:
    """A close fit from the rough one and, where more was promised than it holds, from further starts."""
    reached = np.inf if rough is None else rough.chi_square
    further = [] if rough is None else [rough.x]
    if abs(reached - places[0].promised) > _AS_PROMISED:
        further.append(places[0].alone())
    further += [start.x for start in places[1:] if start.promised < reached - _AS_PROMISED]
    return _fitted(evaluation, data, places[0].linear.parameters, further or [places[0].x])


def _fitted(evaluation, data, parameters: JointParameters, places, *, coarse: bool = False) -> JointFit | None:
    try:
        return fit_joint(evaluation, data, parameters, places, coarse=coarse)
    except (ConvergenceError, np.linalg.LinAlgError):
        return None
