"""The report of an update: a self-contained file with the numbers of update.json that runs in a browser."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from femu_piezo.api import update
from femu_piezo.errors import InputError
from femu_piezo.measurement.autoregression import WHITE, Autoregression
from femu_piezo.output import report_modes, report_update
from femu_piezo.output.report import Section, report_html
from femu_piezo.output.report_curves import _residual_words
from femu_piezo.output.report_update import _stated
from femu_piezo.specimen.file import read_specimen
from tests.commands import succeeded

ROOT = Path(__file__).resolve().parents[2]
SPEC = ROOT / "tutorials" / "k31_plate" / "plate.toml"
VOID = {"meta", "link", "img", "br", "hr", "input"}


class Page(HTMLParser):
    """Elements of a page in order, their nesting checked, with cells that have keys and with scripts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict]] = []
        self.cells: dict[str, tuple[float, str]] = {}
        self.scripts: list[tuple[dict, str]] = []
        self._cell = None
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.elements.append((tag, attributes))
        if tag not in VOID:
            self.open.append(tag)
        if tag == "td" and "data-value" in attributes:
            self._cell = attributes
        if tag == "script":
            self.scripts.append((attributes, ""))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        if tag == "td":
            self._cell = None

    def handle_data(self, data):
        if self._cell is not None:
            self.cells[self._cell["data-key"]] = (float(self._cell["data-value"]), data)
        if self.open and self.open[-1] == "script":
            attributes, text = self.scripts[-1]
            self.scripts[-1] = (attributes, text + data)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("report")
    succeeded("update", SPEC, "--out", out, "--report")
    return out


@pytest.fixture(scope="module")
def page(folder) -> Page:
    return Page((folder / "report.html").read_text(encoding="utf-8"))


def test_structure(page):
    assert page.open == []
    sections = [attributes["id"] for tag, attributes in page.elements if tag == "section"]
    assert sections == [
        "summary",
        "parameters",
        "curves",
        "resonances",
        "figures",
        "identifiability",
        "sensitivity",
        "modes",
        "provenance",
    ]
    links = [attributes["href"] for tag, attributes in page.elements if tag == "a"]
    assert links == [f"#{name}" for name in sections]


def test_nothing_from_elsewhere(folder, page):
    for tag, attributes in page.elements:
        for key in ("src", "href", "action", "poster", "data", "srcset"):
            assert re.match(r"^(#|data:)", attributes.get(key) or "#"), (tag, attributes)
        assert not (tag == "link" and attributes.get("rel") == "stylesheet")
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert set(re.findall(r"https?://[^\s\"'<>]+", text)) <= {
        "http://www.w3.org/2000/svg"
    }  # the name of a namespace, which is not fetched
    assert not re.search(r"@import|url\((?!#)(?!data:)[^$]", text)
    assert not re.search(r"\bfetch\(|XMLHttpRequest|import\(", text)


def test_the_reference_explains_every_key(folder):
    reference = (Path(__file__).parents[2] / "docs/reference/results.md").read_text(encoding="utf-8")
    known = set(re.findall(r"`(\w+)`", reference.split("## update.json")[1].split("## diagnosis.json")[0]))
    record = json.loads((folder / "update.json").read_text(encoding="utf-8"))
    assert set(record) - {"schema"} <= known
    assert set(record["specimens"][0]) | set(record["fit"]) | set(record["identifiability"]) <= known


def test_numbers_are_those_of_update_json(folder, page):
    record = json.loads((folder / "update.json").read_text(encoding="utf-8"))
    embedded = next(text for attributes, text in page.scripts if attributes.get("id") == "record")
    assert json.loads(embedded) == record
    assert {key.split(".")[1] for key in page.cells if key.startswith("parameters.")} == set(record["parameters"])
    for key, (value, text) in page.cells.items():
        found = record
        for part in key.split("."):
            found = found[int(part)] if part.isdigit() else found[part]
        assert value == found, key
        if key.startswith("parameters.") and key.endswith((".value", ".tan")):
            name = key.split(".")[1]
            factor = {"s": 1e12, "d": 1e12, "e": 1 / 8.8541878128e-12}[name[0]] if key.endswith(".value") else 1.0
            std = record["parameters"][name]["std" if key.endswith(".value") else "tan_std"] * factor
            told = [float(part) for part in text.split(" ± ")]
            assert told == [pytest.approx(value * factor, abs=0.0501 * std), pytest.approx(std, rel=0.0501)], key
    assert sum(key.endswith(".model.loss") for key in page.cells) == len(record["poles"]) + len(record["zeros"])


def test_checksums_of_the_inputs(folder):
    text = (folder / "report.html").read_text(encoding="utf-8")
    for path in (SPEC, SPEC.parent / "sweep.csv"):
        assert hashlib.sha256(path.read_bytes()).hexdigest() in text


def test_every_file_that_was_read_has_its_checksum(tmp_path):
    """The raw sweeps of the fixture too."""
    names = ("sweep.csv", "open.csv", "short.csv", "load.csv")
    for name in names:
        (tmp_path / name).write_text(name)
    fixture = 'open = "open.csv"\nshort = "short.csv"\n[measurement.load]\nfile = "load.csv"\nresistance = 100.0\n'
    (tmp_path / "plate.toml").write_text(SPEC.read_text(encoding="utf-8") + fixture, encoding="utf-8")
    specimen = read_specimen(tmp_path / "plate.toml")
    problem = SimpleNamespace(specimen=specimen, density=7900.0)
    outcome = SimpleNamespace(measured=SimpleNamespace(problem=problem), mesh="")
    body = report_update.update_provenance(SimpleNamespace(outcomes=[outcome], seconds={}), "update").body
    for name in ("plate.toml", *names):
        assert hashlib.sha256((tmp_path / name).read_bytes()).hexdigest() in body


