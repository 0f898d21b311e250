"""`import femu_piezo as fp`: a light import, sweeps in memory in place of files, and results that print, draw and
save.
"""

from __future__ import annotations

import copy
import json
import pickle
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import femu_piezo as fp
from femu_piezo.cli import main
from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter
from femu_piezo.measurement.readers import write_spectrum
from femu_piezo.output.tables import deviation_percent, std_percent
from femu_piezo.specimen.file import CONSTANTS, write_specimen
from tests.commands import invoked, succeeded

README = Path(__file__).resolve().parents[1] / "README.md"
RESISTANCE = 3.0
PLATE = """\
name = "plate 07"

[geometry]
shape = "plate"
length = "20 mm"
width = "4 mm"
thickness = "1 mm"
density = "7500 kg/m^3"
poling = "thickness"

[material]
base = "pzt-5h"
""" + "".join(f"tan_{name} = 0.015\n" for name in CONSTANTS)


@pytest.fixture(scope="module")
def specimen(tmp_path_factory) -> fp.Specimen:
    """A plate whose file has no [measurement]."""
    path = tmp_path_factory.mktemp("plate") / "plate.toml"
    path.write_text(PLATE, encoding="utf-8")
    return fp.read_specimen(path)


@pytest.fixture(scope="module")
def sweep(specimen) -> fp.ImpedanceSpectrum:
    """The sweep of a similar plate over two length modes, with leads of 3 Ω and 0.1 % of noise, which is not stated."""
    tangents = {"tan_s11": 0.018, "tan_d31": 0.014, "tan_eps33T": 0.02, "s11": 16.9e-12}
    true = specimen.model_copy(
        update={
            "material": specimen.material.model_copy(update=tangents),
            "effects": {"series_resistance": {"resistance": RESISTANCE}},
        }
    ).model_dump(exclude_none=True, exclude={"path"})
    true["simulation"] = {"start": "30 kHz", "stop": "240 kHz", "points": 211, "noise": 1e-3, "seed": 5}
    true["geometry"]["poling"] = "thickness"
    found = fp.simulate(fp.Specimen.model_validate(true)).spectrum
    return fp.ImpedanceSpectrum.from_impedance(found.frequency, found.impedance)


@pytest.fixture(scope="module")
def updated(specimen, sweep):
    return fp.update(specimen, sweep)


def my_leads(context: EffectContext) -> Effect:
    """A user's own effect: Z + R under a name of its own."""
    return Effect(
        name="my_leads",
        sentence="the leads are mine",
        parameters=(EffectParameter("resistance", "ohm", -1e4, 1e4, 1.0, 0.02 * context.impedance),),
        circuit=lambda omega, z, p: (z + p[0], np.ones_like(z), np.ones((z.size, 1), complex)),
    )


@pytest.fixture(scope="module")
def diagnosed(specimen, sweep):
    return fp.diagnose(specimen, sweep, effects=[my_leads])


def with_file(specimen: fp.Specimen, sweep: fp.ImpedanceSpectrum, folder: Path, name: str = "plate") -> Path:
    """The specimen file, with the sweep in a file next to it."""
    write_spectrum(sweep, folder / f"{name}.csv")
    write_specimen(specimen, folder / f"{name}.toml")
    text = (folder / f"{name}.toml").read_text(encoding="utf-8")
    table = f'[measurement]\nfile = "{name}.csv"\n'
    text = text.replace("[measurement]\n", table) if "[measurement]" in text else text + "\n" + table
    (folder / f"{name}.toml").write_text(text, encoding="utf-8")
    return folder / f"{name}.toml"


# import


def test_import_loads_nothing_and_takes_no_time():
    code = (
        "import sys, time; t = time.perf_counter(); import femu_piezo as fp; names = dir(fp); "
        "print(time.perf_counter() - t, 'numpy' in sys.modules, 'click' in sys.modules, *names)"
    )
    answers = [
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
        for _ in range(3)
    ]
    assert min(float(answer[0]) for answer in answers) < 0.15
    assert answers[0][1:3] == ["False", "False"]
    assert set(answers[0][3:]) == {*fp.__all__, "__version__"}


def test_read_specimens_takes_a_single_path(specimen, sweep, tmp_path):
    path = with_file(specimen, sweep, tmp_path)
    assert [one.name for one in fp.read_specimens(str(path))] == [one.name for one in fp.read_specimens(path)]


