"""What a sweep that follows from its own points reaches, against equally spaced ones and the usual recipe.

    python tests/benchmarks/adaptive_sweeps.py deviations --draws 20    constants of plates, k33 bars and disks
    python tests/benchmarks/adaptive_sweeps.py effects --draws 3        hidden effects named

The data come from the independent discretisation of tests/hidden_effects, everything off by the tolerances of a
laboratory, one noise in every reading. The usual recipe: half of the points equally spaced, half within four half
widths of the poles and zeros that a first sweep of 401 points shows (those points not counted). Takes about an hour.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hidden_effects.catalogue import NAMES
from hidden_effects.draws import Draw, draw
from hidden_effects.round_draws import draw_round

from femu_piezo.errors import FemuPiezoError
from femu_piezo.extraction import extract
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.specimen.file import Specimen, read_specimen
from femu_piezo.study.adaptive import Wish, adapt
from femu_piezo.study.diagnose import diagnose
from femu_piezo.study.model_cache import SharedBases
from femu_piezo.study.update import update

BAND, NOISE = (20e3, 240e3), 1e-3
#: Number of the draw → the drawn piece. Plates and bars are of one set-up each, every sixth seed.
BODIES: dict[str, Callable[[int, str], Draw]] = {
    "plate": lambda number, effect: draw(f"laboratory:{effect}", 6 * number),
    "bar": lambda number, effect: draw(f"laboratory:{effect}", 6 * number + 5),
    "disk": lambda number, effect: draw_round(f"disk:{effect}", number),
}
EFFECTS = ("series_resistance", "leakage", "frequency_dependent_elastic_loss", "wrong_insensitive_parameter")
CONSOLE = Console(width=150)


@dataclass
class Bench:
    """Reads a drawn piece; counts its readings."""

    drawn: Draw
    readings: int = 0
    rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng([21, self.drawn.seed])

    def __call__(self, frequency: np.ndarray) -> ImpedanceSpectrum:
        self.readings += frequency.size
        z = self.drawn.build.impedance(np.append(frequency, BAND[1]))[:-1]
        normal = self.rng.standard_normal((2, frequency.size))
        return ImpedanceSpectrum(frequency, z * (1 + NOISE * (normal[0] + 1j * normal[1]) / np.sqrt(2)), source="bench")


def crowded(bench: Bench, points: int) -> ImpedanceSpectrum:
    """The usual recipe."""
    pairs = extract(bench(np.linspace(*BAND, 401))).pairs
    shown = [one for pair in pairs for one in (pair.pole, pair.zero)]
    about = [one.frequency_Hz * (1 + one.loss / 2 * np.linspace(-4, 4, 201)) for one in shown]
    every = np.sort(np.concatenate(about))
    every = every[(every > BAND[0]) & (every < BAND[1])]
    half = every[np.linspace(0, every.size - 1, points // 2).astype(int)]
    return bench(np.unique(np.concatenate([np.linspace(*BAND, points - points // 2), half])))


def adaptive(points: int) -> Callable[[Specimen, Bench, SharedBases], ImpedanceSpectrum]:
    return lambda specimen, bench, bases: (
        adapt(specimen, bench, Wish(points=points, band_Hz=BAND), bases=bases).spectrum
    )


def equal(points: int) -> Callable[[Specimen, Bench, SharedBases], ImpedanceSpectrum]:
    return lambda specimen, bench, bases: bench(np.linspace(*BAND, points))


RECIPES = {
    "adaptive, 100": adaptive(100),
    "adaptive, 200": adaptive(200),
    "dense at resonances, 200": lambda specimen, bench, bases: crowded(bench, 200),
    "equally spaced, 401": equal(401),
    "equally spaced, 801": equal(801),
}


def specimen_of(drawn: Draw, folder: Path) -> Specimen:
    path = folder / "piece.toml"
    path.write_text(drawn.specification, encoding="utf-8")
    found = read_specimen(path)
    return found.model_copy(
        update={"measurement": found.measurement.model_copy(update={"noise": None, "held_out": None})}
    )


def deviations(bodies: list[str], draws: int) -> None:
    """Median stated deviations of every constant by every recipe, and how far off the truth these are."""
    with tempfile.TemporaryDirectory() as folder:
        for body in bodies:
            bases = SharedBases()
            stated: dict[str, list[dict[str, float]]] = {name: [] for name in RECIPES}
            noise: dict[str, list[dict[str, float]]] = {name: [] for name in RECIPES}
            off: dict[str, list[float]] = {name: [] for name in RECIPES}
            failed: dict[str, int] = dict.fromkeys(RECIPES, 0)
            begun = time.perf_counter()
            for number in range(draws):
                drawn = BODIES[body](number, "none")
                specimen = specimen_of(drawn, Path(folder))
                for name, recipe in RECIPES.items():
                    try:
                        spectrum = recipe(specimen, Bench(drawn), bases)
                        found = update(specimen, bases=bases, spectra=[spectrum]).parameters
                    except FemuPiezoError:
                        failed[name] += 1
                        continue
                    own, of_noise = {}, {}
                    for constant, one in found.items():
                        true = drawn.theta[NAMES.index(constant)]
                        tangent = -true.imag / true.real
                        own |= {constant: one.std / abs(one.value), f"tan_{constant}": one.tan_std}
                        of_noise[constant] = one.budget["noise"] / abs(one.value)
                        of_noise[f"tan_{constant}"] = one.tan_budget["noise"]
                        off[name] += [(one.value - true.real) / one.std, (one.tan - tangent) / one.tan_std]
                    stated[name].append(own)
                    noise[name].append(of_noise)
            table(f"{body}, {draws} draws: median stated deviation", stated, off, failed)
            table(f"{body}: the part of it from noise", noise, off, failed)
            CONSOLE.print(f"{time.perf_counter() - begun:.0f} s")


def table(title: str, stated, off, failed) -> None:
    """Medians by recipe, how far off the truth in stated deviations, and how many draws had no result."""
    labels = list(next(own for own in stated.values() if own)[0])
    shown = Table(title=f"{title} (% of constants, 1e-5 of tangents)")
    shown.add_column("recipe")
    for label in [*labels, "rms (found − true)/σ", "no result"]:
        shown.add_column(label, justify="right")
    for name, own in stated.items():
        median = {label: np.median([one[label] for one in own]) if own else np.nan for label in labels}
        cells = [f"{1e5 * v:.3g}" if label.startswith("tan_") else f"{100 * v:.3g}" for label, v in median.items()]
        shown.add_row(name, *cells, f"{np.sqrt(np.mean(np.square(off[name]))):.2f}", str(failed[name]))
    CONSOLE.print(shown)


def effects(bodies: list[str], draws: int) -> None:
    """How many hidden effects are named, alone, after every recipe."""
    recipes = {name: RECIPES[name] for name in ("adaptive, 100", "adaptive, 200", "equally spaced, 401")}
    with tempfile.TemporaryDirectory() as folder:
        for body in bodies:
            bases = SharedBases()
            named = {name: dict.fromkeys(EFFECTS, 0) for name in recipes}
            for effect in EFFECTS:
                for number in range(draws):
                    drawn = BODIES[body](number, effect)
                    specimen = specimen_of(drawn, Path(folder))
                    for name, recipe in recipes.items():
                        try:
                            spectrum = recipe(specimen, Bench(drawn), bases)
                            found = diagnose(specimen, bases=bases, spectra=[spectrum])
                        except FemuPiezoError:
                            continue
                        named[name][effect] += [one.effect.name for one in found.verdict.causes] == [effect]
            shown = Table(title=f"{body}: hidden effects named, of {draws} draws each")
            shown.add_column("recipe")
            for effect in EFFECTS:
                shown.add_column(effect, justify="right")
            for name, own in named.items():
                shown.add_row(name, *map(str, own.values()))
            CONSOLE.print(shown)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["deviations", "effects"])
    parser.add_argument("--bodies", nargs="+", choices=list(BODIES), default=list(BODIES))
    parser.add_argument("--draws", type=int, default=20)
    given = parser.parse_args()
    {"deviations": deviations, "effects": effects}[given.what](given.bodies, given.draws)
