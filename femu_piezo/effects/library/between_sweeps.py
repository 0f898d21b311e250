"""What differs between the sweeps of one specimen: its stated temperature, and small changes that nobody noticed.

    θ → θ (1 + a ΔT)(1 − j b ΔT)    for every constant, free or held, ΔT from the mean temperature of all sweeps,

so that b is the growth of the loss tangent per kelvin. a includes the thermal expansion of the body, some 1e-6/K.
Changes that are not stated (a few tenths of a kelvin, a new grip) shift the resonances of each sweep by a small share p
of its own,

    s_ij → s_ij/(1 + p)²,

so that the constants are those of the mean of all sweeps, whichever comes first.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter
from femu_piezo.material.constants import D_FORM

#: Name of the effect whose parameters are the shifts of the sweeps.
REPEATABILITY = "repeatability"
#: Prior standard deviations of temperature coefficients of ceramics, 1/K: of compliances, of the other constants, and
#: of all tangents.
_ELASTIC, _ELECTRIC, _TANGENT = 1e-3, 5e-3, 1e-3
_COMPLIANCES = [index for index, name in enumerate(D_FORM) if name.startswith("s")]


def _constants(context: EffectContext) -> tuple[str, ...]:
    """Names of the constants that are not zero."""
    return tuple(name for name in D_FORM if getattr(context.constants, name) != 0)


def _coefficients(context: EffectContext):
    indices, kelvin = [D_FORM.index(name) for name in _constants(context)], context.conditions.warmer_K

    def constants(theta, tangents, omega, p):
        theta, tangents = theta.copy(), tangents.copy()
        by_p = np.zeros((*theta.shape, p.size), dtype=complex)
        for number, index in enumerate(indices):
            real, loss = 1 + p[2 * number] * kelvin, 1 - 1j * p[2 * number + 1] * kelvin
            by_p[:, index, 2 * number] = theta[:, index] * kelvin * loss
            by_p[:, index, 2 * number + 1] = -1j * theta[:, index] * kelvin * real
            theta[:, index] *= real * loss
            tangents[:, index] *= real * loss
        return theta, tangents, by_p

    return constants


def _shift(number: int):
    def constants(theta, tangents, omega, p):
        by_p = np.zeros((*theta.shape, p.size), dtype=complex)
        theta, tangents, w = theta.copy(), tangents.copy(), 1 + p[number]
        theta[:, _COMPLIANCES] /= w**2
        tangents[:, _COMPLIANCES] /= w**2
        by_p[:, _COMPLIANCES, number] = -2 * theta[:, _COMPLIANCES] / w
        return theta, tangents, by_p

    return constants


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """Present where there are several sweeps; never causes."""
    conditions, found = context.conditions, []
    if conditions.span_K > 0:
        found.append(
            Effect(
                name="temperature_coefficients",
                sentence="the constants change with temperature",
                parameters=tuple(
                    parameter
                    for name in _constants(context)
                    for parameter in (
                        _coefficient(name, 1e-3, _ELASTIC if name.startswith("s") else _ELECTRIC),
                        _coefficient(f"tan_{name}", 1e-4, _TANGENT),
                    )
                ),
                constants=_coefficients(context),
                of_conditions=True,
            )
        )
    repeats = context.tolerances.get(REPEATABILITY, 0.0)
    if conditions.count > 1 and repeats:
        found.append(
            Effect(
                name=REPEATABILITY,
                sentence="the resonance frequencies of the specimen differ from sweep to sweep",
                parameters=tuple(
                    EffectParameter(
                        f"sweep_{number + 1}", "1", -0.01, 0.01, repeats, repeats, optional=True, tolerance=repeats
                    )
                    for number in range(conditions.count)
                ),
                constants=_shift(conditions.number),
                of_specimen=True,
                of_conditions=True,
            )
        )
    return tuple(found)


def _coefficient(name: str, usual: float, std: float) -> EffectParameter:
    return EffectParameter(name, "1/K", -0.05, 0.05, usual, std, optional=True, tolerance=std)
