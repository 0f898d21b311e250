"""`identify`: what a sweep can tell before it is measured."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

import femu_piezo as fp
from femu_piezo.errors import ConvergenceError, InputError
from femu_piezo.inference.fit import fit
from femu_piezo.output.noise_study import noise_study_figure
from femu_piezo.study.noise_study import Setting
from tests.commands import invoked, succeeded

BODY = """
name = "{name}"
[geometry]
shape = "plate"
length = "20 mm"
width = "2 mm"
thickness = "{thickness}"
poling = "{poling}"
[material]
base = "pzt-5h"
tan_s11 = 0.015
tan_s33 = 0.015
tan_eps33T = 0.02
[simulation]
start = 100
stop = "{stop}"
points = 301
"""


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    """identifiability.json of a k31 plate with 0.1 % of noise."""
    folder = tmp_path_factory.mktemp("identify")
    spec = folder / "k31.toml"
    spec.write_text(BODY.format(name="k31", thickness="1 mm", poling="thickness", stop="90 kHz"), encoding="utf-8")
    succeeded("identify", spec, "--out", folder / "out", "--noise", "0.001")
    assert (folder / "out" / "sensitivity.png").stat().st_size > 1000
    return json.loads((folder / "out" / "identifiability.json").read_text(encoding="utf-8"))


def test_the_fundamental_of_a_k31_plate_tells_three_constants(record):
    """The paper's choice of unknowns: the sweep of the fundamental determines s11, d31 and ε33T, and no other."""
    well = {name for name, item in record["constants"].items() if item["determined"] == "well"}
    assert well == {"s11", "d31", "eps33T"}
    # a pole known to δf gives s11 to 2 δf/f if all else is known, far below 1 % with 0.1 % of noise
    assert record["constants"]["s11"]["relative_std_if_all_else_known"] < 1e-4
    for item in record["constants"].values():
        if item["relative_std"] is not None:
            assert item["relative_std"] >= 0.999 * item["relative_std_if_all_else_known"]


def test_assumed_loss_tangents_are_told(record, tmp_path):
    """d31 has none in the file; where the file states all, nothing is told."""
    (note,) = record["notes"]
    assert note.startswith("the file states no loss tangent of d31: 0.02 is assumed")
    body = BODY.format(name="k31", thickness="1 mm", poling="thickness", stop="90 kHz")
    (tmp_path / "k31.toml").write_text(body.replace("[simulation]", "tan_d31 = 0.01\n[simulation]"), encoding="utf-8")
    assert fp.identify(tmp_path / "k31.toml", 1e-3, recommend=False).notes == ()


def test_a_k33_bar_is_recommended_for_s33_and_d33(record):
    bars = [item for item in record["recommendations"] if "k33 bar" in item["measurement"]]
    assert len(bars) == 1
    assert "s33" in bars[0]["would_determine"]
    assert any("shear plate" in sentence for sentence in record["advice"])
    for item in record["recommendations"]:
        for name, std in item["relative_std"].items():
            before = record["constants"][name]["relative_std"]
            assert std is None or before is None or std <= before * (1 + 1e-6)


def test_noise_scales_the_prediction(record, tmp_path):
    """Twice the noise gives twice the deviations."""
    spec = tmp_path / "k31.toml"
    spec.write_text(BODY.format(name="k31", thickness="1 mm", poling="thickness", stop="90 kHz"), encoding="utf-8")
    succeeded("identify", spec, "--out", tmp_path / "out", "--noise", "0.002")
    double = json.loads((tmp_path / "out" / "identifiability.json").read_text(encoding="utf-8"))
    ratios = [
        double["constants"][name]["relative_std_if_all_else_known"] / item["relative_std_if_all_else_known"]
        for name, item in record["constants"].items()
        if name in ("s11", "d31", "eps33T")  # the others have the deviations of their priors, whatever the noise
    ]
    np.testing.assert_allclose(ratios, 2.0, rtol=1e-3)


