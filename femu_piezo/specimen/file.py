"""The specimen file (TOML): the specimen, its measured sweep, its material, and options of the commands.

    specimen = read_specimen("plate.toml")
    write_specimen(specimen, "copy.toml")

All values are SI floats once read. Every wrong input is one `InputError` sentence that names file, key, value
and what would be right; the models raise it too when they are built in Python.
"""

from __future__ import annotations

import json
import math
import os
import re
import tomllib
from collections.abc import Iterable, Sequence
from copy import deepcopy
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, ConfigDict, ValidationInfo, model_validator

from femu_piezo.errors import InputError
from femu_piezo.files import path_of, read_bytes, unset_variables, write_atomically
from femu_piezo.specimen.geometry import Geometry as Geometry
from femu_piezo.specimen.geometry import Mass
from femu_piezo.specimen.schema import LIST, PAIR, PATH, Table, described, key_in_file, quantity
from femu_piezo.units import EPS0, parse_temperature, shown

CONSTANTS = ("s11", "s12", "s13", "s33", "s44", "d31", "d33", "d15", "eps11T", "eps33T")
"""The ten complex material parameters by their names in specimen files (IEEE 176; T: at constant stress)."""

_LARGEST_FILE = 1_000_000
_KEPT = 4  # specimen files whose content is kept
_FREE = {"thickness": ("s11", "d31", "eps33T"), "length": ("s33", "d33", "eps33T")}
_FREE_IN_SHEAR = ("s44", "d15", "eps11T")

Frequency = Annotated[float, quantity("Hz", 1e-3, 1e10, 'give a positive frequency such as "90 kHz"')]
_COMPLIANCE = "compliances are given in m^2/N, such as 16.5e-12"
Compliance = Annotated[float, quantity("m^2/N", 1e-14, 1e-9, _COMPLIANCE)]
CrossCompliance = Annotated[float, quantity("m^2/N", -1e-9, 1e-9, _COMPLIANCE)]
Charge = Annotated[float, quantity("C/N", -1e-8, 1e-8, "piezoelectric constants are given in C/N, such as -255e-12")]
Permittivity = Annotated[float, quantity("F/m", EPS0, 1e6 * EPS0, 'permittivities are given in F/m or as "3400 eps0"')]
LossTangent = Annotated[float, quantity("1", 0, 1, 'loss tangents are pure numbers such as 0.015 or "1.5 %"')]
CrossLossTangent = Annotated[float, quantity("1", -1, 1, 'loss tangents are pure numbers such as 0.015 or "1.5 %"')]
PriorStd = Annotated[
    float, quantity("1", 1e-6, 10, 'prior knowledge is a relative standard deviation, such as 0.05 or "5 %"')
]
TangentStd = Annotated[float, quantity("1", 0, 1, "the standard deviation of a loss tangent, such as 0.005")]
MagnitudeStd = Annotated[
    float, quantity("1", 0, 1, 'the accuracy of |Z| is a relative standard deviation, such as 0.0008 or "0.08 %"')
]
PhaseStd = Annotated[float, quantity("rad", 0, 0.5, 'the accuracy of a phase is an angle such as "0.8 mrad"')]
Resistance = Annotated[float, quantity("ohm", 0, 1e6, 'a residue is a resistance such as "20 mohm"')]
Inductance = Annotated[float, quantity("H", 0, 1.0, 'a residue is an inductance such as "10 nH"')]
Capacitance = Annotated[float, quantity("F", 0, 1e-3, 'a residue is a capacitance such as "0.1 pF"')]
RelativeNoise = Annotated[
    float, quantity("1", 0, 1, 'noise is the relative standard deviation, such as 0.001 or "0.1 %"')
]
ReadCapacitance = Annotated[
    float, quantity("F", 1e-15, 1e-3, 'the capacitance at 1 kHz is one such as "1.23 nF"; is the unit right?')
]
Speed = Annotated[float, quantity("m/s", 100, 20000, 'a sound velocity is one such as "4500 m/s"; is the unit right?')]
ReadStd = Annotated[
    float, quantity("1", 1e-6, 1, 'the deviation of a reading is relative, such as 0.01 or "1 %", and not zero')
]
READ = ("mass", "capacitance", "d33", "sound_velocity")
"""Quantities of a specimen that other instruments read; `std_NAME` is the relative standard deviation of each."""

Voltage = Annotated[float, quantity("V", 1e-6, 1e4, 'a drive voltage is one such as "0.5 V"; is the unit right?')]
Bias = Annotated[float, quantity("V", 0, 1e4, 'the largest bias is a voltage such as "0 V"; is the unit right?')]
Accuracy = Annotated[float, quantity("1", 1e-9, 0.1, "give the relative eigenvalue error, such as 1e-4")]


