"""Work that shares the cores: same results in the same order, errors come through, the user's limit is kept."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from femu_piezo.threads import Once, available_cores, in_parallel


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
    """Two pieces that wait for each other can only end together."""
    monkeypatch.setattr("femu_piezo.threads._cores", lambda: 2)
    both = threading.Barrier(2, timeout=10)
    assert sorted(in_parallel(lambda _: both.wait(), range(2))) == [0, 1]


def test_an_error_comes_through(monkeypatch):
    monkeypatch.setattr("femu_piezo.threads._cores", lambda: 2)
    with pytest.raises(ZeroDivisionError):
        list(in_parallel(lambda i: 1 / i, [1, 0, 2]))


def test_a_core_that_has_nothing_left_joins_work_within_work(monkeypatch):
    """The second of two pieces has two of its own, which can only end together, after the first has ended."""
    monkeypatch.setattr("femu_piezo.threads._cores", lambda: 2)
    both, first = threading.Barrier(2, timeout=10), threading.Event()

    def inner(_) -> int:
        assert first.wait(10)
        return both.wait()

    def outer(number: int) -> list[int]:
        if number == 0:
            first.set()
            return []
        return sorted(in_parallel(inner, range(2)))

    assert list(in_parallel(outer, range(2))) == [[], [0, 1]]


def test_work_within_work_counts_as_sharing_the_cores(monkeypatch):
    """On every thread, and no longer once it has ended."""
    monkeypatch.setattr("femu_piezo.threads._cores", lambda: 2)
    assert list(in_parallel(lambda _: available_cores(), range(4))) == [1] * 4
    assert (
        list(in_parallel(lambda _: list(in_parallel(lambda _: available_cores(), range(2))), range(2))) == [[1, 1]] * 2
    )
    assert available_cores() == 2


def test_what_was_not_asked_for_is_not_begun(monkeypatch):
    """Where a loop is left early, or interrupted."""
    monkeypatch.setattr("femu_piezo.threads._cores", lambda: 2)
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


def test_values_are_made_once_by_many_threads_and_the_latest_kept():
    made, values = [], Once(latest=2)

    def make(key):
        made.append(key)
        time.sleep(0.01)
        return key.upper()

    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda key: values.get(key, lambda: make(key)), "aaaabbbb"))
    assert found == [*"AAAABBBB"] and sorted(made) == ["a", "b"]
    for key in "abca":  # a asked for before b, whichever thread was last: c takes its place
        values.get(key, lambda key=key: make(key))
    assert sorted(made) == ["a", "a", "b", "c"]  # a was the oldest
    assert values.get("c", lambda: make("c")) == "C" and len(made) == 4
