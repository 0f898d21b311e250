"""What a fit says against the numbers that a specimen file states: dimensions, density and held constants."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from femu_piezo.effects.constant_factor import ConstantFactor
from femu_piezo.effects.effect import Effect
from femu_piezo.effects.words import quantity
from femu_piezo.inference.budget import source_of
from femu_piezo.inference.fit import Fit
from femu_piezo.inference.readings import CONTRADICTS
from femu_piezo.material.constants import D_FORM, PiezoConstants
from femu_piezo.material.library import library_material, library_names
from femu_piezo.study.unknowns import constants_found


def contradicted(found: Fit) -> list[str]:
    """A note where the fit moved dimensions or density by more than `CONTRADICTS` of their standard deviations."""
    moved = [
        f"{effect.title.removeprefix('wrong_')} {_size(effect, away)}"
        for effect, away in _moved(found)
        if source_of(effect) in ("geometry", "density")
    ]
    if not moved:
        return []
    return [
        f"the sweep contradicts the file by many of its standard deviations (σ): {', '.join(moved)}; check these "
        "numbers, or let `femu-piezo diagnose` look for what the model lacks"
    ]


def of_another_material(found: Fit, base: str | None) -> list[str]:
    """The same of held constants; where these are several, with the library material nearest to what was found.

    base : library material of the specimen file
    """
    moved = {
        D_FORM[effect.constants.index]: _size(effect, away)
        for effect, away in _moved(found)
        if isinstance(effect.constants, ConstantFactor)
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


def _moved(found: Fit) -> Iterator[tuple[Effect, float]]:
    """The effects whose first parameter, a relative error, the fit moved far from rest, and how far."""
    for effect, values in zip(found.parameters.effects, found.parameters.values(found.x), strict=True):
        away = float(values[0] - effect.rest[0])
        if abs(away) > CONTRADICTS * effect.tolerance[0] > 0:
            yield effect, away


def _size(effect: Effect, away: float) -> str:
    """A relative error in words, and over its standard deviation."""
    sign = "+" if away > 0 else ""
    return f"{sign}{quantity(effect.parameters[0], float(f'{away:.2g}'))} ({abs(away) / effect.tolerance[0]:.0f} σ)"
