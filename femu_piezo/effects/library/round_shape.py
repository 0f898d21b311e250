"""A disk or ring that is a little out of shape: a wedge, or oval.

    wedge     the thickness is t (1 + w x/R): it varies across the body
    ovality   the diameters are D e^o and D e^−o, nearly D (1 ± o), of a ring the inner ones likewise

A wedge couples the driven modes to those of Fourier order 1, an oval to those of order 2, which a round body cannot
show: weak resonances of strength w² and o² appear, the first ones below the radial fundamental. Both shift the driven
modes with the square of their size.
"""

from __future__ import annotations

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter
from femu_piezo.effects.local.round_deformations import COUPLED, OVAL, WEDGE
from femu_piezo.effects.local.round_fields import ORDERS

#: Name → relative frequency by which modes of orders 1 and 2 are off, over the square of the size; against an
#: independent solver 0.05 to 0.1, and 1 to 2.
_DETUNED = {"wedge": 0.1, "ovality": 1.5}


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For disks and rings; signs cannot be told, so both are taken as positive."""
    if context.radii is None:
        return ()

    def size(name: str, unit: float, largest: float) -> tuple[EffectParameter, ...]:
        starts = (unit, 3 * unit, 10 * unit)  # strength goes with the square
        misses = {"law_error": 0.03, "law_detuning": _DETUNED[name]}
        return (EffectParameter(name, "1", 0.0, largest, unit, 3 * unit, starts=starts, **misses),)

    return (
        Effect(
            name="wedge",
            sentence="the faces are not parallel: one side of the specimen is thicker than the other",
            parameters=size("wedge", 0.02, 0.3),
            confusable_with=("ovality", "point_mass"),
            advice=("measure the thickness along the rim with a micrometer",),
            local=lambda places, omega, p: places.wedge.terms(places, omega, p),
            sectors=(ORDERS[COUPLED[WEDGE]], WEDGE),
        ),
        Effect(
            name="ovality",
            sentence="the outline is oval: the diameter differs from one direction to another",
            parameters=size("ovality", 0.003, 0.05),
            confusable_with=("wedge", "point_mass"),
            advice=("measure the diameter in several directions with a micrometer",),
            local=lambda places, omega, p: places.oval.terms(places, omega, p),
            sectors=(ORDERS[COUPLED[OVAL]], OVAL),
        ),
    )
