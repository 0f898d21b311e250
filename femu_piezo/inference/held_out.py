"""Predictions of the bands of a sweep by fits that do not see them, linear about the fit that sees all.

With r the residual and H = J (JᵗJ)^-1 Jᵗ the hat matrix of data and priors, a fit without band b leaves
(I − H_bb)^-1 r_b there, whose covariance for a right model is (I − H_bb)^-1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femu_piezo.measurement.sweeps import SweepData
from femu_piezo.threads import made_once

#: Least share of the information on a combination of unknowns that bands other than the one left out must give.
_DETERMINED = 1e-10


@dataclass(frozen=True)
class HeldOut:
    """What fits that do not see a band leave in it, for every band of every sweep.

    Attributes
    ----------
    residual : (2k,) whitened, of the fit that sees all
    levers : (2k, n) rows B of the data, B Bᵗ = H
    """

    data: SweepData
    residual: np.ndarray
    levers: np.ndarray

    @made_once
    def _bands(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each band its rows of the residual, and their values in a fit without the band.

        (I − B Bᵗ)^-1 r with the levers B of the band, along the principal axes of BᵗB; 0 along those that no other band
        determines.
        """
        k, found = self.residual.size // 2, []
        for points in self.data.bands():
            rows = np.concatenate([points, points + k])
            levers, residual = self.levers[rows], self.residual[rows]
            share, axes = np.linalg.eigh(levers.T @ levers)
            determined = 1 - share > _DETERMINED
            factor = np.where(determined, 1, -1) / np.where(determined, 1 - share, share)
            along = levers @ axes
            found.append((rows, residual + along @ (factor * (along.T @ residual))))
        return found

    @made_once
    def predicted(self) -> np.ndarray:
        """(k,) complex whitened error of each point as predicted by the fit that does not see its band."""
        k = self.residual.size // 2
        found = np.empty(2 * k)
        for rows, unseen in self._bands:
            found[rows] = unseen
        return found[:k] + 1j * found[k:]

    @property
    def rms(self) -> float:
        """rms error of the predictions, in σ."""
        return float(np.sqrt(np.mean(np.abs(self.predicted) ** 2) / 2))

    @property
    def misfit(self) -> float:
        """rms error of the predictions over what noise in data and unknowns makes: 1 for a right model.

        r_bᵗ (I − H_bb)^-1 r_b is a χ².
        """
        squares = [self.residual[rows] @ unseen for rows, unseen in self._bands]
        return float(np.sqrt(np.sum(squares) / self.residual.size))


def misfit_of_unseen(error: np.ndarray, slopes: np.ndarray, covariance: np.ndarray) -> float:
    """rms error at points that a fit did not see, over what noise there and in the unknowns makes.

    Parameters
    ----------
    error : (m,) whitened real residuals;  slopes : (m, n_x) of them in the unknowns
    covariance : (n_x, n_x) of the unknowns by the fit
    """
    spread = np.eye(error.size) + slopes @ covariance @ slopes.T
    return float(np.sqrt(error @ np.linalg.solve(spread, error) / error.size))
