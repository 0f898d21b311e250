"""The steps of a job: each turns specimens into columns of the table and a full record.

A new step is one function here and its name in `STEPS`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from femu_piezo.batch.table import NOTES_APART
from femu_piezo.effects.words import sizes
from femu_piezo.errors import InputError
from femu_piezo.files import as_json
from femu_piezo.output.records import update_record
from femu_piezo.specimen.file import Specimen
from femu_piezo.study.model_cache import Bases
from femu_piezo.study.results import UpdateResult
from femu_piezo.study.update import update

if TYPE_CHECKING:
    from femu_piezo.study.diagnose import Diagnosis

Value = float | int | str | None
#: Specimens of one job, and where bases come from → columns of the table, record in JSON types.
Step = Callable[[list[Specimen], Bases], tuple[dict[str, Value], dict]]


def _update(specimens: list[Specimen], bases: Bases) -> tuple[dict[str, Value], dict]:
    result = update(specimens, bases=bases)
    return update_columns(result), as_json(update_record(result))


def update_columns(result: UpdateResult) -> dict[str, Value]:
    """The constants with their standard deviations (SI), the fundamental of the first specimen, the misfit."""
    first = result.outcomes[0]
    columns: dict[str, Value] = {}
    for name, estimate in result.parameters.items():
        columns |= {name: estimate.value, f"{name}_std": estimate.std}
        columns |= {f"{name}_tan": estimate.tan, f"{name}_tan_std": estimate.tan_std}
        columns |= {f"{name}_std_from": estimate.largest_part}
    pair = first.measured.pair
    columns |= {"pole_Hz": pair.pole.frequency_Hz, "pole_loss": pair.pole.loss}
    columns |= {"zero_Hz": pair.zero.frequency_Hz, "zero_loss": pair.zero.loss, "k_eff": pair.k_eff}
    columns |= {"rms_log_error": first.rms_after, "iterations": result.iterations, "method": result.method}
    columns["doubt"] = NOTES_APART.join(result.doubts) or None
    columns["notes"] = NOTES_APART.join(result.notes)
    return as_json(columns)


def _diagnose(specimens: list[Specimen], bases: Bases) -> tuple[dict[str, Value], dict]:
    """The verdict and its causes, of a job with one specimen."""
    from femu_piezo.output.diagnosis import diagnosis_record
    from femu_piezo.study.diagnose import diagnose

    if len(specimens) > 1:
        raise InputError(
            f"{specimens[0].path}: several specimens fitted together have no common diagnosis; diagnose each by itself"
        )
    result = diagnose(specimens[0], bases=bases)
    return diagnosis_columns(result), as_json(diagnosis_record(result))


def diagnosis_columns(result: Diagnosis) -> dict[str, Value]:
    """The verdict, the most probable cause with its size, the others, and the errors before and after."""
    verdict, gain = result.verdict, result.gain
    causes = sorted(verdict.causes, key=lambda cause: -cause.probability)
    columns: dict[str, Value] = {"verdict": verdict.word}
    if causes:
        first = causes[0]
        columns |= {"cause": first.effect.title, "probability": first.probability}
        columns |= {"size": first.values[0], "size_std": first.std[0], "size_unit": first.effect.parameters[0].unit}
        columns["further_causes"] = " + ".join(cause.effect.title for cause in causes[1:]) or None
        columns["alike"] = ", ".join(first.indistinguishable_from) or None
    columns |= {f"error_{when}": gain[f"held_out_{when}"] for when in ("before", "after")}
    columns |= {"error_noise": gain["noise_floor"], "diagnosis": _diagnosis_words(verdict.word, causes)}
    return as_json(columns)


def _diagnosis_words(word: str, causes) -> str:
    named = []
    for cause in causes:
        size = sizes(cause.effect, cause.values, cause.std)
        alike = f", indistinguishable from {', '.join(cause.indistinguishable_from)}" * bool(
            cause.indistinguishable_from
        )
        named.append(f"{cause.effect.title} ({size}; probability {cause.probability:.2f}{alike})")
    if word == "none":
        return "the simulation explains the sweep within the noise"
    if word == "unknown":
        return "misfit that no candidate explains" + f", in part {' + '.join(named)}" * bool(named)
    return " + ".join(named)


STEPS: dict[str, Step] = {"update": _update, "diagnose": _diagnose}
