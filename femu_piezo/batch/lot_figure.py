"""The picture of a lot: control chart over serial number and distribution of every quantity."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from femu_piezo.batch.lot import FEWEST, Distribution, Lot, counts_words
from femu_piezo.output.curves import PRINTED
from femu_piezo.output.picture import Picture, as_it_stands, margins

_POINTS = {"color": "#1f6fb4", "marker": ".", "linestyle": "none", "markersize": 4}
_LIMIT = {"color": "#8c8c8c", "linewidth": 1.0, "linestyle": "--"}
_OUTLIER = {"color": "#c0392b", "marker": "o", "markerfacecolor": "none", "linestyle": "none", "markersize": 7}
_LABELLED = 12  # most outliers with a label in each chart
#: Room beside all charts: left, right, below, above, inches.
_ROOM = 1.0, 0.15, 0.6, 0.45
#: Outliers further off than this, in robust standard deviations, are drawn on the edge of the chart.
_SHOWN = 12.0


def lot_figure(lot: Lot) -> Figure:
    """One row per quantity: values with control limits, drift and outliers by file name and cause; histogram."""
    rows = max(1, len(lot.distributions))
    size = 11.0, 1.05 + 1.9 * rows
    figure = Picture(figsize=size)
    grid = margins(size, *_ROOM) | {"width_ratios": [4, 1], "hspace": 0.1, "wspace": 0.03}
    axes = figure.subplots(rows, 2, squeeze=False, sharex="col", gridspec_kw=grid)
    for one, (chart, histogram) in zip(lot.distributions, axes, strict=False):
        factor, unit = PRINTED.get(one.quantity, (1.0, ""))
        far = {item.number for item in lot.outliers if item.quantity == one.quantity and abs(item.distance) > _SHOWN}
        inside = np.array([number not in far for number in one.number.tolist()])
        low, high = _range(one, inside)
        _chart(chart, one, lot, factor, inside)
        chart.ticklabel_format(axis="y", useOffset=False)
        chart.set(ylim=(factor * low, factor * high), ylabel=f"{one.quantity}{f' ({unit})' if unit else ''}")
        bins = min(40, max(5, int(inside.sum()) // 5))
        histogram.hist(
            factor * one.values[inside], bins, orientation="horizontal", color="#9dbfdc", histtype="stepfilled"
        )
        histogram.set_ylim(chart.get_ylim())
    for histogram in axes[:, 1]:
        histogram.tick_params(labelleft=False)
    if not lot.distributions:
        axes[0, 0].text(0.5, 0.5, "no specimen gave a result", ha="center", transform=axes[0, 0].transAxes)
    axes[-1, 0].set_xlabel("serial number (place in the order of file names)")
    for axis, most in ((axes[-1, 0].xaxis, 9), (axes[-1, 1].xaxis, 4)):
        axis.set_major_locator(MaxNLocator(most, integer=True, min_n_ticks=1))
    axes[-1, 1].set_xlabel("specimens")
    figure.align_ylabels(axes[:, 0])
    looked_for = any(one.values.size >= FEWEST for one in lot.distributions)
    outliers = f"{len({item.number for item in lot.outliers})} with outliers"
    words = outliers if looked_for else f"outliers are not looked for below {FEWEST} values"
    figure.suptitle(f"{counts_words(lot)}; {words}", fontsize=11, y=1 - 0.14 / size[1])
    return figure


def _range(distribution: Distribution, inside: np.ndarray) -> tuple[float, float]:
    """The range of a chart, with a margin: limits, line and the values `inside`, which are not far off."""
    low, high = (pick([*distribution.limits, *distribution.line, *distribution.values[inside]]) for pick in (min, max))
    margin = 0.15 * (high - low) or 0.01 * abs(high) or 1.0
    return low - margin, high + margin


def _chart(axes: Axes, distribution: Distribution, lot: Lot, factor: float, inside: np.ndarray) -> None:
    axes.plot(distribution.number[inside], factor * distribution.values[inside], **_POINTS)
    for limit in distribution.limits:
        axes.axhline(factor * limit, **_LIMIT)
    axes.plot(distribution.number, factor * distribution.line, color="#222222", linewidth=1.0)
    shown = dict(zip(distribution.number.tolist(), inside.tolist(), strict=True))
    outliers = sorted(
        (item for item in lot.outliers if item.quantity == distribution.quantity), key=lambda i: -abs(i.distance)
    )
    for rank, item in enumerate(outliers):
        name = item.file.rsplit(".", 1)[0] + (f": {item.cause}" if item.cause else "")
        if shown[item.number]:
            place, style = {"xy": (item.number, factor * item.value)}, _OUTLIER
        else:  # on the edge, with the value in words
            above = item.value > distribution.centre
            place = {"xy": (item.number, float(above)), "xycoords": axes.get_xaxis_transform()}
            style = {**_OUTLIER, "marker": "^" if above else "v", "clip_on": False}
            style["transform"] = axes.get_xaxis_transform()
            name += f" ({factor * item.value:.4g})"
        axes.plot(*place["xy"], **style)
        if rank < _LABELLED:
            align = {"va": "center"} if shown[item.number] else {"va": "top" if above else "bottom"}
            is_right = 2 * item.number <= distribution.number.max()  # in the first half, the name is right of the point
            align |= {"ha": "left" if is_right else "right", "xytext": (7 if is_right else -7, 0)}
            axes.annotate(as_it_stands(name), **place, textcoords="offset points", fontsize=7, **align)
    axes.margins(x=0.02)
