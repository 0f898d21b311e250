"""Holland's condition (1967) as a wall: no constants of a fit may create energy.

The loss matrix is −Im of the d-form matrix scaled to a unit diagonal of its real part; its lowest eigenvalue must not
be negative. A violation of `TOLERANCE` costs as much as one standard deviation of the data.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from femu_piezo.inference.coefficients import d_form_constants, effects_on_constants, even_constants
from femu_piezo.inference.unknowns import Unknowns

TOLERANCE = 1e-5
#: Share of the tolerance below which a violation is rounding: a lossless constant stands at the wall.
_NOTICED = 1e-3


@cache
def _pairs(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns (size (size + 1)/2,) of an upper triangle."""
    return np.triu_indices(size)


def wall_and_readings(parameters: Unknowns, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows (m,) and slopes (m, n_x) that a fit has beside data and priors: the wall, then a row for each reading."""
    rows, slopes = passivity_wall(parameters, x)
    read = [one.row(parameters, x) for one in parameters.readings]
    return (
        np.concatenate([rows, [row for row, _ in read]]),
        np.concatenate([slopes, *(slope[None] for _, slope in read)]),
    )


def passivity_wall(parameters: Unknowns, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows (m,) and slopes (m, n_x) of the wall: ½ |rows|² = ½ Σ min(0, λ)²/TOLERANCE² over all eigenvalues λ.

    Of free and held constants at x (n_x,) without laws over frequency. With h_ij = v_iᵗ (∂L/∂x) v_j of the eigenvectors
    of every block L of the loss matrix, the Hessian is Σ γ_ij h_ij²/TOLERANCE², γ_ij = (λ_i⁻ − λ_j⁻)/(λ_i − λ_j), which
    counts that the boundary is curved. So a pair i ≠ j has a slope √(2γ_ij) h_ij beside a row that is zero.
    """
    active = effects_on_constants(parameters, x)
    constants, tangents = even_constants(parameters, x, active), None
    rows, slopes = [], []
    for block in range(constants.block_count):
        values, vectors = np.linalg.eigh(constants.loss_block(block))
        low = np.where(values < -_NOTICED * TOLERANCE, values, 0.0)
        if not np.any(low):
            rows.append(np.zeros(values.size * (values.size + 1) // 2))
            slopes.append(np.zeros((rows[-1].size, x.size)))
            continue
        if tangents is None:
            tangents = d_form_constants(parameters, x, active, np.ones(1))[1][0]
            moving = np.flatnonzero(np.any(tangents != 0, axis=0))
        first, second = _pairs(values.size)
        apart = values[first] - values[second]
        share = np.where(apart == 0, low[first] < 0, (low[first] - low[second]) / np.where(apart == 0, 1.0, apart))
        count = np.where(first == second, share, 2 * share)
        own = np.zeros((first.size, x.size))
        turned = vectors.T @ constants.loss_block_slopes(block, tangents[:, moving].T) @ vectors
        own[:, moving] = (np.sqrt(count) * turned[:, first, second] / TOLERANCE).T
        rows.append(np.where(first == second, low[first], 0.0) / TOLERANCE)
        slopes.append(own)
    return np.concatenate(rows), np.concatenate(slopes)
