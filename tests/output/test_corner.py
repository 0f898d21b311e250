"""The corner picture of posterior samples."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from femu_piezo.output.corner import corner_figure


def test_a_column_has_one_axis_and_no_more_bins_than_samples_bear():
    """Samples of s11 have the same axis in its histogram and in the panel below; 50 samples have at most 16 bins."""
    rng = np.random.default_rng(3)
    values = {"s11": rng.normal(16e-12, 1e-13, 50), "tan_s11": rng.normal(0.02, 1e-3, 50)}
    samples = SimpleNamespace(of=values.__getitem__, values=np.zeros((50, 2)))
    estimate = SimpleNamespace(value=16e-12, std=1e-13, tan=0.02, tan_std=1e-3)
    figure = corner_figure("plate", samples, {"s11": estimate})
    first, _, below, _ = figure.axes
    assert first.get_xlim() == below.get_xlim()
    assert 4 <= len(first.patches) <= 16
    assert np.isclose(sum(bar.get_height() * bar.get_width() for bar in first.patches), 1.0)
