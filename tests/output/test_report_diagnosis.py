"""The report of a diagnosis: all verdicts in words, the numbers of diagnosis.json, and charts that run in a browser."""

from __future__ import annotations

import asyncio
import hashlib
import json
import re
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from test_report import Page

from femu_piezo.batch.table import CONSTANT_COLUMNS, DIAGNOSIS_COLUMNS, UPDATE_COLUMNS
from femu_piezo.diagnosis.averaging import Averaged
from femu_piezo.diagnosis.rules import Rules
from femu_piezo.effects.effect import Effect, EffectParameter
from femu_piezo.effects.library import circuits, losses
from femu_piezo.effects.words import quantity
from femu_piezo.inference.unknowns import Estimate
from femu_piezo.material.constants import EPS0
from femu_piezo.measurement.discrepancy import Discrepancy
from femu_piezo.output.diagnosis import diagnosis_record
from femu_piezo.output.diagnosis_tables import fitted_sizes
from femu_piezo.output.diagnosis_words import _best_candidate, _form, _likely, answer, moved_by_others
from femu_piezo.output.folder import prepare_folder, write_json
from femu_piezo.output.report_diagnosis import _candidates, write_diagnosis_report
from femu_piezo.output.tables import interval_text
from femu_piezo.output.wording import band, listed, merged
from femu_piezo.specimen.file import read_specimen
from femu_piezo.study.diagnose import LinearBody, diagnose
from tests.commands import succeeded
from tests.noise import noisy

TUTORIAL = Path(__file__).resolve().parents[2] / "tutorials" / "hidden_effect"
NOISE, HIGHEST = 2e-3, 140e3


@dataclass(frozen=True)
class Case:
    """A diagnosed sweep: its folder, record, page, and the text of the section of answers without markup.

    terminal : what the command printed; empty where it was not run
    """

    folder: Path
    record: dict
    page: Page
    first: str
    terminal: str


def _holder(omega: np.ndarray) -> np.ndarray:
    """Admittance of a resonator at 100 kHz parallel to the specimen, such as a resonating holder, S."""
    own = (2 * np.pi * 100e3) ** 2 * (1 + 0.02j)
    return 1j * omega * 8e-12 * own / (own - omega**2)


def _diagnosed(folder: Path, verdict: str) -> Case:
    """A diagnosis of the tutorial's plate around its fundamental, with noise added.

    verdict : "effect", 8 Ω in the leads; "none"; "unknown", a resonating holder; "points", a resonance that softens
    """
    f, real, imag = np.loadtxt(TUTORIAL / "sweep.csv", delimiter=",", skiprows=1).T
    z = real + 1j * imag
    f, z = f[f <= HIGHEST], z[f <= HIGHEST]
    z = z + (6.5 if verdict == "effect" else -1.5)
    if verdict == "unknown":
        z = 1 / (1 / z + _holder(2 * np.pi * f))
    if verdict == "points":  # the resonance falls by up to 0.5 % where the current is high
        conductance = (1 / z).real
        moved = f * (1 + 5e-3 * conductance / conductance.max())
        z = np.interp(moved, f, z.real) + 1j * np.interp(moved, f, z.imag)
    z = noisy(z, np.sqrt(NOISE**2 - 1e-6), 5)
    rows = "".join(f"{a!r},{b.real!r},{b.imag!r}\n" for a, b in zip(f.tolist(), z.tolist(), strict=True))
    (folder / "sweep.csv").write_text("frequency_Hz,resistance_ohm,reactance_ohm\n" + rows, encoding="utf-8")
    text = (TUTORIAL / "plate.toml").read_text(encoding="utf-8").replace("noise = 0.001", f"noise = {NOISE}")
    text = "\n".join(line for line in text.splitlines() if not line.startswith("held_out"))
    (folder / "plate.toml").write_text(f"{text}\n", encoding="utf-8")
    if verdict == "effect":
        answer = succeeded("diagnose", folder / "plate.toml", "--out", folder / "out", "--report")
        terminal = answer.output
    else:  # one cause at most of few candidates, which is enough for the words and much faster
        few, terminal = [circuits.candidates, losses.candidates], ""
        result = diagnose(read_specimen(folder / "plate.toml"), rules=Rules(most_causes=1), effects=few)
        prepare_folder(folder / "out")
        write_json(folder / "out/diagnosis.json", diagnosis_record(result))
        write_diagnosis_report(folder / "out/report.html", result)
    record = json.loads((folder / "out/diagnosis.json").read_text(encoding="utf-8"))
    text = (folder / "out/report.html").read_text(encoding="utf-8")
    one = re.search(r'<section id="answers">(.*?)</section>', text, flags=re.S)[1]
    return Case(folder, record, Page(text), re.sub(r"<[^>]+>", " ", one), terminal)


