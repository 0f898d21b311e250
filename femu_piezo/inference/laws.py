"""What approximate laws miss: errors of known size beside the noise.

The law of a cause is an approximation that is wrong by a share e of what it describes (`EffectParameter.law_error`). It
may be wrong as a whole, so that the parameter that fits best is off by e of its value, and in shape, so that it misses
e of its change of log Z in each band by itself. Both move what is fitted beside the cause as any change of data does.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from femu_piezo.effects.effect import Effect
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.measurement.sweeps import SweepData

if TYPE_CHECKING:
    from femu_piezo.inference.fit import Response


def law_misses(
    response: Response,
    data: SweepData,
    parameters: Unknowns,
    x: np.ndarray,
    at_x: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """(2k, m) whitened errors of log Z, independent and of one standard deviation each, of all laws at x (n_x,).

    Of every parameter p: e p ∂log Z/∂p. Of the first one, the size, in each band: e times the change of log Z between
    the effect as it is at x and none. Known effects have laws as fitted ones do.

    at_x : whitened residual (2k,) and Jacobian (2k, n_x) there
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
        change = residual - data.whitened(*response.with_jacobian(whole, without))[0]
        for band in data.bands():
            rows = np.concatenate([band, band + data.impedance.size])
            miss = np.zeros((residual.size, 1))
            miss[rows, 0] = errors[0] * change[rows]
            found.append(miss)
    return np.hstack(found)


def _approximate(effect: Effect) -> bool:
    return any(parameter.law_error > 0 for parameter in effect.parameters)
