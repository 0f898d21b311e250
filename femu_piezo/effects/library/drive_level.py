"""The drive is too high: the compliances and their loss grow with the square of the strain, and resonances lean over.

At each frequency the body is taken as linear with the compliances at its amplitude there (describing function),

    s → s [1 + β A (1 − jq)],    A = |Y'|²/|Y_1|²,

under the constant voltage of the instrument. The strain of a resonance is proportional to its velocity and so to the
current, that is to the final Y', which the softening itself limits. The unit is |Y_1|, the admittance of the body
without softening at its fundamental resonance, whatever frequencies are swept: at that current β is the relative growth
of the compliance and βq that of its loss. With compliances s w² (`femu_piezo.effects.softening`),

    Z' = Z + β A (1 − jq)/2 · ∂Z/∂w

to first order, which suffices: Z is nearly linear in w near its zeros, where A is large. A sweep with the voltage V has
(V/V_max)² of β, V_max the largest of all sweeps. With g = β (1 − jq)/2 · ∂Z/∂w/|Y_1|² the square u = |Z'|² obeys

    Z' = Z + g/u,    u³ = |Z|² u² + 2 Re(Z* g) u + |g|².
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import AcquisitionHook, Effect, EffectContext, EffectParameter, Reached
from femu_piezo.effects.softening import softened

#: Share of the change that the law misses: strain is not uniform, and not all of the current is that of motion.
_LAW_ERROR = 0.1
#: Frequencies over that of the fundamental about which Y_1 is the largest admittance.
_NEAR = np.linspace(0.96, 1.04, 241)
#: Newton steps for the root of the cubic.
_STEPS = 40


def _square(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """The largest root u (k,) of u³ = a u² + b u + c, by Newton's steps from above all of them (Cauchy's bound)."""
    u = np.maximum.reduce([3 * a, np.sqrt(3 * np.abs(b)), np.cbrt(3 * c)])
    for _ in range(_STEPS):
        u = u - (((u - a) * u - b) * u - c) / ((3 * u - 2 * a) * u - b)
    return u


def _least_square(z: np.ndarray, slopes: np.ndarray) -> tuple[float, np.ndarray]:
    """The least |Z|² about a resonance, of Z (k,) at points around it, and its slopes (n_x,), from those (k, n_x) of Z.

    Z runs along a straight line there, whose distance from 0 is Im(Z_1* Z_2)/|Z_2 − Z_1|: steps of the frequency may be
    wider than a sharp resonance.
    """
    size = np.abs(z)
    top = int(np.argmin(size[1:-1])) + 1
    ends = [top, top + 1 if size[top + 1] < size[top - 1] else top - 1]
    (first, second), (by_first, by_second) = z[ends], slopes[ends]
    along, by_along = second - first, by_second - by_first
    area, by_area = (np.conj(first) * second).imag, (np.conj(by_first) * second + np.conj(first) * by_second).imag
    length = np.abs(along) ** 2
    least = area**2 / length
    return float(least), (2 * area * by_area - least * 2 * (np.conj(along) * by_along).real) / length


def _hook(drive: float, fundamental_Hz: float) -> AcquisitionHook:
    """drive : V/V_max"""
    near = 2 * np.pi * fundamental_Hz * _NEAR

    def acquisition(inside: Reached, omega: np.ndarray, p: np.ndarray):
        z, slopes, by_p = _leaning(inside, omega, p * np.array([drive**2, 1.0]), near)
        return z, slopes, by_p * np.array([drive**2, 1.0])

    return acquisition


def _leaning(inside: Reached, omega: np.ndarray, p: np.ndarray, near: np.ndarray):
    unit, unit_slopes = _least_square(*inside(near))  # 1/|Y_1|²
    (z, slopes), (by_w, by_w_slopes) = softened(inside, omega)
    factor = (1 - 1j * p[1]) / 2
    g = p[0] * factor * by_w * unit
    dg = p[0] * factor * (by_w_slopes * unit + by_w[:, None] * unit_slopes)
    g_by_p = by_w[:, None] * unit * np.array([factor, -0.5j * p[0]])
    u = _square(np.abs(z) ** 2, 2 * (np.conj(z) * g).real, np.abs(g) ** 2)
    found = z + g / u

    def moved(dz: np.ndarray, dg: np.ndarray) -> np.ndarray:
        """Slopes (k, n) of Z', from those of Z and g."""
        z_conj, g_conj = np.conj(z)[:, None], np.conj(g)[:, None]
        parts = ((z_conj * dz).real * u[:, None] + (z_conj * dg + g_conj * dz).real) * u[:, None] + (g_conj * dg).real
        below = (3 * u - 2 * np.abs(z) ** 2) * u - 2 * (np.conj(z) * g).real
        return dz + dg / u[:, None] - (g / u**2 / below)[:, None] * 2 * parts

    return found, moved(slopes, dg), moved(np.zeros_like(g_by_p), g_by_p)


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For every body."""
    return (
        Effect(
            name="drive_level",
            sentence="the drive voltage is too high: large strain softens the material and lowers its resonances",
            parameters=(
                EffectParameter("softening", "1", 0.0, 0.1, 5e-4, 3e-3, law_error=_LAW_ERROR),
                EffectParameter("loss_ratio", "1", 0.0, 3.0, 0.2, 0.4, rest=0.4, optional=True, law_error=_LAW_ERROR),
            ),
            confusable_with=("temperature_drift", "sweep_too_fast", "tan_s11"),
            advice=(
                "sweep again at a third of the voltage: the shift of the resonances falls to a ninth",
                "sweep again in the opposite direction: a shift by drift changes its sign, one by the drive does not",
            ),
            acquisition=_hook(context.conditions.drive, context.fundamental_Hz),
            outward=0.3,
            of_conditions=True,
        ),
    )