_ELASTIC = described("compliance at constant field")
_COUPLING = described("piezoelectric constant")
_DIELECTRIC = described("permittivity at constant stress")
_TANGENT = described("loss tangent of the constant; default: that of the base, without a base 0")
_STD = described(
    "prior standard deviation of the real part, relative; the default of a free constant is 0.5", usual=0.03
)
_TANGENT_STD = described(
    "prior standard deviation of the loss tangent, absolute; the default prior of a free constant is 0.02 ± 0.05",
    usual=0.005,
)


class Material(Table):
    """A base of the material library and overrides, or all ten constants; complex: value (1 − j tan)."""

    model_config = ConfigDict(title="material")

    base: str | None = described("name of a material of the library, whose values the other keys override")
    s11: Compliance | None = _ELASTIC
    s12: CrossCompliance | None = _ELASTIC
    s13: CrossCompliance | None = _ELASTIC
    s33: Compliance | None = _ELASTIC
    s44: Compliance | None = _ELASTIC
    d31: Charge | None = _COUPLING
    d33: Charge | None = _COUPLING
    d15: Charge | None = _COUPLING
    eps11T: Permittivity | None = _DIELECTRIC
    eps33T: Permittivity | None = _DIELECTRIC
    tan_s11: LossTangent | None = _TANGENT
    tan_s12: CrossLossTangent | None = _TANGENT
    tan_s13: CrossLossTangent | None = _TANGENT
    tan_s33: LossTangent | None = _TANGENT
    tan_s44: LossTangent | None = _TANGENT
    tan_d31: CrossLossTangent | None = _TANGENT
    tan_d33: CrossLossTangent | None = _TANGENT
    tan_d15: CrossLossTangent | None = _TANGENT
    tan_eps11T: LossTangent | None = _TANGENT
    tan_eps33T: LossTangent | None = _TANGENT
    std_s11: PriorStd | None = _STD
    std_s12: PriorStd | None = _STD
    std_s13: PriorStd | None = _STD
    std_s33: PriorStd | None = _STD
    std_s44: PriorStd | None = _STD
    std_d31: PriorStd | None = _STD
    std_d33: PriorStd | None = _STD
    std_d15: PriorStd | None = _STD
    std_eps11T: PriorStd | None = _STD
    std_eps33T: PriorStd | None = _STD
    std_tan_s11: TangentStd | None = _TANGENT_STD
    std_tan_s12: TangentStd | None = _TANGENT_STD
    std_tan_s13: TangentStd | None = _TANGENT_STD
    std_tan_s33: TangentStd | None = _TANGENT_STD
    std_tan_s44: TangentStd | None = _TANGENT_STD
    std_tan_d31: TangentStd | None = _TANGENT_STD
    std_tan_d33: TangentStd | None = _TANGENT_STD
    std_tan_d15: TangentStd | None = _TANGENT_STD
    std_tan_eps11T: TangentStd | None = _TANGENT_STD
    std_tan_eps33T: TangentStd | None = _TANGENT_STD
    free: Annotated[tuple[str, ...] | None, LIST] = described(
        "free constants, which a fit finds; default: s11, d31, eps33T of a piece poled through its thickness; s33, "
        "d33, eps33T of one poled along its length; s44, d15, eps11T (shear) for any other direction"
    )
    simplified: bool = described("use the isotropic simplification of the paper", False)

    @property
    def values(self) -> dict[str, float]:
        """The constants given here, SI: name → real part."""
        return {name: getattr(self, name) for name in CONSTANTS if getattr(self, name) is not None}

    @property
    def tangents(self) -> dict[str, float]:
        """The loss tangents given here: name of the constant → tan. Absent: that of `base`, else 0."""
        tangents = {name: getattr(self, f"tan_{name}") for name in CONSTANTS}
        return {name: tan for name, tan in tangents.items() if tan is not None}

    @property
    def priors(self) -> dict[str, float]:
        """Relative standard deviations of what is known beforehand: name of the constant → std."""
        found = {name: getattr(self, f"std_{name}") for name in CONSTANTS}
        return {name: std for name, std in found.items() if std is not None}

    @property
    def tangent_priors(self) -> dict[str, float]:
        """Standard deviations of loss tangents that are known beforehand: name of the constant → std."""
        found = {name: getattr(self, f"std_tan_{name}") for name in CONSTANTS}
        return {name: std for name, std in found.items() if std is not None}

    def problem(self) -> str | None:
        if self.base is not None and not (self.base.strip() and self.base.isprintable()):
            return f"material.base = {shown(self.base)} is not a name; give one of the material library"
        missing = [name for name in CONSTANTS if name not in self.values]
        if self.base is None and missing:
            return (
                f"material has no base and lacks {', '.join(missing)}; name a base of the library, such as "
                'base = "tj52-hd", or give all ten constants'
            )
        for name in self.free or ():
            if name not in CONSTANTS:
                return f"material.free names {shown(name)}, which is none of {', '.join(CONSTANTS)}"
            if self.free.count(name) > 1:
                return f"material.free names {shown(name)} twice; name each constant once"
        return None


