"""Walls of a fit, which keep the material stable and passive; all rows of a fit that are no data.

The d-form matrix is scaled to a unit diagonal of its real part. Its real part must be positive semidefinite (IEEE 176:
the stored energy of a stable body is positive), and so must its negative imaginary part (Holland 1967: a passive body
dissipates). An eigenvalue of −`TOLERANCE` costs as much as one standard deviation of the data. Beyond the wall of
stability a body has modes of negative stiffness, by which a fit may follow errors of the data or of the model.
"""

from __future__ import annotations

from dataclasses import dataclass
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
    """The walls at given unknowns, with their slopes.

    The constants are those of every specimen, with all effects but laws over frequency and conditions of a sweep. With
    eigenvalues λ_i and eigenvectors v_i of every block L of both matrices, and h_ij = v_iᵗ (∂L/∂x) v_j, the walls cost
    Σ min(0, λ_i)²/TOLERANCE².

    Parameters
    ----------
    x : (n_x,) the unknowns
    """

    def __init__(self, parameters: Unknowns, x: np.ndarray) -> None:
        self._parameters, self._x, every = parameters, x, effects_on_constants(parameters, x)
        owners = {item.effect.owner: None for item in every if item.effect.owner} or ("",)
        of_each = [[item for item in every if item.effect.owner in ("", owner)] for owner in owners]
        self._bodies = [(active, even_constants(parameters, x, active)) for active in of_each]
        self._eigen = [
            np.linalg.eigh(np.stack([constants.energy_block(block), constants.loss_block(block)]))
            for _, constants in self._bodies
            for block in range(constants.block_count)
        ]

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
        return np.concatenate([np.diagonal(turned, axis1=1, axis2=2).T for turned in self._eigen_slopes])

    @made_once
    def rows(self) -> np.ndarray:
        """(m,) residual, an element for each pair i ≤ j of each block: min(0, λ_i)/TOLERANCE for i = j, else 0."""
        found = []
        for low, _ in self._violations:
            first, second = _pairs(low.size)
            found.append(np.where(first == second, low[first], 0.0))
        return np.concatenate(found) / TOLERANCE

    @made_once
    def row_slopes(self) -> np.ndarray:
        """(m, n_x) slopes G of `rows`, with GᵗG the Hessian of half the cost.

        That is Σ γ_ij h_ij²/TOLERANCE², γ_ij = (λ_i⁻ − λ_j⁻)/(λ_i − λ_j), λ⁻ = min(0, λ), which includes the curvature
        of the boundary. So a pair i ≠ j has a slope √(2γ_ij) h_ij though its row is zero.
        """
        if not self.touched:
            return np.zeros((self.rows.size, self._x.size))
        found = []
        for (low, values), turned in zip(self._violations, self._eigen_slopes, strict=True):
            first, second = _pairs(low.size)
            apart = values[first] - values[second]
            share = np.where(apart == 0, low[first] < 0, (low[first] - low[second]) / np.where(apart == 0, 1.0, apart))
            count = np.where(first == second, share, 2 * share)
            found.append((np.sqrt(count) * turned[:, first, second]).T)
        return np.concatenate(found)

    @made_once
    def _violations(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """λ⁻ = min(0, λ), and λ, of every block of each matrix."""
        parts = [values for of_both, _ in self._eigen for values in of_both]
        ends = np.cumsum([values.size for values in parts])[:-1]
        low = np.split(np.minimum(self.values, 0.0) * TOLERANCE, ends)
        return list(zip(low, parts, strict=True))

    @made_once
    def _eigen_slopes(self) -> list[np.ndarray]:
        """h (n_x, i, j) over the tolerance, of every block of each matrix."""
        found, eigen = [], iter(self._eigen)
        for active, constants in self._bodies:
            tangents = d_form_constants(self._parameters, self._x, active, np.ones(1))[1][0]
            moving = np.flatnonzero(np.any(tangents != 0, axis=0))
            for block in range(constants.block_count):
                slopes = constants.block_slopes(block, tangents[:, moving].T)
                for vectors, slope in zip(next(eigen)[1], slopes, strict=True):
                    turned = np.zeros((self._x.size, *vectors.shape))
                    turned[moving] = vectors.T @ slope @ vectors / TOLERANCE
                    found.append(turned)
        return found


@dataclass(frozen=True)
class WallsAndReadings:
    """The terms of the cost of a fit that need neither Z nor a linearisation, at given unknowns.

    Attributes
    ----------
    read, along : (q,) residual and (q, n_x) slopes of the readings of other instruments
    """

    walls: Walls
    read: np.ndarray
    along: np.ndarray

    @classmethod
    def at(cls, parameters: Unknowns, x: np.ndarray) -> WallsAndReadings:
        """The terms at x (n_x,)."""
        return cls(Walls(parameters, x), *readings(parameters, x))


def further_rows(
    parameters: Unknowns, x: np.ndarray, terms: WallsAndReadings | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Residual (m,) and slopes (m, n_x) of all rows of a fit that are no data: priors, walls, readings.

    terms : walls and readings at x, where they are known
    """
    std, terms = parameters.prior_std, terms or WallsAndReadings.at(parameters, x)
    return (
        np.concatenate([(x - parameters.prior_mean) / std, terms.walls.rows, terms.read]),
        np.concatenate([np.diag(1 / std), terms.walls.row_slopes, terms.along]),
    )


def readings(parameters: Unknowns, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residual (q,) and slopes (q, n_x) of the readings of other instruments."""
    found = [reading.row(parameters, x) for reading in parameters.readings]
    return np.array([row for row, _ in found]), np.array([slope for _, slope in found]).reshape(len(found), x.size)
