"""The queue of jobs: progress, cancelling, errors, two at once, and what remains after a stop."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from femu_piezo.errors import InputError
from femu_piezo.web.jobs import Job, Jobs
from femu_piezo.web.server import _checked

from .conftest import TUTORIALS


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("plate.toml", "sweep.csv"):
        (tmp_path / name).write_bytes((TUTORIALS / "k31_plate" / name).read_bytes())
    (tmp_path / "broken.csv").write_text("time,colour\n1,red\n2,blue\n")
    (tmp_path / ".femu-piezo").mkdir()
    return tmp_path


@pytest.fixture
def start(folder: Path):
    queues: list[Jobs] = []

    def make(workers: int = 1) -> Jobs:
        queues.append(Jobs(folder, folder / ".femu-piezo", workers))
        return queues[-1]

    yield make
    for queue in queues:
        queue.stop()


def wait(until: Callable[[], bool], seconds: float = 90.0) -> None:
    end = time.time() + seconds
    while not until():
        assert time.time() < end, "it does not come to an end"
        time.sleep(0.02)


def test_a_command_runs_as_in_a_terminal_and_shows_its_steps(folder: Path, start) -> None:
    jobs, seen = start(), set()
    job = jobs.ask("update", "plate.toml", "results/plate.toml/update")

    def ended() -> bool:
        seen.add(job.step)
        return not job.active

    wait(ended)
    assert job.state == "done" and job.message == "" and job.seconds > 0.5
    assert "fit" in seen or "reduce" in seen or len(seen) > 2
    assert (
        json.loads((folder / "results/plate.toml/update/update.json").read_text())["parameters"]["s11"]["value"] > 1e-11
    )
    again = Job(99, "update", "plate.toml", "x", began=time.time(), state="running")
    assert 0 < jobs.seconds_left(again) < 2 * job.seconds  # the time of the next run is estimated from the last one


def test_errors_are_the_sentence_of_the_terminal(start) -> None:
    jobs = start()
    job = jobs.ask("extract", "broken.csv", "results/broken.csv/extract")
    wait(lambda: not job.active)
    assert job.state == "failed" and job.message.startswith("broken.csv") and "column" in job.message


def test_jobs_wait_are_cancelled_and_are_not_asked_twice(folder: Path, start) -> None:
    jobs = start(workers=1)
    first = jobs.ask("diagnose", "plate.toml", "results/plate.toml/diagnose")
    second = jobs.ask("extract", "sweep.csv", "results/sweep.csv/extract")
    assert jobs.ask("diagnose", "plate.toml", "results/plate.toml/diagnose") is first
    wait(lambda: first.state == "running" and first.step != "")
    assert second.state == "waiting"
    jobs.cancel(first.number)
    assert first.state == "cancelled"
    wait(lambda: not second.active)
    assert second.state == "done"
    assert not (folder / "results/plate.toml/diagnose").exists()  # an interrupted command leaves no incomplete files


def test_two_run_at_once(start) -> None:
    jobs = start(workers=2)
    pair = [jobs.ask("extract", "sweep.csv", "results/a"), jobs.ask("update", "plate.toml", "results/b")]
    wait(lambda: all(job.state == "running" for job in pair))
    wait(lambda: not any(job.active for job in pair))
    assert [job.state for job in pair] == ["done", "done"]


def test_what_waited_is_run_after_a_restart(folder: Path, start) -> None:
    jobs = start(workers=1)
    jobs.ask("diagnose", "plate.toml", "results/plate.toml/diagnose")
    jobs.ask("extract", "sweep.csv", "results/sweep.csv/extract")
    wait(lambda: jobs.latest("diagnose", "plate.toml").state == "running")
    record = (folder / ".femu-piezo/jobs.json").read_text()
    jobs.stop()
    (folder / ".femu-piezo/jobs.json").write_text(record)  # the record of a job that was running, as after a power cut
    after = start(workers=1)
    assert after.latest("diagnose", "plate.toml").state == "cancelled"
    assert "stopped" in after.latest("diagnose", "plate.toml").message
    wait(lambda: after.latest("extract", "sweep.csv").state == "done")
    (folder / ".femu-piezo/jobs.json").write_text("{ damaged")
    assert start().all() == []


def test_a_list_that_cannot_be_saved_stops_no_job(start, monkeypatch) -> None:
    """As on a full disk: the jobs run in turn all the same."""

    def full(path: Path, text: str) -> None:
        raise InputError(f"{path}: no space left on the device")

    monkeypatch.setattr("femu_piezo.web.jobs.write_atomically", full)
    jobs = start()
    asked = [jobs.ask("extract", name, f"results/{name}") for name in ("sweep.csv", "broken.csv")]
    wait(lambda: not any(job.active for job in asked))
    assert [job.state for job in asked] == ["done", "failed"]


def test_a_script_in_the_folder_is_no_module_and_a_name_no_option(folder: Path, start) -> None:
    (folder / "numbers.py").write_text("raise SystemExit('run')")
    (folder / "-x.csv").write_bytes((folder / "sweep.csv").read_bytes())
    jobs = start()
    job = jobs.ask("extract", "-x.csv", "results/-x.csv/extract")
    wait(lambda: not job.active)
    assert (job.state, job.message) == ("done", "")


def test_a_lot_without_any_result_is_told(folder: Path, start) -> None:
    (folder / "lot").mkdir()
    (folder / "lot/a.toml").write_text('name = "a"\n')
    job = start().ask("batch", "lot", "results/lot/batch")
    wait(lambda: not job.active)
    assert job.state == "failed" and (folder / "results/lot/batch/table.csv").exists()
    assert job.message == "no specimen has a result; the reasons are in results/lot/batch/table.csv"


def test_jobs_of_another_version_are_forgotten(folder: Path, start) -> None:
    (folder / ".femu-piezo/jobs.json").write_text('[{"number": 1, "colour": "red"}]')
    assert start().all() == []


def test_commands_keep_their_results_in_the_store_of_the_page(folder: Path) -> None:
    from femu_piezo.store.database import Database
    from femu_piezo.store.read import read_pieces

    address = str(folder / "line.sqlite")
    jobs = Jobs(folder, folder / ".femu-piezo", 1, store=address)
    job = jobs.ask("update", "plate.toml", "results/plate.toml/update")
    wait(lambda: not job.active)
    jobs.stop()
    assert job.state == "done", job.message
    database = Database(address, folder, make=False)
    assert [row["status"] for row in read_pieces(database)] == ["ok"]
    database.close()


@pytest.mark.parametrize(
    ("address", "file"),
    [
        ("sqlite:///line.sqlite", "line.sqlite"),
        ("sqlite+pysqlite:///line.sqlite", "line.sqlite"),
        ("line.sqlite", "line.sqlite"),
        ("sqlite", "page/store.sqlite"),
    ],
)
def test_the_store_of_the_page_is_that_of_its_terminal(tmp_path: Path, monkeypatch, address: str, file: str) -> None:
    """The commands run in the folder of the page; the address is meant where the page was started."""
    from femu_piezo.store.database import Database

    (tmp_path / "page").mkdir()
    monkeypatch.chdir(tmp_path)
    checked = _checked(address, Path("page"))
    monkeypatch.chdir(tmp_path / "page")
    assert Database(checked, Path()).shown == tmp_path / file
