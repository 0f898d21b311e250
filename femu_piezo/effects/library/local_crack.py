"""A loss of stiffness at a place, as by a crack: in a thin slice across a plate, in a spot of any other body.

A slice of width w whose c^E is (1 − k) times that of the rest yields along the plate like a = w k/(1 − k) more length
of sound material: a is its size. Against lateral strain, which it shares with its neighbours, the plate lacks the
length w k = a w/(w + a). The two differ where a is not small against w. e and ε^S stay.

The soft slice is shared out among the slices of elements around its position with the weights of a cubic interpolation,
so that fields that vary as a cubic along the plate meet it at its place. A slice of elements, h long, with the share q
is a laminate with layers normal to x (Backus 1962, J. Geophys. Res. 67, 4427, here of layers that differ by a factor):
with S = h/(h + q a) and P = 1 − q w k/h,

    c^E → S c^E + (P − S) c^L,    c^L the part of c^E at T_xx = T_xy = T_xz = 0.

A spot goes through the whole thickness and yields in the plane of the faces. Its size is a volume V of sound material:
under a static load that strains the sound body by S there, the spot adds ½ V Sᵗc̄S to the energy, c̄ the part of c^E at
T_xz = T_yz = T_zz = 0. With B the mean strains of the unknowns over the parts of the spot, at heights that stand for
shares w of thickness and area, and G = B K^-1 Bᵗ the flexibility of the sound body to stresses there,

    A → A − V Bᵗ (1/w c̄^-1 + V G)^-1 B.

A round hole through the thickness, of area A and in the middle of a thin sheet, has about 3 A t; a spot whose c^E is
(1 − k) times that of the rest about A t k/(1 − 0.66 k). Strains vary over a spot, so its radius is a parameter.
In a body hardly wider than the spot the volume is found 10 to 20 % too small.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import BarycentricInterpolator

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter, LocalTerm
from femu_piezo.effects.local.operators import ELASTIC, Places
from femu_piezo.effects.local.patch import PATCH
from femu_piezo.effects.local.placement import Placement, in_plane, patch_radius
from femu_piezo.effects.local.spot import PARTS, spot_strains

#: Where to look first, as shares of half the length.
_SITES = np.linspace(0.02, 0.95, 24)
#: Number of c11 in the e-form.
_C11 = ELASTIC[0]
#: Relative error of frequencies over v², v the volume of a spot over that of the body: a spot moves frequencies by v/2,
#: the law misses a tenth of this, and v = 0.01 is taken as usual.
_DETUNING = 5.0
#: Share of its coordinates by which a spot seems nearer the middle than it is: strains fall over its extent, and the
#: part of the disk beyond a rim does not count.
_EXTENT = 0.02
#: Number of slices that share a crack.
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
        return LocalTerm.constant_over(omega, "stiffness", matrix, value, slopes, constant)

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


def _spot(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
    """p : volume, place x, y or r, radius"""
    volume, *place, radius = p
    strains, moved, shares = spot_strains(places.levels, *in_plane(place), radius)
    root, u = places.elastic_flexibility, places.sectors.displacements
    strains, moved = strains.reshape(-1, u), moved.reshape(len(moved), -1, u)
    shares = np.repeat(shares, PARTS) / PARTS
    compliance = np.kron(np.diag(1 / shares), np.linalg.inv(places.in_plane_stiffness))
    static = strains @ root
    flexibility = static @ static.T
    softened = np.linalg.inv(compliance + volume * flexibility)

    def term(matrix: np.ndarray, value: float, number: int, slope: float) -> LocalTerm:
        full = np.zeros((places.size, places.size))
        full[:u, :u] = matrix / (places.copies * places.sectors.all_fields.constants.c11.real)
        return LocalTerm.constant_over(omega, "stiffness", full, value, slope * np.eye(p.size)[number], _C11)

    yielding = softened @ strains
    found = [
        term(strains.T @ yielding, -volume, 0, -1.0),
        term(yielding.T @ flexibility @ yielding, 0.0, 0, volume),
    ]
    for number, along in enumerate([*moved[: len(place)], moved[-1]], start=1):
        change = along.T @ yielding - volume * yielding.T @ (along @ root) @ static.T @ yielding
        found.append(term(change + change.T, 0.0, number, -volume))
    return found


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For every body with an upper face; by symmetry the crack of a plate is taken at x > 0."""
    if context.mass is None:
        return ()
    common = Effect(
        name="local_crack",
        sentence="a spot is more compliant than the rest in the plane of the faces: a crack, or a hole",
        parameters=(),
        confusable_with=("point_mass", "s11", "wrong_length"),
        advice=(
            "look for a crack under a microscope or with a dye penetrant",
            "sweep again at a higher voltage: the response of a crack changes with amplitude",
        ),
    )
    if context.dimensions is None:
        return (_of_a_spot(context, common),)
    return (_of_a_slice(context.dimensions[0], common),)


def _of_a_spot(context: EffectContext, common: Effect) -> Effect:
    volume, place = context.mass / context.density, Placement.on(context)
    return replace(
        common,
        parameters=(
            EffectParameter(
                "volume",
                "m^3",
                0.0,
                0.2 * volume,
                0.001 * volume,
                0.03 * volume,
                law_error=0.15,
                law_detuning=_DETUNING / volume**2,
            ),
            *(replace(parameter, law_error=_EXTENT) for parameter in place.parameters),
            patch_radius("radius", place.size),
        ),
        local=_spot,
        start_sizes=() if context.radii is None else (0.25, 1.0),
        sectors=place.sectors,
        sites=place.sites_with(0.002 * volume, PATCH * place.size),
    )


def _of_a_slice(length: float, common: Effect) -> Effect:
    sites, width = _SITES * length / 2, length / 40
    return replace(
        common,
        sentence="a slice across the plate is more compliant than the rest: a crack or a soft joint",
        parameters=(
            EffectParameter("added_length", "m", 0.0, 0.2 * length, 0.002 * length, 0.03 * length, law_error=0.04),
            EffectParameter("position", "m", 0.0, length / 2, length / 40, 5 * length, rest=length / 4, law_error=0.02),
            EffectParameter(
                "width", "m", width / 30, 10 * width, width, width, rest=width, optional=True, law_error=0.25
            ),
        ),
        local=_terms,
        sectors=("ramp", "slices", "x", "x ramp", "x taper", "x slices"),
        sites=np.column_stack([np.full(sites.size, 0.002 * length), sites, np.full(sites.size, width)]),
    )
