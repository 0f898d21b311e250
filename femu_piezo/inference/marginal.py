"""A linearised model whose unknowns are integrated out, within the walls of the material."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import erfcx

from femu_piezo.inference.triangle import solved


@dataclass(frozen=True)
class Columns:
    """Jacobian of a linearised model, unknowns in prior standard deviations, the rows of the data factored to Q R.

    Attributes
    ----------
    basis, triangle : (2k, r), (r, n) Q and R of the rows of the data;  others : (m, n) rows of priors, walls, readings
    """

    basis: np.ndarray
    triangle: np.ndarray
    others: np.ndarray

    @classmethod
    def of(cls, data: np.ndarray, others: np.ndarray) -> Columns:
        """From whitened rows of the data (2k, n) and other rows (m, n)."""
        return cls(*np.linalg.qr(data), others)

    def without(self, which: np.ndarray) -> Columns:
        """These columns without those of the numbers `which`."""
        return Columns(self.basis, np.delete(self.triangle, which, axis=1), np.delete(self.others, which, axis=1))

    def rows(self, level: float = 1.0) -> np.ndarray:
        """(r + m, n) R over the noise level, then the other rows: JᵗJ is that of all rows."""
        return np.concatenate([self.triangle / level, self.others])

    def projected(self, values: np.ndarray, level: float) -> np.ndarray:
        """(r + m,) of values (2k + m,): Qᵗ of those of the data over the noise level, then the others."""
        count = len(self.basis)
        return np.concatenate([self.basis.T @ values[:count] / level, values[count:]])

    def expanded(self, rows: np.ndarray) -> np.ndarray:
        """(2k + m, …) Q of the first r of rows (r + m, …), then the others: all rows of the data again."""
        size = len(self.triangle)
        return np.concatenate([self.basis @ rows[:size], rows[size:]])

    def in_all_rows(self, chosen: np.ndarray) -> np.ndarray:
        """(r + m,) bool: the chosen (m,) of the rows that are no data; no row of the data."""
        return np.append(np.zeros(len(self.triangle), dtype=bool), chosen)


@dataclass(frozen=True)
class Marginal:
    """A linearised model whose unknowns are integrated out: its residual, and their volume.

    Attributes
    ----------
    residual : (2k,) whitened, of the data;  further : (m,) of priors, wall and readings
    basis, triangle : (2k + m, n), (n, n) Q and R of all columns at the noise level; R without rows of touched walls
    log_volume : logarithm of the integral of the density over the unknowns, in prior standard deviations, divided by
        its value at the estimate and by (2π)^(n/2): −log |det R|, plus the log share that touched walls leave
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
        inverse = solved(self.triangle, np.eye(len(self.triangle)))
        return inverse @ inverse.T

    @classmethod
    def of(cls, columns: Columns, residual: np.ndarray, level: float, walls: np.ndarray, held: np.ndarray) -> Marginal:
        """From columns and a residual (2k + m,), the rows of the data first.

        walls : (m,) bool, all rows of walls that are touched;  held : those of them that hold the estimate
        """
        count, rows = len(columns.basis), columns.rows(level)
        basis, triangle = np.linalg.qr(rows)
        share = 0.0
        if np.any(walls):
            projected = columns.projected(residual, level)
            triangle, share, _ = behind_walls(rows, projected, columns.in_all_rows(walls), columns.in_all_rows(held))
        volume = share - float(np.sum(np.log(np.abs(np.diag(triangle)))))
        return cls(residual[:count], residual[count:], columns.expanded(basis), triangle, volume, level)


def behind_walls(
    rows: np.ndarray, values: np.ndarray, walls: np.ndarray, held: np.ndarray
) -> tuple[np.ndarray, float, np.ndarray]:
    """The normal distribution of all rows (m, n), values (m,), but walls, truncated by these to where they allow.

    Returns R (n, n) of the rows that are no walls; the log of the share within the walls, over the density at the
    estimate; and the weights (w,) of the rows of held walls that give the normal distribution the same mean squares
    about the estimate as the truncated one has.

    A wall of slope g has the value −uΔ at the minimum without it, u² = gᵗ (RᵗR)⁻¹ g. It leaves ∫ exp(−t²/2) dt/√(2π)
    from Δ on, where the density is exp(−Δ²/2). The ratio is doubled, so that it is 1 for a wall that is just touched,
    as for one that is not quite touched. Each of several walls acts on the mean and covariance that those before leave.

    walls, held : (m,) bool, as in `Marginal.of`
    """
    inner, without_walls = np.linalg.qr(rows[~walls])
    slopes, triangle = rows[held], without_walls
    free = values[held] - slopes @ solved(without_walls, inner.T @ values[~walls])
    log_share, weights = 0.0, np.zeros(free.size)
    for number, slope in enumerate(slopes):
        direction = solved(triangle, slope, transposed=True)
        size = float(np.linalg.norm(direction))
        away = max(-free[number] / size, 0.0)
        log_share += float(np.log(erfcx(away / np.sqrt(2))))
        mean = np.sqrt(2 / np.pi) / erfcx(away / np.sqrt(2))  # of t beyond Δ
        narrowed = max(1 - mean * (mean - away), 1 / (2 + away) ** 2)  # rounding could make it smaller
        free += slopes @ solved(triangle, direction) * mean / size
        more = np.sqrt(1 / narrowed - 1) / size * slope
        triangle = np.asarray(np.linalg.qr(np.vstack([triangle, more]), mode="r"))
        square = narrowed + (mean - away) ** 2  # mean square of the distance from the wall
        weights[number] = np.sqrt(max(1 / square - 1, 0.0)) / size
    return without_walls, log_share, weights


@dataclass(frozen=True)
class Unexplained:
    """The part of a residual that no change of the unknowns explains, in a linearised model at a noise level.

    Attributes
    ----------
    residual : (2k + m,) of data, whitened, then of priors in the same unit
    span : (2k, n) as `Fit.span`
    level, log_volume : of the `Marginal` it comes from
    log_likelihood : at the most probable level, with the volume of the unknowns, up to a constant
    """

    residual: np.ndarray
    span: np.ndarray
    level: float
    log_volume: float
    log_likelihood: float