@pytest.fixture(scope="module")
def effect(tmp_path_factory) -> Case:
    return _diagnosed(tmp_path_factory.mktemp("effect"), "effect")


@pytest.fixture(scope="module")
def none(tmp_path_factory) -> Case:
    return _diagnosed(tmp_path_factory.mktemp("none"), "none")


@pytest.fixture(scope="module")
def unknown(tmp_path_factory) -> Case:
    return _diagnosed(tmp_path_factory.mktemp("unknown"), "unknown")


def test_a_headline_names_what_is_more_probable_than_not():
    """Causes with a probability of 0.5 at least; if there is none, the most probable one."""
    small, large, half = (SimpleNamespace(probability=p) for p in (0.0, 0.67, 0.5))
    assert _likely([small, large, half]) == [large, half]
    assert _likely([small, SimpleNamespace(probability=0.3)])[0].probability == 0.3


def test_a_limit_that_another_effect_reached_is_not_told():
    """A fit with `wrong_width_end` at its limit, of the candidate `wrong_width`, whose name the other begins with."""
    parameter = EffectParameter("relative_error", "1", -0.3, 0.3, 0.001, 0.01)
    told = []
    for reached in ("wrong_width_end", "wrong_width"):
        held_out = SimpleNamespace(rms=1.0)
        found = SimpleNamespace(chi_square=1.0, held_out=held_out, on_bound=(f"{reached}.relative_error",))
        effect = Effect("wrong_width", "the width is wrong", (parameter,))
        trial = SimpleNamespace(effect=effect, fit=found, log_odds=1.0, values=np.array([0.01]), std=np.array([0.001]))
        comparison = SimpleNamespace(base=found, singles=[trial])
        told.append("at a limit of its range" in _candidates(SimpleNamespace(comparison=comparison)))
    assert told == [False, True]


def test_a_guess_is_not_told_as_the_cause(effect):
    """Below 0.9 the headline, the constants and the advice say that the cause is not certain."""
    specimen = read_specimen(effect.folder / "plate.toml")
    result = diagnose(specimen, rules=Rules(most_causes=1), effects=[circuits.candidates])
    verdict, told = result.verdict, []
    for probability in (0.97, 0.53):
        causes = tuple(replace(cause, probability=probability) for cause in verdict.causes)
        told.append(answer(replace(result, verdict=replace(verdict, causes=causes))))
    sure, guess = told
    assert sure.headline == "Cause of the misfit: series resistance."
    assert guess.headline == "Possible cause of the misfit: series resistance (probability 0.53)."
    assert guess.constants[0] == "With this cause, which is not certain, constants change:"
    assert sure.constants == guess.constants[1:] and sure.constants[0].startswith("tan ")
    assert sure.measures[0].startswith("Continue with extended.toml")
    assert guess.measures[0].startswith("Confirm this cause before using the constants")


def test_the_reference_explains_every_key_and_column(effect):
    page = (TUTORIAL.parents[1] / "docs/reference/results.md").read_text(encoding="utf-8")
    section = page.split("## diagnosis.json")[1].split("## Tables")[0]
    known = set(re.findall(r"`(\w+)`", section))
    assert set(effect.record) - {"schema"} <= known
    for part in ("gain", "model", "noise", "remaining"):
        assert set(effect.record[part]) <= known, part
    assert set(effect.record["causes"][0]) | set(effect.record["candidates"][0]) <= known
    curves = (effect.folder / "out/curves.csv").read_text(encoding="utf-8").split("\n")[0].split(",")
    columns = {*curves, *DIAGNOSIS_COLUMNS, *UPDATE_COLUMNS} - {*CONSTANT_COLUMNS, "frequency_Hz"}
    assert columns <= set(re.findall(r"`(\w+)`", page))


