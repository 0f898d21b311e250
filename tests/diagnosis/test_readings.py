"""Readings of other instruments in a fit: their values by the compliance matrix, their slopes, and how they narrow a
posterior.
"""

from __future__ import annotations

from dataclasses import replace
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest
from hidden_effects.ritz import RitzPlate

from diagnosis.conftest import AXES, DENSITY, FREQUENCY, FUNDAMENTAL, SIZE
from femu_piezo.diagnosis.readings import readings as direct_readings
from femu_piezo.effects.effect import EffectContext
from femu_piezo.errors import InputError
from femu_piezo.inference.fit import fit
from femu_piezo.inference.readings import Reading, read_beside
from femu_piezo.specimen.file import Readings
from tests.commands import invoked
from tests.noise import noisy

TUTORIALS = Path(__file__).parents[2] / "tutorials"
VOLUME, AREA, NOISE = float(np.prod(SIZE)), SIZE[0] * SIZE[1], 0.02
KILOHERTZ = np.array([1e3])
NAMES = ("mass", "capacitance", "d33", "sound_velocity")


def reading(setup, name: str, value: float, std: float) -> Reading:
    return Reading(name, value, std, "", DENSITY, VOLUME, AREA, setup.model)


def capacitance(z: np.ndarray) -> float:
    """Im Y/ω, F, of an impedance (1,) at 1 kHz."""
    return float((1 / z[0]).imag / (2 * np.pi * KILOHERTZ[0]))


def known(theta: np.ndarray) -> dict[str, float]:
    """Name → value of the four readings for the bare plate; c33D from the inverse of the compliances at constant D, the
    capacitance at 1 kHz by the independent solver.
    """
    s11, s12, s13, s33, _, d31, d33, _, _, eps = theta
    s = np.array([[s11, s12, s13], [s12, s11, s13], [s13, s13, s33]])
    d = np.array([d31, d31, d33])
    stiff = np.linalg.inv(s - np.outer(d, d) / eps)
    return {
        "mass": DENSITY * VOLUME,
        "capacitance": capacitance(RitzPlate(SIZE, DENSITY, (9, 7, 5)).impedance(theta, KILOHERTZ)),
        "d33": d33.real,
        "sound_velocity": np.sqrt(stiff[2, 2].real / DENSITY),
    }


@pytest.mark.parametrize("name", NAMES)
def test_readings_of_the_bare_plate(setup, name):
    """The residual of a reading with the right value is zero."""
    value = known(setup.theta)[name]
    row, slopes = reading(setup, name, value, 1e-2 * abs(value)).row(setup.unknowns, setup.x)
    assert abs(row) < 1e-6 and slopes.shape == setup.x.shape


@pytest.mark.parametrize("name", NAMES)
def test_slopes_of_readings_with_causes(setup, name):
    """Against differences, with causes that move the readings: dimensions, density, a film, a point mass, a gap, a
    relaxation, a held constant.
    """
    causes = {
        "wrong_length": 0.01,
        "wrong_thickness": -0.01,
        "wrong_density": 0.02,
        "electrode_mass": 0.1,
        "point_mass": (2e-6, 4e-3, 2e-3, 5e-4),
        "contact_gap": 1e8,
        "relaxation": (0.05, 9e4, 0.3),
        "wrong_insensitive_parameter:d33": 0.05,
    }
    parameters, x = setup.with_effects(causes)
    value = known(setup.theta)[name]
    read = reading(setup, name, value, 1e-2 * abs(value))
    row, slopes = read.row(parameters, x)
    assert abs(row) > 0.1
    for column in range(x.size):
        step = np.zeros(x.size)
        step[column] = 1e-4
        numeric = (read.row(parameters, x + step)[0] - read.row(parameters, x - step)[0]) / 2e-4
        assert slopes[column] == pytest.approx(numeric, rel=1e-5, abs=1e-6 * np.max(np.abs(slopes)))


