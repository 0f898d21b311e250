"""Every tutorial runs, passes its own assertions and writes its pictures; each opens as a notebook."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from femu_piezo.specimen.file import read_specimen
from tests.variants import variants

FOLDER = Path(__file__).resolve().parents[2] / "tutorials"
#: tutorial → pictures it must write
PICTURES = {
    "k31_plate": ("extraction.png", "impedance.png", "iterations.png", "sensitivity.png"),
    "k33_bar": ("impedance.png", "iterations.png"),
    "paper": ("baseline.png", "prony_ss.png", "printed.png", "iteration.png", "sensitivity.png"),
    "measured_bar": ("critique.png", "impedance.png", "diagnosis.png"),
    "measured_disk": ("poisson_and_q.png", "impedance.png", "diagnosis.png"),
    "trapezoid": ("impedance.png", "modes.png", "mode_01.png", "mode_02.png"),
    "full_set": ("determined.png", "sensitivity_k31.png", "sensitivity_k33.png", "sensitivity_k15.png"),
    "stated_uncertainty": ("intervals.png", "budget.png"),
    "hidden_effect": ("bias.png", "diagnosis.png"),
    "own_effect": ("end_mass.png", "diagnosis.png"),
    "several_sweeps": ("told_apart.png", "diagnosis_1.png", "diagnosis_2.png"),
}
SLOW = {
    "paper",
    "k33_bar",
    "measured_bar",
    "measured_disk",
    "trapezoid",
    "full_set",
    "stated_uncertainty",
    "hidden_effect",
    "own_effect",
    "several_sweeps",
}
MEASURED = {"measured_bar", "measured_disk"}
PAGES = [FOLDER.parent / "README.md", *sorted((FOLDER.parent / "docs").glob("*.md"))]
PAGES += sorted((FOLDER.parent / "docs").glob("how-to/*.md"))
SCRIPTS = sorted(path for path in FOLDER.glob("*/*.py") if path.stem == path.parent.name)


def test_every_tutorial_is_listed_here():
    assert {path.stem for path in SCRIPTS} == set(PICTURES)


@pytest.mark.parametrize("name", variants(PICTURES, slow=SLOW))
def test_tutorial_runs(name, tmp_path, request):
    environment = {**os.environ, "FEMU_PIEZO_OUT": str(tmp_path), "OMP_NUM_THREADS": "1"}
    if name in MEASURED:
        environment["FEMU_PIEZO_MEASURED"] = str(request.getfixturevalue("measured_folder"))
    script = FOLDER / name / f"{name}.py"
    answer = subprocess.run(
        [sys.executable, str(script)], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300
    )
    assert answer.returncode == 0, answer.stdout + answer.stderr
    assert re.search(r"\d", answer.stdout)  # it prints its figures
    for picture in PICTURES[name]:
        assert (tmp_path / name / picture).stat().st_size > 5000, picture


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_tutorial_is_a_notebook_that_asserts(path):
    """Cells begin with # %%, the first one is a title in markdown; there are two assertions at least, none without a
    comparison.
    """
    text = path.read_text(encoding="utf-8")
    cells = re.split(r"^# %%", text, flags=re.M)
    assert cells[0] == "" and re.match(r" \[markdown\]\n# # \w", cells[1])
    assert len(cells) > 5
    for cell in cells[1:]:
        if cell.startswith(" [markdown]"):
            assert all(line.startswith("#") for line in cell.splitlines()[1:] if line.strip())
        else:
            ast.parse("\n".join(cell.splitlines()[1:]))  # each cell of code can be parsed alone
    asserted = [node.test for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Assert)]
    assert len(asserted) >= 2
    assert all(isinstance(test, (ast.Compare, ast.Call, ast.BoolOp)) for test in asserted)


def test_thumbnails_are_small_and_shown():
    pages = "".join(path.read_text(encoding="utf-8") for path in PAGES)
    thumbnails = sorted((FOLDER / "gallery").glob("*.png"))
    assert len(thumbnails) >= 6
    for path in thumbnails:
        assert path.stat().st_size < 100_000
        assert f"tutorials/gallery/{path.name}" in pages


def test_every_sweep_of_the_tutorials_is_simulated():
    """Measured sweeps stay outside of the repository: each sweep has the script that makes it next to it."""
    sweeps = [path for path in FOLDER.rglob("*") if path.suffix in {".csv", ".txt"}]
    assert {path.name for path in sweeps} == {"sweep.csv", "up.csv", "down.csv"}
    assert all((path.parent / "make_sweep.py").is_file() for path in sweeps)


def test_specimens_in_the_documentation_are_read(tmp_path):
    """Specimen files that a newcomer copies from README or a guide are valid."""
    pages = "".join(path.read_text(encoding="utf-8").replace("\n   ", "\n") for path in PAGES)
    blocks = [block for block in re.findall(r"```toml\n(.*?)```", pages, flags=re.S) if "[geometry]" in block]
    shapes = []
    for number, block in enumerate(blocks):
        path = tmp_path / f"specimen_{number}.toml"
        path.write_text(block, encoding="utf-8")
        shapes.append(read_specimen(path).geometry.shape)
    assert {"plate", "trapezoid", "disk", "mesh"} <= set(shapes)