def studied(folder, points: int, draws: int) -> dict[tuple[float, int], dict]:
    """(Noise, points) → what the command finds by updates of so many drawn specimens."""
    spec = folder / "k31.toml"
    text = BODY.format(name="k31", thickness="1 mm", poling="thickness", stop="90 kHz")
    spec.write_text(text.replace("points = 301", f"points = {points}"), encoding="utf-8")
    succeeded("identify", spec, "--out", folder / "out", "--noise", "0.001", "--study", draws)
    assert (folder / "out/study.png").stat().st_size > 20_000
    study = json.loads((folder / "out/identifiability.json").read_text(encoding="utf-8"))["study"]
    found = {(round(one["noise"], 9), one["points"]): one for one in study}
    assert set(found) == {*((noise, points) for noise in (1e-4, 1e-3, 1e-2)), (1e-3, points // 4), (1e-3, 4 * points)}
    assert all(one["lost"] == 0 and one["draws"] == draws for one in study)
    return found


def test_more_points_and_less_noise_tell_more(tmp_path):
    """Stated deviations of every constant decrease."""
    settings = studied(tmp_path, points=101, draws=20)
    for better, worse in (((1e-3, 404), (1e-3, 25)), ((1e-4, 101), (1e-2, 101))):
        for label, found in settings[better]["constants"].items():
            assert found["stated"] < 1.01 * settings[worse]["constants"][label]["stated"], label


@pytest.mark.slow
def test_study_of_drawn_specimens(tmp_path):
    """Errors of updates are as large as stated, and stated deviations decrease with less noise and more points."""
    settings = studied(tmp_path, points=301, draws=40)
    for one in settings.values():
        for label, found in one["constants"].items():
            assert found["deviation"] == pytest.approx(found["stated"], rel=0.45), (one["noise"], label)
            assert abs(found["bias_over_its_std"]) < 3.5, (one["noise"], label)
        inside = [found["inside_1_sigma"] for found in one["constants"].values()]
        assert 0.52 < np.mean(inside) < 0.84
    for better, worse in (((1e-3, 1204), (1e-3, 75)), ((1e-4, 301), (1e-2, 301))):
        for label, found in settings[better]["constants"].items():
            assert found["stated"] < 1.01 * settings[worse]["constants"][label]["stated"], label


def test_a_study_needs_enough_draws(tmp_path):
    spec = tmp_path / "k31.toml"
    spec.write_text(BODY.format(name="k31", thickness="1 mm", poling="thickness", stop="90 kHz"), encoding="utf-8")
    answer = invoked("identify", spec, "--out", tmp_path / "out", "--study", "5")
    assert answer.exit_code == 2 and "20" in answer.output


def test_a_plan_tells_more_than_as_many_points_equally_spaced(tmp_path):
    """By noise alone: 80 planned points state less than 320 equally spaced ones for s11 and its tangent.

    And less than 0.6 of what 80 equally spaced points state.
    """
    text = BODY.format(name="k31", thickness="1 mm", poling="thickness", stop="90 kHz")
    (tmp_path / "k31.toml").write_text(text + "[update]\nnoise_only = true\n[measurement]\nnoise = 0.003\n")
    answer = succeeded("identify", tmp_path / "k31.toml", "--out", tmp_path / "out", "--plan", "80")
    assert "plan, 80 points" in answer.output and "320 equally spaced" in answer.output
    frequency = np.loadtxt(tmp_path / "out/plan.csv", skiprows=1)
    assert len(frequency) == 80 and np.all(np.diff(frequency) > 0) and frequency[[0, -1]] == pytest.approx([100, 90e3])
    assert np.diff(frequency).max() < 1.01 * (90e3 - 100) / 39  # half of the points are spread over the whole band
    plan = json.loads((tmp_path / "out/identifiability.json").read_text())["plan"]
    expected = plan["expected_std"]
    for label in ("s11", "tan_s11"):
        assert expected["plan"][label] < 0.6 * expected["equal"][label]
        assert expected["plan"][label] < expected["equal, four times"][label]
    s11 = json.loads((tmp_path / "out/identifiability.json").read_text())["expected"]["s11"]["value"]
    assert f"{100 * expected['plan']['s11'] / s11:.3g} %" in answer.output.split("planned sweep")[1]
    few = invoked("identify", tmp_path / "k31.toml", "--out", "o", "--plan", "5")
    assert few.exit_code == 2
    both = [str(tmp_path / "k31.toml")] * 2
    assert invoked("identify", *both, "--out", "o", "--plan", "50").exit_code == 2


def test_the_picture_of_a_study_shows_its_bias():
    """A setting whose mean error is many of its deviations lies outside the band of chance, the others inside."""
    rng, truth = np.random.default_rng(1), np.array([16e-12, 0.01])
    settings = []
    for points, off in ((100, 0.0), (400, 0.0), (1600, 0.5)):
        error = (rng.normal(size=(400, 2)) + off) * 1e-3 * truth
        stated = np.tile(1e-3 * truth, (400, 1))
        settings.append(Setting(1e-3, points, ("s11", "tan_s11"), truth, error, stated, 0))
    figure = noise_study_figure("plate", settings)
    panel = next(one for one in figure.axes[1::2] if "bias" in figure.axes[figure.axes.index(one) - 1].get_ylabel())
    drawn = np.array([line.get_ydata() for line in panel.lines if line.get_marker() == "o"])
    np.testing.assert_allclose(drawn.T, [one.bias for one in settings])
    assert np.all(np.abs(drawn[:, :2]) < 4) and np.all(drawn[:, 2] > 7)


@pytest.mark.parametrize("share", [0.2, 0.7])
def test_the_picture_of_a_study_shows_every_share(share):
    """Also of intervals that hold the truth far too seldom."""
    truth = np.array([16e-12, 0.01])
    error = np.where(np.arange(100)[:, None] < 100 * share, 0.5, 3.0) * 1e-3 * truth
    settings = [
        Setting(1e-3, points, ("s11", "tan_s11"), truth, error, np.tile(1e-3 * truth, (100, 1)), 0)
        for points in (100, 400, 1600)
    ]
    panel = next(one for one in noise_study_figure("plate", settings).axes if "share" in one.get_ylabel())
    shown = np.concatenate([line.get_ydata() for line in panel.lines if line.get_marker() in ("o", "s")])
    low, high = panel.get_ylim()
    assert shown == pytest.approx(share) and low < shown.min() - 0.02 and shown.max() < high
    assert low <= 0.4


def test_a_setting_of_which_no_fit_settled_is_told(monkeypatch, tmp_path):
    """At ten times the noise no fit settles: null in the file, a line in words, no points in the picture. At the noise
    of the plan it is an error, and so is a study of too few specimens.
    """
    body = BODY.format(name="k31", thickness="1 mm", poling="thickness", stop="90 kHz")
    (tmp_path / "plate.toml").write_text(body, encoding="utf-8")
    wanted, lost = tmp_path / "plate.toml", [1e-2]

    def fails(response, data, unknowns, starts):
        if any(np.isclose(data.relative_noise[0], one) for one in lost):
            raise ConvergenceError("as if none settled")
        return fit(response, data, unknowns, starts)

    monkeypatch.setattr("femu_piezo.study.noise_study.fit", fails)
    result = fp.identify(wanted, 1e-3, study=20, recommend=False)
    result.save(tmp_path)
    found = json.loads((tmp_path / "identifiability.json").read_text())["study"]
    (loud,) = (one for one in found if one["noise"] == pytest.approx(1e-2))
    assert loud["draws"] == 0 and loud["lost"] == 20 and set(loud["constants"]["s11"].values()) == {None}
    assert all(None not in one["constants"]["s11"].values() for one in found if one is not loud)
    assert "noise 1 %, 301 points: none of 20 fits converged" in str(result)
    lost.append(1e-3)
    with pytest.raises(ConvergenceError, match=r"none of 20 updates at a noise of 0\.001 and 301 points settled"):
        fp.identify(wanted, 1e-3, study=20, recommend=False)
    with pytest.raises(InputError, match="study = 3 gives no statistics; give 20 specimens or more"):
        fp.identify(wanted, 1e-3, study=3, recommend=False)


def test_a_further_measurement_of_a_large_model_is_not_compared(monkeypatch, tmp_path):
    """Its name is in a note; the others are compared as before."""
    (tmp_path / "k31.toml").write_text(BODY.format(name="k31", thickness="1 mm", poling="thickness", stop="90 kHz"))
    monkeypatch.setattr("femu_piezo.study.identify._MOST_UNKNOWNS", 3000)
    result = fp.identify(tmp_path / "k31.toml", 1e-3)
    assert any(re.match(r"a square plate 20 .* is not among the measurements compared", note) for note in result.notes)
    assert len(result.recommendations) == 2 and not any("square" in one.measurement for one in result.recommendations)


def test_losses_that_cannot_be_assumed_are_told(tmp_path):
    """Lossless ε33T alone with a loss makes no passive material here: none is taken, and the note says so."""
    body = BODY.format(name="k31", thickness="1 mm", poling="thickness", stop="90 kHz")
    body = re.sub(r"tan_.*\n", "", body).replace("[simulation]", 'free = ["d31", "eps33T"]\n[simulation]')
    (tmp_path / "k31.toml").write_text(body, encoding="utf-8")
    (note,) = fp.identify(tmp_path / "k31.toml", 1e-3, recommend=False).notes
    assert "makes no passive material: none is taken, and true deviations are larger" in note
