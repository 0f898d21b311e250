"""Picture of a noise study: deviations stated and reached, bias and coverage, against noise and number of points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import binom

from femu_piezo.output.curves import GRID
from femu_piezo.output.picture import Picture, as_it_stands
from femu_piezo.study.noise_study import Setting

#: Colours of the constants, in their order.
_COLOURS = ("#c0392b", "#1f6fb4", "#2a8a4a", "#8e44ad", "#b07d2b", "#148f77", "#566573", "#e67e22", "#5d6d7e", "#222")
#: Coverage of one and of two deviations of a Gaussian.
_COVERED = {1: 0.6827, 2: 0.9545}
#: Between minus and plus so many standard deviations lie 95 % of a Gaussian.
_CHANCE = 1.96


def noise_study_figure(title: str, settings: Sequence[Setting]) -> Figure:
    """Deviations, bias and coverage over the noise (left column) and over the number of points (right column).

    Rows: deviations of constants and of tangents (dots reached, lines stated); the mean error over its standard
    deviation; the share of draws whose truth is within one and two stated deviations. The bands of the last two rows
    hold 95 % where the stated deviations are right. Settings of which no fit settled are left out.
    """
    picture = Picture(figsize=(10.5, 12.0), layout="constrained")
    axes = picture.subplots(4, 2, sharex="col", sharey="row")
    plan = settings[1]
    settings = [one for one in settings if len(one.error)]
    columns = (
        ("noise of a point", [one for one in settings if one.points == plan.points], lambda one: one.noise),
        ("points of the sweep", [one for one in settings if one.noise == plan.noise], lambda one: one.points),
    )
    for column, (words, chosen, x_of) in enumerate(columns):
        chosen = sorted(chosen, key=x_of)
        x = [x_of(one) for one in chosen]
        for index, label in enumerate(plan.labels):
            tangent = label.startswith("tan_")
            row, colour = int(tangent), _COLOURS[index // 2 % len(_COLOURS)]
            size = 1.0 if tangent else abs(plan.values[index])
            axes[row, column].plot(x, [np.median(one.stated[:, index]) / size for one in chosen], color=colour, lw=1.2)
            reached = [one.deviation[index] / size for one in chosen]
            axes[row, column].plot(x, reached, "o", color=colour, markersize=5, label=label)
            style = {"color": colour, "linestyle": "none", "markerfacecolor": "none" if tangent else colour}
            axes[2, column].plot(x, [one.bias[index] for one in chosen], "o", markersize=4.5, **style)
            for sigma, marker in ((1, "o"), (2, "s")):
                share = [one.inside(sigma)[index] for one in chosen]
                axes[3, column].plot(x, share, marker, markersize=4.5, **style)
        axes[2, column].axhspan(-_CHANCE, _CHANCE, color="#e3ece3", zorder=0)
        axes[2, column].axhline(0, color="#7f8c8d", linewidth=0.8)
        for share in _COVERED.values():
            low, high = binom.interval(0.95, len(plan.error), share)
            axes[3, column].axhspan(low / len(plan.error), high / len(plan.error), color="#e3ece3", zorder=0)
            axes[3, column].axhline(share, color="#7f8c8d", linewidth=0.8)
        for one in axes[:, column]:
            one.set_xscale("log")
            one.set_xticks(x, [f"{value:g}" for value in x], minor=False)
            one.set_xticks([], minor=True)
            one.grid(True, **GRID)
        for one in axes[:2, column]:
            one.set_yscale("log")
        axes[3, column].set_xlabel(words)
    axes[0, 0].set_ylabel("relative standard deviation of constants")
    axes[1, 0].set_ylabel("standard deviation of tangents")
    axes[2, 0].set_ylabel("bias: mean error over its std\n(filled constants, open tangents)")
    lowest = min(float(one.inside(1).min()) for one in settings)
    axes[3, 0].set(ylabel="share within 1 (●) and 2 (■) stated σ", ylim=(min(0.4, lowest - 0.03), 1.02))
    axes[0, 1].legend(frameon=False, fontsize=8)
    axes[1, 1].legend(frameon=False, fontsize=8)
    picture.suptitle(
        f"{as_it_stands(title)}: {len(plan.error)} updates of random specimens; dots: scatter found, lines: stated"
    )
    return picture
