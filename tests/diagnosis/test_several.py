"""Two bars of one material and different size, their sweeps by an independent solver: causes that one bar cannot
tell from a constant.
"""

from __future__ import annotations

import json

import numpy as np
import pytest
from hidden_effects.ritz import RitzPlate

from diagnosis.conftest import DENSITY, ReducedBody
from femu_piezo.diagnosis.rules import Rules
from femu_piezo.diagnosis.selection import compare
from femu_piezo.diagnosis.verdict import judge
from femu_piezo.effects.effect import EffectContext
from femu_piezo.effects.extended_model import extend_model
from femu_piezo.effects.library import library
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.shapes import Plate
from femu_piezo.inference.ensemble import Ensemble, Share, is_common, with_owner
from femu_piezo.inference.fit import fit
from femu_piezo.inference.response import Evaluation
from femu_piezo.measurement.readers import write_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.measurement.sweeps import SweepData
from tests.commands import invoked, succeeded
from tests.noise import noisy
from tests.specimens import material, plate

NOISE = 1e-3
#: Length, width, thickness (m), fundamental (Hz) and band (Hz), which holds the first length mode alone.
BARS = {
    "long": ((12e-3, 2.5e-3, 1e-3), 117e3, (20e3, 165e3)),
    "short": ((7e-3, 2e-3, 0.8e-3), 201e3, (30e3, 280e3)),
}
OF_EACH_BAR = ("wrong_length", "wrong_thickness", "electrode_mass")
COMMON = ("stray_capacitance", "series_resistance", "leakage")


class Bars(ReducedBody):
    """Reduced models of both bars and their libraries of effects."""

    def __init__(self) -> None:
        super().__init__("s11", "d31", "eps33T")
        constants, free = self.constants, self.free
        training = [constants, *free.training_sets(free.start, 0.04, 3)[1:]]
        self.parts, self.library, self.frequency = {}, {}, {}
        for name, (size, fundamental, band) in BARS.items():
            axes = {"length": (0,), "width": (1,), "thickness": (2,)}
            context = EffectContext(fundamental, free.names, constants, axes, DENSITY, size[2], 2e3)
            effects = [effect for effect in library(context) if effect.name in (*OF_EACH_BAR, *COMMON)]
            self.frequency[name] = np.linspace(*band, 70)
            model = ElectroelasticModel(Plate(*size).domain((14, 3, 2)), DENSITY)
            extended = extend_model(model, training, effects, band[1], accuracy=1e-5)
            self.parts[name] = Evaluation(extended, 2 * np.pi * self.frequency[name])
            self.library[name] = effects

    def sweep(self, name: str, stretch: float = 0.0, stray: float = 0.0) -> np.ndarray:
        """Noisy Z of a bar (1 + `stretch`) times as long with a capacitance `stray` (F) parallel to it."""
        size, frequency = np.array(BARS[name][0]), self.frequency[name]
        size[0] *= 1 + stretch
        z = RitzPlate(size, DENSITY, (11, 5, 4)).impedance(self.theta, frequency)
        z = 1 / (1 / z + 2j * np.pi * frequency * stray)
        return noisy(z, NOISE, len(name))

    def judged(self, sweeps: dict[str, np.ndarray]):
        """Comparison and verdict of the given sweeps, of one bar or of both."""
        names = list(sweeps)
        impedance = np.concatenate(list(sweeps.values()))
        frequency = np.concatenate([self.frequency[name] for name in names])
        sizes = tuple(z.size for z in sweeps.values())
        data = SweepData(frequency, impedance, np.full(impedance.size, NOISE), True, sizes)
        evaluation, effects = self.parts[names[0]], self.library[names[0]]
        if len(names) > 1:
            evaluation = Ensemble(tuple((Share((name,)), self.parts[name]) for name in names))
            effects = [effect for effect in effects if is_common(effect)]
            effects += [with_owner(e, name) for name in names for e in self.library[name] if not is_common(e)]
        start = self.x * 1.01
        result = compare(evaluation, data, self.unknowns, start, effects, rules=Rules(most_causes=2))
        return result, judge(result)


@pytest.fixture(scope="module")
def bars() -> Bars:
    return Bars()


