"""The terminal's tables of a diagnosis: candidates, constants, poles and zeros."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.table import Table

from femu_piezo.diagnosis.comparison import Trial
from femu_piezo.effects.words import quantity, sizes
from femu_piezo.inference.readings import reading_words
from femu_piezo.output.curves import PRINTED
from femu_piezo.output.diagnosis_words import answer
from femu_piezo.output.tables import interval_text, note_lines, text_of
from femu_piezo.output.wording import alike_words, names_of, percent, spoken, with_article
from femu_piezo.study.diagnose import Diagnosis
from femu_piezo.study.pole_zero_residuals import Difference
from femu_piezo.units import number, signed

#: Candidates, and recommended measurements, that are shown.
_CANDIDATES, _MEASUREMENTS = 8, 5


def diagnosis_table(result: Diagnosis) -> RenderableType:
    """Verdict in words, the best candidates, the constants before and after, what to measure."""
    verdict, gain = result.verdict, result.gain
    lines = [f"{result.piece.name}: {verdict.word}: {answer(result).headline}"]
    for cause in verdict.causes:
        size = sizes(cause.effect, cause.values, cause.std)
        lines.append(f"  {cause.effect.title}: {cause.effect.sentence}; {size}; probability {cause.probability:.3f}")
        lines += [f"    {words}" for words in alike_words(cause.indistinguishable_from)]
    for form in verdict.forms:
        size = sizes(form.effect, form.values, form.std)
        looks = with_article(spoken(form.effect))
        lines.append(f"  the unexplained misfit looks like {looks}: {form.effect.sentence}; {size}")
    lines.append(
        f"rms error on data that the fit did not use: base model {percent(gain['held_out_before'])}, final model "
        f"{percent(gain['held_out_after'])} ({gain['over_expected']:.3g} times that of a correct model), noise "
        f"{percent(gain['noise_floor'])}"
    )
    if verdict.causes and verdict.after.structured:
        bands = ", ".join(f"{low / 1e3:.4g}-{high / 1e3:.4g} kHz" for low, high in verdict.after.worst_Hz[:3])
        where = f"largest at {bands}" if bands else "spread over the whole sweep"
        lines.append(f"unexplained: {percent(verdict.unexplained)} of the misfit, {where}")
    lines += reading_words(result.comparison.final)
    tables = (_candidate_table(result), _constant_table(result), _resonance_table(result))
    tail = [f"recommended: {words}" for words in verdict.measurements[:_MEASUREMENTS]]
    further = len(verdict.measurements) - len(tail)
    if further > 0:
        tail.append(f"{further} further recommendation{'s' if further > 1 else ''} in diagnosis.json")
    return Group(text_of(lines), *tables, text_of([*tail, *note_lines(result.notes)]))


def _candidate_table(result: Diagnosis) -> Table:
    table = Table(title="candidate effects, each fitted alone with the constants", title_justify="left")
    for heading in ("effect", "log odds", "prediction error (σ)", "size"):
        table.add_column(heading, justify="left" if heading in ("effect", "size") else "right")
    base = result.comparison.base
    table.add_row("none", "0", f"{base.held_out.rms:.3g}", "")
    for trial in ranked(result)[:_CANDIDATES]:
        row = (trial.effect.key, signed(trial.log_odds, ".1f"), f"{trial.fit.held_out.rms:.3g}", fitted_sizes(trial))
        table.add_row(*row)
    return table


def ranked(result: Diagnosis) -> list[Trial]:
    """The candidates whose fit converged, in falling order of their log odds."""
    settled = (trial for trial in result.comparison.singles if trial.fit is not None)
    return sorted(settled, key=lambda trial: -trial.log_odds)


def fitted_sizes(trial: Trial) -> str:
    """The fitted parameters of a candidate with deviation and unit, with their names where there are several."""
    if len(trial.effect.parameters) > 1:
        return sizes(trial.effect, trial.values, trial.std)
    return quantity(trial.effect.parameters[0], float(trial.values[0]), float(trial.std[0]))


def _constant_table(result: Diagnosis) -> Table:
    table = Table(title="constants", title_justify="left")
    for heading in ("constant", "unit"):
        table.add_column(heading)
    known = result.verdict.word != "unknown"  # otherwise the constants absorb what the model lacks
    for heading in ("base model", "final model", *["95 %, averaged over causes"] * known):
        table.add_column(heading, justify="right")
    before, after = result.before, result.after
    for name, old in before.items():
        factor, unit = PRINTED[name]
        new = after[name]
        values = (number(one.value * factor, one.std * factor) for one in (old, new))
        table.add_row(name, unit, *values, *[interval_text(*(factor * end for end in new.interval))] * known)
        tangents = (number(one.tan, one.tan_std) for one in (old, new))
        table.add_row(f"tan {name}", "", *tangents, *[interval_text(*new.tan_interval)] * known)
    return table


def _resonance_table(result: Diagnosis) -> Table:
    """Δf and ΔQ of every pole and zero of the sweep `shown`, before and after."""
    of = f" of {result.sweeps[result.shown].measured.problem.specimen.name}" if len(result.sweeps) > 1 else ""
    table = Table(title=f"poles and zeros{of}, simulated − measured", title_justify="left")
    for heading in ("", "measured (Hz)"):
        table.add_column(heading, justify="right")
    extension = result.verdict.extension
    shown = ["base model", f"with {names_of(extension)}"] if extension else ["base model"]
    for words in shown:
        table.add_column(f"Δf, {words}", justify="right")
        table.add_column("ΔQ", justify="right")
    sets = [(*one.poles, *one.zeros) for one in result.pole_zero[: len(shown)]]
    for row in zip(*sets, strict=True):
        cells = [cell for one in row for cell in (difference(one, "frequency"), difference(one, "quality"))]
        measured = row[0].measured
        table.add_row(measured.kind, number(measured.frequency_Hz, measured.std_Hz), *cells)
    return table


def difference(one: Difference, what: str) -> str:
    """Simulated − measured, in % or ppm, and in σ; what : "frequency", "quality" or "coupling"."""
    found = getattr(one, what)
    if found is None:
        return "not there" if one.model is None and what == "frequency" else ""
    share, sigma = found
    small = abs(share) < 0.1 and what == "frequency"
    size = f"{signed(1e4 * share, '.0f')} ppm" if small else f"{signed(share, '.2f')} %"
    return size if sigma is None else f"{size} ({signed(sigma, '.1f')} σ)"
