"""A spot of mass on one face, away from the centre: solder, a drop of glue, a chip of electrode paste.

The mass covers a patch of radius a. Its mean displacement is v, that of the face under it ⟨N u⟩; between the two lies
the local compliance C of the face, which the modes of the body lack. The part of the motion that varies over the patch,
above all its tilt, is that of the face:

    + ½ (v − ⟨N u⟩)ᵗ C^-1 (v − ⟨N u⟩),   − ½ ω² m [vᵗv + ⟨|N u|²⟩ − |⟨N u⟩|²]

C is that of a plate of infinite extent under uniform pressure, without its modes below the frequency up to which the
body has modes (`femu_piezo.effects.local.face_compliance`).
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter, LocalTerm
from femu_piezo.effects.local.face_compliance import FaceCompliance
from femu_piezo.effects.local.operators import Places
from femu_piezo.effects.local.patch import Patch
from femu_piezo.effects.local.placement import Placement, in_plane, patch_radius
from femu_piezo.effects.local.sectors import SPOT

#: Smallest mass, as a share of the body's: the unknowns of a mass of zero have no equation of motion.
_NONE = 1e-7


def _hook(context: EffectContext, radii: tuple[float, float]):
    """Terms of a mass whose unknowns are √M v, M the mass of the specimen.

    radii : of the smallest and the largest patch, m
    """
    whole = context.mass

    def terms(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
        mass, *place, radius = p
        patch = Patch(places.face, *in_plane(place), radius)
        size, copies, u = places.size, places.face.copies, patch.mean.shape[1]
        names = ("mass", *("x", "y")[: len(place)], "radius")

        def term(kind, matrix: np.ndarray, value: float, **slopes: float) -> LocalTerm:
            row = [slopes.get(name, 0.0) for name in names]
            return LocalTerm.constant_over(omega, kind, matrix / copies, value, row)

        # displacement v − ⟨N u⟩ of the mass against the face: rows (3, r)
        gap, moved = np.zeros((3, size)), np.zeros((3, 3, size))
        gap[:, :u] = -patch.mean
        gap[np.arange(3), places.spot] = 1 / np.sqrt(whole)
        moved[:, :, :u] = -patch.mean_slopes
        compliance = FaceCompliance.of(context, places.cutoff_omega, radii)
        springs, softer = (part[:, None] for part in compliance.stiffness(radius))
        found = [
            term("stiffness", gap.T @ (springs * gap), 1.0),
            term("stiffness", gap.T @ (softer * gap), 0.0, radius=1.0),
        ]
        inertia = patch.spread.copy()
        inertia[places.spot, places.spot] += 1 / whole
        found.append(term("inertia", inertia, mass, mass=1.0))
        for name, along, spread in zip(("x", "y", "radius"), moved, patch.spread_slopes, strict=True):
            change = along.T @ (springs * gap)
            found.append(term("stiffness", change + change.T, 0.0, **{name: 1.0}))
            found.append(term("inertia", spread, 0.0, **{name: mass}))
        return found

    return terms


def _onset(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
    """A vanishing mass follows the face: − ½ ω² m (N u)ᵗ N u."""
    n, _ = places.face.at(*in_plane(p[1:-1]))
    slopes = np.zeros((omega.size, p.size), dtype=complex)
    slopes[:, 0] = 1.0
    return [LocalTerm("inertia", n.T @ n / places.face.copies, slopes[:, 0] * p[0], slopes)]


def _weight(p: np.ndarray, area: float) -> tuple[float, np.ndarray]:
    return p[0], np.eye(1, p.size)[0]


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For every body with an upper face."""
    if context.mass is None:
        return ()
    whole, place = context.mass, Placement.on(context)
    radius = patch_radius("radius", place.size)
    return (
        Effect(
            name="point_mass",
            sentence="a small mass sticks to one face, away from its centre",
            parameters=(
                EffectParameter(
                    "mass",
                    "kg",
                    _NONE * whole,
                    0.3 * whole,
                    0.001 * whole,
                    0.02 * whole,
                    rest=_NONE * whole,
                    law_error=0.04,
                ),
                *place.parameters,
                radius,
            ),
            confusable_with=("electrode_mass", "local_crack", "wrong_length"),
            advice=("look at both faces and clean them", "weigh the specimen before and after cleaning"),
            local=_hook(context, (radius.low, radius.high)),
            onset=_onset,
            added_mass=_weight,
            # it shifts radial modes as s11 and s12 do, and shows by the bending modes that it drives
            start_sizes=() if context.radii is None else (0.25, 1.0),
            sectors=(SPOT, *place.sectors),
            sites=place.sites_with(0.002 * whole, radius.rest),
        ),
    )
