"""What a fit says against the tolerances that it allows: of dimensions, density, held constants, instrument, sweeps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

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
    "file": "the sweep contradicts the file by many of its standard deviations (σ): {moved}; check these numbers, or "
    "let `femu-piezo diagnose` look for what the model lacks",
    "sweeps": "the sweeps contradict each other: their resonances are shifted by many standard deviations (σ) of what "
    "differs from sweep to sweep, {moved}; check temperature, drive and clamping, and that all are of one piece",
    "instrument": "the sweep contradicts the accuracy of instrument and fixture by many standard deviations (σ): "
    "{moved}; compensate open and short, state what is there in [effects], or let `femu-piezo diagnose` look for it",
}


def contradicted(found: Fit, kinds: Sequence[str] = tuple(_SENTENCES)) -> list[str]:
    """A note for each kind of tolerance of which the fit moved some by more than `CONTRADICTS` standard deviations.

    Those of held constants are told by `of_another_material`.

    kinds : "file" (dimensions and density), "sweeps" (one against the other), "instrument"
    """
    told: dict[str, list[str]] = {kind: [] for kind in kinds}
    for effect, number, away in _moved(found):
        kind = "sweeps" if effect.name == REPEATABILITY else _KINDS.get(source_of(effect))
        if kind in told:
            told[kind].append(f"{_label(effect, number)} {_size(effect, number, away)}")
    return [_SENTENCES[kind].format(moved=", ".join(moved)) for kind, moved in told.items() if moved]


def _label(effect: Effect, number: int) -> str:
    """A tolerance in words: "width", "stray capacitance", "phase near 10000 Hz", "sweep 2"."""
    name = effect.parameters[number].name.replace("_", " ")
    if effect.name == INSTRUMENT:
        kind, frequency = name.split()
        return f"{kind} near {hertz(float(frequency))} Hz"
    title = effect.title.removeprefix("wrong_").replace("_", " ")
    return name if effect.name == REPEATABILITY else f"{title}, {name}" if number else title


def of_another_material(found: Fit, base: str | None) -> list[str]:
    """The same of held constants; where these are several, with the library material nearest to what was found.

    base : library material of the specimen file
    """
    moved = {
        D_FORM[effect.constants.index]: _size(effect, number, away)
        for effect, number, away in _moved(found)
        if isinstance(effect.constants, ConstantFactor) and number == 0
    }
    if not moved:
        return []
    told = ", ".join(f"{name} {size}" for name, size in moved.items())
    near = ""
    if len(moved) > 1:
        names = (*found.parameters.material.free.names, *moved)
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


def _moved(found: Fit) -> Iterator[tuple[Effect, int, float]]:
    """Effects with a parameter that the fit moved far from rest, the number of that parameter, and how far."""
    for effect, values in zip(found.parameters.effects, found.parameters.values(found.x), strict=True):
        for number, away in enumerate((values - effect.rest).tolist()):
            if abs(away) > CONTRADICTS * effect.tolerance[number] > 0:
                yield effect, number, away


def _size(effect: Effect, number: int, away: float) -> str:
    """How far a parameter was moved, in words, and over its standard deviation."""
    parameter, sign, size = effect.parameters[number], "+" if away > 0 else "", float(f"{away:.2g}")
    if effect.name == INSTRUMENT:  # in units of the accuracy
        return f"{away:+.0f} σ"
    told = f"{100 * size:.2g} %" if effect.name == REPEATABILITY else quantity(parameter, size)
    return f"{sign}{told} ({abs(away) / effect.tolerance[number]:.0f} σ)"
