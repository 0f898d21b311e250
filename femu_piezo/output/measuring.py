"""The picture of a measurement while it is made: points so far, the updated model, and how the deviations fell."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from femu_piezo.output.curves import GRID, MEASURED, UPDATED, draw_impedance, frequency_axis
from femu_piezo.output.picture import Picture, as_it_stands

if TYPE_CHECKING:
    from femu_piezo.study.adaptive import State

_DEPARTED = {"color": "#1f6fb4", "linewidth": 0.9, "linestyle": ":"}


def measuring_figure(title: str, states: Sequence[State]) -> Figure:
    """|Z| and phase of all points with the last model; deviations, and log odds of rival causes, over the points."""
    last = states[-1]
    with_rivals = [one for one in states if one.rivals is not None]
    figure = Picture(figsize=(8.0, 10.0 if with_rivals else 8.0), layout="constrained")
    magnitude, phase, fall, *odds = figure.subplots(
        3 + bool(with_rivals), 1, height_ratios=[3, 2, 2, 2][: 3 + bool(with_rivals)]
    )
    phase.sharex(magnitude)
    frequency = last.spectrum.frequency
    factor, label, _ = frequency_axis(frequency)
    draw_impedance(magnitude, phase, frequency * factor, [(last.spectrum.impedance, "measured", MEASURED)])
    if last.curve is not None:
        draw_impedance(magnitude, phase, last.curve[0] * factor, [(last.curve[1], "updated model", UPDATED)])
    for number, place in enumerate(last.departures):
        magnitude.axvline(place * factor, label="" if number else "point that departs from the model", **_DEPARTED)
        phase.axvline(place * factor, **_DEPARTED)
    magnitude.set(title=f"{as_it_stands(title)}: {len(last.spectrum)} points")
    magnitude.legend(loc="best", fontsize="small")
    magnitude.tick_params(labelbottom=False)
    phase.set(xlabel=label)
    updated = [one for one in states if one.deviations]
    for name in updated[-1].deviations if updated else ():
        values = np.array([one.deviations[name] for one in updated])
        fall.semilogy([len(one.spectrum) for one in updated], values, marker="o", markersize=3, label=name)
    fall.set(xlabel="points", ylabel="standard deviation")
    fall.grid(True, **GRID)
    if updated:
        fall.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small")
    else:
        fall.text(0.5, 0.5, "no update yet", ha="center", va="center", transform=fall.transAxes)
    if with_rivals:
        _draw_odds(odds[0], with_rivals)
        odds[0].sharex(fall)
    return figure


def _draw_odds(axes: Axes, states: Sequence[State]) -> None:
    """Log odds of the more probable of the two rival causes after every round, a line for each pair of causes."""
    pairs = [(one.rivals.first, one.rivals.second) for one in states]
    for pair in dict.fromkeys(pairs):
        of_pair = [one for one, other in zip(states, pairs, strict=True) if other == pair]
        points, values = [len(one.spectrum) for one in of_pair], [one.rivals.log_odds for one in of_pair]
        axes.plot(points, values, marker="o", markersize=3, label=as_it_stands(f"{pair[0]} over\n{pair[1]}"))
    axes.axhline(states[-1].rivals.enough, color="black", linewidth=0.8, linestyle="--", label="enough")
    axes.set(xlabel="points", ylabel="log odds")
    axes.grid(True, **GRID)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small")
