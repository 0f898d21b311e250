"""What a diagnosis means in words a designer understands: what is wrong, how sure, the constants, what to do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femu_piezo.diagnosis.effect import Effect, EffectParameter
from femu_piezo.diagnosis.verdict import Cause
from femu_piezo.output.curves import PRINTED
from femu_piezo.output.tables import number
from femu_piezo.study.diagnose import Diagnosis

_SHARES = {"relative_error", "fall_per_decade"}  # pure numbers that are read as per cent
_UNITS = {"ohm": ("Ω", 1.0), "kg": ("g", 1e3), "kg/m^2": ("g/m²", 1e3), "1": ("", 1.0)}
_PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
#: Shift of a constant, in standard deviations, that is told.
_MOVED = 3.0
#: Share of the sweep that stands out from which a misfit is all over it.
_WHOLE = 0.6
_HOLD = (
    "Measure again with the specimen held differently and in another fixture: what moves belongs to the holder or the "
    "fixture, what stays to the specimen."
)


@dataclass(frozen=True)
class Answer:
    """Sentences of page one, each group a tuple; `headline` is the shortest form of all."""

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


def spoken(effect: Effect) -> str:
    """The name of a cause in plain words."""
    law = f" ({effect.law} law)" if effect.law else ""
    return effect.title.replace("_", " ").replace(":", " ") + law


def listed(words: list[str] | tuple[str, ...], last: str = "and") -> str:
    """a, b and c."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}"


def quantity(parameter: EffectParameter, value: float, std: float | None) -> str:
    """A parameter of an effect with its deviation, in a readable unit."""
    if parameter.unit == "1" and (parameter.name in _SHARES or parameter.name in PRINTED):
        return f"{number(100 * value, None if std is None else 100 * std)} %"
    unit, factor = _UNITS.get(parameter.unit, (parameter.unit.replace("^2", "²"), 1.0))
    if unit:
        size = factor * max(abs(value), std or 0.0)
        power = int(np.clip(3 * np.floor(np.log10(size) / 3), -12, 9)) if size > 0 else 0
        unit, factor = _PREFIXES[power] + unit, factor * 10.0**-power
    text = number(factor * value, None if std is None else factor * std)
    return f"({text}) {unit}" if unit and "±" in text else f"{text} {unit}".strip()


def sizes(effect: Effect, values: np.ndarray, std: np.ndarray) -> str:
    """All parameters of an effect with their names."""
    found = zip(effect.parameters, values, std, strict=True)
    return ", ".join(f"{p.name.replace('_', ' ')} {quantity(p, float(v), float(s))}" for p, v, s in found)


def percent(share: float) -> str:
    """A share in per cent with three digits."""
    return f"{100 * share:.3g} %"


def band(low: float, high: float) -> str:
    """A band of frequencies, Hz, in kHz or MHz."""
    factor, unit = (1e-6, "MHz") if high >= 2e6 else (1e-3, "kHz")
    return f"{low * factor:.5g} to {high * factor:.5g} {unit}"


def merged(bands: tuple[tuple[float, float], ...], gap: float) -> list[tuple[float, float]]:
    """Bands in order of frequency, those less than a gap (Hz) apart joined."""
    found: list[tuple[float, float]] = []
    for low, high in sorted(bands):
        if found and low - found[-1][1] < gap:
            found[-1] = (found[-1][0], max(high, found[-1][1]))
        else:
            found.append((low, high))
    return found


def shifts(result: Diagnosis) -> list[Shift]:
    """Every free constant and tangent, the most moved first."""
    before, after = (result.constants(fit) for fit in (result.comparison.base, result.comparison.final))
    found = []
    for name, new in after.items():
        old = before[name]
        for label, one, other, std in (
            (name, old.value, new.value, new.std),
            (f"tan {name}", old.tan, new.tan, new.tan_std),
        ):
            found.append(Shift(label, one, other, abs(one - other) / std if std else 0.0, 100 * (one / other - 1)))
    return sorted(found, key=lambda shift: -shift.sigma)


def answer(result: Diagnosis) -> Answer:
    """The four answers."""
    return Answer(_headline(result), _wrong(result), _sure(result), _bias(result), _measures(result))


def _names(result: Diagnosis) -> str:
    return listed([spoken(cause.effect) for cause in result.verdict.causes])


def _headline(result: Diagnosis) -> str:
    word = result.verdict.word
    if word == "none":
        return "The simulation explains this sweep: nothing beyond noise is left over, no effect is needed."
    many = len(result.verdict.causes) > 1
    if word == "effect":
        return f"The misfit has {'named causes' if many else 'a named cause'}: {_names(result)}."
    if result.verdict.causes:
        return f"{_names(result).capitalize()} explain{'' if many else 's'} a part of the misfit; the rest has no name."
    return "The simulation misses something that no known effect explains."


def _wrong(result: Diagnosis) -> tuple[str, ...]:
    verdict, frequency = result.verdict, result.spectrum.frequency
    found = [_cause(cause) for cause in verdict.causes]
    if verdict.word == "none":
        points = f"{len(result.spectrum)} points from {band(frequency[0], frequency[-1])}"
        found.append(f"With its constants updated the model follows the {points} as closely as the noise allows.")
    if verdict.word == "unknown":
        left = verdict.after if verdict.causes else verdict.before
        gap = 2 * float(np.max(np.diff(frequency)))
        where = [band(*one) for one in merged(left.worst_Hz[:4], gap)]
        whole = sum(high - low + gap / 2 for low, high in left.worst_Hz) > _WHOLE * (frequency[-1] - frequency[0])
        found.append(
            f"What is left over is {np.sqrt(left.size):.3g} times the noise"
            + (", spread over the whole sweep" if whole or not where else "")
            + (f", most of it from {listed(where)}." if where else ".")
        )
        if verdict.causes:
            share = percent(verdict.unexplained)
            found.append(f"Of the misfit beyond noise {share} stays: the name above is not the whole answer.")
    found += _resonances(result)
    return tuple(found)


