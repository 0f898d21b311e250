"""Prony-SS on the exact 1-D bar: the paper's kind of sweep, from near DC on a uniform grid."""

import json
from pathlib import Path

import numpy as np
import pytest

from femu_piezo.errors import InputError
from femu_piezo.extraction import extract
from femu_piezo.extraction.prony_ss import prony_ss
from femu_piezo.extraction.stabilization import rational_stabilization, stabilize
from femu_piezo.measurement.readers import read_spectrum, write_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from tests.commands import succeeded

from .bar import Bar, sweep

SWEEP = Path(__file__).parents[2] / "tutorials/k31_plate/sweep.csv"
BAR = Bar()
PAPER = np.arange(100.0, 300_001.0, 100.0)


@pytest.mark.parametrize("extension", ["hermitian", "analytic"])
@pytest.mark.parametrize("kind", ["pole", "zero"])
def test_noise_free_sweep_from_near_dc(kind, extension):
    found = prony_ss(sweep(BAR, PAPER), kind, extension=extension).diagram.columns
    for n in (1, 2, 3):
        truth = getattr(BAR, kind)(n)
        assert min(abs(c.eigenvalue / truth - 1) for c in found) < 1e-8


@pytest.mark.parametrize("kind", ["pole", "zero"])
def test_columns_under_noise_are_the_modes_and_nothing_else(kind):
    found = prony_ss(sweep(BAR, PAPER, relative=1e-3, seed=1), kind).diagram.columns
    truth = [getattr(BAR, kind)(n) for n in range(1, 5)]
    assert len(found) == 4
    assert all(abs(c.eigenvalue / t - 1) < 1e-4 for c, t in zip(found, truth, strict=True))


def test_residues_are_those_of_the_charge():
    data = sweep(BAR, PAPER)
    poles = prony_ss(data, "pole", band=(100.0, 100_000.0), dead_time=8.0)
    assert poles.residues[0] == pytest.approx(BAR.residue_of_charge(1), rel=1e-6)
    offset = prony_ss(data, "pole", band=(10_000.0, 100_000.0), extension="analytic", dead_time=10.0)
    assert offset.residues[0] == pytest.approx(BAR.residue_of_charge(1), rel=1e-6)
    zeros = prony_ss(data, "zero", band=(100.0, 100_000.0), dead_time=8.0)
    near = BAR.zero(1) * (1 + 1e-6)  # R/(λ − λ0) of 1/Q just beside the zero
    assert zeros.residues[0] == pytest.approx(BAR.zero(1) * 1e-6 / BAR.charge(np.sqrt(near)), rel=1e-4)


@pytest.mark.parametrize("kind", ["pole", "zero"])
@pytest.mark.parametrize("low", [100.0, 10_000.0])
def test_columns_make_up_the_signal(kind, low):
    """Σ R Δt/(2p) exp((p − jω0) t) over the columns is the decomposed signal, real or complex."""
    found = prony_ss(sweep(BAR, PAPER), kind, band=(low, 100_000.0), dead_time=10.0)
    assert np.isrealobj(found.signal) == (low == 100.0)
    assert found.modelled == pytest.approx(found.signal, abs=1e-4 * np.max(np.abs(found.signal)))


def test_command_draws_what_the_method_decomposes(tmp_path):
    write_spectrum(sweep(BAR, np.linspace(20e3, 60e3, 801)), tmp_path / "sweep.csv")
    succeeded("extract", tmp_path / "sweep.csv", "--method", "prony-ss", "--out", tmp_path / "out")
    assert (tmp_path / "out/prony_ss.png").stat().st_size > 20_000
    record = json.loads((tmp_path / "out/extraction.json").read_text(encoding="utf-8"))
    assert record["poles"][0]["frequency_Hz"] == pytest.approx(np.sqrt(BAR.pole(1).real) / (2 * np.pi), rel=1e-5)


def test_narrow_band_agrees_with_the_rational_fit():
    data = sweep(BAR, np.linspace(20e3, 60e3, 801))
    slow, quick = extract(data, method="prony_ss").resonances, extract(data).resonances
    assert slow.poles[0].eigenvalue == pytest.approx(quick.poles[0].eigenvalue, rel=1e-5)
    assert slow.zeros[0].eigenvalue == pytest.approx(quick.zeros[0].eigenvalue, rel=1e-5)


def test_wide_band_methods_agree():
    data = sweep(BAR, PAPER[::2], relative=1e-4, seed=2)
    found = extract(data, method="prony_ss")
    assert found.method == "prony_ss" and found.resonances.poles[0].covariance is None
    for n, (pole, zero) in enumerate(zip(found.resonances.poles, found.resonances.zeros, strict=True), start=1):
        assert abs(pole.eigenvalue / BAR.pole(n) - 1) < 1e-4
        assert abs(zero.eigenvalue / BAR.zero(n) - 1) < 1e-4


def test_what_the_method_cannot_do_is_refused():
    with pytest.raises(InputError, match="uniform"):
        prony_ss(sweep(BAR, np.geomspace(20e3, 60e3, 400)), "pole")
    with pytest.raises(InputError, match="at least 16"):
        prony_ss(sweep(BAR, PAPER), "pole", band=(35e3, 36e3))
    with pytest.raises(InputError, match="multiples of the step"):
        prony_ss(sweep(BAR, np.arange(20013.0, 60e3, 50.0)), "pole", extension="hermitian")


def test_columns_need_continuity_in_frequency_and_loss():
    steady = 1e10 * (1 + 0.01j)
    by_order = {
        m: np.array([steady, 2e10 * (1 + 0.1 * m) * (1 + 0.01j), 4e10 * (1 + 0.01j * 2**m)]) for m in range(1, 9)
    }
    diagram = stabilize("pole", by_order)
    assert [c.eigenvalue for c in diagram.columns] == [steady]
    assert diagram.columns[0].orders == tuple(range(1, 9))
    assert np.count_nonzero(diagram.stable) == 7


def test_rational_diagram_on_a_log_grid():
    poles, zeros = rational_stabilization(sweep(BAR, np.geomspace(25e3, 130e3, 400), relative=1e-4, seed=3))
    for diagram, truth in ((poles, BAR.pole), (zeros, BAR.zero)):
        for n in (1, 2):
            assert min(abs(c.eigenvalue / truth(n) - 1) for c in diagram.columns) < 1e-4


def test_reversed_terminals_are_named():
    data = sweep(BAR, np.linspace(28e3, 48e3, 401), relative=1e-3, seed=4)
    found = extract(ImpedanceSpectrum(data.frequency, -data.impedance))
    assert found.status == "negative_resistance"
    assert found.resonances.poles[0].eigenvalue == pytest.approx(extract(data).resonances.poles[0].eigenvalue, rel=1e-9)


def test_zeros_of_a_passive_piece_alternate_with_its_poles():
    """The paper's sweep to 50 kHz holds one pole and one zero; the column of a second zero, an artefact of the
    window, is left out.
    """
    found = extract(read_spectrum(SWEEP), method="prony_ss").resonances
    assert (len(found.poles), len(found.zeros)) == (1, 1)
    exact = extract(read_spectrum(SWEEP)).resonances
    assert found.zeros[0].frequency_Hz == pytest.approx(exact.zeros[0].frequency_Hz, rel=1e-5)
