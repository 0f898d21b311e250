"""Throughput of `batch` on 1 and 2 processes and through Dask, its memory, and the cost of a first and a further plate.

    python tests/benchmarks/batch.py [sweeps, default 500] [most seconds of the rates, default 3600]
    python tests/benchmarks/batch.py growth [sweeps, default 100 1000 10000]

The second form measures everything but the fits: finding, checking and distributing the different sweeps of a lot, and
writing records, table, report and store. Its pool answers every update with the same record.

On a shared machine the column "others" (cores kept busy by other programs) shows how far the rates can be trusted;
processor time per plate (of the workers, and of the process that feeds them) depends on it less. The sweeps
are simulated by a reduced model on a finer mesh than the update uses, with scattered constants and noise.
"""

from __future__ import annotations

import csv
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import Future
from pathlib import Path

import numpy as np
import psutil

ROOT = Path(__file__).resolve().parents[2]
#: Plates that are computed in one way before the next way has its turn.
ROUND = 25

SPECIMEN = """
name = "plate"
[geometry]
shape = "plate"
length = "40 mm"
width = "5 mm"
thickness = "1 mm"
density = "7900 kg/m^3"
poling = "thickness"
[material]
base = "pzt-5h"
tan_s11 = 0.015
tan_d31 = 0.013
tan_eps33T = 0.016
[measurement]
file = "sweeps/p1.csv"
"""


def make_lot(folder: Path, count: int) -> tuple[Path, Path]:
    """`count` sweeps of plates whose constants scatter by 1 to 2 %, 401 points, relative noise 1e-3."""
    from femu_piezo.forward.reduction import reduce_model
    from femu_piezo.measurement.readers import write_spectrum
    from femu_piezo.measurement.spectrum import ImpedanceSpectrum
    from femu_piezo.specimen.file import read_specimen
    from femu_piezo.study.problem import prepare

    (folder / "sweeps").mkdir(parents=True)
    specimen = folder / "plate.toml"
    specimen.write_text(SPECIMEN, encoding="utf-8")
    problem, frequency = prepare(read_specimen(specimen)), np.linspace(5e3, 120e3, 401)
    truth, rng = problem.constants, np.random.default_rng(1)
    free = problem.free(truth)
    reduced = reduce_model(problem.model(1.3 * frequency[-1], 1e-5), free.training_sets(free.start, 0.2), frequency[-1])
    for number in range(1, count + 1):
        factors = dict(zip(("s11", "d31", "eps33T"), 1 + rng.standard_normal(3) * [0.01, 0.02, 0.02], strict=True))
        constants = truth.with_values(**{name: getattr(truth, name) * factor for name, factor in factors.items()})
        noise = 1e-3 * (rng.standard_normal((frequency.size, 2)) @ [1, 1j]) / np.sqrt(2)
        impedance = reduced.impedance(constants.to_e_form(), frequency) * (1 + noise)
        write_spectrum(ImpedanceSpectrum(frequency, impedance), folder / "sweeps" / f"p{number}.csv")
    return folder / "sweeps", specimen


class Memory:
    """Largest resident memory of any child process, MB, sampled while the block runs; and the processor time of
    children.
    """

    def __enter__(self) -> Memory:
        self.largest, self._stop = 0.0, threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stop.set()
        self._thread.join()

    @staticmethod
    def now() -> float:
        """Processor time of all children so far, s."""
        return sum(sum(child.cpu_times()[:2]) for child in psutil.Process().children(recursive=True))

    def _watch(self) -> None:
        while not self._stop.wait(0.5):
            for child in psutil.Process().children(recursive=True):
                try:
                    self.largest = max(self.largest, child.memory_info().rss / 1e6)
                except psutil.NoSuchProcess:
                    continue


class Kept:
    """A pool that stays open when `run_lot` closes it."""

    def __init__(self, pool) -> None:
        self._pool = pool

    def __getattr__(self, name: str):
        return getattr(self._pool, name)

    def close(self) -> None: ...


