"""Equivalent circuits against residues, against the curve they represent, and against ngspice."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import femu_piezo as fp
from femu_piezo.circuits.branch import Branch, element_deviations
from femu_piezo.circuits.circuit import fit_circuit
from femu_piezo.circuits.spice import spice_text, subcircuit_name
from femu_piezo.measurement.readers import write_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from tests import k31_bar
from tests.commands import invoked, succeeded
from tests.extraction.bar import Bar
from tests.noise import noisy

NGSPICE = shutil.which("ngspice")
FREQUENCY = np.linspace(5e3, 120e3, 2301)
L1, R1, C1, C0 = 0.1, 60.0, 2.5e-11, 4e-10


def bvd(frequency, branches=((L1, R1, C1), (0.04, 45.0, 1.2e-10)), c0=C0):
    """Y of a Butterworth-Van Dyke circuit, S."""
    s = 2j * np.pi * frequency
    return s * c0 + sum(1 / (s * l1 + r1 + 1 / (s * c1)) for l1, r1, c1 in branches)


def test_four_elements_are_the_section_of_pole_and_residue():
    """The admittance of the elements of a branch is that of its pole and residue."""
    omega = 2 * np.pi * np.linspace(10e3, 200e3, 500)
    for phase in (-0.05, 0.0, 0.02):
        pole = -900 + 6.1e5j
        branch = Branch(pole, 3.0 * np.exp(1j * phase), {})
        np.testing.assert_allclose(branch.admittance(omega), branch.section(omega), rtol=1e-10)


def test_a_butterworth_van_dyke_branch_has_its_own_elements():
    """s/L over s² + (R/L) s + 1/(LC) has the residue p/(L (p − p*)): L, R and C are recovered, and Rp is very large."""
    pole = -R1 / (2 * L1) + 1j * np.sqrt(1 / (L1 * C1) - (R1 / (2 * L1)) ** 2)
    found = Branch(pole, pole / (L1 * (pole - pole.conjugate())), {}).elements
    assert [found[key] for key in "LRC"] == pytest.approx([L1, R1, C1], rel=1e-9, abs=0)
    assert abs(found["Rp"]) > 1e6 * np.sqrt(L1 / C1)


def test_deviations_of_elements_against_draws():
    """20000 draws of pole and residue: stated deviations are the spread of each element within 3 %."""
    pole, residue = -900 + 6.1e5j, 3.0 * np.exp(0.01j)
    rng = np.random.default_rng(2)
    spread = rng.normal(size=(4, 4)) * np.array([3.0, 3.0, 0.01, 0.01])[:, None]
    stated = element_deviations(pole, residue, spread @ spread.T)
    draws = spread @ rng.normal(size=(4, 20000))
    elements = [Branch(pole + complex(a, b), residue + complex(c, d), {}).elements for a, b, c, d in draws.T]
    for key in ("L", "R", "C"):
        assert stated[key] == pytest.approx(np.std([one[key] for one in elements]), rel=0.03, abs=0), key


def test_a_circuit_is_recovered_from_its_sweep():
    """A circuit with two branches without a parallel resistance, so that Rp is large."""
    circuit = fp.circuit(ImpedanceSpectrum.from_impedance(FREQUENCY, 1 / bvd(FREQUENCY)))
    assert len(circuit.branches) == 2
    for branch, truth in zip(circuit.branches, ((0.04, 45.0, 1.2e-10), (L1, R1, C1)), strict=True):
        assert [branch.elements[key] for key in "LRC"] == pytest.approx(truth, rel=1e-6, abs=0)
        assert abs(branch.elements["Rp"]) > 1e4 * np.sqrt(truth[0] / truth[2])
    assert circuit.misfit[1] < 1e-6
    assert circuit.static_capacitance == pytest.approx(C0, rel=1e-3, abs=0)


def test_clipped_readings_do_not_count():
    """|Z| below 20 kHz is shown as one value: the circuit and its misfit are those of the other points."""
    z = noisy(1 / bvd(FREQUENCY), 1e-3, 5)
    ceiling = np.abs(z[FREQUENCY < 20e3]).min()
    over = np.abs(z) > ceiling
    found = fp.circuit(ImpedanceSpectrum(FREQUENCY, np.where(over, z / np.abs(z) * ceiling, z)))
    assert found.misfit_of_sweep[1] < 0.01
    assert found.frequency[0] >= 20e3 and found.frequency.size == np.sum(~over) - 1  # the ceiling itself is clipped too


def test_stated_deviations_cover_the_truth():
    """20 sweeps with 0.1 % of noise: errors of L, C and R over their deviations are below 4 and have an rms of 0.6
    to 1.5.
    """
    clean = 1 / bvd(FREQUENCY[::4])
    far = []
    for seed in range(20):
        circuit = fp.circuit(ImpedanceSpectrum.from_impedance(FREQUENCY[::4], noisy(clean, 1e-3, seed)))
        branch = min(circuit.branches, key=lambda one: abs(one.frequency_Hz - 1e5))
        for key, truth in zip("LRC", (L1, R1, C1), strict=True):
            far.append((branch.elements[key] - truth) / branch.std[key])
    assert np.max(np.abs(far)) < 4
    assert 0.6 < np.sqrt(np.mean(np.square(far))) < 1.5


@pytest.fixture(scope="module")
def bar() -> fp.ImpedanceSpectrum:
    """The exact lossy bar with three modes, whose complex residues no circuit of R, L, C alone has."""
    frequency = np.linspace(1e3, 200e3, 4001)
    return ImpedanceSpectrum(frequency, Bar().impedance(frequency), source="bar 40.csv")


@pytest.fixture(scope="module")
def circuit(bar):
    """The circuit of the bar."""
    return fp.circuit(bar)


def test_residues_are_those_of_the_exact_bar(circuit):
    """Y/(jω) = Σ R_n/(λ_n − ω²): L = 1/Re R_n within 1e-5."""
    exact = Bar()
    assert len(circuit.branches) == 3
    for number, branch in enumerate(circuit.branches, 1):
        assert branch.pole == pytest.approx(1j * np.sqrt(exact.pole(number)), rel=1e-7)
        assert branch.residue == pytest.approx(exact.residue_of_charge(number) / 2, rel=1e-5)
        assert branch.elements["L"] == pytest.approx(1 / exact.residue_of_charge(number).real, rel=1e-5)


def test_the_circuit_follows_its_curve(circuit):
    """Within 5 %: a constant tan δ of 0.015 is not causal, as C would have to fall by (2/π) tan δ ln(f2/f1) over
    this band.
    """
    assert circuit.misfit[1] < 2 / np.pi * 0.015 * np.log(200)
    assert any("follows its curve within" in note for note in circuit.notes)
    assert any("Kramers" in note for note in circuit.notes)


def test_a_specimen_gives_the_circuit_of_its_model(tmp_path):
    text = '[geometry]\nshape = "plate"\nlength = "20 mm"\nwidth = "3 mm"\nthickness = "1 mm"\n'
    text += '[material]\nbase = "pzt-5h"\n'
    text += "".join(f"tan_{name} = 0.01\n" for name in ("s11", "d31", "eps33T"))
    (tmp_path / "plate.toml").write_text(text, encoding="utf-8")
    found = fp.circuit(tmp_path / "plate.toml")
    poles = [one.frequency_Hz for one in fp.simulate(tmp_path / "plate.toml").poles]
    assert [one.frequency_Hz for one in found.branches] == pytest.approx(poles[: len(found.branches)], rel=1e-6)
    assert found.misfit[1] < 2 / np.pi * 0.01 * np.log(found.frequency[-1] / found.frequency[0])


@pytest.mark.parametrize("loss", [0.0, 0.01])
@pytest.mark.parametrize("excess", [0.0, 1.3])
def test_direct_current_of_branches_is_cancelled_but_no_more(loss, excess):
    """A negative resistor takes back what the Rp of branches carry; a curve that asks for more gets no source."""
    poles = 2 * np.pi * np.array([35.02e3, 103.02e3]) * 1j * np.sqrt(1 + 1j * loss)
    branches = [Branch(complex(pole), complex(residue, 0.0), {}) for pole, residue in zip(poles, (17, 16), strict=True)]
    omega = 2 * np.pi * FREQUENCY
    direct = sum(one.section(np.zeros(1))[0].real for one in branches)
    rest = 1j * omega * 3e-9 - direct - excess * (direct or 1 / 3e7)
    found = fit_circuit("plate", branches, FREQUENCY, 1 / (sum(one.section(omega) for one in branches) + rest))
    assert all(np.isfinite(one.elements["Rp"]) == (loss > 0) for one in found.branches)
    assert any(one.kind == "R" and one.values["R"] < 0 for one in found.static) == (loss > 0)
    assert any("negative resistor" in note for note in found.notes) == (loss > 0)
    assert 0 <= found.admittance(np.array([1e-9]))[0].real <= 1e-5 * direct


def test_the_circuit_is_passive_at_every_frequency(circuit):
    """Re Y ≥ 0, also far outside the sweep; else it oscillates or grows with open terminals (positive-real Y)."""
    assert np.all(circuit.admittance(2 * np.pi * np.geomspace(1e-3, 1e9, 20001)).real >= 0)


def test_the_circuit_of_a_sweep_from_below_all_modes_is_a_capacitor_there(circuit):
    """C at 1 Hz within 1 % of the exact bar's at 1 kHz, where the sweep begins, and no mode below it."""
    exact = 1 / (2j * np.pi * 1e3 * Bar().impedance(np.array([1e3]))[0])
    omega = 2 * np.pi * np.geomspace(1.0, 1e3, 400)
    np.testing.assert_allclose(circuit.admittance(omega).imag / omega, exact.real, rtol=0.01)
    assert min(places_outside(circuit)) > 200e3


