"""The picture of several lots: for every quantity, control charts of single pieces and of lots over time."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from femu_piezo.output.curves import PRINTED
from femu_piezo.output.picture import Picture, as_it_stands, margins
from femu_piezo.store.control import MONTH_S, RUN, Control, Drift

_POINT, _LINE, _LIMIT, _BEYOND = "#1f6fb4", "#222222", "#8c8c8c", "#c0392b"
_PIECES = f"single pieces: limits from the moving range of two; red: beyond, orange: {RUN} on one side"
_MEANS = "lots: mean, limits from the scatter within lots; drift ± σ, red where significant"
#: Room beside all charts: left, right, below, above, inches.
_ROOM = 1.0, 0.2, 0.65, 0.4
#: Most lots whose names are written at their points.
_LABELLED = 14


def lots_figure(controls: Sequence[Control]) -> Figure:
    """One row for each quantity: single pieces on the left, lots on the right."""
    rows = max(1, len(controls))
    size = 12.0, 1.05 + 2.3 * rows
    figure = Picture(figsize=size)
    grid = margins(size, *_ROOM) | {"hspace": 0.08, "wspace": 0.2}
    axes = figure.subplots(rows, 2, squeeze=False, sharex="col", gridspec_kw=grid)
    for control, (left, right) in zip(controls, axes, strict=False):
        factor, unit = PRINTED.get(control.quantity, (1.0, ""))
        left.set_ylabel(f"{control.quantity}{f' ({unit})' if unit else ''}")
        _pieces(left, control, factor)
        _lots(right, control, factor)
    if controls:
        axes[0, 0].set_title(_PIECES, fontsize=9)
        axes[0, 1].set_title(_MEANS, fontsize=9)
    else:
        axes[0, 0].text(0.5, 0.5, "no piece has a result", ha="center", transform=axes[0, 0].transAxes)
    axes[-1, 0].set_xlabel("piece, in the order of measurement")
    axes[-1, 0].xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axes[-1, 1].set_xlabel("mean time of measurement (UTC)", loc="left")  # the date stands on the right
    locator = AutoDateLocator()
    axes[-1, 1].xaxis.set_major_locator(locator)
    axes[-1, 1].xaxis.set_major_formatter(ConciseDateFormatter(locator))
    if len({seconds for control in controls for seconds in control.means.time.tolist()}) == 1:
        day = date2num(datetime.fromtimestamp(controls[0].means.time[0], UTC))
        axes[-1, 1].set_xlim(day - 1, day + 1)  # of a single date matplotlib makes an axis of four years
    figure.align_ylabels(axes[:, 0])
    return figure


def _pieces(axes: Axes, control: Control, factor: float) -> None:
    number, values, chart = np.arange(1, control.values.size + 1), factor * control.values, control.individuals
    axes.plot(number, values, ".", color=_POINT, markersize=4, linewidth=0)
    if chart is None:
        return
    axes.axhline(factor * chart.centre, color=_LINE, linewidth=1.0)
    for limit in chart.limits:
        axes.axhline(factor * limit, color=_LIMIT, linewidth=1.0, linestyle="--")
    beyond, shifted = list(chart.beyond), list(chart.shifted)
    axes.plot(number[shifted], values[shifted], ".", color="#e69f00", markersize=4, linewidth=0)
    axes.plot(number[beyond], values[beyond], "o", color=_BEYOND, markerfacecolor="none", markersize=6, linewidth=0)


def _lots(axes: Axes, control: Control, factor: float) -> None:
    means = control.means
    when = date2num([datetime.fromtimestamp(seconds, UTC) for seconds in means.time])
    axes.axhline(factor * means.centre, color=_LINE, linewidth=1.0)
    if means.within is not None:  # own limits for each lot, as lots differ in their number of pieces
        axes.vlines(when, *(factor * means.limits.T), color=_LIMIT, linewidth=6, alpha=0.35)
    axes.plot(when, factor * means.mean, "o", color=_POINT, markersize=5, linewidth=0)
    beyond = list(means.beyond)
    axes.plot(when[beyond], factor * means.mean[beyond], "o", color=_BEYOND, markersize=5, linewidth=0)
    if control.drift is not None:
        _draw_drift(axes, control.drift, means.centre, control.time, factor)
    for index, name in enumerate(means.lots if len(means.lots) <= _LABELLED else ()):
        is_right = 2 * index < len(means.lots)  # in the first half, the name is right of the point
        place = {"xytext": (4 if is_right else -4, 4), "textcoords": "offset points", "fontsize": 7}
        align = "left" if is_right else "right"
        axes.annotate(as_it_stands(name[-18:]), (when[index], factor * means.mean[index]), ha=align, **place)
    axes.margins(x=0.05, y=0.15)
    axes.ticklabel_format(axis="y", useOffset=False)


def _draw_drift(axes: Axes, drift: Drift, centre: float, seconds: np.ndarray, factor: float) -> None:
    months = np.linspace(seconds.min(), seconds.max(), 50) / MONTH_S
    when = date2num([datetime.fromtimestamp(month * MONTH_S, UTC) for month in months])
    line = drift.offset + drift.per_month * (months - drift.at)
    half = drift.std * np.abs(months - drift.at)
    color = _BEYOND if drift.significant else _LIMIT
    axes.plot(when, factor * line, color=color, linewidth=1.2)
    axes.fill_between(when, factor * (line - half), factor * (line + half), color=color, alpha=0.15, linewidth=0)
    if not centre:
        return  # there is no share of it
    words = f"{drift.in_percent(centre)} per month"
    axes.text(0.99, 0.03, words, ha="right", transform=axes.transAxes, fontsize=8, color=color)
