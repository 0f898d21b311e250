"""Corner picture of posterior samples: the histogram of every constant, and every pair against each other."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from femu_piezo.inference.sampling import Samples
from femu_piezo.inference.unknowns import Estimate
from femu_piezo.output.curves import PRINTED, UPDATED
from femu_piezo.output.picture import Picture
from femu_piezo.output.tables import number

#: Places of a Gaussian.
_POINTS = 120


def corner_figure(title: str, samples: Samples, parameters: dict[str, Estimate]) -> Figure:
    """Samples of the free constants and tangents; the line is the Gaussian of the stated deviation.

    Every column has one axis, and histograms as many bins as the number of samples bears (Freedman, Diaconis, 1981).
    """
    rows = [row for name, one in parameters.items() for row in _rows(name, one)]
    size = len(rows)
    picture = Picture(figsize=(1.9 * size + 1.0, 1.9 * size + 0.6), layout="constrained")
    axes = picture.subplots(size, size, squeeze=False, sharex="col")
    for i, (name, words, times, value, std) in enumerate(rows):
        for j, (other, _, factor, *_) in enumerate(rows):
            own = axes[i, j]
            if j > i:
                own.set_axis_off()
                continue
            if i == j:
                own.hist(times * samples.of(name), "auto", density=True, color="#d0d7de")
                at = np.linspace(value - 3.5 * std, value + 3.5 * std, _POINTS)
                own.plot(at, np.exp(-0.5 * ((at - value) / std) ** 2) / (std * np.sqrt(2 * np.pi)), **UPDATED)
                own.set_yticks([])
                own.set_title(number(value, std), fontsize="small")
            else:
                own.plot(factor * samples.of(other), times * samples.of(name), ".", color="#1f4e79", markersize=2)
            own.tick_params(labelsize=6, labelbottom=i == size - 1, labelleft=j == 0 < i)
            own.locator_params(nbins=3)
            own.ticklabel_format(style="plain", useOffset=False)
            own.tick_params(axis="x", labelrotation=30)
            if i == size - 1:
                own.set_xlabel(rows[j][1], fontsize="small")
            if j == 0 < i:
                own.set_ylabel(words, fontsize="small")
    picture.suptitle(f"{title}: {len(samples.values)} samples of the posterior")
    return picture


def _rows(name: str, one: Estimate) -> list[tuple[str, str, float, float, float]]:
    """Unknown, its words, what it is printed in, value and deviation in that, of a constant and its tangent."""
    factor, unit = PRINTED[name]
    return [
        (name, f"{name} ({unit})", factor, factor * one.value, factor * one.std),
        (f"tan_{name}", f"tan {name}", 1.0, one.tan, one.tan_std),
    ]
