"""A lot from files to table: rows for good and bad files, resuming, independence of the order of work, Dask,
SIGKILL.
"""

from __future__ import annotations

import csv
import json
import re
import shutil
from concurrent.futures import Future
from pathlib import Path

import pyarrow.parquet
import pytest
from lots import S11, SPECIMEN, InlinePool, kill_at_random, sweep, write_lot

from femu_piezo.batch.jobs import Job, find_jobs, natural_order
from femu_piezo.batch.lot import lot_of, lot_text
from femu_piezo.batch.pool import in_turn
from femu_piezo.batch.report import write_report
from femu_piezo.batch.run import run_lot
from femu_piezo.batch.table import write_table
from femu_piezo.errors import ConvergenceError, InputError
from femu_piezo.measurement.readers import write_spectrum
from femu_piezo.measurement.spectrum import ENDINGS, ImpedanceSpectrum
from tests.commands import invoked, succeeded


def no_pool():
    """Stands for a pool where nothing may be computed."""
    raise AssertionError("nothing was to be computed")


def table(out: Path) -> list[dict[str, str]]:
    """Rows of table.csv."""
    with open(out / "table.csv", encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.fixture(scope="module")
def lot(tmp_path_factory) -> tuple[Path, Path, Path]:
    """Sweeps, specimen and finished results of a lot of six with two bad files, by the command line with two
    processes.
    """
    folder = tmp_path_factory.mktemp("lot")
    sweeps, specimen = write_lot(folder, 6)
    (sweeps / "p2.csv").write_bytes(b"\x00\x01\x02")
    write_spectrum(sweep(3).band(26e3, 30e3), sweeps / "p3.csv")
    succeeded("batch", sweeps, "--specimen", specimen, "--out", folder / "out", "--workers", "2")
    return sweeps, specimen, folder / "out"


def test_good_and_bad_files_are_rows(lot):
    rows = table(lot[2])
    assert [row["file"] for row in rows] == [f"p{i}.csv" for i in range(1, 7)]
    assert [row["status"] for row in rows] == ["ok", "failed", "failed", "ok", "ok", "ok"]
    assert "p2.csv" in rows[1]["reason"] and "no resonance" in rows[2]["reason"]
    for row in rows:
        if row["status"] == "ok":  # sweeps of a 1-D bar, fitted by a plate 3 mm wide: s11 differs by a few per mille
            assert float(row["s11"]) == pytest.approx(S11.real, rel=0.05, abs=0)
            assert 0 < float(row["s11_std"]) < 0.01 * float(row["s11"])
    record = json.loads((lot[2] / "records" / "p1.csv.json").read_text(encoding="utf-8"))
    assert record["results"]["update"]["parameters"]["s11"]["value"] == float(rows[0]["s11"])


def test_parquet_holds_the_same(lot):
    rows, other = table(lot[2]), pyarrow.parquet.read_table(lot[2] / "table.parquet").to_pylist()
    assert list(rows[0]) == list(other[0])
    for row, same in zip(rows, other, strict=True):
        assert {name: "" if value is None else str(value) for name, value in same.items()} == row


def test_the_table_names_files_as_they_are(tmp_path):
    """Two spaces remain two, as in Parquet; a reason of several lines is one."""
    row = {"number": 1, "file": "p  1.csv", "specimen": "p  1", "status": "failed", "reason": "first\nsecond"}
    write_table([row], tmp_path / "table.csv", tmp_path / "table.parquet")
    found = table(tmp_path)[0]
    assert (found["file"], found["specimen"], found["reason"]) == ("p  1.csv", "p  1", "first second")
    assert pyarrow.parquet.read_table(tmp_path / "table.parquet").to_pylist()[0]["file"] == found["file"]


def test_lot_report(lot):
    report = json.loads((lot[2] / "lot.json").read_text(encoding="utf-8"))
    assert report["counts"] == {"specimens": 6, "ok": 4, "failed": 2, "lost": 0}
    assert {item["file"] for item in report["faults"]} == {"p2.csv", "p3.csv"}
    assert report["quantities"]["s11"]["count"] == 4
    assert (lot[2] / "lot.png").stat().st_size > 10_000


def test_only_changed_files_are_computed_again(lot, tmp_path):
    sweeps, specimen, out = lot
    before = (out / "table.csv").read_bytes(), (out / "table.parquet").read_bytes()
    result = run_lot(find_jobs(sweeps, specimen), out, no_pool)
    assert (result.kept, result.computed) == (6, 0)
    assert ((out / "table.csv").read_bytes(), (out / "table.parquet").read_bytes()) == before

    old = (sweeps / "p5.csv").read_bytes()
    write_spectrum(sweep(50), sweeps / "p5.csv")
    pool = InlinePool()
    run_lot(find_jobs(sweeps, specimen), out, lambda: pool)
    assert pool.done == ["p5.csv"]
    assert (out / "table.csv").read_bytes() != before[0]
    (sweeps / "p5.csv").write_bytes(old)
    run_lot(find_jobs(sweeps, specimen), out, lambda: pool)
    assert (out / "table.csv").read_bytes() == before[0]


def test_order_of_work_and_process_do_not_change_the_table(lot, tmp_path):
    """Two spawned processes, and this process in reversed order, write the same bytes."""
    jobs = find_jobs(lot[0], lot[1])
    run_lot(list(reversed(jobs)), tmp_path / "reversed", InlinePool)
    run_lot(jobs, tmp_path / "reversed", no_pool)
    assert (tmp_path / "reversed/table.csv").read_bytes() == (lot[2] / "table.csv").read_bytes()


def test_a_sweep_under_two_names_is_told(lot, tmp_path):
    """A copy of a file in a folder of sweeps, and two specimen files with one sweep."""
    (tmp_path / "sweeps").mkdir()
    for name, number in (("a", 4), ("b", 5), ("copy of a", 4)):
        shutil.copy(lot[0] / f"p{number}.csv", tmp_path / "sweeps" / f"{name}.csv")
        text = SPECIMEN.format(file=f"sweeps/{name}.csv".replace("copy of ", ""))
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
    for folder, specimen, end in ((tmp_path / "sweeps", lot[1], "csv"), (tmp_path, None, "toml")):
        result = run_lot(find_jobs(folder, specimen), tmp_path / end, InlinePool)
        write_report(result, tmp_path / end)
        words = f"the same sweep, counted as 2 pieces: a.{end}, copy of a.{end}\n"
        assert words in (tmp_path / end / "lot.txt").read_text(encoding="utf-8")
        record = json.loads((tmp_path / end / "lot.json").read_text(encoding="utf-8"))
        assert record["same_sweeps"] == [[f"a.{end}", f"copy of a.{end}"]]
    assert json.loads((lot[2] / "lot.json").read_text(encoding="utf-8"))["same_sweeps"] == []


def test_damaged_and_foreign_records_are_computed_again(lot, tmp_path):
    jobs = find_jobs(lot[0], lot[1])[3:]
    run_lot(jobs, tmp_path, InlinePool)
    records = sorted((tmp_path / "records").iterdir())
    records[0].write_bytes(records[0].read_bytes()[:100])
    records[1].write_text("[]", encoding="utf-8")
    (tmp_path / "records" / ".p9.csv.json.1.ab.tmp").write_text("half", encoding="utf-8")
    pool = InlinePool()
    run_lot(jobs, tmp_path, lambda: pool)
    assert len(pool.done) == 2
    assert not list((tmp_path / "records").glob(".*"))


def test_unexpected_errors_are_rows_and_tried_again(lot, tmp_path, monkeypatch):
    from femu_piezo.batch import steps

    def broken(specimens, bases):
        raise ZeroDivisionError("by\nnothing")

    jobs = find_jobs(lot[0], lot[1])[:1]
    with monkeypatch.context() as patch:
        patch.setitem(steps.STEPS, "update", broken)
        result = run_lot(jobs, tmp_path, InlinePool)
    assert result.rows[0]["status"] == "lost"
    assert "ZeroDivisionError: by nothing" in result.rows[0]["reason"]
    assert run_lot(jobs, tmp_path, InlinePool).rows[0]["status"] == "ok"


def test_a_file_that_changes_during_the_work_is_lost(lot, tmp_path):
    jobs = [Job("p1.csv", lot[1], lot[0] / "p1.csv")]

    class Changing(InlinePool):
        def submit(self, function, job, checksum, *rest):
            return super().submit(function, job, "0" * 64, *rest)

    row = run_lot(jobs, tmp_path, Changing).rows[0]
    assert row["status"] == "lost" and "changed during the work" in row["reason"]


def test_a_link_to_nothing_is_a_row(lot, tmp_path):
    (tmp_path / "sweeps").mkdir()
    (tmp_path / "sweeps" / "p1.csv").symlink_to(lot[0] / "moved away.csv")
    (tmp_path / "sweeps" / "p2.csv").symlink_to(lot[0], target_is_directory=True)
    (row,) = run_lot(find_jobs(tmp_path / "sweeps", lot[1]), tmp_path / "out", InlinePool).rows
    assert (row["file"], row["status"]) == ("p1.csv", "failed") and "p1.csv" in row["reason"]


def test_folder_of_specimen_files(tmp_path):
    specimen = write_lot(tmp_path, 1)[1]
    for number in (9, 10):
        text = specimen.read_text(encoding="utf-8").replace('length = "40 mm"', f'length = "{39 + number / 10} mm"')
        (tmp_path / f"bar {number}.toml").write_text(f'name = "bar {number}"\n{text}', encoding="utf-8")
    specimen.write_text("name = ", encoding="utf-8")
    result = run_lot(find_jobs(tmp_path), tmp_path / "out", InlinePool)
    assert [row["file"] for row in result.rows] == ["bar 9.toml", "bar 10.toml", "bar.toml"]
    assert [row["status"] for row in result.rows] == ["ok", "ok", "failed"]
    assert (
        result.rows[0]["s11"] > result.rows[1]["s11"]
    )  # the same sweep of a longer bar means a stiffer material (bar 9 is the shorter one)


def test_a_file_that_frees_nothing_is_wrong_input_and_not_lost(tmp_path):
    specimen = write_lot(tmp_path, 1)[1]
    specimen.write_text(
        specimen.read_text(encoding="utf-8").replace("[update]", "free = []\n[update]"), encoding="utf-8"
    )
    row = run_lot(find_jobs(tmp_path), tmp_path / "out", InlinePool).rows[0]
    assert row["status"] == "failed" and "material.free = []" in row["reason"]


def diagnosed(name: str):
    """A step that finds the cause `name` in every specimen, and fails for one of the files."""

    def step(specimens, bases):
        if specimens[0].measurement.file.name == "p5.csv":
            raise ConvergenceError("p5.csv: the base model cannot be fitted")
        return {"verdict": "effect", "cause": name, "probability": 0.97, "diagnosis": f"{name} 3 ohm"}, {"verdict": 1}

    return step


def test_diagnoses_are_columns_kept_apart_from_the_updates(lot, tmp_path, monkeypatch):
    from femu_piezo.batch import steps

    jobs = find_jobs(lot[0], lot[1])
    plain = run_lot(jobs, tmp_path, InlinePool)
    before = (tmp_path / "table.csv").read_bytes()
    monkeypatch.setitem(steps.STEPS, "diagnose", diagnosed("series_resistance"))
    pool = InlinePool()
    result = run_lot(jobs, tmp_path, lambda: pool, diagnose="all")
    assert pool.done == [
        "p1.csv",
        "p4.csv",
        "p5.csv",
        "p6.csv",
    ]  # files with a result, whose updates are not computed again
    assert [row["verdict"] for row in result.rows] == ["effect", None, None, "effect", None, "effect"]
    assert "no diagnosis: p5.csv: the base" in result.rows[4]["diagnosis"] and result.rows[4]["status"] == "ok"
    assert [row["s11"] for row in result.rows if "s11" in row] == [row["s11"] for row in plain.rows if "s11" in row]
    report = lot_of(result.rows)
    assert (report.verdicts, report.causes) == ({"effect": 3}, {"series_resistance": 3})
    whole = (tmp_path / "table.csv").read_bytes()
    assert table(tmp_path)[0]["cause"] == "series_resistance"
    assert pyarrow.parquet.read_table(tmp_path / "table.parquet").to_pylist()[0]["probability"] == 0.97
    again = run_lot(jobs, tmp_path, no_pool, diagnose="all")
    assert (again.kept, again.computed) == (10, 0) and (tmp_path / "table.csv").read_bytes() == whole
    run_lot(jobs, tmp_path, no_pool)
    assert (tmp_path / "table.csv").read_bytes() == before


def test_only_outliers_are_diagnosed_on_request(tmp_path, monkeypatch):
    from femu_piezo.batch import steps

    sweeps, specimen = write_lot(tmp_path, 9)
    write_spectrum(sweep(9, scatter=0.2), sweeps / "p9.csv")
    monkeypatch.setitem(steps.STEPS, "diagnose", diagnosed("wrong_length"))
    pool = InlinePool()
    result = run_lot(find_jobs(sweeps, specimen), tmp_path / "out", lambda: pool, diagnose="outliers")
    assert pool.done[9:] == ["p9.csv"]
    assert [row["verdict"] for row in result.rows] == [None] * 8 + ["effect"]
    assert "diagnosis: wrong_length 3 ohm" in lot_text(lot_of(result.rows))


def test_a_diagnosis_end_to_end(tmp_path):
    """Through the command line: a resistor of 100 ohm in series with a bar thin enough for the 1-D formula."""
    sweeps, specimen = write_lot(tmp_path, 1)
    text = specimen.read_text(encoding="utf-8").replace("3 mm", "0.5 mm").replace("1e-2", "1e-3")
    specimen.write_text(text, encoding="utf-8")
    one = sweep(1, width=0.5e-3)
    write_spectrum(ImpedanceSpectrum(one.frequency, one.impedance + 100), sweeps / "p1.csv")
    arguments = ["batch", str(sweeps), "--specimen", str(specimen), "--out", str(tmp_path / "out"), "--workers", "1"]
    succeeded(*arguments, "--diagnose")
    row = table(tmp_path / "out")[0]
    assert row["verdict"] == "effect" and row["cause"] == "series_resistance", row["diagnosis"]
    assert float(row["size"]) == pytest.approx(100, abs=4 * float(row["size_std"]))
    assert re.match(r"series_resistance \(resistance \([\d.]+ ± [\d.]+\) Ω; probability", row["diagnosis"])
    record = json.loads((tmp_path / "out/diagnoses/p1.csv.json").read_text(encoding="utf-8"))
    assert record["results"]["diagnose"]["causes"][0]["probability"] == float(row["probability"])


def test_natural_order():
    names = ["p10", "p9", "P1", "a2b10", "a2b9", "7", "x"]
    assert sorted(names, key=natural_order) == ["7", "a2b9", "a2b10", "P1", "p9", "p10", "x"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["{sweeps}", "--out", "{tmp}/o"], "no files *.toml"),
        (["{tmp}/none", "--out", "{tmp}/o"], "no folder"),
        (["{sweeps}", "--specimen", "{tmp}/none.toml", "--out", "{tmp}/o"], "no such specimen file"),
        (["{sweeps}", "--specimen", "{sweeps}/p1.csv", "--out", "{tmp}/o"], "this is not TOML"),
        (["{sweeps}", "--specimen", "{specimen}", "--out", "{sweeps}"], "cannot go into the folder of the lot"),
        (
            ["{sweeps}", "--specimen", "{specimen}", "--out", "{tmp}/o", "--scheduler", "x", "--workers", "1"],
            "--workers",
        ),
        (["{sweeps}", "--specimen", "{specimen}", "--out", "{tmp}/o", "--scheduler", "tcp://127.0.0.1:1"], "scheduler"),
    ],
)
def test_wrong_use_is_one_sentence(lot, tmp_path, arguments, words, monkeypatch):
    monkeypatch.setattr("femu_piezo.batch.cluster.CONNECT_S", 1)
    filled = [item.format(sweeps=lot[0], specimen=lot[1], tmp=tmp_path) for item in arguments]
    answer = invoked("batch", *filled)
    assert answer.exit_code == 2, answer.output
    assert words in answer.output and answer.output.count("\n") == 1


