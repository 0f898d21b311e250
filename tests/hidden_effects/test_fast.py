"""A few hidden effects, and the command end to end. The full study is test_study.py."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from femu_piezo.cli import main
from hidden_effects.draws import NAMES, draw
from hidden_effects.judge import judge_draw


@pytest.mark.parametrize("effect", ["none", "wrong_width"])
def test_hidden_effect_is_named(effect, tmp_path):
    outcome = judge_draw(draw(effect, 7), tmp_path)
    assert outcome.truth
    assert outcome.word == ("none" if effect == "none" else "effect")
    if effect != "none":
        assert outcome.sigma > 8
        assert abs(outcome.deviation) < 3
        assert outcome.probability > 0.9


def test_command_names_the_cause_and_the_extended_specimen_has_none(tmp_path):
    """diagnosis.json by the contract; the bias of the constants gone; extended.toml is diagnosed as none."""
    hidden = draw("series_resistance", 8)
    spec = hidden.write(tmp_path)
    run = CliRunner()
    answer = run.invoke(main, ["diagnose", str(spec), "--out", str(tmp_path / "a")])
    assert answer.exit_code == 0, answer.output
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
    again = run.invoke(main, ["diagnose", str(tmp_path / "a/extended.toml"), "--out", str(tmp_path / "b")])
    assert again.exit_code == 0, again.output
    assert json.loads((tmp_path / "b/diagnosis.json").read_text(encoding="utf-8"))["verdict"] == "none"
    updated = run.invoke(main, ["update", str(tmp_path / "a/extended.toml"), "--out", str(tmp_path / "c")])
    assert updated.exit_code == 0, updated.output
    parameters = json.loads((tmp_path / "c/update.json").read_text(encoding="utf-8"))["parameters"]
    assert parameters["s11"]["value"] == pytest.approx(hidden.theta[0].real, rel=1e-3)


def test_unknown_effect_in_a_specimen_file_is_one_sentence(tmp_path):
    spec = draw("none", 7).write(tmp_path)
    spec.write_text(spec.read_text(encoding="utf-8") + "[effects.ghost]\nsize = 1.0\n", encoding="utf-8")
    answer = CliRunner().invoke(main, ["diagnose", str(spec), "--out", str(tmp_path / "out")])
    assert answer.exit_code == 2
    assert "ghost" in answer.output and "known are" in answer.output
    assert answer.output.strip().count("\n") == 0


def test_the_independent_model_is_converged():
    """Ritz orders of the draws against higher ones: 3e-4 in Z at most, at the sharp upper resonances."""
    from hidden_effects.draws import DENSITY, PZT5H
    from hidden_effects.ritz import RitzPlate

    frequency = np.concatenate([np.linspace(20e3, 130e3, 12), np.linspace(180e3, 240e3, 25)])
    theta, size = PZT5H * (1 - 0.015j), (12e-3, 6.9e-3, 1.6e-3)
    coarse = RitzPlate(size, DENSITY, (12, 9, 5)).impedance(theta, frequency)
    fine = RitzPlate(size, DENSITY, (16, 12, 7)).impedance(theta, frequency)
    assert np.max(np.abs(coarse / fine - 1)) < 3e-4
