"""A spot of mass on one face, away from the centre: solder, a drop of glue, a chip of electrode paste.

The body moves by v, the face under it by N u; between them lies the local compliance C of the face under a patch of
radius a, which the modes of the plate do not have:

    + ½ (v − N u)ᵗ C^-1 (v − N u),   − ½ ω² m vᵗv

C is that of a half-space under even pressure, mean displacement 16 (1 − ν²)/(3π² E a) along the normal (Johnson,
Contact Mechanics, 1985, section 3.3), and (2 − ν)/(2 − 2ν) times as much along the face.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.diagnosis.effect import Effect, EffectContext, EffectParameter, LocalTerm
from femu_piezo.diagnosis.places import Places
from femu_piezo.diagnosis.sectors import SPOT

#: Where to look first, as shares of half the length and half the width.
_ALONG, _ACROSS = np.linspace(0.06, 0.98, 9), np.linspace(0.08, 0.95, 5)
#: Smallest mass, as a share of the plate's: at none at all the body has no equation of motion.
_NONE = 1e-7
_POISSON = 0.3


def _springs(context: EffectContext) -> np.ndarray:
    """(3,) local stiffness along x, y, z per radius of the patch, N/m²."""
    c = context.constants
    normal, along = (
        (1 / c.s33.real, 1 / c.s11.real) if context.poling == "thickness" else (1 / c.s11.real, 1 / c.s33.real)
    )
    moduli = np.array([along, 1 / c.s11.real, normal])
    tangential = (2 - _POISSON) / (2 - 2 * _POISSON)
    return 3 * np.pi**2 * moduli / (16 * (1 - _POISSON**2)) / np.array([tangential, tangential, 1.0])


def _hook(springs: np.ndarray, own: float):
    """own: mass of the plate, the unit of inertia of the body's unknowns."""

    def terms(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
        mass, x, y, radius = p
        n, slopes = places.face.at(x, y)
        size, copies = places.ramp.shape[-1], places.face.copies
        one, zero = np.ones(omega.shape, dtype=complex), np.zeros(omega.shape, dtype=complex)
        # relative displacement of face and body: rows (3, r)
        gap, moved = np.zeros((3, size)), np.zeros((2, 3, size))
        gap[:, : n.shape[1]] = -n
        gap[np.arange(3), places.spot] = 1 / np.sqrt(own)
        moved[:, :, : n.shape[1]] = -slopes
        spring = gap.T @ (springs[:, None] * gap) / copies
        found = [LocalTerm("stiffness", spring, radius * one, np.stack([zero, zero, zero, one], axis=1))]
        for place, slope in enumerate(moved):
            change = slope.T @ (springs[:, None] * gap) / copies
            columns = [zero, zero, zero, zero]
            columns[1 + place] = radius * one
            found.append(LocalTerm("stiffness", change + change.T, zero, np.stack(columns, axis=1)))
        body = np.zeros((n.shape[1], n.shape[1]))
        body[places.spot, places.spot] = 1 / (own * copies)
        found.append(LocalTerm("inertia", body, mass * one, np.stack([one, zero, zero, zero], axis=1)))
        return found

    return terms


def _onset(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
    """A vanishing mass follows the face: − ½ ω² m (N u)ᵗ N u."""
    n, _ = places.face.at(p[1], p[2])
    slopes = np.zeros((omega.size, p.size), dtype=complex)
    slopes[:, 0] = 1.0
    return [LocalTerm("inertia", n.T @ n / places.face.copies, slopes[:, 0] * p[0], slopes)]


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For plates with three mirror planes; by symmetry the spot is taken in the quadrant x, y > 0 of the upper face."""
    if context.dimensions is None:
        return ()
    own = context.density * float(np.prod(context.dimensions))
    half = np.array(context.dimensions[:2]) / 2
    grid = np.stack(np.meshgrid(_ALONG * half[0], _ACROSS * half[1], indexing="ij"), axis=-1).reshape(-1, 2)
    patch = context.dimensions[0] / 25
    return (
        Effect(
            name="point_mass",
            sentence="a small mass sticks to one face of the plate, away from its centre",
            parameters=(
                EffectParameter(
                    "mass", "kg", _NONE * own, 0.3 * own, 0.001 * own, 0.02 * own, rest=_NONE * own, law_error=0.04
                ),
                *(
                    EffectParameter(name, "m", 0.0, length, length / 20, 10 * length, rest=length / 2)
                    for name, length in zip(("x", "y"), half.tolist(), strict=True)
                ),
                EffectParameter("radius", "m", patch / 5, 6 * patch, patch / 2, patch, rest=patch, optional=True),
            ),
            confusable_with=("electrode_mass", "local_crack", "wrong_length"),
            advice=("look at both faces and clean them", "weigh the plate before and after cleaning"),
            local=_hook(_springs(context), own),
            onset=_onset,
            sectors=(SPOT, "x", "y", "z", "xy", "xz", "yz", "xyz"),
            sites=np.column_stack([np.full(len(grid), 0.001 * own), grid, np.full(len(grid), patch)]),
        ),
    )
