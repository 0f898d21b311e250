"""Work shared by the cores: results in order, errors passed on, and the user's limit kept."""

from __future__ import annotations

import copy
import pickle
import threading
import time
import weakref
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from femu_piezo import threads
from femu_piezo.threads import Once, available_cores, by_columns, in_parallel, made_once


@pytest.mark.parametrize("cores", ["1", "2"])
def test_results_come_in_order(monkeypatch, cores):
    monkeypatch.setenv("OMP_NUM_THREADS", cores)
    assert list(in_parallel(lambda i: (time.sleep(0.02 * (5 - i)), i**2)[1], range(5))) == [0, 1, 4, 9, 16]
    assert list(in_parallel(abs, [])) == []


def test_one_core_is_a_plain_loop(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    own = threading.get_ident()
    assert set(in_parallel(lambda _: threading.get_ident(), range(4))) == {own}


def test_pieces_run_side_by_side(monkeypatch):
    """Two pieces of work that wait for each other can only end if they run at the same time."""
    monkeypatch.setattr("femu_piezo.threads.cores_of_process", lambda: 2)
    both = threading.Barrier(2, timeout=10)
    assert sorted(in_parallel(lambda _: both.wait(), range(2))) == [0, 1]


def test_an_error_is_passed_on(monkeypatch):
    monkeypatch.setattr("femu_piezo.threads.cores_of_process", lambda: 2)
    with pytest.raises(ZeroDivisionError):
        list(in_parallel(lambda i: 1 / i, [1, 0, 2]))


def test_an_idle_core_joins_nested_work(monkeypatch):
    """The second of two pieces has two inner pieces, which wait for each other and begin after the first piece has
    ended.
    """
    monkeypatch.setattr("femu_piezo.threads.cores_of_process", lambda: 2)
    both, first = threading.Barrier(2, timeout=10), threading.Event()

    def inner(_) -> int:
        assert first.wait(10)
        return both.wait()

    def outer(asks: bool) -> list[int]:
        if asks:
            return sorted(in_parallel(inner, range(2)))
        first.set()
        return []

    for pieces in (
        [False, True],
        [True, False],
    ):  # the nested work is in the piece of the calling thread, or in that of the helper
        first.clear()
        found = list(in_parallel(outer, pieces))
        assert sorted(found) == [[], [0, 1]]


def test_the_calling_thread_joins_the_nested_work_it_waits_for(monkeypatch):
    """The other thread has the last piece, whose two inner pieces wait for each other."""
    monkeypatch.setattr("femu_piezo.threads.cores_of_process", lambda: 2)
    both, begun, own = threading.Barrier(2, timeout=10), threading.Event(), threading.get_ident()

    def outer(_) -> list[int]:
        if threading.get_ident() == own:
            assert begun.wait(10)
            return []
        begun.set()
        return sorted(in_parallel(lambda _: both.wait(), range(2)))

    assert sorted(in_parallel(outer, range(2))) == [[], [0, 1]]


def test_nested_work_counts_as_sharing_the_cores(monkeypatch):
    """On every thread, and no longer once it has ended."""
    monkeypatch.setattr("femu_piezo.threads.cores_of_process", lambda: 2)
    assert list(in_parallel(lambda _: available_cores(), range(4))) == [1] * 4
    assert (
        list(in_parallel(lambda _: list(in_parallel(lambda _: available_cores(), range(2))), range(2))) == [[1, 1]] * 2
    )
    assert available_cores() == 2


def test_pieces_after_an_early_end_are_not_begun(monkeypatch):
    """A loop over results that is left early or interrupted."""
    monkeypatch.setattr("femu_piezo.threads.cores_of_process", lambda: 2)
    begun = []
    for _ in in_parallel(lambda n: (begun.append(n), time.sleep(0.01)), range(1000)):
        break
    assert len(begun) < 10

    def interrupted(number: int) -> None:
        begun.append(number)
        time.sleep(0.01)
        if threading.current_thread() is threading.main_thread():
            raise KeyboardInterrupt

    begun.clear()
    with pytest.raises(KeyboardInterrupt):
        list(in_parallel(interrupted, range(1000)))
    assert len(begun) < 10


def test_results_are_released(monkeypatch):
    """Results that were fetched, and all results of nested work that has ended, are freed."""
    monkeypatch.setattr("femu_piezo.threads.cores_of_process", lambda: 2)
    alive: weakref.WeakSet = weakref.WeakSet()

    class Large:
        def __init__(self) -> None:
            alive.add(self)

    def outer(_) -> int:
        for one in in_parallel(lambda _: Large(), range(4)):
            del one
        return len(alive)

    assert max(in_parallel(outer, range(20))) <= 2 * 4
    for number, one in enumerate(in_parallel(lambda _: Large(), range(50))):
        del one
        if number == 49:
            assert len(alive) <= 1


def test_a_loop_collected_as_garbage_in_its_own_helper_thread_ends(monkeypatch):
    monkeypatch.setattr("femu_piezo.threads.cores_of_process", lambda: 2)
    own, left, collected = threading.get_ident(), [], threading.Event()

    def piece(number: int) -> None:
        if number == 0 or threading.get_ident() == own:
            time.sleep(0.001)
            return
        while not left:
            time.sleep(0.001)
        left.pop().close()
        collected.set()

    loop = in_parallel(piece, range(1000))  # the helper may have the first piece, and this thread some more
    next(loop)
    left.append(loop)
    assert collected.wait(10)
    assert list(in_parallel(abs, [1, -2])) == [1, 2]


def test_work_by_columns_is_that_of_the_whole_matrix(monkeypatch):
    matrix, parts = np.random.default_rng(0).standard_normal((5, 41)), []

    def work(part: np.ndarray) -> np.ndarray:
        parts.append(part.shape[1])
        return np.vstack([2 * part, part[:1]])

    for cores, expected in ((1, [41]), (2, [20, 21]), (8, [8, 8, 8, 8, 9])):
        monkeypatch.setattr("femu_piezo.threads.cores_of_process", lambda cores=cores: cores)
        parts.clear()
        np.testing.assert_array_equal(by_columns(work, matrix), np.vstack([2 * matrix, matrix[:1]]))
        assert sorted(parts) == expected


class Thing:
    """An object with two properties made once, of which `late` fails the first time."""

    def __init__(self) -> None:
        self.made, self.failed = 0, False

    @made_once
    def value(self) -> int:
        """The words of it."""
        time.sleep(0.02)
        self.made += 1
        return self.made

    @made_once
    def late(self) -> str:
        if not self.failed:
            self.failed = True
            raise ValueError
        return "here"


def test_a_property_is_made_once_for_each_object():
    first, second = Thing(), Thing()
    with ThreadPoolExecutor(8) as pool:
        assert set(pool.map(lambda thing: thing.value, [first, second] * 8)) == {1}
    assert (first.made, second.made) == (1, 1) and Thing.value.__doc__ == "The words of it."


def test_objects_do_not_wait_for_each_other():
    barrier = threading.Barrier(2, timeout=10)

    class Waiting:
        @made_once
        def value(self) -> int:
            return barrier.wait()

    with ThreadPoolExecutor(2) as pool:
        assert sorted(pool.map(lambda thing: thing.value, [Waiting(), Waiting()])) == [0, 1]


def test_a_property_that_failed_is_tried_again():
    """No lock remains, and the object can be pickled and copied."""
    one = Thing()
    with pytest.raises(ValueError):
        one.late  # noqa: B018
    assert pickle.loads(pickle.dumps(one)).failed and copy.deepcopy(one).late == one.late == "here"
    assert not threads._making


def test_values_are_made_once_by_many_threads_and_the_latest_are_kept():
    made, values = [], Once(latest=2)

    def make(key):
        made.append(key)
        time.sleep(0.01)
        return key.upper()

    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda key: values.get(key, lambda: make(key)), "aaaabbbb"))
    assert found == [*"AAAABBBB"] and sorted(made) == ["a", "b"]
    for key in "abca":  # the order of use after the threads may be either; a is now used before b, so c replaces a
        values.get(key, lambda key=key: make(key))
    assert sorted(made) == ["a", "a", "b", "c"]  # a was the least recently used value and had to be made again
    assert values.get("c", lambda: make("c")) == "C" and len(made) == 4
