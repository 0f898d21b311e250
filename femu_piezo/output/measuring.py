"""The picture of a measurement while it is made: points so far, the updated model, and how the deviations fell."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from femu_piezo.output.curves import GRID, MEASURED, UPDATED, draw_impedance, frequency_axis
from femu_piezo.output.picture import Picture

if TYPE_CHECKING:
    from femu_piezo.study.adaptive import State

_DEPARTED = {"color": "#1f6fb4", "linewidth": 0.9, "linestyle": ":"}


def measuring_figure(title: str, states: Sequence[State]) -> Figure:
    """|Z| and phase of all points with the model of the last state, and the deviations over the number of points."""
    last = states[-1]
    figure = Picture(figsize=(8.0, 8.0), layout="constrained")
    magnitude, phase, fall = figure.subplots(3, 1, height_ratios=[3, 2, 2])
    phase.sharex(magnitude)
    frequency = last.spectrum.frequency
    factor, label, _ = frequency_axis(frequency)
    draw_impedance(magnitude, phase, frequency * factor, [(last.spectrum.impedance, "measured", MEASURED)])
    if last.curve is not None:
        draw_impedance(magnitude, phase, last.curve[0] * factor, [(last.curve[1], "updated model", UPDATED)])
    for number, place in enumerate(last.departures):
        magnitude.axvline(place * factor, label="" if number else "departs from the model", **_DEPARTED)
        phase.axvline(place * factor, **_DEPARTED)
    magnitude.set(title=f"{title}: {len(last.spectrum)} points")
    magnitude.legend(loc="best", fontsize="small")
    magnitude.tick_params(labelbottom=False)
    phase.set(xlabel=label)
    told = [one for one in states if one.deviations]
    for name in told[-1].deviations if told else ():
        values = np.array([one.deviations[name] for one in told])
        fall.semilogy([len(one.spectrum) for one in told], values, marker="o", markersize=3, label=name)
    fall.set(xlabel="points", ylabel="standard deviation")
    fall.grid(True, **GRID)
    if told:
        fall.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small")
    else:
        fall.text(0.5, 0.5, "no update yet", ha="center", va="center", transform=fall.transAxes)
    return figure
