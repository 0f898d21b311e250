"""Extraction from real sweeps (sources in the README of the folder of measured sweeps)."""

import numpy as np
import pytest

from femu_piezo.extraction import extract
from femu_piezo.extraction.roots import Pair
from femu_piezo.measurement.readers import read_spectrum


def one_pair(extraction) -> Pair:
    """The single pole and zero of an extraction."""
    assert len(extraction.resonances.poles) == len(extraction.resonances.zeros) == 1
    (pair,) = extraction.pairs
    return pair


def test_k31_bar_of_tsurumi(measured_folder):
    """Conductance peaks at 128.1 kHz, resistance at 134.5 kHz (README); readings from a printed figure."""
    found = extract(read_spectrum(measured_folder / "k31_bar_pzt_12x3x1mm.txt"))
    pair = one_pair(found)
    assert pair.pole.frequency_Hz == pytest.approx(128.1e3, abs=100)
    assert pair.zero.frequency_Hz == pytest.approx(134.5e3, abs=100)
    # the 1-D bar fitted to log Y has tan(s11) = 0.0115 (README): loss of the pole, and k31 = 0.338 gives k_eff
    assert pair.pole.loss == pytest.approx(0.0115, abs=3 * pair.pole.std_loss)
    assert pair.k_eff == pytest.approx(0.304, abs=0.004)
    assert found.status == "correlated_residual"
    assert np.nanmax(np.abs(found.residual)) < 6


def test_radial_disk_of_li(measured_folder):
    """Q is about 80 at the resonance and 140 at the antiresonance, so the piezoelectric loss is the largest."""
    found = extract(read_spectrum(measured_folder / "disk_radial_35x2mm.csv"))
    pair = one_pair(found)
    assert pair.pole.quality_factor == pytest.approx(80, rel=0.05)
    assert pair.zero.quality_factor == pytest.approx(140, rel=0.03)
    # narrow windows give a pole at 55 589 Hz, which has to lie within the stated deviation
    assert abs(pair.pole.frequency_Hz - 55_589) < 2 * pair.pole.std_Hz
    assert pair.coupling_phase < -3 * pair.std_coupling_phase
    assert "above the mean of the dielectric and elastic" in found.remarks[0]


def test_a_narrow_window_of_the_disk_agrees(measured_folder):
    sweep = read_spectrum(measured_folder / "disk_radial_35x2mm.csv")
    whole, window = extract(sweep), extract(sweep.band(67.5e3, 70.5e3))
    zero, near = whole.resonances.zeros[0], max(window.resonances.zeros, key=lambda r: abs(r.residue))
    assert near.frequency_Hz == pytest.approx(zero.frequency_Hz, abs=2 * zero.std_Hz)
    assert near.loss == pytest.approx(zero.loss, abs=2 * zero.std_loss)


def test_sample_of_the_4294a(measured_folder):
    found = extract(read_spectrum(measured_folder / "hp4294a_sample.txt", correct_phase=True))
    pole = max(found.resonances.poles, key=lambda r: abs(r.residue))
    zero = max(found.resonances.zeros, key=lambda r: abs(r.residue))
    assert pole.frequency_Hz == pytest.approx(28.1e3, abs=3 * pole.std_Hz)
    assert zero.frequency_Hz == pytest.approx(30.03e3, abs=30)
    assert "correlated_residual" in [f.code for f in found.findings]


def test_thickness_mode_among_lateral_overtones(measured_folder):
    """Resonances and antiresonances that are visible in the curves (README), with their intervals, and the misfit."""
    found = extract(read_spectrum(measured_folder / "e4990a_thickness_mode.csv"))
    poles = [*found.resonances.poles, *(r for r in found.doubtful if r.kind == "pole")]
    zeros = [*found.resonances.zeros, *(r for r in found.doubtful if r.kind == "zero")]
    for seen, group in (((958.5e3, 994.0e3, 1012e3, 1057e3), poles), ((959e3, 1009e3, 1047e3, 1097e3), zeros)):
        for one in seen:
            near = min(group, key=lambda r, one=one: abs(r.frequency_Hz - one))
            assert abs(near.frequency_Hz - one) < 500 + 2 * near.std_Hz  # read from the curves to 0.5 kHz
    assert len(poles) == 4
    assert len(zeros) == 4
    assert len(found.resonances.poles) >= 3
    assert found.status == "correlated_residual"
    assert " Hz; causes may be the drive level" in found.notes[0]
    # the rms misfit is the same number everywhere in the result; it is no noise, as neighbours agree to 2e-5 (README)
    assert found.noise.origin == "misfit"
    assert f"by {100 * found.noise.relative:.2g} % rms" in found.notes[0]
    assert "scatter of 0.002" in found.notes[0]
