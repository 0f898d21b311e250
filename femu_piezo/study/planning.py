"""Which further measurement would tell causes apart: planned data by coarse models, ranked by expected separation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from femu_piezo.diagnosis.comparison import Comparison
from femu_piezo.diagnosis.next_measurement import Plan, Point, Remembered, Separation, separation, strength, summary
from femu_piezo.diagnosis.readings import readings
from femu_piezo.diagnosis.verdict import Verdict
from femu_piezo.effects.effect import Effect
from femu_piezo.effects.extended_model import ExtendedModel
from femu_piezo.errors import ConvergenceError, InputError
from femu_piezo.geometry.reshaping import reshapings
from femu_piezo.inference.ensemble import Ensemble, Share, is_common, with_default_owner, with_owner
from femu_piezo.inference.response import Evaluation
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.specimen.file import Specimen
from femu_piezo.study.model_cache import CLOSE, Bases
from femu_piezo.study.posterior import Posterior
from femu_piezo.study.problem import Problem, prepare
from femu_piezo.study.shapes import shape_of
from femu_piezo.study.starts import away_from_wall
from femu_piezo.study.subjects import Subject
from femu_piezo.study.unknowns import constants_found
from femu_piezo.threads import in_parallel

#: Planned ends of the band over the present one, and present noise over the planned one.
_WIDER, _QUIETER = (1.5,), 3.0
#: Error of mesh and basis that a plan may have, and points per sweep.
_ACCURACY, _POINTS = 3e-3, 250
#: Least separation, σ, of a plan that is recommended, and its least ratio to that by the present data.
_TELLS, _MORE = 3.0, 1.5
#: Most alternatives of a cause that are planned for, and most plans stated for each pair.
_ALTERNATIVES, _BEST = 3, 3
#: Name of a second specimen in a plan.
_SECOND = "the second"
#: Sweeps that the same set-up can take at once, in words.
OPPOSITE, THIRD = "sweep again in the opposite direction", "sweep again at a third of the voltage"


def separations(
    several: Sequence[Subject], posterior: Posterior, comparison: Comparison, verdict: Verdict
) -> tuple[Separation, ...]:
    """What further measurements would bring for every pair that is not told apart: best first for each pair.

    Pairs are a cause with what it is not told from, and an effect that the sweep cannot show with the constant that
    imitates it.
    """
    pairs = [*_named(comparison, verdict), *_hidden(comparison, verdict)]
    if not pairs:
        return ()
    effects = {effect.key: effect for pair in pairs for effect in (*pair.effects, *comparison.final.parameters.effects)}
    constants = constants_found(comparison.final.parameters, comparison.final.x)
    owner = several[0].measured.piece.name
    now = Plan("", Remembered(posterior.evaluation), comparison.base.data.relative_noise, owner)
    plans = [
        replace(
            now,
            words="average until the noise is a third of the present noise",
            relative_noise=now.relative_noise / _QUIETER,
        ),
        *_readings(now, several, tuple(effects.values())),
        *_sweeps(now, several, tuple(effects.values()), constants, posterior.bases),
    ]
    if len(several) == 1:
        plans += _again(now, several[0], posterior.models[0])
    asked = [(pair, plan) for pair in pairs for plan in (now, *plans) if plan is now or pair.concerns(plan)]
    sigmas = list(in_parallel(lambda item: item[0].sigma(item[1]), asked))
    found: list[Separation] = []
    for pair in pairs:
        (_, present), *own = [(plan, sigma) for (of, plan), sigma in zip(asked, sigmas, strict=True) if of is pair]
        told = [
            Separation(plan.words, pair.cause, pair.other, pair.usual, present, sigma)
            for plan, sigma in own
            if sigma >= max(_TELLS, _MORE * present)
        ]
        found += sorted(told, key=lambda one: -one.expected)[:_BEST]
    return tuple(found)


def recommended(verdict: Verdict, planned: Sequence[Separation]) -> tuple[str, ...]:
    """Measurements in words, each with what it would tell apart and by how many σ, best first.

    Plans for the named causes come first; the best one tells most pairs apart, of equals the one with the larger least
    separation. The advice of the library follows, for causes and hidden effects that no plan tells apart.
    """
    causes = {cause.effect.title for cause in verdict.causes}
    words = _ranked([one for one in planned if one.cause in causes])
    words += _ranked([one for one in planned if one.cause not in causes])
    told = {one.cause for one in planned}
    for cause in verdict.causes:
        if cause.effect.title not in told:
            words += cause.effect.advice if cause.indistinguishable_from else cause.effect.advice[:1]
    for form in verdict.forms:
        words += form.effect.advice
    for effect, constant in verdict.hidden:
        if effect.name != "wrong_insensitive_parameter" and effect.title not in told:
            words += [f"to distinguish {effect.title} from {constant}: {advice}" for advice in effect.advice[:2]]
    return tuple(dict.fromkeys(words))


def _ranked(planned: Sequence[Separation]) -> list[str]:
    groups = {words: [one for one in planned if one.measurement == words] for words in {p.measurement for p in planned}}
    best = sorted(groups.items(), key=lambda item: (-len(item[1]), -min(one.expected for one in item[1]), item[0]))
    return [summary(group) for _, group in best]


class _Pair:
    """Two causes, or an effect and a constant, that are not told apart."""

    def __init__(self, cause: Effect, first: Point, other: Effect | str, second: Point | None, size: float | None):
        """size : of the cause, SI; its usual size where None."""
        self.effects = [cause] if isinstance(other, str) else [cause, other]
        self.cause, self.other = cause.title, other if isinstance(other, str) else other.title
        self.usual = cause.parameters[0] if size is None else None
        self._first, self._second = first, second
        self._size = cause.parameters[0].usual if size is None else size
        self._index = first.parameters.index(cause.key)

    def sigma(self, plan: Plan) -> float:
        """Expected separation with a plan."""
        if self._second is None:
            return strength(plan, self._first, self._index, self._size)
        return separation(plan, self._first, self._second)

    def concerns(self, plan: Plan) -> bool:
        """Whether a plan has a reading that depends on one of the two, or sweeps by a model that includes both."""
        names = {effect.name for effect in self.effects}
        if plan.readings:
            return any(name in names for name, _ in plan.readings)
        points = [point for point in (self._first, self._second) if point is not None]
        known = [e for p in points for e in (*p.parameters.effects, *(e for e, _ in p.parameters.fixed))]
        return not (plan.new_sweeps and any(effect.local is not None for effect in known))


def _named(comparison: Comparison, verdict: Verdict) -> list[_Pair]:
    """Pairs of each named cause with what it is not told from."""
    final, pairs = comparison.final, []
    point = Point(final.parameters, final.x)
    for cause, found in zip(verdict.causes, comparison.causes, strict=True):
        for title in cause.indistinguishable_from[:_ALTERNATIVES]:
            others = [trial for trial in found.fits if trial.effect.title == title]
            if others:
                other = others[0]
                second = Point(other.fit.parameters, other.fit.x)
                pairs.append(_Pair(cause.effect, point, other.effect, second, 0.0))
            else:
                pairs.append(_Pair(cause.effect, point, title, None, float(cause.values[0])))
    return pairs


def _hidden(comparison: Comparison, verdict: Verdict) -> list[_Pair]:
    """Pairs of each effect that the sweep cannot show, of usual size, with the constant that imitates it."""
    base, known = comparison.base, {cause.effect.title for cause in verdict.causes}
    hidden: dict[str, tuple[Effect, str]] = {}
    for effect, constant in verdict.hidden:
        if effect.name != "wrong_insensitive_parameter" and effect.local is None and effect.title not in known:
            hidden.setdefault(effect.title, (effect, constant))
    every = base.parameters
    for effect, _ in hidden.values():
        if effect.acquisition is None:  # an acquisition evaluates Z several times, with all unknowns
            every = every.with_candidate(effect)
    with_all, pairs = Point(every, every.carried(base.parameters, base.x)), []
    for effect, constant in hidden.values():
        parameters = base.parameters.with_candidate(effect)
        x = parameters.carried(base.parameters, base.x)
        point = Point(parameters, x, with_all if effect.acquisition is None else None)
        pairs.append(_Pair(effect, point, constant, None, None))
    return pairs


def _readings(now: Plan, several: Sequence[Subject], effects: Sequence[Effect]) -> list[Plan]:
    owned = [with_default_owner(effect, now.owner) for effect in effects]
    contexts = {one.name or now.owner: one.context for one in several if not _was_weighed(one)}
    return [replace(now, words=words, readings=slopes) for words, slopes in readings(owned, contexts)]


def _was_weighed(one: Subject) -> bool:
    """Whether the `[readings]` of its file hold its mass."""
    table = one.problem.specimen.readings
    return table is not None and "mass" in table.given


def _sweeps(
    now: Plan, several: Sequence[Subject], effects: Sequence[Effect], constants: PiezoConstants, bases: Bases
) -> list[Plan]:
    """Wider bands, and for a single specimen a second one half as long; by models without effects at a place.

    Such effects need the other parity classes of the plate, which cost more than a recommendation is worth.
    """
    if any(effect.local is not None for one in several for effect, _ in one.fixed):
        return []
    effects = [effect for effect in effects if effect.local is None]
    highest = max(_WIDER)
    made = [
        partial(_coarse, bases, _ToSweep(one.problem, highest * one.measured.band_Hz), one, effects, constants)
        for one in several
    ]
    second_made = partial(_second_specimen, bases, several, effects, constants)
    *models, second = in_parallel(lambda make: make(), [*made, second_made])
    plans = []
    for factor in _WIDER:
        parts, noise = [], []
        for one, model in zip(several, models, strict=True):
            frequency = _thinned(one.measured.fitted.frequency)
            more = _beyond(frequency, factor)
            parts.append((_share(one, now.owner), Evaluation(model, 2 * np.pi * np.concatenate([frequency, more]))))
            noise.append(_noise(one, frequency.size + more.size))
        words = f"sweep up to {factor:g} times the present upper frequency"
        plans.append(Plan(words, Remembered(Ensemble(tuple(parts))), np.concatenate(noise), now.owner, new_sweeps=True))
    if second is not None:
        plans.append(_beside_the_first(now, several[0], models[0], second))
    return plans


def _again(now: Plan, one: Subject, model: ExtendedModel) -> list[Plan]:
    """The same sweep in the other direction, and at a third of the voltage, by the model of the diagnosis."""
    frequency, conditions = _thinned(one.measured.fitted.frequency), one.context.conditions
    part, noise = Evaluation(model, 2 * np.pi * frequency), np.tile(_noise(one, frequency.size), 2)
    ways = {
        OPPOSITE: replace(conditions, rising=not conditions.rising),
        THIRD: replace(conditions, drive=conditions.drive / 3),
    }
    plans = []
    for words, way in ways.items():
        other = replace(one, context=replace(one.context, conditions=way))
        parts = tuple((_share(sweep, now.owner), part) for sweep in (one, other))
        plans.append(Plan(words, Remembered(Ensemble(parts)), noise, now.owner))
    return plans


def _share(one: Subject, owner: str) -> Share:
    """The unknowns that concern a sweep of a plan; its specimen is named `owner` where it has no name."""
    forms = [with_default_owner(form, owner) for form in one.share.forms.values()]
    return Share((one.name or owner, one.fixture), {form.key: form for form in forms})


@dataclass(frozen=True)
class _Second:
    """A second specimen: its model, the name of the halved dimension, and effects for its uncertain sizes."""

    model: ExtendedModel
    halved: str
    sizes: tuple[Effect, ...]


def _second_specimen(
    bases: Bases, several: Sequence[Subject], effects: Sequence[Effect], constants: PiezoConstants
) -> _Second | None:
    """A specimen of the same material, half as long; None where it cannot be computed or there are several already."""
    one, geometry = several[0], several[0].problem.specimen.geometry
    dimension = next((name for name in ("length", "diameter") if getattr(geometry, name, None)), None)
    if dimension is None or len(several) > 1:
        return None
    try:
        problem = prepare(_halved(one.problem, dimension), check=False)
        common = [effect for effect in effects if is_common(effect)]
        sizes = [_measured_alike(effect, dimension, problem) for effect in one.library if effect.has_tolerance]
        sizes = [effect for effect in sizes if effect.resizes or effect.density is not None]
        model = _coarse(bases, _ToSweep(problem, 2 * one.measured.band_Hz), one, [*common, *sizes], constants)
    except (InputError, ConvergenceError):
        return None
    return _Second(model, dimension, tuple(sizes))


def _beside_the_first(now: Plan, one: Subject, model: ExtendedModel, second: _Second) -> Plan:
    """The plan that adds a sweep of the second specimen over the same modes, at twice the frequencies."""
    frequency = _thinned(one.measured.fitted.frequency)
    parts = (
        (_share(one, now.owner), Evaluation(model, 2 * np.pi * frequency)),
        (Share((_SECOND,)), Evaluation(second.model, 4 * np.pi * frequency)),
    )
    own = tuple(with_owner(effect, _SECOND) for effect in second.sizes)
    words = f"measure a second specimen of the same material with half the {second.halved}"
    noise = np.tile(_noise(one, frequency.size), 2)
    return Plan(words, Remembered(Ensemble(parts)), noise, now.owner, new_sweeps=True, tolerances=own)


def _measured_alike(effect: Effect, halved: str, second: Problem) -> Effect:
    """The tolerance of a size of the second specimen by the same tools: relatively twice as large if it is halved."""
    name = effect.name.removeprefix("wrong_")
    share = 2.0 if name == halved else 1.0
    known = tuple(replace(one, tolerance=share * one.tolerance) for one in effect.parameters)
    return replace(effect, parameters=known, reshaping=reshapings(second.plate).get(name)).within_tolerance


def _halved(problem: Problem, dimension: str) -> Specimen:
    """The specimen with half the length or diameter; its mass, where stated, goes with its volume."""
    specimen, geometry = problem.specimen, problem.specimen.geometry
    half = geometry.model_copy(update={dimension: getattr(geometry, dimension) / 2})
    if geometry.mass is not None:
        volume = shape_of(specimen.model_copy(update={"geometry": half})).volume
        half = half.model_copy(update={"mass": geometry.mass * volume / problem.plate.volume})
    return specimen.model_copy(update={"geometry": half})


@dataclass(frozen=True)
class _ToSweep:
    """A body, and the frequency up to which it is to be swept."""

    problem: Problem
    band_Hz: float


def _coarse(
    bases: Bases, body: _ToSweep, one: Subject, effects: Sequence[Effect], constants: PiezoConstants
) -> ExtendedModel:
    """A reduced model, exact enough for planning; around shared constants, it is trained for nearby ones as well."""
    of_model = [effect for effect in effects if one.share.has(effect)] + [effect for effect, _ in one.fixed]
    constants = away_from_wall(constants, body.problem.fitted)
    around = bases.around(body.problem, constants)
    training, free = [around], body.problem.free(around)
    if around is not constants:
        training += free.training_sets(free.start, CLOSE, 4)[1:]
    return bases.extended(bases.model(body, _ACCURACY), training, of_model, body, _ACCURACY)


def _thinned(frequency: np.ndarray) -> np.ndarray:
    """At most `_POINTS` of the frequencies."""
    return frequency[:: -(-frequency.size // _POINTS)]


def _beyond(frequency: np.ndarray, factor: float) -> np.ndarray:
    """At most `_POINTS` frequencies behind those of a sweep, up to `factor` times its end.

    They are as dense as those of the sweep where that many reach so far: not behind a sweep of a narrow band, or one
    with crowded points about its resonances.
    """
    end = frequency[-1]
    steps = int((factor - 1) * end / np.median(np.diff(frequency)))
    return np.linspace(end, factor * end, 1 + max(1, min(steps, _POINTS)))[1:]


def _noise(one: Subject, size: int) -> np.ndarray:
    """(size,) noise of a thinned sweep that tells as much as the present one with all its points."""
    dense = np.sqrt(-(-one.measured.fitted.frequency.size // _POINTS))
    return np.full(size, float(np.median(one.noise)) / dense)
