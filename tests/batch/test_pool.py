"""Workers that die, hang or do not answer: the lot goes on, the culprit is named, and nothing is left running."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Future
from pathlib import Path

import pytest
from lots import InlinePool, deadly

from femu_piezo.batch.pool import LocalPool, run_all
from femu_piezo.errors import ConvergenceError


def outcome(tasks: list[str], workers: int = 2, limit_s: float | None = None, bundle: int = 1) -> dict[str, str]:
    """Task → "ok" or the reason why it has no result."""
    found = {}

    def finished(task, result, reason):
        assert task[0] not in found
        found[task[0]] = "ok" if result else reason

    pool = LocalPool(workers, limit_s)
    pool.bundle = bundle
    try:
        run_all(pool, deadly, [(task,) for task in tasks], finished, patience_s=60)
    finally:
        pool.close()
    return found


@pytest.mark.parametrize("bundle", [1, 3])
def test_a_dead_worker_costs_its_job_only(bundle):
    tasks = ["a 1", "slow 2", "die", "a 3", "slow 4", *(f"a {number}" for number in range(5, 20))]
    found = outcome(tasks, bundle=bundle)
    assert set(found) == set(tasks)
    assert "died" in found.pop("die")
    assert set(found.values()) == {"ok"}


def test_a_hang_ends_after_the_time_limit():
    found = outcome(["a 1", "sleep", "a 2"], workers=1, limit_s=1.5)
    assert "longer than the 1.5 s" in found["sleep"]
    assert found["a 1"] == found["a 2"] == "ok"


def test_workers_that_always_die_end_the_lot(monkeypatch):
    monkeypatch.setattr("femu_piezo.batch.pool._HOPELESS", 1)
    with pytest.raises(ConvergenceError, match="die at once"):
        outcome(["die"], workers=1)


def test_a_pool_that_does_not_answer_is_given_up():
    found = {}
    pool = LocalPool(1, None)
    try:
        run_all(pool, deadly, [("sleep",)], lambda task, result, reason: found.update({task[0]: reason}), patience_s=2)
    finally:
        pool.close()
    assert "no worker has answered for 2 s" in found["sleep"]


LOCAL_POOL = """
import multiprocessing, os

def threads():
    from femu_piezo.threads import cores_of_process
    return cores_of_process(), os.environ["RAYON_NUM_THREADS"]

if __name__ == "__main__":
    if {begun}:
        other = multiprocessing.get_context("forkserver").Process(target=int)
        other.start()
        other.join()
    before = dict(os.environ)
    from femu_piezo.batch.pool import LocalPool
    pool = LocalPool(1, None)
    print(*pool.submit(threads).result(), dict(os.environ) == before)
    pool.close()
"""


@pytest.mark.parametrize("begun", [False, True])
def test_workers_have_one_thread_and_the_caller_keeps_its_environment(begun, tmp_path):
    """Also where something else has started the process from which workers fork."""
    script = tmp_path / "script.py"
    script.write_text(LOCAL_POOL.format(begun=begun))
    free = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    ended = subprocess.run([sys.executable, script], capture_output=True, text=True, env=free, check=True)
    assert ended.stdout.split() == ["1", "1", "True"]


@pytest.mark.parametrize("after_s", [0.2, 0.5])
def test_ctrl_c_while_the_program_loads_ends_in_a_sentence(after_s, tmp_path):
    """No traceback of the process from which workers fork, which loads the program then."""
    command = [sys.executable, "-c", "from femu_piezo.batch.pool import load_program; load_program(); input()"]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True, cwd=tmp_path
    )
    time.sleep(after_s)
    os.killpg(process.pid, signal.SIGINT)
    told = process.communicate()[1]
    assert "forkserver" not in told


def test_a_restarted_scheduler_loses_no_task():
    """Tasks in flight are submitted again to the new scheduler."""
    from distributed import LocalCluster

    from femu_piezo.batch.cluster import DaskPool

    def cluster(port: int = 0) -> LocalCluster:
        settings = {"processes": False, "dashboard_address": None, "protocol": "tcp", "host": "127.0.0.1"}
        return LocalCluster(1, threads_per_worker=2, scheduler_port=port, **settings)

    found, clusters = {}, [cluster()]
    pool = DaskPool(clusters[0].scheduler_address)

    def finished(task, result, reason):
        assert task[0] not in found
        found[task[0]] = "ok" if result else reason
        if len(found) == 3:
            clusters[0].close()
            clusters.append(cluster(int(pool._address.rsplit(":", 1)[1])))

    tasks = [f"{kind} {number}" for number in range(6) for kind in ("a", "slow")]
    try:
        run_all(pool, deadly, [(task,) for task in tasks], finished, patience_s=60)
        assert found == dict.fromkeys(tasks, "ok")
    finally:
        pool.close()
        for one in clusters:
            one.close()


@pytest.mark.parametrize("error", [None, ValueError("a future of the old scheduler")], ids=["cancelled", "in error"])
def test_tasks_of_a_lost_scheduler_are_submitted_again(error):
    """Of two tasks in flight, one is cancelled or ends in an error, and the other is never answered; the next
    scheduler does both.
    """
    restarts, found = [], {}

    class Lost(InlinePool):
        width = 2

        def submit(self, function, *arguments) -> Future:
            future = Future()
            if restarts:
                future.set_result(function(*arguments))
            elif arguments[0] == "a 1" and error is not None:
                future.set_exception(error)
            elif arguments[0] == "a 1":
                future.cancel()
                future.set_running_or_notify_cancel()
            return future

        def answers(self) -> bool:
            return bool(restarts)

        def restart(self) -> None:
            restarts.append(1)

    tasks = [("a 1",), ("a 2",), ("a 3",)]
    run_all(Lost(), lambda task, limit: task, tasks, lambda task, result, _: found.update({task[0]: result}), 60)
    assert found == {"a 1": "a 1", "a 2": "a 2", "a 3": "a 3"} and restarts == [1]


@pytest.mark.parametrize("error", [ValueError("a defect"), OSError("a defect")])
def test_an_error_of_the_program_ends_a_lot_whose_scheduler_answers(error):
    class Wrong(InlinePool):
        def submit(self, function, *arguments) -> Future:
            future = Future()
            future.set_exception(error)
            return future

        def restart(self) -> None:
            raise AssertionError("tried again")

    with pytest.raises(type(error), match="a defect"):
        run_all(Wrong(), lambda task, limit: task, [("a 1",)], lambda *_: None, 60)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs the signal masks of /proc")
def test_a_mesh_does_not_make_broken_pipes_deadly():
    """gmsh resets SIGPIPE, so that a worker whose caller has ended would die silently at its next write; meshing
    restores the signal.
    """
    import signal

    from femu_piezo.geometry.gmsh_session import gmsh_session

    with gmsh_session("geo"):
        pass
    with open("/proc/self/status", encoding="ascii") as stream:
        ignored = next(int(line.split()[1], 16) for line in stream if line.startswith("SigIgn"))
    assert ignored >> (signal.SIGPIPE - 1) & 1
