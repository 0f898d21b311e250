"""The rational model of a piezoelectric one-port: poles, residues and a smooth background in one function."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.polynomial import chebyshev

NEWTON_STEPS = 6
#: Background, of charges of the order of 1, that stands for one of zero.
_NOTHING = 1e-30
#: Least number of polynomials of a sweep that are computed at once and cached.
_DEGREES = 16


@dataclass(frozen=True)
class FrequencyAxis:
    """Maps ω to the normalised variable x = (ω² − center)/half_width, x ∈ [−1, 1] over the sweep.

    In ω² the λ of eq 14 is a simple pole for constant complex moduli (hysteretic loss). It is one for viscous loss
    too: 1/(ω₁² − ω² + jωγ) has its pole at ω² = −p², and √ω² is smooth elsewhere in the sweep, so that the mirror
    image −p* and the frequency dependence of the loss are background.

    Attributes
    ----------
    center, half_width : rad²/s²
    """

    center: float
    half_width: float

    @classmethod
    def of(cls, omega: np.ndarray) -> FrequencyAxis:
        """The axis that spans the sweep `omega` (n,) rad/s."""
        low, high = float(omega[0]) ** 2, float(omega[-1]) ** 2
        return cls((low + high) / 2, (high - low) / 2)

    def x(self, omega: np.ndarray) -> np.ndarray:
        """Normalised variable of (real or complex) ω."""
        return (omega**2 - self.center) / self.half_width

    def eigenvalue(self, x: np.ndarray | complex) -> np.ndarray:
        """λ, rad²/s², of normalised positions x."""
        return self.center + self.half_width * np.asarray(x)


@dataclass(frozen=True)
class RationalModel:
    """Y/(jω) = scale · [ Σ_m r_m/(z_m − x) + Σ_k b_k T_k(x) ], all of z, r, b complex.

    Attributes
    ----------
    axis : the normalised frequency variable x
    scale : farad, the size of Y/(jω)
    poles : (M,) z_m, poles in x; Im z > 0 for a lossy mode
    residues : (M,) r_m
    background : (d+1,) Chebyshev coefficients b_k: clamped capacitance and every mode outside the sweep
    """

    axis: FrequencyAxis
    scale: float
    poles: np.ndarray
    residues: np.ndarray
    background: np.ndarray

    def normalised(self, axis: FrequencyAxis, scale: float) -> RationalModel:
        """The same modes over another axis and scale; the background keeps its coefficients, to be fitted there."""
        return replace(
            self,
            axis=axis,
            scale=scale,
            poles=axis.x(np.sqrt(self.axis.eigenvalue(self.poles))),
            residues=self.residues * (self.scale / scale * self.axis.half_width / axis.half_width),
        )

    @property
    def parameters(self) -> np.ndarray:
        """(2M + d + 1,) complex: poles, residues, background."""
        return np.concatenate([self.poles, self.residues, self.background])

    @property
    def linear(self) -> np.ndarray:
        """(M + d + 1,) complex: residues, background, in which the charge is linear."""
        return np.concatenate([self.residues, self.background])

    @property
    def size(self) -> int:
        """Number of complex parameters."""
        return 2 * self.poles.size + self.background.size

    def with_parameters(self, theta: np.ndarray) -> RationalModel:
        """The model with other values of its parameters, (2M + d + 1,) complex, ordered as `parameters`."""
        m = self.poles.size
        return RationalModel(self.axis, self.scale, theta[:m], theta[m : 2 * m], theta[2 * m :])

    def charge(self, x: np.ndarray) -> np.ndarray:
        """The bracket, Y/(jω·scale), at normalised positions x (n,), real or complex."""
        modes = (1 / (self.poles - np.asarray(x)[..., None])) @ self.residues
        return modes + _series(x, self.background)

    def charge_slope(self, x: np.ndarray) -> np.ndarray:
        """d charge / dx."""
        modes = (self.residues / (self.poles - np.asarray(x)[..., None]) ** 2).sum(axis=-1)
        return modes + chebyshev.chebval(x, chebyshev.chebder(self.background))

    def log_slope(self, x: np.ndarray) -> np.ndarray:
        """∂ log Z/∂ log ω at normalised positions x (n,)."""
        stretch = 2 * self.axis.eigenvalue(x) / self.axis.half_width
        return -1 - stretch * self.charge_slope(x) / self.charge(x)

    def linear_jacobian(self, x: np.ndarray) -> np.ndarray:
        """(n, M + d + 1) ∂charge/∂linear at x (n,): 1/(z_m − x), then T_k(x)."""
        m = self.poles.size
        found = np.empty((x.size, m + self.background.size), dtype=complex)
        found[:, :m] = 1 / (self.poles - x[:, None])
        found[:, m:] = _polynomials(x, self.background.size).T
        return found

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """(n, 2M + d + 1) exact ∂charge/∂parameters (holomorphic, so complex numbers suffice)."""
        linear = self.linear_jacobian(np.asarray(x))
        return np.concatenate([-self.residues * linear[:, : self.poles.size] ** 2, linear], axis=1)

    def admittance(self, omega: np.ndarray) -> np.ndarray:
        """Y(ω), siemens."""
        return 1j * omega * self.scale * self.charge(self.axis.x(omega))

    def zeros(self) -> np.ndarray:
        """Every root of the charge function in x: the zeros of Y, physical and spurious, unsorted.

        With w_m = T_0/(z_m − x) a root x is an eigenvalue, and (T_0 … T_{d−1}, w) its vector, of

            x T_0 = T_1,    x T_k = (T_{k−1} + T_{k+1})/2,    x w_m = z_m w_m − T_0,
            x T_{d−1} = T_{d−2}/2 − (Σ_{k<d} b_k T_k + Σ_m r_m w_m)/(2 b_d),    d > 1

        and x T_0 = −(b_0 T_0 + Σ_m r_m w_m)/b_1 for d = 1, x w_m = z_m w_m + Σ_n r_n w_n/b_0 for d = 0. Newton steps on
        the charge function itself polish the roots: a polynomial over all poles would lose them in its rounding.
        """
        b, m = np.trim_zeros(self.background, "b"), self.poles.size
        d = b.size - 1
        if d < 1:
            whole = b[0] if b.size else _NOTHING
            return self._polished(np.linalg.eigvals(np.diag(self.poles) + self.residues / whole))
        matrix = np.zeros((d + m, d + m), dtype=complex)
        matrix[:d, :d] = (np.eye(d, k=1) + np.eye(d, k=-1)) / 2
        matrix[0, :d] *= 2  # T_1 = x T_0
        first = 2 * b[d] if d > 1 else b[d]
        matrix[d - 1, :d] -= b[:d] / first
        matrix[d - 1, d:] = -self.residues / first
        matrix[d:, d:], matrix[d:, 0] = np.diag(self.poles), -1.0
        return self._polished(np.linalg.eigvals(matrix))

    def _polished(self, roots: np.ndarray) -> np.ndarray:
        """Roots (n,) after Newton steps; a root from which the steps lead away stays where it was."""
        x, approaching = roots.astype(complex), np.ones(roots.size, dtype=bool)
        for _ in range(NEWTON_STEPS):
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                step = self.charge(x) / self.charge_slope(x)
            approaching &= np.isfinite(step) & (np.abs(step) <= 0.5 * np.abs(x - roots) + 0.1)
            x = np.where(approaching, x - step, roots)
        return x

    def zero_derivative(self, x: complex) -> np.ndarray:
        """(2M + d + 1,) dx/dparameters of a zero at x, by implicit differentiation of charge(x) = 0."""
        return -self.jacobian(np.array([x]))[0] / complex(self.charge_slope(np.array(x)))


def _series(x: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Σ b_k T_k at x (…), real or complex."""
    if _is_sweep(x):
        return coefficients @ _polynomials(x, coefficients.size)
    return chebyshev.chebval(x, coefficients)


def _polynomials(x: np.ndarray, count: int) -> np.ndarray:
    """T_0 … T_(count−1) at x (n,) as (count, n); cached for the points of a sweep."""
    if _is_sweep(x):
        return _kept_polynomials(x.tobytes(), max(count, _DEGREES))[:count]
    return chebyshev.chebvander(x, count - 1).T


def _is_sweep(x: np.ndarray) -> bool:
    return isinstance(x, np.ndarray) and x.ndim == 1 and x.size > 1 and x.dtype == float


@lru_cache(maxsize=4)
def _kept_polynomials(x: bytes, count: int) -> np.ndarray:
    return np.array(chebyshev.chebvander(np.frombuffer(x), count - 1).T, dtype=complex, order="C")
