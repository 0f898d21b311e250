"""One electrode is heavier than the other: films of ± d/2 beside the mean one, −ω² (d/2) (∫_upper − ∫_lower) v·u dS.

It couples the driven modes to those that are odd about the plane between the electrodes, bending among them.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.diagnosis.effect import Effect, EffectContext, EffectParameter, LocalTerm
from femu_piezo.diagnosis.places import Places


def _terms(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
    one = np.ones(omega.shape, dtype=complex)
    return [LocalTerm("inertia", places.films, p[0] / 2 * one, one[:, None] / 2)]


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For plates with three mirror planes and electrodes on their faces; which one is the heavier cannot be told."""
    if context.dimensions is None or context.poling != "thickness":
        return ()
    own = context.density * context.thickness / 2
    return (
        Effect(
            name="unequal_electrode_mass",
            sentence="one electrode is heavier than the other: the plate bends as it vibrates",
            parameters=(
                EffectParameter(
                    "difference",
                    "kg/m^2",
                    0.0,
                    0.2 * own,
                    0.01 * own,
                    0.03 * own,
                    starts=(0.003 * own, 0.01 * own, 0.04 * own),
                    law_error=0.03,
                ),
            ),
            confusable_with=("electrode_mass", "point_mass"),
            advice=("measure the thickness of both electrodes", "compare with the simulation of a bare plate"),
            local=_terms,
            sectors=("z", "z film"),
        ),
    )
