"""Every JSON file that a command writes begins with its schema, and results are written in one place only."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from femu_piezo.errors import InputError
from femu_piezo.files import SCHEMA, json_text, read_json
from tests.commands import succeeded

PACKAGE = Path(__file__).resolve().parents[1] / "femu_piezo"
PLATE = """[geometry]
shape = "plate"
length = "12 mm"
width = "3 mm"
thickness = "1 mm"
[material]
base = "pzt-5h"
tan_s11 = 0.01
[simulation]
start = "60 kHz"
stop = "160 kHz"
points = 201
noise = 0.001
"""


def test_commands_write_the_schema_first(tmp_path):
    (tmp_path / "plate.toml").write_text(PLATE, encoding="utf-8")
    for words in (["simulate", "plate.toml"], ["extract", "out/impedance.csv"], ["circuit", "out/impedance.csv"]):
        succeeded(words[0], tmp_path / words[1], "--out", tmp_path / "out")
    files = sorted((tmp_path / "out").glob("*.json"))
    assert [file.name for file in files] == ["circuit.json", "extraction.json", "simulation.json"]
    for file in files:
        assert next(iter(json.loads(file.read_text(encoding="utf-8")).items())) == ("schema", SCHEMA)


def test_results_are_turned_to_json_in_one_place():
    """The exceptions are no results: data of the page, of charts and scenes, strings of TOML, and content hashed by
    a store.
    """
    others = {"output/scene.py", "output/chart.py", "specimen/file.py", "files.py", "store/entry.py"}
    found = {
        str(path.relative_to(PACKAGE))
        for path in PACKAGE.rglob("*.py")
        if "web" not in path.parts and re.search(r"\bjson\.dumps?\(", path.read_text(encoding="utf-8"))
    }
    assert found <= others, found - others


def test_written_files_are_read_and_incomplete_ones_refused(tmp_path):
    path = tmp_path / "x.json"
    path.write_text(json_text({"a": 1.5}), encoding="utf-8")
    assert read_json(path, 1000, "a result") == {"schema": SCHEMA, "a": 1.5}
    broken = ("", "[1]", '{"a": ', "\ufeff{}", "[" * 100_000)
    for content in (*broken, '{"schema": "2"}', '{"schema": null}', '{"schema": 0}'):
        path.write_text(content, encoding="utf-8")
        with pytest.raises(InputError, match=r"^\S+x.json: this (is not a result|file has schema)"):
            read_json(path, 1_000_000, "a result")
    with pytest.raises(ValueError, match="JSON compliant"):
        json_text({"a": float("nan")})
