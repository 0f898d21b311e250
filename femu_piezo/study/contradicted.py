"""What a fit says against the tolerances that it allows: of dimensions, density, held constants, instrument, sweeps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from femu_piezo.effects.constant_factor import ConstantFactor
from femu_piezo.effects.effect import Effect
from femu_piezo.effects.library.between_sweeps import REPEATABILITY
from femu_piezo.effects.library.instrument import INSTRUMENT
from femu_piezo.effects.words import quantity
from femu_piezo.inference.budget import source_of
from femu_piezo.inference.fit import Fit
from femu_piezo.inference.readings import CONTRADICTS
from femu_piezo.material.constants import D_FORM, PiezoConstants
from femu_piezo.material.library import library_material, library_names
from femu_piezo.study.unknowns import constants_found
from femu_piezo.units import hertz

#: Kind of tolerance that each source of uncertainty is told as.
_KINDS = {"geometry": "file", "density": "file", "instrument": "instrument"}
_SENTENCES = {
    "file": "the sweep contradicts the file by many of its standard deviations (σ): {strained}; check these numbers, "
    "or let `femu-piezo diagnose` look for what the model lacks",
    "sweeps": "the sweeps contradict each other: their resonances are shifted by many standard deviations (σ) of what "
    "differs from sweep to sweep, {strained}; check temperature, drive and clamping, and that all are of one piece",
    "instrument": "the sweep contradicts the accuracy of instrument and fixture by many standard deviations (σ): "
    "{strained}; compensate open and short, state what is there in [effects], or let `femu-piezo diagnose` look for it",
}


def contradicted(found: Fit) -> list[str]:
    """A note for each kind of tolerance of which the fit strained some by more than `CONTRADICTS` standard deviations.

    Those of held constants are told by `of_another_material`.
    """
    told: dict[str, list[str]] = {kind: [] for kind in _SENTENCES}
    for one in _strained(found):
        kind = "sweeps" if one.effect.name == REPEATABILITY else _KINDS.get(source_of(one.effect))
        if kind is not None:
            told[kind].append(f"{_label(one.effect, one.number, found.data.frequency)} {_size(one)}")
    return [_SENTENCES[kind].format(strained=", ".join(several)) for kind, several in told.items() if several]


def at_limits(found: Fit) -> list[str]:
    """A note on the unknowns that ended at a limit of their range."""
    unknowns = found.parameters
    constants = [name for name in unknowns.material.names if name in found.on_bound]
    ended = np.flatnonzero(unknowns.on_bound(found.x)[unknowns.of_material :]) if found.on_bound else []
    every = [(effect, number) for effect in unknowns.effects for number in range(len(effect.parameters))]
    told = [*constants, *(_label(*every[place], found.data.frequency) for place in ended)]
    return [f"{', '.join(told)} reached a limit of the range that the fit allows"] if told else []


def _label(effect: Effect, number: int, frequency: np.ndarray) -> str:
    """A parameter in words: "width", "stray capacitance", "held s12", "phase near 10000 Hz", "sweep 2", and whose.

    frequency : (k,) of the sweeps, Hz: errors of the instrument that are centred beyond are told at their end
    """
    name = effect.parameters[number].name.replace("_", " ")
    words = effect.name.removeprefix("wrong_").replace("_", " ")
    if isinstance(effect.constants, ConstantFactor):
        words = f"held {D_FORM[effect.constants.index]}" if number == 0 else f"held {name.replace(' ', '_')}"
    elif effect.name == REPEATABILITY:
        words = name
    elif effect.name == INSTRUMENT:
        kind, at = name.split()
        words = f"{kind} near {hertz(float(np.clip(float(at), frequency.min(), frequency.max())))} Hz"
    elif number:
        words += f", {name}"
    return f"{words} of {effect.owner}" if effect.owner else words


def of_another_material(found: Fit, base: str | None) -> list[str]:
    """The same of held constants; where these are several, with the library material nearest to what was found.

    base : library material of the specimen file
    """
    strained = {
        D_FORM[one.effect.constants.index]: _size(one)
        for one in _strained(found)
        if isinstance(one.effect.constants, ConstantFactor) and one.number == 0
    }
    if not strained:
        return []
    told = ", ".join(f"{name} {size}" for name, size in strained.items())
    near = ""
    if len(strained) > 1:
        names = (*found.parameters.material.free.names, *strained)
        near = nearest_material(constants_found(found.parameters, found.x), names)
    return [
        "the held constants may be those of another material: the sweep contradicts them by many of their standard "
        f"deviations (σ), {told}; "
        + (f"of the library, {near} is nearest to what was found: " if near not in ("", base) else "")
        + "see material.base and its values"
    ]


def nearest_material(constants: PiezoConstants, names: Sequence[str]) -> str:
    """The library material with the least sum of squares of ln ratios of real parts, over the named constants."""
    at = [D_FORM.index(name) for name in names]

    def distance(name: str) -> float:
        of_library = library_material(name).constants.vector().real[at]
        if not np.all(of_library):  # of the simplified ones
            return np.inf
        return float(np.linalg.norm(np.log(np.abs(constants.vector().real[at] / of_library))))

    return min(library_names(), key=distance)


@dataclass(frozen=True)
class _Strained:
    """Parameter `number` of an effect, `away` from rest (SI), and the same over its standard deviation."""

    effect: Effect
    number: int
    away: float
    over_std: float


def _strained(found: Fit) -> Iterator[_Strained]:
    """The parameters of effects that the fit moved farther from rest than `CONTRADICTS` standard deviations.

    Shifts from sweep to sweep are taken from their mean, which sweeps do not tell from a change of the constants.
    """
    for effect, values in zip(found.parameters.effects, found.parameters.values(found.x), strict=True):
        away, std = values - effect.rest, effect.tolerance
        if effect.name == REPEATABILITY:
            away, std = away - away.mean(), std * np.sqrt(1 - 1 / away.size)
        for number in np.flatnonzero((std > 0) & (np.abs(away) > CONTRADICTS * std)).tolist():
            yield _Strained(effect, number, float(away[number]), float(away[number] / std[number]))


def _size(one: _Strained) -> str:
    """How far a parameter is off, in words, and over its standard deviation."""
    if one.effect.name == INSTRUMENT:  # in units of the accuracy
        return f"{one.over_std:+.0f} σ"
    sign, size = "+" if one.away > 0 else "", float(f"{one.away:.2g}")
    parameter = one.effect.parameters[one.number]
    told = f"{100 * size:.2g} %" if one.effect.name == REPEATABILITY else quantity(parameter, size)
    return f"{sign}{told} ({abs(one.over_std):.0f} σ)"
