"""The measured disk of the tutorial: four constants from its one mode, and that no linear body fits it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from femu_piezo import diagnose, read_specimen, update
from femu_piezo.effects.library import circuits
from femu_piezo.extraction.linear_body import linear_body_misfit

DISK = Path(__file__).resolve().parents[2] / "tutorials" / "measured_disk" / "disk.toml"


@pytest.fixture
def disk(measured_folder, monkeypatch):
    monkeypatch.setenv("FEMU_PIEZO_MEASURED", str(measured_folder))
    return read_specimen(DISK)


def test_one_radial_mode_determines_d31_and_eps33T_but_not_s11_and_s12(disk):
    weights = {"measurement": disk.measurement.model_copy(update={"noise": 0.005})}
    result = update(disk.model_copy(update=weights))
    assert {name: result.known.verdict(name) for name in result.parameters} == {
        "s11": "not",
        "s12": "not",
        "d31": "well",
        "eps33T": "well",
    }
    (outcome,) = result.outcomes
    bound = linear_body_misfit(outcome.measured.spectrum, [55.6e3])
    assert bound < outcome.rms_after < 1.2 * bound


def test_report_says_that_no_linear_body_fits(disk):
    """With circuits as the only candidates, which explain nothing; the tutorial tries every effect."""
    wish = disk.measurement.model_copy(update={"held_out": (60e3, 63e3)})
    found = diagnose(disk.model_copy(update={"measurement": wish}), effects=(circuits.candidates,))
    assert np.array_equal(found.fitted, np.abs(found.spectrum.frequency - 61.5e3) > 1.5e3)
    assert found.verdict == "unknown" and max((one.probability for one in found.causes), default=0.0) < 0.9
    assert found.linear_body.to_blame and found.linear_body.resonances == 1