def test_a_balance_sees_the_mass_of_an_own_effect(setup):
    """The solder of the tutorial, 3 mg on each of two ends; a plan advises to weigh where it may be there."""
    spec = spec_from_file_location("end_mass", TUTORIALS / "own_effect/effects/end_mass.py")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    context = EffectContext(FUNDAMENTAL, ("s11",), setup.constants, AXES, DENSITY, SIZE[2], 2e3, tuple(SIZE))
    (solder,) = module.candidates(context)
    parameters = setup.unknowns.with_candidate(solder)
    x = np.append(setup.x, 3e-6 / solder.scale)
    row, slopes = reading(setup, "mass", DENSITY * VOLUME, 1e-6).row(parameters, x)
    assert row == pytest.approx(6.0) and slopes[-1] == pytest.approx(2 * solder.scale[0] / 1e-6)
    assert np.all(slopes[:-1] == 0)
    ((words, seen),) = direct_readings([solder], {"": context})
    assert words == "weigh the specimen, to 0.1 %" and list(seen) == [("end_mass", "")]


@pytest.mark.parametrize(
    ("name", "cause"),
    [
        ("mass", "wrong_density"),
        ("capacitance", "stray_capacitance"),
        ("d33", "wrong_insensitive_parameter:d33"),
    ],
)
def test_a_reading_narrows_by_the_right_amount(setup, name, cause):
    """A cause that a constant hides: the refit has the posterior of sweep and reading by Bayes' rule for normal
    distributions.
    """
    z = RitzPlate(SIZE, DENSITY, (13, 10, 5)).impedance(setup.theta, FREQUENCY)
    data = setup.data(noisy(z, NOISE, 3), NOISE)
    parameters, x = setup.with_effects({cause: 0.0})
    value = known(setup.theta)[name]
    read = reading(setup, name, value, 5e-4 * abs(value))
    free = fit(setup.evaluation, data, parameters, [x])
    with_reading = fit(setup.evaluation, data, replace(parameters, readings=(read,)), [free.x])
    row, h = read.row(parameters, free.x)
    before = free.precision_inverse
    gain = before @ h / (1 + h @ before @ h)
    expected = before - np.outer(gain, h @ before)
    place = parameters.columns(0).start
    assert with_reading.precision_inverse[place, place] < before[place, place] / 10
    np.testing.assert_allclose(np.diag(with_reading.precision_inverse), np.diag(expected), rtol=0.03)
    assert np.all(np.abs(with_reading.x - (free.x - gain * row)) < 0.1 * np.sqrt(np.diag(expected)))
    assert abs(read_beside(with_reading)[name]["sigma"]) < 3


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"mass": "2 mm"}, "readings.mass"),
        ({"d33": 0.0}, "readings.d33 = 0"),
        ({"std_mass": 0.01}, "readings.std_mass is given without readings.mass"),
        ({"capacity": 1e-9}, "did you mean 'capacitance'"),
        ({"sound_velocity": 4.5}, "readings.sound_velocity"),
    ],
)
def test_wrong_readings_are_one_sentence(table, words):
    with pytest.raises(InputError, match=words):
        Readings.model_validate(table)


def test_two_masses_end_with_exit_code_2(tmp_path):
    """A mass under both [geometry] and [readings]."""
    path = tmp_path / "plate.toml"
    path.write_text(
        '[geometry]\nshape = "plate"\npoling = "thickness"\nlength = 12e-3\nwidth = 6.5e-3\nthickness = 1.5e-3\n'
        'mass = "0.9 g"\n[material]\nbase = "pzt-5h"\n[measurement]\nfile = "a.csv"\n[readings]\nmass = "0.9 g"\n',
        encoding="utf-8",
    )
    answer = invoked("update", path, "--out", tmp_path / "out")
    assert answer.exit_code == 2 and "geometry.mass" in answer.output and answer.output.strip().count("\n") == 0