def test_names_are_those_of_the_commands():
    # these commands have no result in memory: data sheet, page, lots, instruments
    assert set(main.commands) - {"analyser", "batch", "datasheet", "lots", "measure", "serve"} <= set(dir(fp))
    assert all(getattr(fp, name) is not None for name in fp.__all__)
    with pytest.raises(AttributeError, match="find_modes"):
        _ = fp.find_modes


# sweeps in memory


def test_sweep_of_any_pair_of_columns():
    frequency = np.array([1e3, 2e3, 3e3])
    z = np.array([3 - 4j, 1 - 2j, 2 + 1j])
    y = 1 / z
    spectra = (
        fp.ImpedanceSpectrum.from_impedance(frequency, z),
        fp.ImpedanceSpectrum.from_resistance_reactance(frequency.tolist(), z.real.tolist(), z.imag.tolist()),
        fp.ImpedanceSpectrum.from_magnitude_phase(frequency, np.abs(z), np.degrees(np.angle(z))),
        fp.ImpedanceSpectrum.from_magnitude_phase(frequency, np.abs(z), np.angle(z), degrees=False),
        fp.ImpedanceSpectrum.from_conductance_susceptance(frequency, y.real, y.imag),
    )
    for one in spectra:
        assert np.allclose(one.impedance, z, rtol=1e-14) and np.array_equal(one.frequency, frequency)
    assert repr(spectra[0]) == "ImpedanceSpectrum('sweep', 3 points from 1000 to 3000 Hz)"
    assert "from 1001234 to 3003702 Hz" in repr(fp.ImpedanceSpectrum.from_impedance(1001.234 * frequency, z))


def test_sweep_downwards_is_sorted_and_says_so():
    found = fp.ImpedanceSpectrum.from_impedance([3e3, 2e3, 1e3], [3, 2, 1], relative_noise=[0.3, 0.2, 0.1])
    assert found.frequency.tolist() == [1e3, 2e3, 3e3]
    assert found.impedance.tolist() == [1, 2, 3] and np.allclose(found.noise, [0.1, 0.4, 0.9])
    assert any("sorted" in note for note in found.notes)


def test_arrays_are_checked_as_files_are(specimen, sweep):
    with pytest.raises(fp.InputError, match=r"180°.*correct_phase"):
        fp.update(specimen, replace(sweep, impedance=-sweep.impedance))
    broken = sweep.impedance.copy()
    broken[5] = np.nan
    with pytest.raises(fp.InputError, match="not a number at 1 points"):
        fp.extract(replace(sweep, impedance=broken))
    with pytest.raises(fp.InputError, match="zero"):
        fp.ImpedanceSpectrum.from_conductance_susceptance([1.0, 2.0], [1.0, 0.0], [1.0, 0.0])
    with pytest.raises(fp.InputError, match="shapes"):
        fp.ImpedanceSpectrum.from_impedance([[1.0, 2.0]], [[1.0, 2.0]])


@pytest.mark.parametrize("lengths", [(3, 3, 2), (3, 2, 3), (2, 3, 3), (1, 3, 3)])
def test_columns_of_unequal_lengths_are_told_with_these(lengths):
    f, a, b = (np.arange(1.0, size + 1).tolist() for size in lengths)
    make = fp.ImpedanceSpectrum
    for one, names in (
        (make.from_resistance_reactance, ("resistance_ohm", "reactance_ohm")),
        (make.from_magnitude_phase, ("magnitude_ohm", "phase")),
        (make.from_conductance_susceptance, ("conductance_S", "susceptance_S")),
        (
            lambda f, z, std, **more: make.from_impedance(f, z, relative_noise=std, **more),
            ("impedance_ohm", "relative_n"),
        ),
    ):
        with pytest.raises(
            fp.InputError, match=f"^plate 7: .* frequency_Hz has {lengths[0]}, {names[0]} has {lengths[1]}"
        ):
            one(f, a, b, source="plate 7")
    assert len(make.from_magnitude_phase([1e3, 2e3], 50.0, [1.0, 2.0])) == 2