def test_stray_capacitance_is_told_from_the_permittivity_by_two_bars(bars):
    """With one bar ε33T hides the capacitance, with two it is named and ε33T is right."""
    stray = 8e-12
    _, alone = bars.judged({"long": bars.sweep("long", stray=stray)})
    assert alone.word == "none"
    assert {effect.key: constant for effect, constant in alone.hidden}["stray_capacitance"] == "eps33T"
    result, both = bars.judged({name: bars.sweep(name, stray=stray) for name in BARS})
    assert both.word == "effect"
    (cause,) = both.causes
    assert cause.effect.key == "stray_capacitance"
    assert cause.indistinguishable_from == ()
    assert abs(cause.values[0] - stray) < 3 * cause.std[0] < stray
    eps = result.final.x[4]
    assert eps == pytest.approx(1.0, abs=4 * result.final.std[4])


def test_wrong_length_is_told_from_the_compliance_by_two_bars(bars):
    """With one bar the verdict is none, and s11 hides the error of the length.

    With two, a wrong length is named; which of the two bars has it stays open, with opposite signs.
    """
    stretch = 0.01
    _, alone = bars.judged({"long": bars.sweep("long", stretch=stretch)})
    assert alone.word == "none"
    assert {effect.key: constant for effect, constant in alone.hidden}["wrong_length"] == "s11"
    result, both = bars.judged({"long": bars.sweep("long", stretch=stretch), "short": bars.sweep("short")})
    assert both.word == "effect"
    (cause,) = both.causes
    names = {cause.effect.key, *cause.indistinguishable_from}
    assert names == {"wrong_length (long)", "wrong_length (short)"}
    sizes = {trial.effect.key: trial.values[0] for trial in result.causes[0].fits}
    assert sizes["wrong_length (long)"] == pytest.approx(stretch, rel=0.1)
    assert sizes["wrong_length (short)"] == pytest.approx(-stretch, rel=0.1)


def test_two_right_bars_have_no_cause(bars):
    assert bars.judged({name: bars.sweep(name) for name in BARS})[1].word == "none"


def test_jacobian_of_several_sweeps(bars):
    """Unknowns of one bar change its own sweep alone, common unknowns change both; slopes against differences."""
    names = ("wrong_length", "stray_capacitance")
    length, stray = (next(e for e in bars.library["long"] if e.name == name) for name in names)
    ensemble = Ensemble(tuple((Share((name,)), part) for name, part in bars.parts.items()))
    parameters = bars.unknowns.with_candidate(with_owner(length, "short")).with_candidate(stray)
    x = np.concatenate([bars.x, [0.7, 0.4, 2.0]])  # the loss tangent of the stray capacitance is the last one
    z, slopes = ensemble.with_jacobian(parameters, x)
    points = bars.frequency["long"].size
    assert np.all(slopes[:points, 6] == 0) and np.all(slopes[points:, 6] != 0)
    for column in range(x.size):
        step = np.zeros(x.size)
        step[column] = 1e-4
        numeric = (ensemble.impedance(parameters, x + step) - ensemble.impedance(parameters, x - step)) / 2e-4
        assert np.max(np.abs((slopes[:, column] - numeric) / z)) < 1e-4 * np.max(np.abs(slopes[:, column] / z))
    of_long, columns = Share(("long",)).of(parameters)
    assert [effect.name for effect in of_long.effects] == ["stray_capacitance"]
    assert columns.tolist() == [0, 1, 2, 3, 4, 5, 7, 8]


def test_left_out_bands_are_those_of_each_sweep(bars):
    """A band of the short bar as predicted by a fit to the rest of its sweep and the whole sweep of the long bar."""
    z = np.concatenate([bars.sweep(name) for name in BARS])
    frequency = np.concatenate(list(bars.frequency.values()))
    points = bars.frequency["long"].size
    data = SweepData(frequency, z, np.full(z.size, NOISE), True, (points, z.size - points))
    start = bars.x
    ensemble = Ensemble(tuple((Share((name,)), part) for name, part in bars.parts.items()))
    predicted = fit(ensemble, data, bars.unknowns, [start]).held_out.predicted
    band = np.array_split(np.arange(points, z.size), 10)[3]
    kept = np.setdiff1d(np.arange(z.size), band)
    rest = np.delete(bars.parts["short"].omega, band - points)
    short = Evaluation(bars.parts["short"].model, rest)
    seen = Ensemble(((Share(("long",)), bars.parts["long"]), (Share(("short",)), short)))
    refit = fit(seen, data.select(kept), bars.unknowns, [start])
    residual = data.whitened(*ensemble.with_jacobian(bars.unknowns, refit.x))[0]
    unseen = residual[band] + 1j * residual[band + z.size]
    assert np.max(np.abs(unseen - predicted[band])) < 0.1


