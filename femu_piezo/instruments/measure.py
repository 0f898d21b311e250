"""`measure`: an analyser sweeps at the frequencies that the study chooses; every point is on disk once measured."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from femu_piezo import api
from femu_piezo.errors import FemuPiezoError, InputError
from femu_piezo.files import append_durably, write_atomically
from femu_piezo.instruments.analyser import Analyser, Settings
from femu_piezo.instruments.connect import connect
from femu_piezo.measurement.readers import write_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.output.folder import locked, prepare_folder, write_figure, write_json
from femu_piezo.output.measuring import measuring_figure
from femu_piezo.output.results.diagnosed import Diagnosed
from femu_piezo.output.results.updated import Updated
from femu_piezo.specimen.file import Measurement, Specimen, Sweep, read_specimen, write_specimen
from femu_piezo.study.adaptive import Adapted, State, Wish, adapt, joined, merged
from femu_piezo.study.model_cache import SharedBases
from femu_piezo.study.planning import OPPOSITE, THIRD
from femu_piezo.study.problem import prepare
from femu_piezo.study.progress import Progress
from femu_piezo.units import signed

#: Most points of one sweep of the analyser; a crash during a sweep loses no more.
_BLOCK = 32
#: The specimen whose points a folder holds.
_PIECE = "piece.toml"
_HEADER = "frequency_Hz,resistance_ohm,reactance_ohm,voltage_V,bias_V"


@dataclass(frozen=True)
class MeasureResult:
    """The result of `measure`.

    Attributes
    ----------
    adapted : points and rounds;  updated : the update of all points;  diagnosed : None where it was not asked for
    """

    adapted: Adapted
    updated: Updated
    diagnosed: Diagnosed | None = None


def measure(
    specimen: Specimen,
    address: str,
    out: Path,
    wish: Wish,
    settings: Settings,
    *,
    diagnose: bool = False,
    keep: Callable[[Sequence[Specimen], Updated | Diagnosed], None] = lambda specimens, result: None,
    tell: Callable[[str], None] = lambda line: None,
    progress: Progress | None = None,
) -> MeasureResult:
    """Measure a specimen with the analyser at a VISA address.

    The folder gets piece.toml (what is measured), points.csv (every point as it comes), live.png (rewritten after every
    round), sweep.csv, measured.toml (the specimen with this sweep), measure.json, and what `update` writes. Points that
    it holds already count: a measurement that was broken off goes on. Those of another piece are refused, and so is a
    folder into which another measurement writes.

    Parameters
    ----------
    diagnose : diagnose the sweep as well (as `wish.separate` also does), and take the sweeps in the opposite direction
        and at a third of the voltage where the diagnosis recommends them
    keep : called as keep([specimen], result) with each result once its files are written
    tell : called with a line about every round

    Raises
    ------
    InputError : a wish, a setting or the folder cannot serve
    InstrumentError : the instrument fails; the points so far are in points.csv, and the output is off
    """
    _refuse_foreign_columns(specimen)
    alone = specimen.model_copy(update={"sweep": None})
    points = PointFile(prepare_folder(out) / "points.csv", settings, alone)
    bases, states = SharedBases(), []

    def shown(state: State) -> None:
        states.append(state)
        try:
            write_figure(out / "live.png", measuring_figure(specimen.name, states), dots_per_inch=100)
        except FemuPiezoError as error:
            tell(f"{error}; measuring goes on without the picture")
        tell(state_words(state))

    with interruptible(), locked(out):
        begun = points.read()
        if begun is not None:
            tell(f"{len(begun)} points are in {points.path} already; the measurement continues with them")
        with connect(address, specimen.limits, settings) as analyser:
            tell(f"{analyser.identity}; fixture compensation: {analyser.compensation}")

            def take(frequency: np.ndarray) -> ImpedanceSpectrum:
                return swept(analyser, frequency, points)

            adapted = adapt(alone, take, wish, begun, progress, shown, bases)
        sweep = replace(adapted.spectrum, source=specimen.name)
        write_spectrum(sweep, out / "sweep.csv")
        measured = _with_sweep(alone, out / "sweep.csv")
        write_specimen(measured, out / "measured.toml")
        taken = {
            "instrument": analyser.identity,
            "compensation": analyser.compensation,
            "voltage_V": settings.voltage,
            "bias_V": settings.bias,
        }
        write_json(out / "measure.json", {**adapted.to_json(), **taken})
        updated = api.update(measured, progress=progress, bases=bases)
        updated.save(out)
        keep([measured], updated)
        found = None
        if diagnose or wish.separate:
            diagnosed = measured
            found = api.diagnose(diagnosed, progress=progress, bases=bases)
            more = _recommended(found, settings, analyser.voltages[0]) if diagnose else []
            if more:
                tell(f"the diagnosis recommends {' and '.join(more)}; the sweeps are taken now")
                diagnosed = _further(alone, address, out, sweep.frequency, settings, more)
                found = api.diagnose(diagnosed, progress=progress)
            found.save(out / "diagnosis")
            keep([diagnosed], found)
    return MeasureResult(adapted, updated, found)


def _refuse_foreign_columns(specimen: Specimen) -> None:
    """InputError where raw sweeps of the fixture need `columns`, by which the sweeps measured now would be read too."""
    table = specimen.measurement or Measurement()
    if table.columns is not None and (table.open is not None or table.short is not None):
        raise InputError(
            f"{specimen.path or specimen.name}: measurement.columns would also name the columns of the sweeps that "
            "`measure` writes; give the raw sweeps of the fixture a header with quantities and units, and take columns "
            "out"
        )


def _refuse_another(path: Path, specimen: Specimen) -> None:
    """InputError where the points of a folder are of another piece, which the file at `path` describes."""
    if not path.exists():
        return
    before = read_specimen(path)
    if (before.name, prepare(before).plate) != (specimen.name, prepare(specimen).plate):
        raise InputError(
            f"{path.parent}: its points are of another piece, {before.name!r} as in {path.name}; give another --out"
        )


def swept(analyser: Analyser, frequency: np.ndarray, points: PointFile) -> ImpedanceSpectrum:
    """A sweep in blocks of at most `_BLOCK` points, each on disk before the next begins."""
    found = None
    for block in np.array_split(frequency, -(-frequency.size // _BLOCK)):
        one = analyser.sweep(block)
        points.append(one)
        found = joined(found, one)
    return found


class PointFile:
    """points.csv: a line for every point, on disk when `append` returns; a half-written last line is left out.

    Parameters
    ----------
    settings : of the measurement; a file with points at another voltage or bias is refused
    piece : what is measured; it is written beside the first point, and points of another piece are refused
    """

    def __init__(self, path: Path, settings: Settings, piece: Specimen | None = None) -> None:
        self.path, self._settings, self._piece = path, settings, piece

    def read(self) -> ImpedanceSpectrum | None:
        """The points of the file; None where it has none."""
        if not self.path.exists():
            return None
        text = self.path.read_text(encoding="utf-8", errors="replace")
        lines = text[: text.rfind("\n") + 1].splitlines()
        if text and lines[:1] != [_HEADER]:
            raise InputError(f"{self.path}: this is not a file of points of `measure`; give another --out")
        if not text.endswith("\n") or not text:  # cut off in mid-line by a crash
            write_atomically(self.path, "".join(f"{line}\n" for line in lines or [_HEADER]))
        rows = []
        for number, line in enumerate(lines[1:], 2):
            try:
                rows.append([float(word) for word in line.split(",")])
            except ValueError:
                raise InputError(f"{self.path}, line {number}: {line[:60]!r} is no point; take the line out") from None
            if len(rows[-1]) != 5 or not np.all(np.isfinite(rows[-1])) or rows[-1][0] <= 0:
                raise InputError(f"{self.path}, line {number}: {line[:60]!r} is no point; take the line out")
        if not rows:
            return None
        if self._piece is not None:
            _refuse_another(self.path.with_name(_PIECE), self._piece)
        values = np.array(rows)
        for column, name, setting in ((3, "voltage", self._settings.voltage), (4, "bias", self._settings.bias)):
            other = values[np.abs(values[:, column] - setting) > 1e-9, column]
            if other.size:
                raise InputError(
                    f"{self.path}: holds points at a {name} of {other[0]:g} V, not {setting:g} V; give --{name} "
                    f"{other[0]:g}, or another --out"
                )
        return merged(values[:, 0], values[:, 1] + 1j * values[:, 2], str(self.path))

    def append(self, spectrum: ImpedanceSpectrum) -> None:
        """Write the points of a sweep, and wait until they are on the disk."""
        new = not self.path.exists() or self.path.stat().st_size == 0
        if new and self._piece is not None:
            write_specimen(self._piece, self.path.with_name(_PIECE))
        rows = zip(
            spectrum.frequency.tolist(), spectrum.impedance.real.tolist(), spectrum.impedance.imag.tolist(), strict=True
        )
        end = f"{self._settings.voltage!r},{self._settings.bias!r}"
        text = "".join(f"{f!r},{r!r},{x!r},{end}\n" for f, r, x in rows)
        append_durably(self.path, (_HEADER + "\n" if new else "") + text)


@contextmanager
def interruptible() -> Iterator[None]:
    """Treat a request to end (SIGTERM) like Ctrl-C: the output is switched off before the program ends."""

    def stop(number, frame):
        raise KeyboardInterrupt

    try:
        before = signal.signal(signal.SIGTERM, stop)
    except ValueError:  # not the main thread
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def state_words(state: State) -> str:
    """One line about a round."""
    words = f"{len(state.spectrum):4d} points, {state.step}: "
    if state.reason:
        return words + "no update yet"
    parts = [
        f"{name} ± {value:.1g}" if name.startswith("tan_") else f"{name} ± {100 * value:.2g} %"
        for name, value in state.deviations.items()
    ]
    words += ", ".join(parts)
    if state.rivals is not None:
        two = state.rivals
        words += f"; log odds of {two.first} over {two.second} {signed(two.log_odds, '.1f')}"
    if state.departures:
        words += "; the sweep departs from the model near " + ", ".join(
            f"{one / 1e3:.4g} kHz" for one in state.departures
        )
    return words


def _table_for_own(specimen: Specimen) -> Measurement:
    """[measurement] for sweeps that this program writes: its `connection` and `columns` are those of other files.

    They stay where it names raw sweeps of the fixture, which are read with them.
    """
    table = specimen.measurement or Measurement()
    if table.open is not None or table.short is not None:
        return table
    return table.model_copy(update={"connection": None, "columns": None})


def _with_sweep(specimen: Specimen, file: Path) -> Specimen:
    table = _table_for_own(specimen).model_copy(update={"file": file.absolute()})
    return specimen.model_copy(update={"measurement": table, "path": file.with_name("measured.toml")})


def _recommended(found: Diagnosed, settings: Settings, least: float) -> list[str]:
    """The further sweeps that the diagnosis recommends and this analyser can take; `least` : its lowest level, V."""
    words = found.verdict.measurements
    possible = (OPPOSITE, THIRD) if settings.voltage / 3 >= least else (OPPOSITE,)
    return [way for way in possible if any(one.startswith(way) for one in words)]


def _further(
    specimen: Specimen, address: str, out: Path, frequency: np.ndarray, settings: Settings, more: Sequence[str]
) -> Specimen:
    """The specimen with new full sweeps: rising and, if in `more`, falling and at a third of the voltage."""
    ways = {"up": (settings.voltage, True)}
    ways |= {"down": (settings.voltage, False)} if OPPOSITE in more else {}
    ways |= {"third": (settings.voltage / 3, True)} if THIRD in more else {}
    tables = []
    with connect(address, specimen.limits, settings) as analyser:
        for name, (voltage, rising) in ways.items():
            write_spectrum(analyser.sweep(frequency, voltage, rising=rising), out / f"{name}.csv")
            tables.append(
                Sweep(
                    file=(out / f"{name}.csv").absolute(), direction="up" if rising else "down", drive_voltage=voltage
                )
            )
    table = _table_for_own(specimen).model_copy(update={"file": None})
    several = specimen.model_copy(update={"measurement": table, "sweep": tuple(tables), "path": out / "several.toml"})
    write_specimen(several, out / "several.toml")
    return several
