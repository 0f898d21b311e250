"""The electrodes of a thickness-poled plate end before the plate does: bare strips at both ends of both faces."""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter, LocalTerm
from femu_piezo.effects.local.end_strips import WIDEST
from femu_piezo.effects.local.operators import Places


def _terms(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
    one, found = np.ones(omega.shape, dtype=complex), []
    for constant, (matrix, slope) in enumerate(zip(*places.bare_ends.at(p[0]), strict=True)):
        found.append(LocalTerm("stiffness", matrix, one, 0 * one[:, None], constant))
        found.append(LocalTerm("stiffness", slope, 0 * one, one[:, None], constant))
    return found


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For thickness-poled plates with three mirror planes."""
    if context.dimensions is None or context.poling != "thickness":
        return ()
    length = context.dimensions[0]
    return (
        Effect(
            name="electrode_margin",
            sentence="the electrodes end before the plate does: both faces are bare at both ends",
            parameters=(
                EffectParameter(
                    "margin",
                    "m",
                    0.0,
                    WIDEST * length,
                    0.01 * length,
                    0.03 * length,
                    starts=(0.005 * length, 0.02 * length, 0.06 * length),
                    law_error=0.03,
                ),
            ),
            confusable_with=("eps33T", "wrong_length", "poling_gradient"),
            advice=("measure the width of the bare strips under a microscope",),
            local=_terms,
        ),
    )
