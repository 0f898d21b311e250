"""Picture of constants over temperature, as sweeps at several temperatures determine them."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from femu_piezo.output.curves import GRID, PRINTED, UPDATED
from femu_piezo.output.picture import Picture, as_it_stands
from femu_piezo.study.temperature import TemperatureSeries
from femu_piezo.units import number

#: Points of a drawn line.
_POINTS = 61


def temperature_figure(title: str, series: TemperatureSeries) -> Figure:
    """Every free constant and its tangent over temperature ± one standard deviation, dots at temperatures of sweeps."""
    names = tuple(series.coefficients)
    picture = Picture(figsize=(3.4 * len(names), 5.2), layout="constrained")
    axes = picture.subplots(2, len(names), squeeze=False, sharex=True)
    celsius = np.linspace(min(series.measured_C), max(series.measured_C), _POINTS)
    lines, at_sweeps = series.over(celsius), series.over(np.array(series.measured_C))
    for column, name in enumerate(names):
        factor, unit = PRINTED[name]
        one = series.coefficients[name]
        rows = ((name, factor, f"{name} ({unit})"), (f"tan_{name}", 1.0, f"tan {name}"))
        for row, (label, times, words) in enumerate(rows):
            panel, (value, std) = axes[row, column], lines[label]
            band = times * (value - std), times * (value + std)
            panel.fill_between(celsius, *band, color=UPDATED["color"], alpha=0.2, linewidth=0)
            panel.plot(celsius, times * value, **UPDATED)
            panel.plot(series.measured_C, times * at_sweeps[label][0], "o", color=UPDATED["color"], markersize=4)
            panel.set_ylabel(words)
            panel.grid(True, **GRID)
        for row, (slope, std) in enumerate(((one.relative, one.std), (one.tangent, one.tangent_std))):
            axes[row, column].set_title(f"({number(1e6 * slope, 1e6 * std)}) · 10⁻⁶/K", fontsize="medium")
        axes[1, column].set_xlabel("temperature (°C)")
    picture.suptitle(f"{as_it_stands(title)}: constants over temperature, ± one standard deviation")
    return picture
