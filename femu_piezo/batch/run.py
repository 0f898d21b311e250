"""A lot from jobs to table: finished results of unchanged inputs are kept, the others are computed."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

from femu_piezo.batch.jobs import Job, program_checksum, same_sweeps
from femu_piezo.batch.pool import Pool, run_all
from femu_piezo.batch.records import Records, write_record
from femu_piezo.batch.table import rows_of, write_table
from femu_piezo.batch.worker import record, run_job
from femu_piezo.output.folder import locked, prepare_folder

#: Which specimens are diagnosed after the update: every one that has a result, or those that are outliers of the lot.
Diagnosed = Literal["all", "outliers"]


@dataclass(frozen=True)
class LotResult:
    """The rows of a lot, and how many results were kept from earlier runs or computed now.

    same : files with the same content of their sweeps, several in each group
    """

    rows: list[dict]
    kept: int
    computed: int
    same: tuple[tuple[str, ...], ...] = ()

    def count(self, status: str) -> int:
        """Number of rows with a status."""
        return sum(row["status"] == status for row in self.rows)


def run_lot(
    jobs: list[Job],
    out: Path,
    make_pool: Callable[[], Pool],
    *,
    diagnose: Diagnosed | None = None,
    finished: Callable[[str, int, int, dict], None] = lambda step, done, all_, record: None,
    patience_s: float = 1200.0,
) -> LotResult:
    """Compute what is missing, write out/table.csv and out/table.parquet.

    Every record is durable in out/records (of diagnoses in out/diagnoses) as soon as it is computed, so that the next
    run continues however this one ends.

    Parameters
    ----------
    jobs : updates, one for each row
    make_pool : starts the workers; not called where nothing is to be computed
    diagnose : which specimens to diagnose as well
    finished : called with (step, jobs done so far, all jobs, record) after each job, kept ones included
    patience_s : give up the jobs in flight after so long without any result

    Raises
    ------
    InputError : the folder cannot serve, or another run holds it;  ConvergenceError : no worker survives
    """
    prepare_folder(out)
    with locked(out):
        run = _Run(make_pool, finished, patience_s)
        try:
            updated = run.step("update", jobs, Records(out / "records"))
            rows, diagnosed = rows_of(updated), None
            if diagnose is not None:
                chosen = _to_diagnose(rows, diagnose)
                wanted = [replace(job, step="diagnose") for job in jobs if job.name in chosen]
                found = run.step("diagnose", wanted, Records(out / "diagnoses"))
                diagnosed = {one["name"]: one for one in found}
        finally:
            run.close()
        rows = rows_of(updated, diagnosed)
        write_table(rows, out / "table.csv", out / "table.parquet")
    return LotResult(rows, run.kept, run.computed, run.same)


def _to_diagnose(rows: list[dict], which: Diagnosed) -> set[str]:
    if which == "outliers":
        from femu_piezo.batch.lot import lot_of  # loads the statistics of scipy

        return {one.file for one in lot_of(rows).outliers}
    return {row["file"] for row in rows if row["status"] == "ok"}


def run_and_keep(folder: str, job: Job, checksum: str, program: str, limit_s: float | None = None) -> dict:
    """`run_job` for bundles: the worker itself makes the record durable at once, where it can write to the folder."""
    found = run_job(job, checksum, program, limit_s)
    with suppress(OSError):
        write_record(Path(folder), found)
    return found


class _Run:
    """Runs steps on the same workers, which start with the first job that must be computed."""

    def __init__(self, make_pool: Callable[[], Pool], finished: Callable, patience_s: float) -> None:
        self._make_pool, self._finished, self._patience = make_pool, finished, patience_s
        self._pool: Pool | None = None
        self._program = program_checksum()
        self.kept = self.computed = 0
        self.same: tuple[tuple[str, ...], ...] = ()

    def step(self, name: str, jobs: list[Job], records: Records) -> list[dict]:
        """The records of one step, kept or computed, without their "results", in the order of the jobs."""
        checksums, sweeps = {}, {}
        for job in jobs:
            inputs = job.read()
            contents = inputs.contents()
            checksums[job.name], sweeps[job.name] = job.checksum(self._program, contents), inputs.of_sweeps(contents)
        self.same = self.same or same_sweeps(sweeps)
        found: dict[str, dict] = {}

        def take(one: dict) -> None:
            found[one["name"]] = {key: value for key, value in one.items() if key != "results"}  # those are on disk
            self._finished(name, len(found), len(jobs), one)

        def computed(task: tuple, result: dict | None, reason: str) -> None:
            job, checksum, _ = task
            result = result or record(job, checksum, "lost", f"{job.name}: {reason}")
            if self._pool.bundle == 1 or records.read(job.name, checksum) is None:
                records.write(result)
            take(result)

        todo = []
        for job in jobs:
            old = records.read(job.name, checksums[job.name])
            if old is None:
                todo.append(job)
            else:
                take(old)
        self.kept += len(jobs) - len(todo)
        self.computed += len(todo)
        if todo:
            self._pool = self._pool or self._make_pool()
            tasks = [(job, checksums[job.name], self._program) for job in todo]
            work = run_job if self._pool.bundle == 1 else partial(run_and_keep, str(records.folder.resolve()))
            run_all(self._pool, work, tasks, computed, self._patience)
        return [found[job.name] for job in jobs]

    def close(self) -> None:
        if self._pool is not None:
            self._pool.close()
