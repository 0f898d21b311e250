"""A spot of mass on one face, away from the centre: solder, a drop of glue, a chip of electrode paste.

The body covers a patch of radius a. Its mean displacement is v, that of the face under it ⟨N u⟩; between them lies the
local compliance C of the face, which the modes of the plate do not have. What of the motion varies over the patch, its
tilt first of all, the face imposes:

    + ½ (v − ⟨N u⟩)ᵗ C^-1 (v − ⟨N u⟩),   − ½ ω² m [vᵗv + ⟨|N u|²⟩ − |⟨N u⟩|²]

C is that of a half-space under even pressure, mean displacement 16 (1 − ν²)/(3π² E a) along the normal (Johnson,
Contact Mechanics, 1985, section 3.3), and (2 − ν)/(2 − 2ν) times as much along the face.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter, LocalTerm
from femu_piezo.effects.local.operators import Face, Places
from femu_piezo.effects.local.symmetry_sectors import SPOT

#: Where to look first, as shares of half the length and half the width.
_ALONG, _ACROSS = np.linspace(0.06, 0.98, 9), np.linspace(0.08, 0.95, 5)
#: Smallest mass, as a share of the plate's: at none at all the body has no equation of motion.
_NONE = 1e-7
_POISSON = 0.3
#: Gauss points over a patch, and their weights.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)


def _springs(context: EffectContext) -> np.ndarray:
    """(3,) local stiffness along x, y, z per radius of the patch, N/m²."""
    c = context.constants
    normal, along = (
        (1 / c.s33.real, 1 / c.s11.real) if context.poling == "thickness" else (1 / c.s11.real, 1 / c.s33.real)
    )
    moduli = np.array([along, 1 / c.s11.real, normal])
    tangential = (2 - _POISSON) / (2 - 2 * _POISSON)
    return 3 * np.pi**2 * moduli / (16 * (1 - _POISSON**2)) / np.array([tangential, tangential, 1.0])


class _Patch:
    """Means over a square of the area of a disk of some radius, by Gauss points; all by x, y, radius too.

    Attributes
    ----------
    mean : (3, u) mean of N, with slopes (3, 3, u)
    spread : (u, u) mean of NᵗN less that of the mean, with slopes (3, u, u)
    """

    def __init__(self, face: Face, x: float, y: float, radius: float) -> None:
        shares = np.stack(np.meshgrid(*2 * [_NODES], indexing="ij"), axis=-1).reshape(-1, 2) * np.sqrt(np.pi) / 2
        weights = np.multiply.outer(_WEIGHTS, _WEIGHTS).ravel() / 4
        values, slopes = zip(*(face.at(x + a * radius, y + b * radius) for a, b in shares), strict=True)
        n, along = np.array(values), np.array(slopes)  # (points, 3, u), (points, 2, 3, u)
        grown = np.einsum("gd,gdcu->gcu", shares, along)
        moved = np.concatenate([along, grown[:, None]], axis=1)  # by x, y, radius
        self.mean = np.tensordot(weights, n, axes=1)
        self.mean_slopes = np.tensordot(weights, moved, axes=1)
        around, away = n - self.mean, moved - self.mean_slopes
        self.spread = np.einsum("g,gcu,gcv->uv", weights, around, around, optimize=True)
        half = np.einsum("g,gdcu,gcv->duv", weights, away, around, optimize=True)
        self.spread_slopes = half + half.transpose(0, 2, 1)


def _hook(springs: np.ndarray, own: float):
    """own: mass of the plate, the unit of inertia of the body's unknowns."""

    def terms(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
        mass, x, y, radius = p
        patch = _Patch(places.face, x, y, radius)
        size, copies, u = places.size, places.face.copies, patch.mean.shape[1]

        def term(kind, matrix: np.ndarray, value: float, **slopes: float) -> LocalTerm:
            one = np.ones(omega.size, dtype=complex)
            row = np.array([slopes.get(name, 0.0) for name in ("mass", "x", "y", "radius")])
            return LocalTerm(kind, matrix / copies, value * one, one[:, None] * row)

        # relative displacement of face and body: rows (3, r)
        gap, moved = np.zeros((3, size)), np.zeros((3, 3, size))
        gap[:, :u] = -patch.mean
        gap[np.arange(3), places.spot] = 1 / np.sqrt(own)
        moved[:, :, :u] = -patch.mean_slopes
        found = [term("stiffness", gap.T @ (springs[:, None] * gap), radius, radius=1.0)]
        body = patch.spread.copy()
        body[places.spot, places.spot] += 1 / own
        found.append(term("inertia", body, mass, mass=1.0))
        for name, way, spread in zip(("x", "y", "radius"), moved, patch.spread_slopes, strict=True):
            change = way.T @ (springs[:, None] * gap)
            found.append(term("stiffness", change + change.T, 0.0, **{name: radius}))
            found.append(term("inertia", spread, 0.0, **{name: mass}))
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
