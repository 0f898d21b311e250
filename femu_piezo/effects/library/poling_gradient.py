"""The piezoelectric constants vary along the length: e → e [1 + g ξ + h (ξ² − 1/3)], ξ = 2x/L.

The gradient g couples the driven modes to those that are odd about the middle, which a uniform plate cannot show. A
real change of poling is curved as well: h, kept small by its prior, has no effect on the mean.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter, LocalTerm
from femu_piezo.effects.local.operators import PIEZOELECTRIC, Places


def _terms(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
    one = np.ones(omega.shape, dtype=complex)
    return [
        LocalTerm("stiffness", matrix, value * one, unit * one[:, None], constant)
        for value, unit, profile in zip(p, np.eye(2), places.ramp[...], strict=True)
        for constant, matrix in zip(PIEZOELECTRIC, profile, strict=True)
    ]


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For plates with three mirror planes; the sign of g cannot be told, so it is taken as positive."""
    if context.dimensions is None:
        return ()
    return (
        Effect(
            name="poling_gradient",
            sentence="the poling changes along the length: modes without charge in a uniform plate are driven",
            parameters=(
                EffectParameter("gradient", "1", 0.0, 0.95, 0.1, 0.3, starts=(0.05, 0.2, 0.5)),
                EffectParameter("curvature", "1", -0.5, 0.5, 0.02, 0.05, optional=True),
            ),
            confusable_with=("local_crack", "point_mass"),
            advice=(
                "measure d33 at both ends with a d33 meter",
                "split one electrode across the length and compare the halves",
            ),
            local=_terms,
            sectors=("ramp", "x", "x ramp"),
        ),
    )
