"""Least-squares fit of a `RationalModel` to a sweep in units of its noise: maximum likelihood."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.linalg import lapack

from femu_piezo.extraction.model import FrequencyAxis, RationalModel
from femu_piezo.measurement.spectrum import evenly
from femu_piezo.threads import made_once

# Relative size below which a residual is rounding and no evidence
ROUNDING = 1e-10
# Relative size of a residual that is finer than any instrument
UNSEEN = 1e-7
_ALIKE = 1e-7  # sine of the angle between a column and the span of those before it, below which it depends on them
_HOPE = 10.0  # bound on the further fall of the misfit, over that of the last step or of the linearised problem
MAX_DAMPING = 1e6  # damping at which steps are so short that a misfit which they do not lower is at its minimum


@dataclass(frozen=True)
class NormalisedSweep:
    """A sweep in the variables of the fit.

    Attributes
    ----------
    axis : normalised frequency axis
    x : (n,) normalised frequency
    charge : (n,) Y/(jω·scale), dimensionless
    scale : farad; negative where most readings have a negative conductance (reversed terminals)
    weight : (n,) 1/(relative standard deviation of the complex impedance); only its shape matters for the
        search, its size for the covariance
    least : rms weighted residual below which a residual is no evidence
    """

    axis: FrequencyAxis
    x: np.ndarray
    charge: np.ndarray
    scale: float
    weight: np.ndarray
    least: float = 0.0

    @classmethod
    def of(cls, omega: np.ndarray, admittance: np.ndarray, weight: np.ndarray, least: float = 0.0) -> NormalisedSweep:
        """Normalise Y (n,) S over ω (n,) rad/s; `scale` carries the sign of the conductance."""
        axis = FrequencyAxis.of(omega)
        charge = admittance / (1j * omega)
        sign = -1.0 if np.median(admittance.real) < 0 else 1.0
        scale = float(np.median(np.abs(charge)) * sign)
        return cls(axis, axis.x(omega), charge / scale, scale, np.asarray(weight, float), least)

    def __len__(self) -> int:
        return self.x.size

    @made_once
    def negligible(self) -> float:
        """Σ|residual|² below which the residual is rounding or far below the noise."""
        return max(self.rounding, self.least**2 * len(self))

    @made_once
    def rounding(self) -> float:
        """Σ|residual|² of a residual of the relative size `ROUNDING`."""
        return ROUNDING**2 * float(np.sum(self.weight**2))

    @made_once
    def log_weight(self) -> float:
        """Σ ln weight²."""
        return float(np.sum(np.log(self.weight**2)))

    def thinned(self, most: int) -> NormalisedSweep:
        """At most `most` of the points, evenly spaced."""
        keep = evenly(len(self), most)
        return replace(self, x=self.x[keep], charge=self.charge[keep], weight=self.weight[keep])


@dataclass(frozen=True)
class Fit:
    """A fitted model with its misfit.

    Attributes
    ----------
    model : the model;  data : what it was fitted to
    residual : (n,) complex, weight · (charge_model/charge_data − 1): the misfit in units of the noise
    misfit : Σ|residual|²
    """

    model: RationalModel
    data: NormalisedSweep
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

    @made_once
    def evidence(self) -> float:
        """Bayesian information criterion, N ln(S/n) + k ln(N) · N/(N − k − 1) − 2 Σ ln weight²; less is better.

        N = 2n real data, k real parameters, S = Σ|r|²: −2 ln of the likelihood of the relative errors with the noise
        level profiled out, plus Schwarz's penalty with the small-sample factor of Hurvich and Tsai (1989).
        Here r = weight · ln(charge_model/charge_data), whose noise is the same however wrong the model is.
        S is no less than `negligible`: rounding, and what is far below a given noise, counts as noise.
        """
        data, n, k = self.data, len(self.data), 2 * self.model.size
        if k + 1 >= 2 * n:
            return np.inf
        misfit = _power(data.weight * np.log(1 + self.residual / data.weight))
        return 2 * n * np.log(max(misfit, data.negligible) / n) + penalty(k, n) - 2 * data.log_weight

    @made_once
    def is_visible(self) -> bool:
        """Whether the residual is not negligible, and some instrument could see it.

        More and more modes would follow every digit of a computed curve that is no rational function.
        """
        seen = np.mean(np.abs(self.residual / self.data.weight) ** 2) > UNSEEN**2
        return bool(seen and self.misfit > self.data.negligible)

    @made_once
    def is_correlated(self) -> bool:
        """Whether neighbouring residuals are visible and correlated beyond chance (1 in 10 000 white ones)."""
        phi = correlation(self.residual)
        return bool(self.is_visible and abs(phi) ** 2 * self.residual.size > np.log(1e4))


def penalty(k: int, n: int) -> float:
    """Penalty in the evidence of a fit of k real parameters to n complex data: N = 2n, k ln(N) · N/(N − k − 1)."""
    return k * np.log(2 * n) * 2 * n / (2 * n - k - 1)


@dataclass(frozen=True)
class _Trial:
    """A model that a fit tries.

    To first order in the noise the relative errors of Z and of Y = 1/Z are the same, so one residual serves the poles
    of Y and the poles of Z alike, and the fit is the joint maximum-likelihood estimate of both.

    Attributes
    ----------
    linear_jacobian : (n, M + d + 1) of the model at the points of the data
    residual : (n,) complex, weight · (Z_data/Z_model − 1) = weight · (charge_model/charge_data − 1)
    misfit : Σ|residual|²
    """

    model: RationalModel
    data: NormalisedSweep
    linear_jacobian: np.ndarray
    residual: np.ndarray
    misfit: float

    @classmethod
    def of(cls, model: RationalModel, data: NormalisedSweep, linear_jacobian: np.ndarray | None = None) -> _Trial:
        """linear_jacobian : that of the model where it is known, as of one with the same poles"""
        along = model.linear_jacobian(data.x) if linear_jacobian is None else linear_jacobian
        residual = data.weight * (along @ model.linear / data.charge - 1)
        return cls(model, data, along, residual, _power(residual))

    def triangle(self) -> np.ndarray:
        """(k + 1, k + 1) R of the QR factors of the Jacobian of the residual (n, k), and of the residual."""
        m, whole = self.model.poles.size, np.empty((len(self.data), self.model.size + 1), dtype=complex, order="F")
        whole[:, m:-1] = (self.data.weight / self.data.charge)[:, None] * self.linear_jacobian
        whole[:, :m] = -self.model.residues * self.linear_jacobian[:, :m] * whole[:, m : 2 * m]
        whole[:, -1] = self.residual
        return _triangle(whole)

    @property
    def fit(self) -> Fit:
        return Fit(self.model, self.data, self.residual, self.misfit)


def fit(
    model: RationalModel,
    data: NormalisedSweep,
    tolerance: float = 1e-4,
    max_steps: int = 60,
    least: float = np.inf,
) -> Fit:
    """Levenberg-Marquardt over all parameters with the exact Jacobian, in complex arithmetic.

    The model is holomorphic in its complex parameters, so the complex Gauss-Newton step −(JᴴJ + μD²)⁻¹Jᴴr is the
    real one, at a quarter of the work of (Re, Im) columns. D are the column norms of J; μ follows the share ρ of the
    promised fall of Σ|r|² that a step brought (Nielsen 1999, Damping parameter in Marquardt's method, IMM-REP-1999-05):
    times max(1/10, 1 − (2ρ − 1)³) after a step that lowers it, times 2, 4, 8, … after those that do not. The search
    ends where a step lowers Σ|r|² by less than `tolerance` (relative), or no step does. It is given up where Σ|r|² will
    stay above `least`, the most that is of use: where it exceeds `least` by more than `_HOPE` times the larger of the
    fall by the last step and the fall that the linearised problem still promises.
    """
    return _descended(_Trial.of(model, data), tolerance, max_steps, least).fit


def _descended(here: _Trial, tolerance: float, max_steps: int, least: float) -> _Trial:
    """`fit` from a trial."""
    size, damping, fall = here.model.size, 1e-3, 0.0
    for _ in range(max_steps):
        triangle = here.triangle()
        upper, target = triangle[:size, :size], -triangle[:size, size]
        if here.misfit - _HOPE * max(_power(target), fall) > least:
            break
        lower, growth = np.diag(np.linalg.norm(upper, axis=0)), 2.0
        while damping < MAX_DAMPING:
            step = _damped(upper, target, np.sqrt(damping) * lower)
            there = _Trial.of(here.model.with_parameters(here.model.parameters + step), here.data)
            if there.misfit < here.misfit:
                break
            damping, growth = damping * growth, 2 * growth
        else:
            break
        promised = _power(target) - _power(upper @ step - target)
        fall = here.misfit - there.misfit
        share = fall / promised if promised > 0 else 1.0
        damping *= max(0.1, 1 - (2 * share - 1) ** 3)
        before, here = here.misfit, there
        if fall < tolerance * before:
            break
    return here


def _damped(upper: np.ndarray, target: np.ndarray, lower: np.ndarray) -> np.ndarray:
    """(k,) least squares of upper (k, k) x = target (k,) and lower (k, k) x = 0.

    Where the system is singular, as with a column of zeros, the solution is that of least norm.
    """
    count = target.size
    system = np.zeros((2 * count, count + 1), dtype=complex, order="F")
    system[:count, :count], system[count:, :count], system[:count, count] = upper, lower, target
    triangle = _triangle(system.copy(order="F"))
    step, singular = lapack.ztrtrs(triangle[:count, :count], triangle[:count, count])
    return np.linalg.lstsq(system[:, :count], system[:, count], rcond=None)[0] if singular else step


def _triangle(matrix: np.ndarray) -> np.ndarray:
    """R (min(m, k), k) of the QR factors of a matrix (m, k), in Fortran's order, which is overwritten."""
    found = lapack.zgeqrf(matrix, overwrite_a=True)[0][: matrix.shape[1]]
    found[_below_diagonal(*found.shape)] = 0  # the reflectors of Q
    return found


@lru_cache(maxsize=64)
def _below_diagonal(rows: int, columns: int) -> np.ndarray:
    """(rows, columns) bool."""
    return np.tri(rows, columns, k=-1, dtype=bool)


def _power(r: np.ndarray) -> float:
    return float(np.vdot(r, r).real)


def solve_linear(model: RationalModel, data: NormalisedSweep) -> Fit:
    """The fit of residues and background by linear least squares, with the poles held fixed."""
    return _linear(model, data).fit


def _linear(model: RationalModel, data: NormalisedSweep) -> _Trial:
    """`solve_linear`, as a trial."""
    along = model.linear_jacobian(data.x)
    linear = _least_squares((data.weight / data.charge)[:, None] * along, data.weight.astype(complex))
    return _Trial.of(model.with_parameters(np.concatenate([model.poles, linear])), data, along)


def _least_squares(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(k,) solution of least norm of matrix (m, k) x = right (m,); by singular values where columns are dependent."""
    rows, count = matrix.shape
    size = np.linalg.norm(matrix, axis=0)
    if rows > count and np.all(size > 0):
        whole = np.empty((rows, count + 1), dtype=complex, order="F")
        whole[:, :count], whole[:, count] = matrix / size, right
        triangle = _triangle(whole)
        if np.min(np.abs(np.diag(triangle)[:count])) > _ALIKE:
            return lapack.ztrtrs(triangle[:count, :count], triangle[:count, count])[0] / size
    return np.linalg.lstsq(matrix, right, rcond=None)[0]


def refit(
    model: RationalModel,
    data: NormalisedSweep,
    tolerance: float = 1e-4,
    max_steps: int = 60,
    least: float = np.inf,
) -> Fit:
    """`fit` from the poles of a model alone: residues and background start from `solve_linear`."""
    linear = _linear(model, data)
    return (_descended(linear, tolerance, max_steps, least) if model.poles.size else linear).fit


def correlation(residual: np.ndarray) -> complex:
    """φ of neighbouring residuals (n,) by Burg (1967): 2 Σ r_i r*_{i−1} / Σ (|r_i|² + |r_{i−1}|²), |φ| ≤ 1."""
    before, after = residual[:-1], residual[1:]
    power = float(np.sum(np.abs(before) ** 2 + np.abs(after) ** 2))
    return complex(2 * np.sum(after * before.conj()) / power) if power > 0 else 0j
