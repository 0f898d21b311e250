"""The workers of a Dask cluster as a pool.

Imported only where `--scheduler` asks for it: Dask is an optional dependency.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from contextlib import suppress

from distributed import Client, Worker, WorkerPlugin
from distributed.scheduler import KilledWorker

from femu_piezo.batch.jobs import program_checksum
from femu_piezo.batch.pool import AHEAD
from femu_piezo.errors import InputError

#: Seconds to wait for the answer of a scheduler, and after which its workers are counted again.
CONNECT_S, _COUNT_S = 20, 5.0
#: Seconds that a lost scheduler has to come back.
RETURN_S = 120
#: (parameter of mallopt, value): the largest thresholds that glibc reaches by itself on 64 bits where none is set.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = (-1, 64 << 20), (-3, 32 << 20)
#: Names of two periodic callbacks of a Dask worker, and the period of the second one during a lot, ms.
_SAMPLING, _TICK, _SLOW_TICK = "profile", "tick", 1000.0


class QuietWorker(WorkerPlugin):
    """Removes overhead of Dask from a worker while a lot runs on it; also from workers that join or restart later.

    The stack of a running task is not sampled (every 10 ms, a tenth of the time of a plate), the lag of the event
    loop is measured once a second (otherwise 50 times), and freed memory is kept for the next array. Dask sets glibc
    to return all free memory above 64 kB at once. This also ends the adaptation of the size from which glibc maps
    arrays afresh, so that the kernel zeroes them each time.
    """

    name = "femu-piezo-quiet"

    def setup(self, worker: Worker) -> None:
        """Called by Dask on every worker when the lot begins, or when the worker joins."""
        callbacks = worker.periodic_callbacks
        if _SAMPLING in callbacks:
            callbacks[_SAMPLING].stop()
        if _TICK in callbacks:
            self.tick = callbacks[_TICK].callback_time
            callbacks[_TICK].callback_time = max(self.tick, _SLOW_TICK)
        with suppress(AttributeError, OSError):  # another C library
            for option in (_MMAP_THRESHOLD, _TRIM_THRESHOLD):
                ctypes.CDLL(None).mallopt(*option)

    def teardown(self, worker: Worker) -> None:
        """Called by Dask when the lot is done: sampling and the measurement of lag go on as before."""
        callbacks = worker.periodic_callbacks
        if _SAMPLING in callbacks:
            callbacks[_SAMPLING].start()
        if _TICK in callbacks:
            callbacks[_TICK].callback_time = self.tick


class DaskPool:
    """The workers of a Dask scheduler, a `femu_piezo.batch.pool.Pool`; they must run this program, see the same files.

    Raises InputError where no scheduler answers, or its workers cannot serve.
    """

    lost_worker_errors = (KilledWorker,)
    lost_connection_errors = (CancelledError, OSError)
    breaks_whole = False
    bundle = 4  # handing over a single job costs some ms on either side
    limit_s = None

    def __init__(self, address: str) -> None:
        self._address = address
        self._open()

    def _open(self) -> None:
        address = self._address
        try:
            self._client = Client(address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(
                f"--scheduler {address}: no Dask scheduler answers there ({error or type(error).__name__}); start one "
                "by `dask scheduler` and give its address, such as tcp://host:8786"
            ) from None
        try:
            self._check()
            self._client.register_plugin(QuietWorker())
        except BaseException:
            self._client.close()
            raise
        self._scheduler = self._client.scheduler_info()["id"]
        self._executor = self._client.get_executor(pure=False)
        self._width, self._counted = 0, -_COUNT_S

    def _check(self) -> None:
        """InputError where there are no workers, or they run another program."""
        try:
            self._client.wait_for_workers(1, timeout=60)
            programs = self._client.run(program_checksum)
        except TimeoutError:
            raise InputError("--scheduler: the scheduler has no workers; start some by `dask worker`") from None
        except ImportError as error:
            raise InputError(f"--scheduler: a worker cannot import femu_piezo ({error}); install it there") from None
        for worker, program in programs.items():
            if program != program_checksum():
                raise InputError(
                    f"--scheduler: worker {worker} runs femu_piezo {program}, this machine {program_checksum()}; "
                    "install the same on all, and start the workers again"
                )

    @property
    def width(self) -> int:
        if time.monotonic() - self._counted > _COUNT_S:  # asking the scheduler takes too long to do it for every plate
            self._width = max(1, sum(self._client.nthreads().values())) * (1 + AHEAD)
            self._counted = time.monotonic()
        return self._width

    def submit(self, function: Callable, *arguments) -> Future:
        return self._executor.submit(function, *arguments)

    def restart(self) -> None:
        """Connect again where the scheduler was lost, also to a new one at its address; Dask replaces workers."""
        if self.answers():
            return
        self._client.close(timeout=1)
        end = time.monotonic() + RETURN_S
        while not self._returned(end):
            time.sleep(1)

    def _returned(self, end: float) -> bool:
        """Whether the connection could be opened again; InputError where not, after `end` (monotonic clock)."""
        try:
            self._open()
        except InputError:
            if time.monotonic() > end:
                raise
            return False
        return True

    def answers(self) -> bool:
        """Whether the scheduler is still the same one."""
        with suppress(OSError, TimeoutError, ValueError, RuntimeError):
            return self._client.status == "running" and self._client.scheduler_info()["id"] == self._scheduler
        return False

    def close(self) -> None:
        self._executor.shutdown(wait=False)
        with suppress(OSError, TimeoutError, ValueError):  # the cluster is gone
            self._client.unregister_worker_plugin(QuietWorker.name)
        self._client.close()
