"""What a diagnosis means in words a designer understands: what is wrong, how sure, the constants, what to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from femu_piezo.diagnosis.averaging import LEVEL
from femu_piezo.diagnosis.verdict import Cause
from femu_piezo.effects.effect import title_of
from femu_piezo.effects.words import sizes
from femu_piezo.inference.fit import Fit
from femu_piezo.output.curves import PRINTED
from femu_piezo.output.tables import interval_text
from femu_piezo.output.wording import (
    alike_words,
    band,
    listed,
    merged,
    names_of,
    percent,
    plain,
    sentence_case,
    spoken,
    with_article,
)
from femu_piezo.study.diagnose import Diagnosis, LinearBody
from femu_piezo.units import signed

#: Shift of a constant, in standard deviations, above which it is reported.
_MOVED = 3.0
#: Probability from which a cause is told as very likely.
_VERY_LIKELY = 0.9
#: Errors of predictions over what noise causes of them up to which a model counts as right.
_AS_EXPECTED = 1.3
#: `Spread.wider` above which an interval is reported.
_WIDER = 1.5
#: Share of the swept band with a conspicuous misfit above which the misfit counts as spread over the whole sweep.
_WHOLE = 0.6
_POINTS = (
    "Sweep upwards, downwards and at a tenth of the voltage: the sweeps differ if the specimen drifts or its response "
    "is not linear. Use the original points if these were read from a picture or converted."
)
_HOLD = (
    "Measure again with the specimen held differently and in another fixture: residuals that change come from the "
    "holder or the fixture, residuals that stay come from the specimen."
)


@dataclass(frozen=True)
class Answer:
    """Sentences of page one: `headline`, one sentence for all, and four groups, each a tuple."""

    headline: str
    wrong: tuple[str, ...]
    sure: tuple[str, ...]
    constants: tuple[str, ...]
    measures: tuple[str, ...]


@dataclass(frozen=True)
class Shift:
    """How far a constant (or loss tangent) moved from the base to the final model.

    Attributes
    ----------
    sigma : in standard deviations of the final value
    percent : of the final value
    """

    name: str
    before: float
    after: float
    sigma: float
    percent: float


def shifts(result: Diagnosis) -> list[Shift]:
    """Every free constant and tangent, the most moved first."""
    before, after = result.before, result.after
    found = []
    for name, new in after.items():
        old = before[name]
        for label, base, final, std in (
            (name, old.value, new.value, new.std),
            (f"tan {name}", old.tan, new.tan, new.tan_std),
        ):
            found.append(Shift(label, base, final, abs(base - final) / std if std else 0.0, 100 * (base / final - 1)))
    return sorted(found, key=lambda shift: -shift.sigma)


@dataclass(frozen=True)
class Spread:
    """The interval of 95 % of a constant (or loss tangent), averaged over the sets of causes.

    Attributes
    ----------
    low, high : its ends, in the unit it is printed in
    wider : distance of the farther end from the value, over the half width of the interval by the named set alone
    cause : the other set of causes that contributes most to it, in words
    """

    name: str
    low: float
    high: float
    unit: str
    wider: float
    cause: str


def spreads(result: Diagnosis) -> list[Spread]:
    """Of every free constant and tangent, in falling order of `wider`."""
    comparison, reach, found = result.comparison, float(ndtri((1 + LEVEL) / 2)), []
    named_causes = tuple(cause.key for cause in comparison.final.parameters.causes)
    for number, (name, estimate) in enumerate(result.after.items()):
        parts = (
            (name, *PRINTED[name], estimate.interval, estimate.value, estimate.std),
            (f"tan {name}", 1.0, "", estimate.tan_interval, estimate.tan, estimate.tan_std),
        )
        for place, (label, factor, unit, (low, high), value, std) in enumerate(parts, start=2 * number):
            most = comparison.averaged.spread_by(place, value, named_causes, comparison.discrepant)
            wider = max(high - value, value - low) / (reach * std) if std else 0.0
            found.append(Spread(label, low * factor, high * factor, unit, wider, _other_set(most, named_causes)))
    return sorted(found, key=lambda spread: -spread.wider)


def _other_set(most: tuple[tuple[str, ...], bool] | None, named_causes: tuple[str, ...]) -> str:
    """The set of causes that `Averaged.spread_by` returns, in words: how it differs from the named causes."""
    if most is None:
        return "one of several other causes"
    causes, discrepant = most
    titles = [title_of(key) for key in named_causes]
    further = [title_of(key) for key in causes if key not in named_causes]
    if further:
        return listed([f"another law of {plain(title)}" if title in titles else plain(title) for title in further])
    missing = [plain(title_of(key)) for key in named_causes if key not in causes]
    if missing:
        return f"the absence of {listed(missing)}"
    return "an error that no cause describes" if discrepant else "the absence of an error that no cause describes"


def answer(result: Diagnosis) -> Answer:
    """The headline and the four groups of sentences of a diagnosis."""
    elsewhere = moved_by_others(result) if result.verdict.word != "unknown" else ()
    constants = (*_bias(result, bool(elsewhere)), *elsewhere)
    return Answer(_headline(result), _wrong(result), _sure(result), constants, _measures(result))


def _headline(result: Diagnosis) -> str:
    word = result.verdict.word
    if word == "none":
        return "The simulation explains this sweep within the noise: no further effect is needed."
    if word == "effect":
        likely = _likely(result.verdict.causes)
        words = f"{'causes' if len(likely) > 1 else 'cause'} of the misfit:"
        if _are_sure(likely):
            return f"{sentence_case(words)} {names_of(likely)}."
        each = [f"{names_of([one])} (probability {one.probability:.2f})" for one in likely]
        return f"Possible {words} {listed(each)}."
    if _points_to_blame(result):
        return "No linear body can have this response: the error is in the data, not in the simulation."
    words = "The simulation lacks something that no known effect explains"
    if result.verdict.causes:
        share = percent(result.verdict.unexplained)
        return f"{words}: with {names_of(result.verdict.causes)} in the model, {share} of the misfit remains."
    looks = _looks(result)
    return f"{words}; the misfit looks like {listed(looks)}." if looks else f"{words}."


def _likely(causes: Sequence[Cause]) -> list[Cause]:
    """The causes more probable than not, else the most probable one; `_sure` reports all with their probabilities."""
    found = [cause for cause in causes if cause.probability >= 0.5]
    return found or [max(causes, key=lambda cause: cause.probability)]


def _are_sure(causes: Sequence[Cause]) -> bool:
    """Whether every cause is very likely."""
    return all(cause.probability >= _VERY_LIKELY for cause in causes)


def _uncertain(result: Diagnosis) -> str:
    """What stands before the changes of constants where not all causes are certain."""
    one = len(result.verdict.causes) == 1
    which = "this cause, which is not certain" if one else "these causes, which are not all certain"
    return f"With {which}, constants change:"


def _looks(result: Diagnosis) -> list[str]:
    """Words for the part that no cause describes: forms of the verdict, then the discrepancy of the final fit."""
    discrepancy = result.comparison.final.discrepancy
    forms = [with_article(spoken(form.effect)) for form in result.verdict.forms]
    return forms if discrepancy is None else [*forms, str(discrepancy)]


def _wrong(result: Diagnosis) -> tuple[str, ...]:
    verdict, frequency = result.verdict, result.spectrum.frequency
    found = [_cause(cause) for cause in verdict.causes] if verdict.word == "effect" else []
    if verdict.word == "none":
        points = f"{len(result.spectrum)} points from {band(frequency[0], frequency[-1])}"
        found.append(f"With updated constants, the model follows the {points} as closely as the noise allows.")
    if verdict.word == "unknown":
        remaining = verdict.after if verdict.causes else verdict.before
        gap = 2 * float(np.max(np.diff(frequency)))
        where = [band(*one) for one in merged(remaining.worst_Hz[:4], gap)]
        whole = sum(high - low + gap / 2 for low, high in remaining.worst_Hz) > _WHOLE * (frequency[-1] - frequency[0])
        found.append(
            f"The {'remaining misfit' if verdict.causes else 'misfit of the base model'} is "
            f"{np.sqrt(remaining.size):.3g} times the noise (rms)"
            + (", spread over the whole sweep" if whole or not where else "")
            + (f", largest from {listed(where)}." if where else ".")
        )
        if _points_to_blame(result):
            found.append(_linear(result.linear_body))
        else:
            found += [_cause(form) for form in verdict.forms]
            found += _form(result.comparison.final)
            found += [
                f"The following cause may explain a part of the misfit. {_cause(cause)}" for cause in verdict.causes[:1]
            ]
            found += [_cause(cause) for cause in verdict.causes[1:]]
    found += _resonances(result)
    return tuple(found)


def _form(final: Fit) -> list[str]:
    """A sentence on the form of the discrepancy; none where the fit has none."""
    discrepancy = final.discrepancy
    if discrepancy is None:
        return []
    why = {
        "smooth": "the instrument, the fixture, or a wrong law of losses or of drift can cause it",
        "of every resonance": "a body that is not uniform, or that is held or loaded in places, can cause it",
        "a resonance of its own": "a loose part, a second piece or the fixture can cause it; a sweep of the fixture "
        "without the specimen shows whether the resonance is in the fixture",
        "a step": "a change of the instrument's range or a moving contact can cause it; sweep again in one range, or "
        "each side of the step separately",
    }
    return [f"The unexplained misfit looks like {discrepancy}: {why[discrepancy.form]}."]


def _points_to_blame(result: Diagnosis) -> bool:
    return result.linear_body is not None and result.linear_body.to_blame


def _linear(linear: LinearBody) -> str:
    """Sentences that no linear body explains the points."""
    count = "one resonance" if linear.resonances == 1 else f"{linear.resonances} resonances"
    return (
        f"The simulation is not the cause: even the best linear body with {count} in this band, whatever its shape, "
        f"constants and leads, misses the points by {linear.least:.3g} times the noise, and the simulation by "
        f"{linear.model:.3g} times. The points are in error: because of drift, a drive too high for a linear response, "
        "or their conversion to numbers."
    )


def _cause(cause: Cause) -> str:
    sentence = cause.effect.sentence
    size = sizes(cause.effect, cause.values, cause.std)
    return f"{spoken(cause.effect).capitalize()}: {sentence}; {size}."


def _resonances(result: Diagnosis) -> list[str]:
    """Sentences on measured and simulated resonances without partner in the final model."""
    (unexplained, extra), found = result.without_partner, []
    for kind, resonances, words in (
        ("measured", unexplained, "the simulation does not have"),
        ("simulated", extra, "the measurement does not show"),
    ):
        if resonances:
            places = listed([f"{r.frequency_Hz / 1e3:.5g} kHz ({r.kind})" for r in resonances[:4]])
            found.append(f"There are {kind} resonances that {words}: {places}.")
    return found


def _sure(result: Diagnosis) -> tuple[str, ...]:
    verdict, gain, known = result.verdict, result.gain, result.comparison.base.data.noise_known
    found = []
    for cause in () if _points_to_blame(result) else verdict.causes:
        found.append(f"{spoken(cause.effect).capitalize()} is {_certainty(cause.probability)}.")
        if cause.indistinguishable_from:
            found += [f"But {plain(words)}." for words in alike_words(cause.indistinguishable_from)]
    unseen = "the held-out band" if not np.all(result.fitted) else "bands left out of the fit one by one"
    before, after, floor = (percent(gain[key]) for key in ("held_out_before", "held_out_after", "noise_floor"))
    if verdict.extension:
        found.append(
            f"On data that the fit did not use ({unseen}), the rms error {_moves(gain)} from {before} to {after}, "
            f"{gain['over_expected']:.3g} times the error that noise causes in predictions of a correct model"
            f"{_grown(gain)}; the noise is {floor}."
        )
    else:
        found.append(f"On data that the fit did not use ({unseen}), the rms error is {before}; the noise is {floor}.")
    if not verdict.causes:
        found.append(_best_candidate(result))
    if not known:
        found.append("The noise was not given with the data; it was estimated from the sweep itself.")
    return tuple(found)


def _moves(gain: dict[str, float]) -> str:
    return "falls" if gain["held_out_after"] < gain["held_out_before"] else "rises"


def _grown(gain: dict[str, float]) -> str:
    """Why the error of predictions rises where the model is right."""
    if gain["held_out_after"] < gain["held_out_before"] or gain["over_expected"] > _AS_EXPECTED:
        return ""
    return ": with the cause more is unknown, and so less well predicted"


def _certainty(probability: float) -> str:
    words = (
        (0.99, "practically certain"),
        (_VERY_LIKELY, "very likely"),
        (0.6, "likely"),
        (0.0, "no more than a guess"),
    )
    word = next(word for least, word in words if probability >= least)
    figure = f"{probability:.3f}"
    if not 0.001 <= probability <= 0.999:
        figure = "above 0.999" if probability > 0.5 else "below 0.001"
    return f"{word} (probability {figure}, compared with all other candidates and with no cause)"


def _best_candidate(result: Diagnosis) -> str:
    """A sentence on the most probable candidate: its log odds, and why it was not named."""
    candidates = [trial for trial in result.comparison.singles if not trial.effect.of_unknown]
    tried = [trial for trial in candidates if trial.fit is not None]
    if not tried:
        return "No candidate effect could be tried."
    best = max(tried, key=lambda trial: trial.log_odds)
    if best.log_odds <= 0:
        reason = "is less probable than no effect"
    elif result.verdict.forms:
        reason = f"explains less than {names_of(result.verdict.forms)} does"
    else:
        reason = (
            "is more probable than no effect, but within a few of its standard deviations (or its tolerance) of zero"
        )
    return (
        f"{len(candidates)} candidate effects were tried; the most probable of them, {spoken(best.effect)}, "
        f"{reason}: its log odds against no effect are {signed(best.log_odds, '.1f')}."
    )


def _bias(result: Diagnosis, elsewhere: bool) -> tuple[str, ...]:
    if _points_to_blame(result):
        return ("The constants have an error of unknown size, since they were fitted to points that are in error.",)
    if not result.verdict.causes:
        if result.verdict.word == "none":
            unless = ", unless there is a cause that this sweep cannot show" * bool(elsewhere or result.verdict.hidden)
            return (f"No bias was found: the updated constants hold within their standard deviations{unless}.",)
        if result.verdict.forms:
            forms = listed([with_article(spoken(form.effect)) for form in result.verdict.forms])
            return (
                f"The constants were fitted together with {forms}, whose cause is unknown; their standard deviations "
                "hold as far as this describes the specimen.",
            )
        return ("The constants have an error of unknown size, since they compensate in part for the missing effect.",)
    if result.verdict.word == "unknown":
        return (
            f"The constants differ with {names_of(result.verdict.causes)} in the model, but neither set is reliable "
            "while the rest of the misfit is unexplained.",
        )
    moved = [shift for shift in shifts(result) if shift.sigma > _MOVED]
    if not moved:
        return (f"No constant changed by more than {_MOVED:.0f} of its standard deviations.",)
    found = [] if _are_sure(result.verdict.causes) else [_uncertain(result)]
    for shift in moved[:4]:
        name = shift.name.removeprefix("tan ")
        factor, unit = PRINTED[name] if shift.name == name else (1.0, "")
        found.append(
            f"{shift.name} had come out {_two_digits(abs(shift.percent))} % too "
            f"{'large' if shift.percent > 0 else 'small'}: {shift.before * factor:.5g} in place of "
            f"{shift.after * factor:.5g}{' ' if unit else ''}{unit} ({shift.sigma:.2g} standard deviations)."
        )
    if len(moved) > 4:
        found.append(f"{len(moved) - 4} more changed by more than {_MOVED:.0f} standard deviations; see the table.")
    return tuple(found)


def _two_digits(size: float) -> str:
    """A positive number to two digits, without an exponent where it is large."""
    return f"{size:.2g}" if size < 100 else f"{size:.0f}"


def moved_by_others(result: Diagnosis) -> tuple[str, ...]:
    """Sentences on constants whose deviation is too small if a cause acts that the sweep does not exclude."""
    by_cause: dict[str, list[Spread]] = {}
    for spread in spreads(result):
        if spread.wider > _WIDER:
            by_cause.setdefault(spread.cause, []).append(spread)
    found = []
    for cause, moved in by_cause.items():
        ends = [
            f"{spread.name} lies within {interval_text(spread.low, spread.high)}"
            f"{' ' if spread.unit else ''}{spread.unit}"
            for spread in moved
        ]
        each, them = ("each with", "them") if len(moved) > 1 else ("with", "it")
        times = _two_digits(moved[0].wider)
        found.append(
            f"Averaged over all causes by their probability, {listed(ends)}, {each} a probability of 95 %, up to "
            f"{times} times as far from the fitted value as the standard deviation implies: {cause}, which this sweep "
            f"does not exclude, would change {them}."
        )
    return tuple(found)


def _measures(result: Diagnosis) -> tuple[str, ...]:
    word = result.verdict.word
    if word == "none":
        first = "Use the constants."
        if result.verdict.hidden:
            first = "Use the constants if none of the effects is there that this sweep cannot show, listed below."
    elif word == "effect":
        several = len(result.verdict.causes) > 1
        these, right = ("these causes", "they are right") if several else ("this cause", "it is right")
        file = f"extended.toml, the specimen file with {these} and the corrected constants"
        first = f"Continue with {file}: simulate, update and diagnose accept it like any other."
        if not _are_sure(result.verdict.causes):
            first = f"Confirm {these} before using the constants: {file}, holds only if {right}."
    else:
        first = "Do not rely on the constants before the cause is known; look at the residual where it is largest."
        if _points_to_blame(result):
            return first, _POINTS
        if not result.verdict.extension:
            return first, _HOLD
    remedies = [cause.effect.advice[0] for cause in result.verdict.extension if cause.effect.advice]
    advice = list(dict.fromkeys([*remedies, *result.verdict.measurements]))[:3]
    return (first, *(f"{sentence_case(words)}.".replace("_", " ") for words in advice))
