"""`identify`: the deviations that an update will state and the gain by a smaller tolerance, against files with that
tolerance and updates.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import femu_piezo as fp
from femu_piezo.measurement.readers import write_spectrum
from femu_piezo.specimen.file import read_specimen
from tests.commands import succeeded
from tests.noise import noisy

#: A plate with the usual tolerances, and sweeps of twelve such plates by spectral elements (make_sweep.py there).
FOLDER = Path(__file__).resolve().parents[2] / "tutorials" / "stated_uncertainty"
PLATE = (FOLDER / "plate.toml").read_text(encoding="utf-8")


@pytest.fixture
def specimen(tmp_path):
    """A function that writes a specimen file and reads it."""

    def written(text: str = PLATE, name: str = "plate.toml"):
        (tmp_path / name).write_text(text, encoding="utf-8")
        return read_specimen(tmp_path / name)

    return written


@pytest.fixture(scope="module")
def today():
    """What is expected with the tolerances of the file."""
    return fp.identify(FOLDER / "plate.toml", recommend=False).expected


def improvement(expected, tolerance: str):
    """The expected improvement by one tolerance."""
    (one,) = (one for one in expected.improvements if one.tolerance == tolerance)
    return one


def relative(parameters) -> dict[str, float]:
    """Name of constant or tangent → its stated deviation."""
    pairs = ((f"{kind}{n}", std) for n, p in parameters.items() for kind, std in (("", p.std), ("tan_", p.tan_std)))
    return dict(pairs)


HALVED = {
    "std_density": ("geometry]", "geometry]\nstd_density = 0.0025"),
    "std_width": ("geometry]", 'geometry]\nstd_width = "0.01 mm"'),
    "std_tan_s12": ("material]", "material]\nstd_tan_s12 = 0.0025"),
    "phase_accuracy": ("measurement]", 'measurement]\nphase_accuracy = "0.4 mrad"'),
    "accuracy": ("measurement]", "measurement]\naccuracy = 0.0004"),
    "residue.resistance": ("measurement]", 'measurement]\nresidue = { resistance = "10 mohm" }'),
    "noise": ("noise = 0.001", "noise = 0.0005"),
}


@pytest.mark.parametrize("tolerance", HALVED)
def test_expected_gain_is_that_of_a_file_with_half_the_tolerance(tolerance, today, specimen):
    """Each kind of tolerance halved in the file and everything computed anew: equal to rounding."""
    again = fp.identify(specimen(PLATE.replace(*HALVED[tolerance])), recommend=False).expected
    one = improvement(today, tolerance)
    assert improvement(again, tolerance).today == pytest.approx(one.today / 2, rel=1e-12, abs=0)
    assert relative(again.parameters) == pytest.approx(one.halved, rel=1e-9, abs=0)
    assert max(one.shrinks(label) for label in one.before) > 1e-5  # halving the tolerance has some effect


@pytest.mark.parametrize(("piece", "tolerance"), [(1, "std_width"), (2, "std_density"), (12, "phase_accuracy")])
def test_expected_deviations_are_those_of_an_update(piece, tolerance, today, specimen):
    """Updates of sweeps by another discretisation, with the tolerance and with half of it.

    The expectation is linear, about constants up to 3 % and tangents up to 0.004 off, and for average noise: 8 % are
    allowed in the deviations, 3 % in their reduction.
    """
    columns = np.loadtxt(FOLDER / "sweep.csv", delimiter=",", skiprows=1, unpack=True)
    sweep = fp.ImpedanceSpectrum.from_resistance_reactance(columns[0], columns[2 * piece - 1], columns[2 * piece])
    one = improvement(today, tolerance)
    before, after = (
        relative(fp.update(specimen(text), sweep).parameters) for text in (PLATE, PLATE.replace(*HALVED[tolerance]))
    )
    assert one.shrinks(one.best(tangents=tolerance == "phase_accuracy")[0]) > 0.15  # the tolerance matters in this case
    for label in ("s11", "d31", "eps33T", "tan_d31", "tan_eps33T"):
        assert before[label] == pytest.approx(one.before[label], rel=0.08, abs=0), label
        assert after[label] / before[label] == pytest.approx(1 - one.shrinks(label), rel=0.03), label


SWEEP = '\n[[sweep]]\nfile = "{name}.csv"\n{key} = "{value}"\n'


def test_coefficients_of_temperature_are_no_tolerance_of_the_constant_they_change(specimen):
    """Two plates 40 K apart, whose files halve the deviation of d33: the expected gain is that of such files."""
    pieces = {"plate": ("12 mm", 20), "long": ("18 mm", 60)}

    def expected(table: str):
        texts = {
            name: PLATE.replace('name = "plate"', f'name = "{name}"')
            .replace("12 mm", length)
            .replace("material]", table)
            + SWEEP.format(name=name, key="temperature", value=f"{warm} degC")
            for name, (length, warm) in pieces.items()
        }
        files = [specimen(text, f"{name}.toml") for name, text in texts.items()]
        return fp.identify(files, recommend=False).expected

    one = improvement(expected("material]"), "std_d33")
    again = relative(expected("material]\nstd_d33 = 0.015").parameters)
    assert again == pytest.approx(one.halved, rel=1e-9, abs=0)
    assert one.halved["eps33T"] < (1 - 1e-6) * one.before["eps33T"]


@pytest.mark.parametrize(
    ("key", "values"),
    [("temperature", ("20 degC", "60 degC")), ("fixture", ("clips", "foam")), ("direction", ("up", "down"))],
)
def test_every_sweep_of_a_specimen_is_expected(key, values, specimen, tmp_path):
    """Two sweeps 40 K apart, of two fixtures or in two directions, against an update of such sweeps by the model.

    Sweeps at two temperatures tell the constants at their mean, whatever a single one tells.
    """
    text = PLATE + "".join(
        SWEEP.format(name=name, key=key, value=value) for name, value in zip("ab", values, strict=True)
    )
    clean = fp.simulate(specimen()).spectrum
    for seed, name in enumerate("ab"):
        noise = noisy(clean.impedance, 1e-3, seed)
        write_spectrum(fp.ImpedanceSpectrum(clean.frequency, noise), tmp_path / f"{name}.csv")
    several = specimen(text)
    expected = relative(fp.identify(several, recommend=False).expected.parameters)
    assert expected == pytest.approx(relative(fp.update(several).parameters), rel=0.08, abs=0)


def test_a_plan_for_a_file_with_several_sweeps_is_one_sweep(specimen):
    """The next sweep, by the constants of the file, whatever the temperatures of those that it names."""
    sweeps = (SWEEP.format(name=warm, key="temperature", value=f"{warm} degC") for warm in (20, 60))
    one, several = (
        fp.identify(specimen(text), recommend=False, plan=32).plan for text in (PLATE, PLATE + "".join(sweeps))
    )
    np.testing.assert_allclose(several.frequency, one.frequency)


READ = (
    PLATE
    + """
