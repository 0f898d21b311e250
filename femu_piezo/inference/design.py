"""The most informative frequencies of a sweep, chosen one after another by what each adds (greedy D-optimal design).

The model is linearised about the expected values. With C the covariance so far, S the unknowns of interest and J the
two whitened rows of a frequency, the Gaussian information of that frequency about S, all else marginalised, is

    I = ½ ln det(1 + J C Jᵗ) − ½ ln det(1 + J C' Jᵗ),    C' = C − C[:, S] C[S, S]^-1 C[S, :],

C' being the covariance if S were known (Chaloner, Verdinelli, Statist. Sci. 10 (1995) 273, for D_S-optimality). The
frequency of the largest I is taken, C is updated with its rows, and so on. Nuisance unknowns, such as the gain of an
instrument, get points only as far as they limit what is known of S.

Two explanations of the same data are told apart where one misses what the other predicts even after all its unknowns
are fitted again (T-optimality: Atkinson, Fedorov, Biometrika 62 (1975) 57). With e the whitened difference of the two
predictions at some frequencies before this refit, the misfit after it is

    χ² = eᵗ (1 + J C Jᵗ)^-1 e,

and χ²/2 is the log odds that these frequencies are expected to bring.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

#: Whitened slopes (k, 2, n) of an explanation, and its covariance (n, n), in the same units
Explanation = tuple[np.ndarray, np.ndarray]


def information(rows: np.ndarray, covariance: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """I (k,), in nats, of each of k frequencies about some unknowns.

    Parameters
    ----------
    rows : (k, 2, n) whitened Jacobian, real and imaginary part of each frequency
    covariance : (n, n) so far
    wanted : (m,) columns of the unknowns of interest
    """
    to_wanted = covariance[:, wanted]
    given_wanted = covariance - to_wanted @ np.linalg.solve(covariance[np.ix_(wanted, wanted)], to_wanted.T)
    return 0.5 * (_log_det(rows, covariance) - _log_det(rows, given_wanted))


def _log_det(rows: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """ln det(1 + J C Jᵗ) (k,)."""
    a, b = rows[:, 0] @ covariance, rows[:, 1] @ covariance
    first, mixed, second = (
        np.einsum("kn,kn->k", *pair) for pair in ((a, rows[:, 0]), (a, rows[:, 1]), (b, rows[:, 1]))
    )
    return np.log(np.maximum((1 + first) * (1 + second) - mixed**2, 1.0))


def covariance_after(covariance: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """The covariance (n, n) after whitened rows (m, n) were measured."""
    gain = covariance @ rows.T
    found = covariance - gain @ np.linalg.solve(np.eye(len(rows)) + rows @ gain, gain.T)
    return (found + found.T) / 2


def most_informative(rows: np.ndarray, covariance: np.ndarray, wanted: np.ndarray, count: int) -> list[int]:
    """Numbers of the `count` most informative frequencies, each once, the most informative first.

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
        covariance = covariance_after(covariance, rows[best])
    return found


def misfit_after_refit(rows: np.ndarray, covariance: np.ndarray, error: np.ndarray) -> float:
    """χ² of whitened errors e (m,) after a refit of unknowns of covariance C (n, n) by their slopes J (m, n)."""
    moved = rows.T @ error
    moves = np.linalg.solve(np.eye(moved.size) + covariance @ (rows.T @ rows), covariance @ moved)
    return float(error @ error - moved @ moves)


def most_separating(explanations: Sequence[Explanation], apart: np.ndarray, count: int) -> list[int]:
    """Numbers of `count` frequencies, each once, in the order in which they tell two explanations apart.

    Each is the one at which χ² grows most, the mean of what each explanation misses if the other holds.

    Parameters
    ----------
    explanations : the two
    apart : (k, 2) whitened difference of what they predict
    """
    rows = [one for one, _ in explanations]
    covariances, errors = [one for _, one in explanations], [apart for _ in explanations]
    free, found = np.ones(len(apart), dtype=bool), []
    for _ in range(min(count, len(apart))):
        gains = sum(_missed_each(*one) for one in zip(rows, covariances, errors, strict=True))
        place = int(np.argmax(np.where(free, gains, -np.inf)))
        found.append(place)
        free[place] = False
        for number, (slopes, covariance, error) in enumerate(zip(rows, covariances, errors, strict=True)):
            gain = covariance @ slopes[place].T
            move = gain @ np.linalg.solve(np.eye(2) + slopes[place] @ gain, error[place])
            errors[number] = error - slopes @ move
            covariances[number] = covariance_after(covariance, slopes[place])
    return found


def _missed_each(rows: np.ndarray, covariance: np.ndarray, error: np.ndarray) -> np.ndarray:
    """χ² (k,) after a refit to each frequency alone: rows (k, 2, n), covariance (n, n), errors (k, 2)."""
    spread = np.eye(2) + rows @ covariance @ rows.transpose(0, 2, 1)
    return np.einsum("ka,ka->k", error, np.linalg.solve(spread, error[..., None])[..., 0])
