"""Which effects a sweep cannot show or tell apart, by the model alone: tangents in the noise-weighted Jacobian."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from femu_piezo.diagnosis.starts import Start
from femu_piezo.effects.effect import Effect
from femu_piezo.inference.fit import Fit

#: |cos| from which two tangents count as parallel, the span of the unknowns of the base fit projected out of both.
PARALLEL = 0.99
#: Misfit in σ that an effect must leave after a refit of those unknowns to be seen.
VISIBLE = 5.0


@dataclass(frozen=True)
class Tangent:
    """The change of the whitened sweep by an effect, linearised at the base fit.

    Attributes
    ----------
    outside : (2k, 1) part outside the span of the unknowns, whitened, for one scale of the size (the first parameter)
    visible : |outside|, the misfit in σ that one scale of the effect leaves after a refit
    nearest : the free constant (or loss tangent) that imitates the effect best
    """

    effect: Effect
    outside: np.ndarray
    visible: float
    nearest: str

    @property
    def hidden(self) -> bool:
        """Whether the free constants hide the effect at its usual size (`EffectParameter.usual`)."""
        return self.hides(self.effect.parameters[0].usual / self.effect.parameters[0].scale)

    def hides(self, size: float) -> bool:
        """Whether a change of the free constants explains the effect, of a size over its scale, within the noise."""
        return self.visible * size < VISIBLE


def tangents(base: Fit, alone: Sequence[Start]) -> list[Tangent]:
    """Tangent of each effect at the base fit, in the direction in which its start leads (`Start.direction`)."""
    span, found = base.span, []
    for start in alone:
        tangent = start.direction(base)
        outside = tangent - span @ (span.T @ tangent)
        count = base.parameters.of_material
        scaled = base.jacobian[:, :count] * base.parameters.prior_std[:count]
        moves = np.linalg.lstsq(scaled, tangent, rcond=None)[0]
        strength = np.linalg.norm(scaled, axis=0)[:, None] * np.abs(moves)
        nearest = base.parameters.names[int(np.argmax(strength.sum(axis=1)))]
        found.append(Tangent(start.cause, outside, float(np.linalg.norm(outside)), nearest))
    return found


def parallel(first: Tangent, second: Tangent, size: float) -> bool:
    """Whether a second effect changes the sweep as the first one does at its fitted size.

    The parts of both tangents outside the span are parallel, and the component of the first that is orthogonal to the
    second is below `VISIBLE` σ at that size.

    Parameters
    ----------
    size : size of the first effect over its scale
    """
    if first.hidden or second.hidden:
        return False
    first_unit, second_unit = (t.outside / np.linalg.norm(t.outside) for t in (first, second))
    cosine = min(1.0, float(np.abs(np.sum(first_unit * second_unit))))
    return cosine > PARALLEL and np.sqrt(1 - cosine**2) * first.visible * abs(size) < VISIBLE