def test_two_runs_cannot_share_a_folder(lot, tmp_path):
    def second_run():
        with pytest.raises(InputError, match="another run"):
            run_lot(jobs, tmp_path, no_pool)
        return InlinePool()

    jobs = find_jobs(lot[0], lot[1])[:1]
    run_lot(jobs, tmp_path, second_run)


def test_bundles_give_the_same_table_and_lose_nothing(lot, tmp_path):
    """Jobs are submitted three at a time; the coordinator dies before it has the result of the first bundle."""

    class Bundles(InlinePool):
        bundle, width = 3, 1

        def submit(self, function, *arguments):
            future = Future()
            future.set_result(function(*arguments))
            self.done.append(len(arguments[1]) if function is in_turn else 1)
            if dies:
                raise KeyboardInterrupt
            return future

    jobs, dies = find_jobs(lot[0], lot[1]), True
    with pytest.raises(KeyboardInterrupt):
        run_lot(jobs, tmp_path, Bundles)
    assert len(list((tmp_path / "records").glob("*.json"))) == 3
    dies, pool = False, Bundles()
    assert run_lot(jobs, tmp_path, lambda: pool).kept == 3
    assert sum(pool.done) == len(jobs) - 3 and pool.done[0] > 1
    assert (tmp_path / "table.csv").read_bytes() == (lot[2] / "table.csv").read_bytes()


