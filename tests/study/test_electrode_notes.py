"""Bodies whose electrodes end inside a face carry a note wherever their mesh does not resolve the field there."""

from __future__ import annotations

import json

import pytest

from femu_piezo.specimen.file import read_specimen
from femu_piezo.study.shapes import electrode_notes
from tests.commands import succeeded

PLATE = """
[geometry]
shape = "plate"
length = "10 mm"
width = "3 mm"
thickness = "1 mm"
{more}
[material]
base = "pzt-5h"
"""


def specimen(tmp_path, more: str):
    path = tmp_path / "plate.toml"
    path.write_text(PLATE.format(more=more), encoding="utf-8")
    return path


PARTIAL = ['electrode_length = "5 mm"', 'electrode_margin = "0.5 mm"', 'wrap_length = "1 mm"\nwrap_gap = "0.5 mm"']


@pytest.mark.parametrize("more", PARTIAL)
def test_partial_electrodes_carry_a_note(more, tmp_path):
    """For tetrahedra and for bodies with round corners; a grid keeps the accuracy asked for and needs none."""
    assert electrode_notes(read_specimen(specimen(tmp_path, more))) == ()
    (round_corners,) = electrode_notes(read_specimen(specimen(tmp_path, more + '\ncorner_radius = "0.3 mm"')))
    assert "up to 1e-3 in λ" in round_corners and "tetrahedron" in round_corners
    (tetrahedra,) = electrode_notes(read_specimen(specimen(tmp_path, more + '\nelements = "tetrahedron"')))
    assert "a few 1e-4 in λ" in tetrahedra


def test_full_electrodes_need_no_note(tmp_path):
    assert electrode_notes(read_specimen(specimen(tmp_path, ""))) == ()


def test_commands_print_and_record_it(tmp_path):
    path = specimen(tmp_path, 'electrode_length = "5 mm"\nelements = "tetrahedron"\n')
    path.write_text(path.read_text(encoding="utf-8") + "[update]\naccuracy = 1e-2\n", encoding="utf-8")
    answer = succeeded("modes", path, "--out", tmp_path / "out", "--band", "100000", "200000")
    assert "note:" in answer.output and "singular" in answer.output
    record = json.loads((tmp_path / "out/modes.json").read_text(encoding="utf-8"))
    assert len(record["notes"]) == 1 and "singular" in record["notes"][0]
