"""Maximum-likelihood fit of a `RationalModel` to a sweep, in units of the noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import matmul_toeplitz
from scipy.optimize import least_squares

from femu_piezo.extraction.model import FrequencyAxis, RationalModel

# Relative size below which a residual is the rounding of double precision and no evidence for anything
ROUNDING = 1e-11


@dataclass(frozen=True)
class SweepData:
    """A sweep in the variables of the fit.

    Attributes
    ----------
    axis : normalised frequency axis
    x : (n,) normalised frequency
    charge : (n,) Y/(jω·scale), dimensionless
    scale : farad; negative where most readings have a negative conductance (reversed terminals)
    weight : (n,) 1/(relative standard deviation of the complex impedance); only its shape matters for the
        search, its size for the covariance
    """

    axis: FrequencyAxis
    x: np.ndarray
    charge: np.ndarray
    scale: float
    weight: np.ndarray

    @classmethod
    def of(cls, omega: np.ndarray, admittance: np.ndarray, weight: np.ndarray, squared: bool) -> SweepData:
        """Normalise Y (n,) S over ω (n,) rad/s; `scale` carries the sign of the conductance."""
        axis = FrequencyAxis.of(omega, squared)
        charge = admittance / (1j * omega)
        scale = float(np.median(np.abs(charge)) * np.sign(np.median(admittance.real)))
        return cls(axis, axis.x(omega), charge / scale, scale, np.asarray(weight, float))

    def __len__(self) -> int:
        return self.x.size


@dataclass(frozen=True)
class Fit:
    """A fitted model with its misfit.

    Attributes
    ----------
    model : the model
    residual : (n,) complex, weight · (Z_data/Z_model − 1): the misfit of Z in units of its noise
    misfit : Σ|residual|²
    """

    model: RationalModel
    residual: np.ndarray
    misfit: float

    @property
    def degrees_of_freedom(self) -> int:
        """2n real data minus the real parameters."""
        return 2 * (self.residual.size - self.model.size)

    @property
    def scale(self) -> float:
        """rms residual per degree of freedom: 1 where the noise is known and the model is right."""
        return float(np.sqrt(2 * self.misfit / self.degrees_of_freedom))


def residual(model: RationalModel, data: SweepData) -> np.ndarray:
    """(n,) complex weight · (Z_data/Z_model − 1) = weight · (charge_model/charge_data − 1).

    To first order in the noise the relative errors of Z and of Y = 1/Z are the same, so one residual serves
    the poles of Y and the poles of Z alike and the fit is the joint maximum-likelihood estimate of both.
    """
    return data.weight * (model.charge(data.x) / data.charge - 1)


def fit(model: RationalModel, data: SweepData, tolerance: float = 1e-10, max_evaluations: int = 60) -> Fit:
    """Levenberg-Marquardt (MINPACK) over all parameters with the exact Jacobian.

    The model is holomorphic in its complex parameters: the real Jacobian is [[Re J, −Im J], [Im J, Re J]].
    """
    row = (data.weight / data.charge)[:, None]
    size = model.size

    def unpack(theta: np.ndarray) -> RationalModel:
        return model.with_parameters(theta[:size] + 1j * theta[size:])

    def misfit(theta: np.ndarray) -> np.ndarray:
        r = residual(unpack(theta), data)
        return np.concatenate([r.real, r.imag])

    def jacobian(theta: np.ndarray) -> np.ndarray:
        jac = row * unpack(theta).jacobian(data.x)
        return np.block([[jac.real, -jac.imag], [jac.imag, jac.real]])

    start = np.concatenate([model.parameters.real, model.parameters.imag])
    solution = least_squares(
        misfit, start, jacobian, method="lm", x_scale="jac", ftol=tolerance, xtol=tolerance, gtol=1e-15,
        max_nfev=max_evaluations,
    )  # fmt: skip
    return _as_fit(unpack(solution.x), data)


def solve_linear(model: RationalModel, data: SweepData) -> Fit:
    """Residues and background by linear least squares, poles held."""
    m = model.poles.size
    columns = (data.weight / data.charge)[:, None] * model.jacobian(data.x)[:, m:]
    linear = np.linalg.lstsq(columns, data.weight.astype(complex), rcond=None)[0]
    return _as_fit(model.with_parameters(np.concatenate([model.poles, linear])), data)


def correlation(residual: np.ndarray) -> tuple[complex, float]:
    """First-order autoregression of a residual (n,): φ by Burg (1967), |φ| ≤ 1, and the innovation.

    φ = 2 Σ r_i r*_{i−1} / Σ (|r_i|² + |r_{i−1}|²). The innovation Σ|r_i − φ r_{i−1}|² is scaled by n/(n − 1) to
    stand beside Σ|r_i|².
    """
    before, after = residual[:-1], residual[1:]
    power = float(np.sum(np.abs(before) ** 2 + np.abs(after) ** 2))
    phi = complex(2 * np.sum(after * before.conj()) / power) if power > 0 else 0j
    innovation = float(np.sum(np.abs(after - phi * before) ** 2))
    return phi, innovation * residual.size / (residual.size - 1)


def covariance_factor(model: RationalModel, data: SweepData, phi: complex = 0j) -> np.ndarray:
    """(p, p) complex F with F Fᴴ = E[δθ δθᴴ] of the complex parameters, for residual variance E|r|² = 1.

    F Fᴴ is the inverse Fisher matrix (JᴴJ)⁻¹: the Cramér-Rao bound for this model class, with the complex
    residues and the complex background coefficients as nuisance parameters. For circular noise
    E[δθ δθ] = 0, so the real covariance of (Re θ, Im θ) follows from it (`real_covariance`).

    With a correlated residual, E[r_i r*_j] = φ^(i−j), the same estimate has the covariance
    (JᴴJ)⁻¹ JᴴΣJ (JᴴJ)⁻¹ (the "sandwich" of Huber 1967 and White 1982), wider than the bound.
    """
    jac = (data.weight / data.charge)[:, None] * model.jacobian(data.x)
    size = np.linalg.norm(jac, axis=0)
    q, r = np.linalg.qr(jac / size)
    factor = np.linalg.inv(r) / size[:, None]
    if phi == 0:
        return factor
    power = phi ** np.arange(len(data))
    return factor @ np.linalg.cholesky(q.conj().T @ matmul_toeplitz((power, power.conj()), q))


def real_covariance(hermitian: np.ndarray) -> np.ndarray:
    """(2k, 2k) covariance over (Re, Im) pairs from the (k, k) hermitian one of circular complex errors."""
    k = hermitian.shape[0]
    out = np.empty((2 * k, 2 * k))
    out[0::2, 0::2] = out[1::2, 1::2] = hermitian.real / 2
    out[1::2, 0::2] = hermitian.imag / 2
    out[0::2, 1::2] = -hermitian.imag / 2
    return out


def _as_fit(model: RationalModel, data: SweepData) -> Fit:
    r = residual(model, data)
    return Fit(model, r, float(np.sum(np.abs(r) ** 2)))