class Residue(Table):
    """Residual elements of a fixture after its compensation, as standard deviations."""

    model_config = ConfigDict(title="measurement.residue")

    resistance: Resistance | None = described("standard deviation of a resistance in series", usual=0.02)
    inductance: Inductance | None = described("standard deviation of an inductance in series", usual=10e-9)
    capacitance: Capacitance | None = described("standard deviation of a capacitance in parallel", usual=0.1e-12)


class LoadStandard(Table):
    """The load of a compensation: its raw sweep and its true impedance."""

    model_config = ConfigDict(title="measurement.load")
    missing: ClassVar[dict[str, str]] = {
        "file": 'give the raw sweep of the load, such as file = "load.csv"',
        "resistance": 'say what the load is, such as resistance = "100 ohm"',
    }

    file: Annotated[Path, PATH] = described("raw sweep of the load", ...)
    resistance: Resistance = described("resistance of the load", ...)
    inductance: Inductance | None = described("inductance in series with the resistance")
    capacitance: Capacitance | None = described("capacitance in parallel with both")
    std: MagnitudeStd | None = described("relative standard deviation of the impedance of the load; default 0")


def _to_bands(value: object) -> object:
    """Lists of TOML to tuples of (low, high); ValueError for what is no list of pairs."""
    if value is None:
        return None
    bands = value if isinstance(value, (list, tuple)) else (value,)
    if bands is not value or any(not isinstance(band, (list, tuple)) or len(band) != 2 for band in bands):
        single = len(bands) == 2 and not any(isinstance(band, (list, tuple)) for band in bands)
        right = f"[[{', '.join(map(shown, bands))}]]" if single else '[["61 kHz", "62 kHz"]]'
        given = shown(list(value) if isinstance(value, tuple) else value)
        raise ValueError(f"{given} cannot be used, since each band is a list of two frequencies; write mask = {right}")
    return tuple(map(tuple, bands))


class Measurement(Table):
    """A measured sweep and how it was taken; paths are absolute once read."""

    model_config = ConfigDict(title="measurement")

    file: Annotated[Path | None, PATH] = described(
        "path of the sweep, relative to the specimen file; a list of paths has the meaning of [[sweep]] tables; not "
        "needed where --data, [[sweep]] or Python gives the sweep"
    )
    held_out: Annotated[tuple[Frequency, Frequency] | None, PAIR] = described(
        "band that no fit uses, to test the prediction there"
    )
    mask: Annotated[tuple[tuple[Frequency, Frequency], ...] | None, BeforeValidator(_to_bands)] = described(
        "bands whose points are ignored altogether"
    )
    correct_phase: bool = described("turn the phase of the sweep by 180°", False)
    mask_faults: bool = described("leave out spikes, mains lines and stretches in another range", False)
    noise: RelativeNoise | None = described(
        "relative standard deviation of the noise of a point; default: estimated from the sweep"
    )
    accuracy: MagnitudeStd | None = described(
        "relative standard deviation of the instrument's error of |Z|, which is smooth over frequency", usual=0.0008
    )
    phase_accuracy: PhaseStd | None = described(
        "standard deviation of the instrument's error of phase, which is smooth over frequency", usual=0.0008
    )
    residue: Residue | None = described("table: residual elements of the fixture after its compensation")
    open: Annotated[Path | None, PATH] = described("raw sweep of the open fixture, to compensate a raw sweep with")
    short: Annotated[Path | None, PATH] = described("raw sweep of the shorted fixture, likewise")
    load: LoadStandard | None = described("table: raw sweep of a known load in the fixture, likewise")
    connection: Literal["reflection", "series", "shunt"] | None = described(
        "how the piece was connected, for a Touchstone file; default: detected from the data"
    )
    columns: Annotated[tuple[str, ...] | None, LIST] = described(
        'names of the columns of the file, such as ["Frequency (Hz)", "R (Ohm)", "X (Ohm)"], instead of its header'
    )

    @property
    def magnitude_std(self) -> float:
        """Relative standard deviation of the smooth error of |Z|, of the instrument and of the load together."""
        load = 0.0 if self.load is None else self.load.std or 0.0
        return math.hypot(self.stated("accuracy"), load)

    @property
    def of_corrected(self) -> Measurement:
        """This table for a sweep after all corrections that it asks for, as this program writes it.

        No correction is asked for once more, and nothing of how a file was laid out; no file is named.
        """
        corrections = ("correct_phase", "mask_faults", "mask", "open", "short", "load", "connection", "columns")
        changes: dict[str, Any] = {key: type(self).model_fields[key].get_default() for key in corrections}
        if self.load is not None and self.load.std:
            changes["accuracy"] = self.magnitude_std
        return self.model_copy(update=changes | {"file": None})

    def problem(self) -> str | None:
        if self.held_out is not None and not self.held_out[0] < self.held_out[1]:
            low, high = self.held_out
            return f"measurement.held_out = [{low:g}, {high:g}] Hz is not a band; give the lower frequency first"
        for low, high in self.mask or ():
            if not low < high:
                return f"measurement.mask holds [{low:g}, {high:g}] Hz, not a band; give the lower frequency first"
        if self.load is not None and (self.open is None or self.short is None):
            return "measurement.load needs measurement.open and measurement.short; give these files as well"
        if self.noise == 0:
            return "measurement.noise = 0 would mean exact data; leave the key out to have the noise estimated"
        return None


