"""A fast sample of tests/benchmarks/mutations.py: damaged sweeps, specimens, meshes and results never give a
traceback.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from femu_piezo.measurement.tables import read_table

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


@pytest.mark.parametrize("last", [",", "\t", "\t,", ""])
def test_a_last_line_of_delimiters_alone_is_no_row(last):
    """Also where the numbers are separated by tabs."""
    rows = ["Frequency (Hz)\tR1 (Ohm)", *(f"{1e3 * (i + 1):.3f}\t{5.0 + i:.3f}" for i in range(20))]
    assert read_table([*rows, last], "x", 1).values.shape == (20, 2)