def test_phases_in_radians_given_as_degrees_are_refused(sweep):
    """With resonances, off them, and with the error of a phase; not those of a resistor with some inductance."""
    z, make = sweep.impedance, fp.ImpedanceSpectrum.from_magnitude_phase
    off = slice(0, 20)
    for part in (slice(None), off):
        with pytest.raises(fp.InputError, match=r"as radians do near π/2 = 1\.571.*degrees = False"):
            make(sweep.frequency[part], np.abs(z[part]), np.angle(z[part]) + 0.01)
        make(sweep.frequency[part], np.abs(z[part]), np.angle(z[part], deg=True))
        make(sweep.frequency[part], np.abs(z[part]), np.angle(z[part]), degrees=False)
    load = 100 + 2j * np.pi * sweep.frequency * 1.7e-6
    assert 1.2 < np.max(np.angle(load, deg=True)) < 1.6
    assert len(make(sweep.frequency, np.abs(load), np.angle(load, deg=True))) == len(sweep)


def test_arrays_in_the_wrong_order_or_of_words_are_refused(sweep):
    make, f, z = fp.ImpedanceSpectrum, sweep.frequency, sweep.impedance
    for wrong, words in (
        (lambda: make.from_impedance(z, f, source="plate 7"), "^plate 7: frequency_Hz is real, and complex"),
        (lambda: make.from_resistance_reactance(f, z, z.imag), "resistance_ohm is real"),
        (lambda: make.from_magnitude_phase(f, z, np.angle(z, deg=True)), "magnitude_ohm is real"),
        (lambda: make.from_impedance(f, z, relative_noise="1 %"), "relative_noise does not hold numbers"),
        (lambda: make.from_impedance(f, ["open"] * f.size), "impedance_ohm does not hold numbers"),
        (lambda: make.from_impedance(f, iter(z)), "impedance_ohm does not hold numbers"),
        (lambda: make.from_magnitude_phase(f, np.abs(z), np.angle(z, deg=True), degrees=False), "more than a turn"),
        (lambda: make.from_magnitude_phase(f, np.angle(z, deg=True), np.abs(z)), "are negative.* exchanged"),
        (lambda: make.from_magnitude_phase(f, np.angle(z), np.abs(z), degrees=False), "are negative.* exchanged"),
        (lambda: make.from_conductance_susceptance(f, 0 * f, 0 * f, source="plate 7"), "plate 7: 211 admittances"),
    ):
        with pytest.raises(fp.InputError, match=words):
            wrong()
    with pytest.raises(fp.InputError, match="no imaginary part at any point"):
        fp.extract(make.from_impedance(f, np.abs(z)))
    with pytest.raises(fp.InputError, match="multiply those of an array by 1000"):
        fp.extract(make.from_impedance(f / 1e3, z))


def test_update_of_a_sweep_in_memory_is_that_of_the_file(specimen, sweep, updated, tmp_path):
    """The same numbers, whether the sweep comes in the file, as a spectrum that was read, or as a path."""
    path = with_file(specimen, sweep, tmp_path)
    read = fp.read_spectrum(tmp_path / "plate.csv")
    for result in (fp.update(path), fp.update(specimen, read), fp.update([specimen], [str(tmp_path / "plate.csv")])):
        assert result.parameters == updated.parameters
        assert np.array_equal(result.outcomes[0].updated_curve, updated.outcomes[0].updated_curve)
        assert result.notes == updated.notes


def test_diagnosis_of_a_sweep_in_memory_is_that_of_the_file(specimen, sweep, diagnosed, tmp_path):
    again = fp.diagnose(with_file(specimen, sweep, tmp_path), effects=[my_leads])
    assert again.rows() == diagnosed.rows() and again.gain == diagnosed.gain
    assert again.parameters == diagnosed.parameters


def test_several_specimens_with_their_sweeps(specimen, sweep, updated):
    other = specimen.model_copy(update={"name": "plate 08"})
    result = fp.update([specimen, other], [sweep, sweep])
    assert len(result.outcomes) == 2 and result.name == "plate 07 + plate 08"
    assert result.parameters["s11"].value == pytest.approx(updated.parameters["s11"].value, rel=2e-3, abs=0)
    with pytest.raises(fp.InputError, match="2 specimens and 1 sweeps"):
        fp.update([specimen, other], sweep)