def test_a_narrow_sweep_below_whose_band_no_mode_lies_has_none_there():
    """About the first mode of the bar alone: the misfit is small without modes below, which it could still lower."""
    frequency = np.linspace(30e3, 55e3, 801)
    found = fp.circuit(ImpedanceSpectrum(frequency, Bar().impedance(frequency)))
    assert len(found.branches) == 1 and found.misfit[0] < 1e-3
    assert min(places_outside(found), default=np.inf) > 55e3


def test_a_sweep_from_above_a_mode_asks_for_a_mode_below():
    """The bar from 60 kHz, its first mode at 41 kHz: without a mode below, no passive elements follow the curve."""
    frequency = np.linspace(60e3, 250e3, 3001)
    found = fp.circuit(ImpedanceSpectrum(frequency, Bar().impedance(frequency)))
    assert found.misfit[1] < 1e-3 and not any(part.kind == "RLC" for part in found.static)
    assert min(places_outside(found)) < 60e3


def test_modes_outside_are_damped_as_the_others(circuit):
    loss = np.median([1 / one.quality_factor for one in circuit.branches])
    outside = [part.values for part in circuit.static if part.kind == "mode"]
    assert outside and loss > 0
    for values in outside:
        assert values["R"] * np.sqrt(values["C"] / values["L"]) == pytest.approx(loss, rel=1e-12)


