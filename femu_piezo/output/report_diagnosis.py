"""The report of a diagnosis: page one answers in words, then pictures, tables, provenance."""

from __future__ import annotations

import html
from pathlib import Path

import numpy as np

from femu_piezo.output.curves import PRINTED
from femu_piezo.output.diagnosis import diagnosis_record
from femu_piezo.output.diagnosis_tables import difference, fitted_sizes, ranked
from femu_piezo.output.diagnosis_words import Answer, answer, shifts
from femu_piezo.output.report import (
    Cell,
    Section,
    inputs_of,
    notes,
    paragraph,
    provenance_section,
    table,
    write_report,
)
from femu_piezo.output.report_diagnosis_charts import curve_charts, models, residual_charts
from femu_piezo.output.report_figures import standard_figures_html
from femu_piezo.output.report_modes import fundamental_picture
from femu_piezo.output.tables import interval_text
from femu_piezo.output.wording import listed, sentence_case, spoken
from femu_piezo.study.diagnose import Diagnosis, extended_specimen
from femu_piezo.study.pole_zero_residuals import PoleZeroResiduals
from femu_piezo.units import number, signed

#: Separation in σ beyond which a figure has no meaning.
_FAR = 100
_WORD = {"none": "good", "effect": "fair", "unknown": "poor"}


def write_diagnosis_report(path: Path, result: Diagnosis, command: str = "femu-piezo diagnose") -> None:
    """Write the report of a diagnosis; the embedded record is that of diagnosis.json."""
    sections = [*diagnosis_sections(result), _provenance(result, command)]
    title = f"{result.specimen.name}: what the simulation gets wrong"
    write_report(path, title, "Diagnosis of an impedance sweep", sections, diagnosis_record(result))


def diagnosis_sections(result: Diagnosis) -> list[Section]:
    """Answers, residuals, curves, resonances, constants, standard figures, candidates, what the sweep cannot show,
    measurements, mode shape."""
    said = answer(result)
    curves, residuals = curve_charts(result), residual_charts(result)
    return [
        Section("answers", "In short", _answers(result, said)),
        Section("residuals", "Residuals", "".join(chart.html() for chart in residuals)),
        Section("curves", "Curves", "".join(chart.html() for chart in curves)),
        Section("resonances", "Poles and zeros", _resonances(result)),
        Section("constants", "Constants before and after", _constants(result)),
        Section("figures", "Standard figures", _figures(result)),
        Section("candidates", "Candidates", _candidates(result)),
        Section("hidden", "What this sweep cannot show", _hidden(result)),
        Section("measurements", "What to measure next", _measurements(result)),
        Section("modes", "Mode shape", _mode(result)),
    ]


def _answers(result: Diagnosis, said: Answer) -> str:
    groups = (
        ("What is wrong", said.wrong),
        ("How sure", said.sure),
        ("What it means for the constants", said.constants),
        ("What to do", said.measures),
    )
    body = paragraph(said.headline, f"key {_WORD[result.verdict.word]}")
    for title, sentences in groups:
        body += f"<h3>{html.escape(title)}</h3>" + "".join(paragraph(sentence) for sentence in sentences)
    return body + notes(result.notes)


def _resonances(result: Diagnosis) -> str:
    """One table for the base, one for the final model."""
    words = (
        "Differences are simulated minus measured, with σ of the measurement. Poles and zeros of both curves were "
        "extracted in the same way, from the same frequencies. Pole: series resonance; zero: parallel resonance. k_eff "
        "is the effective coupling of a pole and its zero."
    )
    tables = [
        _resonance_table(one, model.words, when)
        for model, one, when in zip(models(result), result.pole_zero, ("before", "after"), strict=False)
    ]
    return "".join(tables) + paragraph(words) + notes(_without_partner(result))


