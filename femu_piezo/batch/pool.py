"""Worker processes of this machine, the interface they share with those of a cluster, and the loop that feeds both.

The jobs in flight are lost with a worker that dies. Which of them killed it cannot be known, so they are tried again
one at a time: a job that kills its worker alone gets a row that says so, the others go on.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Protocol

from femu_piezo.errors import ConvergenceError, InputError

#: Jobs handed to each worker beyond the one it works on, so that it never waits for the next.
AHEAD = 1
#: Variables that keep a process to one thread of dense and sparse algebra; read when the libraries load.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS")
#: Module that workers need, which takes longest to load; and whether they can share one copy of it, loaded once by a
#: process without threads from which they fork.
_LOADED_ONCE, _FORKS = "femu_piezo.batch.steps", sys.platform == "linux"
#: Workers that may die one after the other, while no job succeeds, before the lot is given up.
_HOPELESS = 4


class Pool(Protocol):
    """Workers: `width` jobs at once, `submit` one, `restart` after a loss, `close` at the end.

    `answers` : whether the scheduler that hands jobs to the workers still runs and is the same one

    Attributes
    ----------
    lost_worker_errors : exceptions that mean a dead worker
    lost_connection_errors : exceptions that may mean a connection lost for a while; their tasks are tried again
    breaks_whole : whether all jobs in flight are lost when one worker dies
    bundle : most jobs that are handed to a worker at once; above 1 where handing over takes long
    limit_s : seconds after which a worker ends itself, None where it must not

    `restart` raises InputError where the workers do not come back; the waiting jobs are then left to the next run.
    """

    lost_worker_errors: tuple[type[BaseException], ...]
    lost_connection_errors: tuple[type[BaseException], ...]
    breaks_whole: bool
    bundle: int
    limit_s: float | None

    @property
    def width(self) -> int: ...

    def submit(self, function: Callable, *arguments) -> Future: ...

    def answers(self) -> bool: ...

    def restart(self) -> None: ...

    def close(self) -> None: ...


def load_program() -> None:
    """Begin to load what workers need, in the process from which they fork, where there is one; returns at once.

    Its libraries load for one thread: a process with threads cannot be forked safely.
    """
    if not _FORKS:
        return
    from multiprocessing import forkserver, resource_tracker

    resource_tracker.ensure_running()  # would unblock Ctrl-C below
    multiprocessing.set_forkserver_preload([_LOADED_ONCE])
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # Ctrl-C is for this process alone
    try:
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


class LocalPool:
    """`workers` processes of this machine, each on one thread; they end with this process, however it ends."""

    lost_worker_errors = (BrokenProcessPool,)
    lost_connection_errors = ()
    breaks_whole = True
    bundle = 1

    def __init__(self, workers: int, limit_s: float | None) -> None:
        self._workers, self.limit_s = workers, limit_s
        self._executor = self._new()

    def _new(self) -> Executor:
        from femu_piezo.batch.worker import start_local_worker  # loads what reads jobs, `load_program` comes before it

        load_program()
        context = multiprocessing.get_context("forkserver" if _FORKS else "spawn")
        return ProcessPoolExecutor(self._workers, mp_context=context, initializer=start_local_worker)

    @property
    def width(self) -> int:
        return self._workers * (1 + AHEAD)

    def submit(self, function: Callable, *arguments) -> Future:
        return self._executor.submit(function, *arguments)

    def answers(self) -> bool:
        return True

    def restart(self) -> None:
        self._end()
        self._executor = self._new()

    def close(self) -> None:
        self._end()

    def _end(self) -> None:
        processes = list((getattr(self._executor, "_processes", None) or {}).values())
        self._executor.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.kill()
        for process in processes:
            process.join()


def run_all(
    pool: Pool,
    function: Callable[..., dict],
    tasks: Sequence[tuple],
    finished: Callable[[tuple, dict | None, str], None],
    patience_s: float,
) -> None:
    """Run function(*task) for every task and report each once: finished(task, result, ""), or (task, None, reason).

    Parameters
    ----------
    patience_s : tasks in flight are given up where none has finished for so long

    Raises
    ------
    ConvergenceError : the workers die on every task, or the cluster is gone
    """
    _Dispatch(pool, function, tasks, finished, patience_s).run()


def in_turn(function: Callable[..., dict], tasks: Sequence[tuple], limit_s: float | None) -> list[dict]:
    """function(*task, limit_s) of several tasks, one after another."""
    return [function(*task, limit_s) for task in tasks]


class _Dispatch:
    def __init__(self, pool, function, tasks, finished, patience_s) -> None:
        self._pool, self._function, self._finished, self._patience = pool, function, finished, patience_s
        self._waiting, self._suspects = deque(tasks), deque()
        self._running: dict[Future, tuple[list[tuple], bool, float]] = {}
        self._succeeded = self._died = 0

    def run(self) -> None:
        while self._waiting or self._suspects or self._running:
            self._fill()
            done, _ = wait(self._running, timeout=self._patience, return_when=FIRST_COMPLETED)
            if not done:
                self._give_up()
                continue
            if any(self._is_lost(future) for future in done) and self._pool.breaks_whole:
                done, _ = wait(self._running)  # each is lost now, or had finished
            broken = [self._take(future) for future in done]
            if any(broken):
                self._restart()

    def _fill(self) -> None:
        """Start suspects one at a time; where there are none, as many waiting tasks as the pool takes."""
        try:
            if self._suspects:
                if not self._running:
                    self._start(self._suspects, 1, alone=True)
                return
            while self._waiting and len(self._running) < self._pool.width:
                # small bundles at the end, so that all workers finish together
                count = max(1, min(self._pool.bundle, len(self._waiting) // self._pool.width))
                self._start(self._waiting, count, alone=False)
        except BrokenProcessPool:  # a worker died while it was idle
            if not self._running:
                self._died += 1
                self._check_hope("")
                self._restart()
                self._fill()

    def _take_back(self, tasks: list[tuple]) -> None:
        """Queue tasks again, and all others in flight: lost with the scheduler, their futures may never say so."""
        for lost in (tasks, *(others for others, _, _ in self._running.values())):
            self._waiting.extendleft(reversed(lost))
        self._running.clear()

    def _restart(self) -> None:
        try:
            self._pool.restart()
        except InputError as error:
            raise ConvergenceError(
                f"the workers are gone ({error}); what is finished is kept, run the same command again to continue"
            ) from None

    def _start(self, queue: deque, count: int, alone: bool) -> None:
        tasks, limit = [queue[index] for index in range(count)], self._pool.limit_s
        if count == 1:
            future = self._pool.submit(self._function, *tasks[0], limit)
        else:
            future = self._pool.submit(in_turn, self._function, tasks, limit)
        for _ in tasks:
            queue.popleft()
        self._running[future] = (tasks, alone, time.monotonic())

    def _is_lost(self, future: Future) -> bool:
        return not future.cancelled() and isinstance(future.exception(), self._pool.lost_worker_errors)

    def _take(self, future: Future) -> bool:
        """Report the tasks of a future that is done; whether its worker was lost."""
        if future not in self._running:  # queued again together with another one
            return False
        tasks, alone, began = self._running.pop(future)
        if not self._is_lost(future):
            try:
                result = future.result()
            except Exception as error:
                if not isinstance(error, self._pool.lost_connection_errors) and self._pool.answers():
                    raise
                self._take_back(tasks)  # lost with the scheduler: no fault of the task
                return True
            self._succeeded += 1
            for task, one in zip(tasks, [result] if len(tasks) == 1 else result, strict=True):
                self._finished(task, one, "")
            return False
        if not alone:
            self._suspects.extend(tasks)
            return True
        task = tasks[0]
        elapsed, limit = time.monotonic() - began, self._pool.limit_s
        self._died += 1
        if limit is not None and elapsed >= limit:
            self._finished(
                task, None, f"it took longer than the {limit:g} s allowed, and was stopped; see --time-limit"
            )
        else:
            self._check_hope(str(future.exception()))
            self._finished(
                task, None, "the worker process died during this task (out of memory, or a crash of a library)"
            )
        return True

    def _check_hope(self, reason: str) -> None:
        if self._died >= _HOPELESS and not self._succeeded:
            raise ConvergenceError(
                f"the worker processes die at once, {self._died} one after the other {reason}; run `femu-piezo update` "
                "on one of the files to see why, and try fewer --workers if memory is short"
            )

    def _give_up(self) -> None:
        """Report all tasks in flight as lost: none has finished for too long (a cluster without workers, or a hang)."""
        for future, (tasks, _, _) in self._running.items():
            future.cancel()
            for task in tasks:
                self._finished(task, None, f"no worker has answered for {self._patience:g} s")
        self._running.clear()
        self._restart()
