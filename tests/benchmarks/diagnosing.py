"""Time that the steps of `diagnose` take, for nulls, single hidden effects and a pair, alone and on a shared basis.

    python tests/benchmarks/diagnosing.py
    OMP_NUM_THREADS=1 python tests/benchmarks/diagnosing.py
    python tests/benchmarks/diagnosing.py FOLDER          every case in FOLDER/*/specimen.toml, in a process of its own

Each row is a whole diagnosis in this process, reading and planning included, with a basis of its own and, in the last
column but one, on the basis of an earlier diagnosis of its set-up. Without OMP_NUM_THREADS independent work shares the
cores. Takes some minutes. Of the cases in a folder the peak memory after every step is shown as well.
"""

from __future__ import annotations

import multiprocessing
import resource
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from hidden_effects.draws import draw
from rich.console import Console
from rich.table import Table

from femu_piezo.specimen.file import Specimen, read_specimen
from femu_piezo.study.diagnose import Diagnosis, diagnose
from femu_piezo.study.model_cache import Bases, SharedBases
from femu_piezo.threads import available_cores

#: Draws by name and seed, from set-ups with different noise, one of them a bar.
DRAWS = (
    ("none", 9000),
    ("none", 9003),
    ("none", 9001),
    ("none", 9005),
    ("leakage", 9000),
    ("wrong_thickness", 9003),
    ("mounting", 9001),
    ("local_crack", 9002),
    ("electrode_mass", 9005),
    ("poling_gradient+tapered_width", 9006),
)
STEPS = ("start", "reduce", "fit", "compare", "plan")
CONSOLE = Console(width=130)


def seconds(specimen: Specimen, bases: Bases) -> tuple[float, Diagnosis]:
    """Seconds of a diagnosis, and its result."""
    begin = time.perf_counter()
    result = diagnose(specimen, bases=bases)
    return time.perf_counter() - begin, result


def row(name: str, seed: int) -> list[str]:
    """A row of the table: a draw diagnosed alone, then twice on shared bases."""
    hidden = draw(name, seed)
    with tempfile.TemporaryDirectory() as folder:
        specimen = read_specimen(hidden.write(Path(folder)))
        alone, result = seconds(specimen, Bases())
        shared = SharedBases()
        seconds(specimen, shared)
        again = seconds(specimen, shared)[0]
    said = " + ".join(cause.effect.title for cause in result.verdict.causes) or result.verdict.word
    steps = [f"{result.seconds.get(step, 0.0):.1f}" for step in STEPS]
    size = [f"{result.unknowns}", f"{result.reduced_size}"]
    return [f"{name}:{seed}", f"{100 * hidden.noise:.2f} %", *size, *steps, f"{alone:.1f}", f"{again:.1f}", said]


def case(path: Path) -> list[str]:
    """A row of the table for a case in a folder: seconds / peak memory (GB) of every step and of the whole."""
    peaks, running = {}, [""]

    def progress(step: str) -> None:
        if step in (*STEPS, "mesh and assemble", "verdict", ""):  # a step, not a candidate tried within a step
            peaks[running[0]] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
            running[0] = step

    begin = time.perf_counter()
    result = diagnose(read_specimen(path), progress=progress)
    progress("")
    said = " + ".join(cause.effect.title for cause in result.verdict.causes) or result.verdict.word
    steps = [f"{result.seconds.get(step, 0.0):.1f} / {peaks.get(step, 0.0):.1f}" for step in STEPS]
    whole = f"{time.perf_counter() - begin:.1f} / {max(peaks.values()):.1f}"
    return [path.parent.name, f"{result.unknowns}", f"{result.reduced_size}", *steps, whole, said]


def cases(folder: Path) -> Table:
    """The table of all cases, each diagnosed in a new process, one after another."""
    table = Table(title=f"diagnose, seconds / peak GB, {available_cores()} cores", title_justify="left")
    for heading in ("case", "unknowns", "r", *STEPS, "all", "said"):
        table.add_column(heading, justify="right")
    for path in sorted(folder.glob("*/specimen.toml")):
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
            table.add_row(*pool.submit(case, path).result())
    return table


def draws() -> Table:
    """The table of all draws."""
    table = Table(title=f"diagnose, seconds, {available_cores()} cores", title_justify="left")
    for heading in ("hidden", "noise", "unknowns", "r", *STEPS, "all", "shared", "said"):
        table.add_column(heading, justify="right")
    for job in DRAWS:
        table.add_row(*row(*job))
    return table


if __name__ == "__main__":
    CONSOLE.print(cases(Path(sys.argv[1])) if len(sys.argv) > 1 else draws())
