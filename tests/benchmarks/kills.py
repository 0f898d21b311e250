"""The page's jobs killed at random moments: what is on disk afterwards is whole, and the next server goes on.

    python tests/benchmarks/kills.py [kills, default 50] [seed]

A process works as the server does (`femu_piezo.web.jobs.Jobs`) on extractions and updates of one plate, and is killed
with all its children. Then every JSON file reads, every picture ends as it should, nothing temporary is left that a new
server does not survive, and a job asked of that one comes to its end. Kills of `batch`: tests/benchmarks/batch.py.
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
from pathlib import Path

from femu_piezo.web.jobs import Jobs

PLATE = Path(__file__).resolve().parents[2] / "tutorials" / "k31_plate"
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
LONGEST_S = 6.0


def broken(folder: Path) -> list[str]:
    """Files that are not whole."""
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


def goes_on(folder: Path) -> bool:
    """Whether a new server on the folder brings a job to its end."""
    jobs = Jobs(folder, folder / ".femu-piezo", 1)
    try:
        job = jobs.ask("extract", "sweep.csv", "results/sweep.csv/extract")
        end = time.time() + 60
        while job.active and time.time() < end:
            time.sleep(0.05)
        return job.state == "done"
    finally:
        jobs.stop()


def main(count: int, seed: int) -> None:
    """Print how many kills left everything whole."""
    draw, found = random.Random(seed), Counter()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for name in ("plate.toml", "sweep.csv"):
            shutil.copy(PLATE / name, folder)
        for _ in range(count):
            server = subprocess.Popen([sys.executable, "-c", SERVER, str(folder)], start_new_session=True)
            time.sleep(draw.uniform(0.3, LONGEST_S))
            found["alive"] += server.poll() is None
            os.killpg(server.pid, signal.SIGKILL)
            server.wait()
            faults = broken(folder)
            found["broken"] += bool(faults)
            found["goes on"] += goes_on(folder)
            if faults:
                print(faults)
    print(f"{count} kills ({found['alive']} of a server at work): {found['broken']} left a broken file, ", end="")
    print(f"after {found['goes on']} the next server went on")


if __name__ == "__main__":
    main(*(int(item) for item in [*sys.argv[1:], *(50, 1)[len(sys.argv) - 1 :]]))