def test_the_keys_of_measurement_count_for_a_sweep_in_memory(specimen, sweep):
    """Held-out band, noise, accuracy and corrections come from the specimen, wherever the sweep comes from."""
    table = {"held_out": (150e3, 170e3), "noise": 1e-3, "accuracy": 0.02, "correct_phase": True}
    wish = fp.Specimen.model_validate(
        {**specimen.model_dump(exclude_none=True), "measurement": {**table, "held_out": [150e3, 170e3]}}
    )
    turned = replace(sweep, impedance=-sweep.impedance)
    result = fp.update(wish, turned)
    measured = result.outcomes[0].measured
    assert len(measured.fitted) == len(sweep) - np.sum((sweep.frequency >= 150e3) & (sweep.frequency <= 170e3))
    assert np.allclose(measured.spectrum.noise, 1e-3 * np.abs(sweep.impedance))
    assert np.array_equal(measured.spectrum.impedance, sweep.impedance)
    plain = fp.update(specimen, turned, correct_phase=True)
    assert result.parameters["eps33T"].budget["instrument"] > 5 * plain.parameters["eps33T"].budget["instrument"]


def test_faults_are_masked_in_a_sweep_that_was_read_without_masking(specimen, sweep, tmp_path):
    spiked = sweep.impedance.copy()
    spiked[100] *= 1.5
    path = with_file(specimen, replace(sweep, impedance=spiked), tmp_path)
    read = fp.read_spectrum(tmp_path / "plate.csv")
    assert len(read) == len(sweep) and len(read.notes) == 1
    of_file, in_memory = fp.update(path, mask_faults=True), fp.update(specimen, read, mask_faults=True)
    assert len(in_memory.outcomes[0].measured.spectrum) == len(sweep) - 1
    assert in_memory.parameters == of_file.parameters and in_memory.notes == of_file.notes


def test_bands_are_left_out_of_a_file_and_of_a_sweep_in_memory(specimen, sweep, tmp_path):
    """A spike in a masked band of the file has no effect: the result is that of the sweep without those points."""
    spiked = sweep.impedance.copy()
    spiked[100:103] *= 1.5
    low, high = sweep.frequency[[99, 103]]
    path = with_file(specimen, replace(sweep, impedance=spiked), tmp_path)
    path.write_text(path.read_text().replace("[measurement]", f"[measurement]\nmask = [[{low}, {high}]]"))
    keep = (sweep.frequency < low) | (sweep.frequency > high)
    masked, without = fp.update(path), fp.update(specimen, sweep.select(keep))
    assert len(masked.outcomes[0].measured.spectrum) == np.sum(keep) == len(sweep) - 5
    assert masked.parameters["s11"].value == pytest.approx(without.parameters["s11"].value, rel=1e-9, abs=0)
    assert any("left out (mask), 5 points" in note for note in masked.notes)
    fp.read_specimen(path).write(tmp_path / "again.toml")
    assert fp.read_specimen(tmp_path / "again.toml").measurement.mask == ((low, high),)
    run = invoked("extract", tmp_path / "plate.csv", "--mask", low, high, "--out", tmp_path / "out")
    assert run.exit_code == 0 and json.loads((tmp_path / "out/extraction.json").read_text())["points"] == np.sum(keep)
    turned = invoked("extract", tmp_path / "plate.csv", "--mask", high, low, "--out", tmp_path / "turned")
    assert turned.exit_code == 2 and "not a band; give the lower frequency first" in turned.output
    with pytest.raises(fp.InputError, match="not a band"):
        fp.extract(sweep, mask=[(high, low)])
    for band, words in (
        ("[[5.0, 2.0]]", "not a band"),
        ("[[1.0, 1e9]]", "mask leaves 0 of"),
        ("[7.0]", "cannot be used"),
    ):
        path.write_text(re.sub(r"mask = .*", f"mask = {band}", path.read_text()))
        with pytest.raises(fp.InputError, match=words):
            fp.update(path)


