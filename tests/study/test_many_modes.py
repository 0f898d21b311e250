"""Appendix A of the paper: any free constants from all poles and zeros, for sweeps of the independent solver."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
from hidden_effects.build import Build
from hidden_effects.draws import (
    DENSITY,
    NAMES,
    PZT5H,
    STD_DENSITY,
    STD_HELD,
    STD_SIZE,
    STD_TANGENT,
    draw,
    instrument,
    material_lines,
    measurement_lines,
)

from femu_piezo import read_specimen, update
from femu_piezo.errors import InputError
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.measurement.readers import write_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from tests.commands import invoked, succeeded
from tests.noise import noisy
from tests.specimens import material, plate

SIZE = np.array([12e-3, 6.7e-3, 1.6e-3])
FREE = ("s11", "s12", "d31", "eps33T")
TRUTH = PZT5H.astype(complex)
for _name, _off, _tangent in (("s11", 1.03, 0.016), ("d31", 0.97, 0.012), ("eps33T", 1.05, 0.018)):
    TRUTH[NAMES.index(_name)] *= _off * (1 - 1j * _tangent)


@cache
def clean(length: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies and Z (601,) of a plate of a length without noise."""
    frequency = np.linspace(20e3, 240e3, 601) * SIZE[0] / length
    size = np.array([length, *SIZE[1:]])
    return frequency, Build(size, DENSITY, TRUTH, fundamental=0.0).impedance(frequency)


def written(folder, seed: int, length: float = SIZE[0], more: str = "noise_only = true"):
    """Specimen file with a noisy sweep; the free constants of the file are 3 to 5 % off."""
    frequency, z = clean(length)
    name = f"plate {1e3 * length:g} mm"
    write_spectrum(ImpedanceSpectrum(frequency, noisy(z, 1e-3, seed)), folder / f"{name}.csv")
    text = plate(name, [length, *SIZE[1:]], DENSITY) + material(PiezoConstants.from_vector(PZT5H), FREE)
    path = folder / f"{name}.toml"
    text += f'[measurement]\nfile = "{name}.csv"\n[update]\nmethod = "pole_zero"\n{more}'
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.slow
def test_four_constants_from_three_modes(tmp_path):
    """Four sweeps: errors of values and tangents over their stated deviations, which count noise of λ and mesh
    error, have an rms of about 1.
    """
    pulls = []
    for seed in range(4):
        result = update(read_specimen(written(tmp_path, seed)))
        assert result.method == "pole_zero" and result.fit is None
        for name, one in result.parameters.items():
            exact = TRUTH[NAMES.index(name)]
            pulls.append([(one.value - exact.real) / one.std, (one.tan + exact.imag / exact.real) / one.tan_std])
    rms = np.sqrt(np.mean(np.reshape(pulls, (4, -1)) ** 2, axis=0))
    assert np.all(rms < 1.9) and 0.7 < np.sqrt(np.mean(rms**2)) < 1.3, rms
    assert result.parameters["s11"].std < 1e-5 * result.parameters["s11"].value
    assert any("6 of 6 measured poles and zeros" in note for note in result.notes)


def test_two_specimens_join(tmp_path):
    """The command on two plates of one material: every deviation is smaller than with one plate."""
    files = [written(tmp_path, 1), written(tmp_path, 2, length=16e-3)]
    out = tmp_path / "out"
    succeeded("update", *files, "--method", "pole-zero", "--out", out)
    both = json.loads((out / "update.json").read_text(encoding="utf-8"))
    assert both["method"] == "pole_zero" and len(both["specimens"]) == 2
    alone = update(read_specimen(files[0])).parameters
    for name, one in both["parameters"].items():
        assert one["std"] < alone[name].std, name
        assert abs(one["value"] - TRUTH[NAMES.index(name)].real) < 4 * one["std"], name


FUNDAMENTAL, BAR = ("s11", "d31", "eps33T"), np.array([12e-3, 3e-3, 1e-3])


