"""Control charts against published numbers, and drifts against simulated ones."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from scipy import stats

from femu_piezo.store.control import MONTH_S, controls, individuals, lot_means, trend
from femu_piezo.store.figure import lots_figure


def test_individuals_of_the_handbook():
    """NIST/SEMATECH e-Handbook of Statistical Methods, 6.3.2.2: flow rates with limits 45.8 and 55.8."""
    chart = individuals(np.array([49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1]))
    assert chart.centre == pytest.approx(50.81)
    assert chart.limits == pytest.approx((45.8159, 55.8041), abs=2e-3)  # the handbook takes d2 = 1.128
    assert not chart.beyond and not chart.shifted


def test_a_shift_and_an_outlier_are_marked():
    values = np.tile([-1.0, 1.0], 20)
    values[7] = 9.0
    values[20:30] = 0.7
    chart = individuals(values)
    assert chart.beyond == (7,) and chart.shifted == (
        27,
        28,
        29,
    )  # values 19 to 29 lie above the mean, the last three after eight in a row


def test_means_of_lots():
    """Limits of a lot of four are half as far apart as those of single pieces; lots are in order of time."""
    values = np.array([9.0, 11, 9, 11, 10, 14])
    chart = lot_means(["b"] * 4 + ["a"] * 2, np.array([5.0, 5, 5, 5, 1, 1]), values)
    within = np.sqrt((4 * 1 + 2 * 4) / 4)
    assert chart.lots == ("a", "b") and chart.mean.tolist() == [12, 10] and chart.count.tolist() == [2, 4]
    assert chart.within == pytest.approx(within)
    assert chart.limits[1] - chart.centre == pytest.approx([-1.5 * within, 1.5 * within])
    assert lot_means(["a", "b"], np.zeros(2), values[:2]).within is None


@pytest.mark.parametrize(("lots", "between"), [(4, 0.0), (4, 0.01), (8, 0.003), (24, 0.01)])
def test_the_deviation_of_a_drift_covers_the_truth(lots, between):
    """600 simulated productions with 10 pieces in each lot: the 90 % interval holds the true slope in 87 to 97 % of
    them.
    """
    rng, held = np.random.default_rng(lots), 0
    time, variance, slope = np.arange(lots) * MONTH_S, np.full(lots, 0.01**2 / 10), -0.002
    for _ in range(600):
        means = 1 + slope * np.arange(lots) + np.hypot(between, 0.01 / np.sqrt(10)) * rng.standard_normal(lots)
        found = trend(time, means, variance)
        held += abs(found.per_month - slope) < found.std * stats.t.isf(0.05, found.freedom)
    assert held > 0.87 * 600
    assert lots < 8 or held < 0.97 * 600  # with few lots the interval may be too wide


def test_a_single_day_or_two_lots_have_no_trend():
    assert trend(np.linspace(0, 3600, 50), np.linspace(1, 2, 50), np.zeros(50)) is None
    assert trend(np.arange(2) * MONTH_S, np.array([1.0, 2.0]), np.zeros(2)) is None


@pytest.mark.parametrize(("lots", "days"), [(1, 2.0), (3, 60.0)])
def test_axes_of_the_chart_have_whole_pieces_and_the_days_of_the_lots(lots, days):
    start = datetime(2026, 11, 27, 12, tzinfo=UTC)
    rows = [
        {
            "status": "ok",
            "lot": f"$x_$ {n % lots}",
            "measured": start + timedelta(days=30 * (n % lots)),
            "k_eff": 0.4 + 0.01 * n,
        }
        for n in range(4)
    ]
    figure = lots_figure(controls(rows))
    figure.draw_without_rendering()
    pieces, times = (axes.xaxis for axes in figure.axes[-2:])
    assert all(float(label.get_text()).is_integer() for label in pieces.get_ticklabels())
    assert np.ptp(times.get_view_interval()) == pytest.approx(days, rel=0.2)
