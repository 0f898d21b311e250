"""The work of a worker process, local or of a cluster: one job in, one record out, never an exception of the job.

A record is JSON: {"name", "checksum", "status", "reason", "columns", "results"}. Status "ok" and "failed" (wrong
input, no convergence) are final for these inputs; "lost" (a dead worker, an unexpected error) is tried again by the
next run.
"""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits

from femu_piezo.batch.jobs import Job
from femu_piezo.batch.pool import THREAD_VARIABLES
from femu_piezo.errors import FemuPiezoError

FINAL = ("ok", "failed")

_one_at_a_time = threading.Lock()  # a cluster's worker may have several threads; gmsh and the shared bases may not
_shared_bases = None


def run_job(job: Job, checksum: str, program: str, limit_s: float | None = None) -> dict:
    """Compute one job.

    Parameters
    ----------
    checksum : of the job, as the caller computed it; another one here means that the files differ or have changed
    program : `program_checksum` of the caller
    limit_s : the process ends itself after so many seconds, whatever it hangs in; None for never
    """
    with _one_at_a_time, ended_after(limit_s):
        return _computed(job, checksum, program)


@contextmanager
def ended_after(limit_s: float | None) -> Iterator[None]:
    """End the whole process where the block takes longer, be it in a library that never returns; None: no limit."""
    if limit_s is not None:
        faulthandler.dump_traceback_later(limit_s, exit=True, file=_devnull())
    try:
        yield
    finally:
        if limit_s is not None:
            faulthandler.cancel_dump_traceback_later()


def record(job: Job, checksum: str, status: str, reason: str = "", columns=None, results=None) -> dict:
    """The record of a job in JSON types."""
    return {
        "name": job.name,
        "checksum": checksum,
        "status": status,
        "reason": reason,
        "columns": columns or {},
        "results": results or {},
    }


def _computed(job: Job, checksum: str, program: str) -> dict:
    from femu_piezo.batch.steps import STEPS

    inputs = job.read()
    if job.checksum(program, inputs.contents()) != checksum:
        return record(job, checksum, "lost", _changed(job))
    columns, results = {}, {}
    try:
        if inputs.error is not None:
            raise inputs.error
        columns["specimen"] = " + ".join(one.name for one in inputs.specimens)
        found, results[job.step] = STEPS[job.step](list(inputs.specimens), _bases())
        columns |= found
        status, reason = "ok", ""
    except FemuPiezoError as error:
        status, reason = "failed", str(error)
    except Exception as error:  # the lot goes on; the row says that this is no fault of the input
        status, reason = "lost", f"unexpected {type(error).__name__}: {' '.join(str(error).split()) or 'no message'}"
        results["traceback"] = traceback.format_exc()
    if job.checksum(program, inputs.contents()) != checksum:
        return record(job, checksum, "lost", _changed(job))
    return record(job, checksum, status, reason, columns, results)


def _changed(job: Job) -> str:
    return (
        f"{job.name}: its files changed during the work, or this worker sees other files than the machine that "
        "started the lot; leave them unchanged, on a file system that all workers share"
    )


def _bases():
    global _shared_bases
    if _shared_bases is None:
        from femu_piezo.study.model_cache import SharedBases

        _shared_bases = SharedBases()
    return _shared_bases


def _devnull():
    global _null
    try:
        return _null
    except NameError:
        _null = open(os.devnull, "w")  # noqa: SIM115 - kept open for the life of the process
        return _null


def start_local_worker() -> None:
    """Prepare a new local worker process: one thread; it ignores Ctrl-C, which the parent handles, and ends with it.

    Only where something else had started the process that workers fork from are there more threads until here.
    """
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    threadpool_limits(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warnings.simplefilter("ignore")
    sys.stdout = _devnull()
    parent = multiprocessing.parent_process()
    threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()
