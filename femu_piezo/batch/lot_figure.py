"""The picture of a lot: control chart over serial number and distribution of every quantity."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from femu_piezo.batch.lot import Distribution, Lot
from femu_piezo.output.curves import PRINTED

_POINTS = {"color": "#1f6fb4", "marker": ".", "linestyle": "none", "markersize": 4}
_LIMIT = {"color": "#8c8c8c", "linewidth": 1.0, "linestyle": "--"}
_OUTLIER = {"color": "#c0392b", "marker": "o", "markerfacecolor": "none", "linestyle": "none", "markersize": 7}
_LABELLED = 12  # so many outliers are written out in each chart


def lot_figure(lot: Lot) -> Figure:
    """One row per quantity: values with control limits, drift and outliers by file name; histogram."""
    rows = max(1, len(lot.distributions))
    figure = Figure(figsize=(11.0, 0.8 + 1.9 * rows), layout="constrained")
    axes = figure.subplots(rows, 2, squeeze=False, sharex="col", gridspec_kw={"width_ratios": [4, 1]})
    for one, (chart, histogram) in zip(lot.distributions, axes, strict=False):
        factor, unit = PRINTED.get(one.quantity, (1.0, ""))
        _chart(chart, one, lot, factor)
        chart.set_ylabel(f"{one.quantity}{f' ({unit})' if unit else ''}")
        _histogram(histogram, one, factor, chart)
    if not lot.distributions:
        axes[0, 0].text(0.5, 0.5, "no specimen gave a result", ha="center", transform=axes[0, 0].transAxes)
    axes[-1, 0].set_xlabel("serial number (place in the order of file names)")
    counts = lot.counts
    figure.suptitle(
        f"{counts['specimens']} specimens: {counts['ok']} updated, {counts['failed']} refused or not converged, "
        f"{counts['lost']} lost; {len({item.number for item in lot.outliers})} with outliers",
        fontsize=11,
    )
    return figure


def _chart(axes: Axes, one: Distribution, lot: Lot, factor: float) -> None:
    axes.plot(one.number, factor * one.values, **_POINTS)
    for limit in one.limits:
        axes.axhline(factor * limit, **_LIMIT)
    axes.plot(one.number, factor * one.line, color="#222222", linewidth=1.0)
    mine = [item for item in lot.outliers if item.quantity == one.quantity]
    axes.plot([item.number for item in mine], [factor * item.value for item in mine], **_OUTLIER)
    for item in sorted(mine, key=lambda item: -abs(item.distance))[:_LABELLED]:
        axes.annotate(
            item.file.rsplit(".", 1)[0],
            (item.number, factor * item.value),
            xytext=(6, 0),
            textcoords="offset points",
            fontsize=7,
            va="center",
        )
    axes.margins(x=0.02)


def _histogram(axes: Axes, one: Distribution, factor: float, chart: Axes) -> None:
    axes.hist(
        factor * one.values, bins=min(40, max(5, one.values.size // 5)), orientation="horizontal", color="#9dbfdc"
    )
    axes.set_ylim(chart.get_ylim())
    axes.tick_params(labelleft=False)
