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
from femu_piezo.threads import made_once

TOLERANCE = 1e-5
#: Share of the tolerance below which a violation is rounding: a lossless constant stands at the wall.
_NOTICED = 1e-6


@cache
def _pairs(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns (size (size + 1)/2,) of an upper triangle."""
    return np.triu_indices(size)


class Walls:
    """The walls as seen from some unknowns.

    Of free and held constants without laws over frequency. With eigenvalues λ_i and eigenvectors v_i of every block L
    of both matrices, and h_ij = v_iᵗ (∂L/∂x) v_j, the walls cost Σ min(0, λ_i)²/TOLERANCE².

    Parameters
    ----------
    x : (n_x,) the unknowns
    """

    def __init__(self, parameters: Unknowns, x: np.ndarray) -> None:
        self._parameters, self._x = parameters, x
        self._active = effects_on_constants(parameters, x)
        self._constants = even_constants(parameters, x, self._active)
        blocks = range(self._constants.block_count)
        both = [np.stack([self._constants.energy_block(n), self._constants.loss_block(n)]) for n in blocks]
        self._eigen = [np.linalg.eigh(one) for one in both]

    @made_once
    def values(self) -> np.ndarray:
        """(n,) every λ over the tolerance; what is negative by rounding alone is 0."""
        found = np.concatenate([values.ravel() for values, _ in self._eigen]) / TOLERANCE
        return np.where((found < 0) & (found > -_NOTICED), 0.0, found)

    @property
    def touched(self) -> bool:
        """Whether any λ is beyond its wall."""
        return bool(self.values.min() < 0)

    @property
    def cost(self) -> float:
        """Σ min(0, λ)²/TOLERANCE²."""
        return float(np.sum(np.minimum(self.values, 0.0) ** 2))

    @made_once
    def slopes(self) -> np.ndarray:
        """(n, n_x) h_ii over the tolerance, ∂values/∂x."""
        return np.concatenate([np.diagonal(turned, axis1=1, axis2=2).T for turned in self._turned])

    @made_once
    def rows(self) -> np.ndarray:
        """(m,) of a residual, one for each pair i ≤ j of each block: λ_i beyond its wall for i = j, else 0."""
        found = []
        for low, _ in self._low:
            first, second = _pairs(low.size)
            found.append(np.where(first == second, low[first], 0.0))
        return np.concatenate(found) / TOLERANCE

    @made_once
    def row_slopes(self) -> np.ndarray:
        """(m, n_x) of the same, whose product with itself is the Hessian of half the cost.

        That is Σ γ_ij h_ij²/TOLERANCE², γ_ij = (λ_i⁻ − λ_j⁻)/(λ_i − λ_j), which counts that the boundary is curved. So
        a pair i ≠ j has a slope √(2γ_ij) h_ij beside a row that is zero.
        """
        if not self.touched:
            return np.zeros((self.rows.size, self._x.size))
        found = []
        for (low, values), turned in zip(self._low, self._turned, strict=True):
            first, second = _pairs(low.size)
            apart = values[first] - values[second]
            share = np.where(apart == 0, low[first] < 0, (low[first] - low[second]) / np.where(apart == 0, 1.0, apart))
            count = np.where(first == second, share, 2 * share)
            found.append((np.sqrt(count) * turned[:, first, second]).T)
        return np.concatenate(found)

    @made_once
    def _low(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """(λ⁻, λ) of every block of each matrix."""
        parts = [values for of_both, _ in self._eigen for values in of_both]
        ends = np.cumsum([values.size for values in parts])[:-1]
        low = np.split(np.minimum(self.values, 0.0) * TOLERANCE, ends)
        return list(zip(low, parts, strict=True))

    @made_once
    def _turned(self) -> list[np.ndarray]:
        """h (n_x, i, j) over the tolerance of every block of each matrix."""
        tangents = d_form_constants(self._parameters, self._x, self._active, np.ones(1))[1][0]
        moving = np.flatnonzero(np.any(tangents != 0, axis=0))
        found = []
        for block, (_, of_both) in enumerate(self._eigen):
            slopes = self._constants.block_slopes(block, tangents[:, moving].T)
            for vectors, own in zip(of_both, slopes, strict=True):
                turned = np.zeros((self._x.size, *vectors.shape))
                turned[moving] = vectors.T @ own @ vectors / TOLERANCE
                found.append(turned)
        return found


def wall_and_readings(parameters: Unknowns, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows (m,) and slopes (m, n_x) that a fit has beside data and priors: the walls, then a row for each reading."""
    walls, (read, along) = Walls(parameters, x), readings(parameters, x)
    return np.concatenate([walls.rows, read]), np.concatenate([walls.row_slopes, along])


def readings(parameters: Unknowns, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A row (m,) with slopes (m, n_x) for each reading."""
    found = [one.row(parameters, x) for one in parameters.readings]
    return np.array([row for row, _ in found]), np.array([slope for _, slope in found]).reshape(len(found), x.size)