def test_the_terminal_shows_the_first_recommendations(effect):
    count = len(effect.record["recommended_measurements"])
    assert count > 5 and effect.terminal.count("recommended: ") == 5
    assert f"{count - 5} further recommendations in diagnosis.json" in " ".join(effect.terminal.split())


def test_effect_is_reported_in_words_and_figures(effect):
    assert effect.record["verdict"] == "effect"
    (cause,) = effect.record["causes"]
    assert cause["effect"] == "series_resistance"
    found = cause["parameters"]["resistance"]
    told = re.search(r"resistance \(([\d.]+) ± ([\d.]+)\) Ω", effect.first)
    assert float(told[1]) == pytest.approx(found["value"], abs=found["std"] / 10)
    assert float(told[2]) == pytest.approx(found["std"], rel=0.05)
    assert cause["sentence"] in effect.first
    assert "Series resistance is practically certain (probability above 0.999" in effect.first
    gain = effect.record["gain"]
    assert f"falls from {100 * gain['held_out_before']:.3g} % to {100 * gain['held_out_after']:.3g} %" in effect.first
    assert (
        f"{gain['over_expected']:.3g} times the error that noise causes" in effect.first
        and 0.8 < gain["over_expected"] < 1.2
    )
    assert f"the noise is {100 * gain['noise_floor']:.3g} %" in effect.first
    before, after = (effect.record["parameters"][when]["eps33T"]["tan"] for when in ("before", "after"))
    assert f"tan eps33T had come out {100 * (before / after - 1):.2g} % too large" in effect.first
    assert "extended.toml" in effect.first
    s11 = effect.record["parameters"]["after"]["s11"]
    away = [(end - s11["value"]) / s11["std"] for end in s11["interval"]]
    assert away[0] < -1.9 and away[1] > 1.9  # the density, for example, cannot be told from s11
    text = (effect.folder / "out/report.html").read_text(encoding="utf-8")
    assert "95 %, averaged over causes" in text and interval_text(*(1e12 * end for end in s11["interval"])) in text


def _known(averaged: Averaged) -> SimpleNamespace:
    """A result whose s11 and ε33T are known by the average over sets of causes."""
    ends, pairs = averaged.interval(0.95).tolist(), zip(averaged.mean[0], averaged.std[0], strict=True)
    numbers = [float(number) for pair in pairs for number in pair]
    after = {
        "s11": Estimate(*numbers[:4], interval=tuple(ends[0]), tan_interval=tuple(ends[1])),
        "eps33T": Estimate(*numbers[4:], interval=tuple(ends[2]), tan_interval=tuple(ends[3])),
    }
    final = SimpleNamespace(parameters=SimpleNamespace(causes=()))
    return SimpleNamespace(after=after, comparison=SimpleNamespace(averaged=averaged, final=final, discrepant=False))


def test_constants_that_another_cause_would_change_are_named():
    """A cable, with a probability of 10 %, would change ε33T alone."""
    mean, std = np.array([[1.6e-11, 0.02, 3e-8, 0.02]] * 2), np.array([[1e-13, 1e-4, 1e-10, 1e-4]] * 2)
    mean[1, 2] = 2.5e-8
    averaged = Averaged(((), ("cable",)), (False, False), np.array([0.9, 0.1]), mean, std)
    (sentence,) = moved_by_others(_known(averaged))
    low, high = averaged.interval(0.95)[2] / EPS0
    assert low == pytest.approx(2.5e-8 / EPS0, rel=0.02) and high > 3e-8 / EPS0
    assert f"eps33T lies within {low:.0f} to {high:.0f} ε₀, with a probability of 95 %" in sentence
    assert ": cable, which this sweep does not exclude, would change it" in sentence
    assert moved_by_others(_known(replace(averaged, weights=np.array([1.0, 0.0])))) == ()


def test_constants_that_another_law_of_the_named_cause_would_change():
    """Two laws of one cause, nearly equally probable: the other law is named, not "several other causes"."""
    mean, std = np.array([[1.6e-11, 0.02, 3e-8, 0.02]] * 2), np.array([[1e-13, 1e-4, 1e-10, 1e-4]] * 2)
    mean[1, 0] = 1.5e-11
    laws = (("frequency_dependent_elastic_loss/causal",), ("frequency_dependent_elastic_loss",))
    result = _known(Averaged(laws, (False, False), np.array([0.6, 0.4]), mean, std))
    result.comparison.final.parameters.causes = (SimpleNamespace(key=laws[0][0]),)
    (sentence,) = moved_by_others(result)
    assert ": another law of frequency dependent elastic loss, which this sweep does not exclude" in sentence


