"""The folder of results: of a command that is refused, and of one that ran before."""

from __future__ import annotations

import os
import time
from pathlib import Path

from femu_piezo.output.folder import older_files
from tests.commands import invoked, succeeded
from tests.specimens import plate

SPEC = f"""{plate("plate", (40e-3, 5e-3, 1e-3), 7500.0)}
[material]
base = "pzt-5h"
[measurement]
file = "missing.csv"
"""


def test_a_refused_run_leaves_no_empty_folder(tmp_path):
    """Nor one of those that it made above it; what was there before stays."""
    (tmp_path / "plate.toml").write_text(SPEC, encoding="utf-8")
    (tmp_path / "there").mkdir()
    for out in ("new/of/plate", "there/of/plate", "there"):
        refused = invoked("update", tmp_path / "plate.toml", "--out", tmp_path / out)
        assert refused.exit_code == 2 and "missing.csv" in refused.output
        assert sorted(path.name for path in tmp_path.iterdir()) == ["plate.toml", "there"]
        assert not any((tmp_path / "there").iterdir())


def test_files_of_an_earlier_run_are_told(tmp_path):
    """Also numbered ones; not what this run wrote, nor files of other names, which may be the user's own."""
    began = time.time()
    ages = {"impedance.png": 60, "impedance_2.png": 60, "report.html": 1e5, "impedance_old.png": 60, "notes.txt": 60}
    for name, age in {**ages, "updated.csv": -1}.items():
        (tmp_path / name).write_text("x")
        os.utime(tmp_path / name, (began - age, began - age))
    names = ("impedance.png", "updated.csv", "report.html")
    assert older_files(tmp_path, names, began) == ["impedance.png", "impedance_2.png", "report.html"]


def test_a_command_names_what_an_earlier_run_left(tmp_path):
    """prony_ss.png of `extract`, from a sweep that had modes; it stays where it is."""
    sweep, stale = Path(__file__).parents[2] / "tutorials/k31_plate/sweep.csv", tmp_path / "prony_ss_2.png"
    stale.write_bytes(b"")
    os.utime(stale, (1e9, 1e9))
    told = succeeded("extract", sweep, "--out", tmp_path).output
    assert f"note: prony_ss_2.png in {tmp_path} belongs to an earlier run" in told and stale.exists()
    assert "prony_ss.png" not in told


def test_an_empty_name_is_no_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plate.toml").write_text(SPEC, encoding="utf-8")
    for name in ("", " "):
        refused = invoked("modes", "plate.toml", "--out", name)
        assert refused.exit_code == 2 and "--out names no folder" in refused.output
    assert [path.name for path in tmp_path.iterdir()] == ["plate.toml"]
