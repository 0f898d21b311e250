"""What no material can be, as walls of a fit: one that creates energy, or that gives it away at rest.

The d-form matrix, scaled to a unit diagonal of its real part, has a real part that must not be indefinite (IEEE 176:
the stored energy of a stable body is positive) and a negative imaginary part that must not be either (Holland 1967: a
passive one dissipates). A violation of an eigenvalue by `TOLERANCE` costs as much as one standard deviation of the
data. Beyond the wall of stability a body has modes of negative stiffness, with which a fit may follow what it should
not.
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
    """Rows (m,) and slopes (m, n_x) that a fit has beside data and priors: the walls, then a row for each reading."""
    rows, slopes = material_wall(parameters, x)
    read = [one.row(parameters, x) for one in parameters.readings]
    return (
        np.concatenate([rows, [row for row, _ in read]]),
        np.concatenate([slopes, *(slope[None] for _, slope in read)]),
    )


def material_wall(parameters: Unknowns, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows (m,) and slopes (m, n_x) of the walls: ½ |rows|² = ½ Σ min(0, λ)²/TOLERANCE² over all eigenvalues λ.

    Of free and held constants at x (n_x,) without laws over frequency. With h_ij = v_iᵗ (∂L/∂x) v_j of the eigenvectors
    of every block L of both matrices, the Hessian is Σ γ_ij h_ij²/TOLERANCE², γ_ij = (λ_i⁻ − λ_j⁻)/(λ_i − λ_j), which
    counts that the boundary is curved. So a pair i ≠ j has a slope √(2γ_ij) h_ij beside a row that is zero.
    """
    active = effects_on_constants(parameters, x)
    constants, tangents = even_constants(parameters, x, active), None
    rows, slopes = [], []
    for block in range(constants.block_count):
        both = np.stack([constants.energy_block(block), constants.loss_block(block)])
        of_both, vectors_of_both = np.linalg.eigh(both)
        first, second = _pairs(of_both.shape[1])
        for part, (values, vectors) in enumerate(zip(of_both, vectors_of_both, strict=True)):
            low = np.where(values < -_NOTICED * TOLERANCE, values, 0.0)
            if not np.any(low):
                rows.append(np.zeros(first.size))
                slopes.append(np.zeros((first.size, x.size)))
                continue
            if tangents is None:
                tangents = d_form_constants(parameters, x, active, np.ones(1))[1][0]
                moving = np.flatnonzero(np.any(tangents != 0, axis=0))
            apart = values[first] - values[second]
            share = np.where(apart == 0, low[first] < 0, (low[first] - low[second]) / np.where(apart == 0, 1.0, apart))
            count = np.where(first == second, share, 2 * share)
            own = np.zeros((first.size, x.size))
            turned = vectors.T @ constants.block_slopes(block, tangents[:, moving].T)[part] @ vectors
            own[:, moving] = (np.sqrt(count) * turned[:, first, second] / TOLERANCE).T
            rows.append(np.where(first == second, low[first], 0.0) / TOLERANCE)
            slopes.append(own)
    return np.concatenate(rows), np.concatenate(slopes)
