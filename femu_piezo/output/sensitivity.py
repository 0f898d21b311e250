"""Picture of the sensitivity of a sweep to each constant (the paper's figure 3)."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from femu_piezo.inference.sensitivity import Sensitivity
from femu_piezo.material.constants import D_FORM
from femu_piezo.output.curves import GRID, MEASURED, frequency_axis
from femu_piezo.output.picture import Picture, as_it_stands

#: Colour of each constant, the same in every picture.
COLOURS = dict(
    zip(
        D_FORM,
        ("#1f4e79", "#2e86c1", "#85c1e9", "#148f77", "#7dcea0", "#c0392b", "#e67e22", "#f5b041", "#6c3483", "#a569bd"),
        strict=True,
    )
)


def sensitivity_figure(result: Sensitivity) -> Figure:
    """|Z| above; below, |∂log Z/∂log θ| of every constant that matters by more than 1e-4 of the strongest."""
    figure = Picture(figsize=(8.0, 6.0), layout="constrained")
    magnitude, slopes = figure.subplots(2, 1, sharex=True, height_ratios=[1, 2])
    factor, label, scale = frequency_axis(result.frequency)
    x = result.frequency * factor
    magnitude.semilogy(x, np.abs(result.impedance), color=MEASURED["color"], linewidth=1.2)
    size = np.abs(result.values)
    for name in result.strongest():
        values = size[:, D_FORM.index(name)]
        if values.max() > 1e-4 * size.max():
            slopes.semilogy(x, values, color=COLOURS[name], label=name, linewidth=1.3)
    magnitude.set(
        ylabel="|Z| (Ω)", xscale=scale, title=f"{as_it_stands(result.title)}: sensitivity of Z to each constant"
    )
    slopes.set(ylabel="|∂ log Z / ∂ log θ|", xlabel=label, ylim=(1e-4 * size.max(), 2 * size.max()))
    slopes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    for axes in (magnitude, slopes):
        axes.grid(True, **GRID)
    return figure
