"""Statistics of lots with known outliers and drifts; false alarms in lots without."""

from __future__ import annotations

import re

import numpy as np
import pytest

from femu_piezo.batch.lot import lot_of, lot_text
from femu_piezo.batch.lot_figure import lot_figure

CENTRE, SIGMA = 16.5e-12, 0.2e-12


def rows(values: np.ndarray, note: str = "") -> list[dict]:
    """Rows of a table with values of s11."""
    return [
        {"number": i, "file": f"p{i}.csv", "status": "ok", "reason": "", "s11": v, "s11_std": SIGMA / 10, "notes": note}
        for i, v in enumerate(values.tolist(), 1)
    ]


def clean(count: int, seed: int) -> np.ndarray:
    """Values of a lot without outliers and drift."""
    return CENTRE + SIGMA * np.random.default_rng(seed).standard_normal(count)


@pytest.mark.parametrize("count", [8, 20, 60, 300])
def test_clean_lots_raise_few_alarms(count):
    """Each kind of alarm occurs in at most 5 % of clean lots by design; 20 of 200 lots are three standard deviations
    more.
    """
    lots = [lot_of(rows(clean(count, seed))) for seed in range(200)]
    assert sum(bool(lot.outliers) for lot in lots) <= 20
    assert sum(lot.distributions[0].drifts for lot in lots) <= 20


def test_robust_spread_and_limits():
    values = clean(400, 1)
    values[:8] *= 3
    one = lot_of(rows(values)).distributions[0]
    assert one.centre == pytest.approx(CENTRE, rel=1e-2, abs=0)
    assert one.sigma == pytest.approx(SIGMA, rel=0.15, abs=0)
    assert one.limits == pytest.approx((one.centre - 3 * one.sigma, one.centre + 3 * one.sigma), rel=1e-6, abs=0)
    assert one.measurement == pytest.approx(SIGMA / 10, rel=1e-6, abs=0)


def test_outliers_are_named_with_their_reason():
    values = clean(50, 2)
    values[16] += 8 * SIGMA
    lot = lot_of(rows(values, note="a jump at 90 kHz"))
    assert [item.file for item in lot.outliers] == ["p17.csv"]
    assert "above the median" in lot.outliers[0].reason
    assert "outlier p17.csv: s11" in lot_text(lot) and "a jump at 90 kHz" in lot_text(lot)
    one = lot.distributions[0]
    median, value = f"{1e12 * one.centre:.5g} 10⁻¹² m²/N", f"s11 = {1e12 * values[16]:.5g} 10⁻¹² m²/N is "
    assert f"median {median}, " in lot_text(lot) and value in lot_text(lot) and f"the lot ({median})" in lot_text(lot)
    assert f"{1e12 * one.limits[1]:.5g} 10⁻¹² m²/N ({one.beyond} beyond)" in lot_text(lot)
    assert f"s11 = {values[16]:.5g} is " in lot.outliers[0].reason  # lot.json is in SI units


def test_notes_of_at_least_half_of_the_updates_are_told_once():
    """In the words of the first; numbers and names of constants and specimens differ from piece to piece."""
    every = rows(clean(6, 4))
    for number, row in enumerate(every):
        row["specimen"] = f"p{number}"
        row["notes"] = f"held: {('s12', 'tan_d33')[number % 2]} {number - 2:+} % · p{number}: off by 0.0{number}"
        row["notes"] += " · held: s13 5 %"
    for row in every[:2]:
        row["notes"] += " · poles and zeros: a jump"
    every[2]["notes"] += " · poles and zeros: something else"
    every[5]["notes"] = ""
    lot = lot_of(every)
    assert lot.notes == ((5, "held: s12 -2 %"), (5, "off by 0.00"))
    assert "5 of 6 updates, the first: off by 0.00" in lot_text(lot) and "a jump" not in lot_text(lot)
    assert {"count": 5, "note": "held: s12 -2 %"} in lot.to_json()["notes"]
    assert not lot_of(rows(clean(1, 4), note="a jump at 90 kHz")).notes


def test_a_small_lot_says_that_values_beyond_its_limits_are_not_counted():
    values = CENTRE * (1 + 1e-4 * np.arange(5.0))
    values[4] *= 1.1
    lot = lot_of(rows(values))
    assert "(values beyond are not counted)" in lot_text(lot) and "0 beyond" not in lot_text(lot)
    assert "outliers are not looked for" in lot_figure(lot).get_suptitle()
    assert lot.to_json()["quantities"]["s11"]["beyond_limits"] == 0


def test_one_value_has_no_spread():
    text = lot_text(lot_of(rows(np.array([CENTRE]))))
    assert "one value" in text and "robust" not in text and "limits " not in text.splitlines()[1]


