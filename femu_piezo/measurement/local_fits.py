"""Local rational fits that leave points out or allow a step: how far a point, or a side, is off its neighbours.

In a short window an impedance is a rational function of low degree times noise. Fitted without the suspects, it
predicts them; the prediction has a standard deviation, and what the other points leave over says whether the
function can describe the window at all.
"""

from __future__ import annotations

import numpy as np

_PASSES, _STEPS = 3, 3
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
    x = frequency - frequency.mean(axis=1, keepdims=True)
    x = x / np.abs(x).max(axis=1, keepdims=True)
    powers = np.polynomial.chebyshev.chebvander(x, max(degrees))
    top, bottom = powers[..., : degrees[0] + 1], powers[..., : degrees[1] + 1]
    matrix = np.concatenate([top / values[..., None], -bottom], axis=-1)
    scale = weight
    for _ in range(_PASSES):
        scaled = matrix * scale[..., None]
        # the Gram matrix is good to 1e-8 of the largest column, far below any noise, and much faster than an SVD
        null = np.linalg.eigh(np.swapaxes(scaled.conj(), 1, 2) @ scaled)[1][:, :, 0]
        p = np.einsum("kwi,ki->kw", top, null[:, : degrees[0] + 1])
        q = np.einsum("kwi,ki->kw", bottom, null[:, degrees[0] + 1 :])
        q = _away_from_zero(q)
        scale = weight / np.abs(q)
        scale = scale / scale.max(axis=1, keepdims=True)
    p = _away_from_zero(p)
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
    f, z, w = frequency[index], impedance[index], 1 / sigma[index]
    step = _straight_step(z, behind)
    for _ in range(_STEPS):
        level = z * np.exp(-step[:, None] * behind)
        fit, jacobian = rational(f, level, w, degrees)
        residual = np.log(level / fit) * w
        both = np.concatenate([jacobian, behind[..., None]], axis=-1) * w[..., None]
        inverse = _pseudo_inverse(both)
        change = np.einsum("ki,ki->k", inverse[:, -1], residual)
        step = step + np.clip(np.abs(change), 0, 1) * np.exp(1j * np.angle(change))
    std = np.linalg.norm(inverse[:, -1], axis=1)
    freedom = width - (sum(degrees) + 2)
    rest = np.linalg.norm(residual, axis=1) / np.sqrt(freedom)
    return step, np.abs(step) / std, rest


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