def test_none_is_reported_in_words_and_figures(none):
    assert none.record["verdict"] == "none" and none.record["causes"] == []
    assert "explains this sweep within the noise" in none.first
    assert "No bias was found" in none.first and "Use the constants" in none.first
    seen = none.record["not_visible"]
    assert "unless there is a cause that this sweep cannot show" in none.first
    assert seen and "if none of the effects is there that this sweep cannot show" in none.first
    assert f"the rms error is {100 * none.record['gain']['held_out_before']:.3g} %" in none.first
    candidates = [
        one for one in none.record["candidates"] if one["effect"] != "uneven_body"
    ]  # a form of misfit, not a cause
    assert f"{len(candidates)} candidate effects were tried" in none.first
    best = max(candidates, key=lambda one: one["evidence"])
    assert best["effect"].replace("_", " ") in none.first
    assert "practically certain" not in none.first and "extended.toml" not in none.first


def test_unknown_is_reported_in_words_and_figures(unknown):
    assert unknown.record["verdict"] == "unknown"
    assert all(cause["probability"] < 0.9 for cause in unknown.record["causes"])
    assert "something that no known effect explains" in unknown.first
    if unknown.record["causes"]:
        share = 100 * unknown.record["remaining"]["unexplained"]
        assert (
            f"{share:.3g} % of the misfit remains" in unknown.first
            and "may explain a part of the misfit" in unknown.first
        )
    assert "Do not rely on the constants" in unknown.first and "Averaged over all causes" not in unknown.first
    assert "averaged over causes" not in (unknown.folder / "out/report.html").read_text(encoding="utf-8")
    left = unknown.record["remaining"]["after"]
    low, high = left["worst_Hz"][0]
    assert low < 105e3 and high > 95e3
    assert f"{np.sqrt(left['size']):.3g} times the noise" in unknown.first
    alone = [one for one in unknown.record["unexplained"]["after"]["measured_only"] if one["kind"] == "pole"]
    assert [one["frequency_Hz"] for one in alone] == [pytest.approx(100e3, rel=5e-3)]
    assert f"{alone[0]['frequency_Hz'] / 1e3:.5g} kHz (pole)" in unknown.first
    assert "practically certain" not in unknown.first and "Use the constants" not in unknown.first
    form = unknown.record["discrepancy"]
    assert form["form"] == "a resonance of its own" and form["frequency_Hz"] == pytest.approx(100e3, rel=0.01)
    assert (
        f"The unexplained misfit looks like a resonance of its own near {form['frequency_Hz'] / 1e3:.3g} kHz"
        in unknown.first
    )
    linear = unknown.record["linear_body"]  # specimen and holder together are a linear body
    assert linear["resonances"] == 2 and linear["least"] < 1.3 and linear["model"] > 2
    assert "The simulation is not the cause" not in unknown.first


def test_a_step_is_reported_with_its_place_and_possible_reasons():
    left = Discrepancy("a step", 123.4e3, 1e-3, 1.0, 30.0, np.ones((8, 2)))
    (sentence,) = _form(SimpleNamespace(discrepancy=left))
    assert sentence.startswith(
        "The unexplained misfit looks like a step near 123 kHz: a change of the instrument's range"
    )


def test_the_best_cause_is_named_next_to_a_form_that_is_no_cause():
    """An uneven body is a form of misfit, not a cause."""

    def trial(name: str, odds: float, unknown: bool):
        return SimpleNamespace(effect=SimpleNamespace(title=name, law="", of_unknown=unknown), fit=0, log_odds=odds)

    form = trial("uneven_body", 170.0, True)
    singles = [trial("wedge", -2.0, False), form, trial("tapered_width", 160.0, False)]
    result = SimpleNamespace(comparison=SimpleNamespace(singles=singles), verdict=SimpleNamespace(forms=[form]))
    said = _best_candidate(result)
    assert said.startswith(
        "2 candidate effects were tried; the most probable of them, tapered width, explains less than uneven"
    )
    assert "+160.0" in said


