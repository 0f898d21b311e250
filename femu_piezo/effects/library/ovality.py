"""The outline of a disk or ring is oval: its diameters are D e^o and D e^−o, nearly D (1 ± o), as are the inner ones.

An oval couples the driven modes to those of Fourier order 2, which a round body cannot show: weak resonances of
strength o² appear, the first ones below the radial fundamental. The driven modes are shifted with the square of o.
"""

from __future__ import annotations

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter
from femu_piezo.effects.local.round_deformations import COUPLED, OVAL
from femu_piezo.effects.local.round_fields import ORDERS

#: Relative error of the frequencies of modes of order 2, over the square of the size; 1 to 2 against an independent
#: solver.
_DETUNED = 1.5


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For disks and rings; the sweep cannot tell the sign, which is taken as positive."""
    if context.radii is None:
        return ()
    starts = (0.003, 0.01, 0.03)  # strength goes with the square
    return (
        Effect(
            name="ovality",
            sentence="the outline is oval: the diameter differs from one direction to another",
            parameters=(
                EffectParameter("ovality", "1", 0.0, 0.05, 0.003, 0.01, starts, law_error=0.03, law_detuning=_DETUNED),
            ),
            confusable_with=("wedge", "point_mass"),
            advice=("measure the diameter in several directions with a micrometer",),
            local=lambda places, omega, p: places.oval.terms(places, omega, p),
            sectors=(ORDERS[COUPLED[OVAL]], OVAL),
        ),
    )
