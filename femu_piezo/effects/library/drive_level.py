"""The drive is too high: the compliances and their loss grow with the square of the strain, and resonances lean over.

At the amplitude of each frequency the body is taken as linear (describing function, quasi-linear),

    s → s [1 + β A (1 − jq)],    A = |Y'|²/max |Y|²,

with the constant voltage of the instrument. The strain of a resonance goes with its velocity and so with the current Y'
that there is in the end, which the lean itself limits; the largest of the sweep were it linear, max |Y|, is the unit. β
is the growth of the compliance there, q how much loss it has. With compliances s w² (`femu_piezo.effects.softening`),

    Z' = Z + β A (1 − jq)/2 · ∂Z/∂w

to first order; of several sweeps each has (V/V_max)² of β by its voltage V. Z is straight where A is large, at the
zeros of Z. With g = β (1 − jq)/2 · ∂Z/∂w/max|Y|² the square u = |Z'|² obeys

    Z' = Z + g/u,    u³ = |Z|² u² + 2 Re(Z* g) u + |g|².
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import AcquisitionHook, Effect, EffectContext, EffectParameter, Reached
from femu_piezo.effects.softening import softened

#: Share of the lean that the law misses: strain that is not even, a current that is not all of motion.
_LAW_ERROR = 0.1
#: Newton steps of the cubic.
_TURNS = 40


def _square(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """The largest root u (k,) of u³ = a u² + b u + c, by Newton's steps from above all of them (Cauchy's bound)."""
    u = np.maximum.reduce([3 * a, np.sqrt(3 * np.abs(b)), np.cbrt(3 * c)])
    for _ in range(_TURNS):
        u = u - (((u - a) * u - b) * u - c) / ((3 * u - 2 * a) * u - b)
    return u


def _hook(drive: float) -> AcquisitionHook:
    """drive : V/V_max"""

    def acquisition(inside: Reached, omega: np.ndarray, p: np.ndarray):
        z, slopes, own = _leaning(inside, omega, p * np.array([drive**2, 1.0]))
        return z, slopes, own * np.array([drive**2, 1.0])

    return acquisition


def _leaning(inside: Reached, omega: np.ndarray, p: np.ndarray):
    (z, slopes), (along, along_slopes) = softened(inside, omega)
    top = int(np.argmin(np.abs(z)))
    unit, unit_slopes = np.abs(z[top]) ** 2, 2 * (np.conj(z[top]) * slopes[top]).real  # 1/max |Y|²
    factor = (1 - 1j * p[1]) / 2
    g = p[0] * factor * along * unit
    dg = p[0] * factor * (along_slopes * unit + along[:, None] * unit_slopes)
    own = along[:, None] * unit * np.array([factor, -0.5j * p[0]])
    u = _square(np.abs(z) ** 2, 2 * (np.conj(z) * g).real, np.abs(g) ** 2)
    found = z + g / u

    def moved(dz: np.ndarray, dg: np.ndarray) -> np.ndarray:
        """Slopes (k, n) of Z' of those of Z and g."""
        one, other = np.conj(z)[:, None], np.conj(g)[:, None]
        parts = ((one * dz).real * u[:, None] + (one * dg + other * dz).real) * u[:, None] + (other * dg).real
        below = (3 * u - 2 * np.abs(z) ** 2) * u - 2 * (np.conj(z) * g).real
        return dz + dg / u[:, None] - (g / u**2 / below)[:, None] * 2 * parts

    return found, moved(slopes, dg), moved(np.zeros_like(own), own)


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For every body."""
    return (
        Effect(
            name="drive_level",
            sentence="the drive is too high: the material softens where the strain is large, and resonances lean over",
            parameters=(
                EffectParameter("softening", "1", 0.0, 0.1, 5e-4, 3e-3, law_error=_LAW_ERROR),
                EffectParameter("loss_ratio", "1", 0.0, 3.0, 0.2, 0.4, rest=0.4, optional=True, law_error=_LAW_ERROR),
            ),
            confusable_with=("temperature_drift", "sweep_too_fast", "tan_s11"),
            advice=(
                "sweep again at a third of the voltage: the lean falls to a ninth",
                "sweep again in the opposite direction: a drift changes its sign, a lean does not",
            ),
            acquisition=_hook(context.taken.drive),
            outward=0.3,
            of_conditions=True,
        ),
    )