def timed(jobs, out: Path, pool) -> dict[str, float]:
    """Figures of one run on workers that are already started.

    Plates per minute, s to the first result, ms of processor time per plate, and number of cores kept busy by others.
    """
    from femu_piezo.batch.run import run_lot

    stamps: list[float] = []
    start, own = time.perf_counter(), time.process_time()
    with Memory() as memory:
        before, busy = memory.now(), _busy()
        result = run_lot(jobs, out, lambda: pool, finished=lambda *_: stamps.append(time.perf_counter() - start))
        spent, others = memory.now() - before, _busy() - busy
    others -= spent + time.process_time() - own
    assert result.count("ok") == len(jobs), result.rows
    cost = {"worker": 1e3 * spent / len(jobs), "feeder": 1e3 * (time.process_time() - own) / len(jobs)}
    cost |= {"others": others / stamps[-1], "rate": 60 * len(jobs) / stamps[-1]}
    return cost | {"first": stamps[0], "MB": memory.largest}


def _busy() -> float:
    """Processor time of all programs of the machine, s."""
    times = psutil.cpu_times()
    return times.user + times.nice + times.system


def throughput(sweeps: Path, specimen: Path, folder: Path, budget_s: float) -> None:
    """Print the table of rates. In every round each of the three ways computes the same plates in turn."""
    from contextlib import ExitStack

    from distributed import LocalCluster

    from femu_piezo.batch.cluster import DaskPool
    from femu_piezo.batch.jobs import find_jobs
    from femu_piezo.batch.pool import LocalPool
    from femu_piezo.batch.run import run_lot

    jobs = find_jobs(sweeps, specimen)
    print(f"{len(jobs)} sweeps of 401 points; load {psutil.getloadavg()[0]:.1f} on {psutil.cpu_count()} cores")
    with ExitStack() as stack:
        before = dict(os.environ)
        cluster = stack.enter_context(LocalCluster(2, threads_per_worker=1, dashboard_address=None))
        cluster.wait_for_workers(2)
        for name in set(os.environ) - set(
            before
        ):  # Dask sets options of malloc, which the local processes must not inherit
            del os.environ[name]
        pools = {"1 process": LocalPool(1, None), "2 processes": LocalPool(2, None)}
        pools["Dask, 2 workers"] = DaskPool(cluster.scheduler_address)
        for pool in pools.values():
            stack.callback(pool.close)
        rounds = [jobs[start : start + ROUND] for start in range(0, len(jobs), ROUND)]
        found, began = {name: [] for name in pools}, time.perf_counter()
        for part in rounds:
            if len(found["1 process"]) > 1 and time.perf_counter() - began > budget_s:
                break
            for name, pool in pools.items():
                found[name].append(timed(part, folder / name.replace(" ", "_"), Kept(pool)))
    jobs = jobs[: sum(len(part) for part in rounds[: len(found["1 process"])])]
    heads = ("plates/min", "efficiency", "first (s)", "MB/worker", "CPU ms", "feeding", "others")
    print(f"{'':18s}" + "".join(f"{head:>12s}" for head in heads))
    quiet = _quietest(found)
    for name, runs in found.items():
        rate, cpu, feeder, others = (
            np.median([runs[i][key] for i in quiet]) for key in ("rate", "worker", "feeder", "others")
        )
        workers = 1 if name == "1 process" else 2
        share = np.median([runs[i]["rate"] / found["1 process"][i]["rate"] / workers for i in quiet])
        print(
            f"{name:18s}{rate:12.0f}{share:12.2f}{runs[0]['first']:12.2f}"
            f"{max(run['MB'] for run in runs):12.0f}{cpu:12.0f}{feeder:12.1f}{others:12.2f}"
        )
    tables = set()
    for name in found:
        out = folder / name.replace(" ", "_")
        assert run_lot(jobs, out, lambda: None).computed == 0
        tables.add((out / "table.csv").read_bytes())
    print(
        f"different tables among the three: {len(tables)}; medians of {len(quiet)} of {len(found['1 process'])} rounds "
        f"of {ROUND} plates, those in which other programs used least of the machine, the first left out"
    )
    _costs(jobs)
    _accuracy(folder / "1_process" / "table.csv")


