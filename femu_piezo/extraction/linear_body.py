"""Misfit of the best linear body to a sweep, whatever its shape, constants, electrodes and leads."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from femu_piezo.measurement.spectrum import ImpedanceSpectrum

#: Losses of the resonances from which fits start.
_LOSSES = (0.001, 0.003, 0.01, 0.03)
#: Upper bounds of (end of the sweep / resonance above it)² and of the loss of that resonance.
_NEAREST, _LOSSIEST = 0.98, 0.1
#: Most steps of one fit.
_STEPS = 100


def linear_body_misfit(
    spectrum: ImpedanceSpectrum, poles_Hz: Sequence[float], relative_noise: np.ndarray | None = None
) -> float:
    """rms misfit of the best C(ω) = Y/(jω) = a + b ω² + Σ_k r_k/(λ_k − ω²) + r/(λ − ω²), all numbers complex.

    Any linear body with these resonances λ_k in the sweep has this form; one resonance λ above the sweep stands for all
    beyond. A misfit that a simulation shares with this function is not due to its constants or to an effect that keeps
    the body linear, provided that this function follows the simulation itself, which is a linear body too.

    Parameters
    ----------
    poles_Hz : where the resonances are, roughly
    relative_noise : (k,) sqrt(E|δZ/Z|²); the result is the rms of |ΔC/C| over it, 1 for noise alone, or of |ΔC/C|
        where None

    Raises
    ------
    ValueError : no pole is given
    """
    if not len(poles_Hz):
        raise ValueError("a linear body needs a resonance; give at least one pole")
    near = float(np.median(poles_Hz))
    x = (spectrum.frequency / near) ** 2
    weight = np.ones(x.size) if relative_noise is None else 1 / np.asarray(relative_noise)
    relative = weight / (spectrum.admittance / (1j * spectrum.omega))
    places = (np.asarray(poles_Hz) / near) ** 2

    def misfit(u: np.ndarray) -> np.ndarray:
        """(2k,) Re, Im of the error of C over its noise for poles u; a, b, r_k, r by linear least squares."""
        *poles, (near_end, loss) = u.reshape(-1, 2)
        above = 1 / (1 - near_end * (1 - 1j * loss) * x / x.max())
        resonances = [1 / (place * (real + 1j * imag) - x) for place, (real, imag) in zip(places, poles, strict=True)]
        parts = relative[:, None] * np.column_stack([np.ones_like(x), x - 1, *resonances, above])
        parts /= np.linalg.norm(parts, axis=0)
        error = parts @ np.linalg.lstsq(parts, weight.astype(complex), rcond=None)[0] - weight
        return np.concatenate([error.real, error.imag])

    free = np.full(2 * places.size, np.inf)
    bounds = ([*-free, 0.0, 0.0], [*free, _NEAREST, _LOSSIEST])
    starts = ([*places.size * [1.0, loss], 0.5, loss] for loss in _LOSSES)
    cost = min(least_squares(misfit, start, bounds=bounds, x_scale="jac", max_nfev=_STEPS).cost for start in starts)
    return float(np.sqrt(2 * cost / x.size))
