"""A constant that [effects] state to be another is that constant."""

from __future__ import annotations

import numpy as np
import pytest

from femu_piezo.errors import InputError
from femu_piezo.material.constants import D_FORM
from femu_piezo.specimen.file import read_specimen
from femu_piezo.study.modes import modes
from femu_piezo.study.simulate import simulate
from tests.materials import PZT5H
from tests.specimens import material, plate

_BAR = ((8e-3, 2e-3, 1.6e-3), 7500.0, 'poling = "length"')
#: All tangents alike: the losses then say nothing of how the modes change with one of the constants.
_ALIKE = PZT5H.with_values(**{one: getattr(PZT5H, one) * (1 - 0.015j) for one in D_FORM})
_SWEEP = "[simulation]\nstart = 30e3\nstop = 400e3\npoints = 101\n"


@pytest.mark.parametrize(("name", "error"), [("s13", 0.05), ("s33", -0.05), ("d33", 0.05)])
def test_a_wrong_constant_is_simulated_as_the_constant_itself(tmp_path, name, error):
    """Z of a k33 bar, by [effects] and by [material]: the two were 5 to 31 % apart."""

    def simulated(factors, more=""):
        text = plate("bar", *_BAR) + material(_ALIKE, ["s11"], factors) + _SWEEP + more
        (tmp_path / "bar.toml").write_text(text, encoding="utf-8")
        return simulate(read_specimen(tmp_path / "bar.toml")).spectrum.impedance

    stated = simulated({}, f"[effects.wrong_insensitive_parameter]\n{name} = {error}\n")
    np.testing.assert_allclose(stated, simulated({name: 1 + error}), rtol=1e-4)


@pytest.mark.parametrize("command", [simulate, modes])
def test_constants_of_no_stable_material_are_refused(tmp_path, command):
    """s13 larger by 60 %: the bar had poles and zeros without a word."""
    table = "[effects.wrong_insensitive_parameter]\ns13 = 0.6\n"
    (tmp_path / "bar.toml").write_text(plate("bar", *_BAR) + material(_ALIKE, ["s11"]) + _SWEEP + table)
    with pytest.raises(InputError, match=r"\[effects\] leave: s11, s12, s13, .* not positive definite"):
        command(read_specimen(tmp_path / "bar.toml"))
