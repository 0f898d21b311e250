"""A few hidden effects, the command from file to verdict, and the helpers of the study; the full study is
test_study.py.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from femu_piezo.errors import InputError
from femu_piezo.study.model_cache import SharedBases
from hidden_effects import study
from hidden_effects.catalogue import EFFECTS, NAMES
from hidden_effects.confusion import rates
from hidden_effects.draws import DENSITY, PZT5H, _drawn, draw
from hidden_effects.judge import Outcome, judge_draw
from hidden_effects.ritz import RitzPlate
from tests.commands import invoked, succeeded


@pytest.fixture(scope="module")
def bases():
    return SharedBases()


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["none", "wrong_width"])
def test_hidden_effect_is_named(effect, tmp_path, bases):
    outcome = judge_draw(draw(effect, 7, variant=False), tmp_path, bases)
    assert outcome.word == ("none" if effect == "none" else "effect")
    if effect != "none":
        assert outcome.kind == "single" and outcome.detectable and outcome.first
        assert abs(outcome.sizes["wrong_width.relative_error"]) < 3
        assert outcome.confident
        assert outcome.ratio[0] < 1.3 < outcome.ratio[1]
        assert outcome.misfit == pytest.approx(1.0, abs=0.15)
        assert outcome.chances["wrong_width"] >= outcome.said["wrong_width"] > 0.9
        value, std, truth = outcome.causes["wrong_width.relative_error"]
        assert (value - truth) / std == outcome.sizes["wrong_width.relative_error"]
    else:
        assert outcome.sigma == () and not outcome.said
        assert max(outcome.chances.values()) < 0.5
    assert len(outcome.chances) > 15 and all(0 <= chance <= 1 + 1e-12 for chance in outcome.chances.values())
    value, std, truth = outcome.constants["tan_s11"]
    assert truth == pytest.approx(0.016, abs=0.0041) and (value - truth) / std == outcome.bias["tan_s11"]


def test_command_names_the_cause_and_the_extended_specimen_has_none(tmp_path):
    """diagnosis.json names the resistance, and constants have no bias; the diagnosis of extended.toml finds no
    further cause.
    """
    hidden = draw("series_resistance", 4, variant=False)
    spec = hidden.write(tmp_path)
    succeeded("diagnose", spec, "--out", tmp_path / "a")
    record = json.loads((tmp_path / "a/diagnosis.json").read_text(encoding="utf-8"))
    assert record["verdict"] == "effect"
    (cause,) = record["causes"]
    assert cause["effect"] == "series_resistance"
    found = cause["parameters"]["resistance"]
    assert found["unit"] == "ohm"
    assert abs(found["value"] - hidden.size) < 3 * found["std"] < hidden.size
    gain = record["gain"]
    assert gain["held_out_after"] < 1.3 * gain["noise_floor"] < gain["held_out_before"]
    for name in ("s11", "d31", "eps33T"):
        after, truth = record["parameters"]["after"][name], hidden.theta[NAMES.index(name)]
        assert abs(after["value"] - truth.real) < 4 * after["std"], name
        assert abs(after["tan"] + truth.imag / truth.real) < 4 * after["tan_std"], name
    stray = [item for item in record["not_visible"] if item["effect"] == "stray_capacitance"]
    assert stray and stray[0]["indistinguishable_from"] == ["eps33T"]
    assert any("open fixture" in words for words in record["recommended_measurements"])
    assert (tmp_path / "a/diagnosis.png").stat().st_size > 20000
    succeeded("diagnose", tmp_path / "a/extended.toml", "--out", tmp_path / "b")
    assert json.loads((tmp_path / "b/diagnosis.json").read_text(encoding="utf-8"))["verdict"] == "none"
    succeeded("update", tmp_path / "a/extended.toml", "--out", tmp_path / "c")
    parameters = json.loads((tmp_path / "c/update.json").read_text(encoding="utf-8"))["parameters"]
    assert parameters["s11"]["value"] == pytest.approx(hidden.theta[0].real, rel=1e-3, abs=0)


def test_unknown_effect_in_a_specimen_file_is_one_sentence(tmp_path):
    spec = draw("none", 7).write(tmp_path)
    spec.write_text(spec.read_text(encoding="utf-8") + "[effects.ghost]\nsize = 1.0\n", encoding="utf-8")
    answer = invoked("diagnose", spec, "--out", tmp_path / "out")
    assert answer.exit_code == 2
    assert "ghost" in answer.output and "use one of" in answer.output
    assert answer.output.strip().count("\n") == 0


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("[effects.tapered_width]\ntaper = 0.5\n", "effects.tapered_width.taper = 0.5 is outside 0 … 0.1\n"),
        ("[effects.point_mass]\nmass = 1\nx = 1e-3\ny = 1e-3\n", " kg\n"),
    ],
)
def test_value_of_an_effect_out_of_its_range_is_one_sentence(tmp_path, table, words):
    spec = draw("none", 7, points=31).write(tmp_path)
    spec.write_text(spec.read_text(encoding="utf-8") + table, encoding="utf-8")
    answer = invoked("diagnose", spec, "--out", tmp_path / "out")
    assert answer.exit_code == 2
    assert answer.output.endswith(words) and answer.output.strip().count("\n") == 0


def test_the_global_ritz_model_is_converged():
    """The orders that other tests use against higher ones: within 3e-4 in Z, at the sharp upper resonances."""
    frequency = np.concatenate([np.linspace(20e3, 130e3, 12), np.linspace(180e3, 240e3, 25)])
    theta, size = PZT5H * (1 - 0.015j), (12e-3, 6.9e-3, 1.6e-3)
    coarse = RitzPlate(size, DENSITY, (12, 9, 5)).impedance(theta, frequency)
    fine = RitzPlate(size, DENSITY, (16, 12, 7)).impedance(theta, frequency)
    assert np.max(np.abs(coarse / fine - 1)) < 3e-4


def _outcome(kind: str, truth: tuple[str, ...], sigma: float, word: str, said: dict, alike=(), **more) -> Outcome:
    names = {cause: list(alike) for cause in said}
    return Outcome("x", 1, kind, truth, (sigma,) * len(truth), word, said, names, **more)


def test_counts_of_the_study():
    """Which outcomes count as first, in a class, confident and detectable; and rates with their intervals."""
    right = _outcome("single", ("leakage",), 20, "effect", {"leakage": 0.99}, sizes={"leakage.conductance": 3.5})
    beside = _outcome("single", ("s",), 20, "effect", {"leakage": 0.95}, alike=("s",))
    weak = _outcome("single", ("s",), 7.9, "none", {})
    second = _outcome("single", ("s",), 30, "effect", {"leakage": 0.9, "s": 0.9})
    assert (right.first, right.in_class, beside.first, beside.in_class) == (True, True, False, True)
    assert not weak.detectable and not second.first and not second.in_class
    pair = _outcome("pair", ("a", "b"), 9, "effect", {"b": 0.9, "c": 0.8}, alike=("a",))
    assert not pair.first and pair.in_class
    strange = _outcome("undescribed", ("second_piece",), 50, "effect", {"leakage": 0.91})
    doubt = _outcome("undescribed", ("second_piece",), 50, "unknown", {"leakage": 0.91})
    assert strange.confident and not doubt.confident
    null = _outcome("null", (), 0, "none", {})
    found = {rate.words: rate for rate in rates([right, beside, weak, second, pair, strange, doubt, null])}
    assert (found["single effects: first"].count, found["single effects: first"].total) == (1, 3)
    assert found["single effects: first or in its class"].count == 2
    assert found["size within 3 σ"].count == 0 and not found["size within 3 σ"].holds
    assert (found["nulls: none"].count, found["undescribed: no confident name"].count) == (1, 1)
    assert "33.3% (95 %: 0.8% to 90.6%)" in found["single effects: first"].line()  # Clopper-Pearson of 1 in 3


def test_study_goes_on_where_it_ended(tmp_path, monkeypatch):
    """Outcomes of finished draws come from the file; the others are computed and appended to it."""
    null = _outcome("null", (), 0, "none", {})
    monkeypatch.setattr(study, "judged", lambda job: replace(null, name=job[0], seed=job[1]))
    file = tmp_path / "results.jsonl"
    first = list(study.run([("none", 1), ("none", 2)], results=file))
    monkeypatch.setattr(study, "judged", lambda job: pytest.fail("computed again") if job[1] < 3 else first[0])
    again = list(study.run([("none", 2), ("none", 1), ("none", 3)], results=file))
    assert again[:2] == first[::-1] and len(again) == 3
    assert len(file.read_text(encoding="utf-8").splitlines()) == 3


def test_jobs_of_a_study():
    """Every effect as often as asked, pairs of two different effects, and undescribed effects of at least eight
    kinds.
    """
    found = study.jobs(list(EFFECTS), draws=2, nulls=3, pairs=10, undescribed=10, seed=5)
    names = [name for name, _ in found]
    assert all(names.count(effect) == 2 for effect in EFFECTS) and names.count("none") == 3
    pairs = [name.split("+") for name in names if "+" in name]
    assert len(pairs) == 10 and all(a != b and {a, b} <= set(EFFECTS) for a, b in pairs)
    assert len({name for name in names if name.startswith("undescribed:")}) >= 8
    assert len(set(found)) == len(found)


def test_specimens_are_passive():
    """The first attempt of this draw, a bar with k33² = 0.56, has losses that would create energy; the draw itself
    has not.
    """
    assert _drawn("wrong_length", 4005, 31, None, []).clean.real.min() < 0
    assert draw("wrong_length", 4005, points=31).clean.real.min() > 0


def test_refused_sweep_counts_as_missed(tmp_path, monkeypatch):
    """A sweep that the diagnosis refuses is detectable, is not named, and makes a rate fail."""

    def refuse(specimen, bases):
        raise InputError("no")

    monkeypatch.setattr("hidden_effects.judge.diagnose", refuse)
    outcome = judge_draw(draw("series_resistance", 2, points=31), tmp_path)
    assert outcome.word == "refused" and outcome.detectable and not outcome.in_class
    assert not all(rate.holds for rate in rates([outcome]))
