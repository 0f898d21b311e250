"""A lot on four worker processes of Dask: one dies, one is slow, and the scheduler is restarted."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from lots import write_lot

from femu_piezo.batch.jobs import find_jobs
from femu_piezo.batch.run import run_lot

SWEEPS = 24


class Cluster:
    """A scheduler and four workers, each a process on the loopback address."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        self._folder, self.processes = folder, []

    def start(self) -> None:
        """Start the scheduler, at the same address as before, and the workers."""
        port = self.address.rsplit(":", 1)[1]
        self.processes = [self._run("scheduler", "--host", "127.0.0.1", "--port", port)]
        order = ["worker", self.address, "--nthreads", "1", "--no-nanny", "--local-directory", str(self._folder)]
        self.processes += [self._run(*order) for _ in range(4)]

    def stop(self) -> None:
        """Kill all processes."""
        for process in self.processes:
            process.kill()
            process.wait()

    def _run(self, command: str, *arguments: str) -> subprocess.Popen:
        order = [sys.executable, "-m", f"distributed.cli.dask_{command}", *arguments, "--no-dashboard"]
        with open(self._folder / "log", "ab") as log:
            return subprocess.Popen(order, stdout=log, stderr=log, env={**os.environ, "OMP_NUM_THREADS": "1"})


@pytest.mark.slow
def test_deaths_and_slowness_on_a_cluster_do_not_change_the_table(tmp_path):
    from femu_piezo.batch.cluster import DaskPool
    from femu_piezo.batch.pool import LocalPool

    jobs = find_jobs(*write_lot(tmp_path, SWEEPS))
    run_lot(jobs, tmp_path / "local", lambda: LocalPool(2, None))
    cluster, ended, workers = Cluster(tmp_path), threading.Event(), []

    def slow() -> None:
        """Stops the second worker for three quarters of the time."""
        while not ended.wait(0.1):
            victim = cluster.processes[2]
            victim.send_signal(signal.SIGSTOP)
            time.sleep(0.3)
            victim.send_signal(signal.SIGCONT)

    def finished(step: str, done: int, all_: int, record: dict) -> None:
        if done == 5:
            cluster.processes[1].kill()
        if done == 12:
            cluster.stop()
            cluster.start()

    def pool() -> DaskPool:
        found = DaskPool(cluster.address)
        found._client.wait_for_workers(4, timeout=60)
        workers.append(found.width)
        return found

    try:
        cluster.start()
        threading.Thread(target=slow, daemon=True).start()
        result = run_lot(jobs, tmp_path / "cluster", pool, finished=finished)
    finally:
        ended.set()
        cluster.stop()
    assert result.computed == SWEEPS == result.count("ok") and workers == [8]
    for name in ("table.csv", "table.parquet"):
        assert (tmp_path / "cluster" / name).read_bytes() == (tmp_path / "local" / name).read_bytes()
