"""Maximum-likelihood fit of the whole impedance curve in the free complex constants.

Residual: log Z_model − log Z_measured in units of the relative noise, complex; for relative noise this is the
log-likelihood to first order, and it stays well shaped far from the solution. The Jacobian is exact:
∂log Z/∂θ = −(1/Y) ∂Y/∂c_q ∂c_q/∂θ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from femu_piezo.errors import ConvergenceError
from femu_piezo.forward.reduction import ReducedModel
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.updating.parameters import FreeConstants

#: Range of each real part relative to its start, and of each loss tangent.
_SCALE_RANGE, _TANGENT_RANGE = (0.2, 5.0), (-0.2, 1.0)


@dataclass(frozen=True)
class CurveFit:
    """Outcome of a curve fit.

    Attributes
    ----------
    theta : (n,) complex free constants
    covariance : (2n, 2n) over (Re θ_1, Im θ_1, …), SI; scaled by the reduced χ² where the noise was not known
    reduced_chi_square : Σ|residual|² / degrees of freedom, in the noise given
    evaluations : model evaluations
    """

    theta: np.ndarray
    covariance: np.ndarray
    reduced_chi_square: float
    evaluations: int


def _complex(x: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """(a_1, tan_1, a_2, …) → θ = scale · a (1 − j tan)."""
    return scale * x[0::2] * (1 - 1j * x[1::2])


def _slopes(x: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """(n, 2n) complex ∂θ/∂x."""
    slopes = np.zeros((scale.size, x.size), dtype=complex)
    index = np.arange(scale.size)
    slopes[index, 2 * index] = scale * (1 - 1j * x[1::2])
    slopes[index, 2 * index + 1] = -1j * scale * x[0::2]
    return slopes


def fit_curve(
    reduced: ReducedModel,
    free: FreeConstants,
    spectrum: ImpedanceSpectrum,
    relative_noise: np.ndarray | float,
    start: np.ndarray,
    *,
    noise_known: bool = True,
) -> CurveFit:
    """Fit the free constants to a sweep.

    Parameters
    ----------
    relative_noise : standard deviation of the complex relative error, scalar or (k,)
    start : (n,) complex θ
    noise_known : False scales the covariance by the misfit reached

    Raises
    ------
    ConvergenceError : the optimiser does not converge, or ends on the border of the physical range
    """
    scale = np.array(start.real)
    omega, log_data = spectrum.omega, np.log(spectrum.impedance)
    weight = 1 / np.broadcast_to(np.asarray(relative_noise, float), omega.shape) * np.sqrt(2.0)

    def residual(x: np.ndarray) -> np.ndarray:
        modal = reduced.modal(free.constants(_complex(x, scale)).to_e_form())
        difference = -np.log(modal.admittance(omega)) - log_data
        difference.imag = (difference.imag + np.pi) % (2 * np.pi) - np.pi
        return np.concatenate([difference.real * weight, difference.imag * weight])

    def jacobian(x: np.ndarray) -> np.ndarray:
        theta = _complex(x, scale)
        modal = reduced.modal(free.constants(theta).to_e_form())
        relative = -modal.admittance_jacobian(omega)[:, :10] / modal.admittance(omega)[:, None]
        slopes = (relative @ (free.e_form_jacobian(theta) @ _slopes(x, scale))) * weight[:, None]
        return np.concatenate([slopes.real, slopes.imag])

    x0 = np.stack([np.ones(scale.size), -start.imag / start.real], axis=1).ravel()
    bounds = np.tile([_SCALE_RANGE, _TANGENT_RANGE], (scale.size, 1)).T
    solution = least_squares(residual, x0, jacobian, bounds=bounds, x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12)
    if solution.status <= 0 or np.any(solution.active_mask):
        raise ConvergenceError(
            f"the curve fit did not end inside the physical range ({solution.message.rstrip('.')}): check dimensions, "
            "density and poling, or start from a closer base material"
        )
    freedom = 2 * omega.size - x0.size
    reduced_chi_square = float(2 * solution.cost / freedom)
    normal = np.linalg.inv(solution.jac.T @ solution.jac) * (1.0 if noise_known else reduced_chi_square)
    slopes = _slopes(solution.x, scale)
    real = np.empty((2 * scale.size, x0.size))
    real[0::2], real[1::2] = slopes.real, slopes.imag
    return CurveFit(_complex(solution.x, scale), real @ normal @ real.T, reduced_chi_square, int(solution.nfev))


def rms_log_error(model: np.ndarray, data: np.ndarray) -> float:
    """Root mean square of |log Z_model − log Z_data| over a sweep, dimensionless."""
    return float(np.sqrt(np.mean(np.abs(np.log(model / data)) ** 2)))