def test_curves_hold_the_sweep(page):
    sweep = (SPEC.parent / "sweep.csv").read_text(encoding="utf-8").splitlines()
    first = [float(value) for value in sweep[1].split(",")]
    charts = [
        json.loads(text)
        for attributes, text in page.scripts
        if attributes.get("type") == "application/json" and "id" not in attributes
    ]
    magnitude = charts[0]["series"][0]
    assert magnitude["name"] == "measured" and len(magnitude["x"]) == len(sweep) - 1
    assert magnitude["y"][0] == pytest.approx(abs(complex(*first[1:])), rel=1e-6)
    assert {chart["y"]["label"] for chart in charts} >= {"|Z| (Ω)", "phase of Z (°)", "residual (σ)"}


def test_a_machine_without_renderer_still_gets_a_report(monkeypatch, tmp_path):
    def fails(*_):
        raise InputError("mode pictures need a library to draw with")

    monkeypatch.setattr(report_modes, "mode_figure", fails)
    succeeded("update", SPEC, "--out", tmp_path, "--report")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "could not be drawn here: mode pictures need a library" in text
    assert (
        text.count("data:image/png") == 1 and "data:image/png" in text.split('id="curves"')[0]
    )  # the picture of the budget


@pytest.mark.parametrize("free", [["s11", "d31", "eps33T"], ["s11", "s12", "d31", "eps33T"]])
def test_the_report_tells_which_poles_and_zeros_were_fitted(tmp_path, monkeypatch, free):
    """Those of the fundamental as in the main part of the paper, or all of them as in its appendix."""
    text = SPEC.read_text(encoding="utf-8").replace("simplified = true", "").replace('"s11", "d31", "eps33T"', "FREE")
    text = text.replace("[FREE]", str(free)).replace('"sweep.csv"', f'"{SPEC.parent}/sweep.csv"')
    (tmp_path / "plate.toml").write_text(text + '[update]\nmethod = "pole_zero"\n', encoding="utf-8")
    monkeypatch.setattr(report_update, "mode_section", lambda _: Section("modes", "", ""))
    result = update(tmp_path / "plate.toml")
    assert list(result.parameters) == free
    sections = {one.name: one.body for one in report_update.update_sections(result)}
    of_fundamental = len(free) == 3
    assert ("the first pole and zero of the finite element model were fitted" in sections["summary"]) == of_fundamental
    assert ("appendix A" in sections["summary"]) != of_fundamental
    assert ("determine two complex constants exactly" in sections["identifiability"]) == of_fundamental


def test_names_cannot_become_markup():
    text = report_html("<b>x</b> __RECORD__", "a & b", [Section("s", "<i>", "<p>body</p>")], {"k": "</script>"})
    page = Page(text)
    assert "b" not in {tag for tag, _ in page.elements} and page.open == []
    embedded = next(text for attributes, text in page.scripts if attributes.get("id") == "record")
    assert json.loads(embedded) == {"k": "</script>"}


def test_runs_in_a_browser(folder, tmp_path):
    """Headless Chromium draws every chart and the picture, and its console stays empty."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("there is no chromium on this machine")
    flags = (
        "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
        "--disable-component-update --disable-sync --virtual-time-budget=4000 --enable-logging=stderr --v=0"
    )
    command = [browser, *flags.split(), f"--user-data-dir={tmp_path}", "--dump-dom", (folder / "report.html").as_uri()]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert "CONSOLE" not in answer.stderr
    dom = answer.stdout
    assert dom.count("<svg") == dom.count('<figure class="chart"') == 4
    measured = re.search(r'<path d="([^"]+)" stroke="#222222" class="points"', dom)[1]
    assert measured.count("M") == 500  # every point of the sweep
    assert "NaN" not in re.sub(r'<script.*?</script>|data:image/[^"]+', "", dom, flags=re.S)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("length", 0.04, "40 mm"),
        ("std_length", 2e-5, "0.02 mm"),
        ("std_density", 0.003, "0.3 %"),
        ("mass", 1.58e-3, "1.58 g"),
        ("hole_position", (1e-3, 0.0), "(1, 0) mm"),
        ("poling", (0.0, 1.0, 0.0), "(0, 1, 0)"),
        ("shape", "plate", "plate"),
    ],
)
def test_values_of_the_body_have_their_units(key, value, words):
    assert _stated(key, value) == words


@pytest.mark.parametrize(
    ("memory", "told"), [(WHITE, "this is not noise but an error"), (Autoregression((0.7,)), "compatible with noise")]
)
def test_noise_whose_correlation_is_known_is_no_error_of_the_model(memory: Autoregression, told: str) -> None:
    """A residual of correlation 0.7 between neighbours and size 1, of 2000 points."""
    white, noise = np.random.default_rng(3).standard_normal((2000, 2)) @ [1, 1j], np.zeros(2000, dtype=complex)
    for point in range(2000):
        noise[point] = 0.7 * noise[point - 1] + np.sqrt(1 - 0.7**2) * white[point]
    outcome = SimpleNamespace(measured=SimpleNamespace(noise_known=True), noise_memory=memory)
    assert told in _residual_words(outcome, noise)
