"""What the accuracy of the instrument allows: Z' = Z exp(g(ω) + jφ(ω)) with smooth errors of magnitude and phase.

Both are Gaussian processes over log10 f with the accuracies of the specimen file (`accuracy`, `phase_accuracy`) as
standard deviations and a correlation length of one decade: an instrument's error changes slowly with frequency. Each
process is the sum of a few of its principal components (Karhunen-Loève), whose coefficients have unit variance.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter

#: Correlation length, decades, and components: the next would hold less than 1e-3 of the variance of a 4-decade sweep.
_LENGTH, _COMPONENTS = 1.0, 6
#: Points in log10 f on which the components are found.
_POINTS = 65


def _components(band_Hz: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Points (p,) in log10 f, and components (p, n) of unit-variance coefficients for a process of variance one."""
    low, high = np.log10(band_Hz)
    at = np.linspace(low - 0.05, high + 0.05, _POINTS)
    kernel = np.exp(-0.5 * ((at[:, None] - at) / _LENGTH) ** 2)
    values, vectors = np.linalg.eigh(kernel)
    return at, vectors[:, ::-1][:, :_COMPONENTS] * np.sqrt(np.maximum(values[::-1][:_COMPONENTS], 0.0))


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """Present where an accuracy is known; never a cause, since beyond its accuracy an instrument may err in any way."""
    magnitude, phase = (context.tolerances.get(name, 0.0) for name in ("accuracy", "phase_accuracy"))
    if magnitude == 0 and phase == 0:
        return ()
    at, components = _components(context.band_Hz)
    scales = np.repeat([magnitude, 1j * phase], _COMPONENTS)

    def circuit(omega: np.ndarray, z: np.ndarray, p: np.ndarray):
        own = np.array([np.interp(np.log10(omega / (2 * np.pi)), at, column) for column in components.T]).T
        slopes = np.hstack([own, own]) * scales
        gain = np.exp(slopes @ p)
        return z * gain, gain, (z * gain)[:, None] * slopes

    names = [f"{kind}_{number}" for kind in ("magnitude", "phase") for number in range(_COMPONENTS)]
    return (
        Effect(
            name="instrument",
            sentence="the instrument's error of magnitude and phase, within its accuracy",
            parameters=tuple(
                EffectParameter(name, "1", -20.0, 20.0, 1.0, 1.0, optional=True, tolerance=1.0) for name in names
            ),
            circuit=circuit,
        ),
    )
