"""The chart of an uncertainty budget: bars of the right length, and no overlapping texts."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from femu_piezo.inference.budget import SOURCES
from femu_piezo.inference.unknowns import Estimate
from femu_piezo.output.budget_chart import budget_figure, budget_shares


def estimate(value: float, parts: dict[str, float], tan_parts: dict[str, float]) -> Estimate:
    std, tan_std = (float(np.sqrt(sum(part**2 for part in own.values()))) for own in (parts, tan_parts))
    return Estimate(value, std, 0.02, tan_std, parts, tan_parts)


@pytest.fixture
def parameters():
    """Two constants with every source of uncertainty; those of the second include parts too small to be shown."""
    every = {source: 1e-14 * number for number, source in enumerate(SOURCES, 1)}
    few = {"noise": 3e-12, "geometry": 4e-12, "held": 1e-15}
    return {
        "s11": estimate(16e-12, every, {"noise": 1e-5, "instrument": 1e-4}),
        "d31": estimate(-270e-12, few, {"noise": 2e-4}),
    }


def test_bars_are_shares_of_the_variance(parameters):
    shares = budget_shares(parameters)
    assert list(shares) == ["s11", "tan s11", "d31", "tan d31"]
    assert [sum(parts.values()) for parts in shares.values()] == pytest.approx([1.0] * 4)
    assert shares["d31"]["geometry"] == pytest.approx(16 / 25, rel=1e-6)
    (axes,) = budget_figure("budget", parameters).axes
    widths = {bars.get_label(): [bar.get_width() for bar in bars] for bars in axes.containers}
    assert widths["dimensions"][2] == pytest.approx(64, rel=1e-6) and widths["dimensions"][3] == 0
    for row in range(4):
        bars = [container[row] for container in axes.containers]
        starts = np.cumsum([0.0, *(bar.get_width() for bar in bars)])
        assert [bar.get_x() for bar in bars] == pytest.approx(starts[:-1], abs=1e-9)
        assert starts[-1] == pytest.approx(100, abs=0.5)  # parts below 0.5 % are left out
    colours = [container[0].get_facecolor() for container in axes.containers]
    assert len(set(colours)) == len(colours) == len(SOURCES)


def test_nothing_overlaps(parameters):
    """Numbers in the bars, deviations beside them, names of the rows, the legend and the label of the axis."""
    figure = budget_figure("a plate of a long name: where the deviations come from", parameters)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    (axes,), (legend,) = figure.axes, figure.legends
    texts = [one for one in (*axes.texts, *axes.get_yticklabels(), axes.xaxis.label, axes.title) if one.get_text()]
    boxes = [one.get_window_extent(canvas.get_renderer()) for one in (*texts, legend)]
    assert len(boxes) > 12
    assert not [1 for one, other in combinations(boxes, 2) if one.overlaps(other)]
    inside = figure.bbox
    assert all(inside.x0 <= box.x0 and box.x1 <= inside.x1 and inside.y0 <= box.y0 for box in boxes)
    assert axes.get_xlabel() == "share of the variance (%)"


def test_without_a_budget_there_is_no_bar():
    assert budget_shares({"s11": Estimate(16e-12, 1e-14, 0.02, 1e-4), "d31": Estimate(-1e-12, None, 0.0, None)}) == {}
