"""The Cramér-Rao bound of poles and zeros, from exact functions alone (nothing of the code under test).

Model class of the bound: Y/(jω) = Σ_m R_m/(λ_m − s) + Σ_k b_k T_k(x), s = ω², with the λ_m and R_m inside the
sweep, relative circular noise of known level ε on Y (the same on Z). Nuisance parameters: every complex R_m and
the complex b_0 … b_d. The degree d is the smallest for which leaving out the rest of the true background moves
no λ and no zero by more than a tenth of its bound: the bound knows as much physics as the class, not more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev


@dataclass(frozen=True)
class Truth:
    """A one-port with exactly known poles and zeros.

    charge : function of ω, Y/(jω); poles, residues, zeros : of the modes inside the sweep, in λ and R
    """

    charge: object
    poles: tuple[complex, ...]
    residues: tuple[complex, ...]
    zeros: tuple[complex, ...]


@dataclass(frozen=True)
class Bound:
    """sqrt(E|δλ|²) of each pole and zero, rad²/s², and the background degree of the class."""

    poles: np.ndarray
    zeros: np.ndarray
    degree: int


def cramer_rao(truth: Truth, frequency, relative: float, max_degree: int = 14) -> Bound:
    """The bound for a sweep at `frequency` (n,) Hz with relative complex noise `relative` (sqrt(E|ε|²))."""
    omega = 2 * np.pi * np.asarray(frequency)
    s, q = omega**2, truth.charge(omega)
    x = (2 * s - s[0] - s[-1]) / (s[-1] - s[0])
    poles, residues = np.array(truth.poles), np.array(truth.residues)
    background = q - (residues / (poles - s[:, None])).sum(axis=1)
    for degree in range(max_degree + 1):
        columns = np.hstack(
            [-residues / (poles - s[:, None]) ** 2, 1 / (poles - s[:, None]), chebyshev.chebvander(x, degree)]
        )
        jac = columns / (q[:, None] * relative)
        size = np.linalg.norm(jac, axis=0)
        basis, upper = np.linalg.qr(jac / size)
        factor = np.linalg.inv(upper) / size[:, None]
        zero_rows = np.array([_zero_gradient(truth, zero, s, degree) for zero in truth.zeros])
        std = np.linalg.norm(factor[: poles.size], axis=1)
        zero_std = np.linalg.norm(zero_rows @ factor, axis=1)
        # bias by the part of the background that degree d cannot follow, to first order
        rest = (
            background
            - columns[:, 2 * poles.size :]
            @ np.linalg.lstsq(columns[:, 2 * poles.size :] / q[:, None], background / q, rcond=None)[0]
        )
        shift = factor @ (basis.conj().T @ (rest / (q * relative)))
        rest_at = np.array([_rest_at(truth, zero, s, degree, background, q) for zero in truth.zeros])
        zero_shift = zero_rows @ shift - rest_at
        if np.all(np.abs(shift[: poles.size]) < 0.1 * std) and np.all(np.abs(zero_shift) < 0.1 * zero_std):
            return Bound(std, zero_std, degree)
    raise ValueError(f"no background degree up to {max_degree} represents the truth at noise {relative:g}")


def _slope(truth: Truth, at: complex) -> complex:
    """∂(Y/(jω))/∂s at s = `at`."""
    step = 1e-5 * at
    return (truth.charge(np.sqrt(at + step)) - truth.charge(np.sqrt(at - step))) / (2 * step)


def _zero_gradient(truth: Truth, zero: complex, s, degree: int):
    """Derivatives of a zero in all parameters of the model class."""
    poles, residues = np.array(truth.poles), np.array(truth.residues)
    x = (2 * zero - s[0] - s[-1]) / (s[-1] - s[0])
    row = np.concatenate(
        [-residues / (poles - zero) ** 2, 1 / (poles - zero), chebyshev.chebvander(np.array([x]), degree)[0]]
    )
    return -row / _slope(truth, zero)


def _rest_at(truth: Truth, zero: complex, s, degree: int, background, q) -> complex:
    """Shift of a zero by the part of the background at the zero that the polynomial does not represent."""
    x = (2 * s - s[0] - s[-1]) / (s[-1] - s[0])
    at = (2 * zero - s[0] - s[-1]) / (s[-1] - s[0])
    columns = chebyshev.chebvander(x, degree)
    coefficients = np.linalg.lstsq(columns / q[:, None], background / q, rcond=None)[0]
    poles, residues = np.array(truth.poles), np.array(truth.residues)
    exact = truth.charge(np.sqrt(zero)) - np.sum(residues / (poles - zero))
    return -(exact - chebyshev.chebval(at, coefficients)) / _slope(truth, zero)


@dataclass(frozen=True)
class Score:
    """Errors of one resonance over many draws, against its bound.

    rms : rms |δλ| / bound; median : median |δλ| / bound, 0.83 for Gaussian errors at the bound;
    bias : |mean| of Re and of Im in units of the bound's std of that part;
    cover68, cover95 : share of Re and Im inside the stated 68 % and 95 % intervals, nan without covariance
    """

    rms: float
    median: float
    bias: float
    cover68: float
    cover95: float


def score(errors, deviations, bound: float) -> Score:
    """errors (n,) complex δλ, deviations (n, 2) stated std of Re and Im (or None), bound sqrt(E|δλ|²)."""
    errors = np.asarray(errors)
    part = bound / np.sqrt(2)
    bias = max(abs(errors.real.mean()), abs(errors.imag.mean())) / part
    rms = float(np.sqrt(np.mean(np.abs(errors) ** 2)) / bound)
    median = float(np.median(np.abs(errors)) / bound)
    if deviations is None:
        return Score(rms, median, float(bias), float("nan"), float("nan"))
    scaled = np.abs(np.column_stack([errors.real, errors.imag]) / np.asarray(deviations))
    return Score(rms, median, float(bias), float(np.mean(scaled < 0.99446)), float(np.mean(scaled < 1.95996)))
