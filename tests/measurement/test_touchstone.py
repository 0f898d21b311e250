"""Touchstone files in every form, written by scikit-rf or by hand, are read as Z; the noise of S is converted by
|dZ/dS|.
"""

from __future__ import annotations

import builtins
import json
from pathlib import Path

import numpy as np
import pytest
import skrf

from femu_piezo.errors import InputError
from femu_piezo.measurement.readers import read_spectrum, write_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.specimen.file import read_specimen
from femu_piezo.study.measured import measure, measure_each
from tests.commands import invoked, succeeded

from .sweeps import SOFT, bar_impedance

FREQUENCY = np.linspace(30e3, 50e3, 201)
IMPEDANCE = bar_impedance(FREQUENCY, **SOFT)
PLATE = """
[geometry]
shape = "plate"
length = "40 mm"
width = "5 mm"
thickness = "1 mm"
poling = "thickness"
[material]
base = "tj52-hd"
"""


def write(folder: Path, s: np.ndarray, reference: float, name: str = "sweep", **options) -> Path:
    """A Touchstone file of S (n, p, p) by scikit-rf."""
    network = skrf.Network(frequency=skrf.Frequency.from_f(FREQUENCY, unit="hz"), s=s, z0=reference)
    network.write_touchstone(name, dir=str(folder), **options)
    return next(folder.glob(f"{name}.*"))


def reflection(reference: float) -> np.ndarray:
    """S (n, 1, 1) of the piece as a one-port."""
    return ((IMPEDANCE - reference) / (IMPEDANCE + reference)).reshape(-1, 1, 1)


def two_port(kind: str, reference: float) -> np.ndarray:
    """S of the piece in series or shunt from its chain matrix, by circuit theory."""
    one, none = np.ones_like(IMPEDANCE), np.zeros_like(IMPEDANCE)
    a, b, c, d = (one, IMPEDANCE, none, one) if kind == "series" else (one, none, 1 / IMPEDANCE, one)
    below = a + b / reference + c * reference + d
    s11, s21 = (a + b / reference - c * reference - d) / below, 2 / below
    s22 = (-a + b / reference - c * reference + d) / below
    return np.moveaxis(np.array([[s11, s21], [s21, s22]]), -1, 0)


@pytest.mark.parametrize("form", ["ri", "ma", "db"])
@pytest.mark.parametrize("version", ["1.0", "2.0"])
@pytest.mark.parametrize("parameter", ["S", "Z", "Y"])
@pytest.mark.parametrize("reference", [50.0, 75.0, 1000.0])
def test_one_port_in_every_form(tmp_path, form, version, parameter, reference):
    path = write(tmp_path, reflection(reference), reference, form=form, version=version, parameter=parameter)
    found = read_spectrum(path)
    np.testing.assert_allclose(found.frequency, FREQUENCY, rtol=1e-12)
    assert np.max(np.abs(found.impedance / IMPEDANCE - 1)) < 1e-9
    if parameter == "S":
        assert f"reflection against {reference:g} ohm" in found.notes[0]
    else:  # what the instrument saw is not known
        assert not found.notes and found.noise is None


def test_admittances_of_version_1_are_normalised(tmp_path):
    """Touchstone 1.1: y = Y R, so that y = 0.5 against 100 ohm is a piece of 200 ohm."""
    rows = "\n".join(f"{f} 0.5 0" for f in range(1000, 2000, 100))
    (tmp_path / "sweep.y1p").write_text(f"# HZ Y RI R 100\n{rows}\n", encoding="utf-8")
    np.testing.assert_allclose(read_spectrum(tmp_path / "sweep.y1p").impedance, 200, rtol=1e-12)


@pytest.mark.parametrize("kind", ["series", "shunt"])
@pytest.mark.parametrize("form", ["ri", "ma", "db"])
@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_series_and_shunt_are_recognised(tmp_path, kind, form, version):
    found = read_spectrum(write(tmp_path, two_port(kind, 50.0), 50.0, form=form, version=version))
    assert np.max(np.abs(found.impedance / IMPEDANCE - 1)) < 1e-9
    assert found.notes[0].startswith(f"{kind} against 50 ohm")


