"""Pages, as the server sends them, of specimen files that are being written."""

from __future__ import annotations

import asyncio
import json
import re
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock
from urllib.parse import urlencode
from urllib.request import urlopen

import numpy as np
import pytest

pytest.importorskip("nicegui", reason="the page needs nicegui: pip install 'femu-piezo[web]'")

from femu_piezo.measurement.compensation import Compensation
from femu_piezo.measurement.readers import read_spectrum, write_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.specimen.file import read_specimens, write_study
from femu_piezo.web import site
from femu_piezo.web.drafts import Draft
from femu_piezo.web.jobs import Job
from femu_piezo.web.pages import diagnosis, update
from femu_piezo.web.pages.specimen import _Form
from femu_piezo.web.pages.update import _Update
from femu_piezo.web.workspace import Workspace
from tests.specimens import plate

from .conftest import TUTORIALS

TEXT = f"""{plate("plate", (40e-3, 5e-3, 1e-3), 7500.0)}[material]
base = "pzt-5h"
free = ["s11"]
"""
#: Names of the curves of a diagnosis.
CURVES = ("measured", "before", "after")
#: What stands in the file, and what is written in its place.
WRITTEN = (
    ('free = ["s11"]', "free = 5"),
    ('shape = "plate"', 'shape = ["plate"]'),
    ("[geometry]", "[[geometry]]"),
    ("[material]", "[[material]]"),
    (TEXT, "geometry = 5\nmaterial = 6"),
)


def test_a_specimen_with_values_of_another_kind_is_shown(serve, tmp_path: Path) -> None:
    """So that it can be corrected: the page of each answers."""
    for number, (before, after) in enumerate(WRITTEN):
        (tmp_path / f"{number}.toml").write_text(TEXT.replace(before, after))
    server = serve()
    for number in range(len(WRITTEN)):
        with urlopen(f"{server.base}/specimen?{urlencode({'spec': f'{number}.toml'})}", timeout=60) as answer:
            assert answer.status == 200


@pytest.mark.parametrize(("before", "after"), WRITTEN)
def test_text_with_values_of_another_kind_is_told(tmp_path: Path, before: str, after: str) -> None:
    """The form follows the text as it is typed, and says what is wrong with it."""
    (tmp_path / "plate.toml").write_text(TEXT)
    workspace, told = Workspace.of(tmp_path), []
    draft = Draft(workspace, "plate.toml", "me")
    form = _Form(SimpleNamespace(), "plate.toml", draft)
    form._tell = form._rebuild = lambda: told.append(draft.problem())
    form._typed(SimpleNamespace(value=TEXT.replace(before, after)))
    assert len(told) == 1 and told[0].startswith("plate.toml: ")


def test_an_update_shows_the_free_constants_of_a_text_with_values_of_another_kind(tmp_path: Path) -> None:
    (tmp_path / "plate.toml").write_text(TEXT)
    workspace = Workspace.of(tmp_path)
    its_site = SimpleNamespace(workspace=workspace, draft=lambda name: Draft(workspace, name, "me"))
    its_site.draft("plate.toml").put("material", "free", 5)
    page = _Update(its_site, "plate.toml")
    assert page._draft_free(workspace.specimen("plate.toml")[0]) == ["s11"]
    its_site.draft("plate.toml").put("material", "free", ["d31"])
    assert page._draft_free(workspace.specimen("plate.toml")[0]) == ["d31"]


def record(*names: str, **more) -> str:
    """update.json of specimens of some names, without constants."""
    figure = {"value": 0.7, "std": None, "unit": "1", "model": None, "meaning": "coupling"}
    figures = [{"title": "bar", "figures": {"k31": figure}}]
    one = {"rms_log_error": {"baseline": 0.1, "updated": 0.01}, "standard_figures": figures}
    specimens = [{"name": name, **one} for name in names]
    return json.dumps({"parameters": {}, "notes": [], "specimens": specimens, **more})


