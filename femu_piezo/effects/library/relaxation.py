"""A relaxation of the permittivity after Cole and Cole (J. Chem. Phys. 9 (1941) 341), causal and with its loss.

    ε33T(ω) = ε33T [1 + Δ (c(ω) − Re c(ω0))],    c(ω) = 1/(1 + (jω/ωr)^(1−α)),

Δ the strength as a share of ε33T, ωr/2π the relaxation frequency, α the width: α = 0 is the law of Debye, with one
relaxation time. At the fundamental ω0 the real part keeps its value. With time as e^(+jωt) a loss is Im ε < 0, and
Im c < 0. The tangent of ε33T is that of all other losses, which may not be negative; the relaxation adds −Δ Im c.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter
from femu_piezo.material.constants import D_FORM

_EPS33T = D_FORM.index("eps33T")


def _cole(logs: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray]:
    """c (k,) at logs = ln(ω/ωr), and its slopes (k, 2) in ln ωr and α."""
    phase = logs + 0.5j * np.pi  # ln(jω/ωr)
    power = np.exp((1 - width) * phase)
    fall = power / (1 + power) ** 2
    return 1 / (1 + power), np.stack([(1 - width) * fall, phase * fall], axis=1)


def _hook(anchor: float):
    def constants(theta, tangents, omega, p):
        strength, frequency, width = p
        law, slopes = _cole(np.log(omega / (2 * np.pi * frequency)), width)
        at, at_slopes = _cole(np.log(np.array([anchor / frequency])), width)
        change, moved = law - at.real, (slopes - at_slopes.real) / np.array([frequency, 1.0])
        by_p = np.zeros((*theta.shape, 3), dtype=complex)
        by_p[:, _EPS33T] = theta[:, _EPS33T, None] * np.column_stack([change, strength * moved])
        theta, tangents = theta.copy(), tangents.copy()
        theta[:, _EPS33T] *= 1 + strength * change
        tangents[:, _EPS33T] *= (1 + strength * change)[:, None]
        return theta, tangents, by_p

    return constants


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For every body; a relaxation far outside the band acts as a constant permittivity or a constant loss."""
    fundamental = context.fundamental_Hz
    return (
        Effect(
            name="relaxation",
            sentence=(
                "the permittivity has a relaxation: it falls about one frequency, where its loss has a peak, "
                "in addition to tan eps33T"
            ),
            parameters=(
                EffectParameter("strength", "1", 0.0, 3.0, 0.01, 0.1),
                EffectParameter(
                    "relaxation_frequency",
                    "Hz",
                    1e-3 * fundamental,
                    1e3 * fundamental,
                    0.2 * fundamental,
                    2 * fundamental,
                    starts=(0.1 * fundamental, 0.3 * fundamental, 3 * fundamental),
                    rest=fundamental,
                ),
                EffectParameter("width", "1", 0.0, 0.9, 0.1, 0.2, rest=0.3, optional=True),
            ),
            confusable_with=("dielectric_dispersion", "tan_eps33T", "leakage"),
            advice=(
                "measure over two more decades of low frequencies, far below the resonances",
                "measure once more at another temperature: a relaxation moves in frequency, the effect of an electrode "
                "does not",
            ),
            constants=_hook(fundamental),
            dispersive=True,
        ),
    )
