"""Throughput of the batch on 1 and 2 processes and through Dask, memory, cost of a first and a further plate; kills.

    python tests/benchmarks/batch.py [sweeps, default 500] [kills, default 50]

On a machine that others use too, processor time per plate (of the workers, and of the process that feeds them) says
more than the rates. The sweeps are simulated by a reduced model on a finer mesh than the update uses, with scattered
constants and noise.
"""

from __future__ import annotations

import csv
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import psutil

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests" / "batch")]

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
    from femu_piezo.specimen import read_specimen
    from femu_piezo.study.inputs import prepare

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
    """Largest resident memory of any child process, MB, and processor time of all, s, sampled while the block runs."""

    def __enter__(self) -> Memory:
        self.largest, self._stop, self._seconds = 0.0, threading.Event(), {}
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stop.set()
        self._thread.join()

    @property
    def seconds(self) -> float:
        return sum(self._seconds.values())

    def _watch(self) -> None:
        while not self._stop.wait(0.5):
            for child in psutil.Process().children(recursive=True):
                try:
                    self.largest = max(self.largest, child.memory_info().rss / 1e6)
                    self._seconds[child.pid] = sum(child.cpu_times()[:2])
                except psutil.NoSuchProcess:
                    continue


def timed(jobs, out: Path, make_pool) -> dict[str, float]:
    """Rates of one run: over all, from the tenth plate on, and the time to the first result."""
    from femu_piezo.batch.run import run_lot

    stamps: list[float] = []
    start, own = time.perf_counter(), time.process_time()
    with Memory() as memory:
        result = run_lot(jobs, out, make_pool, finished=lambda *_: stamps.append(time.perf_counter() - start))
    assert result.count("ok") == len(jobs), result.rows
    skip = min(10, len(jobs) // 2)
    steady = 60 * (len(jobs) - skip) / (stamps[-1] - stamps[skip - 1])
    cost = {"worker": 1e3 * memory.seconds / len(jobs), "feeder": 1e3 * (time.process_time() - own) / len(jobs)}
    return cost | {"all": 60 * len(jobs) / stamps[-1], "steady": steady, "first": stamps[0], "MB": memory.largest}


def throughput(sweeps: Path, specimen: Path, folder: Path) -> None:
    """The table of rates."""
    from distributed import LocalCluster

    from femu_piezo.batch.cluster import DaskPool
    from femu_piezo.batch.jobs import find_jobs
    from femu_piezo.batch.pool import LocalPool

    jobs = find_jobs(sweeps, specimen)
    print(f"{len(jobs)} sweeps of 401 points; load {psutil.getloadavg()[0]:.1f} on {psutil.cpu_count()} cores")
    heads = ("plates/min", "after start", "efficiency", "first (s)", "MB/worker", "CPU ms", "feeding")
    print(f"{'':22s}" + "".join(f"{head:>12s}" for head in heads))
    base = None
    for name, workers in (("1 process", 1), ("2 processes", 2), ("Dask, 2 workers", 2)):
        out = folder / name.replace(" ", "_")
        if name.startswith("Dask"):
            with LocalCluster(workers, threads_per_worker=1, dashboard_address=None) as cluster:
                cluster.wait_for_workers(workers)
                found = timed(jobs, out, lambda address=cluster.scheduler_address: DaskPool(address))
        else:
            found = timed(jobs, out, lambda count=workers: LocalPool(count, None))
        base = base or found["steady"]
        share = found["steady"] / base / workers
        rates = f"{found['all']:12.0f}{found['steady']:12.0f}{share:12.2f}{found['first']:12.2f}"
        print(f"{name:22s}{rates}{found['MB']:12.0f}{found['worker']:12.0f}{found['feeder']:12.1f}")
    tables = {(folder / name / "table.csv").read_bytes() for name in ("1_process", "2_processes", "Dask,_2_workers")}
    print(f"different tables among the three: {len(tables)}")
    _costs(jobs)
    _accuracy(folder / "1_process" / "table.csv")


def _costs(jobs) -> None:
    """Time of the first plate and of the others in one process, without reading and start of processes."""
    from femu_piezo.study.bases import SharedBases
    from femu_piezo.study.update import update

    bases, seconds = SharedBases(), []
    for job in jobs[:20]:
        specimens = list(job.read().specimens)
        start = time.perf_counter()
        update(specimens, bases=bases)
        seconds.append(time.perf_counter() - start)
    print(f"first plate {seconds[0]:.3f} s, a further one {np.median(seconds[1:]):.3f} s")


def _accuracy(table: Path) -> None:
    with open(table, encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    spread = np.std([float(row["s11"]) for row in rows]) / np.mean([float(row["s11"]) for row in rows])
    print(f"s11 scatters by {spread:.2%} (put in: 1 %)")


def kills(folder: Path, count: int) -> None:
    """Kill the batch of a small lot `count` times at random moments, in runs of five; compare the tables."""
    from lots import kill_at_random, write_lot

    from femu_piezo.batch.command import run_batch

    sweeps, specimen = write_lot(folder, 60)
    run_batch(sweeps, folder / "whole", specimen, workers=2)
    reference = [(folder / "whole" / name).read_bytes() for name in ("table.csv", "table.parquet")]
    alive = same = 0
    for number in range(count):
        out = folder / f"killed{number}"
        alive += kill_at_random(sweeps, specimen, out, kills=1, seed=number, longest_s=8)
        same += [(out / name).read_bytes() for name in ("table.csv", "table.parquet")] == reference
    print(f"{count} kills ({alive} before its end): {same} identical tables after resume")


if __name__ == "__main__":
    sweeps_, kills_ = (int(item) for item in [*sys.argv[1:], *(500, 50)[len(sys.argv) - 1 :]])
    with tempfile.TemporaryDirectory() as place:
        if sweeps_:
            throughput(*make_lot(Path(place) / "lot", sweeps_), Path(place))
        if kills_:
            kills(Path(place) / "kills", kills_)
