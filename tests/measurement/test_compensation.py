"""Open, short and load compensation: a fixture of known circuit is removed exactly, and the noise of its readings is
counted.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from femu_piezo.errors import InputError
from femu_piezo.measurement.compensation import Compensation, Load, compensated, compensation_slopes
from femu_piezo.measurement.readers import write_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.specimen.file import read_specimen, write_specimen
from femu_piezo.study.measured import measure
from femu_piezo.study.tolerances import tolerances
from femu_piezo.study.update import update
from tests.noise import with_noise

from .sweeps import SOFT, bar_impedance

SWEEP = Path(__file__).parents[2] / "tutorials/k31_plate/sweep.csv"
FREQUENCY = np.linspace(30e3, 50e3, 201)
OMEGA = 2 * np.pi * FREQUENCY
TRUTH = bar_impedance(FREQUENCY, **SOFT)
SERIES, STRAY = 1.5 + 1j * OMEGA * 3e-6, 1e-6 + 1j * OMEGA * 20e-12
STANDARD = Load(100.0, inductance=2e-7, capacitance=3e-12)


def fixture(z, kind: str):
    """What the analyser reads of z behind a fixture: a stray admittance parallel to the piece and a series lead
    ("simple"), or a general two-port.
    """
    if kind == "general":
        a, b, c, d = 1.1 + 0.05j, 20 + 30j, (2 + 5j) * 1e-4, 0.9 - 0.04j
        return (a * z + b) / (c * z + d) if np.all(np.isfinite(z)) else np.full_like(OMEGA, a / c, complex)
    inner = 1 / STRAY if not np.all(np.isfinite(z)) else z / (1 + STRAY * z)
    return SERIES + inner


def readings(kind: str):
    """Readings of the piece, the open and the shorted fixture, and the load."""
    open_, short = fixture(np.full_like(TRUTH, np.inf), kind), fixture(np.zeros_like(TRUTH), kind)
    return fixture(TRUTH, kind), open_, short, fixture(STANDARD.impedance(OMEGA), kind)


def test_load_is_its_circuit():
    series = 100.0 + 1j * OMEGA * 2e-7
    np.testing.assert_allclose(1 / STANDARD.impedance(OMEGA), 1 / series + 1j * OMEGA * 3e-12, rtol=1e-14)


def test_formulas_remove_the_fixture():
    raw, open_, short, load = readings("simple")
    np.testing.assert_allclose(compensated(raw, open_, short), TRUTH, rtol=1e-9)
    np.testing.assert_allclose(compensated(TRUTH + SERIES, short=SERIES), TRUTH, rtol=1e-12)
    np.testing.assert_allclose(compensated(1 / (1 / TRUTH + STRAY), open=1 / STRAY), TRUTH, rtol=1e-12)
    np.testing.assert_allclose(compensated(raw, open_, short, load, STANDARD.impedance(OMEGA)), TRUTH, rtol=1e-9)


def test_three_terms_remove_any_two_port():
    """Open and short alone leave more than 1 %."""
    raw, open_, short, load = readings("general")
    np.testing.assert_allclose(compensated(raw, open_, short, load, STANDARD.impedance(OMEGA)), TRUTH, rtol=1e-9)
    assert np.max(np.abs(compensated(raw, open_, short) / TRUTH - 1)) > 0.01


@pytest.mark.parametrize("names", [("short",), ("open",), ("open", "short"), ("open", "short", "load")])
def test_slopes_against_differences(names):
    raw, *others = readings("general" if "load" in names else "simple")
    values = {"raw": raw} | {n: v for n, v in zip(("open", "short", "load"), others, strict=True) if n in names}
    known = STANDARD.impedance(OMEGA)
    slopes = compensation_slopes(**values, known=known)
    assert set(slopes) == set(values)
    for name, value in values.items():
        step = 1e-6 * value
        up, down = (compensated(**(values | {name: value + sign * step}), known=known) for sign in (1, -1))
        np.testing.assert_allclose(slopes[name], (up - down) / (2 * step), rtol=2e-5, err_msg=name)


def test_noise_of_all_readings_is_in_the_noise():
    """200 draws: the spread of the compensated Z agrees with the stated noise within 25 %, at every tenth point."""
    clean = readings("general")
    sizes = [1e-3, 2e-3, 3e-3, 1e-3]
    found = []
    for seed in range(200):
        noisy = [
            ImpedanceSpectrum(FREQUENCY, with_noise(z, s * np.abs(z), 4 * seed + i), s * np.abs(z))
            for i, (z, s) in enumerate(zip(clean, sizes, strict=True))
        ]
        found.append(Compensation(*noisy[1:], STANDARD).applied(noisy[0]))
    spread = np.sqrt(np.mean(np.abs([one.impedance - TRUTH for one in found]) ** 2, axis=0))
    stated = np.mean([one.noise for one in found], axis=0)
    np.testing.assert_allclose(stated[::10], spread[::10], rtol=0.25)
    assert "compensated by open, short, load from raw files" in found[0].notes[-1]
    unknown = replace(noisy[0], noise=None)
    assert found[0].noise_known and not Compensation(*noisy[1:], STANDARD).applied(unknown).noise_known
    loose = Compensation(*noisy[1:], Load(100.0, 2e-7, 3e-12, std=0.01)).applied(noisy[0])
    np.testing.assert_array_equal(loose.noise, found[-1].noise)  # a tolerance of the load does not count as noise


def write(folder: Path, name: str, impedance, frequency=FREQUENCY) -> None:
    write_spectrum(ImpedanceSpectrum(frequency, impedance, 1e-4 * np.abs(impedance)), folder / f"{name}.csv")


SPEC = """\
name = "plate"
[geometry]
shape = "plate"
length = "40 mm"
width = "5 mm"
thickness = "1 mm"
[material]
base = "tj52-hd"
[measurement]
file = "raw.csv"
open = "open.csv"
short = "short.csv"
load = { file = "load.csv", resistance = "100 ohm", inductance = "0.2 uH", capacitance = "3 pF" }
"""


def test_from_a_specimen_file(tmp_path):
    for name, z in zip(("raw", "open", "short", "load"), readings("general"), strict=True):
        write(tmp_path, name, z)
    (tmp_path / "plate.toml").write_text(SPEC, encoding="utf-8")
    specimen = read_specimen(tmp_path / "plate.toml")
    measured = measure(specimen)
    np.testing.assert_allclose(measured.spectrum.impedance, TRUTH, rtol=1e-8)
    (tmp_path / "below").mkdir()
    write_specimen(specimen, tmp_path / "copy.toml")
    assert read_specimen(tmp_path / "copy.toml").measurement == specimen.measurement


def test_wrong_fixtures_are_told(tmp_path):
    raw, open_, short, load = readings("simple")
    for name, z in (("raw", raw), ("open", open_), ("load", load)):
        write(tmp_path, name, z)
    write(tmp_path, "short", short[20:], FREQUENCY[20:])
    (tmp_path / "plate.toml").write_text(SPEC, encoding="utf-8")
    with pytest.raises(InputError, match="measure the fixture over the whole sweep"):
        measure(read_specimen(tmp_path / "plate.toml"))
    (tmp_path / "plate.toml").write_text(SPEC.replace('short = "short.csv"\n', ""), encoding="utf-8")
    with pytest.raises(InputError, match=r"measurement\.load needs measurement\.open and measurement\.short"):
        read_specimen(tmp_path / "plate.toml")
    (tmp_path / "plate.toml").write_text(SPEC.replace('resistance = "100 ohm", ', ""), encoding="utf-8")
    with pytest.raises(InputError, match=r"measurement\.load\.resistance is missing; say what the load is"):
        read_specimen(tmp_path / "plate.toml")
    same = ImpedanceSpectrum(FREQUENCY, open_)
    with pytest.raises(InputError, match="compensated impedance is zero or infinite"):
        Compensation(open=same, short=same).applied(same)


def test_a_wrong_load_is_within_the_stated_deviation_and_moves_no_resonance(tmp_path):
    """The load is 100.5 ohm where the file says 100 ± 0.5 ohm: ε33T is off by as much, within its stated deviation."""
    clean = np.loadtxt(SWEEP, delimiter=",", skiprows=1)
    frequency, z = clean[:, 0], clean[:, 1] + 1j * clean[:, 2]
    noise = 1 + 1e-4 * (np.random.default_rng(3).standard_normal((4, z.size, 2)) @ [1, 1j])
    a, b, c, d = 1.1 + 0.05j, 20 + 30j, (2 + 5j) * 1e-4, 0.9 - 0.04j
    actual = np.full_like(z, 100.5)
    read = [
        (a * z + b) / (c * z + d),
        np.full_like(z, a / c),
        np.full_like(z, b / d),
        (a * actual + b) / (c * actual + d),
    ]
    for name, values, factor in zip(("raw", "open", "short", "load"), read, noise, strict=True):
        write_spectrum(ImpedanceSpectrum(frequency, values * factor, 2e-4 * np.abs(values)), tmp_path / f"{name}.csv")
    tight = 'std_length = "1 nm"\nstd_width = "1 nm"\nstd_thickness = "1 nm"\nstd_density = 1e-6\n'
    text = SPEC.replace("[material]", f'density = "7900 kg/m^3"\n{tight}[material]\nsimplified = true')
    text = text.replace(', inductance = "0.2 uH", capacitance = "3 pF"', ', std = "0.5 %"')
    text = text.replace('file = "raw.csv"', 'file = "raw.csv"\naccuracy = 1e-5\nphase_accuracy = 1e-5')
    (tmp_path / "plate.toml").write_text(text, encoding="utf-8")
    found = update([read_specimen(tmp_path / "plate.toml")])
    eps = found.parameters["eps33T"]
    truth = 2.1450854e-8  # ε33T of the paper's plate, F/m
    assert abs(eps.value / truth - 1) > 4e-3 and abs(eps.value - truth) < 2 * eps.std
    assert eps.std / eps.value < 6e-3
    assert eps.largest_part == "instrument"
    pole = found.outcomes[0].measured.pair.pole
    assert pole.std_Hz < 0.05 and abs(pole.frequency_Hz - 35312.49) < 4 * pole.std_Hz


def test_a_load_of_the_wrong_size_counts_with_the_accuracy(tmp_path):
    """3 % of the load and 4 % of the analyser add in squares to 5 %."""
    for name, z in zip(("raw", "open", "short", "load"), readings("general"), strict=True):
        write(tmp_path, name, z)
    text = SPEC.replace('resistance = "100 ohm"', 'resistance = "100 ohm", std = "3 %"')
    (tmp_path / "plate.toml").write_text(text.replace("[measurement]", '[measurement]\naccuracy = "4 %"'))
    problem = measure(read_specimen(tmp_path / "plate.toml")).problem
    assert tolerances(problem)["accuracy"] == pytest.approx(0.05)
