"""Pictures of specimens and sweeps whatever their names are."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.commands import succeeded

PLATE = Path(__file__).resolve().parents[2] / "tutorials" / "k31_plate"


@pytest.mark.parametrize("command", ["simulate", "extract", "circuit", "update", "datasheet", "identify"])
def test_a_name_with_dollar_signs_is_no_formula(command, tmp_path):
    (tmp_path / "plate.toml").write_text((PLATE / "plate.toml").read_text().replace("of the paper", "$x_$, $3"))
    shutil.copy(PLATE / "sweep.csv", tmp_path / "sweep.csv")
    shutil.copy(PLATE / "sweep.csv", tmp_path / "$x_$.csv")
    file = "$x_$.csv" if command in ("extract", "circuit") else "plate.toml"
    succeeded(command, tmp_path / file, "--out", tmp_path / "out")
    assert list((tmp_path / "out").glob("*.png"))
