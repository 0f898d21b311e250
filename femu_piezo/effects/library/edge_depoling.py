"""The poling is lost at the edges, where a saw or a grinding wheel heated and strained them.

The piezoelectric constants are zero at an edge and recover over the reach ρ: e → e Π [1 − exp(−d/ρ)], d the distances
to the nearest sides of a plate across its length and its width, or to the rims of a disk or ring. Stiffness and
permittivity stay.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter, LocalTerm
from femu_piezo.effects.local.operators import PIEZOELECTRIC, Places, stiffness_terms
from femu_piezo.effects.local.weighted_forms import DEEPEST


def _terms(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
    lost, slope = places.edges.at(p[0])
    return stiffness_terms(PIEZOELECTRIC, -lost, [-slope], omega)


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For thickness-poled plates with three mirror planes, whose four sides have one reach; disks and rings."""
    if not context.is_regular or context.poling != "thickness":
        return ()
    size = min(context.dimensions[:2]) if context.radii is None else context.radii[1] - context.radii[0]
    starts = (0.003 * size, 0.01 * size, 0.03 * size)
    return (
        Effect(
            name="edge_depoling",
            sentence="the material is depoled along the edges: less of it is driven than the electrodes cover",
            parameters=(
                EffectParameter("reach", "m", 0.0, DEEPEST * size, 0.005 * size, 0.02 * size, starts, law_error=0.03),
            ),
            confusable_with=("d31", "electrode_margin", "poling_gradient"),
            advice=(
                "measure d33 at the middle and near the edges with a d33 meter",
                "pole the specimen again, and measure once more",
            ),
            local=_terms,
        ),
    )