def _resonance_table(residuals: PoleZeroResiduals, caption: str, when: str) -> str:
    rows = []
    for kinds in ("poles", "zeros"):
        for index, one in enumerate(getattr(residuals, kinds)):
            measured, model = one.measured, one.model
            frequency = Cell("", "", None)
            if model is not None:
                key = f"{kinds}.{index}.{when}.frequency_Hz"
                frequency = Cell(f"{model.frequency_Hz:.2f}", key, model.frequency_Hz)
            key = f"{kinds}.{index}.measured.frequency_Hz"
            rows.append(
                (
                    measured.kind,
                    Cell(number(measured.frequency_Hz, measured.std_Hz), key, measured.frequency_Hz),
                    frequency,
                    difference(one, "frequency"),
                    f"{measured.quality_factor:.4g}",
                    difference(one, "quality"),
                    difference(one, "coupling"),
                )
            )
    headings = ("", "measured (Hz)", "simulated (Hz)", "Δf", "measured Q", "ΔQ", "Δk_eff")
    return table(headings, rows, sentence_case(caption))


def _without_partner(result: Diagnosis) -> list[str]:
    (unexplained, extra), found = result.without_partner, []
    for resonances, words in (
        (unexplained, "measured, but not in the simulation"),
        (extra, "simulated, but not in the measurement"),
    ):
        found += [f"{r.kind} at {r.frequency_Hz / 1e3:.6g} kHz, Q {r.quality_factor:.3g}: {words}" for r in resonances]
    return found


def _figures(result: Diagnosis) -> str:
    """Standard figures of the sweep shown, and the same figures of the final model with its named causes."""
    return "".join(
        standard_figures_html(one, f"sweeps.{result.shown}.standard_figures.{mode}")
        for mode, one in enumerate(result.sweeps[result.shown].figures)
    )


def _constants(result: Diagnosis) -> str:
    before, after = result.before, result.after
    moved, rows = {shift.name: shift for shift in shifts(result)}, []
    for name, old in before.items():
        factor, unit = PRINTED[name]
        new = after[name]
        for label, scale, part, std, words in (
            (name, factor, "value", "std", unit),
            (f"tan {name}", 1.0, "tan", "tan_std", ""),
        ):
            cells = []
            for when, one in (("before", old), ("after", new)):
                value, sigma = getattr(one, part), getattr(one, std)
                text = number(value * scale, None if sigma is None else sigma * scale)
                cells.append(Cell(text, f"parameters.{when}.{name}.{part}", value))
            shift = moved[label]
            bias = f"{signed(shift.percent, '.3g')} % ({shift.sigma:.2g} σ)" if result.verdict.extension else ""
            ends = getattr(new, "interval" if part == "value" else "tan_interval")
            rows.append((label, words, *cells, bias, interval_text(*(scale * end for end in ends))))
    words = (
        "± is one standard deviation, from the noise of this sweep and from the tolerances of dimensions, density, "
        "held constants and instrument together, provided that the model of the column is complete."
    )
    headings = ("", "unit", "base model", "final model", "bias of the base model", "95 %, averaged over causes")
    known = result.verdict.word != "unknown"  # otherwise the constants absorb what the model lacks
    if known:
        words += (
            " The last column gives the range of a constant with a probability of 95 %, averaged over all sets of "
            "candidate causes that were compared, including those that this sweep cannot show."
        )
    shown = [0, 1, 2, *[3, 4] * bool(result.verdict.extension), *[5] * known]
    headings, rows = [headings[n] for n in shown], [[row[n] for n in shown] for row in rows]
    return table(headings, rows) + paragraph(words)