def places_outside(circuit) -> list[float]:
    """Resonances of the modes outside the sweep, Hz."""
    outside = [part.values for part in circuit.static if part.kind == "mode"]
    return [1 / (2 * np.pi * np.sqrt(values["L"] * values["C"])) for values in outside]


def test_files(circuit, bar, tmp_path):
    write_spectrum(bar, tmp_path / "bar 40.csv")
    out = tmp_path / "out"
    succeeded("circuit", tmp_path / "bar 40.csv", "--out", out)
    assert sorted(one.name for one in out.iterdir()) == [
        "circuit.cir", "circuit.csv", "circuit.json", "circuit.png", "circuit.s1p",
    ]  # fmt: skip
    record = json.loads((out / "circuit.json").read_text(encoding="utf-8"))
    assert [one["elements"]["L"]["unit"] for one in record["branches"]] == ["H"] * 3
    for name in ("circuit.csv", "circuit.s1p"):
        back = fp.read_spectrum(out / name)
        np.testing.assert_allclose(back.impedance, circuit.impedance, rtol=1e-5)
    assert ".subckt BAR_40 a b" in (out / "circuit.cir").read_text(encoding="utf-8")


def test_a_sweep_without_resonance_is_refused(tmp_path):
    frequency = np.linspace(1e3, 2e3, 60)
    noise = 1 + 1e-4 * np.random.default_rng(1).normal(size=60)
    write_spectrum(
        ImpedanceSpectrum(frequency, noise * (1 - 0.02j) / (2j * np.pi * frequency * 1e-9)), tmp_path / "c.csv"
    )
    answer = invoked("circuit", tmp_path / "c.csv", "--out", tmp_path / "out")
    assert answer.exit_code == 2 and "no resonance was found" in answer.output
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def turned():
    """The circuit of a sweep measured with a gain that is off by up to 35 %, which no passive body can have."""
    frequency, x = np.linspace(60e3, 120e3, 801), np.linspace(-1, 1, 801)
    noise = np.random.default_rng(7).normal(size=(2, x.size)) * 2e-4
    damped = bvd(frequency, ((L1, 12 * R1, C1), (0.04, 12 * 45.0, 1.2e-10)))
    z = np.exp(0.3 * np.sin(3 * x)) / damped * (1 + noise[0] + 1j * noise[1])
    return fp.circuit(ImpedanceSpectrum.from_impedance(frequency, z))


