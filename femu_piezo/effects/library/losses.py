"""Laws over frequency.

Elastic losses that follow a power of frequency: tan φ(ω) = tan φ (ω/ω0)^n for all five compliances.

Two laws, which the data tell apart:

- plain: the real parts do not change, which is not causal. The exponent may change with frequency, n + m ln(ω/ω0), as
  at a broad peak of the loss.
- causal: the real parts change as well, as the change of the loss demands by the Kramers-Kronig relations. A loss
  s'' = s' tan φ (ω/ω0)^n belongs to the causal compliance ∝ (jω)^n, whose real part adds
  −s' tan φ cot(nπ/2) [(ω/ω0)^n − 1]; of this the share of a constant loss, −s' tan φ (2/π) ln(ω/ω0), is left out as
  in the base model, so that n = 0 is the base model.

ε33T falls by a share per decade, which may change with frequency: ε33T(ω) = ε33T [1 − p L (1 + b L)], L = log10(ω/ω0).

The Kramers-Kronig partner of a constant fall is a constant loss tangent p π/(2 ln 10) to first order in p (Jonscher's
constant loss). It is not added here, since the tangent of ε33T includes it: the model is causal where that tangent is
not smaller.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter
from femu_piezo.material.constants import D_FORM

_EPS33T = D_FORM.index("eps33T")
_ELASTIC = slice(0, 5)
#: Share of their change that the laws miss: they are empirical, and this is assumed, not measured.
_LAW_ERROR = 0.1
#: Largest exponent (that of a causal law is below 2), and largest change of it, which its prior keeps smaller still.
_STEEPEST, _CHANGE = 1.5, 4.0
_SENTENCE = "the elastic loss tangent changes with frequency by a power law"


def partner(n: float, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """d(n, L) = cot(nπ/2)(e^{nL} − 1) − (2/π) L and ∂d/∂n, each (k,), by their series about n = 0 where n is small.

    logs : (k,) L = ln(ω/ω0)
    """
    if abs(n) < 1e-3:
        second, third = logs**2 / np.pi, logs**3 / (3 * np.pi) - np.pi * logs / 6
        return n * second + n**2 * third, second + 2 * n * third
    half = np.pi / 2
    power, cot = np.exp(n * logs), 1 / np.tan(n * half)
    slope = -half * (1 + cot**2) * (power - 1) + cot * logs * power
    return cot * (power - 1) - logs / half, slope


def _hook(anchor: float, causal: bool):
    def constants(theta, tangents, omega, p):
        logs = np.log(omega / anchor)
        rates = logs[:, None] ** np.arange(1, 1 + p.size)  # ∂ ln(tan φ)/∂p
        power = np.exp(rates @ p)
        shift, shift_slope = partner(p[0], logs) if causal else (np.zeros_like(logs), np.zeros_like(logs))

        def law(values, power, shift, keep):  # with Im s = −s' tan φ: keep Re s + shift Im s + j power Im s
            add = (slice(None),) + (None,) * (values.ndim - 1)
            return keep * values.real + shift[add] * values.imag + 1j * power[add] * values.imag

        by_p = np.zeros((*theta.shape, p.size), dtype=complex)
        for number, rate in enumerate(rates.T):
            by_p[:, _ELASTIC, number] = law(theta[:, _ELASTIC], power * rate, shift_slope, 0.0)
        theta, tangents = theta.copy(), tangents.copy()
        theta[:, _ELASTIC] = law(theta[:, _ELASTIC], power, shift, 1.0)
        tangents[:, _ELASTIC] = law(tangents[:, _ELASTIC], power, shift, 1.0)
        return theta, tangents, by_p

    return constants


def _elastic(context: EffectContext) -> tuple[Effect, ...]:
    """The plain law and its causal variant."""
    anchor = 2 * np.pi * context.fundamental_Hz

    def exponent(name: str) -> EffectParameter:
        return EffectParameter(name, "1", -_STEEPEST, _STEEPEST, 0.3, 1.0, law_error=_LAW_ERROR)

    change = EffectParameter("change_of_exponent", "1", -_CHANGE, _CHANGE, 0.3, 0.5, optional=True)
    laws = (
        ("", (exponent("exponent"), change), False, "; the law is not causal"),
        (
            "causal",
            (exponent("causal_exponent"),),
            True,
            ", with the dispersion of the compliances that causality requires",
        ),
    )
    return tuple(
        Effect(
            name="frequency_dependent_elastic_loss",
            law=law,
            sentence=_SENTENCE + words,
            parameters=parameters,
            confusable_with=("wrong_insensitive_parameter", "tan_s11"),
            advice=("measure up to the next overtones: each further mode gives the loss at another frequency",),
            constants=_hook(anchor, causal),
            dispersive=True,
        )
        for law, parameters, causal, words in laws
    )


def _dielectric(context: EffectContext) -> tuple[Effect, ...]:
    """The fall of ε33T, which keeps its value at the fundamental."""
    anchor = 2 * np.pi * context.fundamental_Hz

    def constants(theta, tangents, omega, p):
        decades = np.log10(omega / anchor)
        bent = decades * (1 + p[1] * decades)
        factor = 1 - p[0] * bent
        by_p = np.zeros((*theta.shape, 2), dtype=complex)
        by_p[:, _EPS33T, 0] = -bent * theta[:, _EPS33T]
        by_p[:, _EPS33T, 1] = -p[0] * decades**2 * theta[:, _EPS33T]
        theta, tangents = theta.copy(), tangents.copy()
        theta[:, _EPS33T] *= factor
        tangents[:, _EPS33T] *= factor[:, None]
        return theta, tangents, by_p

    return (
        Effect(
            name="dielectric_dispersion",
            sentence="ε33T falls with frequency, by a fraction of its value per decade",
            parameters=(
                EffectParameter("fall_per_decade", "1", -0.1, 0.4, 0.01, 0.1, law_error=_LAW_ERROR),
                EffectParameter("change_per_decade", "1", -2.0, 2.0, 0.1, 0.3, optional=True),
            ),
            confusable_with=("eps33T", "series_inductance", "leakage"),
            advice=("measure over two more decades of low frequencies, far below the resonances",),
            constants=constants,
            dispersive=True,
        ),
    )


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """Elastic losses by their two laws, and the fall of ε33T."""
    return (*_elastic(context), *_dielectric(context))
