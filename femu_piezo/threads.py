"""Threads: dense algebra on small matrices runs on one thread, sparse factorisations on as many as they gain from.

The reduced model works on matrices of order 100: a BLAS that wakes 64 threads for each of them is many times slower
than one thread, and two processes doing so on few cores stop each other. `blas_limit` keeps such sections to few
threads and restores the limits afterwards; it never raises a limit that the user has set. Independent pieces of such
work share the cores instead (`in_parallel`): the heavy parts of NumPy, SciPy and the factorisation let other threads
run.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from functools import lru_cache, wraps
from threading import Lock, RLock, local
from typing import Any, TypeVar

from threadpoolctl import ThreadpoolController

#: Unknowns below which one thread is fastest, and the most threads that an operator gains from.
_SMALL, _MOST_THREADS = 5_000, 4
#: Whether a thread is one of those of `in_parallel`, which share the cores.
_here = local()


Item = TypeVar("Item")
Result = TypeVar("Result")


@lru_cache(maxsize=1)
def _blas() -> ThreadpoolController:
    return ThreadpoolController().select(user_api="blas")


def blas_limit(threads: int = 1):
    """Context in which every BLAS of the process uses at most so many threads."""
    current = [library.num_threads for library in _blas().lib_controllers]
    if max(current, default=0) <= threads:
        return nullcontext()
    return _blas().limit(limits=min([threads, *current]))


def with_blas_limit(work: Callable[..., Result]) -> Callable[..., Result]:
    """The function within `blas_limit`: threads of a BLAS that wait for work take the cores from those that do it."""

    @wraps(work)
    def limited(*given, **named) -> Result:
        with blas_limit():
            return work(*given, **named)

    return limited


def available_cores() -> int:
    """Cores that this process may use; no more than OMP_NUM_THREADS where that is set, one where threads share them."""
    if getattr(_here, "shares", False):
        return 1
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    wish = os.environ.get("OMP_NUM_THREADS", "")
    return min(cores, int(wish)) if wish.isdigit() and int(wish) > 0 else cores


def useful_threads(unknowns: int) -> int:
    """Threads for one sparse operator: one for a small one, never more than the process may use."""
    return 1 if unknowns < _SMALL else min(available_cores(), _MOST_THREADS)


class Once:
    """Values by key, each made once however many threads ask for it.

    Parameters
    ----------
    latest : how many are kept, those used last; all where None
    """

    def __init__(self, latest: int | None = None) -> None:
        self._values: OrderedDict[Hashable, Any] = OrderedDict()
        self._locks: dict[Hashable, RLock] = {}
        self._guard, self._latest = Lock(), latest

    def get(self, key: Hashable, make: Callable[[], Result]) -> Result:
        """The value of a key, made by the first thread that asks for it."""
        with self._guard:
            if key in self._values:
                self._values.move_to_end(key)
                return self._values[key]
            lock = self._locks.setdefault(key, RLock())
        with lock:
            if key not in self._values:
                return self._keep(key, make())
        return self.get(key, make)

    def _keep(self, key: Hashable, value: Result) -> Result:
        with self._guard:
            self._values[key] = value
            while self._latest is not None and len(self._values) > self._latest:
                self._values.popitem(last=False)
        return value


def in_parallel(work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """work(item) of every item, in their order, on the available cores; the results are those of a plain loop.

    It is one where a thread that shares the cores with others asks for it.
    """
    items = list(items)
    threads = min(available_cores(), len(items))
    if threads < 2:
        yield from map(work, items)
        return
    with blas_limit(), ThreadPoolExecutor(threads, initializer=lambda: setattr(_here, "shares", True)) as pool:
        yield from pool.map(work, items)
