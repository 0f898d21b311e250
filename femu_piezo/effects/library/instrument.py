"""What the accuracy of the instrument allows: Z' = Z exp(g(ω) + jφ(ω)) with smooth errors of magnitude and phase.

g and φ are Gaussian processes over u = log10 f with the accuracies of the specimen file (`accuracy`, `phase_accuracy`)
as standard deviations and the correlation exp(−Δu²/2): an instrument's error changes slowly with frequency, by about a
decade. Such a process is a sum of bells exp(−(u − i)²) on the whole decades i, whose heights are independent (Higdon
2002, space and space-time modeling using process convolutions); its variance is constant within 2 %.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter
from femu_piezo.threads import Once

#: Name of the effect, of which each parameter is the height of a bell over the accuracy.
INSTRUMENT = "instrument"
#: Height of the bells that gives a process of variance one, and how far beyond the sweep a bell still counts, decades.
_HEIGHT, _REACH = (2 / np.pi) ** 0.25, 1.5


def _bells(omega: np.ndarray, decades: np.ndarray) -> np.ndarray:
    """(k, m) bells on m decades at ω (k,) rad/s."""
    return _HEIGHT * np.exp(-((np.log10(omega / (2 * np.pi))[:, None] - decades) ** 2))


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """Only where an accuracy is known; never a cause, since an instrument outside its accuracy may err in any way."""
    magnitude, phase = (context.tolerances.get(name, 0.0) for name in ("accuracy", "phase_accuracy"))
    if magnitude == 0 and phase == 0:
        return ()
    low, high = np.log10(context.band_Hz)
    decades = np.arange(np.ceil(low - _REACH), np.floor(high + _REACH) + 1)
    scales, kept = np.repeat([magnitude, 1j * phase], decades.size), Once(latest=2)

    def circuit(omega: np.ndarray, z: np.ndarray, p: np.ndarray):
        slopes = kept.get(omega.tobytes(), lambda: np.tile(_bells(omega, decades), 2) * scales)
        gain = np.exp(slopes @ p)
        return z * gain, gain, (z * gain)[:, None] * slopes

    names = [f"{kind}_1e{decade:.0f}" for kind in ("magnitude", "phase") for decade in decades]
    return (
        Effect(
            name=INSTRUMENT,
            sentence="the instrument has an error of magnitude and phase, within its stated accuracy",
            parameters=tuple(
                EffectParameter(name, "1", -20.0, 20.0, 1.0, 1.0, optional=True, tolerance=1.0) for name in names
            ),
            circuit=circuit,
            outward=np.inf,
        ),
    )
