"""A fast part of tests/benchmarks/mutations.py: damaged sweeps, specimens, meshes and results give no traceback."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[1] / "benchmarks" / "mutations.py"


@pytest.mark.parametrize("kind", ["sweeps", "specimens", "meshes", "records"])
@pytest.mark.filterwarnings("ignore")
def test_damaged_files_are_right_or_refused_in_one_sentence(kind: str) -> None:
    spec = importlib.util.spec_from_file_location("mutations", SOURCE)
    mutations = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(mutations)
    found = mutations.run(getattr(mutations, kind)(), 250, 11)
    assert set(found) <= {"right", "told", "other", "refused"}, found
    assert found["other"] <= 12
