"""What a fit says against the numbers that a specimen file states: dimensions, density and held constants."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from femu_piezo.effects.words import quantity
from femu_piezo.inference.budget import source_of
from femu_piezo.inference.fit import Fit
from femu_piezo.inference.readings import CONTRADICTS
from femu_piezo.material.constants import D_FORM, PiezoConstants
from femu_piezo.material.library import library_material, library_names
from femu_piezo.study.subjects import Subject
from femu_piezo.study.unknowns import constants_found


def contradicted(found: Fit) -> list[str]:
    """A note where the fit moved dimensions or density by more than `CONTRADICTS` of their standard deviations."""
    moved = [words for source, _, words in _moved(found) if source != "held"]
    if not moved:
        return []
    return [
        f"the sweep contradicts the file, by its standard deviations: {', '.join(moved)}; check these numbers, or let "
        "`femu-piezo diagnose` look for what the model lacks"
    ]


def of_another_material(found: Fit, several: Sequence[Subject]) -> list[str]:
    """The same of held constants; where these are several, with the library material nearest to what was found."""
    moved = {name: words for source, name, words in _moved(found) if source == "held"}
    if not moved:
        return []
    near, base = "", several[0].problem.specimen.material.base
    if len(moved) > 1:
        names = [*found.parameters.material.free.names, *(name.removeprefix("tan_") for name in moved)]
        near = nearest_material(constants_found(several, found.parameters, found.x), names)
    return [
        "the held constants may be those of another material: the sweep contradicts, by the standard deviations of the "
        f"file, {', '.join(moved.values())}; "
        + (f"of the library, {near} is nearest to what was found: " if near not in ("", base) else "")
        + "see material.base and its values"
    ]


def nearest_material(constants: PiezoConstants, names: Sequence[str]) -> str:
    """The library material with the least rms difference of ln |constant|, real parts, over the named constants."""
    at = [D_FORM.index(name) for name in names]

    def distance(name: str) -> float:
        of_library = library_material(name).constants.vector().real[at]
        if not np.all(of_library):  # of the simplified ones
            return np.inf
        return float(np.linalg.norm(np.log(np.abs(constants.vector().real[at] / of_library))))

    return min(library_names(), key=distance)


def _moved(found: Fit) -> Iterator[tuple[str, str, str]]:
    """Source of the budget, name and words of every stated number that the fit moved far."""
    for effect, values in zip(found.parameters.effects, found.parameters.values(found.x), strict=True):
        source = source_of(effect)
        if source not in ("held", "geometry", "density"):
            continue
        for parameter, away, std in zip(effect.parameters, values - effect.rest, effect.tolerance, strict=True):
            if abs(away) > CONTRADICTS * std > 0:
                name = parameter.name if source == "held" else effect.name.removeprefix("wrong_")
                sign = "+" if away > 0 else ""
                yield source, name, f"{name} {sign}{quantity(parameter, float(f'{away:.2g}'))} ({abs(away) / std:.0f})"
