"""A thin slice across the plate with reduced stiffness, as a crack leaves it.

A slice of width w whose c^E is (1 − k) times that of the rest yields along the plate like a = w k/(1 − k) more length
of sound material: that is its size. Against lateral strain, which is that of its neighbours, w k = a w/(w + a) of the
plate is missing. The two differ where a is not small against w. e and ε^S stay.

The slices of elements around its position share it like the points of a cubic interpolation, so what varies along the
plate as a cubic feels it at its place. A slice of elements, h long, that takes the share q of it is a laminate with
layers normal to x (Backus 1962, J. Geophys. Res. 67, 4427, here of layers that differ by a factor): with
S = h/(h + q a) and P = 1 − q w k/h,

    c^E → S c^E + (P − S) c^L,    c^L the part of c^E at T_xx = T_xy = T_xz = 0.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BarycentricInterpolator

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter, LocalTerm
from femu_piezo.effects.local.operators import ELASTIC, Places

#: Where to look first, as shares of half the length.
_SITES = np.linspace(0.02, 0.95, 24)
#: Number of c11 in the e-form.
_C11 = ELASTIC[0]
#: Slices that share a crack.
_SHARED = 4


def _shares(places: Places, position: float) -> list[tuple[int, float, float]]:
    """(slice, share, ∂share/∂position) of the four slices around a position, by cubic interpolation."""
    centres = places.slices.centres
    count = min(_SHARED, centres.size)
    first = int(np.clip(np.searchsorted(centres, position) - count // 2, 0, centres.size - count))
    lagrange = BarycentricInterpolator(centres[first : first + count], np.eye(count), rng=0)
    shares, slopes = lagrange(position), lagrange.derivative(position)
    return list(zip(range(first, first + count), shares.tolist(), slopes.tolist(), strict=True))


def _terms(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
    (added, position, width), h, found = p, places.slices.width, []
    lateral = added * width / (width + added)
    lateral_slopes = np.array([width**2, added**2]) / (width + added) ** 2  # by the added length, by the width

    def term(matrix: np.ndarray, value: float, slopes: list[float], constant: int) -> LocalTerm:
        one = np.ones(omega.size, dtype=complex)
        return LocalTerm("stiffness", matrix, value * one, one[:, None] * np.array(slopes), constant)

    for number, share, slope in _shares(places, position):
        yielding = share * added
        loss, rate = yielding / (h + yielding), h / (h + yielding) ** 2
        slopes = [-rate * share, -rate * slope * added, 0.0]
        for constant, matrix in zip(ELASTIC, places.slices.matrices[number], strict=True):
            found.append(term(matrix, -loss, slopes, constant))
        slopes = [
            share * (rate - lateral_slopes[0] / h),
            slope * (rate * added - lateral / h),
            -share * lateral_slopes[1] / h,
        ]
        found.append(term(places.slices.lateral[number], loss - share * lateral / h, slopes, _C11))
    return found


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For plates with three mirror planes; by symmetry the crack is taken at x > 0."""
    if context.dimensions is None:
        return ()
    length = context.dimensions[0]
    sites, width = _SITES * length / 2, length / 40
    return (
        Effect(
            name="local_crack",
            sentence="a slice across the plate yields more than the rest: a crack or a soft joint",
            parameters=(
                EffectParameter("added_length", "m", 0.0, 0.2 * length, 0.002 * length, 0.03 * length, law_error=0.02),
                EffectParameter(
                    "position", "m", 0.0, length / 2, length / 40, 5 * length, rest=length / 4, law_error=0.02
                ),
                EffectParameter(
                    "width", "m", width / 30, 10 * width, width, width, rest=width, optional=True, law_error=0.25
                ),
            ),
            confusable_with=("point_mass", "s11", "wrong_length"),
            advice=(
                "look at the plate under a microscope or with dye",
                "ring the plate at higher drive: cracks rattle",
            ),
            local=_terms,
            sectors=("ramp", "slices", "x", "x ramp", "x taper", "x slices"),
            sites=np.column_stack([np.full(sites.size, 0.002 * length), sites, np.full(sites.size, width)]),
        ),
    )
