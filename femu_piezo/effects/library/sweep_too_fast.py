"""The sweep was faster than resonances settle: the current still rings from the frequencies before.

Under one volt of phase φ, dφ/dt = ω, dω/dt = r, a body of admittance Y = ∫ h(τ) e^(−jωτ) dτ has the current

    e^(−jφ) ∫ h(τ) e^(jφ(t−τ)) dτ = ∫ h(τ) e^(−jωτ + jrτ²/2) dτ = Y − (jr/2) d²Y/dω² + O(r²),

since d²Y/dω² = −∫ τ² h e^(−jωτ) dτ. The next term, −(r²/8) d⁴Y/dω⁴, is 3 r/γ² of the first in the middle of a resonance
of half width γ (rad/s): the law holds for r well below γ². It is for a linear sweep of one rate at a constant voltage;
for a sweep in steps that are short against γ it holds with their mean rate.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import AcquisitionHook, Effect, EffectContext, EffectParameter, Reached

#: Loss tangent where the file has none.
_USUAL_LOSS = 0.01
#: Relative step of the frequency for d²Y/dω².
_STEP = 1e-5


def _hook(sign: float) -> AcquisitionHook:
    """sign : −1 for a sweep that went down"""

    def acquisition(inside: Reached, omega: np.ndarray, p: np.ndarray):
        h = _STEP * omega
        z, slopes = inside(np.concatenate([omega - h, omega, omega + h]))
        values, tangents = np.split(1 / z, 3), np.split(-slopes / z[:, None] ** 2, 3)
        share = -1j * np.pi * sign / h**2  # rate p in Hz/s: −j 2πp/2
        bend = share * (values[0] - 2 * values[1] + values[2])
        moved = share[:, None] * (tangents[0] - 2 * tangents[1] + tangents[2])
        y = values[1] + p[0] * bend
        return 1 / y, -(tangents[1] + p[0] * moved) / y[:, None] ** 2, (-bend / y**2)[:, None]

    return acquisition


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For every body; usual rates are shares of the rate γ² (in Hz/s) at which the fundamental cannot follow."""
    driven = context.constants.s11 if context.poling == "thickness" else context.constants.s33
    loss = -driven.imag / driven.real or _USUAL_LOSS
    limit = (np.pi * context.fundamental_Hz * loss) ** 2 / (2 * np.pi)
    return (
        Effect(
            name="sweep_too_fast",
            sentence="the sweep was too fast: resonances were still ringing from preceding frequencies",
            parameters=(
                EffectParameter("rate", "Hz/s", -0.2 * limit, 0.2 * limit, 5e-3 * limit, 0.03 * limit, law_error=0.05),
            ),
            confusable_with=("temperature_drift", "tan_s11", "frequency_dependent_elastic_loss"),
            advice=(
                "sweep again at a tenth of the rate: only what belongs to the body remains",
                "sweep again in the opposite direction: the error changes its sign with the rate",
            ),
            acquisition=_hook(1.0 if context.conditions.rising else -1.0),
            outward=6.0,
            of_conditions=True,
        ),
    )
