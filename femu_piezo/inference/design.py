"""Where a sweep tells most: frequencies chosen one after another by what they add (greedy D-optimal design).

About the expected values the model is linear. With C the covariance so far, S the unknowns that are asked for and J the
two whitened rows of a frequency, its Gaussian information about S, everything else marginalised, is

    I = ½ ln det(1 + J C Jᵗ) − ½ ln det(1 + J C' Jᵗ),    C' = C − C[:, S] C[S, S]^-1 C[S, :],

C' being the covariance if S were known (Chaloner, Verdinelli, Statist. Sci. 10 (1995) 273, for D_S-optimality). The
frequency that tells most is taken, C follows, and so on. Nuisance unknowns, such as the gain of an instrument, get
points only as far as they stand in the way of S.
"""

from __future__ import annotations

import numpy as np


def information(rows: np.ndarray, covariance: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """I (k,), in nats, of each of k frequencies about some unknowns.

    Parameters
    ----------
    rows : (k, 2, n) whitened Jacobian, real and imaginary part of each frequency
    covariance : (n, n) so far
    wanted : (m,) columns of the unknowns that are asked for
    """
    to_wanted = covariance[:, wanted]
    left = covariance - to_wanted @ np.linalg.solve(covariance[np.ix_(wanted, wanted)], to_wanted.T)
    return 0.5 * (_log_det(rows, covariance) - _log_det(rows, left))


def _log_det(rows: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """ln det(1 + J C Jᵗ) (k,)."""
    a, b = rows[:, 0] @ covariance, rows[:, 1] @ covariance
    first, mixed, second = (
        np.einsum("kn,kn->k", *pair) for pair in ((a, rows[:, 0]), (a, rows[:, 1]), (b, rows[:, 1]))
    )
    return np.log(np.maximum((1 + first) * (1 + second) - mixed**2, 1.0))


def observed(covariance: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """The covariance (n, n) after whitened rows (m, n) were measured."""
    gain = covariance @ rows.T
    found = covariance - gain @ np.linalg.solve(np.eye(len(rows)) + rows @ gain, gain.T)
    return (found + found.T) / 2


def chosen(rows: np.ndarray, covariance: np.ndarray, wanted: np.ndarray, count: int) -> list[int]:
    """Numbers of `count` frequencies, each once, in the order in which they tell most.

    Parameters
    ----------
    rows : (k, 2, n);  covariance : (n, n);  wanted : (m,), all as of `information`
    """
    free, found = np.ones(len(rows), dtype=bool), []
    for _ in range(min(count, len(rows))):
        gain = np.where(free, information(rows, covariance, wanted), -np.inf)
        best = int(np.argmax(gain))
        found.append(best)
        free[best] = False
        covariance = observed(covariance, rows[best])
    return found
