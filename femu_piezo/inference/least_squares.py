"""Maximum-likelihood fit of any list of data blocks by bounded nonlinear least squares (scipy, trust region)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from femu_piezo.errors import ConvergenceError
from femu_piezo.inference.blocks import DataBlock
from femu_piezo.inference.unknowns import Estimate, MaterialParameters, estimates
from femu_piezo.threads import blas_limit

#: Spacing of the tangent bounds from a solution that still counts as inside.
_NEAR_BOUND = 1e-6
#: Standard deviations of χ² beyond which data miss the model by more than their noise.
_BEYOND = 6.0


@dataclass(frozen=True)
class Fit:
    """Solution of a fit.

    Attributes
    ----------
    parameters : the map of the unknowns
    x : (2n,) solution
    jacobian : (k, 2n) whitened Jacobian there, rows of data in units of the noise reached
    residual : (k,) whitened residual there, likewise
    noise_scale : misfit of the data in units of the noise given, where that was not known or is exceeded; else 1
    block_scales : noise_scale for every block of data, 1 for priors and walls
    evaluations : model evaluations
    groups : (k,) label of each residual; residuals of one label may be correlated. None: all independent
    """

    parameters: MaterialParameters
    x: np.ndarray
    jacobian: np.ndarray
    residual: np.ndarray
    noise_scale: float
    evaluations: int
    block_scales: tuple[float, ...] = ()
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
        """Σ residual² / degrees of freedom in the noise given; about 1 for a right model and a right noise."""
        return float(self.noise_scale**2 * (self.residual @ self.residual) / self.freedom)

    @property
    def covariance(self) -> np.ndarray:
        """(2n, 2n) over x: (JᵗJ)^-1, or where groups are given the larger sandwich estimate.

        Sandwich (Liang and Zeger 1986): (JᵗJ)^-1 [G/(G−1) Σ_g (J_gᵗr_g)(J_gᵗr_g)ᵗ] (JᵗJ)^-1 over G groups. It needs
        no model of the correlation, and is used where a misfit smooth in frequency shows that the error is one.
        """
        _, singular, rotation = np.linalg.svd(self.jacobian, full_matrices=False)
        inverse = (rotation.T / singular**2) @ rotation
        if self.groups is None:
            return inverse
        labels = np.unique(self.groups)
        scores = np.array([self.jacobian[self.groups == g].T @ self.residual[self.groups == g] for g in labels])
        robust = labels.size / (labels.size - 1) * inverse @ (scores.T @ scores) @ inverse
        growth = np.sqrt(np.maximum(1.0, np.diag(robust) / np.diag(inverse)))
        return inverse * np.outer(growth, growth)

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

    Where the noise of the data is not known, or the data miss the model by more than it (χ² beyond six of its
    standard deviations), the data are weighed by the misfit reached and the fit is made again: priors keep their
    weight, and the intervals tell of the error there is.

    Parameters
    ----------
    start : (n,) complex θ
    noise_known : whether the noise of the data blocks is trusted where they reach it
    loss : "linear", or a robust loss of scipy ("soft_l1", "huber", "cauchy") against outliers, for every row

    Raises
    ------
    ConvergenceError : the optimiser does not settle, or ends on the border of the physical range
    """
    scales = np.ones(len(blocks))
    solution = _minimise(blocks, parameters, parameters.x_of(start), scales, loss)
    noise_scale = _misfit(blocks, parameters, solution.x, loss, noise_known)
    evaluations = solution.nfev
    if noise_scale != 1.0:
        scales = np.array([noise_scale if block.measured else 1.0 for block in blocks])
        solution = _minimise(blocks, parameters, solution.x, scales, loss)
        evaluations += solution.nfev
    return Fit(
        parameters=parameters,
        x=solution.x,
        jacobian=_stacked("jacobian", blocks, parameters, solution.x, scales),
        residual=_stacked("residual", blocks, parameters, solution.x, scales),
        noise_scale=noise_scale,
        evaluations=int(evaluations),
        block_scales=tuple(float(scale) for scale in scales),
    )


def _stacked(what: str, blocks, parameters: MaterialParameters, x: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Residuals or Jacobians of all blocks below one another, each over its scale."""
    return np.concatenate(
        [getattr(block, what)(parameters, x) / scale for block, scale in zip(blocks, scales, strict=True)]
    )


def _minimise(blocks, parameters: MaterialParameters, x0: np.ndarray, scales: np.ndarray, loss: str):
    lower, upper = parameters.bounds.T
    with blas_limit():
        solution = least_squares(
            lambda x: _stacked("residual", blocks, parameters, x, scales),
            np.clip(x0, lower + _NEAR_BOUND, upper - _NEAR_BOUND),
            lambda x: _stacked("jacobian", blocks, parameters, x, scales),
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
    return solution


def _misfit(blocks, parameters: MaterialParameters, x: np.ndarray, loss: str, noise_known: bool) -> float:
    """Misfit of the data blocks in units of their noise; 1 where that noise is known and not exceeded."""
    rows = [block.residual(parameters, x) for block in blocks if block.measured]
    residual = np.concatenate(rows) if rows else np.zeros(0)
    freedom = residual.size - x.size
    if freedom <= 0:
        if not noise_known:
            raise ConvergenceError(
                "the fit has no more data than unknowns, so the noise cannot be learned: give the noise"
            )
        return 1.0
    robust = np.median(np.abs(residual)) / 0.6745  # of a normal distribution, blind to outliers
    scale = float(robust if loss != "linear" else np.sqrt(residual @ residual / freedom))
    exceeded = scale**2 > 1 + _BEYOND * np.sqrt(2 / freedom)
    return scale if exceeded or not noise_known else 1.0
