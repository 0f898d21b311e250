"""One damped step of Gauss and Newton beside walls, which are there from one side only.

    min over s   |F s + r|² + δ |s|² + Σ min(0, λ_i(s))²/TOLERANCE² + Σ readings²

F and r are data and priors, linearised; the walls (`femu_piezo.inference.walls`) and the readings of other instruments
cost next to nothing to evaluate and are taken as they are. Every turn linearises both where it stands. A wall counts
where the minimum of that model would be beyond it, also where it is not yet: so a step that begins on a wall slides
along it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from femu_piezo.inference.walls import Walls

#: Most turns within one step, most sets of walls that are tried in each, and most halvings of what a turn moves.
_TURNS, _SETS, _HALVINGS = 20, 10, 20
#: What is gained in χ² below which turns have settled, and its share of what they have gained so far: the model of the
#: data beyond the wall is only linear, so that more of them gain nothing.
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

    @property
    def cost(self) -> float:
        """Σ of their squares."""
        return self.walls.cost + float(self.read @ self.read)


def damped_step(
    factor: np.ndarray,
    right: np.ndarray,
    damping: float,
    moving: tuple[np.ndarray, np.ndarray],
    beside: Callable[[np.ndarray], Beside],
) -> tuple[np.ndarray, float]:
    """The step s (n,) and what it gains without the damping.

    Parameters
    ----------
    factor, right : F (m, n), r (m,);  damping : δ
    moving : which unknowns move (n,), and what one of s is of each (n,)
    beside : of a step
    """
    which, unit = moving

    def cost(step: np.ndarray, there: Beside) -> float:
        left = factor @ step + right
        return float(left @ left + damping * (step @ step)) + there.cost

    def least(step: np.ndarray, there: Beside, walls: np.ndarray) -> tuple[np.ndarray, float]:
        """Move to the minimum of the model linearised at a step, with these walls (w,), and the cost there."""
        rows = [factor, np.sqrt(damping) * np.eye(step.size), there.along[:, which] * unit]
        values = [factor @ step + right, np.sqrt(damping) * step, there.read]
        if walls.size:
            bends = there.walls.bends[:, which] * unit
            rows += [there.walls.slopes[np.ix_(walls, which)] * unit, bends]
            values += [there.walls.values[walls], np.zeros(len(bends))]
        both = np.column_stack([np.concatenate(rows), np.concatenate(values)])
        triangle = np.asarray(np.linalg.qr(both, mode="r"))
        move = solve_triangular(triangle[:-1, :-1], -triangle[:-1, -1])
        return move, float(triangle[-1, -1] ** 2)

    def within(step: np.ndarray, there: Beside) -> tuple[np.ndarray, float]:
        """The same with the walls beyond which it is, found in turns."""
        walls: np.ndarray = np.flatnonzero(there.walls.values < 0)
        for _ in range(_SETS):
            move, promised = least(step, there, walls)
            ahead = there.walls.values + there.walls.slopes[:, which] @ (unit * move)
            beyond: np.ndarray = np.flatnonzero(ahead < 0)
            if np.array_equal(beyond, walls):
                break
            walls = beyond
        return move, promised

    step = np.zeros(unit.size)
    here = beside(step)
    first = now = cost(step, here)
    if not here.walls.touched:
        free, _ = least(step, here, np.zeros(0, dtype=int))
        there = beside(free)
        if not there.walls.touched and not there.read.size:
            return free, first - cost(free, there) + damping * (free @ free)
    for _ in range(_TURNS):
        move, promised = within(step, here)
        if now - promised < _SETTLED:
            break
        for _ in range(_HALVINGS):
            there = beside(step + move)
            then = cost(step + move, there)
            if then < now:
                break
            move = move / 2
        else:
            break
        step, here, gain, now = step + move, there, now - then, then
        if gain < max(_SETTLED, _SHARE * (first - now)):
            break
    return step, first - now + damping * float(step @ step)
