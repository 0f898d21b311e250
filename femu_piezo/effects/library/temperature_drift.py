"""The specimen warms up or cools down while it is swept: its compliances change linearly in the time of the sweep.

    s_ij → s_ij/w²,    w = 1 + p [t(ω) − t(ω0)],    t the time at which the sweep reached ω, over its whole time,

so that p is the share by which resonances rise from the beginning of the sweep to its end. At the fundamental ω0 (or
the end of the sweep that is nearest to it) the constants keep their values in the first sweep of a specimen; in each
further sweep they have another level, a parameter that adds to w. A body with compliances s/w² behaves as one with s,
d w and ε at frequencies lower by the factor w:

    Z'(ω) = Z(ω/w; s, d w, ε)/w,    Z a cubic polynomial in d through values at Chebyshev nodes over the range of w.

All points are assumed to take the same time, and a sweep to go up where nothing is said. p < 0 is a body that grew
softer. The change of d and ε with temperature is not known and left out.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import AcquisitionHook, Effect, EffectContext, EffectParameter, Reached
from femu_piezo.effects.softening import COUPLING
from femu_piezo.interpolation import chebyshev_nodes
from femu_piezo.threads import in_parallel

#: Share of the drift that the law misses: the temperature coefficients of d and ε, and warming at no constant rate.
_LAW_ERROR = 0.1
#: Values of d at which Z is computed, and the least half range of w that they span.
_NODES, _NARROW = 4, 1e-3
#: Step of w for the slope of Z'.
_STEP = 1e-6


def _hook(context: EffectContext) -> AcquisitionHook:
    pace = np.array(context.pace_Hz or context.band_Hz)
    shares = np.linspace(0, 1, pace.size)
    at, number = np.interp(context.fundamental_Hz, pace, shares), context.conditions.number
    sign = 1.0 if context.conditions.rising else -1.0

    def acquisition(inside: Reached, omega: np.ndarray, p: np.ndarray):
        weights = np.zeros((omega.size, p.size))
        weights[:, 0] = sign * (np.interp(omega / (2 * np.pi), pace, shares) - at)
        if number:
            weights[:, number] = 1.0
        w = 1 + weights @ p

        # at w, and at w a step larger and smaller, for the slope of Z' in w
        each, k, z, tangents = np.concatenate([w, w + _STEP, w - _STEP]), omega.size, 0.0, 0.0
        middle, half = (w.min() + w.max()) / 2, max(np.ptp(w) / 2, _NARROW)
        nodes, every = chebyshev_nodes(middle - half, middle + half, _NODES, each)

        def at_coupling(node: float) -> tuple[np.ndarray, np.ndarray]:
            return inside(np.tile(omega, 3) / each, (COUPLING, np.array([node - 1])), slopes=k)

        for (value, slopes), share in zip(in_parallel(at_coupling, nodes), every.T, strict=True):
            z, tangents = z + share * value / each, tangents + (share / each)[:k, None] * slopes
        here, ahead, behind = z.reshape(3, k)
        return here, tangents, weights * ((ahead - behind) / (2 * _STEP))[:, None]

    return acquisition


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For every body."""
    return (
        Effect(
            name="temperature_drift",
            sentence="the specimen warmed up or cooled down during the sweep: later resonances are shifted further",
            parameters=(
                EffectParameter("drift", "1", -0.1, 0.1, 5e-4, 3e-3, law_error=_LAW_ERROR),
                *(
                    EffectParameter(f"level_{number + 1}", "1", -0.1, 0.1, 5e-4, 3e-3, optional=True)
                    for number in range(1, context.conditions.count)
                ),
            ),
            confusable_with=("wrong_insensitive_parameter", "wrong_width", "frequency_dependent_elastic_loss"),
            advice=(
                "sweep again in the opposite direction: a drift changes the sign of its shift, a constant does not",
                "wait until the specimen has the temperature of the room, and sweep at a lower voltage",
            ),
            acquisition=_hook(context),
            outward=0.25,
            of_conditions=True,
        ),
    )