def _celsius(value: object, info: ValidationInfo) -> float | None:
    return None if value is None else parse_temperature(value, key_in_file(info))


class Sweep(Table):
    """One of several sweeps of a specimen, and how it was taken.

    Voltage, temperature and fixture are given of all sweeps or of none.
    """

    model_config = ConfigDict(title="sweep")
    missing: ClassVar[dict[str, str]] = {"file": 'give the path of the sweep, such as file = "up.csv"'}

    file: Annotated[Path, PATH] = described("path of the sweep, relative to the specimen file", ...)
    name: str | None = described("name of the sweep in results; default: the name of the file")
    drive_voltage: Voltage | None = described(
        "drive, rms, as analysers state it (only the ratios count); of all sweeps or of none"
    )
    temperature: Annotated[float | None, BeforeValidator(_celsius)] = described(
        'temperature of the specimen, "25 °C" or "298 K" (in Python °C); of all sweeps or of none'
    )
    direction: Literal["up", "down"] | None = described("whether the frequency rose or fell with time")
    fixture: str | None = described(
        "name of the fixture, which has residual elements and leads of its own; of all sweeps or of none"
    )

    @property
    def label(self) -> str:
        """Its name in results."""
        return self.file.stem if self.name is None else self.name


class Readings(Table):
    """Readings of other instruments of the specimen, each with its relative standard deviation."""

    model_config = ConfigDict(title="readings")

    mass: Mass | None = described("mass of the specimen")
    capacitance: ReadCapacitance | None = described("capacitance of the specimen at 1 kHz, without the fixture")
    d33: Charge | None = described("reading of a d33 meter")
    sound_velocity: Speed | None = described("velocity of a plane longitudinal wave along the poling, √(c33D/ρ)")
    std_mass: ReadStd | None = described("relative standard deviation of the reading", usual=1e-3)
    std_capacitance: ReadStd | None = described("relative standard deviation of the reading", usual=0.01)
    std_d33: ReadStd | None = described("relative standard deviation of the reading", usual=0.05)
    std_sound_velocity: ReadStd | None = described("relative standard deviation of the reading", usual=0.01)

    @property
    def given(self) -> dict[str, tuple[float, float]]:
        """Name → value, SI, and relative standard deviation."""
        values = {name: getattr(self, name) for name in READ}
        return {name: (value, self.stated(f"std_{name}")) for name, value in values.items() if value is not None}

    def problem(self) -> str | None:
        for name in READ:
            if getattr(self, f"std_{name}") is not None and getattr(self, name) is None:
                return f"readings.std_{name} is given without readings.{name}; give that reading, or take the std out"
        if self.d33 == 0:
            return "readings.d33 = 0 means a body that is not poled; leave it out"
        return None


class Limits(Table):
    """What the specimen may be exposed to while it is measured; no instrument is ever set beyond these limits."""

    model_config = ConfigDict(title="limits")

    voltage: Voltage = described("largest drive, rms, as analysers state it", 0.5)
    bias: Bias = described("largest DC bias of either sign", 0.0)
    frequency: Annotated[tuple[Frequency, Frequency] | None, PAIR] = described(
        "lowest and highest frequency; default: those of the instrument"
    )

    def problem(self) -> str | None:
        if self.frequency is not None and not self.frequency[0] < self.frequency[1]:
            low, high = self.frequency
            return f"limits.frequency = [{low:g}, {high:g}] Hz is not a band; give the lower frequency first"
        return None


