"""A spot of mass on one face, away from the centre: solder, a drop of glue, a chip of electrode paste.

The body covers a patch of radius a. Its mean displacement is v, that of the face under it ⟨N u⟩; between them lies the
local compliance C of the face, which the modes of the plate do not have. What of the motion varies over the patch, its
tilt first of all, the face imposes:

    + ½ (v − ⟨N u⟩)ᵗ C^-1 (v − ⟨N u⟩),   − ½ ω² m [vᵗv + ⟨|N u|²⟩ − |⟨N u⟩|²]

C is that of a plate of infinite extent under even pressure, less what its modes below the highest of the body's own
add to it (`femu_piezo.effects.local.face_compliance`).
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter, LocalTerm
from femu_piezo.effects.local.face_compliance import FaceCompliance
from femu_piezo.effects.local.operators import Places
from femu_piezo.effects.local.patch import Patch
from femu_piezo.effects.local.placement import Placement, in_plane, patch_radius
from femu_piezo.effects.local.sectors import SPOT

#: Smallest mass, as a share of the plate's: at none at all the body has no equation of motion.
_NONE = 1e-7


def _hook(context: EffectContext, radii: tuple[float, float]):
    """Radii of the smallest and the largest patch; the mass of the specimen is the unit of the body's inertia."""
    own = context.mass

    def terms(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
        mass, *place, radius = p
        patch = Patch(places.face, *in_plane(place), radius)
        size, copies, u = places.size, places.face.copies, patch.mean.shape[1]
        names = ("mass", *("x", "y")[: len(place)], "radius")

        def term(kind, matrix: np.ndarray, value: float, **slopes: float) -> LocalTerm:
            one = np.ones(omega.size, dtype=complex)
            row = np.array([slopes.get(name, 0.0) for name in names])
            return LocalTerm(kind, matrix / copies, value * one, one[:, None] * row)

        # relative displacement of face and body: rows (3, r)
        gap, moved = np.zeros((3, size)), np.zeros((3, 3, size))
        gap[:, :u] = -patch.mean
        gap[np.arange(3), places.spot] = 1 / np.sqrt(own)
        moved[:, :, :u] = -patch.mean_slopes
        compliance = FaceCompliance.of(context, places.cut, radii)
        springs, softer = (part[:, None] for part in compliance.stiffness(radius))
        found = [
            term("stiffness", gap.T @ (springs * gap), 1.0),
            term("stiffness", gap.T @ (softer * gap), 0.0, radius=1.0),
        ]
        body = patch.spread.copy()
        body[places.spot, places.spot] += 1 / own
        found.append(term("inertia", body, mass, mass=1.0))
        for name, way, spread in zip(("x", "y", "radius"), moved, patch.spread_slopes, strict=True):
            change = way.T @ (springs * gap)
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


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For every body with an upper face."""
    if context.mass is None:
        return ()
    own, place = context.mass, Placement.on(context)
    radius = patch_radius("radius", place.size)
    return (
        Effect(
            name="point_mass",
            sentence="a small mass sticks to one face, away from its centre",
            parameters=(
                EffectParameter(
                    "mass", "kg", _NONE * own, 0.3 * own, 0.001 * own, 0.02 * own, rest=_NONE * own, law_error=0.04
                ),
                *place.parameters,
                radius,
            ),
            confusable_with=("electrode_mass", "local_crack", "wrong_length"),
            advice=("look at both faces and clean them", "weigh the specimen before and after cleaning"),
            local=_hook(context, (radius.low, radius.high)),
            onset=_onset,
            # it moves radial modes as s11 and s12 do; bending shows it
            start_sizes=() if context.radii is None else (0.25, 1.0),
            sectors=(SPOT, *place.sectors),
            sites=place.sites_with(0.002 * own, radius.rest),
        ),
    )
