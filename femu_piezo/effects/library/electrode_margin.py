"""The electrodes of a thickness-poled body end before it does: bare strips at both ends of a plate, or along rims."""

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
    """For thickness-poled plates with three mirror planes, disks and rings."""
    if context.mass is None or context.poling != "thickness":
        return ()
    if context.radii is None:
        size, where = context.dimensions[0], "both faces are bare at both ends"
    else:
        size, where = context.radii[1] - context.radii[0], "both faces are bare along their rims"
    return (
        Effect(
            name="electrode_margin",
            sentence=f"the electrodes end before the body does: {where}",
            parameters=(
                EffectParameter(
                    "margin",
                    "m",
                    0.0,
                    WIDEST * size,
                    0.01 * size,
                    0.03 * size,
                    starts=(0.005 * size, 0.02 * size, 0.06 * size),
                    law_error=0.03,
                ),
            ),
            confusable_with=("eps33T", "wrong_length", "poling_gradient"),
            advice=("measure the width of the bare strips under a microscope",),
            local=_terms,
        ),
    )