[readings]
mass = "0.27 g"
std_mass = 0.003
"""
)


def test_a_reading_is_counted_and_what_a_better_one_would_bring(today, specimen):
    """A mass to 0.3 %: the gain by half of that against such a file, the deviations against an update with the
    reading.
    """
    planned = fp.identify(specimen(READ), recommend=False).expected
    better = fp.identify(specimen(READ.replace("0.003", "0.0015")), recommend=False).expected
    one = improvement(planned, "readings.std_mass")
    assert relative(better.parameters) == pytest.approx(one.halved, rel=1e-9, abs=0)
    assert planned.parameters["s11"].std < 0.9 * today.parameters["s11"].std
    columns = np.loadtxt(FOLDER / "sweep.csv", delimiter=",", skiprows=1, unpack=True)
    sweep = fp.ImpedanceSpectrum.from_resistance_reactance(*columns[:3])
    found, expected = fp.update(specimen(READ), sweep).parameters["s11"], planned.parameters["s11"]
    assert found.std == pytest.approx(expected.std, rel=0.08, abs=0)
    assert found.budget["readings"] == pytest.approx(expected.budget["readings"], rel=0.08, abs=0)
    assert np.sqrt(sum(part**2 for part in found.budget.values())) == pytest.approx(found.std, rel=1e-6, abs=0)


def test_a_study_reads_the_specimens_that_it_draws(specimen):
    """Sizes known to a micrometre and a mass to 0.05 %: the mass tells the density, which is 0.5 % off, and s11.

    Were it that of the file for every drawn specimen, s11 would be off by four times what is stated. The rms of 20
    errors is within 50 % of their deviation.
    """
    sizes = "".join(f'\nstd_{name} = "1 um"' for name in ("length", "width", "thickness"))
    text = READ.replace("geometry]", f"geometry]{sizes}").replace("0.003", "0.0005").replace("= 201", "= 51")
    planned = fp.identify(specimen(text), recommend=False, study=20).study[1]
    place = planned.labels.index("s11")
    stated = np.median(planned.stated[:, place])
    assert stated < 0.002 * planned.values[place]
    assert planned.deviation[place] / stated == pytest.approx(1.0, abs=0.5)


def test_budget_adds_up_and_the_order_is_that_of_the_gains(today):
    """Parts of the budget, the order of the improvements, and s11 by hand."""
    for one in today.parameters.values():
        assert {"noise", "geometry", "density", "held", "instrument", "prior"} == set(one.budget)
        assert np.sqrt(sum(part**2 for part in one.budget.values())) == pytest.approx(one.std, rel=1e-9, abs=0)
        assert np.sqrt(sum(part**2 for part in one.tan_budget.values())) == pytest.approx(one.tan_std, rel=1e-9, abs=0)
    gains = [one.best()[1] for one in today.improvements]
    assert gains == sorted(gains, reverse=True)
    # 7 held constants with tangents, 3 dimensions and density, 2 of the instrument, 3 of the fixture, noise
    assert len({one.tolerance for one in today.improvements}) == len(today.improvements) == 2 * 7 + 4 + 2 + 3 + 1
    # s11 follows from ρ L² f², so its deviation is hypot(0.5 %, 2 · 0.02/12); d31 and ε33T have width and thickness too
    assert today.parameters["s11"].std / 16.5e-12 == pytest.approx(np.hypot(0.005, 2 * 0.02 / 12), rel=0.02)
    # with the density exactly known, s11 has the uncertainty of the length alone
    exact = improvement(today, "std_density").exact["s11"] / 16.5e-12
    assert exact == pytest.approx(2 * 0.02 / 12, rel=0.03)


def test_noise_only_leaves_noise(specimen):
    """With noise_only the noise is the single improvement, and half of it halves every deviation."""
    expected = fp.identify(specimen(PLATE + "\n[update]\nnoise_only = true\n"), recommend=False).expected
    (noise,) = expected.improvements
    assert noise.tolerance == "noise" and not noise.exact
    assert noise.halved == pytest.approx({label: std / 2 for label, std in noise.before.items()}, rel=1e-3, abs=0)
    assert all(one.std / abs(one.value) < 1e-4 for one in expected.parameters.values())


def test_less_noise_than_the_error_of_the_model_gains_little(specimen):
    """At a noise of 1e-5, as large as the error of the model, half of it gains what `identify` states at half of it."""
    alone = specimen(PLATE + "\n[update]\nnoise_only = true\n")
    today, again = (fp.identify(alone, noise, recommend=False).expected for noise in (1e-5, 5e-6))
    one = improvement(today, "noise")
    assert one.halved == pytest.approx(relative(again.parameters), rel=1e-9, abs=0)
    assert one.shrinks("s11") == pytest.approx(1 - np.sqrt(1.25 / 2), rel=1e-3)


def test_tolerances_of_a_piece_that_was_weighed_and_of_two_specimens(specimen):
    """The tolerance of a mass is in kg; each specimen has its own dimensions, the fixture is common to both."""
    weighed = PLATE.replace('density = "7500 kg/m^3"', 'mass = "0.27 g"')
    long = PLATE.replace('"12 mm"', '"18 mm"').replace('"plate"\n\n', '"long"\n\n')
    expected = fp.identify([specimen(weighed), specimen(long, "long.toml")], recommend=False).expected
    by_name = {(one.tolerance, one.specimen): one for one in expected.improvements}
    assert ("std_mass", "plate") in by_name and ("std_density", "long") in by_name
    assert (
        by_name["std_mass", "plate"].today == pytest.approx(0.27e-6, rel=1e-6, abs=0)
        and by_name["std_mass", "plate"].unit == "kg"
    )
    assert by_name["std_length", "long"].today == by_name["std_length", "plate"].today == 20e-6
    assert ("residue.resistance", "") in by_name and ("std_s12", "") in by_name
    alone = fp.identify(specimen(weighed), recommend=False).expected
    assert (
        expected.parameters["eps33T"].std < 0.8 * alone.parameters["eps33T"].std
    )  # two specimens determine it better than one


def test_a_cause_that_the_file_leaves_free_is_no_tolerance(specimen, today):
    """A free lead has the prior of a cause: the residual resistance of the fixture is no improvement, and tangents
    are less certain.
    """
    leads = PLATE + '\n[effects.series_resistance]\nresistance = "1.5 ohm"\nfree = ["resistance"]\n'
    expected = fp.identify(specimen(leads), recommend=False).expected
    names = {one.tolerance for one in expected.improvements}
    assert {one.tolerance for one in today.improvements} - names == {"residue.resistance"}
    assert expected.parameters["d31"].tan_std > 1.2 * today.parameters["d31"].tan_std
    known = fp.identify(specimen(leads.replace('free = ["resistance"]', "")), recommend=False).expected
    assert known.parameters["d31"].tan_std < 1.1 * today.parameters["d31"].tan_std


def test_a_file_without_losses_has_the_usual_ones(specimen):
    """Tangents of 0.02 are assumed, since without losses every constant would be determined without limit."""
    bare = "".join(line for line in PLATE.splitlines(keepends=True) if not line.startswith("tan_"))
    expected = fp.identify(specimen(bare), recommend=False).expected.parameters
    assert [one.tan for one in expected.values()] == pytest.approx([0.02] * 3)


def test_command_prints_and_writes_them(tmp_path):
    """Table, identifiability.json and budget.png."""
    answer = succeeded("identify", FOLDER / "plate.toml", "--out", tmp_path / "out")
    assert "constants from a sweep with 0.1 % noise" in answer.output  # the noise of the file
    assert "201 points from 20 kHz to 200 kHz" in answer.output
    (line,) = (line for line in answer.output.splitlines() if "std_density" in line)
    assert "0.5 % -> 0.25 %" in line and "s11 0.61 % -> 0.42 %" in line
    assert "phase_accuracy" in answer.output and "0.8 mrad -> 0.4 mrad" in answer.output
    record = json.loads((tmp_path / "out" / "identifiability.json").read_text(encoding="utf-8"))
    first = record["improvements"][0]
    assert (first["tolerance"], first["today"], first["halved"]) == ("std_density", 0.005, 0.0025)
    assert first["std"]["s11"]["today"] == record["expected"]["s11"]["std"]
    assert first["std"]["s11"]["exact"] < first["std"]["s11"]["halved"] < first["std"]["s11"]["today"]
    assert (tmp_path / "out" / "budget.png").stat().st_size > 10000
