"""`femu-piezo measure` against a simulated analyser: faults, kills, limits, and the end of a measurement."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import click
import numpy as np
import pytest

from femu_piezo.batch.jobs import file_checksum
from femu_piezo.cli import main
from femu_piezo.errors import InputError
from femu_piezo.instruments.analyser import Settings, usual_drive
from femu_piezo.instruments.measure import PointFile, _refuse_another, _with_sweep, measure
from femu_piezo.measurement.readers import read_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.specimen.file import Limits, read_specimen, write_specimen
from femu_piezo.store.database import Database
from femu_piezo.store.entry import entry_of_result
from femu_piezo.store.read import read_pieces
from femu_piezo.study.adaptive import Wish
from femu_piezo.study.planning import OPPOSITE, THIRD
from instruments.conftest import PLATE, analyser
from tests.commands import invoked, succeeded

COMMON = ("--points", "64", "--speed", "1", "--timeout", "1")


@pytest.fixture(scope="module")
def specimen(tmp_path_factory) -> Path:
    """The specimen file of the user, which does not mention the series resistance."""
    path = tmp_path_factory.mktemp("measure") / "plate.toml"
    path.write_text(PLATE.split("[effects")[0], encoding="utf-8")
    return path


def run(specimen: Path, address: str, out: Path, *options: str):
    return invoked("measure", specimen, "--instrument", address, "--out", out, *COMMON, *options)


def points(out: Path) -> np.ndarray:
    """Frequencies of the complete rows of points.csv, Hz."""
    whole = (out / "points.csv").read_text(encoding="utf-8").rpartition("\n")[0].splitlines()[1:]
    return np.array([float(row.partition(",")[0]) for row in whole])


def test_every_fault_keeps_the_points_and_the_same_command_goes_on(plate, specimen, tmp_path):
    """Sweep 1 is sound and sweeps 2 … 6 fail; each run resumes from the existing points, and the last one finishes.

    A measurement of 128 points begins with 64 that cover the band, in two sweeps.
    """
    wish = ("--points", "128", "--deviation", "s11", "5 %")
    faults = ("error@2", "half@3", "timeout@4", "overload@5", "unplugged@6")
    out = tmp_path / "out"
    with analyser(plate, *(word for fault in faults for word in ("--fail", fault))) as running:
        before = np.zeros(0)
        for _ in faults:
            failed = run(specimen, running.address, out, *wish)
            assert failed.exit_code == 4 and "Traceback" not in failed.output
            told = failed.stderr.strip().splitlines()
            assert len(told) == 1 and told[0].startswith("femu-piezo: ") and "goes on from there" in told[0]
            assert running.is_off()
            assert points(out).size == 32 and np.array_equal(points(out)[: before.size], before)
            before = points(out)
        done = run(specimen, running.address, out, *wish, "--lot", "may", "--store")
        assert done.exit_code == 0, done.output
        assert running.is_off() and running.largest_voltage() == 0.5
    assert "32 points are in" in done.output and "the requested deviations are reached" in done.output
    sweep = read_spectrum(out / "sweep.csv")
    assert np.all(np.isin(before, sweep.frequency)) and len(sweep) == 64
    record = json.loads((out / "measure.json").read_text())
    assert record["ended"] == "deviations" and record["points"] == len(sweep) and "E4990A" in record["instrument"]
    assert {"live.png", "update.json", "impedance.png", "measured.toml", "piece.toml"} <= {
        path.name for path in out.iterdir()
    }
    found = json.loads((out / "update.json").read_text())["parameters"]["s11"]
    assert abs(found["value"] - 16.5e-12) < 4 * found["std"]
    assert read_specimen(out / "measured.toml").measurement.file == out / "sweep.csv"
    (piece,) = read_pieces(Database("sqlite", out, make=False))
    assert (piece["lot"], piece["specimen"], piece["sweep"]) == ("may", "plate 07", file_checksum(out / "sweep.csv"))
    assert piece["s11"] == found["value"] and piece["s11_std"] == found["std"]


def started(specimen: Path, address: str, out: Path, until: int) -> subprocess.Popen:
    """A process that runs `measure`, returned once it has written so many points."""
    command = ["measure", str(specimen), "--instrument", address, "--out", str(out), "--points", "400", "--speed", "1"]
    process = subprocess.Popen(
        [sys.executable, "-m", "femu_piezo.cli", *command],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "FEMU_PIEZO_STEPS": "1"},
    )
    for _ in range(600):
        if (out / "points.csv").exists() and points(out).size >= until:
            return process
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.05)
    raise AssertionError("no points")


def test_interrupted_and_killed_runs_go_on(bench, specimen, tmp_path):
    """Ctrl-C switches the output off, SIGKILL cannot; neither loses a point, and the next run counts the existing
    ones.
    """
    out = tmp_path / "out"
    process = started(specimen, bench.address, out, 32)
    process.send_signal(signal.SIGINT)
    told = process.communicate(timeout=30)[1]
    assert process.returncode == 130 and told.strip().endswith("femu-piezo: interrupted") and bench.is_off()
    first = points(out)
    process = started(specimen, bench.address, out, first.size + 32)
    process.kill()
    process.communicate()
    second = points(out)
    assert np.array_equal(second[: first.size], first) and second.size > first.size
    with open(out / "points.csv", "a", encoding="utf-8") as stream:
        stream.write("123456.7,12.3,-4")  # an incomplete row, as after a crash of the machine
    (out / "live.png").unlink(missing_ok=True)
    (out / "live.png").mkdir()  # a picture that cannot be written does not stop the measurement
    done = run(specimen, bench.address, out, "--points", str(second.size))
    assert done.exit_code == 0, done.output
    assert "live.png" in done.output and "measuring goes on without the picture" in done.output
    sweep = read_spectrum(out / "sweep.csv")
    assert np.all(np.isin(second, sweep.frequency)) and 123456.7 not in sweep.frequency
    assert bench.is_off() and bench.largest_voltage() <= 0.6


def test_a_folder_belongs_to_one_measurement_at_a_time(bench, specimen, tmp_path):
    out = tmp_path / "out"
    process = started(specimen, bench.address, out, 32)
    second = run(specimen, "TCPIP::127.0.0.1::1::SOCKET", out)  # refused before anything is sent to the instrument
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=30)
    assert second.exit_code == 2 and second.stderr.strip().count("\n") == 0
    assert f"{out}: another run writes to this folder" in second.stderr and not (out / ".lock").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--voltage", "0.7 V"), "above limits.voltage = 0.6 V"),
        (("--bias", "1 V"), "above the 0 V that limits.bias"),
        (("--band", "60 kHz", "200 kHz"), "limits.frequency"),
        (("--deviation", "s33", "1 %"), "a deviation is requested of s33, which is not free"),
        (("--deviation", "s11", "1 m"), "--deviation"),
        (("--data", "x.csv"), "--data goes with --plan"),
        (("--separate", "--band", "9 kHz", "8 kHz"), "no band"),
    ],
)
def test_impossible_wishes_exit_with_2(bench, specimen, tmp_path, options, words):
    before = len(bench.commands())
    failed = run(specimen, bench.address, tmp_path / "out", *options)
    assert failed.exit_code == 2 and words in failed.output and "Traceback" not in failed.output
    assert not (tmp_path / "out").exists()
    assert ":TRIG:SING" not in bench.commands()[before:] and bench.largest_voltage() <= 0.6


def test_the_sweeps_that_the_diagnosis_recommends_are_taken(bench, specimen, tmp_path, monkeypatch):
    """Sweeps up, down and at a third of the voltage, at the frequencies of the first, are diagnosed together.

    The kept update is that of `update measured.toml`, the kept diagnosis is the last one.
    """
    asked, kept = [], []

    def diagnose(wanted, **_):
        asked.append(wanted)
        words = (f"{OPPOSITE}: expected to distinguish a drift from a wrong width by 12 σ", f"{THIRD}: more")
        return SimpleNamespace(verdict=SimpleNamespace(measurements=words), save=lambda folder: folder.mkdir())

    monkeypatch.setattr("femu_piezo.api.diagnose", diagnose)
    before = len(bench.commands())
    result = measure(
        read_specimen(specimen),
        bench.address,
        tmp_path,
        Wish(points=32),
        Settings(voltage=0.3, speed=1),
        diagnose=True,
        keep=lambda specimens, result: kept.append((specimens, result)),
    )
    first, several = asked
    assert first.measurement.file == tmp_path / "sweep.csv" and (tmp_path / "diagnosis").is_dir()
    taken = [(one.label, one.direction, one.drive_voltage) for one in several.sweep]
    assert taken == [("up", "up", 0.3), ("down", "down", 0.3), ("third", "up", pytest.approx(0.1))]
    for one in several.sweep:
        found = read_spectrum(one.file)
        assert np.array_equal(np.round(found.frequency, 3), np.round(result.adapted.spectrum.frequency, 3))
    assert read_specimen(tmp_path / "several.toml").sweep == several.sweep
    assert kept == [([first], result.updated), ([several], result.diagnosed)]
    again = entry_of_result([read_specimen(tmp_path / "measured.toml")], result.updated)
    assert entry_of_result(*kept[0]).key == again.key
    own = bench.commands()[before:]
    assert [line.split()[1] for line in own if line.startswith(":SENS1:SWE:DIR")][-3:] == ["UP", "DOWN", "UP"]
    assert bench.is_off() and bench.largest_voltage() <= 0.6


def test_an_impossible_store_is_refused_before_anything_is_measured(bench, specimen, tmp_path):
    before = len(bench.commands())
    for options, words in (
        (("--store", str(specimen)), "this is no address of a store"),
        (("--store", str(tmp_path / "none" / "line.sqlite")), "there is no such folder"),
        (("--lot", "may"), "lots are kept in a store"),
    ):
        failed = run(specimen, bench.address, tmp_path / "out", *options)
        assert failed.exit_code == 2 and words in failed.output and not (tmp_path / "out").exists()
    assert len(bench.commands()) == before


def test_the_usual_drive_is_that_of_the_limits():
    """The default voltage is the same in [limits], in the settings of the analysers and in the help of the command."""
    own = Limits().voltage
    assert Settings().voltage == own and usual_drive(Limits(voltage=2.0)) == own
    assert usual_drive(Limits(voltage=own / 2)) == own / 2
    words = " ".join(main.commands["measure"].get_help(click.Context(main.commands["measure"])).split())
    assert f"[default: {own:g} V, or" in words and f"(by default {own:g} V, no bias)" in words


def test_nothing_at_the_address_exits_with_4(specimen, tmp_path):
    failed = run(specimen, "TCPIP::127.0.0.1::1::SOCKET", tmp_path / "out")
    assert failed.exit_code == 4 and "cannot be reached" in failed.output and not (tmp_path / "out").exists()


def test_a_plan_for_an_analyser_without_a_connection(specimen, tmp_path):
    """plan.csv, its segments and the printed command have the same frequencies; with --data, the most informative
    next ones.
    """
    found = succeeded("measure", specimen, "--plan", "--points", "50", "--out", tmp_path)
    frequency = np.loadtxt(tmp_path / "plan.csv", skiprows=1)
    head, *lines = found.output.split()
    assert head == "frequency_Hz" and frequency.size == 50
    assert np.allclose([float(line) for line in lines], frequency, atol=1e-3)
    rows = np.loadtxt(tmp_path / "plan_segments.csv", delimiter=",", skiprows=1)
    every = np.concatenate([np.linspace(low, high, int(n)) for low, high, n in rows])
    assert np.min(np.abs(every[:, None] - frequency), axis=0) == pytest.approx(0, abs=2e-3)
    command = (tmp_path / "plan_e4990a.scpi").read_text().splitlines()[1]
    numbers = [float(word) for word in command.removeprefix(":SENS1:SEGM:DATA ").split(",")]
    assert numbers[:9] == [7, 0, 0, 0, 0, 0, 0, 0, len(rows)] and np.allclose(numbers[9:], rows.ravel(), atol=1e-3)


@pytest.mark.parametrize(
    ("limits", "options", "band"),
    [
        ('["1 kHz", "180 kHz"]', ("--band", "90 kHz", "150 kHz"), (90e3, 150e3)),
        ('["70 kHz", "160 kHz"]', (), (70e3, 160e3)),
    ],
)
def test_a_plan_keeps_to_its_band(tmp_path, limits, options, band):
    """The band that is asked for, else that of [simulation] within the frequencies of [limits]."""
    path = tmp_path / "plate.toml"
    path.write_text(PLATE.split("[effects")[0].replace('["1 kHz", "180 kHz"]', limits), encoding="utf-8")
    succeeded("measure", path, "--plan", "--points", "32", "--out", tmp_path / "out", *options)
    frequency = np.loadtxt(tmp_path / "out" / "plan.csv", skiprows=1)
    assert frequency.size == 32 and (frequency[0], frequency[-1]) == pytest.approx(band)


def test_a_full_disk_is_reported():
    """/dev/full acts as a file on a full disk."""
    spectrum = ImpedanceSpectrum(np.array([1e3, 2e3]), np.array([1 - 2j, 3 - 4j]))
    with pytest.raises(InputError, match=r"/dev/full: the file cannot be written \(No space left on device\)"):
        PointFile(Path("/dev/full"), Settings()).append(spectrum)


@pytest.mark.parametrize(
    "options",
    [
        ("--instrument", "TCPIP::127.0.0.1::1::SOCKET"),
        ("--voltage", "0.1 V"),
        ("--speed", "5"),
        ("--time", "5 min"),
        ("--diagnose",),
        ("--lot", "A"),
    ],
)
def test_a_plan_refuses_what_only_an_analyser_can_do(specimen, tmp_path, options):
    failed = invoked("measure", specimen, "--plan", "--out", tmp_path / "out", *options)
    assert failed.exit_code == 2 and f"leave {options[0]} out" in failed.output and not (tmp_path / "out").exists()


def test_a_plan_that_separates_needs_a_sweep(specimen, tmp_path):
    failed = invoked("measure", specimen, "--plan", "--separate", "--out", tmp_path / "out")
    assert failed.exit_code == 2 and "give the sweep by --data" in failed.output and not (tmp_path / "out").exists()


@pytest.mark.slow
def test_causes_are_separated_at_the_analyser(specimen, tmp_path):
    """A lead of 30 ohm that the file does not mention: named, and separated from resistive electrodes by further
    points.
    """
    hidden = tmp_path / "hidden.toml"
    hidden.write_text(PLATE.replace("1.5 ohm", "30 ohm"), encoding="utf-8")
    out = tmp_path / "out"
    with analyser(hidden) as running:
        done = run(specimen, running.address, out, "--separate", "--speed", "5")
        assert done.exit_code == 0, done.output
        assert running.is_off() and running.largest_voltage() == 0.5
    assert "log odds of series_resistance over" in done.output
    assert "series_resistance is distinguished from" in done.output.splitlines()[-1]
    record = json.loads((out / "measure.json").read_text())
    assert record["ended"] == "separated" and len(record["rounds"]) >= 2
    assert json.loads((out / "diagnosis" / "diagnosis.json").read_text())["causes"][0]["effect"] == "series_resistance"
    first = np.loadtxt(out / "points.csv", delimiter=",", skiprows=1)[:32, :3]
    np.savetxt(tmp_path / "first.csv", first, delimiter=",", header="frequency_Hz,R_ohm,X_ohm", comments="")
    plan = ["measure", str(specimen), "--plan", "--separate", "--points", "64", "--out", str(tmp_path / "plan")]
    planned = succeeded(*plan, "--data", tmp_path / "first.csv")
    assert [float(line) for line in planned.output.split()[1:]] == pytest.approx(np.sort(points(out)[32:48]), rel=1e-3)


def test_points_of_another_voltage_are_refused(tmp_path):
    file = PointFile(tmp_path / "points.csv", Settings(voltage=0.5))
    assert file.read() is None
    file.append(ImpedanceSpectrum(np.array([1e3, 2e3]), np.array([1 - 2j, 3 - 4j])))
    file.append(ImpedanceSpectrum(np.array([1.5e3]), np.array([5 - 6j])))
    assert file.read().frequency.tolist() == [1e3, 1.5e3, 2e3] and file.read().impedance[1] == 5 - 6j
    with pytest.raises(Exception, match=r"voltage of 0\.5 V, not 0\.2 V; give --voltage 0\.5"):
        PointFile(file.path, Settings(voltage=0.2)).read()
    file.path.write_text("frequency,Z\n1,2\n")
    with pytest.raises(Exception, match="not a file of points"):
        file.read()


def test_points_of_another_piece_are_refused(tmp_path):
    """Its name or its body differ; other tolerances and priors do not matter."""
    path, kept = tmp_path / "plate.toml", tmp_path / "piece.toml"
    path.write_text(PLATE, encoding="utf-8")
    _refuse_another(kept, read_specimen(path))  # of an older folder nothing is known
    write_specimen(read_specimen(path), kept)
    _refuse_another(kept, read_specimen(path).model_copy(update={"simulation": None}))
    for other in (PLATE.replace("12 mm", "13 mm"), PLATE.replace("plate 07", "plate 08")):
        assert other != PLATE
        path.write_text(other, encoding="utf-8")
        with pytest.raises(InputError, match=r"another piece, 'plate 07' as in piece\.toml; give another --out"):
            _refuse_another(kept, read_specimen(path))


def test_how_other_files_are_read_is_not_kept_for_an_own_sweep(tmp_path):
    """The columns of a table that another instrument wrote are not those of sweep.csv."""
    path = tmp_path / "plate.toml"
    table = '[measurement]\nfile = "x.txt"\nnoise = 0.01\ncolumns = ["f (Hz)", "|Z| (Ohm)", "theta (deg)"]\n'
    path.write_text(PLATE + table, encoding="utf-8")
    kept = _with_sweep(read_specimen(path), tmp_path / "sweep.csv").measurement
    assert kept.columns is None and kept.noise == 0.01 and kept.file == tmp_path / "sweep.csv"


def test_columns_of_the_raw_sweeps_of_a_fixture_are_refused(tmp_path):
    """They would name the columns of the sweeps that are written as well."""
    path = tmp_path / "plate.toml"
    path.write_text(PLATE + '[measurement]\nopen = "open.csv"\ncolumns = ["f (kHz)", "R (Ohm)", "X (Ohm)"]\n')
    with pytest.raises(InputError, match=r"measurement\.columns would also name the columns of the sweeps"):
        measure(read_specimen(path), "simulated", tmp_path / "out", Wish(), Settings())
    assert not (tmp_path / "out").exists()
