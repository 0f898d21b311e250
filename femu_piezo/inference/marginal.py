"""A linearised model whose unknowns are integrated out, walls of material among what holds them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import erfcx


@dataclass(frozen=True)
class Columns:
    """Columns of a linearised model in prior standard deviations, the rows of the data reduced to Q R once for all.

    Attributes
    ----------
    basis, triangle : (2k, r), (r, n) Q and R of the rows of the data;  beside : (m, n) rows of priors, walls, readings
    """

    basis: np.ndarray
    triangle: np.ndarray
    beside: np.ndarray

    @classmethod
    def of(cls, data: np.ndarray, beside: np.ndarray) -> Columns:
        """Of rows of data (2k, n), whitened, and of others (m, n)."""
        return cls(*np.linalg.qr(data), beside)

    def without(self, which: np.ndarray) -> Columns:
        """The same without some columns, by number."""
        return Columns(self.basis, np.delete(self.triangle, which, axis=1), np.delete(self.beside, which, axis=1))

    def rows(self, level: float = 1.0) -> np.ndarray:
        """(r + m, n) at a noise level, with the products of the columns with each other."""
        return np.concatenate([self.triangle / level, self.beside])

    def reached(self, values: np.ndarray, level: float) -> np.ndarray:
        """(r + m,) what columns can reach of values (2k + m,), those of the data over the noise level."""
        count = len(self.basis)
        return np.concatenate([self.basis.T @ values[:count] / level, values[count:]])

    def whole(self, rows: np.ndarray) -> np.ndarray:
        """(2k + m, …) of rows (r + m, …)."""
        size = len(self.triangle)
        return np.concatenate([self.basis @ rows[:size], rows[size:]])

    def among(self, beside: np.ndarray) -> np.ndarray:
        """(r + m,) bool of one (m,) for the rows beside the data."""
        return np.append(np.zeros(len(self.triangle), dtype=bool), beside)


@dataclass(frozen=True)
class Marginal:
    """What is left over of a linearised model whose unknowns are integrated out.

    Attributes
    ----------
    residual : (2k,) whitened, of the data;  further : (m,) of priors, wall and readings
    basis, triangle : (2k + m, n), (n, n) Q and R of all columns at the noise level; R of all but walls that are touched
    log_volume : logarithm of the integral over the unknowns, over its value at the best ones and (2π)^(n/2), in prior
        standard deviations: −log |det R| of all but the walls that are touched, and the share that these leave
    level : factor on the noise
    """

    residual: np.ndarray
    further: np.ndarray
    basis: np.ndarray
    triangle: np.ndarray
    log_volume: float
    level: float

    @property
    def covariance(self) -> np.ndarray:
        """(n, n) posterior covariance of all unknowns, in standard deviations of their priors."""
        inverse = solve_triangular(self.triangle, np.eye(len(self.triangle)))
        return inverse @ inverse.T

    @classmethod
    def of(cls, columns: Columns, left: np.ndarray, level: float, walls: np.ndarray, held: np.ndarray) -> Marginal:
        """Of columns and what is left (2k + m,), the rows of the data first.

        walls : (m,) bool, all rows of walls that are touched;  held : those that keep the best place from beyond
        """
        count, rows = len(columns.basis), columns.rows(level)
        basis, triangle = np.linalg.qr(rows)
        share = 0.0
        if np.any(walls):
            reached = columns.reached(left, level)
            triangle, share, _ = behind_walls(rows, reached, columns.among(walls), columns.among(held))
        volume = share - float(np.sum(np.log(np.abs(np.diag(triangle)))))
        return cls(left[:count], left[count:], columns.whole(basis), triangle, volume, level)


def behind_walls(
    rows: np.ndarray, values: np.ndarray, walls: np.ndarray, held: np.ndarray
) -> tuple[np.ndarray, float, np.ndarray]:
    """What walls leave of the normal distribution that all other rows (m, n) with values (m,) make.

    R (n, n) of those rows; log of the share that is behind the walls, over the density at the best place there; and
    (w,) weights of the walls with which the distribution had, about that place, the same mean squares.

    A wall whose row is −uΔ without it, u² = gᵗ (RᵗR)⁻¹ g of its slope g, leaves ∫ exp(−t²/2) dt/√(2π) from Δ on, where
    the density is exp(−Δ²/2). That counts twice, so that it is 1 where a wall is just touched, as it is just before. Of
    several walls each finds the mean and the covariance that those before have left.

    walls, held : (m,) bool, as in `Marginal.of`
    """
    inner, other = np.linalg.qr(rows[~walls])
    slopes, triangle = rows[held], other
    free = values[held] - slopes @ solve_triangular(other, inner.T @ values[~walls])
    found, weights = 0.0, np.zeros(free.size)
    for number, slope in enumerate(slopes):
        own = solve_triangular(triangle, slope, trans="T")
        size = float(np.linalg.norm(own))
        away = max(-free[number] / size, 0.0)
        found += float(np.log(erfcx(away / np.sqrt(2))))
        mean = np.sqrt(2 / np.pi) / erfcx(away / np.sqrt(2))  # of t, over Δ
        narrowed = max(1 - mean * (mean - away), 1 / (2 + away) ** 2)  # not below by rounding
        free += slopes @ solve_triangular(triangle, own) * mean / size
        more = np.sqrt(1 / narrowed - 1) / size * slope
        triangle = np.asarray(np.linalg.qr(np.vstack([triangle, more]), mode="r"))
        square = narrowed + (mean - away) ** 2  # of the distance behind the wall
        weights[number] = np.sqrt(max(1 / square - 1, 0.0)) / size
    return other, found, weights


@dataclass(frozen=True)
class Unexplained:
    """What no change of the unknowns explains, by a linearised model at a level of the noise.

    Attributes
    ----------
    residual : (2k + m,) of data, whitened, then of priors in the same unit
    span : (2k, n) as `Fit.span`
    level, log_volume : of the `Marginal` that it is of
    log_likelihood : at the most probable level, with the volume of the unknowns, up to a constant
    """

    residual: np.ndarray
    span: np.ndarray
    level: float
    log_volume: float
    log_likelihood: float
