"""What an adaptive sweep reaches, compared with equally spaced sweeps and with the usual recipe.

    python tests/benchmarks/adaptive_sweeps.py deviations --draws 20    constants of plates, k33 bars and disks
    python tests/benchmarks/adaptive_sweeps.py effects --draws 3        hidden effects named

The data come from the independent discretisation of tests/hidden_effects, with everything off by the tolerances of a
laboratory and the same noise in every reading. The usual recipe: half of the points equally spaced, half within four
half-widths of the poles and zeros of a first sweep of 401 points (which are not counted). Takes about an hour.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from hidden_effects.catalogue import NAMES
from hidden_effects.draws import Draw, draw
from hidden_effects.round_draws import ROUND_EFFECTS, draw_round

from femu_piezo.errors import FemuPiezoError
from femu_piezo.extraction import extract
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.specimen.file import Specimen
from femu_piezo.study.adaptive import Wish, adapt
from femu_piezo.study.diagnose import diagnose
from femu_piezo.study.model_cache import SharedBases
from femu_piezo.study.update import update
from tests.study.bench import BAND, Bench, specimen_of

#: Body → function (number of the draw, effect) → draw. Every sixth seed gives plates, or bars, of a single set-up.
BODIES: dict[str, Callable[[int, str], Draw]] = {
    "plate": lambda number, effect: draw(f"laboratory:{effect}", 6 * number),
    "bar": lambda number, effect: draw(f"laboratory:{effect}", 6 * number + 5),
    "disk": lambda number, effect: draw_round(f"disk:{effect}", number),
}
EFFECTS = ("series_resistance", "leakage", "frequency_dependent_elastic_loss", "wrong_insensitive_parameter")
CONSOLE = Console(width=150)


def bench_of(drawn: Draw) -> Bench:
    """The bench that measures a draw."""
    return Bench(drawn, level=1e-3, series=(21,))


def crowded(bench: Bench, points: int) -> ImpedanceSpectrum:
    """The usual recipe, with so many points."""
    pairs = extract(bench(np.linspace(*BAND, 401))).pairs
    resonances = [one for pair in pairs for one in (pair.pole, pair.zero)]
    about = [one.frequency_Hz * (1 + one.loss / 2 * np.linspace(-4, 4, 201)) for one in resonances]
    candidates = np.sort(np.concatenate(about))
    candidates = candidates[(candidates > BAND[0]) & (candidates < BAND[1])]
    half = candidates[np.linspace(0, candidates.size - 1, points // 2).astype(int)]
    return bench(np.unique(np.concatenate([np.linspace(*BAND, points - points // 2), half])))


Recipe = Callable[[Specimen, Bench, SharedBases], ImpedanceSpectrum]


def adaptive(points: int) -> Recipe:
    """The recipe of an adaptive sweep with so many points."""
    return lambda specimen, bench, bases: (
        adapt(specimen, bench, Wish(points=points, band_Hz=BAND), bases=bases).spectrum
    )


def equal(points: int) -> Recipe:
    """The recipe of equally spaced points."""
    return lambda specimen, bench, bases: bench(np.linspace(*BAND, points))


RECIPES: dict[str, Recipe] = {
    "adaptive, 100": adaptive(100),
    "adaptive, 200": adaptive(200),
    "dense at resonances, 200": lambda specimen, bench, bases: crowded(bench, 200),
    "equally spaced, 401": equal(401),
    "equally spaced, 801": equal(801),
}


def plain_specimen_of(drawn: Draw, folder: Path) -> Specimen:
    """The specimen of a draw, without stated noise and held-out band."""
    found = specimen_of(drawn, folder)
    return found.model_copy(
        update={"measurement": found.measurement.model_copy(update={"noise": None, "held_out": None})}
    )


@dataclass
class Kept:
    """Results, kept as lines of a file where one is given, so that an interrupted run can be resumed.

    The entry "of" of a result identifies what was computed.
    """

    path: Path | None
    lines: list[dict] = field(default_factory=list)

    def __post_init__(self) -> None:
        if self.path is not None and self.path.exists():
            self.lines = [json.loads(line) for line in self.path.read_text(encoding="utf-8").splitlines()]

    def result(self, of: list, make: Callable[[], dict]) -> None:
        """Compute and keep a result, unless it exists; {"failed": why} where the computation fails."""
        if any(line["of"] == of for line in self.lines):
            return
        begun = time.process_time()
        try:
            made = make()
        except FemuPiezoError as error:
            made = {"failed": str(error)}
        self.lines.append({"of": of, **made, "processor_s": time.process_time() - begun})
        if self.path is not None:
            with open(self.path, "a", encoding="utf-8") as stream:
                stream.write(json.dumps(self.lines[-1]) + "\n")

    def all_of(self, *of) -> list[dict]:
        """Results whose "of" begins with these entries."""
        return [line for line in self.lines if line["of"][: len(of)] == list(of)]


def deviations(bodies: list[str], draws: range, kept: Kept) -> None:
    """Tables of the median stated deviation of every constant by every recipe, and of the part that is noise."""
    with tempfile.TemporaryDirectory() as folder:
        for body in bodies:
            bases = SharedBases()
            for number in draws:
                drawn = BODIES[body](number, "none")
                specimen = plain_specimen_of(drawn, Path(folder))
                for name, recipe in RECIPES.items():
                    make = partial(updated, drawn, specimen, recipe, bases)
                    kept.result(["deviations", body, name, number], make)
            by_recipe = {name: kept.all_of("deviations", body, name) for name in RECIPES}
            table(f"{body}, {len(by_recipe['adaptive, 100'])} draws: median stated deviation", by_recipe, "stated")
            table(f"{body}: the part of it from noise", by_recipe, "noise")


def updated(drawn: Draw, specimen: Specimen, recipe: Recipe, bases: SharedBases) -> dict:
    """Stated deviations, their part from noise, and errors over stated deviations, of an update after a recipe."""
    stated, noise, off = {}, {}, []
    found = update(specimen, bases=bases, spectra=[recipe(specimen, bench_of(drawn), bases)])
    for constant, one in found.parameters.items():
        true = drawn.theta[NAMES.index(constant)]
        tangent = -true.imag / true.real
        stated |= {constant: one.std / abs(one.value), f"tan_{constant}": one.tan_std}
        noise[constant] = one.budget["noise"] / abs(one.value)
        noise[f"tan_{constant}"] = one.tan_budget["noise"]
        off += [(one.value - true.real) / one.std, (one.tan - tangent) / one.tan_std]
    return {"stated": stated, "noise": noise, "off": [float(value) for value in off]}


def table(title: str, results: dict[str, list[dict]], which: str) -> None:
    """Print medians by recipe, the rms of errors over stated deviations, and the number of draws without a result."""
    done = {name: [one for one in own if "failed" not in one] for name, own in results.items()}
    labels = list(next(own[0] for own in done.values() if own)[which])
    shown = Table(title=f"{title} (% of constants, 1e-5 of tangents)")
    shown.add_column("recipe")
    for label in [*labels, "rms (found − true)/σ", "no result"]:
        shown.add_column(label, justify="right")
    for name, own in done.items():
        median = {label: np.median([one[which][label] for one in own]) if own else np.nan for label in labels}
        cells = [f"{1e5 * v:.3g}" if label.startswith("tan_") else f"{100 * v:.3g}" for label, v in median.items()]
        off = [value for one in own for value in one["off"]]
        shown.add_row(name, *cells, f"{np.sqrt(np.mean(np.square(off))):.2f}", str(len(results[name]) - len(own)))
    CONSOLE.print(shown)


def diagnosed(drawn: Draw, specimen: Specimen, recipe: Recipe, bases: SharedBases) -> dict:
    """Verdict and names of its causes in a diagnosis after a recipe."""
    found = diagnose(specimen, bases=bases, spectra=[recipe(specimen, bench_of(drawn), bases)]).verdict
    return {"word": found.word, "causes": [one.effect.name for one in found.causes]}


def effects(bodies: list[str], draws: range, kept: Kept) -> None:
    """Table of the hidden effects that are named, and nothing else, after every recipe."""
    recipes = {name: RECIPES[name] for name in ("adaptive, 100", "adaptive, 200", "equally spaced, 401")}
    with tempfile.TemporaryDirectory() as folder:
        for body in bodies:
            bases = SharedBases()
            drawable = [effect for effect in EFFECTS if body != "disk" or effect in ROUND_EFFECTS]
            for effect in drawable:
                for number in draws:
                    drawn = BODIES[body](number, effect)
                    specimen = plain_specimen_of(drawn, Path(folder))
                    for name, recipe in recipes.items():
                        make = partial(diagnosed, drawn, specimen, recipe, bases)
                        kept.result(["effects", body, name, effect, number], make)
            shown = Table(title=f"{body}: hidden effects named alone")
            shown.add_column("recipe")
            for effect in drawable:
                shown.add_column(effect, justify="right")
            for name in recipes:
                by_effect = {effect: kept.all_of("effects", body, name, effect) for effect in drawable}
                named = {
                    effect: sum(one.get("causes") == [effect] for one in several)
                    for effect, several in by_effect.items()
                }
                shown.add_row(name, *(f"{count} of {len(by_effect[effect])}" for effect, count in named.items()))
            CONSOLE.print(shown)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["deviations", "effects"])
    parser.add_argument("--bodies", nargs="+", choices=list(BODIES), default=list(BODIES))
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="number of the first draw")
    parser.add_argument("--keep", type=Path, help="file of results as lines, to which others are added")
    given = parser.parse_args()
    draws = range(given.first, given.first + given.draws)
    {"deviations": deviations, "effects": effects}[given.what](given.bodies, draws, Kept(given.keep))
