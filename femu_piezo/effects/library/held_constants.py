"""A constant that the update holds fixed is not what the file says: θ → θ (1 + p)(1 − j t), one for each held constant.

The deviations of such a constant (`std_s12`, `std_tan_s12`) are the tolerances of p and t. A candidate widens p alone.
"""

from __future__ import annotations

from femu_piezo.effects.constant_factor import ConstantFactor
from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter
from femu_piezo.material.constants import D_FORM


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """One effect for each constant that is neither free nor zero."""
    held = [name for name in D_FORM if name not in context.free and getattr(context.constants, name) != 0]
    return tuple(
        Effect(
            name="wrong_insensitive_parameter",
            variant=name,
            sentence=f"the constant {name} is held at a value that is not that of this material",
            parameters=(
                _value(name, context.tolerances.get(name, 0.0)),
                _tangent(name, context.tolerances.get(f"tan_{name}", 0.0)),
            ),
            confusable_with=tuple(other for other in held if other != name),
            advice=(f"set {name} free, and measure a specimen that determines it (see `femu-piezo identify`)",),
            constants=ConstantFactor(D_FORM.index(name)),
        )
        for name in held
    )


def _value(name: str, tolerance: float) -> EffectParameter:
    return EffectParameter(name, "1", -0.7, 2.0, 0.05, max(0.12, 3 * tolerance), tolerance=tolerance)


def _tangent(name: str, tolerance: float) -> EffectParameter:
    return EffectParameter(f"tan_{name}", "1", -0.2, 0.5, 0.005, tolerance, optional=True, tolerance=tolerance)
