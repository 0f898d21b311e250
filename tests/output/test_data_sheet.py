"""The data sheet: one page with every number of the result, and nothing beyond its edges or over its curves."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

import femu_piezo as fp
from femu_piezo.output.data_sheet import as_pdf, data_sheet
from femu_piezo.standards.piece import WORDS
from tests.commands import invoked, succeeded

SPEC = Path(__file__).resolve().parents[2] / "tutorials" / "k31_plate" / "plate.toml"


@pytest.fixture(scope="module")
def result():
    return fp.update(SPEC)


def _boxes(page):
    renderer = FigureCanvasAgg(page).get_renderer()
    page.draw(renderer)
    texts = [text for text in page.texts if text.get_text()]
    return [(text.get_text(), text.get_window_extent(renderer)) for text in texts], renderer


def test_every_constant_and_figure_is_on_the_page(result):
    words = [text.get_text() for text in data_sheet(result).texts]
    for name in (*result.parameters, "fs", "fp", "k_eff", "Qm_3dB", "C_T", "N1", "k31"):
        assert name in words
    assert any(re.fullmatch(r"\(15\.8\d+ ± 0\.\d+\) 10⁻¹² m²/N", word) for word in words)
    k31 = result.figures[0][0]["k31"]
    assert f"{k31.value:.6g}" in words and f"{k31.model:.6g}" in words
    assert any("handbook formulas get wrong for this piece (length/width = 8)" in word for word in words)


@pytest.mark.parametrize("modes", [1, 2])
@pytest.mark.parametrize("notes", [0, 40])
def test_nothing_leaves_the_page_or_lies_over_the_curves(result, modes, notes):
    full = replace(result, notes=tuple(f"a sentence with the number {n} that takes some room" for n in range(notes)))
    full.__dict__["figures"] = ((result.figures[0][0],) * modes,)
    page = data_sheet(full)
    found, renderer = _boxes(page)
    width, height = page.canvas.get_width_height()
    curves = [axes.get_tightbbox(renderer) for axes in page.axes]
    for text, box in found:
        assert box.x0 > 0 and box.x1 < width and box.y0 > 0 and box.y1 < height, text
        assert not any(box.overlaps(curve) for curve in curves), text
    others = [box for _, box in found]
    for index, (text, box) in enumerate(found):
        inner = box.padded(-1.0)
        assert not any(inner.overlaps(other) for other in others[index + 1 :]), text


def test_a_long_name_and_the_notes_end_at_the_right_margin(result):
    words = "what the handbook formulas get wrong k31 -1.1 %, kp +0.33 %, s11 +2.9 % " * 4
    first = result.outcomes[0]
    specimen = first.measured.problem.specimen.model_copy(update={"name": "a name of a piece " * 6})
    measured = replace(first.measured, problem=replace(first.measured.problem, specimen=specimen))
    long = replace(result, outcomes=(replace(first, measured=measured),), notes=(words,))
    long.__dict__["figures"] = result.figures
    page = data_sheet(long)
    right = 0.935 * page.canvas.get_width_height()[0]
    for text, box in _boxes(page)[0]:
        assert box.x1 < right, text
        assert not any(line.startswith("%") for line in text.splitlines()), text


@pytest.mark.parametrize("title", WORDS.values())
def test_the_title_of_every_kind_of_mode_ends_at_the_right_margin(result, title):
    named = replace(result)
    named.__dict__["figures"] = ((replace(result.figures[0][0], title=title),),)
    page = data_sheet(named)
    right = 0.935 * page.canvas.get_width_height()[0]
    (box,) = (box for text, box in _boxes(page)[0] if text == f"Standard figures: {title}")
    assert box.x1 < right


def test_one_page_of_pdf(result):
    data = as_pdf(data_sheet(result))
    assert data.startswith(b"%PDF") and data.count(b"/Type /Page ") + data.count(b"/Type /Page\n") == 1


def test_the_command_goes_from_a_sweep_to_the_page(tmp_path):
    sweep = SPEC.parent / "sweep.csv"
    succeeded("datasheet", SPEC, "--data", sweep, "--out", tmp_path / "out")
    names = sorted(one.name for one in (tmp_path / "out").iterdir())
    assert names == ["datasheet.pdf", "datasheet.png", "update.json"]
    answer = invoked("datasheet", SPEC, "--data", tmp_path / "none.csv", "--out", tmp_path / "other")
    assert answer.exit_code == 2 and "no such file" in answer.output and not (tmp_path / "other").exists()
