"""The sides are not parallel: the width is W (1 + t ξ), ξ = 2x/L.

The taper t couples the driven modes to those that are odd about the middle, and shifts all of them with t².
"""

from __future__ import annotations

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For plates with three mirror planes; the sign of t cannot be told, so it is taken as positive."""
    if context.dimensions is None:
        return ()
    return (
        Effect(
            name="tapered_width",
            sentence="the sides are not parallel: one end of the specimen is wider than the other",
            parameters=(EffectParameter("taper", "1", 0.0, 0.1, 0.005, 0.02, starts=(0.003, 0.01, 0.03)),),
            confusable_with=("poling_gradient", "point_mass", "wrong_width"),
            advice=("measure the width at both ends with a micrometer",),
            local=lambda places, omega, p: places.taper.terms(places, omega, p),
            sectors=("x", "x ramp", "x taper"),
        ),
    )
