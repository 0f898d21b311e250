"""One damped step of Gauss and Newton beside walls, which are there from one side only.

    min over s   |F s + r|² + δ |s|² + Σ min(0, λ_i(s))²/TOLERANCE² + Σ readings²

F and r are data and priors, linearised; the walls (`femu_piezo.inference.walls`) and the readings of other instruments
cost next to nothing to evaluate and are taken as they are. The minimum is approached from beyond the walls, by cutting
planes (Kelley, J. SIAM 8 (1960) 703): a material that passes no wall fulfils λ_i + ∇λ_i·(s − s_k) ≥ 0 for every
eigenvalue at every s_k, as the loss matrix is linear in the losses. Each turn adds those of the eigenvalues that are
beyond their walls at the minimum of the turn before. So a step slides along a wall on which it begins.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from femu_piezo.inference.walls import Walls

#: Most turns within one step, and most halvings of one that they do not bring to a lower cost.
_TURNS, _HALVINGS = 20, 20
#: By how much χ² may be above what the planes leave, and the share of what was gained: the model of the data beyond the
#: wall is only linear, so that more turns gain nothing.
_SETTLED, _SHARE = 1e-7, 1e-2


@dataclass(frozen=True)
class Beside:
    """What is taken as it is, at some step.

    Attributes
    ----------
    read, along : (q,), (q, n_x) of the readings
    """

    walls: Walls
    read: np.ndarray
    along: np.ndarray


def damped_step(
    factor: np.ndarray,
    right: np.ndarray,
    damping: float,
    moving: tuple[np.ndarray, np.ndarray],
    beside: Callable[[np.ndarray], Beside],
    kept: float = 0.0,
) -> tuple[np.ndarray, float]:
    """The step s (n,) and what it gains without the damping.

    Parameters
    ----------
    factor, right : F (m, n), r (m,);  damping : δ
    moving : which unknowns move (n,), and what one of s is of each (n,)
    beside : of a step
    kept : share of the distance to every wall that the step keeps
    """
    which, unit = moving
    start = np.zeros(unit.size)
    here = beside(start)
    margins = kept * np.maximum(here.walls.values, 0.0)

    def cost(step: np.ndarray, there: Beside) -> float:
        left, passed = factor @ step + right, np.minimum(there.walls.values - margins, 0.0)
        return float(left @ left + damping * (step @ step) + passed @ passed + there.read @ there.read)

    def least(planes: np.ndarray, offsets: np.ndarray, near: np.ndarray, there: Beside) -> tuple[np.ndarray, float]:
        """The step of least cost with some planes G s + c (p, n) and the readings as at the step `near`, and that cost.

        With R of all rows but the planes, s₀ their minimum, W = R⁻ᵗGᵗ and what each plane is passed by, μ ≥ 0,

            s = s₀ + R⁻¹W μ,    |μ + G s₀ + c|² + |W μ|² least,    the cost |R (s − s₀)|² + |μ|² over that of s₀.
        """
        along = there.along[:, which] * unit
        rows = np.concatenate([factor, np.sqrt(damping) * np.eye(unit.size), along])
        values = np.concatenate([right, np.zeros(unit.size), there.read - along @ near])
        triangle = np.asarray(np.linalg.qr(np.column_stack([rows, values]), mode="r"))
        own = triangle[:-1, :-1]
        step, promised = solve_triangular(own, -triangle[:-1, -1]), float(triangle[-1, -1] ** 2)
        if np.any(planes @ step + offsets < 0):
            through = solve_triangular(own, planes.T, trans="T")
            both = np.concatenate([np.eye(len(planes)), through])
            passed, _ = nnls(both, np.append(-planes @ step - offsets, np.zeros(unit.size)))
            moved = through @ passed
            step, promised = step + solve_triangular(own, moved), promised + float(moved @ moved + passed @ passed)
        return step, promised

    def cut(step: np.ndarray, walls: Walls, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Planes (p, n) and offsets (p,) of some eigenvalues at a step."""
        planes = walls.slopes[np.ix_(chosen, which)] * unit
        return planes, (walls.values - margins)[chosen] - planes @ step

    first, nearest = cost(start, here), np.min(here.walls.values - margins)
    best, lowest = start, first
    if here.walls.touched:
        planes, offsets = cut(start, here.walls, np.arange(here.walls.values.size))
    else:  # most often no wall is near
        planes, offsets = np.zeros((0, unit.size)), np.zeros(0)
    near = start
    for turn in range(_TURNS):
        step, promised = least(planes, offsets, near, here)
        there = beside(step)
        reached = cost(step, there)
        if reached < lowest:
            best, lowest = step, reached
        if reached - promised < max(_SETTLED, _SHARE * (first - lowest)):
            break
        if turn == 0 and not len(planes):
            planes, offsets = cut(start, here.walls, np.arange(here.walls.values.size))
        further, behind = cut(step, there.walls, np.flatnonzero(there.walls.values < margins))
        # at the start no plane lies lower than the least eigenvalue there, but for what real parts do to the walls
        planes, offsets = np.concatenate([planes, further]), np.concatenate([offsets, np.maximum(behind, nearest)])
        near, here = step, there
    for _ in range(_HALVINGS):  # what real parts do to the walls is not linear
        if lowest < first:
            break
        step = step / 2
        best, lowest = step, cost(step, beside(step))
    return best, first - lowest + damping * float(best @ best)