def test_arguments_of_wrong_types_are_refused(specimen, sweep, updated, tmp_path):
    found, saved = updated, tmp_path / "sweep.csv"
    fp.write_spectrum(sweep, saved)
    for wrong, words in (
        (lambda: fp.update(specimen), "measurement.file is missing"),
        (lambda: fp.update(specimen, sweep.impedance), "from_impedance"),
        (lambda: fp.extract(None), "not a NoneType"),
        (lambda: fp.update(7, sweep), "a specimen is a Specimen or the path of its file, not a int"),
        (lambda: fp.simulate([specimen, specimen]), "2 specimens are given where one is needed"),
        (lambda: fp.identify(specimen, 2.0), "noise 2 is not"),
        (lambda: fp.identify(specimen, "0.1 %"), 'noise = "0.1 %" is not a number; give one without a unit'),
        (lambda: fp.identify(specimen, plan=50.0), r"plan = 50\.0 is not a whole number"),
        (lambda: fp.identify(specimen, study="20"), 'study = "20" is not a whole number'),
        (lambda: fp.update(specimen, sweep, samples=50.0), r"samples = 50\.0 is not a whole number"),
        (lambda: fp.update(specimen, sweep, effects=3), "effects: 3 is no list of effects"),
        (lambda: fp.diagnose(specimen, sweep, rules={}), "rules are a femu_piezo.diagnosis.rules.Rules, not a dict"),
        (lambda: fp.modes(specimen, count=2.0), r"count = 2\.0 is not a whole number"),
        (lambda: fp.extract(sweep, mask=3), "mask = 3 is no list of bands"),
        (lambda: fp.read_spectrum(saved, columns="f, R, X"), 'columns = "f, R, X" is no list of names'),
        (lambda: fp.read_spectrum(saved, columns=[1, 2, 3]), r"columns = \[1, 2, 3\] is no list of names"),
        (lambda: fp.export(found, "json", density="7500 kg/m^3"), "density = .* is not a number"),
        (lambda: fp.export(found, "json", poling="z"), "a poling direction needs three numbers"),
        (lambda: found.save(None), "a folder is given by its path, not by a NoneType"),
        (lambda: fp.read_specimen(None), "by its path, not by a NoneType"),
        (lambda: fp.write_spectrum(sweep, 3), "by its path, not by a int"),
        (lambda: fp.diagnose(specimen, sweep, effects=["leakage"]), "'leakage' is no effect"),
        (lambda: fp.update(tmp_path / "none.toml", sweep), "no such file"),
        (lambda: fp.circuit(specimen, mask_faults=True), "mask_faults is for a measured sweep"),
        (lambda: fp.circuit(sweep, connection="series"), "connection is for the file of a sweep"),
        (lambda: fp.read_spectrum(sweep), "by its path, not by a ImpedanceSpectrum"),
        (lambda: fp.write_spectrum(tmp_path / "w.csv", sweep), "takes an ImpedanceSpectrum, then a path"),
        (lambda: fp.extract(sweep, mask=(50e3, 60e3)), r"mask: 50000\.0 is no band; give bands as \(low, high\)"),
        (lambda: fp.modes(specimen, band=("50 kHz", "90 kHz")), "band: .* is no band"),
        (lambda: fp.modes(specimen, count=-1), "count = -1 is no number of modes"),
        (lambda: fp.export(specimen, "comsol"), "takes what update returns or the path of an update.json"),
        (lambda: fp.standard_figures(sweep).plot(), "no formula of the body was used"),
        (
            lambda: fp.standard_figures(
                fp.ImpedanceSpectrum.from_impedance(sweep.frequency, 1 / sweep.impedance), specimen
            ),
            "no pole .* was paired with a zero above it .* an admittance is given as an impedance",
        ),
    ):
        with pytest.raises(fp.InputError, match=words):
            wrong()


# results


def test_a_result_prints_as_the_table_of_the_terminal(specimen, sweep, updated, tmp_path):
    run = succeeded("update", with_file(specimen, sweep, tmp_path), "--out", tmp_path / "o")
    assert [line.rstrip() for line in run.output.splitlines()] == repr(updated).splitlines()
    assert len(repr(updated)) < 4000 and "array(" not in repr(updated)
    assert "s11" in updated._repr_html_() and updated._repr_html_().startswith("<pre")


def test_leads_beyond_the_accuracy_of_the_instrument_are_told(updated):
    """3 Ω of leads, which the file does not allow for: the fit strains the phase of the instrument, and says so."""
    (note,) = (note for note in updated.notes if "accuracy of instrument and fixture" in note)
    assert re.search(r"phase near \d+ Hz [+-]\d+ σ", note) and "femu-piezo diagnose" in note


def test_results_are_copied(specimen, updated, diagnosed):
    """And those without functions of effects are pickled."""
    for result in (updated, diagnosed):
        assert copy.deepcopy(result).rows() == result.rows()
    modes = fp.modes(specimen, count=1)
    assert pickle.loads(pickle.dumps(modes)).rows() == modes.rows()


