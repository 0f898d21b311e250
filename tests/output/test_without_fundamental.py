"""What is written about a sweep that does not hold the fundamental, which another sweep of the specimen holds."""

from __future__ import annotations

import html
import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from femu_piezo.api import update
from femu_piezo.measurement.readers import write_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.output.data_sheet import data_sheet
from femu_piezo.output.report_diagnosis_charts import _views
from femu_piezo.output.report_update import _summary
from femu_piezo.output.results.updated import Updated
from tests import k31_bar
from tests.batch.lots import D31, EPS33T, S11, SPECIMEN
from tests.noise import noisy

SWEEPS = '[[sweep]]\nfile = "low.csv"\n[[sweep]]\nfile = "high.csv"\n'


@pytest.fixture(scope="module")
def result(tmp_path_factory) -> Updated:
    """An update of a bar from a sweep of its fundamental and one of the band between its modes."""
    folder = tmp_path_factory.mktemp("bands")
    for seed, (name, low, high) in enumerate((("low", 26e3, 46e3), ("high", 60e3, 80e3))):
        frequency = np.linspace(low, high, 121)
        z = k31_bar.impedance(2 * np.pi * frequency, (40e-3, 3e-3, 0.5e-3), 7500.0, S11, D31, EPS33T)
        z = noisy(z, 1e-3, np.random.default_rng(seed))
        write_spectrum(ImpedanceSpectrum(frequency, z), folder / f"{name}.csv")
    (folder / "bar.toml").write_text(SPECIMEN.partition("[measurement]")[0] + SWEEPS, encoding="utf-8")
    return update(folder / "bar.toml")


@pytest.fixture(scope="module")
def page(result, tmp_path_factory) -> str:
    folder = result.save(tmp_path_factory.mktemp("out"), report=True)
    return (folder / "report.html").read_text(encoding="utf-8")


def test_the_report_states_the_fundamental_of_the_sweep_that_holds_it(page):
    words = re.findall(r"<p>(bar, \w+: \d+ points[^<]*)</p>", html.unescape(page))
    assert [line.partition(":")[0] for line in words] == ["bar, low", "bar, high"]
    assert "series resonance (pole) at 3" in words[0]
    assert "series resonance" not in words[1] and "the fundamental is not in this sweep" in words[1]


def test_the_report_claims_no_smaller_misfit_where_it_is_larger(result):
    """Of a baseline that is nearer to the points than their noise."""
    first, *others = result.outcomes
    near = replace(first, base_curve=first.measured.spectrum.impedance * np.exp(2e-4))
    words = _summary(replace(result, outcomes=(near, *others)))
    found = re.findall(r"The root mean square difference[^<]*", words)
    assert f"is 0.02 % with the baseline and {100 * first.rms_after:.3g} % with" in found[0]
    assert "fall" not in words


def test_ranges_of_charts_lie_in_the_sweep(page):
    charts = [json.loads(text) for text in re.findall(r'<script type="application/json">(.*?)</script>', page)]
    assert sum(bool(chart["views"]) for chart in charts) == 2  # curves and sensitivity of the first sweep
    for chart in charts:
        for low, high in chart["views"].values():
            assert chart["series"][0]["x"][0] <= low < high <= chart["series"][0]["x"][-1]


def test_ranges_of_a_diagnosis_lie_in_the_sweep():
    spectrum = SimpleNamespace(frequency=np.linspace(60e3, 80e3, 11))
    verdict = SimpleNamespace(before=SimpleNamespace(worst_Hz=((61e3, 63e3),)))
    found = _views(SimpleNamespace(spectrum=spectrum, reference_Hz=35e3, verdict=verdict), 1e-3)
    assert found == {"where the base model fails most": pytest.approx((60, 64))}


def test_a_data_sheet_has_the_figures_that_there_are(result, tmp_path):
    """The sheet of the second sweep has constants and curves, and no standard figures."""
    assert [len(modes) for modes in result.figures] == [1, 0]
    out = result.save_data_sheet(tmp_path)
    assert sorted(path.name for path in out.iterdir() if path.suffix == ".pdf") == [
        "datasheet_1.pdf",
        "datasheet_2.pdf",
    ]
    titles = [[text.get_text() for text in data_sheet(result, index).texts] for index in (0, 1)]
    assert [any(words.startswith("Standard figures") for words in page) for page in titles] == [True, False]
    assert all("Material constants" in page and "s11" in page for page in titles)