def test_axes_of_the_chart_have_no_offset():
    figure = lot_figure(lot_of(rows(-2.74e-10 * (1 + 1e-5 * np.arange(9.0)))))
    figure.draw_without_rendering()
    assert figure.axes[0].yaxis.get_offset_text().get_text() == ""


def test_far_outliers_do_not_set_the_scale_of_the_chart():
    values = clean(40, 4)
    values[7] *= 50
    values[20] += 9 * SIGMA
    figure = lot_figure(lot_of(rows(values)))
    low, high = figure.axes[0].get_ylim()
    assert 12 * SIGMA < (high - low) / 1e12 < 20 * SIGMA
    words = [text.get_text() for text in figure.axes[0].texts]
    assert sorted(words) == ["p21", f"p8 ({values[7] * 1e12:.4g})"]


def test_drift_is_found_and_outliers_are_those_from_its_line():
    ramp = np.linspace(-3, 3, 100) * SIGMA
    values = clean(100, 3) + ramp
    values[5] += 9 * SIGMA  # near the median of the lot, far from the line of its drift
    lot = lot_of(rows(values))
    assert lot.distributions[0].drifts
    assert lot.distributions[0].drift == pytest.approx(6 * SIGMA, rel=0.2, abs=0)
    assert [item.file for item in lot.outliers] == ["p6.csv"]
    told, side, line = re.search(
        r"outlier p6.csv: \S+ = ([\d.]+) .* σ (above|below) .* \(([\d.]+) ", lot_text(lot)
    ).groups()
    assert (float(told) > float(line)) == (side == "above")
    assert float(line) == pytest.approx(1e12 * lot.distributions[0].line[5], rel=1e-3)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_growing_magnitude_drifts_upwards_in_per_cent(sign):
    """Whatever the sign of the constant, as d31 has: 6 σ of 1.2 % each."""
    values = sign * (clean(100, 3) + np.linspace(-3, 3, 100) * SIGMA)
    assert "drifts by +7." in lot_text(lot_of(rows(values)))


def test_failed_rows_count_and_equal_values_are_no_outliers():
    lot = lot_of([*rows(np.full(20, CENTRE)), {"number": 21, "file": "x", "status": "failed", "reason": "broken"}])
    assert lot.counts == {"specimens": 21, "ok": 20, "failed": 1, "lost": 0}
    assert lot.faults == (("x", "broken"),)
    assert not lot.outliers and not lot.distributions[0].drifts
    assert len(lot_figure(lot).axes) == 2


def test_a_result_that_does_not_follow_its_sweep_is_told_in_any_lot():
    """Of three results one is doubtful: too few for outliers, and told all the same."""
    every = rows(clean(3, 1))
    every[1]["doubt"] = "the updated model differs from the sweep by 55 % rms"
    lot = lot_of(every)
    assert lot.doubtful == (("p2.csv", every[1]["doubt"]),)
    assert f"doubtful result of p2.csv: {every[1]['doubt']}" in lot_text(lot)


def test_only_results_count_as_several_pieces_of_one_sweep():
    every = [*rows(clean(3, 1)), {"number": 4, "file": "x", "status": "failed", "reason": "broken"}]
    lot = lot_of(every, [("p1.csv", "x"), ("p2.csv", "p3.csv", "x")])
    assert lot.same == (("p2.csv", "p3.csv"),)


def test_narrow_limits_have_digits_that_tell_them_apart():
    """A spread of 1e-7: limits are told to a tenth of their distance, an outlier by as many digits as show it."""
    values = CENTRE * (1 + 1e-7 * np.random.default_rng(3).normal(size=40))
    values[4] = CENTRE * (1 + 1e-5)
    lot = lot_of(rows(values))
    words = lot_text(lot)
    low, high = (float(text) for text in re.search(r"limits ([\d.]+) … ([\d.]+)", words).groups())
    (one,) = lot.distributions
    limits = 1e12 * np.array(one.limits)
    assert [low, high] == pytest.approx(limits, rel=0, abs=0.1 * np.ptp(limits))
    told, centre = re.search(r"outlier p5.csv: \S+ = ([\d.]+) .* \(([\d.]+) ", words).groups()
    assert float(told) / float(centre) - 1 == pytest.approx(1e-5, rel=0.05)


def test_an_empty_lot_is_reported():
    lot = lot_of([{"number": 1, "file": "x", "status": "lost", "reason": "died"}])
    assert "1 lost" in lot_text(lot)
    assert lot_figure(lot) is not None


@pytest.mark.parametrize("count", [1, 2, 5, 40])
def test_serial_numbers_and_counts_are_whole(count):
    """Ticks of the charts are integers, also for a lot with one result."""
    figure = lot_figure(lot_of(rows(clean(count, 1))))
    figure.draw_without_rendering()
    for axes in figure.axes:
        ticks = axes.get_xticks()
        assert ticks.size and np.array_equal(ticks, np.round(ticks))
