"""The formulas of `calibration` on simulated results: right probabilities pass, overconfident ones are detected."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from scipy.stats import norm

from hidden_effects.calibration import NAMED, band, brier, calibration, main, reliability, report, transform
from hidden_effects.confusion import clopper_pearson
from hidden_effects.judge import Outcome

CONSTANTS = ("s11", "tan_s11", "d31", "tan_d31")


def _draws(count: int, boast: float = 1.0, seed: int = 1) -> list[Outcome]:
    """Draws with one cause named each.

    boast : factor by which log odds and errors over deviations are overstated
    """
    rng = np.random.default_rng(seed)
    found = []
    for number in range(count):
        odds = rng.uniform(-1.0, 5.0)
        there = rng.random() < 1 / (1 + np.exp(-odds))
        stated = float(1 / (1 + np.exp(-boast * odds)))
        common = rng.standard_normal()  # errors of the constants of a draw are correlated
        bias = {name: boast * (0.6 * common + 0.8 * rng.standard_normal()) for name in CONSTANTS}
        sizes = {"leakage.conductance": boast * rng.standard_normal()} if there else {}
        truth = ("leakage",) if there else ("coating",)
        chances = {"leakage": stated, "coating": 1 - stated}
        said, alike = {"leakage": stated}, {"leakage": []}
        one = Outcome("leakage", number, "single", truth, (20.0,), "effect", said, alike)
        below = {name: float(norm.cdf(-deviations)) for name, deviations in bias.items()}
        found.append(replace(one, sizes=sizes, bias=bias, chances=chances, below=below))
    return found


def test_right_probabilities_and_deviations_pass():
    """2000 draws: bins, Brier's score, uniformity of u, and which draws are counted where."""
    found = calibration(_draws(2000))
    for ends, (chance, was) in ((NAMED, found.named), (np.linspace(0, 1, 6), found.candidates)):
        assert all(one.holds for one in reliability(chance, was, ends))
    assert abs(brier(*found.named).deviations) < 2
    assert found.averaged_constants.all == pytest.approx(found.all_constants.all, abs=1e-9)
    for one in (found.constants, found.all_constants, found.sizes):
        assert one.p_value > 0.05
        shares = np.histogram(one.all, np.linspace(0, 1, 11))[0] / one.all.size
        low, high = band(one.draws)
        assert low < shares.min() and shares.max() < high
    assert found.constants.draws == found.sizes.draws == found.named[1].sum() < 2000 == found.all_constants.draws
    hidden = [
        replace(one, sigma=(1.0,)) for one in _draws(50)
    ]  # effects that the sweep does not show (below the detectable misfit)
    assert calibration([*hidden, *_draws(20)]).shown_constants.draws == 20


def test_overconfident_probabilities_and_deviations_are_detected():
    """Log odds and errors over deviations overstated by a factor of 2: every measure detects it with 300 draws."""
    found = calibration(_draws(300, boast=2.0))
    assert not all(one.holds for one in reliability(*found.named, NAMED))
    assert brier(*found.named).deviations > 4
    assert found.all_constants.p_value < 1e-4 and found.constants.p_value < 1e-3
    shares = np.histogram(found.all_constants.all, np.linspace(0, 1, 11))[0] / found.all_constants.all.size
    assert min(shares[0], shares[-1]) > band(found.all_constants.draws)[1]  # u accumulates at both ends
    count, total = found.all_constants.within(2)
    assert clopper_pearson(count, total)[1] < 0.9
    assert "NOT WITHIN" in report(found)


def test_bias_of_one_constant_is_found_among_many():
    """The smallest p-value over the constants, times their number."""
    draws = [one.bias for one in _draws(300)]
    assert transform(draws).p_value > 0.05
    assert transform([{**one, "d31": one["d31"] + 0.5} for one in draws]).p_value < 1e-6


def test_figures_by_hand():
    """Clopper-Pearson intervals of 1 in 3 and of 0 in 10 (1 − 0.025^(1/10)), Brier's score of four probabilities,
    and bins.
    """
    assert clopper_pearson(1, 3) == pytest.approx((0.0084, 0.9057), abs=1e-4)
    assert clopper_pearson(0, 10) == pytest.approx((0.0, 1 - 0.025**0.1))
    score = brier(np.array([0.8, 0.8, 0.5, 0.5]), np.array([True, False, True, False]))
    assert score.score == pytest.approx((0.04 + 0.64 + 0.25 + 0.25) / 4)
    assert score.expected == pytest.approx((0.16 + 0.16 + 0.25 + 0.25) / 4)
    # Σ(p − y)² − Σp(1 − p) = 0.36 over √Σ(1 − 2p)² p(1 − p) = √(2 · 0.36 · 0.16)
    assert score.deviations == pytest.approx(0.36 / np.sqrt(2 * 0.36 * 0.16))
    lower, upper = reliability(np.array([0.1, 0.3, 1.0]), np.array([False, True, True]), np.array([0.0, 0.5, 1.0]))
    assert (lower.mean, lower.count, lower.total) == (pytest.approx(0.2), 1, 2)
    assert (upper.mean, upper.count, upper.total) == (1.0, 1, 1)


def test_command_writes_table_and_pictures(tmp_path, capsys):
    """Also for results without probabilities of all candidates, and for results without any cause."""
    rows = [asdict(one) for one in _draws(20)]
    for row in rows[:10]:
        del row["chances"]
    results = tmp_path / "results.jsonl"
    for kept in (rows, [{**row, "said": {}, "word": "none", "sizes": {}} for row in rows[:3]]):
        results.write_text("".join(json.dumps(row) + "\n" for row in kept), encoding="utf-8")
        main([str(results), "--out", str(tmp_path / "out")])
    first, second = capsys.readouterr().out.split("probabilities of named causes: ")[1:]
    assert first.startswith("20 stated") and "all candidates: 20 stated" in first and second.startswith("0 stated")
    assert all((tmp_path / "out" / name).stat().st_size > 5000 for name in ("reliability.png", "transform.png"))