def test_a_sweep_that_is_not_passive_needs_elements_of_either_sign(turned):
    """The circuit follows it within 1.5 % in rms, and notes and files say that elements have either sign."""
    of_curve = np.sqrt(np.mean(np.abs(turned.curve / turned.sweep - 1) ** 2))
    assert of_curve < 1e-3 and turned.misfit_of_sweep[0] < 0.015 and turned.misfit_of_sweep[1] < 0.05
    assert any(part.kind == "RLC" for part in turned.static)
    assert any("of either sign" in note for note in turned.notes)
    record = turned.to_json()
    assert record["misfit_of_sweep"]["largest"] == turned.misfit_of_sweep[1]
    assert ", of either sign" in spice_text(turned)


@pytest.mark.slow
def test_a_sweep_of_several_modes_is_followed_by_all_its_poles(measured_folder):
    """Doubtful and merged poles are included and flagged; without them the misfit would be tens of per cent.

    The circuit follows the sweep as closely as the function that was fitted to it.
    """
    path = measured_folder / "e4990a_thickness_mode.csv"
    found, sweep = fp.circuit(path), fp.read_spectrum(path)
    assert [one.doubtful for one in found.branches] == [True, False, False, True, True]
    error = np.abs(1 / fp.extract(path).model.admittance(sweep.omega) / sweep.impedance - 1)
    assert np.sqrt(np.mean(error**2)) < 0.008
    assert found.misfit_of_sweep[0] < 0.008 and found.misfit_of_sweep[1] < 0.02
    assert found.misfit_of_sweep[0] < 1.05 * np.sqrt(np.mean(error**2)) and found.misfit_of_sweep[1] < error.max()
    assert "doubtful" in spice_text(found) and any("may not be a mode" in note for note in found.notes)


def test_names_of_subcircuits_are_valid_in_spice():
    for name, told in (("bar 40", "BAR_40"), ("7 µm", "PIEZO_7_M"), ("---", "PIEZO")):
        assert subcircuit_name(fit_circuit(name, [], FREQUENCY, 1 / bvd(FREQUENCY))) == told


def in_ngspice(circuit, folder: Path, frequency: np.ndarray) -> np.ndarray:
    """Y of the subcircuit by an AC analysis, S: the current driven by 1 V."""
    (folder / "circuit.cir").write_text(spice_text(circuit), encoding="utf-8")
    run = f"""* test
.include {folder / "circuit.cir"}
V1 1 0 dc 0 ac 1
X1 1 0 {subcircuit_name(circuit)}
.control
set numdgt=16
set wr_singlescale
ac lin {frequency.size} {float(frequency[0])!r} {float(frequency[-1])!r}
wrdata {folder / "out.txt"} real(i(v1)) imag(i(v1))
quit
.endc
.end
"""
    (folder / "run.cir").write_text(run, encoding="utf-8")
    answer = subprocess.run([NGSPICE, "-b", str(folder / "run.cir")], capture_output=True, text=True, timeout=60)
    assert (folder / "out.txt").is_file(), answer.stdout + answer.stderr
    columns = np.loadtxt(folder / "out.txt")
    np.testing.assert_allclose(columns[:, 0], frequency, rtol=1e-9)
    return -(columns[:, 1] + 1j * columns[:, 2])


@pytest.mark.skipif(NGSPICE is None, reason="ngspice is not installed: apt-get install ngspice")
@pytest.mark.parametrize("kind", ["bar", "circuit", "turned"])
def test_ngspice_gives_the_same_admittance(kind, circuit, turned, tmp_path):
    plain = ImpedanceSpectrum.from_impedance(FREQUENCY, 1 / bvd(FREQUENCY))
    one = {"bar": circuit, "turned": turned}.get(kind) or fp.circuit(plain)
    frequency = np.linspace(one.frequency[0], one.frequency[-1], 3001)
    found = in_ngspice(one, tmp_path, frequency)
    assert np.max(np.abs(found / one.admittance(2 * np.pi * frequency) - 1)) < 1e-6


def test_the_static_capacitance_is_that_of_c0():
    """A lossy bar from far below its resonance on: no branch stands for the capacitor, and none is larger than it."""
    frequency, lossy = np.geomspace(1e3, 130e3, 401), 1 - 0.016j
    size, density = (40e-3, 5e-3, 1e-3), 7900.0
    z = k31_bar.impedance(2 * np.pi * frequency, size, density, 16e-12 * lossy, -290e-12 * lossy, 2.1e-8 * lossy)
    circuit = fp.circuit(ImpedanceSpectrum.from_impedance(frequency, z))
    free = 2.1e-8 * size[0] * size[1] / size[2]
    assert 0.3 * free < circuit.static_capacitance < free
    assert max(one.values.get("C", 0.0) for one in circuit.static) < 1.1 * free
    assert circuit.misfit[0] < 0.01
