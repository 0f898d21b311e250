"""The noise of a sweep as the fit uses it: from the file, or learned from the fit's own residual."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.extraction.fit import ROUNDING
from femu_piezo.measurement.noise import NoiseModel
from femu_piezo.measurement.spectrum import ImpedanceSpectrum

#: Most steps of the search for the noise of most likelihood, the longest in the logarithm of a variance, and the gain
#: in log likelihood, or the length of a step, below which the search ends; ratio of eigenvalues that counts as zero.
_STEPS, _LONGEST, _CLOSE, _SINGULAR = 60, 2.0, 1e-8, 1e-12


@dataclass(frozen=True)
class NoiseUsed(NoiseModel):
    """σ_Z(ω) = sqrt((relative·|Z|)² + additive²), the standard deviation of the complex impedance in the fit.

    Attributes
    ----------
    relative, additive : as in `NoiseModel`
    origin : "file" where the spectrum carried its noise (relative then is the median of σ_Z/|Z|, additive 0),
        "readings" where that was estimated from the roughness of S or of raw readings, "residual" where it was learned
        from the residual of the fit, "misfit" where that residual is more than noise: relative then is the rms misfit
        of the fit, and all points have equal relative weight
    """

    origin: Literal["file", "readings", "residual", "misfit"]

    @property
    def of_spectrum(self) -> bool:
        """Whether the spectrum carried it."""
        return self.origin in ("file", "readings")


def weight_of_file(spectrum: ImpedanceSpectrum) -> np.ndarray | None:
    """(n,) |Z|/σ_Z from the spectrum's own noise, None where it has none."""
    if spectrum.noise is None:
        return None
    if not (np.all(np.isfinite(spectrum.noise)) and np.all(spectrum.noise > 0)):
        raise InputError(f"{spectrum.source}: the noise must be positive at every point; leave it out if it is unknown")
    return np.abs(spectrum.impedance) / spectrum.noise


def noise_from_residual(error: np.ndarray, impedance: np.ndarray, parameters: int) -> NoiseUsed:
    """Relative and additive noise by maximum likelihood from the misfit of a model.

    Minimises Σ [ln σ_i² + |error_i|²/σ_i²], σ_i² = relative²|Z_i|² + additive², the negative log-likelihood
    of circular Gaussian errors. Relative noise alone is the default; additive noise, alone or together with it,
    has a penalty ln(2n). The level is corrected for the `parameters` complex parameters that were fitted to the data.

    Parameters
    ----------
    error : (n,) complex Z_data − Z_model, ohm
    impedance : (n,) complex model impedance, ohm
    """
    n = error.size
    power, level = np.abs(error) ** 2, np.abs(impedance) ** 2
    correction = n / (n - parameters)
    if np.mean(power / level) < ROUNDING**2:
        return NoiseUsed(float(np.sqrt(np.mean(power / level) * correction)), 0.0, "residual")
    parts = [(float(np.mean(power / level)), 0.0), (0.0, float(np.mean(power)))]
    costs = [
        2 * n * np.log(parts[0][0]) + 2 * np.sum(np.log(level)),
        2 * n * np.log(parts[1][1]) + np.log(2 * n),
    ]
    mixed, cost = _relative_and_additive(power, level, np.array([np.mean(power / level) / 2, np.median(power) / 2]))
    parts.append(mixed)
    costs.append(2 * cost - 2 * n + np.log(2 * n))
    relative, additive = parts[int(np.argmin(costs))]
    return NoiseUsed(float(np.sqrt(relative * correction)), float(np.sqrt(additive * correction)), "residual")


def _solved_of_two(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """x (2,) of least norm of a positive semidefinite matrix (2, 2) x = right (2,)."""
    (first, across), (_, second) = matrix.tolist()
    determinant, trace = first * second - across**2, first + second
    if determinant <= _SINGULAR * trace**2:  # λ v vᵗ, λ its trace
        return matrix @ right / trace**2
    return np.array([second * right[0] - across * right[1], first * right[1] - across * right[0]]) / determinant


def _relative_and_additive(
    power: np.ndarray, level: np.ndarray, start: np.ndarray
) -> tuple[tuple[float, float], float]:
    """Relative² and additive² that minimise Σ [ln v + power/v], v = relative² level + additive², and the least value.

    Fisher scoring in the logarithms of both, from those of `start` (2,); a step is quartered until it lowers the sum.
    """

    def at(logs: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """The sum, the additive share (n,) of every variance, and power over variance (n,), at the logarithms (2,)."""
        additive = np.exp(logs[1])
        variance = np.exp(logs[0]) * level + additive
        ratio = power / variance
        return float(np.sum(np.log(variance) + ratio)), additive / variance, ratio

    logs = np.log(start)
    here, share, ratio = at(logs)
    for _ in range(_STEPS):
        shares = np.array([1 - share, share])
        step = -_solved_of_two(shares @ shares.T, shares @ (1 - ratio))
        step /= max(1.0, float(np.max(np.abs(step))) / _LONGEST)
        while (there := at(logs + step))[0] > here and np.max(np.abs(step)) > _CLOSE:
            step = step / 4
        if there[0] > here:
            break
        gained, logs, (here, share, ratio) = here - there[0], logs + step, there
        if gained < _CLOSE:
            break
    return (float(np.exp(logs[0])), float(np.exp(logs[1]))), here
