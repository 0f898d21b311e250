"""The electrodes of a thickness-poled body end before it does: bare strips at the ends of a plate, or along rims."""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter, LocalTerm
from femu_piezo.effects.local.bare_strips import WIDEST
from femu_piezo.effects.local.operators import Places, stiffness_terms
from femu_piezo.effects.local.round_fields import ORDERS, RIMS


def _terms(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
    value, *slopes = places.bare_ends.at(*p)
    return stiffness_terms(range(len(value)), value, slopes, omega)


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For thickness-poled plates with three mirror planes, whose strips are m (1 ± a) wide; disks and rings, whose
    electrodes are off the centre by a times m.

    The sweep cannot tell which end or side has the wider strip.
    """
    if not context.is_regular or context.poling != "thickness":
        return ()
    if context.radii is None:
        size, where, sectors = context.dimensions[0], "both faces are bare at both ends", ("x",)
        misses = (0.03, 0.0)
    else:
        size, where = context.radii[1] - context.radii[0], "both faces are bare along their rims"
        sectors, misses = (ORDERS[1], RIMS), (0.05, 0.2)
    return (
        Effect(
            name="electrode_margin",
            sentence=f"the electrodes do not reach the edges of the body: {where}",
            parameters=(
                EffectParameter(
                    "margin",
                    "m",
                    0.0,
                    WIDEST * size,
                    0.01 * size,
                    0.03 * size,
                    starts=(0.005 * size, 0.02 * size, 0.06 * size),
                    law_error=misses[0],
                ),
                EffectParameter("asymmetry", "1", 0.0, 1.0, 0.3, 0.3, (0.4,), optional=True, law_error=misses[1]),
            ),
            confusable_with=("eps33T", "wrong_length", "poling_gradient"),
            advice=("measure the width of the bare strips under a microscope",),
            local=_terms,
            sectors=sectors,
        ),
    )
