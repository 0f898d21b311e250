"""Errors of the parameters of a fit: due to noise alone, or also to a systematic error smooth in frequency."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from femu_piezo.extraction.fit import NormalisedSweep
from femu_piezo.extraction.model import RationalModel
from femu_piezo.measurement.discrepancy import Discrepancy, learn_discrepancy, profiled
from femu_piezo.measurement.discrepancy_forms import Alternatives, matern, smooth
from femu_piezo.measurement.sweeps import SweepData, noise_memory, stacked

SHARES = (0.0, 1.0)  # of the variance that is due to errors of frequency: none, or all
_UNKNOWN = 1e100  # deviation of a parameter on which no point depends; its square is finite


@dataclass(frozen=True)
class Spread:
    """Second moments of the errors of p complex parameters.

    Attributes
    ----------
    factor : (p, q) complex F. Circular: F Fᴴ = E[δθ δθᴴ] and E[δθ δθᵀ] = 0, as white circular noise gives.
        Otherwise the columns are a sample: E over the columns of any product of Re and Im parts
    circular : whether F is of the first kind
    """

    factor: np.ndarray = field(repr=False)
    circular: bool

    def size(self, gradient: np.ndarray) -> float:
        """sqrt(E|δ|²) of δ = gradient · δθ."""
        return float(np.linalg.norm(gradient @ self.factor))

    def covariance(self, gradients: np.ndarray) -> np.ndarray:
        """(2k, 2k) real covariance over (Re, Im) pairs of δ = gradients · δθ, gradients (k, p) (delta method)."""
        moved = gradients @ self.factor
        if not self.circular:
            parts = np.empty((2 * moved.shape[0], moved.shape[1]))
            parts[0::2], parts[1::2] = moved.real, moved.imag
            return parts @ parts.T
        hermitian = moved @ moved.conj().T
        out = np.empty((2 * hermitian.shape[0],) * 2)
        out[0::2, 0::2] = out[1::2, 1::2] = hermitian.real / 2
        out[1::2, 0::2] = hermitian.imag / 2
        out[0::2, 1::2] = -hermitian.imag / 2
        return out


def fisher_spread(model: RationalModel, data: NormalisedSweep, scale: float = 1.0) -> Spread:
    """scale²·(JᴴJ)⁻¹, the Cramér-Rao bound where `scale` is the rms of the residual (1: weights are true).

    The bound is for this model class: the complex residues and the complex background coefficients are nuisance
    parameters. J is complex because the model is holomorphic; circular noise gives circular errors. A pole whose
    residue is 0, on which no point depends, has the deviation `_UNKNOWN`.
    """
    jac = (data.weight / data.charge)[:, None] * model.jacobian(data.x)
    size = np.linalg.norm(jac, axis=0)
    shown = size > 0
    factor = np.diag(np.where(shown, 0.0, _UNKNOWN)).astype(complex)
    inverse = np.linalg.inv(np.linalg.qr(jac[:, shown] / size[shown])[1])
    factor[np.ix_(shown, shown)] = scale * inverse / size[shown, None]
    return Spread(factor, circular=True)


def errors_about(model: RationalModel, data: NormalisedSweep, sweep: SweepData) -> list[Alternatives]:
    """The systematic errors of log Z that compete: Gaussian processes over frequency, of the lengths of `smooth`.

    Their kernel (Matérn, 3/2) is no smoother than the errors of instruments. The processes of one fit serve for all
    fits that are near it.

    Parameters
    ----------
    sweep : the points of `data`, with the noise estimated from neighbouring points
    """
    return list(smooth(sweep, model.log_slope(data.x), shares=SHARES, kernel=matern))


def systematic_error(
    model: RationalModel, data: NormalisedSweep, sweep: SweepData, errors: list[Alternatives]
) -> tuple[Discrepancy, float]:
    """The systematic error that a fit leaves in addition to noise, and the evidence of the fit with it.

    The evidence is the Bayesian information criterion, −2 log p(data) + k log(2n), less is better, with the discrepancy
    of log Z marginalised (`femu_piezo.measurement.discrepancy`).

    Parameters
    ----------
    sweep, errors : as of `errors_about`
    """
    residual = stacked((model.charge(data.x) / data.charge - 1) * sweep.weight)
    found = learn_discrepancy(sweep, residual, np.zeros((residual.size, 0)), [errors])
    likelihood = profiled(float(residual @ residual), residual.size, sweep.level_std) + found.log_evidence
    return found, float(-2 * likelihood + 2 * model.size * np.log(2 * len(data)))


def systematic_spread(model: RationalModel, data: NormalisedSweep, sweep: SweepData, error: Discrepancy) -> Spread:
    """Second moments of the errors of the parameters of a fit that leaves a systematic error in addition to noise.

    The parameters are off by A = (JᴴW²J)⁻¹JᴴW² times the relative errors of Z, J = ∂ log charge/∂θ and W the weights of
    the fit: cov = A (N + K) Aᴴ, N the covariance of the noise and K that of the systematic error.
    """
    response, k = _response(model, data), len(data)
    level = error.level / sweep.weight
    smooth = (error.columns[:k] + 1j * error.columns[k:]) * level[:, None]
    noise = response * level
    return Spread(np.hstack([noise, 1j * noise, response @ smooth]), circular=False)


def correlated_spread(model: RationalModel, data: NormalisedSweep, sweep: SweepData) -> Spread | None:
    """Second moments of the errors of the parameters of a fit that leaves noise with correlated neighbours.

    A N Aᴴ with A as in `systematic_spread`, N = L Lᵗ that of an autoregression. None where the residual is no such
    noise. The fit follows a part of it: of 401 points with a correlation of 0.9 between neighbours the deviations are
    up to 1.3 times too small, of 0.7 they are right.
    """
    residual = (model.charge(data.x) / data.charge - 1) / sweep.relative_noise
    memory, size = noise_memory(residual, model.size, sweep.noise_known)
    if not memory:
        return None
    return Spread(memory.coloured_transposed((_response(model, data) * size * sweep.relative_noise).T).T, circular=True)


def _response(model: RationalModel, data: NormalisedSweep) -> np.ndarray:
    """(p, k) A: changes of the parameters of a fit by relative errors of Z."""
    jacobian = model.jacobian(data.x) / data.charge[:, None]
    size = np.linalg.norm(jacobian, axis=0)
    q, upper = np.linalg.qr(data.weight[:, None] * jacobian / size)
    return np.linalg.solve(upper, q.conj().T) * data.weight / size[:, None]
