"""Two sides of the specimen are not parallel.

    tapered_width   a plate is W (1 + t ξ) wide, ξ = 2x/L
    wedge           it is t (1 + w ξ) thick; a disk or ring t (1 + w x/R)

Along a plate both couple the driven modes to those that are odd about the middle; across a round body a wedge couples
them to those of Fourier order 1. No regular body can show these modes: weak resonances of strength t² or w² appear, the
first ones of a disk below its radial fundamental. The driven modes are shifted with the square of the size.
"""

from __future__ import annotations

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter
from femu_piezo.effects.local.round_deformations import COUPLED, WEDGE
from femu_piezo.effects.local.round_fields import ORDERS

#: Relative error of the frequencies of modes of order 1, over the square of the size; 0.05 to 0.1 against an
#: independent solver.
_DETUNED = 0.1


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For plates with three mirror planes, disks and rings; no sweep tells the signs, which are taken as positive."""
    if context.radii is not None:
        starts = (0.02, 0.06, 0.2)  # strength goes with the square
        size = EffectParameter("wedge", "1", 0.0, 0.3, 0.02, 0.06, starts, law_error=0.03, law_detuning=_DETUNED)
        return (_wedge(size, "point_mass", "along the rim", (ORDERS[COUPLED[WEDGE]], WEDGE)),)
    if context.dimensions is None:
        return ()

    def taper(name: str, misses: float = 0.0) -> EffectParameter:
        return EffectParameter(name, "1", 0.0, 0.1, 0.005, 0.02, starts=(0.003, 0.01, 0.03), law_error=misses)

    return (
        Effect(
            name="tapered_width",
            sentence="the sides are not parallel: one end of the specimen is wider than the other",
            parameters=(taper("taper"),),
            confusable_with=("wedge", "poling_gradient", "point_mass", "wrong_width"),
            advice=("measure the width at both ends with a micrometer",),
            local=lambda places, omega, p: places.taper.terms(places, omega, p),
            sectors=("x", "x ramp", "x taper"),
        ),
        _wedge(taper("wedge", 0.03), "tapered_width", "at both ends", ("x", "x ramp", "x wedge")),
    )


def _wedge(size: EffectParameter, like: str, where: str, sectors: tuple[str, ...]) -> Effect:
    return Effect(
        name="wedge",
        sentence="the faces are not parallel: one side of the specimen is thicker than the other",
        parameters=(size,),
        confusable_with=(like, "ovality" if like == "point_mass" else "poling_gradient"),
        advice=(f"measure the thickness {where} with a micrometer",),
        local=lambda places, omega, p: places.wedge.terms(places, omega, p),
        sectors=sectors,
    )
