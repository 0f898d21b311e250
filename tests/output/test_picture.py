"""Pictures of specimens and sweeps whatever their names are."""

from __future__ import annotations

import io
import shutil
from pathlib import Path

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from femu_piezo.batch.lot import lot_of
from femu_piezo.batch.lot_figure import lot_figure
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
