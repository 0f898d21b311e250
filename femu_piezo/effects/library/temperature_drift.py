"""The specimen warms up or cools down while it is swept: its compliances change evenly in the time of the sweep.

    s_ij → s_ij/w²,    w = 1 + p [t(ω) − t(ω0)],    t the share of the sweep's time at which it came by ω,

so that p is the share by which resonances rise from the lowest frequency of the sweep to the highest; at the
fundamental ω0 the constants keep their values. A body of compliances s/w² is that of s, d w and ε at frequencies lower
by w:

    Z'(ω) = Z(ω/w; s, d w, ε)/w,    Z a parabola in d through three values.

Every point is taken to have had the same time. Sweeps are sorted by frequency: one that went down has p of the other
sign, and p < 0 in one that went up is a body that grew softer. How d and ε themselves change is not known and left out.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import AcquisitionHook, Effect, EffectContext, EffectParameter, Reached
from femu_piezo.material.constants import D_FORM

_PIEZOELECTRIC = [D_FORM.index(name) for name in ("d31", "d33", "d15")]
#: Share of the drift that the law misses: the coefficients of d and ε, and a pace of warming that was not even.
_LAW_ERROR = 0.1
#: Relative steps of d and of frequency.
_SIDE, _STEP = 4e-3, 1e-6


def _scaled(theta, tangents, omega, p):
    """d (1 + p)."""
    theta, tangents = theta.copy(), tangents.copy()
    own = np.zeros((*theta.shape, 1), dtype=complex)
    own[:, _PIEZOELECTRIC, 0] = theta[:, _PIEZOELECTRIC]
    theta[:, _PIEZOELECTRIC] *= 1 + p[0]
    tangents[:, _PIEZOELECTRIC] *= 1 + p[0]
    return theta, tangents, own


_SIDES = Effect(
    "sides of d", "", (EffectParameter("share", "1", -0.1, 0.1, 1.0, 0.0),), constants=_scaled, dispersive=False
)


def _hook(context: EffectContext) -> AcquisitionHook:
    pace = np.array(context.pace_Hz or context.band_Hz)
    shares = np.linspace(0, 1, pace.size)
    at = np.interp(context.fundamental_Hz, pace, shares)

    def acquisition(inside: Reached, omega: np.ndarray, p: np.ndarray):
        time = np.interp(omega / (2 * np.pi), pace, shares) - at
        w = 1 + p[0] * time

        def body(w: np.ndarray, slopes: bool = True):
            u, z, tangents = (w - 1) / _SIDE, 0.0, 0.0
            for side, share in ((-_SIDE, u * (u - 1) / 2), (0.0, 1 - u**2), (_SIDE, u * (u + 1) / 2)):
                own = inside(omega / w, (_SIDES, np.array([side])), slopes=slopes)
                z, tangents = z + share * own[0] / w, tangents + (share / w)[:, None] * own[1]
            return z, tangents

        z, tangents = body(w)
        ahead, behind = (body(w + step, slopes=False)[0] for step in (_STEP, -_STEP))
        return z, tangents, (time * (ahead - behind) / (2 * _STEP))[:, None]

    return acquisition


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For every body."""
    return (
        Effect(
            name="temperature_drift",
            sentence="the specimen warmed up or cooled down during the sweep: resonances drift, later ones further",
            parameters=(EffectParameter("drift", "1", -0.1, 0.1, 5e-4, 3e-3, law_error=_LAW_ERROR),),
            confusable_with=("wrong_insensitive_parameter", "wrong_width", "frequency_dependent_elastic_loss"),
            advice=(
                "sweep again in the opposite direction: a drift changes its sign, a constant does not",
                "wait until the specimen has the temperature of the room, and sweep at a lower level",
            ),
            acquisition=_hook(context),
            outward=0.25,
        ),
    )