@pytest.mark.parametrize(("parameter", "kind"), [("Y", "series"), ("Z", "shunt")])
def test_two_port_files_of_admittances_and_impedances(tmp_path, parameter, kind):
    """Written by hand in version 2, with different reference impedances of the ports."""
    parameter_of_piece = 1 / IMPEDANCE if parameter == "Y" else IMPEDANCE
    sign = -1 if parameter == "Y" else 1
    rows = "\n".join(
        f"{f!r} " + " ".join(f"{v.real!r} {v.imag!r}" for v in (z, sign * z, sign * z, z))
        for f, z in zip(FREQUENCY.tolist(), parameter_of_piece.tolist(), strict=True)
    )
    head = f"[Version] 2.0\n# HZ {parameter} RI R 50\n[Number of Ports] 2\n[Two-Port Data Order] 21_12\n"
    head += f"[Number of Frequencies] {FREQUENCY.size}\n[Reference] 50 75\n[Network Data]\n"
    (tmp_path / "sweep.s2p").write_text(head + rows + "\n[End]\n", encoding="utf-8")
    found = read_spectrum(tmp_path / "sweep.s2p", connection=kind)
    assert np.max(np.abs(found.impedance / IMPEDANCE - 1)) < 1e-8


@pytest.mark.parametrize("kind", ["reflection", "series", "shunt"])
def test_noise_of_s_becomes_that_of_z(tmp_path, kind):
    """S with errors of 3e-4: the rms of the error of Z over the stated noise is 1 within 15 %.

    Between 50 to 100 ohm, near the reference, and 5 kΩ at the zero the relative noise grows by up to 100; more than 8
    is asserted.
    """
    rng = np.random.default_rng(4)
    s = reflection(50.0) if kind == "reflection" else two_port(kind, 50.0)
    s = s + 3e-4 / np.sqrt(2) * (rng.standard_normal(s.shape) + 1j * rng.standard_normal(s.shape))
    found = read_spectrum(write(tmp_path, s, 50.0), connection=kind)
    sigma = np.abs(found.impedance - IMPEDANCE) / found.noise
    assert np.sqrt(np.mean(sigma**2)) == pytest.approx(1.0, abs=0.15)
    assert "the noise of Z is computed from that of S" in found.notes[0]
    relative = found.noise / np.abs(found.impedance)
    assert relative.max() > 8 * relative.min()
    assert not found.noise_known  # it is an estimate, and counts as one
    assert read_spectrum(tmp_path / found.source.rsplit("/", 1)[-1], connection=kind, noise=1e-3).noise_known


def test_a_specimen_file_takes_touchstone(tmp_path):
    path = write(tmp_path, two_port("shunt", 50.0), 50.0)
    text = f'[measurement]\nfile = "{path.name}"\nconnection = "shunt"\n'
    (tmp_path / "plate.toml").write_text(PLATE + text, encoding="utf-8")
    assert measure(read_specimen(tmp_path / "plate.toml")).pair.pole.frequency_Hz == pytest.approx(35.4e3, rel=0.02)
    succeeded("extract", path, "--out", tmp_path / "out", "--connection", "shunt")
    assert json.loads((tmp_path / "out" / "extraction.json").read_text(encoding="utf-8"))["poles"]


