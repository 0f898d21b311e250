"""Diagnosis of k33 bars, square plates, disks, simplified material and held-out bands, on data of independent
solvers.
"""

from __future__ import annotations

import numpy as np
import pytest
from hidden_effects.build import Build

from diagnosis.conftest import DENSITY
from femu_piezo.effects.extended_model import extend_model
from femu_piezo.effects.library import circuits, library
from femu_piezo.errors import ConvergenceError
from femu_piezo.forward.response import full_impedance
from femu_piezo.inference.descent import CLOSE, COARSE
from femu_piezo.inference.fit import fit
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.unknowns import MaterialParameters, Unknowns, material_prior
from femu_piezo.material.constants import D_FORM, PiezoConstants
from femu_piezo.measurement.readers import write_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.specimen.file import read_specimen
from femu_piezo.study.beginning import begin
from femu_piezo.study.diagnose import diagnose
from femu_piezo.study.effects import effect_context
from femu_piezo.study.measured import measure, start_constants
from femu_piezo.study.model_cache import Bases
from femu_piezo.study.problem import prepare
from femu_piezo.study.update import update
from tests.materials import PZT5H, TANGENTS
from tests.noise import noisy
from tests.specimens import material
from tests.variants import variants

NOISE = 2e-3
#: Hidden causes: a resistance in series with the body (ohm) or a conductance parallel to it (S).
RESISTANCE, CONDUCTANCE = 3.0, 1e-7
TRUTH = PZT5H.vector() * np.linspace(0.985, 1.015, 10) * (1 - 1j * TANGENTS)
#: Geometry table, axis of the poling, band (Hz), which holds width modes or overtones.
BODIES = {
    "k33": ('shape = "plate"\npoling = "length"\nlength = 12e-3\nwidth = 3.2e-3\nthickness = 2.5e-3', 0, (20e3, 240e3)),
    "square": ('shape = "square"\npoling = "thickness"\nlength = 12e-3\nthickness = 1.5e-3', 2, (20e3, 240e3)),
    "plate": (
        'shape = "plate"\npoling = "thickness"\nlength = 12e-3\nwidth = 6.5e-3\nthickness = 1.5e-3',
        2,
        (20e3, 240e3),
    ),
    "disk": ('shape = "disk"\npoling = "thickness"\ndiameter = 20e-3\nthickness = 1e-3', 2, (20e3, 300e3)),
}
SIZES = {"k33": (12e-3, 3.2e-3, 2.5e-3), "square": (12e-3, 12e-3, 1.5e-3), "plate": (12e-3, 6.5e-3, 1.5e-3)}


def driving(body: str) -> tuple[str, ...]:
    """The free constants of a body."""
    return ("s33", "d33", "eps33T") if body == "k33" else ("s11", "d31", "eps33T")


def specification(body: str, theta: np.ndarray, more: str = "", extra: str = "") -> str:
    """A specimen file whose free constants are those of the library, and all others those of `theta`."""
    values = dict(zip(D_FORM, theta.tolist(), strict=True))
    for name in driving(body):
        values[name] = getattr(PZT5H, name) * (1 - 0.015j)
    table = material(PiezoConstants(**values), driving(body))
    lines = [f'name = "{body}"', "[geometry]", BODIES[body][0], f"density = {DENSITY}", table, extra]
    lines += ["[measurement]", 'file = "sweep.csv"', f"noise = {NOISE}", more, "[update]", "noise_only = true"]
    return "\n".join(lines) + "\n"


def write(
    folder,
    body: str,
    *,
    resistance: float = 0.0,
    conductance: float = 0.0,
    capacitance: float = 0.0,
    theta: np.ndarray = TRUTH,
    more: str = "",
    extra: str = "",
):
    """Specimen file and noisy sweep of a body, with a resistance in series and others parallel to it."""
    path = folder / f"{body}.toml"
    path.write_text(specification(body, TRUTH, more, extra), encoding="utf-8")
    frequency = np.linspace(*BODIES[body][2], 121)
    parallel = conductance + 2j * np.pi * frequency * capacitance
    z = 1 / (1 / exact(body, theta, frequency, path) + parallel) + resistance
    write_spectrum(ImpedanceSpectrum(frequency, noisy(z, NOISE, len(body))), folder / "sweep.csv")
    return read_specimen(path)


