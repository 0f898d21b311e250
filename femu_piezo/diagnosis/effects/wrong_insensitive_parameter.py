"""A constant that the update holds fixed has a wrong value: θ → θ (1 + p), one candidate for each held constant."""

from __future__ import annotations

import numpy as np

from femu_piezo.diagnosis.effect import Effect, EffectContext, EffectParameter
from femu_piezo.material.constants import D_FORM


def _hook(index: int):
    def constants(theta, tangents, omega, p):
        own = np.zeros((*theta.shape, 1), dtype=complex)
        own[:, index, 0] = theta[:, index]
        theta, tangents = theta.copy(), tangents.copy()
        theta[:, index] *= 1 + p[0]
        tangents[:, index] *= 1 + p[0]
        return theta, tangents, own

    return constants


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """One for each constant that is neither free nor zero; the loss tangent stays."""
    held = [name for name in D_FORM if name not in context.free and getattr(context.constants, name) != 0]
    return tuple(
        Effect(
            name="wrong_insensitive_parameter",
            variant=name,
            sentence=f"the constant {name}, held fixed, is not that of this material",
            parameters=(EffectParameter(name, "1", -0.45, 0.8, 0.05, 0.12),),
            confusable_with=tuple(other for other in held if other != name),
            advice=(f"free {name} and measure a specimen that determines it (`femu-piezo identify` says which)",),
            constants=_hook(D_FORM.index(name)),
        )
        for name in held
    )