def _candidates(result: Diagnosis) -> str:
    base = result.comparison.base
    rows = [("none", "0", f"{base.chi_square:.5g}", f"{base.held_out.rms:.3g}", "", "")]
    for trial in ranked(result):
        on_bound = any(name.startswith(f"{trial.effect.key}.") for name in trial.fit.on_bound)
        rows.append(
            (
                spoken(trial.effect),
                signed(trial.log_odds, ".1f"),
                f"{trial.fit.chi_square:.5g}",
                f"{trial.fit.held_out.rms:.3g}",
                fitted_sizes(trial),
                "at a limit of its range" if on_bound else "",
            )
        )
    failed = [spoken(trial.effect) for trial in result.comparison.singles if trial.fit is None]
    words = (
        "Each candidate was fitted alone, together with all free constants and all tolerances. Log odds: natural "
        "logarithm of its odds against no effect, which include its prior probability and a penalty for further "
        "parameters; 3 is 20 to 1. χ²: misfit in units of the noise, priors included. Prediction error: rms error, in "
        "σ, of bands that were left out of the fit one by one; 1 is noise alone."
    )
    headings = ("candidate", "log odds", "χ²", "prediction error (σ)", "fitted size", "")
    body = table(headings, rows, kind="candidates") + paragraph(words)
    return body + notes([f"The fit of {listed(failed)} did not converge."] if failed else [])


def _hidden(result: Diagnosis) -> str:
    """Effects that the free constants imitate and, where no cause is named, the fitted size of each other candidate."""
    hidden = {effect.key: constant for effect, constant in result.verdict.hidden}
    body = ""
    if hidden:
        rows = [
            (spoken(effect), effect.sentence, constant.replace("_", " ")) for effect, constant in result.verdict.hidden
        ]
        caption = "Effects that this sweep cannot show, since a change of the free constants imitates them"
        body += table(("effect", "what it is", "imitated mainly by"), rows, caption, "words")
    else:
        body += paragraph("Every candidate effect of usual size would be visible in this sweep.")
    named = {effect.title for effect in result.comparison.final.parameters.causes}
    rows = [
        (spoken(trial.effect), fitted_sizes(trial))
        for trial in ranked(result)
        if trial.effect.key not in hidden and trial.effect.title not in named
    ]
    if rows and not named:
        body += table(("effect", "fitted size"), rows, "Effects that this sweep would show, but does not need", "words")
    return body


def _measurements(result: Diagnosis) -> str:
    """The recommended measurements, and the separation of causes in σ that the model expects of each."""
    items = "".join(f"<li>{html.escape(words)}</li>" for words in result.verdict.measurements)
    body = (
        f"<ol>{items}</ol>" if items else paragraph("No further measurement is needed to distinguish the candidates.")
    )
    if result.separations:
        rows = [
            (
                one.measurement,
                one.cause.replace("_", " ") + (f", {one.size}" if one.size else ""),
                one.other.replace("_", " "),
                f"{one.now:.2g} σ",
                f"{one.expected:.2g} σ" if one.expected <= _FAR else f"over {_FAR} σ",
            )
            for one in result.separations
        ]
        headings = ("measurement", "effect", "distinguished from", "separation now", "expected")
        body += table(
            headings,
            rows,
            "Separation of effects that the model predicts for each measurement, with all constants fitted again",
            "words",
        )
    return body


def _mode(result: Diagnosis) -> str:
    causes = [cause.effect for cause in result.verdict.causes]  # effects that the library may lack
    return fundamental_picture(extended_specimen(result), result.reference_Hz, 1.2 * result.reference_Hz, causes)


def _provenance(result: Diagnosis, command: str) -> Section:
    specimen = result.specimen
    noise = float(np.median(result.relative_noise))
    origin = "given" if result.comparison.base.data.noise_known else "estimated from the sweep"
    facts = [
        ("command", command),
        ("noise of |Z|", f"{100 * noise:.3g} %, {origin}"),
        *((f"mesh of {one.specimen.name}", one.mesh) for one in result.sweeps),
        ("fits", f"{len(result.comparison.singles)} candidates, {len(result.comparison.causes)} accepted"),
        ("times", ", ".join(f"{step} {seconds:.3g} s" for step, seconds in result.seconds.items())),
    ]
    return provenance_section(inputs_of(specimen), facts)