def page_of_update(serve, tmp_path: Path, text: str, *pictures: str) -> str:
    """The page of the last update, with its update.json and pictures that lie in its folder."""
    (tmp_path / "plate.toml").write_text(TEXT)
    folder = tmp_path / "results" / "plate.toml" / "update"
    folder.mkdir(parents=True)
    (folder / "update.json").write_text(text)
    for name in pictures:
        (folder / name).write_bytes(b"")
    with urlopen(f"{serve().base}/update?spec=plate.toml", timeout=60) as answer:
        return answer.read().decode()


@pytest.mark.parametrize("samples", [None, {"count": 400}])
def test_pictures_of_an_earlier_update_are_not_shown(serve, tmp_path: Path, samples) -> None:
    """Samples only where the last update drew some, the sensitivity of as many sweeps as it had."""
    pictures = ("corner.png", "sensitivity.png", "sensitivity_1.png", "sensitivity_2.png")
    page = page_of_update(serve, tmp_path, record("plate", samples=samples), *pictures)
    assert ("Samples of the posterior" in page) == (samples is not None)
    assert re.findall(r"/(sensitivity\w*\.png)\?", page) == ["sensitivity.png"]


def test_standard_figures_of_every_specimen_are_shown(serve, tmp_path: Path) -> None:
    """Each with the name of its specimen."""
    page = page_of_update(serve, tmp_path, record("first", "second"))
    assert "first: bar" in page and "second: bar" in page


@pytest.mark.parametrize("end", ["done", "failed"])
def test_what_a_command_left_is_shown_at_its_end(monkeypatch, end: str) -> None:
    """Once, where it failed too: the table of a lot without any result holds the reasons."""
    job, shown, screen = Job(1, "batch", "lot", "out"), [], MagicMock()
    monkeypatch.setattr(site, "ui", screen)
    jobs = SimpleNamespace(latest=lambda *_: job, all=lambda: [job], seconds_left=lambda _: 1.0)
    site.Site(SimpleNamespace(), jobs).job_card(
        "batch", "lot", "Update every specimen", lambda: shown.append(job.state)
    )
    look = screen.timer.call_args[0][1]
    for job.state in ("waiting", "running", "running", end, end):
        look()
    assert shown == [end]


def test_a_diagnosis_shows_the_curves_and_the_report_of_every_sweep(serve, tmp_path: Path) -> None:
    """Not those of an earlier diagnosis of one sweep."""
    (tmp_path / "plate.toml").write_text(TEXT)
    folder = tmp_path / "results" / "plate.toml" / "diagnose"
    folder.mkdir(parents=True)
    told = {"verdict": "none", "causes": [], "candidates": [], "notes": [], "parameters": {"after": {}}}
    told |= {"recommended_measurements": [], "separations": [], "sweeps": [{"specimen": "up"}, {"specimen": "down"}]}
    (folder / "diagnosis.json").write_text(json.dumps(told))
    parts = [f"{curve}_{part}_ohm" for curve in CURVES for part in ("resistance", "reactance")]
    head = ",".join(["frequency_Hz", *parts, "noise_ohm", "fitted"])
    for number, suffix in enumerate(("", "_1", "_2")):
        rows = [f"{frequency + number},1,-5,1,-5,1,-5,0.1,1" for frequency in (111, 222)]
        (folder / f"curves{suffix}.csv").write_text("\n".join([head, *rows]))
        (folder / f"report{suffix}.html").write_text("")
    with urlopen(f"{serve().base}/diagnosis?spec=plate.toml", timeout=60) as answer:
        page = answer.read().decode()
    assert page.count("residual before and after") == 2
    assert re.findall(r'"src":"[^"]*/(report\w*\.html)"', page) == ["report_1.html", "report_2.html"]