def test_a_loss_of_zero_has_no_sign(specimen):
    lossless = {**specimen.model_dump(exclude_none=True, exclude={"path"}), "material": {"base": "pzt-5h"}}
    lossless |= {
        "simulation": {"start": 30e3, "stop": 240e3, "points": 211},
        "effects": {"series_resistance": {"resistance": RESISTANCE}},
    }
    told = repr(fp.simulate(fp.Specimen.model_validate(lossless)))
    assert "loss 0.000000" in told and "loss -" not in told


def test_every_result_is_short_drawn_and_tabulated(specimen, sweep, updated, diagnosed):
    results = [fp.extract(sweep), updated, diagnosed, fp.simulate(specimen), fp.identify(specimen, recommend=False)]
    for result in results:
        assert 50 < len(repr(result)) < 8000
        assert "array(" not in repr(result) and "<femu" not in repr(result)
        figure = result.plot()
        assert isinstance(figure, Figure) and figure._repr_png_().startswith(b"\x89PNG")
        assert len(result.to_dataframe()) == len(result.rows()) > 0


def test_the_parts_of_a_result_are_short(specimen, sweep, updated, diagnosed):
    """In a session, an array is shown where it is asked for, not with everything that holds it."""
    found = fp.extract(sweep)
    parts = (*updated.outcomes, *diagnosed.sweeps, diagnosed.comparison, updated.known, *found.pairs, *found.orders)
    for part in (
        updated.fit,
        diagnosed.comparison.averaged,
        *fp.identify(specimen, recommend=False).sensitivities,
        *parts,
    ):
        assert len(repr(part)) < 10_000 and repr(part).count("array(") < 4
    assert re.fullmatch(r"Resonance\('pole', [\d.]+ Hz, loss 0\.\d+\)", repr(found.resonances.poles[0]))


def test_an_extraction_is_printed_and_drawn_to_the_digits_of_its_deviations(sweep, tmp_path):
    fp.write_spectrum(sweep, tmp_path / "plate.csv")
    found = fp.extract(tmp_path / "plate.csv")
    assert re.match(r"pole +\d{5}\.\d\d ± 0\.\d\d Hz   loss 0\.0\d+ ± 0\.00000\d\d ", repr(found))
    figure = found.plot()
    assert figure.get_suptitle().startswith("plate.csv: poles and zeros")
    assert "e-0" not in "".join(text.get_text() for axes in figure.axes for text in axes.texts)
    orders = next(axes for axes in figure.axes if axes.get_ylabel().startswith("model order"))
    assert np.array_equal(orders.get_yticks(), np.round(orders.get_yticks()))


def test_large_deviations_are_without_a_power_of_ten():
    told = [deviation_percent(share) for share in (None, 1e-9, -0.0123, 0.5, 1.8, -39.0)]
    assert told == ["", "0 %", "-1.2 %", "+50 %", "+180 %", "-3900 %"]
    assert [std_percent(share) for share in (0.0123, 0.5, 1.3, 20.0)] == ["1.2 %", "50 %", "130 %", "> 1000 %"]


def test_numbers_of_an_update(updated):
    s11 = updated.parameters["s11"]
    assert abs(s11.value - 16.9e-12) < 4 * s11.std and s11.tan_std > 0
    assert np.isclose(np.sqrt(sum(part**2 for part in s11.budget.values())), s11.std, rtol=0.05)
    table = updated.to_dataframe()
    assert list(table.index) == ["s11", "d31", "eps33T"]
    assert table.loc["s11", "value"] == s11.value and table.loc["d31", "tan"] == updated.parameters["d31"].tan
    assert table.loc["s11", "budget_density"] == s11.budget["density"]


def test_without_pandas_one_sentence_says_what_to_install(updated, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r"needs pandas.*femu-piezo\[notebook\].*rows\(\)"):
        updated.to_dataframe()


def test_verdict_and_causes(diagnosed):
    assert diagnosed.verdict == "effect" and str(diagnosed.verdict) == diagnosed.verdict.word == "effect"
    assert diagnosed.verdict != "none" and repr(diagnosed.verdict) == "Verdict('effect': my_leads)"
    (cause,) = diagnosed.causes
    found = cause.parameters["resistance"]
    assert str(cause) == "my_leads" and found.unit == "ohm"
    assert abs(found.value - RESISTANCE) < 4 * found.std < 1.0
    for name, truth in (("s11", 0.018), ("d31", 0.014), ("eps33T", 0.02)):
        after = diagnosed.parameters[name]
        assert abs(after.tan - truth) < 4 * after.tan_std
    assert diagnosed.parameters_before["s11"].tan != diagnosed.parameters["s11"].tan


