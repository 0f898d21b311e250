"""A lot from jobs to table and report: what is finished and unchanged is kept, the rest computed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from femu_piezo.batch.jobs import Job, program_checksum
from femu_piezo.batch.pool import Pool, run_all
from femu_piezo.batch.store import Records, locked
from femu_piezo.batch.table import rows_of, write_table
from femu_piezo.batch.worker import record, run_job
from femu_piezo.output.folder import prepare_folder


@dataclass(frozen=True)
class LotResult:
    """The rows of a lot, and how many of them were kept from earlier runs or computed now."""

    rows: list[dict]
    kept: int
    computed: int

    def count(self, status: str) -> int:
        """Number of rows with a status."""
        return sum(row["status"] == status for row in self.rows)


def run_lot(
    jobs: list[Job],
    out: Path,
    make_pool: Callable[[], Pool],
    *,
    finished: Callable[[int, int, dict], None] = lambda done, all_, record: None,
    patience_s: float = 1200.0,
) -> LotResult:
    """Compute what is missing, write out/table.csv and out/table.parquet.

    Every record is durable in out/records as soon as it is there, so that after any end the next run continues.

    Parameters
    ----------
    make_pool : starts the workers; not called where nothing is to be computed
    finished : called with (done so far, all, record) after each job, those kept included
    patience_s : give up what is in flight after so long without any result

    Raises
    ------
    InputError : the folder cannot serve, or another run holds it;  ConvergenceError : no worker survives
    """
    prepare_folder(out)
    with locked(out):
        records = Records(out / "records")
        program = program_checksum()
        checksums = {job.name: job.checksum(program, job.read().files) for job in jobs}
        found: dict[str, dict] = {}

        def take(one: dict) -> None:
            found[one["name"]] = one
            finished(len(found), len(jobs), one)

        todo = []
        for job in jobs:
            old = records.read(job.name, checksums[job.name])
            if old is None:
                todo.append(job)
            else:
                take(old)
        if todo:
            _compute(todo, checksums, program, make_pool(), records, take, patience_s)
        rows = rows_of([found[job.name] for job in jobs])
        write_table(rows, out / "table.csv", out / "table.parquet")
    return LotResult(rows, len(jobs) - len(todo), len(todo))


def _compute(todo, checksums, program, pool: Pool, records: Records, take, patience_s: float) -> None:
    def one(task: tuple, result: dict | None, reason: str) -> None:
        job, checksum, _ = task
        result = result or record(job, checksum, "lost", f"{job.name}: {reason}")
        records.write(result)
        take(result)

    try:
        run_all(pool, run_job, [(job, checksums[job.name], program) for job in todo], one, patience_s)
    finally:
        pool.close()
