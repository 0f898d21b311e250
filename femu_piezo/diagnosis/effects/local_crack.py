"""A thin slice across the plate with reduced stiffness, as a crack leaves it.

A slice of width w whose c^E is (1 − k) times that of the rest yields like w k/(1 − k) more length of sound material:
that is its size. The slices of elements around its position share it like the points of a cubic interpolation, so what
varies along the plate as a cubic feels it at its place; a slice of h that takes l has c^E (1 − l/(h + l)). e and ε^S
stay. How w and k share the added length changes the yielding across the slice, hence the size by a few per cent.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BarycentricInterpolator

from femu_piezo.diagnosis.effect import Effect, EffectContext, EffectParameter, LocalTerm
from femu_piezo.diagnosis.places import ELASTIC, Places

#: Where to look first, as shares of half the length.
_SITES = np.linspace(0.02, 0.95, 24)
#: Slices that share a crack.
_SHARED = 4


def _shares(places: Places, position: float) -> list[tuple[int, float, float]]:
    """(slice, share, ∂share/∂position) of the four slices around a position, by cubic interpolation."""
    centres = places.slices.centres
    count = min(_SHARED, centres.size)
    first = int(np.clip(np.searchsorted(centres, position) - count // 2, 0, centres.size - count))
    lagrange = BarycentricInterpolator(centres[first : first + count], np.eye(count))
    shares, slopes = lagrange(position), lagrange.derivative(position)
    return list(zip(range(first, first + count), shares.tolist(), slopes.tolist(), strict=True))


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
                EffectParameter("added_length", "m", 0.0, 0.2 * length, 0.002 * length, 0.03 * length, law_error=0.03),
                EffectParameter(
                    "position", "m", 0.0, length / 2, length / 40, 5 * length, rest=length / 4, law_error=0.04
                ),
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
