"""Every JSON file that a command writes begins with its schema, and results are written in one place only."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from femu_piezo.errors import InputError
from femu_piezo.files import SCHEMA, as_json, json_text, read_json
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


def test_records_hold_plain_numbers_and_null_where_there_is_none():
    """Numbers of numpy, tuples, NaN and infinity at any depth, and numbers as keys."""
    record = {
        "a": np.float64(0.1),
        "b": (np.int64(3), float("nan"), [np.inf, -np.inf, True, None]),
        "c": {"d": np.array([1.0, np.nan]), 2: "ε"},
        "e": np.bool_(False),
    }
    plain = {"a": 0.1, "b": [3, None, [None, None, True, None]], "c": {"d": [1.0, None], "2": "ε"}, "e": False}
    found = as_json(record)
    assert found == plain and json.loads(json_text(record)) == {"schema": SCHEMA, **plain}
    assert type(found["a"]) is float and type(found["b"][0]) is int and type(found["e"]) is bool
    assert as_json(np.float64("nan")) is None
    exact = np.random.default_rng(1).standard_normal(1000) * 10.0 ** np.arange(-250, 250, 0.5)
    assert np.array_equal(as_json(exact), exact)
    assert json.loads(json_text({"a": np.arange(2)})) == {"schema": SCHEMA, "a": [0, 1]}
    assert "ε" in json_text({"a": "ε"}) and "ε" in json_text({"a": "ε", "b": np.nan})
