"""Commands killed at random times: files on disk are intact afterwards, and the same command resumes from them.

    python tests/benchmarks/kills.py [page|batch|measure|all] [kills of each, default 50] [seed, default 1]

page: a process works as the server does (`femu_piezo.web.jobs.Jobs`) on extractions and updates of one plate; after
each kill a new server completes a job. batch: lots of ten sweeps on two processes with a store; resumed, each
ends with the table and the store of an undisturbed run. measure: against a simulated analyser, five kills of
each measurement, with a store; no point on disk is lost, and the last run ends with all of them. Each command is
killed with its children by SIGKILL; then every JSON file must be readable and every picture complete.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import numpy as np

TESTS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TESTS.parent), str(TESTS), str(TESTS / "batch")]
PLATE = TESTS.parent / "tutorials" / "k31_plate"
SERVER = """
import sys, time
from pathlib import Path
from femu_piezo.web.jobs import Jobs
folder = Path(sys.argv[1])
(folder / ".femu-piezo").mkdir(exist_ok=True)
jobs = Jobs(folder, folder / ".femu-piezo", 2)
while True:
    for command, source in (("extract", "sweep.csv"), ("update", "plate.toml")):
        jobs.ask(command, source, f"results/{source}/{command}")
    time.sleep(0.05)
"""
#: Kills of each measurement, and number of its points.
SERIES, POINTS = 5, 96


def broken(folder: Path) -> list[str]:
    """Files that are damaged or incomplete."""
    found = []
    for path in sorted(folder.rglob("*")):
        if path.suffix == ".json":
            try:
                json.loads(path.read_text(encoding="utf-8"))
            except ValueError:
                found.append(str(path.relative_to(folder)))
        elif path.suffix == ".png" and not path.read_bytes().endswith(b"IEND\xaeB`\x82"):
            found.append(str(path.relative_to(folder)))
    return found


def killed(command: list[str], seconds: float) -> bool:
    """Start a command and kill it with its children after some seconds; whether it was still running."""
    process = subprocess.Popen(
        [sys.executable, *command], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    time.sleep(seconds)
    alive = process.poll() is None
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    return alive


def finished(command: list[str]) -> bool:
    """Run a command; whether it succeeds."""
    done = subprocess.run([sys.executable, *command], capture_output=True, text=True)
    if done.returncode:
        print(done.stderr)
    return done.returncode == 0


def page(count: int, draw: random.Random, folder: Path) -> Counter[str]:
    """Kills of a working server."""
    found: Counter[str] = Counter()
    for name in ("plate.toml", "sweep.csv"):
        shutil.copy(PLATE / name, folder)
    for _ in range(count):
        found["at work"] += killed(["-c", SERVER, str(folder)], draw.uniform(0.3, 6.0))
        found["files whole"] += not broken(folder)
        found["went on"] += _serves(folder)
    return found


def _serves(folder: Path) -> bool:
    """Whether a new server on the folder completes a job."""
    from femu_piezo.web.jobs import Jobs

    jobs = Jobs(folder, folder / ".femu-piezo", 1)
    try:
        job = jobs.ask("extract", "sweep.csv", "results/sweep.csv/extract")
        end = time.time() + 60
        while job.active and time.time() < end:
            time.sleep(0.05)
        return job.state == "done"
    finally:
        jobs.stop()


def batch(count: int, draw: random.Random, folder: Path) -> Counter[str]:
    """Kills of a lot, each in a run of its own."""
    from lots import write_lot

    sweeps, specimen = write_lot(folder, 10)

    def command(out: Path) -> list[str]:
        words = ["-m", "femu_piezo.cli", "batch", str(sweeps), "--specimen", str(specimen), "--workers", "2"]
        return [*words, "--out", str(out), "--store=sqlite"]

    def contents(out: Path) -> tuple[object, ...]:
        """Table in both formats and contents of the store."""
        return *((out / name).read_bytes() for name in ("table.csv", "table.parquet")), _kept(out)

    whole = folder / "whole"
    start = time.monotonic()
    assert finished(command(whole))
    longest, reference, found = time.monotonic() - start, contents(whole), Counter[str]()
    for number in range(count):
        out = folder / f"killed{number}"
        found["at work"] += killed(command(out), draw.uniform(0.3, longest))
        found["files whole"] += not out.exists() or not broken(out)
        found["went on"] += finished(command(out)) and contents(out) == reference
        shutil.rmtree(out)
    return found


def measure(count: int, draw: random.Random, folder: Path) -> Counter[str]:
    """Kills of measurements, several for each; the last run of a measurement counts for all of its kills."""
    from instruments.conftest import PLATE as SPECIMEN
    from instruments.conftest import analyser

    from femu_piezo.measurement.readers import read_spectrum

    specimen, found = folder / "plate.toml", Counter[str]()
    specimen.write_text(SPECIMEN, encoding="utf-8")
    with analyser(specimen) as running:
        words = ["-m", "femu_piezo.cli", "measure", str(specimen), "--instrument", running.address, "--speed", "1"]
        for first in range(0, count, SERIES):
            out, seen, whole = folder / f"out{first}", np.zeros(0), 0
            command = [*words, "--points", str(POINTS), "--out", str(out), "--store=sqlite"]
            kills = min(SERIES, count - first)
            for _ in range(kills):
                found["at work"] += killed(command, draw.uniform(1.0, 15.0))
                now = _points(out)
                whole += not out.exists() or not broken(out)
                found["lost a point"] += not np.array_equal(now[: seen.size], seen)
                seen = now
            found["files whole"] += whole
            done = finished(command) and np.all(np.isin(seen, read_spectrum(out / "sweep.csv").frequency))
            found["went on"] += kills * bool(done and running.is_off() and len(_kept(out)) == 1)
    return found


def _points(out: Path) -> np.ndarray:
    """Frequencies of the complete lines of points.csv, Hz."""
    path = out / "points.csv"
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    lines = text[: text.rfind("\n") + 1].splitlines()[1:]
    return np.array([float(line.split(",")[0]) for line in lines])


def _kept(out: Path) -> list[dict]:
    """Contents of the store of a folder, without the name of the lot and the time of writing."""
    from femu_piezo.store.database import Database
    from femu_piezo.store.read import read_pieces

    rows = read_pieces(Database("sqlite", out, make=False))
    return [{name: value for name, value in row.items() if name not in ("lot", "written")} for row in rows]


KINDS = {"page": page, "batch": batch, "measure": measure}


def main(kind: str, count: int, seed: int) -> None:
    """Print after how many kills the files are intact and the command resumes."""
    for name in KINDS if kind == "all" else [kind]:
        with tempfile.TemporaryDirectory() as place:
            found = KINDS[name](count, random.Random(seed), Path(place))
        told = ", ".join(f"{found[what]} {what}" for what in ("at work", "files whole", "went on"))
        print(f"{name}: {count} kills: {told}, {found['lost a point']} lost a point", flush=True)


if __name__ == "__main__":
    kind_, *numbers = [*sys.argv[1:], *("all", "50", "1")[len(sys.argv) - 1 :]]
    main(kind_, *map(int, numbers))
