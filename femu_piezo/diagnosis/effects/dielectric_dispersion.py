"""ε33T falls by a constant share per decade: ε33T(ω) = ε33T [1 − p log10(ω/ω0)].

The Kramers-Kronig partner of this fall is a constant loss tangent p π/(2 ln 10) to first order in p (Jonscher's
constant loss). It is not added here, since the tangent of ε33T holds it: the model is causal where that tangent is
not smaller.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.diagnosis.effect import Effect, EffectContext, EffectParameter
from femu_piezo.material.constants import D_FORM

_EPS33T = D_FORM.index("eps33T")


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """Anchored at the fundamental, where ε33T keeps its value."""
    anchor = 2 * np.pi * context.fundamental_Hz

    def constants(theta, tangents, omega, p):
        decades = np.log10(omega / anchor)
        factor = 1 - p[0] * decades
        own = np.zeros((*theta.shape, 1), dtype=complex)
        own[:, _EPS33T, 0] = -decades * theta[:, _EPS33T]
        theta, tangents = theta.copy(), tangents.copy()
        theta[:, _EPS33T] *= factor
        tangents[:, _EPS33T] *= factor[:, None]
        return theta, tangents, own

    return (
        Effect(
            name="dielectric_dispersion",
            sentence="ε33T falls with frequency, by a constant share per decade",
            parameters=(EffectParameter("fall_per_decade", "1", -0.1, 0.4, 0.01, 0.1),),
            confusable_with=("eps33T", "series_inductance", "leakage"),
            advice=("measure over two more decades towards low frequency, where no resonance disturbs",),
            constants=constants,
            dispersive=True,
        ),
    )
