"""Pictures of specimens and sweeps whatever their names are."""

from __future__ import annotations

import io
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from femu_piezo.batch.lot import lot_of
from femu_piezo.batch.lot_figure import lot_figure
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.output.diagnosis import diagnosis_figure
from femu_piezo.output.measuring import measuring_figure
from femu_piezo.output.picture import Picture
from tests.batch.test_lot import CENTRE, clean, rows
from tests.commands import succeeded

PLATE = Path(__file__).resolve().parents[2] / "tutorials" / "k31_plate"


@pytest.mark.parametrize("command", ["simulate", "extract", "circuit", "update", "datasheet", "identify"])
def test_a_name_with_dollar_signs_is_no_formula(command, tmp_path):
    (tmp_path / "plate.toml").write_text((PLATE / "plate.toml").read_text().replace("of the paper", "$x_$, $3"))
    shutil.copy(PLATE / "sweep.csv", tmp_path / "sweep.csv")
    shutil.copy(PLATE / "sweep.csv", tmp_path / "$x_$.csv")
    file = "$x_$.csv" if command in ("extract", "circuit") else "plate.toml"
    succeeded(command, tmp_path / file, "--out", tmp_path / "out")
    assert list((tmp_path / "out").glob("*.png"))


@pytest.mark.parametrize("columns", [1, 2])
@pytest.mark.parametrize("words", ["disk of soft ceramic of lot 4711, annealed, from the left of the tray", 130 * "x"])
def test_long_titles_stay_within_the_picture(columns, words):
    picture = Picture(figsize=(8.0, 5.5), layout="constrained")
    for axes in picture.subplots(1, columns, squeeze=False).ravel():
        axes.set_title(f"{words}: pole-zero iteration")
        axes.set_title(f"{words}: left", loc="left")
    heading = picture.suptitle(f"{words}, up + {words}, down: impedance, measured and simulated")
    picture.savefig(io.BytesIO(), format="png")
    renderer = FigureCanvasAgg(picture).get_renderer()
    texts = [heading, *(axes.title for axes in picture.axes)]
    assert all(one.get_window_extent(renderer).x0 >= 0 for one in texts)
    assert all(one.get_window_extent(renderer).x1 <= picture.bbox.width for one in texts)
    assert all("\n" in one.get_text() for one in texts)
    once = [one.get_text() for one in texts]
    picture.savefig(io.BytesIO(), format="png")
    assert [one.get_text() for one in texts] == once


def test_a_long_name_of_an_outlier_stays_within_its_chart():
    values = clean(30, 2)
    values[28] += 0.1 * CENTRE
    pieces = [row | {"file": f"{70 * 'p'}{row['number']}.toml"} for row in rows(values)]
    figure = lot_figure(lot_of(pieces))
    figure.draw_without_rendering()
    (label,) = figure.axes[0].texts
    assert label.get_window_extent().x1 < figure.axes[0].bbox.x1


def test_causes_stand_in_pictures_as_they_are():
    """With the name of the specimen that has one, whose dollar signs make no formula."""
    title, frequency = r"wrong_length (plate $\frac{$ 2)", np.linspace(1e3, 2e3, 20)
    spectrum = ImpedanceSpectrum(frequency, 1 - 5j + 0 * frequency)
    diagnosed = SimpleNamespace(
        spectrum=spectrum,
        relative_noise=np.full(20, 1e-3),
        curves=(spectrum.impedance, spectrum.impedance),
        fitted=np.ones(20, bool),
        verdict=SimpleNamespace(extension=[SimpleNamespace(effect=SimpleNamespace(title=title))], word="effect"),
        specimen=SimpleNamespace(name="plate"),
    )
    rivals = SimpleNamespace(first=title, second="leakage", log_odds=1.0, enough=3.0)
    state = SimpleNamespace(spectrum=spectrum, rivals=rivals, curve=None, departures=(), deviations={})
    for figure in (diagnosis_figure(diagnosed), measuring_figure("plate", [state])):
        figure.savefig(io.BytesIO(), format="png")
