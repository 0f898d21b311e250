"""One joint fit of material and effects to a sweep, with everything that comparing fits needs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares

from femu_piezo.errors import ConvergenceError
from femu_piezo.inference.blocks import Prior
from femu_piezo.inference.joint import JointParameters
from femu_piezo.inference.response import Evaluation

#: Excess of χ², in its standard deviations, from which what is left has structure.
_STRUCTURED = 3.0
#: Contiguous bands of the leave-band-out prediction.
_BANDS = 10
#: Least ratio of the true variance of the noise to an estimated one.
LEAST_SCALE = 0.4
#: Distance to a bound, relative to its range, that a start keeps.
_MARGIN = 1e-6
#: Relative gain of a step below which a coarse fit stops, and its most steps; the same of a close fit.
_COARSE, _CLOSE = (1e-3, 15), (1e-7, 60)


@dataclass(frozen=True)
class SweepData:
    """The sweep that fits may see.

    Attributes
    ----------
    impedance : (k,) measured Z, ohm
    relative_noise : (k,) sqrt(E|δZ/Z|²)
    noise_known : whether it came with the data (else it was estimated from the sweep alone)
    prior : prior knowledge of the free constants
    sizes : points of each sweep where there are several, one after another
    """

    impedance: np.ndarray
    relative_noise: np.ndarray
    noise_known: bool
    prior: Prior
    sizes: tuple[int, ...] = ()

    @property
    def sweeps(self) -> list[np.ndarray]:
        """Indices of the points of each sweep."""
        return np.split(np.arange(self.impedance.size), np.cumsum(self.sizes)[:-1])

    @property
    def weight(self) -> np.ndarray:
        """(k,) √2/σ of the relative noise."""
        return np.sqrt(2.0) / self.relative_noise

    def bands(self, count: int = _BANDS) -> list[np.ndarray]:
        """Indices of the points of contiguous bands, so many of each sweep."""
        return [part for sweep in self.sweeps for part in np.array_split(sweep, count)]

    def select(self, keep: np.ndarray) -> SweepData:
        """The points where `keep` (bool, or indices in order) says so."""
        kept = np.arange(self.impedance.size)[keep]
        sizes = tuple(int(np.count_nonzero(np.isin(sweep, kept))) for sweep in self.sweeps) if self.sizes else ()
        return replace(self, impedance=self.impedance[kept], relative_noise=self.relative_noise[kept], sizes=sizes)


@dataclass(frozen=True)
class JointFit:
    """A fit of the material with some effects.

    Attributes
    ----------
    x : (n_x,) solution
    residual : (2k,) whitened (log Z_model − log Z)/σ, Re then Im
    jacobian : (2k, n_x) of the data;  prior_jacobian : (m, n_x) of the priors
    prior_residual : (m,) of the priors
    on_bound : names of the unknowns that ended on a bound
    law_misses : (m, 2k) whitened errors that approximate laws may have made, each one standard deviation
    """

    parameters: JointParameters
    x: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    prior_jacobian: np.ndarray
    prior_residual: np.ndarray
    on_bound: tuple[str, ...]
    data: SweepData
    law_misses: np.ndarray | None = None

    @property
    def chi_square(self) -> float:
        """Σ residual² of data and prior."""
        return float(self.residual @ self.residual + self.prior_residual @ self.prior_residual)

    @property
    def log_error(self) -> np.ndarray:
        """(k,) complex log Z_model − log Z."""
        k = self.residual.size // 2
        return (self.residual[:k] + 1j * self.residual[k:]) / self.data.weight

    @property
    def freedom(self) -> int:
        """Residuals minus unknowns."""
        return self.residual.size - self.x.size

    @property
    def excess(self) -> float:
        """χ² beyond what noise gives."""
        return self.chi_square - self.freedom

    @property
    def structured(self) -> bool:
        """Whether it leaves more than noise."""
        return self._is_structure(self.excess)

    def _is_structure(self, excess: float) -> bool:
        return excess > _STRUCTURED * np.sqrt(2 * self.freedom)

    @property
    def excess_beyond_law(self) -> float:
        """χ² beyond what noise and errors of approximate laws give, with the unknowns refitted; by linearisation."""
        if self.law_misses is None:
            return self.excess
        count, unknowns = self.law_misses.shape[0], self.x.size
        misses = np.concatenate([self.law_misses.T, np.zeros((self.prior_residual.size, count))])
        whole = np.block(
            [
                [np.concatenate([self.jacobian, self.prior_jacobian]), misses],
                [np.zeros((count, unknowns)), np.eye(count)],
            ]
        )
        residual = np.concatenate([self.residual, self.prior_residual, np.zeros(count)])
        span = np.linalg.svd(whole, full_matrices=False)[0]
        left = residual - span @ (span.T @ residual)
        return float(left @ left) - self.freedom

    @property
    def noise_scale(self) -> float:
        """Factor on the noise that the misfit asks for; at least 1."""
        return float(np.sqrt(max(1.0, self.chi_square / self.freedom)))

    @property
    def bic(self) -> float:
        """χ² + k ln n where the noise is known; smaller is better.

        Where it is estimated its scale is profiled, n ln s² + χ²/s² + k ln n, but not below what the estimate can be
        wrong by: misfit below the noise is no evidence.
        """
        n, price = self.residual.size, self.x.size * np.log(self.residual.size)
        if self.data.noise_known:
            return self.chi_square + price
        square = max(self.chi_square / n, LEAST_SCALE)
        return float(n * np.log(square) + self.chi_square / square + price)

    @cached_property
    def covariance(self) -> np.ndarray:
        """(n_x, n_x), scaled by the misfit; with what errors of approximate laws move, and what single bands decide.

        The last, the delete-a-band jackknife, only where more is left than noise and laws explain: there neighbouring
        residuals err alike, and the first counts them as many.
        """
        left, singular, rotation = self._decomposed
        found = self.noise_scale**2 * (rotation.T / singular**2) @ rotation
        moved = np.zeros((0, self.residual.size))
        if self.law_misses is not None:
            moved = self.law_misses
        if self._is_structure(self.excess_beyond_law):
            moved = np.concatenate([moved, self._band_pulls()])
        along = rotation.T @ ((left[: self.residual.size].T @ moved.T) / singular[:, None])
        return found + along @ along.T

    @cached_property
    def _decomposed(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Singular value decomposition of data and priors."""
        return np.linalg.svd(np.concatenate([self.jacobian, self.prior_jacobian]), full_matrices=False)

    def _band_pulls(self) -> np.ndarray:
        """(bands, 2k) residuals by which each band pulls the unknowns, of the delete-a-band jackknife (linear)."""
        found = []
        for rows, unseen in self._left_out(_BANDS):
            pull = np.zeros(self.residual.size)
            pull[rows] = unseen
            found.append(pull)
        return np.sqrt(1 - 1 / len(found)) * np.array(found)

    def _left_out(self, bands: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """(rows of the residual, their values for the fit that did not see them) of each band of each sweep."""
        k = self.residual.size // 2
        basis = self._decomposed[0][: 2 * k]
        for points in self.data.bands(bands):
            rows = np.concatenate([points, points + k])
            hat = basis[rows] @ basis[rows].T
            yield rows, np.linalg.lstsq(np.eye(rows.size) - hat, self.residual[rows], rcond=1e-10)[0]

    @property
    def std(self) -> np.ndarray:
        """(n,) standard deviations of the unknowns."""
        return np.sqrt(np.diag(self.covariance))

    def predicted(self, bands: int = _BANDS) -> np.ndarray:
        """(k,) complex whitened error of each point as predicted by a fit that did not see its band of its sweep.

        Linear: (I − H_bb)^-1 r_b with the hat matrix H = J (JᵗJ)^-1 Jᵗ.
        """
        k = self.residual.size // 2
        found = np.empty(2 * k)
        for rows, unseen in self._left_out(bands):
            found[rows] = unseen
        return found[:k] + 1j * found[k:]

    @cached_property
    def held_out_score(self) -> float:
        """rms of the leave-band-out prediction, in σ: about 1 for a right model."""
        return float(np.sqrt(np.mean(np.abs(self.predicted()) ** 2) / 2))

    @cached_property
    def left_out_misfit(self) -> float:
        """rms of the leave-band-out prediction over what noise makes of it, which is more than the noise: 1 if right.

        The prediction has the covariance (I − H_bb)^-1, so r_bᵗ (I − H_bb)^-1 r_b is a χ².
        """
        squares = [self.residual[rows] @ unseen for rows, unseen in self._left_out(_BANDS)]
        return float(np.sqrt(np.sum(squares) / self.residual.size))

    def unseen_misfit(self, error: np.ndarray, slopes: np.ndarray) -> float:
        """rms error of points that the fit did not see, over what noise there and in the unknowns makes of it.

        Parameters
        ----------
        error : (m,) whitened real residuals;  slopes : (m, n_x) of them in the unknowns
        """
        spread = np.eye(error.size) + slopes @ self.covariance @ slopes.T
        return float(np.sqrt(error @ np.linalg.solve(spread, error) / error.size))


def with_law_misses(evaluation: Evaluation, fit: JointFit) -> JointFit:
    """The fit with the errors that the approximate laws of its effects may have made.

    In each band of each sweep by itself, an effect may change log Z by more or less than its law says: by the
    `law_error` of its size, as a share.
    """
    found, columns = [], [fit.parameters.columns(index) for index in range(len(fit.parameters.effects))]
    whole = evaluation.impedance(fit.parameters, fit.x)
    for effect, own in zip(fit.parameters.effects, columns, strict=True):
        share = effect.parameters[0].law_error
        if share == 0:
            continue
        x = fit.x.copy()
        x[own] = effect.rest / effect.scale
        change = share * np.log(whole / evaluation.impedance(fit.parameters, x)) * fit.data.weight
        for points in fit.data.bands():
            row = np.zeros_like(change)
            row[points] = change[points]
            found.append(np.concatenate([row.real, row.imag]))
    return replace(fit, law_misses=np.array(found)) if found else fit


def whitened(
    evaluation: Evaluation, data: SweepData, parameters: JointParameters, x: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Residual (2k,) = (log Z_model − log Z)/σ as Re, Im, and its Jacobian (2k, n_x)."""
    z, tangents = evaluation.with_jacobian(parameters, x)
    difference = np.log(z / data.impedance) * data.weight
    slopes = tangents / z[:, None] * data.weight[:, None]
    return (
        np.concatenate([difference.real, difference.imag]),
        np.concatenate([slopes.real, slopes.imag]),
    )


class _Problem:
    """Residual and Jacobian of data and priors, the last evaluation kept."""

    def __init__(self, evaluation: Evaluation, data: SweepData, parameters: JointParameters) -> None:
        self._evaluation, self._data, self._parameters = evaluation, data, parameters
        self._x: np.ndarray | None = None

    def evaluate(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual (2k + m,) and Jacobian (2k + m, n_x), the m rows of the priors last."""
        if self._x is None or not np.array_equal(x, self._x):
            self._x = x.copy()
            residual, jacobian = whitened(self._evaluation, self._data, self._parameters, x)
            material = self._parameters.material
            own = x[: 2 * material.scale.size]
            rows = np.zeros((len(self._data.prior.values), x.size))
            rows[:, : own.size] = self._data.prior.jacobian(material, own)
            pull, slopes = self._parameters.prior(x)
            self._last = (
                np.concatenate([residual, self._data.prior.residual(material, own), pull]),
                np.concatenate([jacobian, rows, slopes]),
            )
        return self._last

    def residual(self, x: np.ndarray) -> np.ndarray:
        return self.evaluate(x)[0]

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        return self.evaluate(x)[1]


def linear_fit(
    evaluation: Evaluation, data: SweepData, parameters: JointParameters, x: np.ndarray, moving: np.ndarray
) -> JointFit:
    """What one Gauss-Newton step from x (n_x,) promises: step, residuals and Jacobian by linearisation.

    moving : indices of the unknowns that may move
    """
    residual, jacobian = _Problem(evaluation, data, parameters).evaluate(x)
    return linearised(data, parameters, x, residual, jacobian, moving)


def linearised(
    data: SweepData,
    parameters: JointParameters,
    x: np.ndarray,
    residual: np.ndarray,
    jacobian: np.ndarray,
    moving: np.ndarray,
) -> JointFit:
    """`linear_fit` of residual (2k + m,) and Jacobian (2k + m, n_x) at x (n_x,), the m rows of the priors last."""
    norm = np.linalg.norm(jacobian[:, moving], axis=0)
    norm[norm == 0] = 1.0
    step = np.zeros(x.size)
    step[moving] = np.linalg.lstsq(jacobian[:, moving] / norm, -residual, rcond=1e-9)[0] / norm
    return _joint_fit(data, parameters, x + step, residual + jacobian @ step, jacobian, np.zeros(x.size))


def _joint_fit(data, parameters: JointParameters, x, residual, jacobian, active) -> JointFit:
    rows = 2 * data.impedance.size
    return JointFit(
        parameters=parameters,
        x=x,
        residual=residual[:rows],
        jacobian=jacobian[:rows],
        prior_jacobian=jacobian[rows:],
        prior_residual=residual[rows:],
        on_bound=tuple(parameters.names[i] for i in np.flatnonzero(active)),
        data=data,
    )


def fit_joint(
    evaluation: Evaluation,
    data: SweepData,
    parameters: JointParameters,
    starts: Sequence[np.ndarray],
    *,
    coarse: bool = False,
) -> JointFit:
    """The best of coarse fits from several starts (n_x,), brought to its end.

    coarse : leave it there, for candidates that are only to be ranked

    Raises ConvergenceError where none settles.
    """
    problem = _Problem(evaluation, data, parameters)
    found = [_least_squares(problem, parameters, start, *_COARSE) for start in starts]
    best = min((one for one in found if one.status >= 0), key=lambda one: one.cost, default=None)
    if best is not None and not coarse:
        best = _least_squares(problem, parameters, best.x, *_CLOSE)
    if best is None:
        raise ConvergenceError(
            f"no fit of {', '.join(parameters.names)} settled: check dimensions, density and poling, or free fewer "
            "constants"
        )
    return _joint_fit(data, parameters, best.x, best.fun, best.jac, best.active_mask)


def _least_squares(problem: _Problem, parameters: JointParameters, start: np.ndarray, tolerance: float, most: int):
    """A fit from x (n_x,) until a step gains less than a share of χ², of at most so many steps."""
    lower, upper = parameters.bounds.T
    margin = _MARGIN * (upper - lower)
    return least_squares(
        problem.residual,
        np.clip(start, lower + margin, upper - margin),
        problem.jacobian,
        bounds=(lower, upper),
        x_scale="jac",
        xtol=tolerance,
        ftol=tolerance,
        gtol=1e-9,
        max_nfev=most,
    )
