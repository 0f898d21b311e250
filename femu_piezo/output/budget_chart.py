"""Picture of an uncertainty budget: the shares of the variance of every constant and tangent, by source."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.figure import Figure

from femu_piezo.inference.budget import SOURCES
from femu_piezo.inference.unknowns import Estimate
from femu_piezo.output.picture import Picture, as_it_stands
from femu_piezo.output.tables import source_words, std_percent

#: Colour of each source, the same in every picture.
SOURCE_COLOURS = dict(
    zip(
        SOURCES,
        (
            *("#8c8c8c", "#566573", "#c8c8c8", "#b03a2e", "#e59866", "#1f4e79", "#5dade2", "#7dcea0", "#f5b041"),
            *("#148f77", "#a569bd"),
        ),
        strict=True,
    )
)
#: A source whose share of the variance is below the first in every bar is not drawn; shares from the second on are
#: written into the bar.
_SEEN, _NUMBERED = 0.005, 0.07
#: Colours on which a number is written in black.
_LIGHT = ("#c8c8c8", "#e59866", "#7dcea0", "#f5b041", "#5dade2")


def budget_shares(parameters: Mapping[str, Estimate]) -> dict[str, dict[str, float]]:
    """ "s11", "tan s11", … → source → its share of the variance, 0 to 1; estimates without a budget are left out."""
    found = {}
    for name, estimate in parameters.items():
        for label, parts, std in (
            (name, estimate.budget, estimate.std),
            (f"tan {name}", estimate.tan_budget, estimate.tan_std),
        ):
            if parts and std:
                found[label] = {source: (part / std) ** 2 for source, part in parts.items()}
    return found


def budget_figure(title: str, parameters: Mapping[str, Estimate]) -> Figure:
    """A bar of 100 % for each constant and each tangent, divided by source, with the deviation at its right end."""
    shares = budget_shares(parameters)
    figure = Picture(figsize=(8.0, 1.3 + 0.36 * len(shares)), layout="constrained")
    axes = figure.subplots()
    shown = [source for source in SOURCES if any(parts.get(source, 0.0) >= _SEEN for parts in shares.values())]
    starts = dict.fromkeys(shares, 0.0)
    for source in shown:
        widths = [100 * parts.get(source, 0.0) for parts in shares.values()]
        colour = SOURCE_COLOURS[source]
        name = source_words(source)
        bars = axes.barh(list(shares), widths, left=list(starts.values()), color=colour, label=name, height=0.72)
        numbers = [f"{width:.0f}" if width >= 100 * _NUMBERED else "" for width in widths]
        ink = "black" if colour in _LIGHT else "white"
        axes.bar_label(bars, numbers, label_type="center", color=ink, fontsize=8.5)
        starts = {label: start + width for (label, start), width in zip(starts.items(), widths, strict=True)}
    for row, label in enumerate(shares):
        axes.text(101, row, _deviation(label, parameters), va="center", fontsize=9)
    axes.set(xlim=(0, 100), xlabel="share of the variance (%)")
    axes.set_title(as_it_stands(title), fontsize=11, loc="left")
    axes.invert_yaxis()
    axes.tick_params(axis="y", length=0)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    figure.legend(loc="outside lower center", ncols=min(len(shown), 5), frameon=False, fontsize=9)
    return figure


def _deviation(label: str, parameters: Mapping[str, Estimate]) -> str:
    estimate = parameters[label.removeprefix("tan ")]
    if label.startswith("tan "):
        return f"± {estimate.tan_std:.2g}"
    return f"± {std_percent(estimate.std / abs(estimate.value))}"