def exact(body: str, theta: np.ndarray, frequency: np.ndarray, path) -> np.ndarray:
    """Z by spectral elements; for the disk by full solutions on a much finer mesh than a diagnosis uses."""
    if body in SIZES:
        return Build(np.array(SIZES[body]), DENSITY, theta, 1e5, poling=BODIES[body][1]).impedance(frequency)
    text = path.read_text(encoding="utf-8")
    path.write_text(text.split("[measurement]")[0], encoding="utf-8")
    problem = prepare(read_specimen(path))
    path.write_text(text, encoding="utf-8")
    model = problem.model(frequency[-1], 3e-4)
    return full_impedance(model, PiezoConstants.from_vector(theta).to_e_form(), frequency)


@pytest.mark.parametrize("body", variants(["k33", "square", "disk"], slow=["square", "disk"]))
def test_cause_is_named_and_the_start_is_near(body, tmp_path):
    """The start lies within 5 % of the true constants, also where modes of two dimensions couple; the cause and the
    final constants within 4 deviations.
    """
    hidden = {"conductance": CONDUCTANCE} if body == "k33" else {"resistance": RESISTANCE}
    specimen = write(tmp_path, body, **hidden)
    start = begin([measure(specimen)], Bases()).constants
    for name in driving(body):
        truth = TRUTH[D_FORM.index(name)].real
        assert getattr(start, name).real == pytest.approx(truth, rel=0.05), name
    result = diagnose(specimen)
    assert result.verdict.word == "effect"
    (cause,) = result.verdict.causes
    assert cause.effect.key == ("leakage" if body == "k33" else "series_resistance")
    assert abs(cause.values[0] - next(iter(hidden.values()))) < 4 * cause.std[0]
    final = result.after
    for name in driving(body):
        truth = TRUTH[D_FORM.index(name)]
        assert abs(final[name].value - truth.real) < 4 * abs(final[name].std), name


def test_parallel_capacitance_of_ten_times_that_of_the_body(tmp_path):
    """A fit of the constants alone puts all of it into ε33T; beside the cause, ε33T has to come back by as much."""
    specimen = write(tmp_path, "k33", capacitance=2e-10)

    def without_cables(context):
        return [effect for effect in circuits.candidates(context) if effect.name != "cable"]

    result = diagnose(specimen, effects=[without_cables])
    assert result.before["eps33T"].value > 5 * TRUTH[D_FORM.index("eps33T")].real
    (cause,) = result.verdict.causes
    assert cause.effect.key == "stray_capacitance" and cause.probability > 0.9
    assert abs(cause.values[0] - 2e-10) < 4 * cause.std[0]
    for name in driving("k33"):
        final = result.after[name]
        assert abs(final.value - TRUTH[D_FORM.index(name)].real) < 4 * abs(final.std), name


def test_update_of_a_square_plate_starts_from_the_file(tmp_path):
    """Thin-bar formulas make no stable material of the first pole and zero, so the update starts with the constants
    of the file.
    """
    specimen = write(tmp_path, "square")
    found = update(specimen).parameters
    for name in driving("square"):
        assert found[name].value == pytest.approx(TRUTH[D_FORM.index(name)].real, rel=1e-3, abs=0), name


def test_file_that_is_stable_but_not_passive_is_a_start(tmp_path):
    """Where thin-bar formulas make no stable material, the constants of the file are taken though their losses
    together are not passive.
    """
    write(tmp_path, "square")
    text = (tmp_path / "square.toml").read_text(encoding="utf-8")
    (line,) = [one for one in text.splitlines() if one.startswith("tan_d31 ")]
    (tmp_path / "square.toml").write_text(text.replace(line, "tan_d31 = 0.2"), encoding="utf-8")
    measured = measure(read_specimen(tmp_path / "square.toml"))
    given = measured.problem.constants
    assert given.physical_faults() and not given.physical_faults(passive=False)
    assert not start_constants([measured]).physical_faults(passive=False)


def test_a_diagnosis_goes_on_with_a_base_fit_that_did_not_converge(tmp_path, monkeypatch):
    """A coarse base fit suffices to find the cause; an update fails instead."""
    specimen = write(tmp_path, "k33", conductance=CONDUCTANCE)

    def restless(*given, gain: float = CLOSE, **named):
        """A fit that converges only coarsely."""
        if gain < COARSE:
            raise ConvergenceError("no fit settled")
        return fit(*given, gain=gain, **named)

    monkeypatch.setattr("femu_piezo.study.posterior.fit", restless)
    with pytest.raises(ConvergenceError, match="settled"):
        update(specimen)
    verdict = diagnose(specimen).verdict
    assert [cause.effect.key for cause in verdict.causes] == ["leakage"]


