"""Places on the faces of a body where an effect may be: their parameters, starting places, and the sectors needed.

By symmetry a place is taken on the part that mirror lines cut, on a disk or ring at a distance from the axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from femu_piezo.effects.effect import EffectContext, EffectParameter
from femu_piezo.effects.local.mesh_fields import UNDRIVEN, at_a_place
from femu_piezo.effects.local.patch import LARGEST, PATCH, SMALLEST
from femu_piezo.effects.local.round_fields import AT_A_PLACE

#: Starting places, as shares of half the length, of half the width, and of the way from the inner to the outer radius.
_ALONG, _ACROSS, _OUTWARD = np.linspace(0.06, 0.98, 9), np.linspace(0.08, 0.95, 5), np.linspace(0.02, 0.98, 25)


@dataclass(frozen=True)
class Placement:
    """A place on the faces of a body.

    Attributes
    ----------
    parameters : x and y, or the distance r from the axis
    sites : (m, 2 or 1) places to start a fit from, m
    sectors : groups of unknowns that an effect at a place may couple
    size : the longest dimension of the faces, m
    """

    parameters: tuple[EffectParameter, ...]
    sites: np.ndarray = field(repr=False)
    sectors: tuple[str, ...]
    size: float

    @classmethod
    def on(cls, context: EffectContext) -> Placement:
        """The place on a disk, a ring, another body with an upper face, or a plate with three mirror planes."""
        if context.radii is not None:
            (inner, outer), sectors = context.radii, AT_A_PLACE
            ranges, size = {"r": (inner, outer)}, 2 * outer
            sites = (inner + (outer - inner) * _OUTWARD)[:, None]
        elif context.upper is not None:
            face, sectors = context.upper, (UNDRIVEN, *at_a_place(context.upper.mirrors))
            ranges, size, sites = dict(zip(("x", "y"), face.extents, strict=True)), face.size, face.places
        else:
            half, size, sectors = np.array(context.dimensions[:2]) / 2, context.dimensions[0], at_a_place(range(3))
            ranges = {name: (0.0, length) for name, length in zip(("x", "y"), half.tolist(), strict=True)}
            sites = np.stack(np.meshgrid(_ALONG * half[0], _ACROSS * half[1], indexing="ij"), axis=-1).reshape(-1, 2)
        parameters = (
            EffectParameter(name, "m", low, high, (high - low) / 20, 10 * (high - low), rest=(low + high) / 2)
            for name, (low, high) in ranges.items()
        )
        return cls(tuple(parameters), sites, sectors, size)

    def sites_with(self, *others: float) -> np.ndarray:
        """(m, …) `Effect.sites`: the first of other values, the size, then a place, then the rest of the values."""
        before, after = (np.tile(part, (len(self.sites), 1)) for part in (others[:1], others[1:]))
        return np.column_stack([before, self.sites, after])


def patch_radius(name: str, size: float) -> EffectParameter:
    """The radius of a patch that sticks to or supports a body; size : the longest dimension of its faces, m."""
    usual = PATCH * size
    return EffectParameter(name, "m", SMALLEST * usual, LARGEST * usual, usual / 2, usual, rest=usual, optional=True)


def in_plane(place: Sequence[float]) -> tuple[float, float]:
    """x, y of a place (x, y), or of a distance (r,) from the axis, taken along x."""
    return (place[0], place[1]) if len(place) == 2 else (place[0], 0.0)
