"""A thin slice across the plate with reduced stiffness, as a crack leaves it.

A slice of width w whose c^E is (1 − k) times that of the rest yields like w k/(1 − k) more length of sound material:
that is its size. It is shared by the two slices of elements next to its position so that their yielding adds up and
has the right centre; a slice of h that takes l of it has c^E (1 − l/(h + l)). e and ε^S stay.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.diagnosis.effect import Effect, EffectContext, EffectParameter, LocalTerm
from femu_piezo.diagnosis.places import ELASTIC, Places

#: Where to look first, as shares of half the length.
_SITES = np.linspace(0.02, 0.95, 24)


def _shares(places: Places, position: float) -> list[tuple[int, float, float]]:
    """(slice, share, ∂share/∂position) of the one or two slices at a position."""
    centres = places.slices.centres
    i = int(np.clip(np.searchsorted(centres, position), 1, len(centres) - 1))
    low, high = centres[i - 1], centres[i]
    t = (position - low) / (high - low)
    if not 0 < t < 1:
        return [(i - 1 if t <= 0 else i, 1.0, 0.0)]
    return [(i - 1, 1 - t, -1 / (high - low)), (i, t, 1 / (high - low))]


def _terms(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
    width, one, found = places.slices.width, np.ones((omega.size, 1), dtype=complex), []
    for number, share, slope in _shares(places, p[1]):
        yielding = share * p[0]
        loss, rate = yielding / (width + yielding), width / (width + yielding) ** 2
        slopes = -one * np.array([rate * share, rate * slope * p[0]])
        found += [
            LocalTerm("stiffness", places.slices.matrices[number, constant], -loss * one[:, 0], slopes, constant)
            for constant in ELASTIC
        ]
    return found


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For plates with three mirror planes; by symmetry the crack is taken at x > 0."""
    if context.dimensions is None:
        return ()
    length = context.dimensions[0]
    sites = _SITES * length / 2
    return (
        Effect(
            name="local_crack",
            sentence="a slice across the plate yields more than the rest: a crack or a soft joint",
            parameters=(
                EffectParameter("added_length", "m", 0.0, 0.2 * length, 0.002 * length, 0.03 * length),
                EffectParameter("position", "m", 0.0, length / 2, length / 40, 5 * length, rest=length / 4),
            ),
            confusable_with=("point_mass", "s11", "wrong_length"),
            advice=(
                "look at the plate under a microscope or with dye",
                "ring the plate at higher drive: cracks rattle",
            ),
            local=_terms,
            sectors=("ramp", "slices", "x", "x ramp", "x slices"),
            sites=np.column_stack([np.full(sites.size, 0.002 * length), sites]),
        ),
    )