@pytest.mark.slow
def test_points_that_no_linear_body_fits_are_reported(tmp_path):
    case = _diagnosed(tmp_path, "points")
    linear = case.record["linear_body"]
    assert case.record["verdict"] == "unknown" and linear["least"] > max(3, 0.6 * linear["model"])
    assert "the error is in the data, not in the simulation" in case.first
    assert f"misses the points by {linear['least']:.3g} times the noise" in case.first
    assert "at a tenth of the voltage" in case.first and "may explain a part" not in case.first


@pytest.mark.parametrize(
    ("least", "control", "model", "blamed"),
    [(20.2, 0.1, 20.7, True), (1.1, 0.1, 20.7, False), (1.6, 0.1, 1.7, False), (21.1, 21.0, 1.05, False)],
)
def test_data_are_blamed_only_where_a_linear_body_fits_the_simulation(least, control, model, blamed):
    """If the form with so few resonances does not fit the simulated sweep either, the form is too simple."""
    assert LinearBody(1, least, control, model).to_blame == blamed


@pytest.mark.parametrize("name", ["effect", "none", "unknown"])
def test_page_is_whole_and_needs_nothing(name, request):
    case = request.getfixturevalue(name)
    assert case.page.open == []
    sections = [attributes["id"] for tag, attributes in case.page.elements if tag == "section"]
    assert sections[0] == "answers" and sections[-1] == "provenance"
    assert [a["href"] for tag, a in case.page.elements if tag == "a"] == [f"#{one}" for one in sections]
    text = (case.folder / "out/report.html").read_text(encoding="utf-8")
    assert set(re.findall(r"https?://[^\s\"'<>]+", text)) <= {"http://www.w3.org/2000/svg"}
    for tag, attributes in case.page.elements:
        assert re.match(r"^(#|data:)", attributes.get("src") or attributes.get("href") or "#"), (tag, attributes)
    for file in ("plate.toml", "sweep.csv"):
        assert hashlib.sha256((case.folder / file).read_bytes()).hexdigest() in text


@pytest.mark.parametrize("name", ["effect", "none", "unknown"])
def test_numbers_are_those_of_diagnosis_json(name, request):
    case = request.getfixturevalue(name)
    embedded = next(text for attributes, text in case.page.scripts if attributes.get("id") == "record")
    assert json.loads(embedded) == case.record
    assert {key.split(".")[0] for key in case.page.cells} >= {"parameters", "poles", "zeros", "sweeps"}
    assert {f"sweeps.0.standard_figures.0.figures.k31.{what}" for what in ("value", "model")} <= set(case.page.cells)
    for key, (value, _) in case.page.cells.items():
        found = case.record
        for part in key.split("."):
            found = found[int(part)] if part.isdigit() else found[part]
        assert value == found, key


def test_poles_agree_once_the_cause_is_in_the_fit(effect):
    """Q of the worst pole is off by more than 4 σ before, and by less after."""
    before, after = ([abs(one[when]["Q_sigma"]) for one in effect.record["poles"]] for when in ("before", "after"))
    assert max(before) > 4 > max(after)


def test_runs_in_a_browser_and_the_mouse_zooms(effect, tmp_path):
    """Headless Chromium without messages on the console; a drag zooms all charts, a double click restores the whole
    sweep.
    """
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("there is no chromium on this machine")
    pytest.importorskip("tornado")
    from browser import Browser

    ticks = "[...document.querySelectorAll('figure.chart svg')].map(s => s.querySelectorAll('text')[0].textContent)"
    corner = "(() => { const b = document.querySelector('figure.chart svg').getBoundingClientRect();"

    async def drive():
        async with Browser(program, tmp_path) as tab:
            await tab.open(effect.folder / "out/report.html")
            whole = await tab.value(ticks)
            await tab.value("document.querySelector('figure.chart svg').scrollIntoView()")
            left, top, width, height = await tab.value(f"{corner} return [b.left, b.top, b.width, b.height]; }})()")
            y = top + height / 2
            await tab.mouse("mousePressed", left + 0.25 * width, y)
            await tab.mouse("mouseMoved", left + 0.30 * width, y)
            await tab.mouse("mouseReleased", left + 0.40 * width, y)
            zoomed = await tab.value(ticks)
            readout = await tab.value("document.querySelector('.readout').textContent")
            for clicks in (1, 2):
                await tab.mouse("mousePressed", left + 0.5 * width, y, clicks)
                await tab.mouse("mouseReleased", left + 0.5 * width, y, clicks)
            back = await tab.value(ticks)
            pictures = await tab.value("[...document.images].every(i => i.complete && i.naturalWidth > 100)")
            text = await tab.value("document.querySelector('main').innerText")
            return whole, zoomed, readout, back, pictures, text, tab.console

    whole, zoomed, readout, back, pictures, text, console = asyncio.run(drive())
    assert console == []
    assert len(whole) == 4 and back == whole
    assert all(float(after) > float(before) for before, after in zip(whole, zoomed, strict=True))
    assert re.search(r"log \|Z\| −?\d", readout)
    assert pictures and "NaN" not in text and "undefined" not in text


