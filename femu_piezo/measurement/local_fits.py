"""Local rational fits that leave points out or allow a step: how far a point is off its neighbours, how large the step.

In a short window an impedance is a rational function of low degree times noise. Fitted without the suspected points, it
predicts them with a standard deviation; the residual of the other points says whether the function describes the window
at all.

Every system is solved by a QR factorisation of the weighted matrix. Its normal equations would lose half of the digits,
and rounding would then decide what is a fault.
"""

from __future__ import annotations

import numpy as np

#: Linear fits, each weighted by the denominator of the one before, and Gauss-Newton steps after them.
_PASSES, _REFINEMENTS = 2, 5
#: Squarings of a matrix that find its dominant eigenvector (`_least_moved`).
_SQUARINGS = 6


def windows(size: int, centers: np.ndarray, width: int) -> np.ndarray:
    """(k, width) indices of windows about `centers` (k,), shifted into 0 … size − 1 at the ends."""
    start = np.clip(centers - width // 2, 0, size - width)
    return start[:, None] + np.arange(width)


def rational(
    frequency: np.ndarray, values: np.ndarray, weight: np.ndarray, degrees: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Weighted rational fits p/q to windows (k, w); points of weight 0 are predicted.

    Returns the fit (k, w) complex and its relative Jacobian ∂ log(p/q) / ∂ coefficients (k, w, n) complex.
    """
    powers = _powers(frequency, degrees)
    return _quotient(*powers, _linear_fit(*powers, values, weight))


def rational_values(
    frequency: np.ndarray, values: np.ndarray, weight: np.ndarray, degrees: tuple[int, int]
) -> np.ndarray:
    """The fits (k, w) of `rational` without their Jacobian."""
    powers = _powers(frequency, degrees)
    p, q = _numerator_and_denominator(*powers, _linear_fit(*powers, values, weight))
    return p / q


def _powers(frequency: np.ndarray, degrees: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Chebyshev polynomials of numerator and denominator (k, w, degree + 1) over each window."""
    x = frequency - frequency.mean(axis=1, keepdims=True)
    x = x / np.abs(x).max(axis=1, keepdims=True)
    powers = np.polynomial.chebyshev.chebvander(x, max(degrees))
    return powers[..., : degrees[0] + 1], powers[..., : degrees[1] + 1]


def _linear_fit(top: np.ndarray, bottom: np.ndarray, values: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(k, n) coefficients of p, then q, that make p/values − q small, weighted by 1/q of the pass before."""
    unit = np.exp(np.mean(np.log(np.abs(values)), axis=1, keepdims=True))  # ohm; p and q are then alike in size
    matrix = np.concatenate([top * (unit / values)[..., None], -bottom], axis=-1)
    scale = weight
    for _ in range(_PASSES):
        triangle = np.linalg.qr(matrix * scale[..., None], mode="r")
        null = _least_moved(triangle)
        q = _away_from_zero(np.einsum("kwi,ki->kw", bottom, null[:, top.shape[-1] :]))
        scale = weight / np.abs(q)
        scale = scale / scale.max(axis=1, keepdims=True)
    return np.concatenate([unit * null[:, : top.shape[-1]], null[:, top.shape[-1] :]], axis=1)


def _least_moved(triangle: np.ndarray) -> np.ndarray:
    """(k, n) unit vectors x with nearly the least |R x|, for triangles R (k, n, n).

    x is the dominant eigenvector of R⁻¹R⁻ᴴ, by repeated squaring. With s₁ < s₂ the least singular values of R, the
    direction of s₂ keeps a share (s₁/s₂)^(2·2^`_SQUARINGS`), which is large only where both serve equally well. The
    largest eigenvalue is the one that grows, so no digits are lost; of a matrix of trace 1 it is 1/n or more, and no
    power of it underflows.
    """
    inverse = _inverse(triangle)
    squared = inverse @ inverse.conj().transpose(0, 2, 1)
    squared /= np.einsum("kii->k", squared).real[:, None, None]
    for _ in range(_SQUARINGS):
        squared = squared @ squared
    most = np.argmax(np.einsum("kii->ki", squared).real, axis=1)
    found = squared[np.arange(len(squared)), :, most]
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def _inverse(triangle: np.ndarray) -> np.ndarray:
    """(k, n, n) R⁻¹ of triangles R, with pivots below rounding raised to it."""
    raised = triangle.copy()
    diagonal = np.einsum("kii->ki", raised)
    size = np.abs(diagonal)
    largest = size.max(axis=1, keepdims=True)
    least = np.finfo(float).eps * np.where(largest > 0, largest, 1.0)
    diagonal[...] = np.where(size < least, least, diagonal)
    return np.linalg.inv(raised)


def _quotient(top: np.ndarray, bottom: np.ndarray, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """p/q (k, w) and its relative Jacobian (k, w, n)."""
    p, q = _numerator_and_denominator(top, bottom, coefficients)
    return p / q, np.concatenate([top / p[..., None], -bottom / q[..., None]], axis=-1)


def _numerator_and_denominator(
    top: np.ndarray, bottom: np.ndarray, coefficients: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """p and q (k, w), nowhere zero."""
    p = np.einsum("kwi,ki->kw", top, coefficients[:, : top.shape[-1]])
    q = np.einsum("kwi,ki->kw", bottom, coefficients[:, top.shape[-1] :])
    return _away_from_zero(p), _away_from_zero(q)


def _away_from_zero(values: np.ndarray) -> np.ndarray:
    """Values (k, w), raised to 1e-12 of the largest of their window where smaller, so that none divides by zero."""
    size = np.abs(values)
    largest = size.max(axis=1, keepdims=True)
    floor = np.where(largest > 0, 1e-12 * largest, 1.0)
    return np.where(size < floor, floor, values)


def left_out(
    frequency: np.ndarray,
    impedance: np.ndarray,
    sigma: np.ndarray,
    trusted: np.ndarray,
    first: np.ndarray,
    count: np.ndarray,
    shape: tuple[int, tuple[int, int]],
) -> tuple[np.ndarray, np.ndarray]:
    """How far points are off the fit to their neighbours.

    Parameters
    ----------
    sigma : (n,) relative standard deviation of the impedance
    trusted : (n,) relative standard deviation by which the points of a fit are weighted
    first, count : (k,) each; case i leaves out the points first[i] … first[i] + count[i] − 1
    shape : (points of a window, (degree of numerator, of denominator))

    Returns
    -------
    distance : (k,) the least of the points left out, in standard deviations of point and prediction together
    rest : (k,) rms residual of the other points in standard deviations, 1 where the fit is good
    """
    width, degrees = shape
    index = windows(impedance.size, first + count // 2, width)
    out = (index >= first[:, None]) & (index < (first + count)[:, None])
    weight = np.where(out, 0.0, 1 / trusted[index])
    fit, jacobian = rational(frequency[index], impedance[index], weight, degrees)
    residual = np.log(impedance[index] / fit)
    change, root = _least_squares(jacobian, weight, residual)
    deviation = np.abs(residual - np.einsum("kwn,kn->kw", jacobian, change))
    spread = np.sum(np.abs(jacobian @ root) ** 2, axis=-1)  # variance of the fitted log Z
    rest = np.linalg.norm(deviation * weight, axis=1) / np.sqrt(width - count - (sum(degrees) + 1))
    distance = deviation / np.sqrt(sigma[index] ** 2 + spread)
    return np.where(out, distance, np.inf).min(axis=1), rest


def stepped(
    frequency: np.ndarray,
    impedance: np.ndarray,
    sigma: np.ndarray,
    after: np.ndarray,
    shape: tuple[int, tuple[int, int]],
    guess: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The step of log Z behind the points `after` (k,) that fits best.

    Parameters
    ----------
    guess : (k,) complex step from which the search starts; by default that between straight lines through both sides

    Returns
    -------
    step : (k,) complex, log of the factor by which the points behind are too large
    distance : (k,) its size in standard deviations
    rest : (k,) rms residual with the step, in standard deviations
    """
    if not after.size:
        return np.zeros(0, complex), np.zeros(0), np.zeros(0)
    width, degrees = shape
    index = windows(impedance.size, after + 1, width)
    behind = (index > after[:, None]).astype(float)
    z, weight = impedance[index], 1 / sigma[index]
    powers = _powers(frequency[index], degrees)
    start = _straight_step(z, behind) if guess is None else guess
    linear = _linear_fit(*powers, z * np.exp(-start[:, None] * behind), weight)
    unknowns, std, misfit = _refined(*powers, z, behind, weight, np.concatenate([linear, start[:, None]], axis=1))
    step = np.log(np.exp(unknowns[:, -1]))  # a whole turn of the phase is no step
    return step, np.abs(step) / std[:, 0], misfit[:, 0] / np.sqrt(width - (sum(degrees) + 2))


def _refined(top, bottom, values, behind, weight, unknowns) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unknowns (coefficients, step) of least residual, standard deviation of the step (k, 1), residual (k, 1).

    Gauss-Newton: the linear fit does not minimise the residual itself. Where a change does not lower it, a quarter is
    tried.
    """
    best = (unknowns, *_linearised(top, bottom, values, behind, weight, unknowns))
    share = np.ones((len(unknowns), 1))
    for _ in range(_REFINEMENTS):
        tried = best[0] + share * best[3]
        found = (tried, *_linearised(top, bottom, values, behind, weight, tried))
        better = found[2] < best[2]
        best = tuple(np.where(better, new, old) for new, old in zip(found, best, strict=True))
        share = np.where(better, 1.0, share / 4)
    return best[:3]


def _linearised(top, bottom, values, behind, weight, unknowns) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Standard deviation of the step (k, 1), norm of the residual (k, 1) and the change (k, n + 1) that lowers it."""
    fit, jacobian = _quotient(top, bottom, unknowns[:, :-1])
    residual = np.log(values * np.exp(-unknowns[:, -1:] * behind) / fit)
    change, root = _least_squares(np.concatenate([jacobian, behind[..., None]], axis=-1), weight, residual)
    change[:, -1] /= np.maximum(1, np.abs(change[:, -1]))  # no step grows by more than e at once
    std = np.linalg.norm(root[:, -1], axis=1, keepdims=True)
    return std, np.linalg.norm(residual * weight, axis=1, keepdims=True), change


def _least_squares(jacobian: np.ndarray, weight: np.ndarray, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Change (k, n) of the unknowns that explains a residual (k, w), and a root (k, n, n) of its covariance C = R Rᴴ.

    p and q may have a common factor, which no data determine. A prior therefore gives each unknown the standard
    deviation that changes log Z by 1 (rms over the window).
    """
    width, n = jacobian.shape[1:]
    rms = np.linalg.norm(jacobian, axis=1) / np.sqrt(width)
    rms = np.where(rms == 0, 1.0, rms)
    data = np.concatenate([jacobian, residual[..., None]], axis=-1) * weight[..., None]
    prior = np.concatenate([rms[:, None] * np.eye(n), np.zeros((len(rms), n, 1))], axis=-1)
    triangle = np.linalg.qr(np.concatenate([data, prior], axis=1), mode="r")
    root = np.linalg.inv(triangle[:, :n, :n])
    return np.einsum("kij,kj->ki", root, triangle[:, :n, -1]), root


def _straight_step(values: np.ndarray, behind: np.ndarray) -> np.ndarray:
    """(k,) first guess of the step: between the straight lines in log Z through the two points on either side."""
    last = np.argmax(behind > 0, axis=1) - 1
    rows, logs = np.arange(values.shape[0])[:, None], np.log(values)
    near = logs[rows, last[:, None] + np.arange(-1, 3)]
    turned = near.imag - near[:, :1].imag
    near = near.real + 1j * (near[:, :1].imag + (turned + np.pi) % (2 * np.pi) - np.pi)
    return (1.5 * near[:, 2] - 0.5 * near[:, 3]) - (1.5 * near[:, 1] - 0.5 * near[:, 0])
