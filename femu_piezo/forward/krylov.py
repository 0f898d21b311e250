"""Krylov vectors of the driven plate: the start of a reduced basis, from one real factorisation.

With K_σ = K − σM, a shift σ inside the band and x_0 = K_σ^-1 b, the driven state is

    x(ω) = (1 − s K_σ^-1 M)^-1 x_0,    s = ω² − σ,    bᵗx = bᵗx_0 + s x_0ᵗM x,

so the Lanczos vectors of K_σ^-1 M started from x_0 span every mode that the terminals drive and no other mode.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from femu_piezo.errors import ConvergenceError
from femu_piezo.forward.linear_solver import Factorization

#: Loss factor at which convergence is tested, Lanczos steps between two tests, and the largest number of steps.
LOSS, _STEPS, _MOST_STEPS = 0.005, 6, 1200


def driven_krylov(
    factor: Factorization, mass: sp.spmatrix, static: np.ndarray, shift: float, top: float, accuracy: float
) -> np.ndarray:
    """Vectors x_0, K_σ^-1 M q_1, … until Z up to ω² = top has settled to `accuracy` (relative); (m, j) real.

    Parameters
    ----------
    factor : of K − shift · M, all m unknowns
    mass : (n_u, n_u) M of the displacements, which come first
    static : (m,) K_σ^-1 b

    Raises
    ------
    ConvergenceError : more steps than a sensible mesh and band can need
    """
    split = mass.shape[0]
    norm = np.sqrt(static[:split] @ (mass @ static[:split]))
    solutions, lanczos = [static], np.empty((_STEPS, split))
    weighted, projected = np.empty_like(lanczos), np.zeros((0, 0))
    lanczos[0] = static[:split] / norm
    weighted[0] = mass @ lanczos[0]
    count, previous, settled = 0, None, np.inf
    while settled > accuracy:
        if count >= _MOST_STEPS:
            raise ConvergenceError(
                f"after {_MOST_STEPS} Lanczos steps Z still changes by a relative {settled:.1e}: narrow the band"
            )
        if count + _STEPS >= len(lanczos):
            lanczos, weighted = (np.concatenate([rows, np.empty_like(rows)]) for rows in (lanczos, weighted))
        right = np.zeros((static.size, _STEPS))
        for step in range(_STEPS):
            right[:split, step] = weighted[count]
            solutions.append(factor.solve_unchecked(right[:, step]))
            fresh, column, count = solutions[-1][:split], 0.0, count + 1
            q, mq = lanczos[:count], weighted[:count]
            for _ in range(2):
                part = mq @ fresh
                fresh, column = fresh - part @ q, column + part
            projected = np.pad(projected, (0, 1))
            projected[:, -1] = projected[-1, :] = column
            heavy = mass @ fresh
            size = np.sqrt(fresh @ heavy)
            lanczos[count], weighted[count] = fresh / size, heavy / size
        factor.check(np.column_stack(solutions[-_STEPS:]), right)
        current = np.linalg.eigh(projected)
        if previous is not None:
            settled = _change(previous, current, static[-1], norm, shift, top)
        previous = current
    return np.column_stack(solutions)


def _change(previous, current, static_potential: float, norm: float, shift: float, top: float) -> float:
    """Largest relative change of bᵗx between two Ritz decompositions, at resonances and 60 further frequencies."""
    ritz = shift + 1 / current[0]
    squares = np.concatenate([ritz[(ritz > 0) & (ritz < top)], np.linspace(0.01, 1.0, 60) ** 2 * top])
    s = (squares / (1 + 1j * LOSS))[:, None] - shift

    def response(pairs) -> np.ndarray:
        values, vectors = pairs
        return -static_potential + (s * norm**2 * vectors[0] ** 2 / (1 - s * values)).sum(axis=1)

    new = response(current)
    return float(np.max(np.abs(response(previous) / new - 1)))