def test_extended_specimen_is_written_and_read(diagnosed, sweep, tmp_path):
    """`extended` itself has no sweep; saved with a result it has the sweep from memory, and its diagnosis finds
    nothing more.
    """
    diagnosed.extended.write(tmp_path / "extended.toml")
    alone = fp.read_specimen(tmp_path / "extended.toml")
    assert alone.effects["my_leads"]["resistance"] == diagnosed.causes[0].parameters["resistance"].value
    assert alone.measurement.file is None
    assert fp.update(alone, sweep, effects=[my_leads]).outcomes[0].rms_after < 1.2e-3
    saved = diagnosed.save(tmp_path / "saved")
    assert {path.name for path in saved.iterdir()} == {
        "curves.csv",
        "diagnosis.json",
        "diagnosis.png",
        "extended.toml",
        "measured.csv",
    }
    assert fp.update(saved / "extended.toml", effects=[my_leads]).outcomes[0].rms_after < 1.2e-3
    simulated = fp.simulate(saved / "extended.toml", effects=[my_leads])
    assert simulated.effects == ("my_leads",)
    with pytest.raises(fp.InputError, match=r"effects\.my_leads is no effect"):
        fp.simulate(saved / "extended.toml")


def records(folder: Path) -> dict[str, bytes | dict]:
    """The files of a folder; JSON without times."""
    found: dict[str, bytes | dict] = {}
    for path in sorted(folder.iterdir()):
        found[path.name] = path.read_bytes()
        if path.suffix == ".json":
            found[path.name] = {k: v for k, v in json.loads(path.read_bytes()).items() if k != "seconds"}
    return found


@pytest.mark.parametrize("command", ["simulate", "extract", "update", pytest.param("identify", marks=pytest.mark.slow)])
def test_save_writes_what_the_command_writes(command, specimen, sweep, tmp_path):
    path = with_file(specimen, sweep, tmp_path)
    given = tmp_path / "plate.csv" if command == "extract" else path
    succeeded(command, given, "--out", tmp_path / "command")
    folder = getattr(fp, command)(given).save(tmp_path / "new" / "saved")
    assert records(folder) == records(tmp_path / "command") and len(records(folder)) >= 2


def test_save_of_a_diagnosis_writes_what_the_command_writes(specimen, sweep, tmp_path, monkeypatch):
    """With few candidates, which the command line has no option for."""
    monkeypatch.setattr("femu_piezo.study.subjects.library", _few)
    path = with_file(specimen, sweep, tmp_path)
    succeeded("diagnose", path, "--out", tmp_path / "command", "--report")
    folder = fp.diagnose(path).save(tmp_path / "saved", report=True)
    one, other = records(folder), records(tmp_path / "command")
    assert set(one) == {"curves.csv", "diagnosis.json", "diagnosis.png", "extended.toml", "report.html"}
    lines = (folder / "curves.csv").read_text().splitlines()
    assert len(lines) == len(sweep) + 1 and lines[0].startswith("frequency_Hz,measured_resistance_ohm")
    assert one["diagnosis.json"]["answers"]["headline"] and one["diagnosis.json"]["answers"]["sure"]
    assert one.pop("report.html") and other.pop("report.html")  # which holds the time
    assert one == other


def _few(context: EffectContext) -> tuple[Effect, ...]:
    return tuple(e for make in fp.effects.library for e in make(context) if e.circuit is not None or e.has_tolerance)


def test_modes_are_saved_and_drawn(specimen, tmp_path):
    result = fp.modes(specimen, count=1)
    assert result.rows()[0]["family"] == "first length extension" and repr(result).startswith("pole")
    assert {path.name for path in result.save(tmp_path / "m").iterdir()} == {"modes.json", "modes.png", "mode_01.png"}


# effects written by users


def test_library_is_a_list_of_makers():
    library = fp.effects.library
    assert len(library) == len([*library]) > 10
    assert library[0] is next(iter(library)) and all(callable(make) for make in library)