#: Where a simulated sweep begins unless the file says otherwise.
LOWEST_HZ = 100.0


class Simulation(Table):
    """Sweep of a simulation, also the band of `measure` and the planned sweep of `identify`."""

    model_config = ConfigDict(title="simulation")

    start: Frequency | None = described(f"lowest frequency; default {LOWEST_HZ:g} Hz")
    stop: Frequency | None = described("highest frequency; default: 3.5 times the expected fundamental")
    points: int = described("number of points, 2 to 1000000", 801)
    spacing: Literal["linear", "log"] = described("spacing of the frequencies", "linear")
    noise: RelativeNoise = described("relative standard deviation of the noise added to every point", 0.0)
    seed: int = described("seed of the noise, 0 to 2^63 − 1", 0)
    order: int | None = described(
        "polynomial order of the finite elements, 1 to 8; default: chosen by the program for the accuracy"
    )

    @property
    def lowest(self) -> float:
        """The lowest frequency, Hz."""
        return self.start or LOWEST_HZ

    def problem(self) -> str | None:
        if self.stop is not None and not self.lowest < self.stop:
            if self.start is None:
                return f"simulation.stop = {self.stop:g} Hz is not above the usual start, {LOWEST_HZ:g} Hz; give start"
            return f"simulation.start = {self.start:g} Hz is not below stop = {self.stop:g} Hz; exchange them"
        if not 2 <= self.points <= 1_000_000:
            return f"simulation.points = {self.points} is outside 2 … 1000000; 801 is usual"
        if not 0 <= self.seed < 2**63:
            return f"simulation.seed = {self.seed} is outside 0 … 2^63 - 1; give a whole number such as 1"
        if self.order is not None and not 1 <= self.order <= 8:
            return f"simulation.order = {self.order} is outside 1 … 8; leave it out to have it chosen"
        return None


class Update(Table):
    """Options of an update."""

    model_config = ConfigDict(title="update")

    method: Literal["auto", "pole_zero", "curve"] = described(
        '"auto" and "curve": fit of the whole curve; "pole_zero": the method of the paper, from poles and zeros alone',
        "auto",
    )
    accuracy: Accuracy = described("largest relative error of an eigenvalue by the mesh", 1e-4)
    loss: Literal["linear", "soft_l1", "huber", "cauchy"] = described(
        "loss function of the curve fit: linear (least squares), or robust against outliers", "linear"
    )
    noise_only: bool = described("treat dimensions, density, held constants and instrument as exactly known", False)


Effects = dict[str, dict[str, float | str | Annotated[tuple[str, ...], LIST]]]


