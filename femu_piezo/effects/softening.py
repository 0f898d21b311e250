"""Impedance of a body whose compliances all change by one factor, from the unchanged body at other frequencies.

A body with compliances s w², d and ε behaves as one with s, d/w and ε at frequencies higher by the factor w:

    Z(ω; s w², d, ε) = w Z(ωw; s, d/w, ε).
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import Effect, EffectParameter, Reached
from femu_piezo.material.constants import D_FORM

_PIEZOELECTRIC = [D_FORM.index(name) for name in ("d31", "d33", "d15")]
#: Relative steps of frequency and of d.
_STEP, _SIDE = 1e-5, 4e-3


def _scaled(theta, tangents, omega, p):
    """d (1 + p)."""
    theta, tangents = theta.copy(), tangents.copy()
    by_p = np.zeros((*theta.shape, 1), dtype=complex)
    by_p[:, _PIEZOELECTRIC, 0] = theta[:, _PIEZOELECTRIC]
    theta[:, _PIEZOELECTRIC] *= 1 + p[0]
    tangents[:, _PIEZOELECTRIC] *= 1 + p[0]
    return theta, tangents, by_p


#: d times 1 + share, for a body that is asked for with a further effect (`femu_piezo.effects.effect.Reached`).
COUPLING = Effect(
    "coupling", "", (EffectParameter("share", "1", -0.1, 0.1, 1.0, 0.0),), constants=_scaled, dispersive=False
)


def softened(inside: Reached, omega: np.ndarray) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Z (k,) at frequencies (k,) rad/s, and dZ/dw at w = 1 of compliances s w²: Z + ω ∂Z/∂ω − d ∂Z/∂d.

    Each comes with its slopes (k, n_x).
    """
    near = inside(np.concatenate([omega, omega * (1 + _STEP), omega * (1 - _STEP)]))
    sides = [inside(omega, (COUPLING, np.array([sign * _SIDE]))) for sign in (1, -1)]
    here, along = [], []
    for part in (0, 1):
        value, ahead, behind = np.split(near[part], 3)
        more, less = (side[part] for side in sides)
        here.append(value)
        along.append(value + (ahead - behind) / (2 * _STEP) - (more - less) / (2 * _SIDE))
    return (here[0], here[1]), (along[0], along[1])
