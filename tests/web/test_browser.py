"""The page in a real browser: Debian's Chromium, without a screen, driven by Playwright."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from femu_piezo.batch.report import write_report
from femu_piezo.batch.run import LotResult
from femu_piezo.batch.table import write_table
from femu_piezo.files import json_text
from femu_piezo.measurement.readers import write_spectrum
from tests.batch.lots import sweep
from tests.commands import succeeded

from .conftest import TUTORIALS, Server

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
OPTIONS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"]
OPTIONS += ["--disable-component-update", "--disable-sync"]
PATIENCE = 90_000

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine: apt-get install chromium")


@pytest.fixture(scope="module")
def browser() -> Iterator:
    playwright = pytest.importorskip("playwright.sync_api", reason="the browser is driven by playwright")
    with playwright.sync_playwright() as driver:
        found = driver.chromium.launch(executable_path=CHROMIUM, args=OPTIONS)
        yield found
        found.close()


@pytest.fixture
def page(browser) -> Iterator:
    """A window that records its requests and errors."""
    context = browser.new_context(viewport={"width": 1200, "height": 900}, accept_downloads=True)
    found = context.new_page()
    found.set_default_timeout(PATIENCE)
    asked: list[str] = []
    found.on("request", lambda request: asked.append(request.url))
    yield found
    outside = [url for url in asked if not re.match(r"(http|ws)://127\.0\.0\.1:|data:|blob:", url)]
    assert not outside  # no request goes to another machine
    assert asked
    context.close()


def tutorial(name: str, folder: Path) -> None:
    for file in ("plate.toml", "sweep.csv"):
        shutil.copy(TUTORIALS / name / file, folder / file)


def open_page(page, server: Server, path: str) -> None:
    page.goto(f"{server.base}/{path}")
    page.get_by_role("heading", level=1).wait_for()
    page.wait_for_function("window.socket === undefined || window.socket.connected !== false")


def drawn(page) -> None:
    """Wait until a chart stands on the page."""
    page.wait_for_function("document.querySelectorAll('.js-plotly-plot .main-svg').length > 0")


def cells(page, label: str) -> list[list[str]]:
    rows = page.locator(f'[aria-label="{label}"] tbody tr')
    rows.first.wait_for()
    return [row.locator("td").all_inner_texts() for row in rows.all()]


def test_dropped_files_give_the_constants_of_the_command_line(serve, page, tmp_path: Path) -> None:
    server = serve()
    open_page(page, server, "sweep")
    page.set_input_files("input[type=file]", TUTORIALS / "k31_plate" / "sweep.csv")
    page.wait_for_url("**file=sweep.csv*")
    start = page.get_by_role("button", name="Find poles and zeros")
    start.wait_for()
    before = start.bounding_box()["y"]
    drawn(page)
    assert start.bounding_box()["y"] == pytest.approx(before, abs=30)  # the curve above the button has not displaced it
    start.click()
    page.get_by_text("done in").wait_for()
    found = json.loads((tmp_path / "results/sweep.csv/extract/extraction.json").read_text())
    poles = cells(page, "poles and zeros")
    assert [row[0] for row in poles] == ["pole", "zero"]
    assert float(poles[0][1].split(" ")[0]) == pytest.approx(found["poles"][0]["frequency_Hz"], rel=1e-7)
    page.set_input_files("input[type=file]", TUTORIALS / "k31_plate" / "plate.toml")
    page.wait_for_url("**spec=plate.toml*")
    page.get_by_role("link", name="Update", exact=True).click()
    page.get_by_role("button", name="Update the constants").click()
    page.get_by_text("done in").wait_for()
    shown = cells(page, "constants")
    run = succeeded("update", TUTORIALS / "k31_plate/plate.toml", "--out", tmp_path / "terminal")
    printed = [[cell.strip() for cell in line.split("│")[1:-1]] for line in run.output.splitlines() if "│" in line]
    for name, unit, value, tangent, most in shown:
        row = next(one for one in printed if one[0] == name)
        assert [unit, value, tangent, most] == [row[1], row[3], row[4], row[5]]
    assert [row[0] for row in shown] == ["s11", "d31", "eps33T"]
    assert page.locator(".js-plotly-plot").count() >= 2
    beyond = page.evaluate(
        """() => [...document.querySelectorAll('.legend')].map(legend => {
            const right = one => one.getBoundingClientRect().right;
            const words = [...legend.querySelectorAll('.legendtext')].map(right);
            return Math.max(...words) - right(legend.querySelector('.bg'));
        })"""
    )
    assert beyond and max(beyond) < 1  # px beyond the edge: no text of a legend is cut off
    names = {path.name for path in (tmp_path / "results/plate.toml/update").iterdir()}
    assert names == {path.name for path in (tmp_path / "terminal").iterdir()} | {"report.html"}


@pytest.mark.slow
def test_a_browser_without_connection_keeps_its_page(serve, page, tmp_path: Path) -> None:
    """Five seconds without a connection, in which a button is pressed: it takes effect on return, without a reload."""
    tutorial("k31_plate", tmp_path)
    open_page(page, serve(), "sweep?file=sweep.csv")
    start = page.get_by_role("button", name="Find poles and zeros")
    drawn(page)
    page.evaluate(
        """() => {
            window.kept = true;
            window.socket.io.reconnectionDelay(5000);
            window.socket.io.randomizationFactor(0);
            window.socket.io.engine.close();
        }"""
    )
    page.wait_for_function("!window.socket.connected")
    start.click()
    page.get_by_text("done in").wait_for()
    assert page.evaluate("window.kept === true")


def test_a_broken_file_is_answered_by_the_sentence_of_the_terminal(serve, page, tmp_path: Path) -> None:
    (tmp_path / "broken.csv").write_text("time,colour\n1,red\n2,blue\n")
    run = subprocess.run(
        [sys.executable, "-m", "femu_piezo.cli", "extract", "broken.csv", "--out", "o"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert run.returncode == 2
    open_page(page, serve(), "sweep?file=broken.csv")
    sentence = page.get_by_role("alert").inner_text()
    assert sentence == run.stderr.strip().removeprefix("femu-piezo: ")
    page.set_input_files("input[type=file]", {"name": "run.py", "mimeType": "text/plain", "buffer": b"1"})
    page.get_by_text("files of this kind are not read").wait_for()
    assert not (tmp_path / "run.py").exists()


def test_a_specimen_is_edited_in_both_ways_undone_and_survives(serve, page, tmp_path: Path) -> None:
    tutorial("k31_plate", tmp_path)
    text = (tmp_path / "plate.toml").read_text()
    server = serve()
    open_page(page, server, "specimen?spec=plate.toml")
    length = page.get_by_label("length", exact=True)
    length.fill("39 mm")
    length.press("Tab")
    page.get_by_text("not saved yet").wait_for()
    assert 'length = "39 mm"' in page.locator(".cm-content").inner_text()
    assert "length 39 mm" in page.locator("svg[role=img]").get_attribute("aria-label")
    length.fill("39 furlongs")
    length.press("Tab")
    page.locator(".q-field--error", has_text="furlongs").wait_for()  # the message is next to the field
    assert page.get_by_role("button", name="Save").is_disabled()
    page.get_by_role("button", name="Undo").click()
    page.get_by_text("not saved yet").wait_for()
    page.reload()
    page.get_by_text("not saved yet").wait_for()
    assert (tmp_path / "plate.toml").read_text() == text
    server.stop()
    again = serve()
    page.context.add_cookies([])
    page.goto(f"{again.base}/specimen?spec=plate.toml")
    page.get_by_text("not saved yet").wait_for()
    editor = page.locator(".cm-content")
    editor.click()
    page.keyboard.press("Control+End")
    page.keyboard.type("# from the text")
    page.get_by_role("button", name="Save").click()
    page.get_by_text("plate.toml is saved").wait_for()
    saved = (tmp_path / "plate.toml").read_text()
    assert 'length = "39 mm"' in saved and saved.endswith("# from the text")


@pytest.mark.slow
def test_jobs_run_two_at_once_are_cancelled_and_seen_after_a_reload(serve, page, tmp_path: Path) -> None:
    tutorial("hidden_effect", tmp_path)
    server = serve()
    open_page(page, server, "diagnosis?spec=plate.toml")
    page.get_by_role("button", name="Diagnose").click()
    page.get_by_text(re.compile("left|longer")).wait_for()
    page.reload()
    page.get_by_text(re.compile("left|longer")).wait_for()
    open_page(page, server, "update?spec=plate.toml")
    page.get_by_role("button", name="Update the constants").click()
    page.get_by_role("button", name=re.compile("jobs: 2 active")).click()
    page.get_by_text(re.compile("update plate.toml: (running|waiting)")).wait_for()
    page.get_by_text("diagnose plate.toml: running").locator("..").get_by_role("button", name="Cancel").click()
    page.get_by_text("diagnose plate.toml: cancelled").wait_for()
    page.keyboard.press("Escape")
    page.get_by_text("done in").wait_for()
    assert (tmp_path / "results/plate.toml/update/update.json").exists()
    left = tmp_path / "results/plate.toml/diagnose"
    for _ in range(100):  # the command ends after its present step
        if not left.exists():
            break
        page.wait_for_timeout(100)
    assert not left.exists()
    open_page(page, server, "diagnosis?spec=plate.toml")
    page.get_by_text("cancelled").first.wait_for()


@pytest.mark.slow
def test_points_are_masked_by_dragging(serve, page, tmp_path: Path) -> None:
    tutorial("k31_plate", tmp_path)
    open_page(page, serve(), "sweep?file=sweep.csv&spec=plate.toml")
    page.get_by_role("switch", name="mask by dragging").click()
    area = page.locator(".js-plotly-plot .nsewdrag").first
    page.wait_for_timeout(800)
    box = area.bounding_box()
    page.mouse.move(box["x"] + 0.2 * box["width"], box["y"] + 40)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 80, steps=8)
    page.mouse.up()
    words = page.get_by_text("left out:").inner_text()
    low, high = (1e3 * float(number) for number in re.findall(r"[\d.]+", words))
    assert 4e3 < low < high < 2e4
    page.get_by_role("button", name="Find poles and zeros").click()
    page.get_by_text("done in").wait_for()
    found = json.loads((tmp_path / "results/sweep.csv/extract/extraction.json").read_text())
    assert 350 < found["points"] < 480
    page.get_by_role("button", name="Write into plate.toml").click()
    page.get_by_text("not saved yet").wait_for()
    assert "mask = [[" in page.locator(".cm-content").inner_text()


@pytest.mark.slow
def test_another_shape_leaves_no_dimension_of_the_former(serve, page, tmp_path: Path) -> None:
    tutorial("k31_plate", tmp_path)
    server = serve()
    open_page(page, server, "specimen?spec=plate.toml")
    page.get_by_label("shape", exact=True).click()
    page.get_by_role("option", name="disk").click()
    diameter = page.get_by_label("diameter", exact=True)
    diameter.fill("10 mm")
    diameter.press("Tab")
    page.get_by_text("not saved yet").wait_for()
    assert "length" not in page.locator(".cm-content").inner_text()
    open_page(page, server, "specimen?spec=new.toml")
    open_page(page, server, "update?spec=new.toml")
    page.get_by_text("new.toml is not saved yet").wait_for()  # and nothing else in its place
    assert page.get_by_role("button", name="Update the constants").count() == 0


@pytest.mark.slow
def test_results_of_an_earlier_state_are_marked(serve, page, tmp_path: Path) -> None:
    tutorial("k31_plate", tmp_path)
    server = serve()
    open_page(page, server, "update?spec=plate.toml")
    page.get_by_role("button", name="Update the constants").click()
    page.get_by_text("done in").wait_for()
    page.locator('[aria-label="constants"]').wait_for()
    assert page.get_by_text("earlier state").count() == 0
    (tmp_path / "plate.toml").write_text((tmp_path / "plate.toml").read_text().replace("40 mm", "39.9 mm"))
    page.reload()
    page.get_by_text("earlier state").wait_for()
    below = page.get_by_role("button", name="Which constants can this sweep determine?")
    before = below.bounding_box()["y"]
    page.locator('[aria-label="residual"] .main-svg').first.wait_for()
    assert below.bounding_box()["y"] == pytest.approx(
        before, abs=30
    )  # the charts above the button have not displaced it


@pytest.mark.slow
def test_a_lot_is_computed_charted_and_leads_to_its_pieces(serve, page, tmp_path: Path) -> None:
    """The folder itself is the lot: two specimens with the same sweep."""
    tutorial("k31_plate", tmp_path)
    (tmp_path / "second.toml").write_text((tmp_path / "plate.toml").read_text().replace("of the paper", "two"))
    server = serve()
    open_page(page, server, "lot")
    page.get_by_role("button", name="Update every specimen").click()
    page.get_by_text("done in").wait_for()
    rows = cells(page, "specimens of the lot")
    assert [row[2] for row in rows] == ["ok", "ok"] and rows[0][3] == rows[1][3] == "15.8396"
    page.locator('[aria-label="control chart"] .js-plotly-plot, [aria-label="control chart"]').first.wait_for()
    page.get_by_role("link", name="k31 plate two").click()
    page.wait_for_url("**spec=second.toml*")


@pytest.mark.slow
def test_labels_of_a_logarithmic_axis_do_not_overlap(serve, page, tmp_path: Path) -> None:
    """|Z| over two decades, where labels of all digits have no room."""
    write_spectrum(sweep(1), tmp_path / "sweep.csv")
    open_page(page, serve(), "sweep")
    drawn(page)
    overlap = page.evaluate(
        """() => { const boxes = [...document.querySelectorAll('.ytick text')].map(one => one.getBoundingClientRect());
            return boxes.some((one, k) => boxes.some((other, n) => n > k && one.top < other.bottom - 1
                && other.top < one.bottom - 1 && one.left < other.right && other.left < one.right)); }"""
    )
    assert not overlap


@pytest.mark.slow
def test_an_unknown_name_in_the_address_is_told(serve, page, tmp_path: Path) -> None:
    """No other sweep or lot is shown in its place; without a name, the first one is."""
    (tmp_path / "tray").mkdir()
    tutorial("k31_plate", tmp_path / "tray")
    server = serve()
    for address, words in (("sweep?file=of+yesterday.csv", "no sweep of yesterday.csv"), ("lot?lot=box", "no lot box")):
        open_page(page, server, address)
        page.get_by_text(f"This folder has {words}; choose another one.").wait_for()
        assert not page.get_by_text("Find poles and zeros").count() and not page.get_by_text("Update every").count()
    open_page(page, server, "sweep")
    drawn(page)
    open_page(page, server, "lot")
    page.get_by_text("Update every specimen").wait_for()


def test_causes_and_candidates_are_shown_with_their_sizes(serve, page, tmp_path: Path) -> None:
    """Of a record as `diagnose` leaves it, with as much as the tables need."""
    tutorial("hidden_effect", tmp_path)
    sizes = {"resistance": {"value": 2.966, "std": 0.008, "unit": "ohm"}}
    cause = {"effect": "series_resistance", "probability": 0.99, "parameters": sizes, "sentence": "of the leads"}
    candidates = [{**cause, "evidence": 4052.1}, {"effect": "leakage", "evidence": -3.2, "parameters": None}]
    told = {"verdict": "effect", "causes": [cause], "candidates": candidates, "notes": [], "parameters": {"after": {}}}
    out = tmp_path / "results" / "plate.toml" / "diagnose"
    out.mkdir(parents=True)
    (out / "diagnosis.json").write_text(json_text({**told, "recommended_measurements": [], "separations": []}))
    open_page(page, serve(), "diagnosis?spec=plate.toml")
    assert cells(page, "named causes") == [
        ["series resistance", "0.990", "resistance (2.9660 ± 0.0080) Ω", "of the leads"]
    ]
    page.get_by_text("Candidates, each alone").click()
    assert [row[1:] for row in cells(page, "candidates")] == [
        ["+4052.1", "resistance (2.9660 ± 0.0080) Ω"],
        ["-3.2", ""],
    ]


def test_a_lot_shows_every_piece_its_diagnosis_and_its_report(serve, page, tmp_path: Path) -> None:
    """Rows of 27 pieces as `batch` leaves them, 25 on the first page of the table; the report in words has a link."""
    out = tmp_path / "results" / "lot" / "batch"
    out.mkdir(parents=True)
    tutorial("k31_plate", tmp_path)
    shutil.copytree(TUTORIALS / "k31_plate", tmp_path / "lot")
    columns = {"status": "ok", "reason": "", "k_eff": 0.45, "diagnosis": "misfit that no candidate explains"}
    rows = [{"number": n, "file": f"{n}.toml", "specimen": f"piece {n}", **columns} for n in range(1, 28)]
    write_table(rows, out / "table.csv", out / "table.parquet")
    write_report(LotResult(rows, 0, 27), out)
    open_page(page, serve(), "lot?lot=lot")
    shown = cells(page, "specimens of the lot")
    assert len(shown) == 25 and shown[0][-1] == columns["diagnosis"]
    page.get_by_text("1-25 of 27").wait_for()
    with page.context.expect_page() as opened:
        page.get_by_role("link", name="lot.txt").click()
    assert opened.value.inner_text("body").startswith("27 specimens: 27 updated")


@pytest.mark.slow
def test_the_pages_are_used_by_keyboard_and_fit_a_narrow_window(serve, page, tmp_path: Path) -> None:
    tutorial("k31_plate", tmp_path)
    server = serve()
    page.set_viewport_size({"width": 380, "height": 800})
    for path in ("sweep", "specimen", "update", "diagnosis", "modes", "lot", "export"):
        open_page(page, server, path)
        page.wait_for_timeout(600)
        wide = page.evaluate("document.documentElement.scrollWidth")
        assert wide <= 380, f"{path} is {wide} wide"
        unnamed = page.evaluate(
            """() => [...document.querySelectorAll('button, input, [role=switch], a')].filter(e =>
                e.offsetParent && e.type !== 'file' && !(e.innerText || '').trim() && !e.getAttribute('aria-label')
                && !(e.labels && e.labels.length) && !e.getAttribute('aria-labelledby') && !e.title
                && !e.closest('.js-plotly-plot, .q-uploader, .q-field__append, .q-table__bottom'))
                .map(e => e.outerHTML.slice(0, 200))"""
        )
        assert not unnamed, f"{path}: {unnamed}"
    open_page(page, server, "sweep")
    for _ in range(3):
        page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    page.wait_for_url(re.compile("/(specimen|update)"))


@pytest.mark.slow
def test_a_hidden_effect_is_named_accepted_and_gone(serve, page, tmp_path: Path) -> None:
    tutorial("hidden_effect", tmp_path)
    server = serve()
    open_page(page, server, "diagnosis?spec=plate.toml")
    page.get_by_role("button", name="Diagnose").click()
    page.get_by_text("Cause of the misfit: series resistance.").wait_for(timeout=200_000)
    assert cells(page, "named causes")[0][0] == "series resistance"
    page.get_by_role("button", name="Accept").click()
    page.wait_for_url("**spec=plate-extended.toml*")
    page.get_by_role("button", name="Diagnose").click()
    page.get_by_text("The simulation explains this sweep").wait_for(timeout=200_000)
    assert "series_resistance" in (tmp_path / "plate-extended.toml").read_text()
