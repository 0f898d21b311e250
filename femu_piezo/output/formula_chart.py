"""Picture of the errors of the handbook formulas for a piece."""

from __future__ import annotations

from matplotlib.figure import Figure

from femu_piezo.errors import InputError
from femu_piezo.output.picture import Picture
from femu_piezo.standards.figures import StandardFigures


def formula_figure(figures: StandardFigures) -> Figure:
    """A bar for each figure that a formula of the body gives: its error for this piece, in per cent.

    Raises InputError where no formula was used.
    """
    wrong = [one for one in figures.figures if one.formula_error is not None]
    if not wrong:
        raise InputError(
            "no formula of the body was used, so there is no error of one to draw; give a specimen of a shape that the "
            "standards know"
        )
    drawing = Picture(figsize=(7.0, 1.2 + 0.4 * len(wrong)), layout="constrained")
    axes = drawing.subplots()
    sizes = [100 * one.formula_error for one in wrong]
    bars = axes.barh([one.name for one in wrong], sizes, color="#1f4e79", height=0.6)
    axes.bar_label(bars, [f"{size:+.2g} %" for size in sizes], padding=3)
    axes.invert_yaxis()
    axes.axvline(0.0, color="#222222", linewidth=0.8)
    axes.margins(x=0.2)
    ratio = f", {figures.aspect[0]} = {figures.aspect[1]:.3g}" if figures.aspect else ""
    axes.set(xlabel="error of the handbook formula (%)", title=f"{figures.title}{ratio}")
    axes.title.set_size(10)
    return drawing