@pytest.mark.parametrize(
    ("name", "unit", "value", "std", "text"),
    [
        ("resistance", "ohm", 1.69, 0.044, "(1.690 ± 0.044) Ω"),
        ("capacitance", "F", 12.3e-12, 0.4e-12, "(12.30 ± 0.40) pF"),
        ("relative_error", "1", -0.0123, 0.0004, "-1.230 ± 0.040 %"),
        ("exponent", "1", 0.5, 0.02, "0.500 ± 0.020"),
        ("mass_per_area", "kg/m^2", 0.02, 0.001, "(20.0 ± 1.0) g/m²"),
        ("resistance", "ohm", 0.0, None, "0 Ω"),
        ("relative_error", "1", 0.02, None, "2 %"),
        ("capacitance", "F", 9.5e-10, None, "950 pF"),
        ("stiffness", "N/m", 9.1e5, None, "910 kN/m"),
        ("added_mass", "kg", 2e-6, 1e-7, "(2.00 ± 0.10) mg"),
        ("shear_load", "kg/(m^2 s^0.5)", -1e-4, 0.518, "(0.00 ± 0.52) kg/(m² s^0.5)"),
        ("radiation", "kg/(m^2 s)", 2e3, 58e3, "(2 ± 58)·10³ kg/(m² s)"),
        ("inverse_capacitance", "1/F", 1.08e5, None, "108 1/mF"),
        ("inverse_capacitance", "1/F", 1.234e6, 2e4, "(1.234 ± 0.020) 1/µF"),
        ("square_slowness", "s^2/m^2", 1e-7, 7e-8, "(100 ± 70)·10⁻⁹ s²/m²"),
        ("volume", "m^3", 2e-10, None, "200·10⁻¹² m³"),
        ("rate", "Hz/s", -1230.0, 20.0, "(-1.230 ± 0.020) kHz/s"),
    ],
)
def test_quantities_are_readable(name, unit, value, std, text):
    assert quantity(EffectParameter(name, unit, -1, 1, 1, 1), value, std) == text


def test_several_fitted_sizes_have_their_names():
    names = (("strength", "1"), ("relaxation_frequency", "Hz"))
    several = tuple(EffectParameter(name, unit, -1, 1, 1, 1) for name, unit in names)
    values, std = np.array([0.0006, 35e3]), np.array([0.0011, 69e3])
    trial = SimpleNamespace(effect=SimpleNamespace(parameters=several), values=values, std=std)
    assert fitted_sizes(trial) == "strength 0.0006 ± 0.0011, relaxation frequency (35 ± 69) kHz"
    trial = SimpleNamespace(effect=SimpleNamespace(parameters=several[1:]), values=values[1:], std=std[1:])
    assert fitted_sizes(trial) == "(35 ± 69) kHz"


def test_touching_bands_are_merged():
    assert merged(((150e3, 160e3), (130e3, 140e3), (141e3, 149.5e3)), 1.5e3) == [(130e3, 160e3)]
    assert merged(((150e3, 160e3), (130e3, 140e3)), 1.5e3) == [(130e3, 140e3), (150e3, 160e3)]
    assert band(130e3, 2.1e6) == "0.13 to 2.1 MHz" and listed(["a", "b", "c"], "or") == "a, b or c"
