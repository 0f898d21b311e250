"""Which effects a sweep cannot show or tell apart, by the model alone: tangents in the noise-weighted Jacobian."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from femu_piezo.diagnosis.starts import Start
from femu_piezo.effects.effect import Effect
from femu_piezo.inference.fit import Fit

#: |cos| of two tangents, free of what the constants can do, that counts as parallel.
PARALLEL = 0.99
#: σ that an effect of usual size (its scale) must leave after the constants have been refitted, to be seen at all.
VISIBLE = 5.0
#: Share of a tangent outside the span of the constants below which the two are one.
_SHARE = 0.02


@dataclass(frozen=True)
class Tangent:
    """How an effect moves the sweep at the base fit.

    Attributes
    ----------
    outside : (2k, 1) part that no constant can imitate, whitened, for one scale of its size (the first parameter)
    visible : σ that one scale of the effect leaves after a refit of the constants
    share : |outside| / |tangent|
    nearest : the free constant (or loss tangent) that imitates it best
    """

    effect: Effect
    outside: np.ndarray
    visible: float
    share: float
    nearest: str

    @property
    def hidden(self) -> bool:
        """Whether the sweep cannot tell it from the free constants."""
        return self.share < _SHARE or self.visible < VISIBLE


def tangents(base: Fit, alone: Sequence[Start]) -> list[Tangent]:
    """Tangent of each effect on top of the base fit, in the direction that starts a fit with it."""
    span, found = base.span, []
    for start in alone:
        own = start.direction(base)
        outside = own - span @ (span.T @ own)
        size, left = np.linalg.norm(own), np.linalg.norm(outside)
        count = base.parameters.of_material
        scaled = base.jacobian[:, :count] * base.parameters.prior_std[:count]
        moves = np.linalg.lstsq(scaled, own, rcond=None)[0]
        strength = np.linalg.norm(scaled, axis=0)[:, None] * np.abs(moves)
        nearest = base.parameters.names[int(np.argmax(strength.sum(axis=1)))]
        found.append(Tangent(start.cause, outside, float(left), float(left / size), nearest))
    return found


def parallel(first: Tangent, second: Tangent, size: float) -> bool:
    """Whether a second effect moves the sweep as the first does at its size.

    Parallel once the constants are refitted, and what is not parallel below `VISIBLE` σ.

    Parameters
    ----------
    size : of the first effect over its scale
    """
    if first.hidden or second.hidden:
        return False
    one, other = (t.outside / np.linalg.norm(t.outside) for t in (first, second))
    cosine = min(1.0, float(np.abs(np.sum(one * other))))
    return cosine > PARALLEL and np.sqrt(1 - cosine**2) * first.visible * abs(size) < VISIBLE