def _quietest(found: dict[str, list[dict[str, float]]]) -> list[int]:
    """Half of the rounds, without the first: those in which other programs kept the fewest cores busy."""
    worst = np.max([[run["others"] for run in runs] for runs in found.values()], axis=0)
    order = [int(i) for i in np.argsort(worst) if i or worst.size == 1]
    return order[: max(1, (len(order) + 1) // 2)]


def _costs(jobs) -> None:
    """Print the time of the first plate and of further ones in one process, without reading files and starting
    processes.
    """
    from femu_piezo.study.model_cache import SharedBases
    from femu_piezo.study.update import update

    bases, seconds = SharedBases(), []
    for job in jobs[:20]:
        specimens = list(job.read().specimens)
        start = time.perf_counter()
        update(specimens, bases=bases)
        seconds.append(time.perf_counter() - start)
    print(f"first plate {seconds[0]:.3f} s, a further one {np.median(seconds[1:]):.3f} s")


def _accuracy(table: Path) -> None:
    """Print the scatter of s11 over the lot."""
    with open(table, encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    spread = np.std([float(row["s11"]) for row in rows]) / np.mean([float(row["s11"]) for row in rows])
    print(f"s11 scatters by {spread:.2%} (put in: 1 %)")


class Ready:
    """A pool that answers every update with the same record."""

    lost_worker_errors, lost_connection_errors, breaks_whole, bundle, limit_s, width = (), (), False, 1, None, 4

    def __init__(self, record: dict) -> None:
        self._record = record

    def submit(self, function, job, checksum, *rest) -> Future:
        """The record under the name of the job, at once."""
        future: Future = Future()
        future.set_result(self._record | {"name": job.name, "checksum": checksum})
        return future

    def answers(self) -> bool:
        """Always: there is no scheduler."""
        return True

    def restart(self) -> None: ...

    def close(self) -> None: ...


def growth(count: int, folder: Path) -> None:
    """Print a line of the table: ms per sweep of a lot without its fits, first run and resumed, with a store, and
    memory.
    """
    from femu_piezo.batch.jobs import find_jobs, program_checksum
    from femu_piezo.batch.report import write_report
    from femu_piezo.batch.run import run_lot
    from femu_piezo.batch.worker import run_job
    from femu_piezo.measurement.readers import read_spectrum, write_spectrum
    from femu_piezo.measurement.spectrum import ImpedanceSpectrum
    from femu_piezo.store.command import show_lots
    from femu_piezo.store.write import lot_keeper

    sweeps, specimen = make_lot(folder, 1)
    one = read_spectrum(sweeps / "p1.csv")
    for number in range(2, count + 1):
        other = ImpedanceSpectrum(one.frequency, one.impedance * (1 + 1e-9 * number))
        write_spectrum(other, sweeps / f"p{number}.csv")
    jobs, program, out = find_jobs(sweeps, specimen), program_checksum(), folder / "out"
    record = run_job(jobs[0], jobs[0].checksum(program, jobs[0].read().contents()), program)
    assert record["status"] == "ok", record
    by_name, before = {job.name: job for job in jobs}, _peak()

    def kept() -> None:
        with lot_keeper("sqlite", out, "lot") as keep:
            run_lot(jobs, out, no_pool, finished=lambda step, n, all_, one: keep(by_name[one["name"]], one))

    def no_pool():
        raise AssertionError("everything was there")

    seconds, steps = (
        [],
        (
            lambda: run_lot(jobs, out, lambda: Ready(record)),
            lambda: write_report(run_lot(jobs, out, no_pool), out),
            kept,
            kept,
            lambda: show_lots(str(out), folder / "lots"),
        ),
    )
    for step in steps:
        start = time.process_time()
        step()
        seconds.append(time.process_time() - start)
    size = (out / "store.sqlite").stat().st_size / count
    print(
        f"{count:8d}" + "".join(f"{1e3 * one / count:12.2f}" for one in seconds) + f"{before:10.0f}{_peak():10.0f}"
        f"{size / 1e3:10.1f}"
    )


def _peak() -> float:
    """Largest memory of this process so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def _growths(counts: list[str]) -> None:
    """Measure each number of sweeps in a process of its own."""
    print("CPU ms per sweep, MB, kB per sweep")
    heads = ("first run", "resumed", "into store", "once more", "lots")
    print(" " * 8 + "".join(f"{head:>12s}" for head in heads) + "    before      peak     store", flush=True)
    for count in counts:
        subprocess.run([sys.executable, __file__, "one-growth", count], check=True)


if __name__ == "__main__" and sys.argv[1:2] == ["growth"]:
    _growths(sys.argv[2:] or ["100", "1000", "10000"])
elif __name__ == "__main__" and sys.argv[1:2] == ["one-growth"]:
    with tempfile.TemporaryDirectory() as place:
        growth(int(sys.argv[2]), Path(place) / "lot")
elif __name__ == "__main__":
    sweeps_, budget = (int(item) for item in [*sys.argv[1:], *(500, 3600)[len(sys.argv) - 1 :]])
    with tempfile.TemporaryDirectory() as place:
        throughput(*make_lot(Path(place) / "lot", sweeps_), Path(place), budget)
