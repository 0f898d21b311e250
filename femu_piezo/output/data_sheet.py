"""One page about a piece: constants with deviations, standard figures, curves; A4, made by matplotlib."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib import metadata

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from femu_piezo.output.curves import MEASURED, PRINTED, UPDATED, draw_impedance, frequency_axis
from femu_piezo.output.picture import Picture, as_it_stands
from femu_piezo.output.tables import deviation_percent, figure_words, source_words
from femu_piezo.output.wording import sentence_case
from femu_piezo.specimen.geometry import FEATURES, LENGTHS
from femu_piezo.standards.figures import StandardFigures
from femu_piezo.study.results import Outcome, UpdateResult
from femu_piezo.units import number

_A4 = (8.27, 11.69)
_DARK, _ACCENT = "#222222", "#c0392b"
#: Heights on the page, 0 to 1: first and lowest line of the tables, top of the notes, distance of lines; then the size
#: of letters, points, and the lines that a table takes in addition to its rows.
_TOP, _CURVES, _NOTES, _STEP, _SIZE, _HEAD = 0.905, 0.37, 0.145, 0.0145, 7.6, 3.3
#: Figures of the modes after the fundamental that the sheet states.
_OF_FURTHER_MODES = ("fs", "fp", "k_eff", "Qm_pole", "kt", "Nt", "c33", "c33D")
#: Characters of a name and of the title of a table in letters of full size; characters of a line on the body and of one
#: of notes, and the lines of notes that have room.
_NAME, _TITLE, _BODY, _WIDTH, _LINES = 48, 88, 98, 130, 8


def data_sheet(result: UpdateResult, index: int = 0) -> Figure:
    """The page of one sweep of an update, without standard figures where the sweep gives none."""
    outcome, modes = result.outcomes[index], result.figures[index]
    page = Picture(figsize=_A4)
    name = as_it_stands(outcome.measured.problem.specimen.name)
    body = textwrap.wrap(_body_words(outcome), _BODY)
    above = 0.0125 * (len(body) - 1)
    page.text(0.07, 0.955 + above, name, size=16 * _NAME / max(_NAME, len(name)), weight="bold", color=_DARK)
    page.text(0.07, 0.936, "\n".join(body), size=8, color="#555555", va="bottom", linespacing=1.35)
    page.add_artist(_rule(page, 0.93))
    constants, figures = _constants(result), _figures(modes)
    step = min(_STEP, (_TOP - _CURVES) / (len(constants) + len(figures) + 2 * _HEAD))
    _table(page, _TOP, step, "Material constants", ("", "value", "loss tangent", "mostly from"), constants)
    below = _TOP - step * (len(constants) + _HEAD)
    if modes:
        headings = ("", "by standard", "finite elements", "dev.", "")
        _table(page, below, step, f"Standard figures: {modes[0].title}", headings, figures)
        below -= step * (len(figures) + _HEAD)
    _curves(page, outcome, below)
    _footer(page, result, modes)
    return page


def as_pdf(page: Figure) -> bytes:
    """The page as a PDF file."""
    buffer = io.BytesIO()
    page.savefig(buffer, format="pdf")
    return buffer.getvalue()


def _rule(page: Figure, height: float) -> Line2D:
    return Line2D([0.07, 0.93], [height, height], color=_ACCENT, linewidth=1.6, transform=page.transFigure)


def _body_words(outcome: Outcome) -> str:
    problem, spectrum = outcome.measured.problem, outcome.measured.spectrum
    geometry = problem.specimen.geometry
    sizes = [
        f"{key.replace('_', ' ')} {1e3 * value:.5g} mm"
        for key, value in geometry
        if isinstance(value, float) and key in (*LENGTHS, "corner_radius", *FEATURES)
    ]
    poling = geometry.poling
    along = f"the {poling}" if isinstance(poling, str) else f"({', '.join(f'{part:.4g}' for part in poling)})"
    low, high = spectrum.frequency[[0, -1]]
    sweep = f"{len(spectrum)} points, {low / 1e3:.5g} to {high / 1e3:.5g} kHz"
    body = f"{geometry.shape}: {', '.join(sizes)}; poled along {along}; density {problem.density:.5g} kg/m³"
    return f"{body}; sweep of {sweep}"


def _constants(result: UpdateResult) -> list[tuple[str, ...]]:
    rows = []
    for name, estimate in result.parameters.items():
        factor, unit = PRINTED[name]
        value = number(estimate.value * factor, None if estimate.std is None else estimate.std * factor)
        source = estimate.largest_part
        rows.append(
            (
                name,
                f"({value}) {unit}" if "±" in value else f"{value} {unit}",
                number(estimate.tan, estimate.tan_std),
                source_words(source or ""),
            )
        )
    return rows


def _figures(modes: Sequence[StandardFigures]) -> list[tuple[str, ...]]:
    """Rows of all figures of the fundamental; of each other mode a row with its title, and `_OF_FURTHER_MODES`."""
    rows: list[tuple[str, ...]] = []
    for place, mode in enumerate(modes):
        rows += [(mode.title, "", "", "", "")] * (place > 0)
        rows += [
            (one.name, figure_words(one), figure_words(one, model=True), deviation_percent(one.deviation), one.meaning)
            for one in mode.figures
            if place == 0 or one.name in _OF_FURTHER_MODES
        ]
    return rows


def _table(page: Figure, top: float, step: float, title: str, headings: Sequence[str], rows) -> None:
    """Rows of text, `step` of the page apart: names and words to the left, numbers to the right."""
    left, size = 0.07, _SIZE * step / _STEP
    page.text(left, top, title, size=9.5 * _TITLE / max(_TITLE, len(title)), weight="bold", color=_DARK)
    places = {4: (0.0, 0.30, 0.48, 0.50), 5: (0.0, 0.27, 0.46, 0.55, 0.57)}[len(headings)]
    sides = ("left", "right", "right", *(("left",) if len(headings) == 4 else ("right", "left")))
    for line, row in enumerate([headings, *rows]):
        height = top - step * (1.2 + line)
        for place, side, cell in zip(places, sides, row, strict=True):
            page.text(left + place, height, cell, size=size, ha=side, color=_DARK if line else "#555555")


def _curves(page: Figure, outcome: Outcome, top: float) -> None:
    """|Z| and phase, measured and by finite elements, from `top` of the page down to the notes."""
    spectrum = outcome.measured.spectrum
    factor, label, scale = frequency_axis(spectrum.frequency)
    x, height = spectrum.frequency * factor, min(top, 0.5) - _NOTES - 0.06
    magnitude = page.add_axes((0.13, _NOTES + 0.055, 0.34, height))
    phase = page.add_axes((0.59, _NOTES + 0.055, 0.34, height))
    curves = ((spectrum.impedance, "measured", MEASURED), (outcome.updated_curve, "finite elements", UPDATED))
    draw_impedance(magnitude, phase, x, curves)
    for axes in (magnitude, phase):
        axes.set(xscale=scale, xlabel=label)
        axes.tick_params(which="both", labelsize=7)
        axes.xaxis.label.set_size(8)
        axes.yaxis.label.set_size(8)
    magnitude.legend(frameon=False, fontsize=7, loc="best")


def _footer(page: Figure, result: UpdateResult, modes: Sequence[StandardFigures]) -> None:
    """The notes and the errors of the formulas as far as there is room, then version and date of the page."""
    sentences = [*result.notes, *(one.formula_words for one in modes if one.formula_words)]
    sentences += [note for one in modes for note in one.notes]
    alone = ", of figures by standard for the noise alone" * bool(modes)
    sentences.insert(0, f"± is one standard deviation{alone}; a constant is value (1 − j tan), time factor exp(jωt)")
    lines, remaining = [], list(sentences)
    while remaining:
        sentence = f"{sentence_case(remaining[0])}.".replace(" %", "\N{NO-BREAK SPACE}%")
        wrapped = textwrap.wrap(sentence, _WIDTH)
        if len(lines) + len(wrapped) > _LINES - (len(remaining) > 1):
            lines.append(f"Further notes in update.json: {len(remaining)}.")
            break
        lines += wrapped
        remaining.pop(0)
    page.text(0.07, _NOTES, as_it_stands("\n".join(lines)), size=7, va="top", color="#333333", linespacing=1.35)
    made = f"femu-piezo {metadata.version('femu-piezo')}, {datetime.now(UTC):%Y-%m-%d %H:%M UTC}"
    page.text(0.07, 0.03, made, size=6.5, color="#777777")
