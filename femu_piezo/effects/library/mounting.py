"""The support is not free: springs and dashpots to ground on both faces.

On a plate they stand on a narrow strip across the middle, |x| < w/2, on a disk or ring on a circle of radius r, evenly
and alike in all directions: the total stiffness k and the total damping d. What is even over a narrow strip is, up to
the fourth power of w, what sits at |x| = w/√12:

    A → A + (k + jωd) mean NᵗN  over the line across the face at w/√12, or over the circle
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter, LocalHook, LocalTerm
from femu_piezo.effects.local.operators import Places

#: Radii to look at first, as shares of the way from the inner to the outer one.
_RADII = np.array([0.02, 0.25, 0.5, 0.75, 0.9, 0.99])


def _hook(share: float) -> LocalHook:
    """share : place of the line over the last parameter."""

    def terms(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
        line, slope = places.face.mean_square(share * p[2])
        u, size = line.shape[0], places.size
        value = p[0] + 1j * omega * p[1]
        zero, one = np.zeros(omega.shape, dtype=complex), np.ones(omega.shape, dtype=complex)
        full = [np.zeros((size, size)) for _ in range(2)]
        full[0][:u, :u], full[1][:u, :u] = line, slope
        return [
            LocalTerm("stiffness", full[0], value, np.stack([one, 1j * omega, zero], axis=1)),
            LocalTerm("stiffness", full[1], zero, np.stack([zero, zero, share * value], axis=1)),
        ]

    return terms


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For plates with three mirror planes, disks and rings; sizes against the body's inertia at its fundamental."""
    if context.mass is None:
        return ()
    omega = 2 * np.pi * context.fundamental_Hz
    stiffness, damping = 0.05 * context.mass * omega**2, 0.05 * context.mass * omega
    if context.radii is None:
        length, share, sites = context.dimensions[0], 1 / np.sqrt(12.0), None
        sentence = "the support at the middle holds the plate: a spring and a dashpot to ground"
        place = EffectParameter(
            "width", "m", 0.0, length / 4, length / 20, length / 15, rest=length / 15, optional=True
        )
    else:
        (inner, outer), share = context.radii, 1.0
        sentence = "the support holds the body on a circle: springs and dashpots to ground"
        place = EffectParameter(
            "radius", "m", inner, outer, (outer - inner) / 20, 10 * (outer - inner), rest=(inner + outer) / 2
        )
        sites = np.array([(0.1 * stiffness, 0.0, inner + one * (outer - inner)) for one in _RADII])
    return (
        Effect(
            name="mounting",
            sentence=sentence,
            parameters=(
                EffectParameter("stiffness", "N/m", 0.0, 40 * stiffness, stiffness, 5 * stiffness, law_error=0.03),
                EffectParameter("damping", "N s/m", 0.0, 40 * damping, damping, 5 * damping, law_error=0.03),
                place,
            ),
            confusable_with=("frequency_dependent_elastic_loss", "wrong_insensitive_parameter"),
            advice=("measure again hung on thin wires or lying on foam", "move the support and see what changes"),
            local=_hook(share),
            dispersive=True,
            sites=sites,
        ),
    )
