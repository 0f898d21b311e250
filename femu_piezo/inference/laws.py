"""What approximate laws miss: errors of known size beside the noise.

The law of a cause is an approximation that is wrong by a share e of what it describes (`EffectParameter.law_error`). It
may be wrong as a whole, so that the parameter that fits best is off by e of its value, and in shape, so that it misses
e of its change of log Z in each band by itself. One that ends with the square of the size p may also have that change
at a frequency that is off by φ p² (`EffectParameter.law_detuning`): modes which nothing else drives are not put in
place by any fit. All of it moves what is fitted beside the cause as any change of data does, and is what a further
cause might be taken for.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from femu_piezo.effects.effect import Effect
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.measurement.sweeps import SweepData, stacked

if TYPE_CHECKING:
    from femu_piezo.inference.fit import Response

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
    at_x: tuple[np.ndarray, np.ndarray],
    slope: np.ndarray,
) -> np.ndarray:
    """(2k, m) whitened errors of log Z, independent and of one standard deviation each, of all laws at x (n_x,).

    Of every parameter p: e p ∂log Z/∂p. Of the first one, the size, with Δ the change of log Z between the effect as it
    is at x and none, in each band: e Δ, and φ p² ∂Δ/∂log f. Known effects have laws as fitted ones do.

    at_x : whitened residual (2k,) and Jacobian (2k, n_x) there;  slope : (k,) ∂log Z/∂log f there
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
    residual, jacobian = data.whitened(*response.with_jacobian(whole, at)) if known else at_x
    found = []
    for number in numbers:
        effect, own = whole.effects[number], whole.columns(number)
        errors = np.array([parameter.law_error for parameter in effect.parameters])
        found.append(jacobian[:, own] * (errors * at[own]))
        without = at.copy()
        without[own] = effect.rest / effect.scale
        misses = [errors[0] * (residual - data.whitened(*response.with_jacobian(whole, without))[0])]
        if detuning := effect.parameters[0].law_detuning:
            size = (at - without)[own.start] * effect.scale[0]
            change = data.over_noise(slope - log_slope(response, whole, without))
            misses.append(detuning * size**2 * stacked(change))
        found += [_in_bands(data, miss) for miss in misses]
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
