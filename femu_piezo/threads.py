"""Threads: dense algebra on small matrices runs on one thread, sparse factorisations on as many as they gain from.

The reduced model works on matrices of order 100: a BLAS that wakes 64 threads for each of them is many times slower
than one thread, and two processes doing so on few cores stop each other. `blas_limit` keeps such sections to few
threads and restores the limits afterwards; it never raises a limit that the user has set. Independent pieces of such
work share the cores instead (`in_parallel`): the heavy parts of NumPy, SciPy and the factorisation let other threads
run.
"""

from __future__ import annotations

import os
from collections import OrderedDict, deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import nullcontext
from functools import lru_cache, wraps
from importlib import import_module
from itertools import pairwise
from threading import Event, Lock, RLock, Thread, current_thread, get_ident, local, main_thread
from types import ModuleType
from typing import Any, Generic, TypeVar, overload

import numpy as np
from threadpoolctl import ThreadpoolController

#: Unknowns below which one thread is fastest, and the most threads that an operator gains from.
_SMALL, _MOST_THREADS = 5_000, 4
#: Columns below which a part of a matrix is not worth a thread.
_COLUMNS = 8
#: Seconds after which a thread that waits for a result looks again for work.
_PATIENCE = 0.02
#: Its `share` is the `_Shared` of which this thread works on an item; missing or None outside of `in_parallel`.
_here = local()


def import_to_stay(name: str) -> ModuleType:
    """Import a module in a thread that lasts as long as the process: the main one, or a new one that then waits.

    The allocator of some libraries (mimalloc 3, in rslab 1.7) takes the thread that loads it for the main one and frees
    what all threads share when that thread ends. The next thread that allocates then ends the process.

    Raises what the import raises.
    """
    if current_thread() is main_thread():
        return import_module(name)
    loaded: Future[ModuleType] = Future()

    def stay() -> None:
        try:
            loaded.set_result(import_module(name))
        except BaseException as error:
            loaded.set_exception(error)
        else:
            Event().wait()

    Thread(target=stay, name=f"loaded {name}", daemon=True).start()
    return loaded.result()


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
    """The function, run within `blas_limit`, as BLAS threads that wait for work take the cores from working threads."""

    @wraps(work)
    def limited(*given, **named) -> Result:
        with blas_limit():
            return work(*given, **named)

    return limited


def available_cores() -> int:
    """Cores for the calling thread: `cores_of_process`, but one within `in_parallel`, where threads share them."""
    return cores_of_process() if getattr(_here, "share", None) is None else 1


