"""Pairs of causes that one sweep cannot separate: separation that a plan expects of a further measurement, and reached.

    python tests/benchmarks/told_apart.py [PAIR …]

One line for each pair: the cause in the data, the cause or constant that imitates it, the recommended measurement, and
the separation in σ with the one sweep, as the plan expects it, and with the further data: √(Δχ²) of the wrong cause, or
of the constants alone, over the right cause. Where a constant imitates it, the plan gives size over deviation,
scaled here to the true size. The sweeps come from the spectral elements of tests/hidden_effects, with noise of
0.07 % (drifts) or 0.1 %.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from hidden_effects.build import Build
from hidden_effects.draws import DENSITY
from study.test_several_sweeps import ASSUMED, DRIFT, FEW, FREQUENCY, SIZE, Bench, down, softer, sweep, truth, up

from femu_piezo import diagnose, read_specimen
from femu_piezo.effects.library import dimensions
from femu_piezo.measurement.readers import write_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.study.planning import OPPOSITE
from tests.noise import noisy
from tests.specimens import plate

SECOND = "measure a second specimen of the same material with half the length"
STRAY, LONGER = 40e-12, 0.01


@dataclass
class Pair:
    """A cause in the data, the cause or constant that imitates it, and the measurement that separates them.

    Attributes
    ----------
    size : size of the cause, SI; None where the imitation is a cause as well
    first, further : specimen file of the one sweep, and specimen files of all data
    effects : the candidates; those of the library where None
    """

    cause: str
    other: str
    measurement: str
    size: float | None
    first: Path
    further: Sequence[Path]
    effects: tuple | None = None


def drift(folder: Path) -> Pair:
    """A drift in a rising sweep; the second sweep goes down without a pause."""
    bench = Bench(folder)
    bench.add("up", sweep(softer(up), seed=1), direction="up")
    first = bench.write().rename(folder / "first.toml")
    bench.add("down", sweep(softer(down), seed=2), direction="down")
    return Pair("temperature_drift", "point_mass", OPPOSITE, None, first, [bench.write()])


def window(folder: Path) -> Pair:
    """A drift in a window around the fundamental, where a constant absorbs a part of it."""
    bench, frequency = Bench(folder), np.linspace(100e3, 140e3, 401)

    def passed(f: float) -> float:
        return (f - frequency[0]) / np.ptp(frequency)

    bench.add("up", sweep(softer(lambda f: DRIFT * passed(f)), frequency=frequency, seed=1), direction="up")
    first = bench.write().rename(folder / "first.toml")
    bench.add("down", sweep(softer(lambda f: DRIFT * (2 - passed(f))), frequency=frequency, seed=2), direction="down")
    return Pair("temperature_drift", "d31", OPPOSITE, DRIFT, first, [bench.write()], FEW)


def stray(folder: Path) -> Pair:
    """A stray capacitance of the fixture; the second plate, half as long, is in the same fixture."""
    paths = [_plate(folder, name, share, beside=STRAY) for name, share in (("whole", 1.0), ("half", 0.5))]
    return Pair("stray_capacitance", "eps33T", SECOND, STRAY, paths[0], paths, FEW)


def length(folder: Path) -> Pair:
    """A plate longer than its file states, and a right one half as long."""
    paths = [_plate(folder, "whole", 1.0, longer=LONGER), _plate(folder, "half", 0.5)]
    return Pair("wrong_length", "s11", SECOND, LONGER, paths[0], paths, (*FEW, dimensions.candidates))


def _plate(folder: Path, name: str, share: float, *, beside: float = 0.0, longer: float = 0.0) -> Path:
    """Specimen file and sweep of a plate with a share of the length, over the same part of its resonances.

    beside : stray capacitance, F; longer : relative error of the length
    """
    size, frequency = SIZE * [share, 1, 1], FREQUENCY / share
    build = Build(size * [1 + longer, 1, 1], DENSITY, truth(), 115e3 / share)
    build.circuits.append(lambda w, z: 1 / (1 / z + 1j * w * beside))
    spectrum = ImpedanceSpectrum(frequency, noisy(build.impedance(frequency), 1e-3, len(name)))
    write_spectrum(spectrum, folder / f"{name}.csv")
    path = folder / f"{name}.toml"
    text = plate(name, size, DENSITY) + ASSUMED + f'[measurement]\nfile = "{name}.csv"\n'
    path.write_text(text, encoding="utf-8")
    return path


PAIRS = {"drift": drift, "window": window, "stray": stray, "length": length}


def separation(pair: Pair) -> tuple[float, float, float]:
    """Separation in σ now, as expected, and as reached."""
    alone = diagnose(read_specimen(pair.first), effects=pair.effects)
    pairs = [one for one in alone.separations if one.cause == pair.cause and one.other == pair.other]
    plans = [one for one in pairs if one.measurement == pair.measurement]
    if not plans:
        raise SystemExit(f"{pair.cause} against {pair.other}: the verdict recommends {[p.measurement for p in pairs]}")
    (plan,) = plans
    with_further = diagnose([read_specimen(path) for path in pair.further], effects=pair.effects)
    scale = 1.0 if pair.size is None else pair.size / plan.parameter.usual
    return scale * plan.now, scale * plan.expected, _beyond(with_further, pair)


def _beyond(diagnosis, pair: Pair) -> float:
    """√(Δχ²) of the wrong cause, or of the constants alone, over the right one."""
    alone = replace(diagnosis.comparison.base, discrepancy=None).chi_square
    misfit = {pair.other: alone} if pair.size is not None else {}
    for one in diagnosis.comparison.singles:
        if one.fit is not None:
            name = one.effect.name
            misfit[name] = min(misfit.get(name, np.inf), one.fit.chi_square)
    return float(np.sqrt(max(0.0, misfit[pair.other] - misfit[pair.cause])))


def main(wanted: Sequence[str]) -> None:
    """Print the table."""
    print(f"{'cause':20s}{'taken for':16s}{'further measurement':66s}{'now':>8s}{'expected':>10s}{'reached':>9s}")
    for name in wanted or PAIRS:
        with TemporaryDirectory() as folder:
            pair = PAIRS[name](Path(folder))
            now, expected, reached = separation(pair)
        words = f"{pair.cause:20s}{pair.other:16s}{pair.measurement:66s}"
        print(f"{words}{now:8.1f}{expected:10.1f}{reached:9.1f}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
