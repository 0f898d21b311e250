"""Local rational fits that leave points out or allow a step: how far a point, or a side, is off its neighbours.

In a short window an impedance is a rational function of low degree times noise. Fitted without the suspects, it
predicts them; the prediction has a standard deviation, and what the other points leave over says whether the
function can describe the window at all.
"""

from __future__ import annotations

import numpy as np

_PASSES, _STEPS, _REFINEMENTS = 3, 3, 4
#: Ridge of the normal equations, relative: coefficients of p and q have a common factor that nothing fixes.
_RIDGE = 1e-8


def windows(size: int, centers: np.ndarray, width: int) -> np.ndarray:
    """(k, width) indices of windows about `centers`, moved inside where they would stand out."""
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


def _powers(frequency: np.ndarray, degrees: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Chebyshev polynomials of numerator and denominator (k, w, degree + 1) over each window."""
    x = frequency - frequency.mean(axis=1, keepdims=True)
    x = x / np.abs(x).max(axis=1, keepdims=True)
    powers = np.polynomial.chebyshev.chebvander(x, max(degrees))
    return powers[..., : degrees[0] + 1], powers[..., : degrees[1] + 1]


def _linear_fit(top: np.ndarray, bottom: np.ndarray, values: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(k, n) coefficients of p, then q, that make p/values − q small, weighted by 1/q of the pass before."""
    matrix = np.concatenate([top / values[..., None], -bottom], axis=-1)
    scale = weight
    for _ in range(_PASSES):
        scaled = matrix * scale[..., None]
        # the Gram matrix is good to 1e-8 of the largest column, far below any noise, and much faster than an SVD
        null = np.linalg.eigh(np.swapaxes(scaled.conj(), 1, 2) @ scaled)[1][:, :, 0]
        q = _away_from_zero(np.einsum("kwi,ki->kw", bottom, null[:, top.shape[-1] :]))
        scale = weight / np.abs(q)
        scale = scale / scale.max(axis=1, keepdims=True)
    return null


def _quotient(top: np.ndarray, bottom: np.ndarray, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """p/q (k, w) and its relative Jacobian (k, w, n)."""
    p = _away_from_zero(np.einsum("kwi,ki->kw", top, coefficients[:, : top.shape[-1]]))
    q = _away_from_zero(np.einsum("kwi,ki->kw", bottom, coefficients[:, top.shape[-1] :]))
    return p / q, np.concatenate([top / p[..., None], -bottom / q[..., None]], axis=-1)


def _away_from_zero(values: np.ndarray) -> np.ndarray:
    """Values (k, w) no smaller than 1e-12 of the largest of their window: a zero on a sample says nothing there."""
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
    count: int,
    shape: tuple[int, tuple[int, int]],
) -> tuple[np.ndarray, np.ndarray]:
    """How far points are off the fit to their neighbours.

    Parameters
    ----------
    sigma : (n,) relative standard deviation of the impedance;  trusted : the same for points as neighbours
    first, count : points first … first + count − 1 are left out, (k,) cases
    shape : (points of a window, (degree of numerator, of denominator))

    Returns
    -------
    distance : (k, count) in standard deviations of the prediction
    rest : (k,) rms residual of the other points in standard deviations, 1 where the fit is good
    """
    width, degrees = shape
    index = windows(impedance.size, first + count // 2, width)
    out = (index >= first[:, None]) & (index < first[:, None] + count)
    weight = np.where(out, 0.0, 1 / trusted[index])
    fit, jacobian = rational(frequency[index], impedance[index], weight, degrees)
    deviation = np.abs(impedance[index] / fit - 1)
    spread = np.sum(np.abs(jacobian @ _pseudo_inverse(jacobian * weight[..., None])) ** 2, axis=-1)
    rest = np.linalg.norm(deviation * weight, axis=1) / np.sqrt(width - count - (sum(degrees) + 1))
    distance = deviation / np.sqrt(sigma[index] ** 2 + spread)  # spread: variance of the fitted log Z
    return distance[out].reshape(first.size, count), rest


def stepped(
    frequency: np.ndarray, impedance: np.ndarray, sigma: np.ndarray, after: np.ndarray, shape
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How large a step of log Z behind the points `after` (k,) fits best.

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
    z, w = impedance[index], 1 / sigma[index]
    powers = _powers(frequency[index], degrees)
    step = _straight_step(z, behind)
    for _ in range(_STEPS):
        coefficients = _linear_fit(*powers, z * np.exp(-step[:, None] * behind), w)
        fit, inverse = _with_step(*powers, coefficients, behind, w)
        change = np.einsum("ki,ki->k", inverse[:, -1], np.log(z * np.exp(-step[:, None] * behind) / fit) * w)
        step = step + _at_most_one(change)
    residual = np.log(z * np.exp(-step[:, None] * behind) / fit) * w
    for _ in range(_REFINEMENTS):  # the linear fit does not minimise the residual itself; Gauss and Newton do
        change = np.einsum("knw,kw->kn", inverse, residual)
        tried, moved = coefficients + change[:, :-1], step + _at_most_one(change[:, -1])
        fit, other = _with_step(*powers, tried, behind, w)
        left = np.log(z * np.exp(-moved[:, None] * behind) / fit) * w
        better = np.linalg.norm(left, axis=1) < np.linalg.norm(residual, axis=1)
        step = np.where(better, moved, step)
        coefficients, residual = (np.where(better[:, None], a, b) for a, b in ((tried, coefficients), (left, residual)))
        inverse = np.where(better[:, None, None], other, inverse)
    std = np.linalg.norm(inverse[:, -1], axis=1)
    freedom = width - (sum(degrees) + 2)
    return step, np.abs(step) / std, np.linalg.norm(residual, axis=1) / np.sqrt(freedom)


def _with_step(top, bottom, coefficients, behind, weight) -> tuple[np.ndarray, np.ndarray]:
    """p/q (k, w), and what turns weighted residuals into changes of its coefficients and of the step (k, n + 1, w)."""
    fit, jacobian = _quotient(top, bottom, coefficients)
    return fit, _pseudo_inverse(np.concatenate([jacobian, behind[..., None]], axis=-1) * weight[..., None])


def _at_most_one(change: np.ndarray) -> np.ndarray:
    return np.clip(np.abs(change), 0, 1) * np.exp(1j * np.angle(change))


def _pseudo_inverse(matrix: np.ndarray) -> np.ndarray:
    """(k, n, w) of (k, w, n), by normal equations of columns scaled to one."""
    size = np.linalg.norm(matrix, axis=1, keepdims=True)
    scaled = matrix / np.where(size == 0, 1.0, size)
    adjoint = np.swapaxes(scaled.conj(), 1, 2)
    gram = adjoint @ scaled + _RIDGE * np.eye(matrix.shape[-1])
    return np.linalg.solve(gram, adjoint) / np.swapaxes(np.where(size == 0, 1.0, size), 1, 2)


def _straight_step(values: np.ndarray, behind: np.ndarray) -> np.ndarray:
    """A first guess: the step between straight lines through the three points on either side."""
    last = np.argmax(behind > 0, axis=1) - 1
    rows, logs = np.arange(values.shape[0])[:, None], np.log(values)
    near = logs[rows, last[:, None] + np.arange(-1, 3)]
    turned = near.imag - near[:, :1].imag
    near = near.real + 1j * (near[:, :1].imag + (turned + np.pi) % (2 * np.pi) - np.pi)
    return (1.5 * near[:, 2] - 0.5 * near[:, 3]) - (1.5 * near[:, 1] - 0.5 * near[:, 0])
