"""What approximate laws miss: errors of known size beside the noise.

The law of a cause is an approximation that is wrong by a share e of what it describes (`EffectParameter.law_error`). It
may be wrong as a whole, so that the parameter that fits best is off by e of its value, and in shape: of p ∂log Z/∂p of
its size p, as far as no other unknown does the same, it misses e in each band by itself. A film that stiffens a plate
does much of what s11 does; that part has the shape of s11 and no error of its own. A law that ends with the square of p
may also have its change at a frequency that is off by φ p² (`EffectParameter.law_detuning`): modes which nothing else
drives are not put in place by any fit. All of it moves what is fitted beside the cause as any change of data does, and
is what a further cause might be taken for.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from femu_piezo.effects.effect import Effect
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.measurement.sweeps import SweepData, stacked

if TYPE_CHECKING:
    from femu_piezo.inference.descent import Response

#: Relative step of the frequency for ∂log Z/∂log f.
_STEP = 1e-5


def log_slope(response: Response, parameters: Unknowns, x: np.ndarray) -> np.ndarray:
    """(k,) ∂log Z/∂log f at x (n_x,)."""
    ahead, behind = (response.at(1 + sign * _STEP).impedance(parameters, x) for sign in (1, -1))
    return np.log(ahead / behind) / (2 * _STEP)


def law_misses(
    response: Response,
    data: SweepData,
    parameters: Unknowns,
    x: np.ndarray,
    at_x: np.ndarray,
    slope: np.ndarray,
) -> np.ndarray:
    """(2k, m) whitened errors of log Z, independent and of one standard deviation each, of all laws at x (n_x,).

    Of every parameter p: e p ∂log Z/∂p. Of the first one, the size, in each band: e p ∂log Z/∂p and φ p² ∂Δ/∂log f, Δ
    the change of log Z between the effect as it is at x and none, both less what the other unknowns can do within
    their priors. Known effects have laws as fitted ones do.

    at_x : whitened Jacobian (2k, n_x) there;  slope : (k,) ∂log Z/∂log f there
    """
    known = [item for item in parameters.fixed if _approximate(item[0])]
    whole = replace(
        parameters,
        effects=(*parameters.effects, *(effect for effect, _ in known)),
        fixed=tuple(item for item in parameters.fixed if not _approximate(item[0])),
    )
    numbers = [number for number, effect in enumerate(whole.effects) if _approximate(effect)]
    if not numbers:
        return np.zeros((2 * data.impedance.size, 0))
    at = np.concatenate([x, *(values / effect.scale for effect, values in known)])
    jacobian = data.whitened(*response.with_jacobian(whole, at))[1] if known else at_x
    found, prior_std = [], parameters.prior_std
    for number in numbers:
        effect, own = whole.effects[number], whole.columns(number)
        errors = np.array([parameter.law_error for parameter in effect.parameters])
        size = at[own.start] - effect.rest[0] / effect.scale[0]
        found.append(jacobian[:, own] * (errors * at[own]))
        misses = [errors[0] * size * jacobian[:, own.start]]
        if detuning := effect.parameters[0].law_detuning:
            without = at.copy()
            without[own] = effect.rest / effect.scale
            change = data.over_noise(slope - log_slope(response, whole, without))
            misses.append(detuning * (size * effect.scale[0]) ** 2 * stacked(change))
        others = np.delete(np.arange(x.size), np.arange(own.start, min(own.stop, x.size)))
        span = np.linalg.qr(np.concatenate([jacobian[:, others] * prior_std[others], np.eye(others.size)]))[0]
        span = span[: len(jacobian)]
        found += [_in_bands(data, miss - span @ (span.T @ miss)) for miss in misses]
    return np.hstack(found)


def _in_bands(data: SweepData, miss: np.ndarray) -> np.ndarray:
    """(2k, m) the part of a whitened (2k,) in each band."""
    found = []
    for band in data.bands():
        rows = np.concatenate([band, band + data.impedance.size])
        own = np.zeros(miss.size)
        own[rows] = miss[rows]
        found.append(own)
    return np.stack(found, axis=1)


def _approximate(effect: Effect) -> bool:
    return any(parameter.law_error > 0 for parameter in effect.parameters)
