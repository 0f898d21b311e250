"""Standard figures as a piece of a report."""

from __future__ import annotations

from femu_piezo.output.report import Cell, notes, paragraph, table
from femu_piezo.output.tables import deviation_percent, figure_words
from femu_piezo.output.wording import sentence_case
from femu_piezo.standards.figures import Figure, StandardFigures


def standard_figures_html(figures: StandardFigures, key: str) -> str:
    """A table of figures and of those of the finite element model, the errors of the formulas, and notes; HTML.

    key : where the figures stand in the record of the page, such as "standard_figures"
    """
    with_model = any(one.model is not None for one in figures.figures)
    headings = ["", "meaning", "by standard", *(("finite elements", "deviation") if with_model else ())]
    rows = []
    for one in figures.figures:
        row = [one.name, one.meaning, _cell(one, f"{key}.figures.{one.name}", "value")]
        if with_model:
            row += [_cell(one, f"{key}.figures.{one.name}", "model"), deviation_percent(one.deviation)]
        rows.append(row)
    sentence = figures.formula_words
    words = "" if sentence is None else paragraph(f"{sentence_case(sentence)}.")
    return table(headings, rows, figures.title, "parameters") + words + notes(figures.notes)


def _cell(figure: Figure, key: str, what: str) -> str | Cell:
    value = getattr(figure, what)
    return "" if value is None else Cell(figure_words(figure, model=what == "model"), f"{key}.{what}", value)