def cores_of_process() -> int:
    """Cores that the threads of this process may use together; no more than OMP_NUM_THREADS where that is set."""
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
    latest : number of values that are kept, those used last; all where None
    """

    def __init__(self, latest: int | None = None) -> None:
        self._values: OrderedDict[Hashable, Any] = OrderedDict()
        self._locks: dict[Hashable, RLock] = {}
        self._guard, self._latest = Lock(), latest

    def __reduce__(self) -> tuple[type[Once], tuple[int | None]]:
        """Copies and pickles begin without values, as locks have none."""
        return Once, (self._latest,)

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
                self._locks.pop(self._values.popitem(last=False)[0], None)
        return value


class made_once(Generic[Result]):
    """A property that is made once for each object, however many threads ask for it.

    With functools.cached_property, all objects of a class wait for each other before Python 3.12; since then, threads
    that ask at the same time make the value twice.
    """

    def __init__(self, make: Callable[[Any], Result]) -> None:
        self._make, self._name = make, ""
        self.__doc__ = make.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    @overload
    def __get__(self, one: None, owner: type) -> made_once[Result]: ...

    @overload
    def __get__(self, one: object, owner: type) -> Result: ...

    def __get__(self, one: Any, owner: type) -> made_once[Result] | Result:
        if one is None:
            return self
        kept, key = one.__dict__, (id(one), self._name)
        try:
            with _making.setdefault(key, RLock()):
                if self._name not in kept:
                    kept[self._name] = self._make(one)
        finally:
            _making.pop(key, None)
        return kept[self._name]


#: Locks of the properties (object, name) that are being made.
_making: dict[tuple[int, str], RLock] = {}


def in_parallel(work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """work(item) of every item, in their order, on the available cores; the results are those of a plain loop.

    The calling thread takes items as well. Calls within `work` share the same helper threads: a helper without further
    items goes on with those of the next call, and a thread that waits for a result takes items of its call or of calls
    within it.
    """
    items = list(items)
    threads = min(cores_of_process(), len(items))
    if threads < 2:
        yield from map(work, items)
        return
    shared, helpers = _Shared(work, items), []
    with blas_limit():
        try:
            for _ in range(threads - 1):
                helpers.append(_helpers(cores_of_process() - 1).submit(shared.take_all))
            while shared.results:
                result = shared.results[0]
                while not result.done():
                    if not shared.help():
                        wait([result], _PATIENCE)
                yield shared.results.popleft().result()
        finally:
            shared.close(helpers)


def by_columns(work: Callable[[np.ndarray], np.ndarray], matrix: np.ndarray) -> np.ndarray:
    """work(matrix), (m, k), of a matrix (n, k) whose columns are independent, a part of the columns on each core."""
    parts = min(available_cores(), matrix.shape[1] // _COLUMNS)
    if parts < 2:
        return work(matrix)
    ends = np.linspace(0, matrix.shape[1], parts + 1).astype(int)
    every = in_parallel(lambda ends_of_part: work(matrix[:, slice(*ends_of_part)]), pairwise(ends))
    return np.hstack(list(every))


class _Shared(Generic[Item, Result]):
    """The items of one call of `in_parallel`, which threads take one after another until `close`.

    Attributes
    ----------
    results : of the items that were not yielded yet, in their order
    """

    def __init__(self, work: Callable[[Item], Result], items: list[Item]) -> None:
        self.results: deque[Future[Result]] = deque(Future() for _ in items)
        self._work, self._left = work, deque(zip(items, self.results, strict=True))
        self._within: list[_Shared] = []  # of calls of `in_parallel` that its items make
        self._helping: set[int] = set()
        self._around: _Shared | None = getattr(_here, "share", None)  # in whose item this call is made
        if self._around is not None:
            self._around._within.append(self)

    def take(self) -> bool:
        """Do the next item; whether there was one."""
        try:
            item, result = self._left.popleft()
        except IndexError:
            return False
        before, _here.share = getattr(_here, "share", None), self
        try:
            result.set_result(self._work(item))
        except BaseException as error:
            result.set_exception(error)
            if not isinstance(error, Exception):
                raise
        finally:
            _here.share = before
        return True

    def take_all(self) -> None:
        """Do items until none are left."""
        self._helping.add(get_ident())
        while self.take():
            pass

    def help(self) -> bool:
        """Do an item of this call or of a call within its items; whether there was one.

        An item of another call might wait for a value that the calling thread itself is making.
        """
        return self.take() or any(one.help() for one in tuple(self._within))

    def close(self, helpers: Sequence[Future[None]]) -> None:
        """Begin no further item, and wait for those that helpers have begun."""
        self._left.clear()
        for helper in helpers:
            # a call collected as garbage may be closed by one of its own helpers, which must not wait for itself
            if not helper.cancel() and get_ident() not in self._helping:
                helper.result()
        if self._around is not None:
            self._around._within.remove(self)
        # the executor keeps a cancelled helper, and with it this object, until a thread is free
        self.results.clear()
        del self._work


@lru_cache(maxsize=4)
def _helpers(threads: int) -> ThreadPoolExecutor:
    """The pool of helper threads, kept, so that calls of `in_parallel` within each other share it."""
    return ThreadPoolExecutor(threads)