@pytest.mark.slow
@pytest.mark.parametrize("resistance", [RESISTANCE, 0.0])
def test_simplified_material(resistance, tmp_path):
    """Data and model with the isotropic simplification: verdict none without a cause, and a resistance is named."""
    path = tmp_path / "plate.toml"
    path.write_text(specification("plate", TRUTH, material="simplified = true").split("[measurement]")[0])
    free = (problem := prepare(read_specimen(path))).free(problem.constants)
    isotropic = free.constants(TRUTH[[D_FORM.index(name) for name in free.names]]).vector()
    specimen = write(tmp_path, "plate", resistance=resistance, theta=isotropic, material="simplified = true")
    verdict = diagnose(specimen).verdict
    assert [cause.effect.key for cause in verdict.causes] == ["series_resistance"] * (resistance > 0)
    assert verdict.word == ("effect" if resistance else "none")


@pytest.mark.parametrize("resistance", [RESISTANCE, pytest.param(0.0, marks=pytest.mark.slow)])
def test_held_out_band(resistance, tmp_path):
    """No fit sees the band.

    With a resistance the error there falls to the noise once it is named; without one it is at the noise from the
    start.
    """
    specimen = write(tmp_path, "plate", resistance=3 * resistance, more='held_out = ["195 kHz", "215 kHz"]')
    result = diagnose(specimen, effects=[circuits.candidates])
    frequency = result.spectrum.frequency
    assert np.array_equal(result.fitted, (frequency < 195e3) | (frequency > 215e3))
    assert result.comparison.base.data.impedance.size == np.count_nonzero(result.fitted)
    assert [cause.effect.key for cause in result.verdict.causes] == ["series_resistance"] * (resistance > 0)
    gain = result.gain
    assert gain["noise_floor"] == pytest.approx(NOISE, rel=0.01)
    assert gain["held_out_after"] < 1.3 * gain["noise_floor"]
    assert (gain["held_out_before"] > 2 * gain["noise_floor"]) == (resistance > 0)


def test_disk_that_is_larger_all_over_answers_at_lower_frequency(tmp_path):
    """Diameter and thickness both 1 + p times as large: Z'(f) = Z(f (1 + p)) exactly.

    The diameter alone changes Z at low frequency by 1/(1 + p)².
    """
    path = tmp_path / "disk.toml"
    path.write_text(specification("disk", TRUTH).split("[measurement]")[0], encoding="utf-8")
    problem = prepare(read_specimen(path))
    context = effect_context(problem, 1.3e5, 1e3, (50e3, 300e3))
    effects = {effect.name: effect for effect in library(context) if effect.name.startswith("wrong_")}
    assert {"wrong_diameter", "wrong_thickness"} <= set(effects) and "wrong_length" not in effects
    free = problem.free(problem.constants)
    material, p = MaterialParameters.around(free, free.start), 0.01
    chosen = [effects["wrong_diameter"], effects["wrong_thickness"]]
    model = problem.model(300e3, 3e-3)
    extended = extend_model(model, [problem.constants], chosen, 310e3, accuracy=1e-5)
    frequency = np.linspace(50e3, 300e3, 101)
    plain_set = Unknowns(material, material_prior(free, {}, {}))
    both = plain_set.with_candidate(chosen[0]).with_candidate(chosen[1])
    x = np.concatenate([material.x_of(free.start), [p / effect.scale[0] for effect in chosen]])
    large = Evaluation(extended, 2 * np.pi * frequency).impedance(both, x)
    plain = Evaluation(extended, 2 * np.pi * frequency * (1 + p)).impedance(plain_set, x[:6])
    np.testing.assert_allclose(large, plain, rtol=2e-4)
    wide = Evaluation(extended, 2 * np.pi * frequency[:1]).impedance(plain_set.with_candidate(chosen[0]), x[:7])
    rest = Evaluation(extended, 2 * np.pi * frequency[:1]).impedance(plain_set, x[:6])
    assert abs(wide[0] / rest[0]) == pytest.approx(1 / (1 + p) ** 2, rel=5e-3)