def _cause(cause: Cause) -> str:
    sentence = cause.effect.sentence
    size = sizes(cause.effect, cause.values, cause.std)
    return f"{spoken(cause.effect).capitalize()}: {sentence}; {size}."


def _resonances(result: Diagnosis) -> list[str]:
    """Resonances of the final model without partner."""
    final, found = result.pole_zero[1], []
    for kind, resonances, words in (
        ("measured", final.unexplained, "the simulation does not have"),
        ("simulated", final.extra, "the measurement does not show"),
    ):
        if resonances:
            places = listed([f"{r.frequency_Hz / 1e3:.5g} kHz ({r.kind})" for r in resonances[:4]])
            found.append(f"There are {kind} resonances that {words}: {places}.")
    return found


def _sure(result: Diagnosis) -> tuple[str, ...]:
    verdict, gain, known = result.verdict, result.gain, result.comparison.base.data.noise_known
    found = []
    for cause in verdict.causes:
        found.append(f"{spoken(cause.effect).capitalize()} is {_certainty(cause.probability)}.")
        if cause.indistinguishable_from:
            others = listed([name.replace("_", " ") for name in cause.indistinguishable_from], "or")
            found.append(f"But this sweep cannot tell it from {others}: the true cause may as well be one of these.")
    unseen = "the held-out band" if not np.all(result.fitted) else "bands left out of the fit one by one"
    before, after, floor = (percent(gain[key]) for key in ("held_out_before", "held_out_after", "noise_floor"))
    if verdict.causes:
        found.append(
            f"The test on data that no fit saw ({unseen}): the error {_moves(gain)} from {before} to {after}; the "
            f"noise is {floor}."
        )
    else:
        found.append(f"On data that no fit saw ({unseen}) the model errs by {before}; the noise is {floor}.")
        found.append(_best_candidate(result))
    if not known:
        found.append("The noise was not given with the data; it was estimated from the roughness of the sweep itself.")
    return tuple(found)


def _moves(gain: dict[str, float]) -> str:
    return "falls" if gain["held_out_after"] < gain["held_out_before"] else "rises"


def _certainty(probability: float) -> str:
    words = ((0.99, "practically certain"), (0.9, "very likely"), (0.6, "likely"), (0.0, "no more than a guess"))
    word = next(word for least, word in words if probability >= least)
    figure = f"{probability:.3f}"
    if not 0.001 <= probability <= 0.999:
        figure = "above 0.999" if probability > 0.5 else "below 0.001"
    return f"{word} (probability {figure} against all other candidates and none)"


def _best_candidate(result: Diagnosis) -> str:
    """What the candidate of most evidence gains, and why it was not accepted."""
    base = result.comparison.base
    tried = [(base.bic - fit.bic, effect, fit) for effect, fit in result.comparison.singles if fit is not None]
    gained, best, fit = max(tried, key=lambda item: item[0])
    if gained <= 0:
        reason = "costs more than it gains: its evidence is"
    elif fit.held_out_score >= base.held_out_score:
        old, new = (f"{score:.3g} σ" for score in (base.held_out_score, fit.held_out_score))
        reason = f"fits better but predicts bands left out of the fit no better ({new} against {old}): its evidence is"
    else:
        reason = "gains less evidence than its price:"
    count = len(result.comparison.singles)
    return f"{count} candidate effects were tried; the best of them, {spoken(best)}, {reason} {gained:+.1f}."


def _bias(result: Diagnosis) -> tuple[str, ...]:
    if not result.verdict.causes:
        if result.verdict.word == "none":
            return ("No bias was found: the updated constants stand, within their standard deviations.",)
        return ("They carry an error of unknown size: what is missing in the model has gone into them as well.",)
    if result.verdict.word == "unknown":
        return ("They move with what is named, but neither set is safe while the rest of the misfit has no name.",)
    moved = [shift for shift in shifts(result) if shift.sigma > _MOVED]
    if not moved:
        return (f"None of them moved by more than {_MOVED:.0f} of its standard deviations.",)
    found = []
    for shift in moved[:4]:
        name = shift.name.removeprefix("tan ")
        factor, unit = PRINTED[name] if shift.name == name else (1.0, "")
        found.append(
            f"{shift.name} had come out {abs(shift.percent):.2g} % too "
            f"{'large' if shift.percent > 0 else 'small'}: {shift.before * factor:.5g} in place of "
            f"{shift.after * factor:.5g}{' ' if unit else ''}{unit} ({shift.sigma:.2g} standard deviations)."
        )
    if len(moved) > 4:
        found.append(f"{len(moved) - 4} more moved by more than {_MOVED:.0f} standard deviations; see the table.")
    return tuple(found)


def _measures(result: Diagnosis) -> tuple[str, ...]:
    word = result.verdict.word
    if word == "none":
        first = "Use the constants. What this sweep cannot show is listed below."
    elif word == "effect":
        first = (
            "Go on with extended.toml: it is the specimen with this effect and the corrected constants, and it "
            "simulates, updates and diagnoses like any other."
        )
    else:
        first = "Do not rely on the constants before the cause is known; look at the residual where it is largest."
        if not result.verdict.causes:
            return first, _HOLD
    advice = [f"{words[0].upper()}{words[1:]}." for words in result.verdict.measurements[:3]]
    return (first, *advice)
