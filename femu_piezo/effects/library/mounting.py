"""The support is not free: springs and dashpots to ground on a narrow strip across the middle of both faces.

The strip |x| < w/2 bears the total stiffness k and the total damping r evenly, alike in all directions. What is even
over a narrow strip is, up to the fourth power of w, what sits at |x| = w/√12:

    A → A + (k + jωr) mean_y N(w/√12, y)ᵗ N(w/√12, y)
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import legendre

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter, LocalTerm
from femu_piezo.effects.local.operators import Face, Places

#: Gauss points across the width.
_ACROSS = 10


def _mean(face: Face, x: float) -> tuple[np.ndarray, np.ndarray]:
    """mean over y of NᵗN (u, u) at |x|, the share of one part, and its slope ∂/∂x."""
    nodes, weights = legendre.leggauss(_ACROSS)
    total, slope = 0.0, 0.0
    for y, weight in zip((nodes + 1) / 2 * face.half[1], weights / 2, strict=True):
        n, slopes = face.at(x, y)
        total = total + weight * (n.T @ n)
        moved = slopes[0].T @ n
        slope = slope + weight * (moved + moved.T)
    share = face.same_class / face.copies
    return total * share, slope * share


def _terms(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
    x = p[2] / np.sqrt(12.0)
    strip, slope = _mean(places.face, x)
    u, size = strip.shape[0], places.size
    value = p[0] + 1j * omega * p[1]
    zero, one = np.zeros(omega.shape, dtype=complex), np.ones(omega.shape, dtype=complex)
    full = [np.zeros((size, size)) for _ in range(2)]
    full[0][:u, :u], full[1][:u, :u] = strip, slope
    return [
        LocalTerm("stiffness", full[0], value, np.stack([one, 1j * omega, zero], axis=1)),
        LocalTerm("stiffness", full[1], zero, np.stack([zero, zero, value / np.sqrt(12.0)], axis=1)),
    ]


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For plates with three mirror planes; sizes against the inertia of the plate at its fundamental."""
    if context.dimensions is None:
        return ()
    length = context.dimensions[0]
    own = context.density * float(np.prod(context.dimensions))
    omega = 2 * np.pi * context.fundamental_Hz
    stiffness, damping = 0.05 * own * omega**2, 0.05 * own * omega
    return (
        Effect(
            name="mounting",
            sentence="the support at the middle holds the plate: a spring and a dashpot to ground",
            parameters=(
                EffectParameter("stiffness", "N/m", 0.0, 40 * stiffness, stiffness, 5 * stiffness, law_error=0.03),
                EffectParameter("damping", "N s/m", 0.0, 40 * damping, damping, 5 * damping, law_error=0.03),
                EffectParameter(
                    "width", "m", 0.0, length / 4, length / 20, length / 15, rest=length / 15, optional=True
                ),
            ),
            confusable_with=("frequency_dependent_elastic_loss", "wrong_insensitive_parameter"),
            advice=("measure again hung on thin wires or lying on foam", "move the support and see what changes"),
            local=_terms,
            dispersive=True,
        ),
    )