def test_a_users_effect_is_a_candidate_beside_the_tolerances(specimen, sweep, diagnosed):
    """As a function or as an effect; dimensions, held constants and instrument stay unknown within their tolerances."""
    keys = [effect.key for effect in diagnosed.comparison.final.parameters.effects]
    assert {"my_leads", "wrong_length", "wrong_density", "series_resistance", "wrong_insensitive_parameter:s12"} <= {
        *keys
    }
    assert [trial.effect.key for trial in diagnosed.comparison.singles] == ["my_leads"]
    made = my_leads(EffectContext(80e3, (), None, {}, 7500.0, 1e-3, impedance=1e3))
    again = fp.diagnose(specimen, sweep, effects=[made, lambda context: None, lambda context: ()])
    assert str(again.causes[0]) == "my_leads"


def test_mistakes_in_a_users_effect_are_told_in_one_sentence(specimen, sweep):
    def with_circuit(circuit):
        return lambda context: replace(my_leads(context), circuit=circuit)

    def needs_two(context, more):
        return my_leads(context)

    z_alone = with_circuit(lambda omega, z, p: z + p[0])
    flat = with_circuit(lambda omega, z, p: (z + p[0], np.ones_like(z), np.ones(z.size, complex)))

    def broken(omega, z, p):
        return z + p[0], np.ones_like(z), np.where(omega[:, None] == omega[3], np.nan, 1.0 + 0j)

    empty = with_circuit(lambda omega, z, p: (np.full(z.shape, np.nan), np.ones_like(z), np.ones((z.size, 1), complex)))
    for effects, words in (
        ([empty], "effect my_leads: Z' of its circuit is not a finite number at resistance = .* ohm; it has to be one"),
        ([with_circuit(broken)], "effect my_leads: ∂Z'/∂p of its circuit is not a finite number"),
        ([needs_two], "needs_two must take one argument, an EffectContext"),
        ([Effect], "Effect must take one argument"),
        ([lambda context: ["leads"]], "returns 'leads', which is no Effect"),
        ([z_alone], r"effect my_leads: its circuit returns shapes \(\d+,\); needed are Z'"),
        ([flat], r"shapes \[\((\d+),\), \(\1,\), \(\1,\)\]; needed are .* \(\1, 1\)\]"),
    ):
        with pytest.raises(fp.InputError, match=words):
            fp.diagnose(specimen, sweep, effects=effects)
    with pytest.raises(fp.InputError, match="parameter resistance of an effect: rest = 0 is not between low = 10000"):
        EffectParameter("resistance", "ohm", 1e4, -1e4, 1.0, 1.0)
    with pytest.raises(fp.InputError, match="scale = 0 is not above zero"):
        EffectParameter("resistance", "ohm", -1e4, 1e4, 0.0, 1.0)


def test_a_single_effect_stands_for_a_list_of_it(specimen, sweep, diagnosed):
    assert str(fp.diagnose(specimen, sweep, effects=my_leads).verdict) == str(diagnosed.verdict)


def test_corrections_of_a_sweep_reach_the_diagnosis_from_the_command_line(specimen, sweep, tmp_path, monkeypatch):
    asked = {}

    def stop(specimens, *_, **options):
        asked.update(specimens[0].measurement.model_dump())
        raise fp.InputError("seen")

    monkeypatch.setattr("femu_piezo.study.diagnose.diagnose", stop)
    path = with_file(specimen, sweep, tmp_path)
    run = invoked("diagnose", path, "--out", tmp_path / "o", "--correct-phase", "--mask-faults")
    assert run.exit_code == 2 and "seen" in run.output
    assert asked["correct_phase"] and asked["mask_faults"] and not (tmp_path / "o").exists()


# the session of README.md


def test_the_notebook_session_of_the_readme_runs(sweep, tmp_path, monkeypatch):
    code = re.search(r"## In Python\n.*?```python\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.S)[1]
    lines = [line for line in code.splitlines() if line and not line.startswith("import")]
    assert len(lines) <= 10
    columns = np.array([sweep.frequency, np.abs(sweep.impedance), np.degrees(np.angle(sweep.impedance))]).T
    np.savetxt(tmp_path / "analyser.txt", columns)
    (tmp_path / "plate.toml").write_text(PLATE, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    exec(compile(code, str(README), "exec"), names)
    assert abs(names["s11"].value - 16.9e-12) < 4 * names["s11"].std
    diagnosis = names["diagnosis"]
    assert diagnosis.verdict == "effect" and "series_resistance" in map(str, diagnosis.causes)
    assert (tmp_path / "out/diagnosis/extended.toml").is_file() and (tmp_path / "out/diagnosis/report.html").is_file()
