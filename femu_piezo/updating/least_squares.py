"""Maximum-likelihood fit of any list of data blocks by bounded nonlinear least squares (scipy, trust region)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from femu_piezo.errors import ConvergenceError
from femu_piezo.threads import blas_limit
from femu_piezo.updating.data import DataBlock
from femu_piezo.updating.parameters import Estimate, MaterialParameters, estimates

#: Spacing of the tangent bounds from a solution that still counts as inside.
_NEAR_BOUND = 1e-6


@dataclass(frozen=True)
class Fit:
    """Solution of a fit.

    Attributes
    ----------
    parameters : the map of the unknowns
    x : (2n,) solution
    jacobian : (k, 2n) whitened Jacobian there
    residual : (k,) whitened residual there
    noise_scale : factor on the standard deviations: 1 where the noise was known, else sqrt of the reduced χ²
    evaluations : model evaluations
    groups : (k,) label of each residual; residuals of one label may be correlated. None: all independent
    """

    parameters: MaterialParameters
    x: np.ndarray
    jacobian: np.ndarray
    residual: np.ndarray
    noise_scale: float
    evaluations: int
    groups: np.ndarray | None = None

    @property
    def theta(self) -> np.ndarray:
        """(n,) complex free constants."""
        return self.parameters.theta(self.x)

    @property
    def freedom(self) -> int:
        """Residuals minus unknowns."""
        return self.residual.size - self.x.size

    @property
    def reduced_chi_square(self) -> float:
        """Σ residual² / degrees of freedom; about 1 for a right model and a right noise."""
        return float(self.residual @ self.residual / self.freedom)

    @property
    def covariance(self) -> np.ndarray:
        """(2n, 2n) over x: noise_scale² (JᵗJ)^-1, or where groups are given the larger sandwich estimate.

        Sandwich (Liang and Zeger 1986): (JᵗJ)^-1 [G/(G−1) Σ_g (J_gᵗr_g)(J_gᵗr_g)ᵗ] (JᵗJ)^-1 over G groups. It needs
        no model of the correlation, and is used where a misfit smooth in frequency shows that the error is one.
        """
        _, singular, rotation = np.linalg.svd(self.jacobian, full_matrices=False)
        inverse = (rotation.T / singular**2) @ rotation
        plain = self.noise_scale**2 * inverse
        if self.groups is None:
            return plain
        labels = np.unique(self.groups)
        scores = np.array([self.jacobian[self.groups == g].T @ self.residual[self.groups == g] for g in labels])
        robust = labels.size / (labels.size - 1) * inverse @ (scores.T @ scores) @ inverse
        growth = np.sqrt(np.maximum(1.0, np.diag(robust) / np.diag(plain)))
        return plain * np.outer(growth, growth)

    @property
    def theta_covariance(self) -> np.ndarray:
        """(2n, 2n) over (Re θ_1, Im θ_1, …), SI."""
        return self.parameters.theta_covariance(self.x, self.covariance)

    @property
    def estimates(self) -> dict[str, Estimate]:
        """Free constant → value, tangent and their standard deviations."""
        names = self.parameters.free.names
        return dict(zip(names, estimates(self.theta, self.theta_covariance), strict=True))


def fit(
    blocks: Sequence[DataBlock],
    parameters: MaterialParameters,
    start: np.ndarray,
    *,
    noise_known: bool = True,
    loss: str = "linear",
) -> Fit:
    """Minimise the sum of squared whitened residuals of all blocks.

    Parameters
    ----------
    start : (n,) complex θ
    noise_known : False scales the covariance by the misfit reached
    loss : "linear", or a robust loss of scipy ("soft_l1", "huber", "cauchy") against outliers

    Raises
    ------
    ConvergenceError : the optimiser does not settle, or ends on the border of the physical range
    """

    def residual(x: np.ndarray) -> np.ndarray:
        return np.concatenate([block.residual(parameters, x) for block in blocks])

    def jacobian(x: np.ndarray) -> np.ndarray:
        return np.concatenate([block.jacobian(parameters, x) for block in blocks])

    lower, upper = parameters.bounds.T
    x0 = np.clip(parameters.x_of(start), lower + _NEAR_BOUND, upper - _NEAR_BOUND)
    with blas_limit():
        solution = least_squares(
            residual,
            x0,
            jacobian,
            bounds=(lower, upper),
            x_scale="jac",
            loss=loss,
            xtol=1e-12,
            ftol=1e-12,
            gtol=1e-12,
            max_nfev=200,
        )
    stuck = [parameters.names[i] for i in np.flatnonzero(solution.active_mask)]
    if solution.status <= 0 or stuck:
        where = f"; {', '.join(stuck)} ended on the border of the physical range" if stuck else ""
        raise ConvergenceError(
            f"the fit did not settle ({solution.message.rstrip('.')}){where}: check dimensions, density and poling, "
            "free fewer constants, or give a prior for those the data do not determine"
        )
    if not noise_known and solution.fun.size <= x0.size:
        raise ConvergenceError("the fit has no more data than unknowns, so the noise cannot be learned: give the noise")
    return Fit(
        parameters=parameters,
        x=solution.x,
        jacobian=solution.jac,
        residual=solution.fun,
        noise_scale=1.0 if noise_known else float(np.sqrt(2 * solution.cost / (solution.fun.size - x0.size))),
        evaluations=int(solution.nfev),
    )
