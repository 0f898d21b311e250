"""extended.toml: it simulates the fitted curve, and a further fit of it knows no more than the first one."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import femu_piezo as fp
from femu_piezo.effects.extended_model import ExtendedModel
from femu_piezo.effects.library import circuits, drive_level, temperature_drift
from femu_piezo.inference.fit import fit
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.specimen.file import CONSTANTS, Simulation, Specimen, read_specimen, write_specimen
from femu_piezo.study.diagnose import diagnose, extended_specimen
from femu_piezo.study.effects import effects_as_simulated, simulated_with_effects
from femu_piezo.study.measured import Measured, measure_each
from femu_piezo.study.model_cache import Bases
from femu_piezo.study.problem import prepare
from femu_piezo.study.simulate import simulate
from femu_piezo.study.tolerances import tolerances
from femu_piezo.study.update import update
from tests.noise import noisy

TRIO = ("s11", "d31", "eps33T")
NOISE = 5e-4


class Keeping(Bases):
    """Bases that keep the last basis with effects of a measured sweep, not of a plan."""

    last: ExtendedModel

    def extended(self, model, training, effects, one, accuracy):
        found = super().extended(model, training, effects, one, accuracy)
        if isinstance(one, Measured):
            self.last = found
        return found


@pytest.fixture(params=["no cause", "series_resistance", pytest.param("leakage", marks=pytest.mark.slow)])
def diagnosed(request, sweeps, write_specimen_of, tmp_path):
    """A diagnosed plate and its extended file: width 0.1 % and gain 0.1 % off, s11 of the file 1 %, s12 2 % and d31
    3 % off.
    """
    frequency, z = sweeps["k31"].frequency, sweeps["k31"].impedance
    if request.param == "series_resistance":
        z = z + 60.0
    if request.param == "leakage":
        z = 1 / (1 / z + 2e-7)
    z = noisy(1.001 * z, NOISE, 1)
    factors = {"s11": 1.01, "s12": 1.02, "d31": 0.97}
    extra = 'std_s11 = "0.2 %"\nstd_tan_d31 = 0.002\nstd_s12 = "2 %"'
    path = write_specimen_of("k31", ImpedanceSpectrum(frequency, z), TRIO, factors, extra, f"noise = {NOISE}", True)
    path.write_text(path.read_text().replace("width = 0.003", "width = 0.002997"))
    bases = Keeping()
    result = diagnose(read_specimen(path), bases=bases, effects=[circuits.candidates])
    assert [cause.effect.name for cause in result.verdict.causes] == [request.param] * (request.param != "no cause")
    write_specimen(extended_specimen(result), tmp_path / "extended.toml")
    return SimpleNamespace(result=result, file=read_specimen(tmp_path / "extended.toml"), model=bases.last)


def curve(one: SimpleNamespace, file: Specimen) -> np.ndarray:
    """Z (k,) of a file as `simulate` takes it, by the reduced model of the diagnosis."""
    problem, frequency = prepare(file), one.result.spectrum.frequency
    known = effects_as_simulated(problem, frequency)
    return simulated_with_effects(problem, one.model, frequency, known)


def test_the_file_gives_the_fitted_curve(diagnosed):
    """Within 1e-6 by the same reduced model; without any table of [fitted] the curve differs by more than twice
    that.
    """
    fitted, file = diagnosed.result.curves[1], diagnosed.file
    assert np.max(np.abs(curve(diagnosed, file) / fitted - 1)) < 1e-6
    for left_out in ("material", "wrong_width", "wrong_insensitive_parameter", "instrument"):
        without = {name: table for name, table in file.fitted.items() if name != left_out}
        changed = curve(diagnosed, file.model_copy(update={"fitted": without}))
        assert np.max(np.abs(changed / fitted - 1)) > 2e-6, left_out


def test_simulate_gives_the_fitted_curve_within_the_error_of_its_mesh(diagnosed):
    """Within 1e-4 in Z: eigenvalues on the mesh of `simulate` have the file's accuracy of 1e-4, those of a fit
    errors below the noise.
    """
    frequency, fitted = diagnosed.result.spectrum.frequency[1:], diagnosed.result.curves[1][1:]
    sweep = Simulation(start=frequency[0], stop=frequency[-1], points=frequency.size)
    found = simulate(diagnosed.file.model_copy(update={"simulation": sweep})).spectrum
    np.testing.assert_allclose(found.frequency, frequency, rtol=1e-12)
    assert np.max(np.abs(found.impedance / fitted - 1)) < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize(
    ("table", "cause", "spacing"),
    [
        ("temperature_drift]\ndrift = 0.01", temperature_drift, "log"),
        ("drive_level]\nsoftening = 0.01", drive_level, "linear"),
    ],
)
def test_how_a_sweep_was_taken_is_simulated_as_it_was_fitted(tmp_path, table, cause, spacing):
    """The pole of a square, at which both laws are anchored, lies 13 % above that of a thin bar; and in a sweep with
    logarithmic steps, time is the logarithm of frequency.
    """
    body = '[geometry]\nshape = "square"\nlength = 8e-3\nthickness = 1e-3\ndensity = 7500.0\n'
    losses = "".join(f"tan_{name} = 0.015\n" for name in CONSTANTS)
    body += f'[material]\nbase = "pzt-5h"\nfree = ["s11", "d31", "eps33T"]\n{losses}'
    sweep = f'[simulation]\nstart = 20e3\nstop = 350e3\npoints = 500\nspacing = "{spacing}"\nnoise = 1e-3\n'
    (tmp_path / "square.toml").write_text(body + sweep)
    (tmp_path / "disturbed.toml").write_text(f"{body}{sweep}[effects.{table}\n")
    spectrum = simulate(read_specimen(tmp_path / "disturbed.toml")).spectrum
    result = diagnose(read_specimen(tmp_path / "square.toml"), spectra=[spectrum], effects=[cause.candidates])
    write_specimen(extended_specimen(result), tmp_path / "extended.toml")
    extended = read_specimen(tmp_path / "extended.toml")
    exact = extended.model_copy(update={"simulation": extended.simulation.model_copy(update={"noise": 0.0})})
    assert len(result.verdict.causes) == 1
    assert np.max(np.abs(simulate(exact).spectrum.impedance / result.curves[1] - 1)) < 1e-3


@pytest.mark.slow
def test_a_drift_of_the_second_specimen_is_anchored_at_its_own_fundamental(tmp_path):
    """A square of 8 mm, and one of 5 mm that warms up while it is measured, whose file gives its fitted curve."""
    losses = "".join(f"tan_{name} = 0.015\n" for name in CONSTANTS)
    material = f'[material]\nbase = "pzt-5h"\nfree = ["s11", "d31", "eps33T"]\n{losses}'
    sweep = "[simulation]\nstart = 20e3\nstop = 450e3\npoints = 500\nnoise = 1e-3\n"
    files, spectra = [], []
    for length, effects in (("8e-3", ""), ("5e-3", "[effects.temperature_drift]\ndrift = 0.01\n")):
        body = f'[geometry]\nshape = "square"\nlength = {length}\nthickness = 1e-3\ndensity = 7500.0\n'
        for name, more in ((length, ""), ("disturbed", effects)):
            (tmp_path / f"{name}.toml").write_text(body + material + sweep + more)
        files.append(read_specimen(tmp_path / f"{length}.toml"))
        spectra.append(simulate(read_specimen(tmp_path / "disturbed.toml")).spectrum)
    result = diagnose(files, spectra=spectra, effects=[temperature_drift.candidates])
    assert [cause.effect.owner for cause in result.verdict.causes] == ["5e-3"]
    second = replace(result, shown=1)
    extended = extended_specimen(second)
    exact = extended.model_copy(update={"simulation": extended.simulation.model_copy(update={"noise": 0.0})})
    assert np.max(np.abs(simulate(exact).spectrum.impedance / second.curves[1] - 1)) < 1e-3


def test_a_sweep_in_memory_is_corrected_once(sweeps, write_specimen_of, tmp_path):
    """A raw sweep, mirrored, behind a series lead and a stray capacitance; its file names open, short, load, columns
    and a masked band. The file of the diagnosis reads the corrected sweep as it was fitted, with tolerances as before.
    """
    frequency, z = sweeps["k31"].frequency, sweeps["k31"].impedance
    lead, stray, load = 2.0 + 1e-6j * frequency, 4e-11j * frequency, np.full(frequency.size, 500.0)
    raw = {"short": lead, "open": lead + 1 / stray, "load": lead + load / (1 + stray * load)}
    piece = ImpedanceSpectrum(frequency, -(lead + 1 / (1 / noisy(z, NOISE, 1) + stray)))
    for name, one in raw.items():
        rows = np.column_stack([frequency / 1e3, one.real, one.imag])
        np.savetxt(tmp_path / f"{name}.csv", rows, delimiter=",", header="Frequency (kHz),R (Ohm),X (Ohm)", comments="")
    low, high = frequency[[40, 43]]
    table = "\n".join(
        [
            'open = "open.csv"\nshort = "short.csv"\ncolumns = ["Frequency (kHz)", "R (Ohm)", "X (Ohm)"]',
            f"correct_phase = true\nmask = [[{low}, {high}]]",
            '[measurement.load]\nfile = "load.csv"\nresistance = 500.0\nstd = 0.003',
        ]
    )
    path = write_specimen_of("k31", sweeps["k31"], TRIO, more=table, lossy=True)
    asked = read_specimen(path)
    result = fp.diagnose(asked, piece, effects=[])
    result.save(tmp_path / "out")
    written = read_specimen(tmp_path / "out" / "extended.toml")
    again, first = measure_each([written])[0], result.sweeps[0].measured
    assert first.spectrum.frequency.size == frequency.size - 4
    np.testing.assert_allclose(again.spectrum.frequency, first.spectrum.frequency, rtol=1e-14)
    np.testing.assert_allclose(again.spectrum.impedance, first.spectrum.impedance, rtol=1e-12)
    before, after = tolerances(first.problem), tolerances(again.problem)
    assert after == pytest.approx(before, rel=1e-12) and after["accuracy"] > 0.003


def test_geometry_material_and_measurement_of_the_file_stay(diagnosed):
    """Fitted constants are in a table of their own."""
    given, file = diagnosed.result.specimen, diagnosed.file
    assert (file.geometry, file.material, file.measurement) == (given.geometry, given.material, given.measurement)
    assert file.fitted_constants["s11"] != given.material.s11


def test_a_further_update_knows_no_more(diagnosed):
    """Values, deviations and budgets are those of the diagnosis: priors, tolerances and the prior of the cause are
    the same.
    """
    first = diagnosed.result.after
    again = update(diagnosed.file).parameters
    for name in TRIO:
        assert again[name].value == pytest.approx(first[name].value, abs=1e-3 * first[name].std)
        assert again[name].tan == pytest.approx(first[name].tan, abs=1e-3 * first[name].tan_std)
        assert again[name].std == pytest.approx(first[name].std, rel=1e-4, abs=0)
        assert again[name].tan_std == pytest.approx(first[name].tan_std, rel=1e-4)
        assert again[name].budget == pytest.approx(first[name].budget, rel=1e-2, abs=1e-2 * first[name].std)


def test_a_further_diagnosis_finds_nothing_more(diagnosed):
    """The verdict is none, and its own extended file has the same free causes with the same sizes."""
    again = diagnose(diagnosed.file, effects=[circuits.candidates])
    assert again.verdict.word == "none"
    further, first = extended_specimen(again), diagnosed.file
    assert (further.effects is None) == (first.effects is None)
    for name, table in (further.effects or {}).items():
        assert table["free"] == first.effects[name]["free"] and set(table) == set(first.effects[name])
        assert [table[key] for key in table["free"]] == pytest.approx(
            [first.effects[name][key] for key in table["free"]], rel=1e-5
        )


def test_a_fit_starts_where_the_file_says_that_a_free_effect_is(sweeps, write_specimen_of, monkeypatch):
    """The start is the value of the file, though the prior of the cause is centred on zero."""
    tail = 'noise = 5e-4\n[effects.series_resistance]\nresistance = 50.0\nfree = ["resistance"]\n'
    path = write_specimen_of("k31", sweeps["k31"], TRIO, more=tail, lossy=True)
    seen = []

    def watched(response, data, unknowns, places, **more):
        seen.append((unknowns, places[0]))
        return fit(response, data, unknowns, places, **more)

    monkeypatch.setattr("femu_piezo.study.posterior.fit", watched)
    result = update(read_specimen(path))
    found = result.fit
    unknowns, start = seen[0]
    lead = unknowns.index("series_resistance")
    assert unknowns.values(start)[lead] == pytest.approx([50.0])
    assert unknowns.values(unknowns.prior_mean)[lead] == [0.0]
    assert abs(found.parameters.values(found.x)[lead][0]) < 4 * found.std_of_effects[lead][0]
    assert any(note.startswith("series_resistance, which the file leaves free, was fitted") for note in result.notes)