@pytest.mark.parametrize("count", [1, 2])
def test_extended_specimens_are_kept_beside_the_diagnosed_ones(tmp_path: Path, monkeypatch, count: int) -> None:
    """Of a study a study file, with a specimen file for each of its specimens."""
    workspace = Workspace.of(tmp_path)
    folder = workspace.path(workspace.results("lot/both.toml", "diagnose"))
    folder.mkdir(parents=True)
    (tmp_path / "lot").mkdir()
    (folder / "extended.toml").write_text(TEXT)
    if count > 1:
        names = [f"extended_{number}.toml" for number in range(1, count + 1)]
        for name in names:
            (folder / name).write_text(TEXT.replace('"plate"\n[', f'"{name}"\n['))
        write_study(names, folder / "extended.toml")
    opened = []
    monkeypatch.setattr(diagnosis, "ui", SimpleNamespace(navigate=SimpleNamespace(to=opened.append)))
    diagnosis._Diagnosis(SimpleNamespace(workspace=workspace), "lot/both.toml")._accept()
    assert opened == ["/diagnosis?spec=lot%2Fboth-extended.toml"]
    found = workspace.specimen("lot/both-extended.toml")
    assert [one.name for one in found] == [one.name for one in read_specimens([folder / "extended.toml"])]
    assert len(found) == count and len(workspace.specimens()) == (1 if count == 1 else 1 + count)


class Place:
    """Stands for a column of the page."""

    def classes(self, _: str) -> Place:
        return self

    style = classes

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        pass


@pytest.mark.parametrize("key", ["correct_phase = true", "columns", "open", "mask = [[60e3, 70e3]]"])
def test_an_update_is_compared_with_the_sweep_that_was_fitted(tmp_path: Path, monkeypatch, key: str) -> None:
    """The measured curve of the page is that of the fit: its phase turned, its columns named, its fixture taken off."""
    true, file = read_spectrum(TUTORIALS / "k31_plate" / "sweep.csv"), tmp_path / "sweep.csv"
    raw = ImpedanceSpectrum(true.frequency, -true.impedance if key.startswith("correct") else true.impedance)
    if key == "open":
        shunt = ImpedanceSpectrum(true.frequency, 1 / (2j * np.pi * true.frequency * 20e-12))
        write_spectrum(shunt, tmp_path / "open.csv")
        raw = ImpedanceSpectrum(true.frequency, 1 / (1 / true.impedance + 1 / shunt.impedance))
        key = 'open = "open.csv"'
        assert Compensation(open=shunt).applied(raw).impedance == pytest.approx(true.impedance)
    write_spectrum(raw, file)
    if key == "columns":
        file.write_text("\n".join(file.read_text().splitlines()[1:]))
        key = 'columns = ["f (Hz)", "R (Ohm)", "X (Ohm)"]'
    (tmp_path / "plate.toml").write_text(f'{TEXT}[measurement]\nfile = "sweep.csv"\n{key}\n')
    workspace = Workspace.of(tmp_path)
    folder = workspace.path(workspace.results("plate.toml", "update"))
    folder.mkdir(parents=True)
    fitted = true.select((true.frequency < 60e3) | (true.frequency > 70e3)) if "mask" in key else true
    write_spectrum(fitted, folder / "updated.csv")

    async def here(function, *given):
        return function(*given)

    shown = []
    monkeypatch.setattr(update, "ui", SimpleNamespace(column=Place))
    monkeypatch.setattr(update.run, "cpu_bound", here)
    monkeypatch.setattr(update, "_compare", lambda name, measured, updated: shown.append((name, measured)))
    page = _Update(SimpleNamespace(workspace=workspace), "plate.toml")
    page._places = page._reserved_places()
    asyncio.run(page._draw())
    [(name, (frequency, impedance))] = shown
    assert name == "measured" and frequency.tolist() == fitted.frequency.tolist()
    assert impedance == pytest.approx(fitted.impedance, rel=1e-9)
