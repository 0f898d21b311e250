"""One specimen with its sweep: poles and zeros extracted, the fundamental chosen, start values from the sweep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from femu_piezo.effects.effect import SweepConditions
from femu_piezo.errors import InputError
from femu_piezo.extraction import Extraction, extract
from femu_piezo.extraction.limitations import find_clipping
from femu_piezo.extraction.roots import Pair, fundamental
from femu_piezo.geometry.shapes import Plate
from femu_piezo.inference.starts.pole_zero import static_permittivity
from femu_piezo.inference.starts.thin_body import bar_coupling
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.measurement.checks import FEWEST_POINTS
from femu_piezo.measurement.compensation import Compensation, Load
from femu_piezo.measurement.readers import accept_spectrum, read_raw, read_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.measurement.touchstone import is_touchstone
from femu_piezo.specimen.file import Measurement, Residue, Specimen, Update
from femu_piezo.study.problem import Problem, prepare
from femu_piezo.study.starts import has_uniform_field, start_permittivity, start_values
from femu_piezo.units import hertz

#: A sweep reaches low frequency where it starts below this share of the fundamental pole: there the plate is free
#: and uniform, and the error of eq 41 is about k² (f/f_p)² ≈ 2e-4.
LOW_FREQUENCY_SHARE = 0.03
#: Points below this share of the pole enter the mean; the known rise of a bar, 2e-3 k² there, is taken out.
LOW_POINTS_SHARE = 0.05
#: Ratio of two poles up to which they are of one mode at different temperatures and drives.
_SAME_MODE = 1.1


@dataclass(frozen=True)
class Measured:
    """A specimen and what one sweep of it says without a model.

    Attributes
    ----------
    problem : the specimen as computed, with this sweep alone; its name includes that of the sweep where it has several
    spectrum : the whole sweep;  fitted : without the held-out band
    pair : pole and zero of the fundamental, of another sweep of the specimen where this one does not hold them
    piece : the specimen with all its sweeps;  conditions : how this sweep was taken
    permittivity : complex ε33T from the low end of the sweep, None where it has none
    """

    problem: Problem = field(repr=False)
    spectrum: ImpedanceSpectrum
    fitted: ImpedanceSpectrum
    extraction: Extraction
    pair: Pair
    permittivity: complex | None
    piece: Specimen
    conditions: SweepConditions = field(default_factory=SweepConditions)

    @property
    def holds_fundamental(self) -> bool:
        """Whether the fundamental is in this sweep."""
        return self.pair in self.extraction.pairs

    @property
    def band_Hz(self) -> float:
        """Highest frequency the model must serve."""
        return float(max(self.spectrum.frequency[-1], 1.05 * self.pair.zero.frequency_Hz))

    @property
    def relative_noise(self) -> np.ndarray:
        """(k,) standard deviation of the relative error of `fitted`."""
        return self.relative_noise_of(self.fitted)

    def relative_noise_of(self, spectrum: ImpedanceSpectrum) -> np.ndarray:
        """(n,) standard deviation of the relative error of a part of the sweep, as `Extraction.relative_noise_of`."""
        return self.extraction.relative_noise_of(spectrum)

    @property
    def low_frequency(self) -> np.ndarray:
        """(n,) Hz, the points that `permittivity` is the mean of."""
        return self.fitted.frequency[_low_points(self.problem, self.fitted, self.pair)]

    @property
    def permittivity_covariance(self) -> np.ndarray:
        """(2, 2) covariance of (Re, Im) of `permittivity` by the noise of the points it is the mean of, (F/m)²."""
        noise = self.relative_noise[_low_points(self.problem, self.fitted, self.pair)]
        variance = abs(self.permittivity) ** 2 * float(np.mean(noise**2)) / noise.size
        return np.eye(2) * variance / 2

    @property
    def noise_known(self) -> bool:
        """Whether the noise came with the data."""
        return self.fitted.noise_known

    def start_values(self, free: tuple[str, ...]) -> dict[str, complex]:
        """Start values of those free constants that the sweep determines by thin-body formulas."""
        values = {}
        if "eps33T" in free:
            values["eps33T"] = self._start_permittivity()
        eps = values.get("eps33T", self.problem.constants.eps33T)
        found = start_values(self.problem, self.pair, eps)
        return values | {name: value for name, value in found.items() if name in free}

    def _start_permittivity(self) -> complex:
        if self.permittivity is not None:
            return self.permittivity
        return start_permittivity(self.problem, self.pair, self.fitted.frequency[0], self.fitted.admittance[0])


#: Factor about 10^±3 and 10^±6 within which the capacitance of a sweep is that of the body in another unit.
_ANOTHER_UNIT = 4.0
#: Tables of which that of the first specimen counts for all, in the order in which notes tell it.
_TABLES = ("[material]", "[update]", "[measurement] on instrument and fixture")
#: A sweep in memory, or another file than that of the specimen.
Sweep = ImpedanceSpectrum | Path


def measure_each(specimens: Sequence[Specimen], spectra: Sequence[Sweep] | None = None) -> list[Measured]:
    """Every sweep of several specimens analysed, those of one specimen one after another; [update] of the first counts.

    spectra : in place of those that the files name, in the same order

    Raises InputError where file, key or sweep cannot serve.
    """
    count = sum(len(specimen.of_each_sweep) for specimen in specimens)
    if spectra is not None and len(spectra) != count:
        whose = f"{len(specimens)} specimens" if count == len(specimens) else f"{count} sweeps in the specimen files"
        raise InputError(f"there are {whose} and {len(spectra)} sweeps; give one sweep for each")
    given = iter([None] * count if spectra is None else spectra)
    found: list[Measured] = []
    for specimen in specimens:
        ruled = specimen.model_copy(update={"update": specimens[0].update})
        sweeps = [(own, next(given)) for own in ruled.of_each_sweep]
        _refuse_idle_layout(specimen, sweeps)
        analysed = [_analysed(*one) for one in sweeps]
        _refuse_idle_held_out(specimen, analysed)
        found += _of_one_piece(specimen, analysed)
    conditions = from_common_mean([one.conditions for one in found])
    return [replace(one, conditions=own) for one, own in zip(found, conditions, strict=True)]


def tables_of_the_first(measured: Sequence[Measured]) -> tuple[str, ...]:
    """Notes on what files of further specimens state otherwise than the first, which alone counts.

    That is [material], [update], and of [measurement] the accuracy of the instrument and the residue of the fixture, as
    the first specimen in each fixture states them.
    """
    first, fixtures = measured[0], {}
    told: dict[tuple[str, str], dict[str, list[str]]] = {}  # table, whose it is → name of another specimen → words
    for other in measured:
        leading = fixtures.setdefault(other.conditions.fixture, other)
        owners = (first, first, leading)
        for table, owner, differs in zip(_TABLES, owners, (_of_material, _of_rules, _of_instrument), strict=True):
            words = [] if owner.piece is other.piece else differs(owner, other)
            if words:
                told.setdefault((table, owner.piece.name), {})[other.piece.name] = words
    return tuple(
        f"the table {table} of {owner} counts for all specimens; "
        + "; ".join(f"that of {name}, which {' and '.join(words)}, does not" for name, words in others.items())
        for (table, owner), others in sorted(told.items(), key=lambda item: _TABLES.index(item[0][0]))
    )


def _of_material(first: Measured, other: Measured) -> list[str]:
    """What [material] of another specimen has that the first has not, in words."""
    mine, its = first.piece.material, other.piece.material
    further = [one for one in its.free if one not in mine.free]
    found = [f"frees {', '.join(further)}"] if further else []
    if not np.array_equal(other.problem.constants.vector(), first.problem.constants.vector()):
        found.append("has other values")
    if (its.priors, its.tangent_priors) != (mine.priors, mine.tangent_priors):
        found.append("states other standard deviations")
    return found


def _of_rules(first: Measured, other: Measured) -> list[str]:
    """What [update] of another specimen asks otherwise, in words; keys that it leaves out ask nothing."""
    asked, rules = other.piece.update or Update(), first.piece.update or Update()
    given = (key for key in Update.model_fields if key in asked.model_fields_set)
    keys = [key for key in given if getattr(rules, key) != getattr(asked, key)]
    return [f"has another {' and '.join(keys)}"] if keys else []


def _of_instrument(leading: Measured, other: Measured) -> list[str]:
    """What [measurement] of another specimen in the same fixture states otherwise, in words; not what it leaves out."""
    mine, its = (one.piece.measurement or Measurement() for one in (leading, other))
    differs = {
        "accuracy": (its.accuracy is not None or its.load is not None) and its.magnitude_std != mine.magnitude_std,
        "phase_accuracy": its.phase_accuracy is not None and its.phase_accuracy != mine.stated("phase_accuracy"),
        "residue": its.residue is not None and its.residue != (mine.residue or Residue()),
    }
    keys = [key for key, found in differs.items() if found]
    return [f"states another {' and '.join(keys)}"] if keys else []


def measure(specimen: Specimen, spectrum: Sweep | None = None) -> Measured:
    """Analyse the sweep of a specimen: the one that is given, else that of its file.

    Of the [measurement] table everything but the file counts for any sweep. Raises InputError where file, key or sweep
    cannot serve, or the specimen has several sweeps.
    """
    found = measure_each([specimen], None if spectrum is None else [spectrum])
    if len(found) > 1:
        raise InputError(
            f"{specimen.path or specimen.name}: one sweep is needed, but the file names {len(found)}; leave one"
        )
    return found[0]


@dataclass(frozen=True)
class _Analysed:
    """One sweep with its poles and zeros, before other sweeps of the specimen are considered."""

    problem: Problem
    spectrum: ImpedanceSpectrum
    fitted: ImpedanceSpectrum
    extraction: Extraction


def _analysed(specimen: Specimen, spectrum: Sweep | None) -> _Analysed:
    wish = specimen.measurement or Measurement()
    if isinstance(spectrum, Path):
        wish, spectrum = wish.model_copy(update={"file": spectrum.absolute()}), None
    if spectrum is None and wish.file is None:
        raise InputError(
            f"{specimen.path or specimen.name}: measurement.file is missing; give the path of the sweep in the "
            '[measurement] table, such as file = "impedance.csv"'
        )
    if spectrum is None:
        spectrum = read_sweep(wish, wish.file)
    else:
        spectrum = spectrum if (fixture := _compensation(wish)) is None else fixture.applied(spectrum)
        wish, spectrum = wish.model_copy(update={"file": None}), accept_spectrum(spectrum, **_corrections(wish))
    spectrum = _without_clipped(spectrum)
    problem = prepare(specimen.model_copy(update={"measurement": wish}), check=False)
    fitted = _without_held_out(spectrum, wish.held_out, str(specimen.path or specimen.name))
    found = extract(fitted)
    if found.fundamental is not None:  # what is no impedance has none
        _refuse_another_unit(spectrum, problem)
    return _Analysed(problem, spectrum, fitted, found)


def _refuse_another_unit(spectrum: ImpedanceSpectrum, problem: Problem) -> None:
    """InputError where the capacitance of a sweep is so far from that of the body that Z must be in another unit."""
    plate, omega = problem.plate, 2 * np.pi * spectrum.frequency
    expected = problem.constants.eps33T.real * plate.electrode_area / plate.electrode_gap
    ratio = float(np.median(1 / (omega * np.abs(spectrum.impedance)))) / expected
    powers = np.array([-6.0, -3.0, 3.0, 6.0])
    if np.any(np.abs(np.log10(ratio) - powers) < np.log10(_ANOTHER_UNIT)):
        raise InputError(
            f"{spectrum.source}: the capacitance is {ratio:.2g} times the {1e12 * expected:.3g} pF of the specimen "
            f"{problem.specimen.name}; give the unit of the impedance, ohm or kohm, in the header, or check "
            "dimensions and contacts"
        )


def read_sweep(wish: Measurement, file: Path) -> ImpedanceSpectrum:
    """The sweep of a file, read, compensated and corrected as a [measurement] table says; InputError where it cannot
    be used.
    """
    return read_spectrum(file, **_corrections(wish), **_layout(wish, file), compensation=_compensation(wish))


def _corrections(wish: Measurement) -> dict[str, Any]:
    """The keys of [measurement] for any sweep, in a file or not."""
    return {
        "correct_phase": wish.correct_phase,
        "mask_faults": wish.mask_faults,
        "mask": wish.mask or (),
        "noise": wish.noise,
    }


def _without_clipped(spectrum: ImpedanceSpectrum) -> ImpedanceSpectrum:
    """The sweep without clipped readings, with a note on them; as it is where too few points would be left."""
    clipped, findings = find_clipping(spectrum)
    if not findings or np.count_nonzero(~clipped) < FEWEST_POINTS:
        return spectrum
    notes = (*spectrum.notes, *(finding.sentence for finding in findings))
    return replace(spectrum.select(~clipped), notes=notes)


def _without_held_out(spectrum: ImpedanceSpectrum, band: tuple[float, float] | None, where: str) -> ImpedanceSpectrum:
    """The points outside of the held-out band; InputError where these are too few to fit."""
    if band is None:
        return spectrum
    fitted = spectrum.select((spectrum.frequency < band[0]) | (spectrum.frequency > band[1]))
    if len(fitted) < min(FEWEST_POINTS, len(spectrum)):
        raise InputError(
            f"{where}: measurement.held_out = [{band[0]:g}, {band[1]:g}] Hz leaves {len(fitted)} of {len(spectrum)} "
            f"points of {spectrum.source} to fit, and at least {FEWEST_POINTS} are needed; give a narrower band"
        )
    return fitted


def _layout(wish: Measurement, file: Path) -> dict[str, Any]:
    """The keys of [measurement] that say how to read a file of this format."""
    return {"columns": wish.columns} if not is_touchstone(file) else {"connection": wish.connection}


def _refuse_idle_layout(specimen: Specimen, sweeps: Sequence[tuple[Specimen, Sweep | None]]) -> None:
    """InputError where `connection` or `columns` of [measurement] concerns none of the files that are read."""
    wish = specimen.measurement or Measurement()
    named = [given or (own.measurement or wish).file for own, given in sweeps]
    named += [wish.open, wish.short, wish.load and wish.load.file]
    files = [one for one in named if isinstance(one, Path)]
    for key, what in (("connection", "a Touchstone file"), ("columns", "a table")):
        if files and getattr(wish, key) is not None and not any(key in _layout(wish, file) for file in files):
            raise InputError(
                f"{specimen.path or specimen.name}: measurement.{key} says how to read {what}, and {files[0].name} is "
                "none; take it out"
            )


def _refuse_idle_held_out(specimen: Specimen, sweeps: Sequence[_Analysed]) -> None:
    """InputError where the band `held_out` of [measurement] holds no point of any sweep."""
    band = specimen.measurement and specimen.measurement.held_out
    if band and all(len(one.fitted) == len(one.spectrum) for one in sweeps):
        low = min(one.spectrum.frequency[0] for one in sweeps)
        high = max(one.spectrum.frequency[-1] for one in sweeps)
        raise InputError(
            f"{specimen.path or specimen.name}: measurement.held_out = [{band[0]:g}, {band[1]:g}] Hz holds no point of "
            f"the sweep, {low:g} to {high:g} Hz; give a band inside it, or take it out"
        )


def _of_one_piece(piece: Specimen, sweeps: Sequence[_Analysed]) -> list[Measured]:
    """The sweeps of a specimen, each with how it was taken and with a fundamental.

    That is the fundamental of the sweep itself if it is the same mode as the lowest one of all sweeps, else the lowest.
    """
    own = [fundamental(one.extraction.pairs) for one in sweeps]
    pairs = [pair for pair in own if pair is not None] or [fundamental_pair(sweeps[0].extraction, sweeps[0].spectrum)]
    lowest = min(pairs, key=lambda pair: pair.pole.frequency_Hz)
    found = []
    for one, pair, conditions in zip(sweeps, own, conditions_of(piece), strict=True):
        near = pair is not None and pair.pole.frequency_Hz < _SAME_MODE * lowest.pole.frequency_Hz
        pair = pair if near else lowest
        permittivity = _low_permittivity(one.problem, one.fitted, pair)
        analysed = one.problem, one.spectrum, one.fitted, one.extraction
        found.append(Measured(*analysed, pair, permittivity, piece, conditions))
    return found


def conditions_of(piece: Specimen) -> list[SweepConditions]:
    """How each sweep of a specimen was taken; a single one, upwards, where its file has no [[sweep]] tables."""
    sweeps = piece.sweep
    if sweeps is None:
        return [SweepConditions()]
    volts = [one.drive_voltage or 1.0 for one in sweeps]
    warmer, span = _from_mean([one.temperature for one in sweeps])
    return [
        SweepConditions(
            number=number,
            count=len(sweeps),
            rising=one.direction != "down",
            drive=volt / max(volts),
            fixture=one.fixture or "",
            celsius=one.temperature,
            warmer_K=float(kelvin),
            span_K=span,
        )
        for number, (one, volt, kelvin) in enumerate(zip(sweeps, volts, warmer, strict=True))
    ]


def from_common_mean(conditions: Sequence[SweepConditions]) -> list[SweepConditions]:
    """Conditions of all sweeps that are fitted together, with temperatures counted from the mean of all."""
    warmer, span = _from_mean([one.celsius for one in conditions])
    return [replace(one, warmer_K=float(kelvin), span_K=span) for one, kelvin in zip(conditions, warmer, strict=True)]


def _from_mean(celsius: Sequence[float | None]) -> tuple[np.ndarray, float]:
    """Temperatures (n,) above the mean of those that are stated, K, 0 where none is; and half their range."""
    stated = np.array([one for one in celsius if one is not None])
    if not stated.size:
        return np.zeros(len(celsius)), 0.0
    return np.array([0.0 if one is None else one - stated.mean() for one in celsius]), float(np.ptp(stated)) / 2


def _compensation(wish: Measurement) -> Compensation | None:
    """The raw sweeps of the fixture, read; None where the file names none."""
    if wish.open is None and wish.short is None:
        return None
    sweeps = {
        name: None if file is None else read_raw(file, **_layout(wish, file))
        for name, file in (("open", wish.open), ("short", wish.short), ("load", wish.load and wish.load.file))
    }
    known = None
    if wish.load is not None:
        given = {key: value for key, value in wish.load if key != "file" and value is not None}
        known = Load(**given)
    return Compensation(**sweeps, standard=known)


def fundamental_pair(extraction: Extraction, spectrum: ImpedanceSpectrum) -> Pair:
    """The fundamental of the sweep (`femu_piezo.extraction.roots.fundamental`); InputError where there is no pair."""
    found = fundamental(extraction.pairs)
    if found is None:
        if extraction.status == "lossless":
            raise InputError(f"{spectrum.source}: {extraction.notes[0]}")
        told = (*extraction.notes, *extraction.remarks[-1:])
        reasons = f" ({'; '.join(told)})" if told else ""
        raise InputError(
            f"{spectrum.source}: no resonance with both its pole and its zero was found between "
            f"{hertz(spectrum.frequency[0])} and {hertz(spectrum.frequency[-1])} Hz{reasons}; "
            "measure a band that holds both"
        )
    return found


def _low_permittivity(problem: Problem, spectrum: ImpedanceSpectrum, pair: Pair) -> complex | None:
    """Mean permittivity of the low points; None where the sweep has none or the static field is not uniform.

    A reading far from the others (five of their robust deviations) is left out where there are enough to tell.
    """
    if spectrum.frequency[0] > LOW_FREQUENCY_SHARE * pair.pole.frequency_Hz or not has_uniform_field(problem.plate):
        return None
    low = _low_points(problem, spectrum, pair)
    gap, area = problem.plate.electrode_gap, problem.plate.electrode_area
    frequency = spectrum.frequency[low]
    apparent = static_permittivity(frequency, spectrum.impedance[low], gap, area)
    values = apparent / (1 + _quasistatic_rise(problem, pair, frequency))
    distance = np.abs(values - (np.median(values.real) + 1j * np.median(values.imag)))
    if values.size >= 5:
        values = values[distance <= 5 * max(np.median(distance) / 0.83, 1e-9 * abs(values[0]))]
    return complex(np.mean(values))


def _low_points(problem: Problem, spectrum: ImpedanceSpectrum, pair: Pair) -> np.ndarray:
    """(k,) bool: the points below 5 % of the pole for a bar, whose rise is known; below 1 % for other bodies."""
    share = LOW_POINTS_SHARE if isinstance(problem.plate, Plate) else 0.01
    return spectrum.frequency <= max(spectrum.frequency[0], share * pair.pole.frequency_Hz)


def _quasistatic_rise(problem: Problem, pair: Pair, frequency: np.ndarray) -> np.ndarray:
    """Relative rise of the capacitance towards the resonance, k² X²/3 with X = (π/2) f/f_p (bar, tan X/X ≈ 1 + X²/3).

    For a k33 bar k²/(1 − k²) X²/3 with X = (π/2) f/f_z. Zero for bodies other than bars.
    """
    if not isinstance(problem.plate, Plate):
        return np.zeros(frequency.shape)
    if problem.plate.poling == "length":
        x = np.pi / 2 * frequency / pair.zero.frequency_Hz
        k2 = bar_coupling("length", pair.pole.frequency_Hz, pair.zero.frequency_Hz)
        return k2 / (1 - k2) * x**2 / 3
    x = np.pi / 2 * frequency / pair.pole.frequency_Hz
    return bar_coupling("thickness", pair.pole.frequency_Hz, pair.zero.frequency_Hz) * x**2 / 3


def start_constants(measured: list[Measured]) -> PiezoConstants:
    """The constants of the first specimen's file, with what the sweeps of all give by thin-body formulas.

    The file's alone where both together are no stable material: the formulas fail where modes of two dimensions meet.
    """
    problem = measured[0].problem
    constants = problem.constants
    for one in measured:
        constants = constants.with_values(**one.start_values(problem.specimen.material.free))
    constants = problem.simplified(constants)
    if constants.physical_faults(passive=False) and not problem.constants.physical_faults(passive=False):
        return problem.constants
    where = f"{problem.specimen.path}: with the start values by thin-body formulas"
    return constants.check(where, passive=False)


def baseline_constants(measured: list[Measured], start: PiezoConstants) -> tuple[PiezoConstants, tuple[str, ...]]:
    """The constants of the file as the baseline; the start values, with a note, where those are no stable material."""
    constants = measured[0].problem.constants
    faults = constants.physical_faults(passive=False)
    if not faults:
        return constants, ()
    told = "; ".join(map(str, faults))
    return start, (
        f"the baseline has the start values, since the constants of the specimen file are impossible: {told}",
    )