def in_a_laboratory(folder, seed: int, more: str = ""):
    """Specimen file and sweep of the fundamental with its low end, and true constants; everything is off by its
    tolerance.

    All constants have the same tangent, with which no draw can create energy.
    """
    rng = np.random.default_rng([1919, seed])
    assumed = PZT5H * (1 - 0.015j)
    theta = PZT5H * (1 + STD_HELD * rng.standard_normal(10)) * (1 - 1j * (0.015 + STD_TANGENT * rng.uniform(-1, 1)))
    for name in FUNDAMENTAL:
        theta[NAMES.index(name)] *= PZT5H[NAMES.index(name)] / theta[NAMES.index(name)].real * rng.uniform(0.96, 1.04)
    build = Build(
        BAR + STD_SIZE * rng.standard_normal(3), DENSITY * (1 + STD_DENSITY * rng.standard_normal()), theta, 0.0
    )
    build.circuits.append(instrument(rng))
    frequency = np.concatenate([np.linspace(2e3, 3e3, 11), np.geomspace(4e3, 85e3, 30), np.linspace(90e3, 160e3, 281)])
    folder.mkdir(exist_ok=True)
    write_spectrum(ImpedanceSpectrum(frequency, noisy(build.impedance(frequency), 5e-4, rng)), folder / "sweep.csv")
    sizes = zip(("length", "width", "thickness"), BAR.tolist(), STD_SIZE.tolist(), strict=True)
    text = ['name = "plate"', "[geometry]", 'shape = "plate"', f"density = {DENSITY}", f"std_density = {STD_DENSITY}"]
    text += [f"{one} = {size!r}\nstd_{one} = {std!r}" for one, size, std in sizes]
    text += [*material_lines(FUNDAMENTAL, assumed, True), *measurement_lines(5e-4, True)]
    path = folder / "plate.toml"
    path.write_text("\n".join([*text, "[update]", 'method = "pole_zero"', more]) + "\n", encoding="utf-8")
    return path, theta


def pulls_of(path, theta: np.ndarray, free=FUNDAMENTAL) -> list[float]:
    """Errors of constants and tangents over their stated deviations."""
    found = update(read_specimen(path)).parameters
    exact = {name: theta[NAMES.index(name)] for name in free}
    values = [(found[name].value - one.real) / found[name].std for name, one in exact.items()]
    return values + [(found[name].tan + one.imag / one.real) / found[name].tan_std for name, one in exact.items()]


@pytest.mark.slow
def test_the_papers_intervals_count_the_tolerances(tmp_path):
    """Ten plates with everything off by its tolerance: errors over deviations of about 1.

    With noise_only, errors of s11 and d31 are more than 20 deviations.
    """
    pulls = np.array([pulls_of(*in_a_laboratory(tmp_path / str(seed), seed)) for seed in range(10)])
    rms = np.sqrt(np.mean(pulls**2, axis=0))
    assert np.all(rms < 1.6) and 0.75 < np.sqrt(np.mean(pulls[:, :3] ** 2)) < 1.3, rms
    known = [pulls_of(*in_a_laboratory(tmp_path / str(seed), seed, "noise_only = true")) for seed in range(2)]
    assert np.sqrt(np.mean(np.square(known)[:, :2])) > 20


def test_budget_of_the_pole_zero_method(tmp_path):
    """Parts add up in squares, in update.json as well; the geometry is the largest part of s11."""
    path, _ = in_a_laboratory(tmp_path, 1)
    out = tmp_path / "out"
    answer = invoked("update", path, "--out", out)
    assert answer.exit_code == 0 and "dimensions" in answer.output and "finite elements" in answer.output, answer.output
    assert (out / "budget.png").is_file()
    for name, one in json.loads((out / "update.json").read_text(encoding="utf-8"))["parameters"].items():
        assert {"noise", "mesh", "geometry", "density", "held", "instrument"} <= set(one["budget"]), name
        assert np.linalg.norm(list(one["budget"].values())) == pytest.approx(one["std"], rel=1e-6, abs=0)
        assert np.linalg.norm(list(one["tan_budget"].values())) == pytest.approx(one["tan_std"], rel=1e-6)
    assert update(read_specimen(path)).parameters["s11"].largest_part == "geometry"
    assert "exactly known" not in answer.output


@pytest.mark.slow
def test_all_modes_count_the_tolerances(tmp_path):
    """s11 of drawn plates from all their poles and zeros, which determine d31 and ε33T less well than the prior
    does.
    """
    pulls = []
    for seed in (0, 9, 13):
        drawn = draw("laboratory:none", seed)
        path = drawn.write(tmp_path / str(seed))
        path.write_text(path.read_text() + '\n[update]\nmethod = "pole_zero"\n')
        pulls.append(pulls_of(path, drawn.theta, ("s11",)))
    assert 0.4 < np.sqrt(np.mean(np.square(pulls))) < 1.8, pulls


def test_what_the_method_does_not_know_is_refused(tmp_path):
    more = "noise_only = true\n[effects.series_resistance]\nresistance = 1.0"
    with pytest.raises(InputError, match=r"cannot include \[effects\]"):
        update(read_specimen(written(tmp_path, 1, more=more)))