def write_study(bars, folder, **hidden: float):
    """Specimen files, sweeps and the study file of both bars; `hidden` as for `Bars.sweep`."""
    for name, (size, *_) in BARS.items():
        spectrum = ImpedanceSpectrum(bars.frequency[name], bars.sweep(name, **hidden))
        write_spectrum(spectrum, folder / f"{name}.csv")
        text = plate(name, size, DENSITY, 'poling = "thickness"') + material(bars.constants, bars.free.names)
        text += f'[measurement]\nfile = "{name}.csv"\nnoise = {NOISE}\n[update]\nnoise_only = true\n'
        (folder / f"{name}.toml").write_text(text)
    (folder / "study.toml").write_text('specimens = ["long.toml", "short.toml"]\n')
    return folder / "study.toml"


def test_command_on_a_study_file(bars, tmp_path):
    """One cause common to both bars is named; an update of the extended study file then gives the right ε33T."""
    stray = 8e-12
    succeeded("diagnose", write_study(bars, tmp_path, stray=stray), "--out", tmp_path / "a")
    record = json.loads((tmp_path / "a/diagnosis.json").read_text(encoding="utf-8"))
    assert record["specimens"] == ["long", "short"]
    (cause,) = record["causes"]
    named = {cause["effect"], *cause["indistinguishable_from"]}
    assert cause["effect"] in ("stray_capacitance", "cable") and cause["specimen"] is None
    assert {"stray_capacitance", "cable"} <= named and "eps33T" not in named
    parameters = {name: one["value"] for name, one in cause["parameters"].items()}
    if cause["effect"] == "cable":  # a cable of some centimetres acts as its capacitance alone
        parameters["capacitance"] = parameters["length"] / (0.66 * 299792458.0 * parameters["wave_impedance"])
    assert parameters["capacitance"] == pytest.approx(stray, rel=0.05, abs=0)
    assert sum(item["effect"] == "wrong_length" for item in record["candidates"]) == 2  # a candidate for each specimen
    assert (tmp_path / "a/diagnosis_2.png").stat().st_size > 20000
    succeeded("update", tmp_path / "a/extended.toml", "--out", tmp_path / "b")
    updated = json.loads((tmp_path / "b/update.json").read_text(encoding="utf-8"))["parameters"]
    assert updated["eps33T"]["value"] == pytest.approx(bars.theta[9].real, rel=2e-3)
    for name, after in record["parameters"]["after"].items():  # the capacitance stays one unknown common to both bars
        assert updated[name]["std"] == pytest.approx(after["std"], rel=1e-3, abs=0), name
        assert updated[name]["tan_std"] == pytest.approx(after["tan_std"], rel=1e-3), name


def test_specimens_of_one_name_are_refused(bars, tmp_path):
    study = write_study(bars, tmp_path)
    study.write_text('specimens = ["long.toml", "long.toml"]\n')
    answer = invoked("diagnose", study, "--out", tmp_path / "out")
    assert answer.exit_code == 2
    assert "two specimens are named 'long'" in answer.output and answer.output.strip().count("\n") == 0


def test_measurements_recommended_for_one_bar(bars, tmp_path):
    """A second bar, the open fixture and a micrometer, each with the separation that the model expects of it."""
    write_study(bars, tmp_path, stray=8e-12)
    succeeded("diagnose", tmp_path / "long.toml", "--out", tmp_path / "out")
    record = json.loads((tmp_path / "out/diagnosis.json").read_text(encoding="utf-8"))
    assert record["verdict"] == "none"
    found = {(one["cause"], one["measurement"]): one for one in record["separations"]}
    for cause in ("stray_capacitance", "wrong_length"):
        second = found[cause, "measure a second specimen of the same material with half the length"]
        assert second["expected"] > 10 * second["now"]
    reading = found["stray_capacitance", "measure the open fixture without the specimen, to 0.05 pF"]
    typical = next(c for c in record["candidates"] if c["effect"] == "stray_capacitance")["parameters"]["capacitance"]
    assert reading["expected"] > 100 and typical["std"] > 10 * 5e-14
    micrometer = found["wrong_length", "measure the length of long with a micrometer, to 0.1 %"]
    assert micrometer["expected"] == pytest.approx(20.0, rel=0.1)  # an error of 2 %, the usual one, over 0.1 %
    first = record["recommended_measurements"][0]
    assert first.startswith("measure a second specimen of the same material with half the length: expected to dist")
