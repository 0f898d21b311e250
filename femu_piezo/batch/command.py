"""`femu-piezo batch`: a folder → table and lot report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from threading import Thread

from femu_piezo.batch.jobs import Job, find_jobs
from femu_piezo.batch.pool import LocalPool, Pool
from femu_piezo.batch.progress import lot_progress
from femu_piezo.batch.run import Diagnosed, run_lot
from femu_piezo.batch.table import as_parquet
from femu_piezo.errors import InputError
from femu_piezo.specimen.file import read_specimens
from femu_piezo.threads import available_cores


def run_batch(
    folder: Path,
    out: Path,
    specimen: Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    time_limit_s: float = 900.0,
    correct_phase: bool = False,
    mask_faults: bool = False,
    diagnose: Diagnosed | None = None,
    keep: Callable[[Job, dict], None] | None = None,
) -> tuple[str, int]:
    """Run the lot in a folder and write its results; returns the text to show and the exit code.

    The exit code is 0 where at least one specimen has a result, 3 where none has, 130 after Ctrl-C (finished jobs are
    kept).

    Parameters
    ----------
    keep : called with every finished job and its record, as soon as the record is on disk
    """
    jobs = find_jobs(folder, specimen, correct_phase=correct_phase, mask_faults=mask_faults)
    if specimen is not None:
        read_specimens([specimen], jobs[0].sweep)  # what is wrong with it would be the reason in every row

    def make_pool() -> Pool:
        Thread(target=_load_libraries).start()  # this process waits while the workers start
        if scheduler is not None:
            try:
                from femu_piezo.batch.cluster import DaskPool
            except ImportError:
                raise InputError(
                    "--scheduler needs Dask, which is not installed; pip install 'femu-piezo[cluster]'"
                ) from None
            return DaskPool(scheduler)
        return LocalPool(min(workers or available_cores(), len(jobs)), time_limit_s)

    done, by_name = {}, {job.name: job for job in jobs}
    try:
        with lot_progress() as shown:

            def finished(step: str, count: int, all_: int, record: dict) -> None:
                done[step] = f"{step} {count} of {all_}"
                if keep is not None:
                    keep(replace(by_name[record["name"]], step=step), record)
                shown(step, count, all_, record)

            result = run_lot(jobs, out, make_pool, diagnose=diagnose, finished=finished, patience_s=time_limit_s + 60)
    except KeyboardInterrupt:
        words = ", ".join(done.values()) or "nothing"
        return f"femu-piezo: interrupted with {words} done; run the same command to continue\n", 130
    from femu_piezo.batch.lot import lot_text
    from femu_piezo.batch.report import write_report

    text = lot_text(write_report(result, out))
    text += f"results: {result.computed} computed now, {result.kept} kept → {out / 'table.csv'}\n"
    return text, 0 if result.count("ok") else 3


def _load_libraries() -> None:
    """Load what makes table and report; pyarrow loads pandas, where it is installed, with the first column."""
    import femu_piezo.batch.report  # noqa: F401

    as_parquet([{}], ["file"])
