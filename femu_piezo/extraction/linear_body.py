"""What the best linear body would leave of a sweep, whatever its shape, constants, electrodes and leads."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from femu_piezo.measurement.spectrum import ImpedanceSpectrum

#: Losses and shares of the capacitance that fits start from.
_LOSS, _SHARES, _STRENGTHS = 0.012, (0.5, 1.0, 2.0), (0.05, 0.2)


def linear_body_misfit(
    spectrum: ImpedanceSpectrum, poles_Hz: Sequence[float], relative_noise: np.ndarray | None = None
) -> float:
    """rms misfit of the best C(ω) = Y/(jω) = a + b ω² + c ω⁴ + Σ_k r_k/(λ_k − ω²), all numbers complex.

    So looks any linear body with these resonances in the sweep and all others well beyond it. What a simulation
    misses and this misses as well is no matter of its constants or of an effect that keeps the body linear.

    Parameters
    ----------
    poles_Hz : where the resonances are, roughly
    relative_noise : (k,) sqrt(E|δZ/Z|²); the result is |Δ log Z| over it, 1 for noise alone. Plain |Δ log Z| where None

    Raises
    ------
    ValueError : no pole is given
    """
    if not len(poles_Hz):
        raise ValueError("a linear body needs a resonance; give at least one pole")
    near = float(np.median(poles_Hz))
    x = (spectrum.frequency / near) ** 2
    capacitance = spectrum.admittance / (1j * spectrum.omega)
    capacitance = capacitance / np.median(np.abs(capacitance))
    weight = 1.0 if relative_noise is None else 1 / relative_noise

    def misfit(u: np.ndarray) -> np.ndarray:
        a, b, c, *rest = u[::2] + 1j * u[1::2]
        background = a + b * (x - 1) + c * (x - 1) ** 2
        modes = sum(r / (pole - x) for pole, r in zip(rest[::2], rest[1::2], strict=True))
        error = weight * np.log((background + modes) / capacitance)
        return np.concatenate([error.real, error.imag])

    places = (np.asarray(poles_Hz) / near) ** 2
    starts = (
        [share, -_LOSS, *4 * [0.0], *np.outer(places, [1.0, _LOSS, strength, 0.0]).ravel()]
        for share in _SHARES
        for strength in _STRENGTHS
    )
    cost = min(least_squares(misfit, start, x_scale="jac").cost for start in starts)
    return float(np.sqrt(2 * cost / x.size))
