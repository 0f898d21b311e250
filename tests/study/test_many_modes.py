"""Appendix A of the paper: any free constants from all poles and zeros, of sweeps of the independent solver."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
from click.testing import CliRunner
from hidden_effects.build import Build
from hidden_effects.draws import DENSITY, NAMES, PZT5H

from femu_piezo import read_specimen, update
from femu_piezo.cli import main
from femu_piezo.errors import InputError

SIZE = np.array([12e-3, 6.7e-3, 1.6e-3])
FREE = ("s11", "s12", "d31", "eps33T")
TRUTH = PZT5H.astype(complex)
for _name, _off, _tangent in (("s11", 1.03, 0.016), ("d31", 0.97, 0.012), ("eps33T", 1.05, 0.018)):
    TRUTH[NAMES.index(_name)] *= _off * (1 - 1j * _tangent)


@cache
def clean(length: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies and Z of a plate without noise."""
    frequency = np.linspace(20e3, 240e3, 601) * SIZE[0] / length
    size = np.array([length, *SIZE[1:]])
    return frequency, Build(size, DENSITY, TRUTH, fundamental=0.0).impedance(frequency)


def written(folder, seed: int, length: float = SIZE[0], noise: float = 1e-3, free=FREE, more: str = ""):
    """Specimen file with a sweep, the constants of the file off."""
    frequency, z = clean(length)
    draw = np.random.default_rng(seed).standard_normal((2, z.size)) * noise / np.sqrt(2)
    z = z * (1 + draw[0] + 1j * draw[1])
    name = f"plate {1e3 * length:g} mm"
    np.savetxt(
        folder / f"{name}.csv",
        np.column_stack([frequency, z.real, z.imag]),
        delimiter=",",
        header="frequency_Hz,resistance_ohm,reactance_ohm",
        comments="",
    )
    body = ['shape = "plate"', f"length = {length}", f"width = {SIZE[1]}", f"thickness = {SIZE[2]}"]
    constants = [f"{one} = {value.real!r}" for one, value in zip(NAMES, PZT5H.tolist(), strict=True)]
    text = [f'name = "{name}"', "[geometry]", *body, f"density = {DENSITY}", "[material]", f"free = {list(free)}"]
    text += [*constants, "[measurement]", f'file = "{name}.csv"', "[update]", 'method = "pole_zero"', more]
    path = folder / f"{name}.toml"
    path.write_text("\n".join(text), encoding="utf-8")
    return path


def test_four_constants_from_three_modes(tmp_path):
    """Values and tangents of six sweeps within what is stated: noise of λ and error of the mesh."""
    pulls = []
    for seed in range(6):
        result = update(read_specimen(written(tmp_path, seed)))
        assert result.method == "pole_zero" and result.fit is None
        for name, one in result.parameters.items():
            exact = TRUTH[NAMES.index(name)]
            pulls.append([(one.value - exact.real) / one.std, (one.tan + exact.imag / exact.real) / one.tan_std])
    rms = np.sqrt(np.mean(np.reshape(pulls, (6, -1)) ** 2, axis=0))
    assert np.all(rms < 1.9) and 0.7 < np.sqrt(np.mean(rms**2)) < 1.3, rms
    assert result.parameters["s11"].std < 1e-5 * result.parameters["s11"].value
    assert any("6 of 6 measured poles and zeros" in note for note in result.notes)


def test_two_specimens_join(tmp_path):
    """The command on two plates of one material; each alone knows less."""
    files = [written(tmp_path, 1), written(tmp_path, 2, length=16e-3)]
    out = tmp_path / "out"
    answer = CliRunner().invoke(main, ["update", *map(str, files), "--method", "pole-zero", "--out", str(out)])
    assert answer.exit_code == 0, answer.output
    both = json.loads((out / "update.json").read_text(encoding="utf-8"))
    assert both["method"] == "pole_zero" and len(both["specimens"]) == 2
    alone = update(read_specimen(files[0])).parameters
    for name, one in both["parameters"].items():
        assert one["std"] < alone[name].std, name
        assert abs(one["value"] - TRUTH[NAMES.index(name)].real) < 4 * one["std"], name


def test_what_the_method_does_not_know_is_refused(tmp_path):
    more = "[effects.series_resistance]\nresistance = 1.0"
    with pytest.raises(InputError, match=r"knows no \[effects\]"):
        update(read_specimen(written(tmp_path, 1, more=more)))