class Specimen(Table):
    """One piece: geometry, material and, where given, its measured sweep and what to do with them."""

    model_config = ConfigDict(title="")
    missing: ClassVar[dict[str, str]] = {
        "name": 'give a name such as name = "plate 07"',
        "geometry": "add a [geometry] table with shape, its dimensions and poling",
        "material": "add a [material] table with base or the ten constants",
    }

    name: str = described("a line of 1 to 200 characters; default: the name of the file", ...)
    geometry: Geometry = described("shape, dimensions, electrodes, poling", ...)
    material: Material = described("start values of the constants, and which constants are free", ...)
    measurement: Measurement | None = described("the sweep and how it was taken")
    sweep: Annotated[tuple[Sweep, ...] | None, LIST] = described(
        "several sweeps and how each was taken; the keys of [measurement] but `file` apply to all of them"
    )
    readings: Readings | None = described("readings of other instruments")
    limits: Limits = described("what the specimen may be exposed to while it is measured", Limits())
    simulation: Simulation | None = described("the sweep of a simulation")
    update: Update | None = described("options of an update")
    effects: Effects | None = described(
        "what the specimen has beyond the base model, effect → parameter → value, by the names of `diagnose`; the key "
        "`free` of an effect names the parameters that fits find anew, while simulations use the given value"
    )
    fitted: Effects | None = described(
        'results of a fit in the same form: the free constants ("material") and everything with a tolerance '
        "(dimensions, held constants, instrument); simulations use these values, fits only start from them and keep "
        "the values and tolerances of the other tables as priors"
    )
    path: Path | None = None

    def problem(self) -> str | None:
        if not 0 < len(self.name) <= 200 or not self.name.isprintable():
            return f"name = {shown(self.name)} is not a line of 1 to 200 characters; give a short name"
        if self.name == "prior":  # stands in results beside the names of specimens
            return 'name = "prior" is the word for what is known beforehand; give another name'
        if self.geometry.mass is not None and self.readings is not None and self.readings.mass is not None:
            return "readings.mass and geometry.mass both state the mass of the specimen; give one of the two"
        if self.sweep is not None and (wrong := self._wrong_sweeps(self.sweep)):
            return wrong
        fixtures = {one.fixture for one in self.sweep or ()} - {None}
        for kind, tables in (("effects", self.effects or {}), ("fitted", self.fitted or {})):
            for title in tables:
                if title.endswith(")") and not any(title.endswith(f" ({fixture})") for fixture in fixtures):
                    return (
                        f"{kind}.{title} names a fixture that no [[sweep]] has; known fixtures are "
                        f"{', '.join(sorted(fixtures)) or 'none'}"
                    )
        for key, value in self.fitted_constants.items():
            if key.removeprefix("tan_") not in CONSTANTS:
                return f"fitted.material.{key} is not a constant; known are {', '.join(CONSTANTS)}, each also with tan_"
            if not isinstance(value, float):
                return f"fitted.material.{key} = {shown(value)} is not a number; give it in SI units, without the unit"
        return None

    def _wrong_sweeps(self, sweeps: tuple[Sweep, ...]) -> str | None:
        if not sweeps:
            return 'sweep = [] holds no sweep; write [[sweep]] and file = "up.csv" below, or take it out'
        if self.measurement is not None and self.measurement.file is not None:
            return "measurement.file and [[sweep]] both name sweeps; give every sweep a [[sweep]] table of its own"
        labels = [one.label for one in sweeps]
        unnamed = "unless named it is called as its file; write [[sweep]] tables, each with file and a name of its own"
        if (double := next((label for label in labels if labels.count(label) > 1), None)) is not None:
            return f"two sweeps are called {shown(double)}: {unnamed}"
        if (strange := next((label for label in labels if not label.isprintable()), None)) is not None:
            return f"the name {shown(strange)} of a sweep is not one line: {unnamed}"
        for key in ("drive_voltage", "temperature", "fixture"):
            given = [one for one in sweeps if getattr(one, key) is not None]
            if 0 < len(given) < len(sweeps):
                without = next(one for one in sweeps if getattr(one, key) is None)
                return (
                    f"sweep.{key} is given for {given[0].label}, not for {without.label}; give it for all, or for none"
                )
        return None

    @property
    def of_each_sweep(self) -> tuple[Specimen, ...]:
        """A specimen for each sweep, named by specimen and sweep where there are several; itself without [[sweep]]."""
        if self.sweep is None:
            return (self,)
        several = len(self.sweep) > 1
        return tuple(
            self.model_copy(
                update={
                    "name": f"{self.name}, {one.label}" if several else self.name,
                    "measurement": (self.measurement or Measurement()).model_copy(update={"file": one.file}),
                    "sweep": (one,),
                }
            )
            for one in self.sweep
        )

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that a result of the specimen depends on, its own first."""
        table = self.measurement or Measurement()
        named = [self.path, self.geometry.file, table.file, table.open, table.short, table.load and table.load.file]
        named += [one.file for one in self.sweep or ()]
        return tuple(path for path in named if path is not None)

    @property
    def fitted_constants(self) -> dict[str, float]:
        """Fitted free constants and their loss tangents, SI: "s11", "tan_s11", … → value; empty without a fit."""
        return (self.fitted or {}).get("material", {})

    @model_validator(mode="after")
    def _default_free(self) -> Specimen:
        if self.material.free is None:
            poling = self.geometry.poling
            if isinstance(poling, tuple) and not any(poling[:2]):  # along −z
                poling = "thickness"
            material = self.material.model_copy(update={"free": _FREE.get(poling, _FREE_IN_SHEAR)})
            object.__setattr__(self, "material", material)
        return self

    def write(self, path: Path | str) -> None:
        """Write the specimen file; see `write_specimen`."""
        write_specimen(self, path)


def read_specimens(paths: Sequence[Path | str] | Path | str, data_file: Path | str | None = None) -> list[Specimen]:
    """The specimens of one or several files; a study file, which has only `specimens = ["a.toml", …]`, stands for
    those.
    """
    found = []
    several = isinstance(paths, Iterable) and not isinstance(paths, str)
    for path in map(path_of, paths if several else [paths]):
        content = _content(path, data_file)
        if isinstance(content, Specimen):
            found.append(content)
        else:
            found += [read_specimen(_resolve(member, path, f"{path}: specimens")) for member in content]
    if data_file is not None and len(found) > 1:
        raise InputError("--data gives the sweep of one specimen; with several, name each sweep in its own file")
    return found


def read_specimen(path: Path | str, data_file: Path | str | None = None) -> Specimen:
    """The specimen of a TOML file; paths in it are taken relative to it, `${NAME}` from the environment.

    data_file : the measured sweep, in place of measurement.file

    Raises InputError where the file or any value in it cannot be used.
    """
    path = path_of(path)
    return _specimen_of(_parse_toml(read_bytes(path, _LARGEST_FILE), path), path, data_file)


def _content(path: Path, data_file: Path | str | None) -> Specimen | list[str]:
    """The specimen of a file with this sweep, or the members that a study file names."""
    raw = read_bytes(path, _LARGEST_FILE)
    if data_file is None or any(sign in raw for sign in (b"$", b"~", b"\\")):  # paths by the environment
        return _content_of(raw, path, data_file)
    content = _kept_content(raw, path, "" if path.is_absolute() else os.getcwd())
    if not isinstance(content, Specimen):
        return content
    file = _resolve(str(path_of(data_file).absolute()), path, f"{path}: measurement.file")
    table = (content.measurement or Measurement()).model_copy(update={"file": file})
    tables = {"measurement": table, "effects": deepcopy(content.effects), "fitted": deepcopy(content.fitted)}
    return content.model_copy(update=tables)


@lru_cache(maxsize=_KEPT)
def _kept_content(raw: bytes, path: Path, folder: str) -> Specimen | list[str]:
    """`_content_of` a file, which stands for the sweep as well; kept, as all sweeps of a lot have one specimen file.

    folder : that to which the path is relative, "" where it is absolute
    """
    return _content_of(raw, path, path)


def _content_of(raw: bytes, path: Path, data_file: Path | str | None) -> Specimen | list[str]:
    """As `_content`, of the bytes of the file; InputError where they are neither a specimen nor a study."""
    data = _parse_toml(raw, path)
    members = data.get("specimens")
    if members is None:
        return _specimen_of(data, path, data_file)
    right = 'a study file has only the key specimens = ["k31.toml", "k33.toml"], with paths relative to it'
    if set(data) - {"specimens", "name"} or not isinstance(members, list) or not members:
        raise InputError(f"{path}: {right}")
    if not all(isinstance(member, str) for member in members):
        raise InputError(f"{path}: specimens = {shown(members)} holds entries that are not paths; {right}")
    return members


def _specimen_of(data: dict[str, Any], path: Path, data_file: Path | str | None) -> Specimen:
    """The specimen from the tables `data` of a TOML file; `data` is changed in place."""
    if "path" in data:
        raise InputError(f"{path}: path is not a key that is known; remove it")
    data.setdefault("name", path.stem)
    if data_file is not None:
        if "sweep" in data:
            raise InputError(f"{path}: both --data and [[sweep]] give sweeps; leave --data or the tables out")
        measurement = data.setdefault("measurement", {})
        if isinstance(measurement, dict):
            measurement["file"] = str(path_of(data_file).absolute())
    _several_files(data, path)
    if isinstance(data.get("sweep"), dict):
        raise InputError(f"{path}: there may be several sweep tables; write [[sweep]] in place of [sweep]")
    tables = [("geometry", data.get("geometry")), ("measurement", data.get("measurement"))]
    tables += [("sweep", table) for table in data.get("sweep") or () if isinstance(data["sweep"], list)]
    for section, table in tables:
        if isinstance(table, dict) and isinstance(table.get("file"), str):
            table["file"] = _resolve(table["file"], path, f"{path}: {section}.file")
    _resolve_fixture(data.get("measurement"), path)
    return Specimen.model_validate(data | {"path": path}, context={"file": str(path)})


def _several_files(data: dict[str, Any], path: Path) -> None:
    """Replace `measurement.file = ["a.csv", "b.csv"]` by a [[sweep]] table for each file, in place."""
    measurement = data.get("measurement")
    if not isinstance(measurement, dict) or not isinstance(measurement.get("file"), list):
        return
    files = measurement.pop("file")
    if "sweep" in data:
        raise InputError(
            f"{path}: measurement.file and [[sweep]] both name sweeps; give every sweep a [[sweep]] table of its own"
        )
    data["sweep"] = [{"file": one} for one in files]


def _resolve_fixture(measurement: Any, path: Path) -> None:
    """Make the paths of the raw sweeps of the fixture absolute, in place."""
    if not isinstance(measurement, dict):
        return
    for key in ("open", "short"):
        if isinstance(measurement.get(key), str):
            measurement[key] = _resolve(measurement[key], path, f"{path}: measurement.{key}")
    load = measurement.get("load")
    if isinstance(load, dict) and isinstance(load.get("file"), str):
        load["file"] = _resolve(load["file"], path, f"{path}: measurement.load.file")


def with_measurement(specimens: Sequence[Specimen], **wishes: bool) -> list[Specimen]:
    """The specimens with the keys of [measurement] that are True in `wishes` set to True, whatever their files say."""
    asked = {key: True for key, wish in wishes.items() if wish}
    if not asked:
        return list(specimens)
    tables = [(one.measurement or Measurement()).model_copy(update=asked) for one in specimens]
    return [one.model_copy(update={"measurement": table}) for one, table in zip(specimens, tables, strict=True)]


def with_method(specimens: Sequence[Specimen], method: str) -> list[Specimen]:
    """The specimens with the key `method` of [update] set, whatever their files say."""
    tables = [(one.update or Update()).model_copy(update={"method": method}) for one in specimens]
    return [one.model_copy(update={"update": table}) for one, table in zip(specimens, tables, strict=True)]


def _parse_toml(raw: bytes, path: Path) -> dict[str, Any]:
    """The tables of a TOML file as they stand."""
    try:
        text = raw.decode("utf-8-sig")
        if "\0" in text:
            raise InputError(f"{path}: this is not a text file; give a specimen file in TOML")
        return tomllib.loads(text)
    except UnicodeDecodeError:
        raise InputError(f"{path}: this is not UTF-8 text; give a specimen file in TOML, saved as UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        reason = str(error)[0].lower() + str(error)[1:]
        raise InputError(f'{path}: this is not TOML: {reason}; write KEY = VALUE, strings in "quotes"') from None
    except (ValueError, RecursionError):  # an integer of thousands of digits, or brackets nested as deep
        raise InputError(
            f"{path}: a number or a nesting in this file is too long; write a plain specimen file"
        ) from None


def _resolve(text: str, specimen: Path, where: str) -> Path:
    """The absolute path that `text` means in a specimen file.

    A variable that is not set stays as it is written. Reading the file then raises InputError
    (`femu_piezo.files.read_bytes`); commands that do not read it are not disturbed.
    """

    def variable(match: re.Match[str]) -> str:
        return os.environ.get(match[1]) or match[0]

    if not text.strip() or "\0" in text:
        raise InputError(f'{where}: {text!r} is not a path; give one such as "impedance.csv"')
    expanded = os.path.expanduser(re.sub(r"\$\{(\w+)\}", variable, text))
    return Path(os.path.abspath(specimen.parent / expanded))


def write_specimen(specimen: Specimen, path: Path | str) -> None:
    """Write a specimen file that reads back as `specimen`; no half-written file remains.

    Raises InputError where the file cannot be written, or a path in it has "${", which stands for a variable.
    """
    path = Path(path)
    lines = [f"name = {_toml(specimen.name)}"]
    for section in ("geometry", "material", "measurement", "readings", "limits", "simulation", "update"):
        table = getattr(specimen, section)
        if table is None or table == Limits():
            continue
        lines += ["", f"[{section}]"]
        for key, value in table:
            if isinstance(value, Table):
                inner = ", ".join(
                    f"{name} = {_toml(_relative(one, path) if isinstance(one, Path) else one)}"
                    for name, one in value
                    if one is not None
                )
                lines.append(f"{key} = {{ {inner} }}")
            elif value is not None:
                lines.append(f"{key} = {_toml(_relative(value, path) if isinstance(value, Path) else value)}")
    for one in specimen.sweep or ():
        lines += ["", "[[sweep]]"]
        given = {key: value for key, value in one if value is not None}
        lines += [f"{key} = {_toml(_relative(v, path) if isinstance(v, Path) else v)}" for key, v in given.items()]
    for kind in ("effects", "fitted"):
        for name, values in (getattr(specimen, kind) or {}).items():
            title = name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _toml(name)
            lines += ["", f"[{kind}.{title}]", *(f"{key} = {_toml(value)}" for key, value in values.items())]
    write_atomically(path, "\n".join(lines) + "\n")


def write_study(members: Sequence[str], path: Path | str) -> None:
    """Write a study file that stands for the specimen files `members`, paths relative to it."""
    write_atomically(Path(path), f"specimens = {_toml(tuple(members))}\n")


def _relative(file: Path, specimen: Path) -> str:
    """`file` as the specimen file writes it: relative where it lies in the same folder or below."""
    absolute, folder = Path(os.path.abspath(file)), Path(os.path.abspath(specimen.parent))
    if "${" in str(absolute) and not unset_variables(absolute):
        raise InputError(f"{specimen}: the path {absolute} contains '${{', which stands for a variable; rename it")
    return str(absolute.relative_to(folder)) if absolute.is_relative_to(folder) else str(absolute)


def _toml(value: str | bool | int | float | tuple) -> str:
    """A TOML value."""
    if isinstance(value, tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return str(value).lower() if isinstance(value, bool) else repr(value)
