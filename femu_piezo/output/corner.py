"""Corner picture of posterior samples: the histogram of every constant, and every pair against each other."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from femu_piezo.inference.sampling import Samples
from femu_piezo.inference.unknowns import Estimate
from femu_piezo.output.curves import PRINTED, UPDATED
from femu_piezo.output.picture import Picture, as_it_stands
from femu_piezo.units import number

#: Points of a drawn Gaussian.
_POINTS = 120


def corner_figure(title: str, samples: Samples, parameters: dict[str, Estimate]) -> Figure:
    """Samples of each free constant and tangent, as histograms with the Gaussian of value and deviation, and in pairs.

    The plots of a column share their x axis. The bins are the finer of those by Freedman, Diaconis (1981) and Sturges.
    """
    rows = [row for name, estimate in parameters.items() for row in _rows(name, estimate)]
    size = len(rows)
    picture = Picture(figsize=(1.9 * size + 1.0, 1.9 * size + 0.6), layout="constrained")
    axes = picture.subplots(size, size, squeeze=False, sharex="col")
    for i, (name, label, factor_y, value, std) in enumerate(rows):
        for j, (other, _, factor_x, *_) in enumerate(rows):
            panel = axes[i, j]
            if j > i:
                panel.set_axis_off()
                continue
            if i == j:
                panel.hist(factor_y * samples.of(name), "auto", density=True, color="#d0d7de")
                at = np.linspace(value - 3.5 * std, value + 3.5 * std, _POINTS)
                panel.plot(at, np.exp(-0.5 * ((at - value) / std) ** 2) / (std * np.sqrt(2 * np.pi)), **UPDATED)
                panel.set_yticks([])
                panel.set_title(number(value, std), fontsize="small")
            else:
                panel.plot(
                    factor_x * samples.of(other), factor_y * samples.of(name), ".", color="#1f4e79", markersize=2
                )
            panel.tick_params(labelsize=6, labelbottom=i == size - 1, labelleft=j == 0 < i)
            panel.locator_params(nbins=3)
            panel.ticklabel_format(style="plain", useOffset=False)
            panel.tick_params(axis="x", labelrotation=30)
            if i == size - 1:
                panel.set_xlabel(rows[j][1], fontsize="small")
            if j == 0 < i:
                panel.set_ylabel(label, fontsize="small")
    picture.suptitle(f"{as_it_stands(title)}: {len(samples.values)} samples of the posterior")
    return picture


def _rows(name: str, estimate: Estimate) -> list[tuple[str, str, float, float, float]]:
    """(unknown, label, factor from SI, value and deviation times the factor) of a constant and of its tangent."""
    factor, unit = PRINTED[name]
    return [
        (name, f"{name} ({unit})", factor, factor * estimate.value, factor * estimate.std),
        (f"tan_{name}", f"tan {name}", 1.0, estimate.tan, estimate.tan_std),
    ]