def test_what_does_not_concern_the_format_of_a_file_is_refused(tmp_path):
    """`connection` of a table and `columns` of a Touchstone file, as option and as key."""
    touchstone = write(tmp_path, two_port("shunt", 50.0), 50.0)
    table = tmp_path / "table.csv"
    write_spectrum(ImpedanceSpectrum(FREQUENCY, IMPEDANCE), table)
    names = "Frequency (Hz), R (Ohm), X (Ohm)"
    for path, option, value, words in (
        (table, "--connection", "series", 'connection = "series" is for Touchstone files'),
        (touchstone, "--columns", names, "columns names those of a table, and this is a Touchstone file"),
    ):
        for command in ("extract", "circuit"):
            answer = invoked(command, path, option, value, "--out", tmp_path / "out")
            assert answer.exit_code == 2 and words in answer.output and answer.output.count("\n") == 1
    for key, idle in (('connection = "shunt"', table), ('columns = ["f (Hz)", "R (Ohm)", "X (Ohm)"]', touchstone)):
        (tmp_path / "plate.toml").write_text(PLATE + f'[measurement]\nfile = "{idle.name}"\n{key}\n', encoding="utf-8")
        with pytest.raises(InputError, match=rf"plate\.toml: measurement\.{key[:7]}.* {idle.name} is none; take it"):
            measure(read_specimen(tmp_path / "plate.toml"))
        both = f'[measurement]\nfile = ["{table.name}", "{touchstone.name}"]\n{key}\n'
        (tmp_path / "plate.toml").write_text(PLATE + both, encoding="utf-8")
        assert len(measure_each([read_specimen(tmp_path / "plate.toml")])) == 2  # it concerns one of them


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("# HZ S RI R 50\n1000 0.5\n", "scikit-rf does not understand|no points"),
        ("", "empty"),
        ("# HZ S RI R 50\n1000 1 0\n2000 1 0\n", "open or a short"),
        ("hello\n", "does not understand|no points"),
        ("# HZ S RI R 50\n2000 0.5 0.1\n2000 0.5 0.1\n", "repeat|does not understand"),
    ],
)
def test_damaged_files_are_told_in_one_sentence(tmp_path, text, told):
    (tmp_path / "sweep.s1p").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=told):
        read_spectrum(tmp_path / "sweep.s1p")
    answer = invoked("extract", tmp_path / "sweep.s1p", "--out", tmp_path / "out")
    assert answer.exit_code == 2 and not (tmp_path / "out").exists()


def test_ports_that_are_neither_series_nor_shunt(tmp_path):
    s = two_port("series", 50.0)
    s[:, 0, 0] = 0.1
    with pytest.raises(InputError, match=r'neither .* connection = "series"'):
        read_spectrum(write(tmp_path, s, 50.0))
    with pytest.raises(InputError, match="two ports"):
        read_spectrum(write(tmp_path, reflection(50.0), 50.0, name="one"), connection="series")


def test_without_scikit_rf_one_sentence_says_what_to_install(tmp_path, monkeypatch):
    path = write(tmp_path, reflection(50.0), 50.0)
    real = builtins.__import__

    def without(name, *rest, **more):
        if name == "skrf":
            raise ImportError(name)
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError, match=r"pip install 'femu-piezo\[touchstone\]'"):
        read_spectrum(path)


def test_a_frequency_that_is_not_finite_is_one_sentence(tmp_path):
    rows = [f"{f} 0.5 -0.1" for f in ("30000", "31000", "inf", "33000")]
    (tmp_path / "x.s1p").write_text("\n".join(["# Hz S RI R 50", *rows]), encoding="utf-8")
    with pytest.raises(InputError, match=r"x\.s1p: a frequency of the file is not a finite number; export"):
        read_spectrum(tmp_path / "x.s1p")


@pytest.mark.parametrize("digits", [16, 9])
def test_a_computed_file_states_no_noise(tmp_path, digits):
    """The roughness of S is then the rounding of the file, and equal weights serve as for a table without noise."""
    path = tmp_path / "computed.s1p"
    rows = (
        f"{f:.10g} {s.real:.{digits}e} {s.imag:.{digits}e}"
        for f, s in zip(FREQUENCY, reflection(50.0).ravel(), strict=True)
    )
    path.write_text("\n".join(["# Hz S RI R 50", *rows]) + "\n")
    found = read_spectrum(path)
    assert found.noise is None and "a file that was computed" in found.notes[0]