def test_dask_gives_the_same_table(lot, tmp_path):
    from distributed import LocalCluster

    from femu_piezo.batch.cluster import DaskPool

    sampled = []
    with LocalCluster(1, threads_per_worker=2, processes=False, dashboard_address=None) as cluster:
        sampling, tick = (cluster.workers[0].periodic_callbacks[name] for name in ("profile", "tick"))
        before = tick.callback_time
        run_lot(
            find_jobs(lot[0], lot[1]),
            tmp_path,
            lambda: DaskPool(cluster.scheduler_address),
            finished=lambda *_: sampled.append(sampling.is_running() or tick.callback_time == before),
        )
        assert not any(sampled)
        assert sampling.is_running() and tick.callback_time == before  # the settings of the cluster are restored
    assert (tmp_path / "table.csv").read_bytes() == (lot[2] / "table.csv").read_bytes()


def test_kill_and_resume_ends_in_the_identical_table(lot, tmp_path):
    assert kill_at_random(lot[0], lot[1], tmp_path, kills=2, seed=1, longest_s=2) > 0
    assert (tmp_path / "table.csv").read_bytes() == (lot[2] / "table.csv").read_bytes()
    assert (tmp_path / "table.parquet").read_bytes() == (lot[2] / "table.parquet").read_bytes()


@pytest.mark.parametrize("ending", ENDINGS)
def test_sweeps_of_every_ending_are_jobs(tmp_path, ending):
    (tmp_path / "plate.toml").write_text("", encoding="utf-8")
    (tmp_path / "sweeps").mkdir()
    for name in (f"plate_1{ending}", f"plate_2{ending.upper()}", "notes.md"):
        (tmp_path / "sweeps" / name).write_text("", encoding="utf-8")
    names = [job.name for job in find_jobs(tmp_path / "sweeps", tmp_path / "plate.toml")]
    assert names == [f"plate_1{ending}", f"plate_2{ending.upper()}"]
