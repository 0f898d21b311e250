"""Small lots with known constants, sweeps of exact 1-D k31 bars without any finite element model, and pools for
tests.
"""

from __future__ import annotations

import os
import random
import subprocess
import sys
import time
from concurrent.futures import Future
from pathlib import Path

import numpy as np
import psutil

from femu_piezo.measurement.readers import write_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from tests import k31_bar
from tests.noise import noisy

S11, D31, EPS33T = 16.5e-12 * (1 - 0.015j), -274e-12 * (1 - 0.013j), 3400 * 8.854e-12 * (1 - 0.016j)
FREQUENCY = np.linspace(26e3, 46e3, 121)

SPECIMEN = """
[geometry]
shape = "plate"
length = "40 mm"
width = "3 mm"
thickness = "0.5 mm"
density = "7500 kg/m^3"
poling = "thickness"
[material]
base = "pzt-5h"
[update]
accuracy = 1e-2
[measurement]
file = "{file}"
"""


def sweep(seed: int, scatter: float = 0.01, noise: float = 1e-3, width: float = 3e-3) -> ImpedanceSpectrum:
    """A noisy sweep of a bar whose constants scatter by the relative size `scatter`."""
    rng = np.random.default_rng(seed)
    s11, d31, eps = np.array([S11, D31, EPS33T]) * (1 + scatter * rng.standard_normal(3))
    z = k31_bar.impedance(2 * np.pi * FREQUENCY, (40e-3, width, 0.5e-3), 7500.0, s11, d31, eps)
    return ImpedanceSpectrum(FREQUENCY, noisy(z, noise, rng))


def write_lot(folder: Path, count: int) -> tuple[Path, Path]:
    """A folder of sweeps p1.csv …, and a specimen file next to that folder."""
    sweeps = folder / "sweeps"
    sweeps.mkdir(parents=True)
    for number in range(1, count + 1):
        write_spectrum(sweep(number), sweeps / f"p{number}.csv")
    specimen = folder / "bar.toml"
    specimen.write_text(SPECIMEN.format(file="sweeps/p1.csv"), encoding="utf-8")
    return sweeps, specimen


class InlinePool:
    """A pool that runs every task at once in this process, in the order in which tasks arrive."""

    lost_worker_errors = lost_connection_errors = ()
    breaks_whole = False
    bundle = 1
    limit_s = None
    width = 10_000

    def __init__(self) -> None:
        self.done: list[str] = []

    def answers(self) -> bool:
        return True

    def submit(self, function, *arguments) -> Future:
        future = Future()
        future.set_result(function(*arguments))
        self.done.append(arguments[0].name)
        return future

    def restart(self) -> None: ...

    def close(self) -> None: ...


def deadly(task: str, limit_s: float | None) -> dict:
    """Work for the pool: "die" ends the process, "sleep" hangs, "slow" takes 0.3 s, other tasks return at once."""
    from femu_piezo.batch.worker import ended_after

    with ended_after(limit_s):
        if task == "die":
            os._exit(7)
        time.sleep({"sleep": 600, "slow": 0.3}.get(task.split()[0], 0.0))
        return {"task": task, "threads": os.environ.get("OMP_NUM_THREADS")}


def kill_at_random(sweeps: Path, specimen: Path, out: Path, kills: int, seed: int, longest_s: float) -> int:
    """Start the batch and kill it by SIGKILL after random times, then let it finish; how often it was running when
    killed.

    Asserts that the worker processes of a killed batch end by themselves.
    """
    draw, killed = random.Random(seed), 0
    command = [sys.executable, "-m", "femu_piezo.cli", "batch", str(sweeps), "--specimen", str(specimen)]
    command += ["--out", str(out), "--workers", "2"]
    for _ in range(kills):
        process = psutil.Popen(command, stdout=subprocess.DEVNULL)
        time.sleep(draw.uniform(0.3, longest_s))
        if process.poll() is not None:
            continue
        children = process.children(recursive=True)
        process.kill()
        process.wait()
        killed += 1
        assert not psutil.wait_procs(children, timeout=20)[1], "workers outlived the batch"
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return killed
