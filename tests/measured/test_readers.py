"""Measured sweeps are read (data outside the repository; see ../shared/measured/README.md for their sources)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from femu_piezo.errors import InputError
from femu_piezo.measurement.noise import estimate_noise
from femu_piezo.measurement.orientation import turning_sense
from femu_piezo.measurement.readers import read_spectrum


def test_k31_bar(measured_folder: Path) -> None:
    """G and B read off a printed figure; conductance peaks at 128.1 kHz, resistance at 134.5 kHz (README)."""
    spectrum = read_spectrum(measured_folder / "k31_bar_pzt_12x3x1mm.txt")
    assert len(spectrum.notes) == 1 and "straight lines of conductance and susceptance" in spectrum.notes[0]
    assert (len(spectrum), spectrum.frequency[0], spectrum.frequency[-1]) == (301, 110e3, 140e3)
    assert spectrum.frequency[np.argmax(spectrum.admittance.real)] == pytest.approx(128.1e3, abs=100)
    assert spectrum.frequency[np.argmax(spectrum.impedance.real)] == pytest.approx(134.5e3, abs=100)
    assert spectrum.admittance[0] == pytest.approx(1.47e-5 + 3.57e-4j)
    assert 5e-4 < estimate_noise(spectrum).relative < 5e-3  # values of three digits have steps of 1e-3 … 1e-2


def test_disk(measured_folder: Path) -> None:
    spectrum = read_spectrum(measured_folder / "disk_radial_35x2mm.csv")
    assert spectrum.notes == ()
    assert (len(spectrum), spectrum.frequency[0], spectrum.frequency[-1]) == (201, 50e3, 72e3)
    assert np.abs(spectrum.impedance[0]) == pytest.approx(164.312418656)
    assert np.degrees(np.angle(spectrum.impedance[0])) == pytest.approx(-86.6263720032)


def test_turned_phase_is_named_and_corrected(measured_folder: Path) -> None:
    path = measured_folder / "hp4294a_sample.txt"
    with pytest.raises(InputError, match=r"801 of 801 points.*turned by 180°.*correct_phase = true"):
        read_spectrum(path)
    spectrum = read_spectrum(path, correct_phase=True)
    assert len(spectrum) == 801
    assert np.abs(spectrum.impedance[0]) == pytest.approx(1088.817)
    assert np.degrees(np.angle(spectrum.impedance[0])) == pytest.approx(94.18821 - 180)
    # corrected, it is a passive capacitor with one resonance, inductive between pole and zero, its locus clockwise
    assert spectrum.impedance.real.min() > 78
    signs = np.sign(spectrum.impedance.imag)
    assert (signs[0], signs[-1], np.sum(np.diff(signs) != 0)) == (-1, -1, 2)
    assert turning_sense(spectrum.impedance) < -1
