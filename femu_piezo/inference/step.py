"""One damped step of Gauss and Newton beside walls, which are there from one side only.

    min over low ≤ s ≤ high   |F s + r|² + δ |s|² + Σ min(0, λ_i(s))²/TOLERANCE² + Σ readings²

F and r are data and priors, linearised; the walls (`femu_piezo.inference.walls`) and the readings of other instruments
cost next to nothing to evaluate and are taken as they are. The minimum is approached from beyond the walls, by cutting
planes (Kelley, J. SIAM 8 (1960) 703): a material that passes no wall fulfils λ_i + ∇λ_i·(s − s_k) ≥ 0 for every
eigenvalue at every s_k, as the loss matrix is linear in the losses. Each turn adds those of the eigenvalues that are
beyond their walls at the minimum of the turn before. So a step slides along a wall on which it begins. Bounds of
unknowns are planes that nothing passes: what an unknown cannot do the others make up for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from femu_piezo.inference.walls import Walls

#: Most turns within one step, most halvings of one that they do not bring to a lower cost, and most changes of the
#: planes that hold it, over their number.
_TURNS, _HALVINGS, _PASSES = 20, 20, 30
#: Slope of the planes that stand for bounds: passed by a share of 1e-6 of a step at most where data hold the unknown to
#: a thousandth of one, by less where they hold it less.
_HARD = 1e6
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


#: Planes G s + c ≥ 0: G (p, n) and c (p,).
_Planes = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class _Linearised:
    """Data and priors at the start of a step, and how far walls are kept away.

    Attributes
    ----------
    factor, right : F (m, n), r (m,);  damping : δ
    which, unit : unknowns that move (n,), and what one of s is of each (n,)
    margins : of every eigenvalue, what is left of it at least
    low, high : (n,) bounds of the step
    """

    factor: np.ndarray
    right: np.ndarray
    damping: float
    which: np.ndarray
    unit: np.ndarray
    margins: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def cost(self, step: np.ndarray, there: Beside) -> float:
        """At a step (n,), all beside the data as it is."""
        left, passed = self.factor @ step + self.right, np.minimum(there.walls.values - self.margins, 0.0)
        return float(left @ left + self.damping * (step @ step) + passed @ passed + there.read @ there.read)

    def planes(self, step: np.ndarray, walls: Walls, chosen: np.ndarray) -> _Planes:
        """Those of some eigenvalues (p,) at a step (n,); of none without a look at the slopes."""
        if not chosen.size:
            return np.zeros((0, step.size)), np.zeros(0)
        slopes = walls.slopes[np.ix_(chosen, self.which)] * self.unit
        return slopes, (walls.values - self.margins)[chosen] - slopes @ step

    def least(self, planes: _Planes, near: np.ndarray, there: Beside) -> tuple[np.ndarray, float]:
        """The step (n,) of least cost behind planes and within bounds, readings linear about the step `near`; its cost.

        With R of all rows but the planes, s₀ their minimum, W = R⁻ᵗGᵗ and what each plane is passed by, μ ≥ 0,

            s = s₀ + R⁻¹W μ,    |μ + G s₀ + c|² + |W μ|² least,    the cost |R (s − s₀)|² + |μ|² over that of s₀.
        """
        size, along = self.unit.size, there.along[:, self.which] * self.unit
        rows = np.concatenate([self.factor, np.sqrt(self.damping) * np.eye(size), along])
        values = np.concatenate([self.right, np.zeros(size), there.read - along @ near])
        triangle = np.asarray(np.linalg.qr(np.column_stack([rows, values]), mode="r"))
        step, more = _behind(triangle[:-1], planes, self.low, self.high)
        return step, float(triangle[-1, -1] ** 2) + more


def bounded_step(rows: np.ndarray, values: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The step s (n,) of least |A s + b|² for rows A (m, n) and values b (m,), low ≤ s ≤ high."""
    triangle = np.asarray(np.linalg.qr(np.column_stack([rows, values]), mode="r"))
    return _behind(triangle[: low.size], (np.zeros((0, low.size)), np.zeros(0)), low, high)[0]


def _behind(triangle: np.ndarray, planes: _Planes, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, float]:
    """The step (n,) of least |R s + v|² + |passed|², [R, v] (n, n + 1) upper triangular, and its cost over the least.

    Bounds are planes that are added where the step would leave them.
    """
    own, (slopes, offsets) = triangle[:, :-1], planes
    free, size = solve_triangular(own, -triangle[:, -1]), low.size
    held, step, cost = np.zeros(size, dtype=bool), free, 0.0
    while True:
        ahead = slopes @ free + offsets
        if np.any(ahead < 0):
            through = solve_triangular(own, slopes.T, trans="T")
            both = np.concatenate([np.eye(len(slopes)), through])
            try:
                passed, _ = nnls(both, np.append(-ahead, np.zeros(size)), maxiter=_PASSES * len(slopes))
            except RuntimeError:  # does not end: as far as it came, and halved where that costs more
                return np.clip(step, low, high), cost
            moved = through @ passed
            step, cost = free + solve_triangular(own, moved), float(moved @ moved + passed @ passed)
        leaving = ~held & ((step < low) | (step > high))
        if not np.any(leaving):
            return step, cost
        held |= leaving
        unit, sides = _HARD * np.eye(size)[leaving], (np.isfinite(low[leaving]), np.isfinite(high[leaving]))
        slopes = np.concatenate([slopes, unit[sides[0]], -unit[sides[1]]])
        ends = -low[leaving][sides[0]], high[leaving][sides[1]]
        offsets = np.concatenate([offsets, *(_HARD * end for end in ends)])


def damped_step(
    factor: np.ndarray,
    right: np.ndarray,
    damping: float,
    moving: tuple[np.ndarray, np.ndarray],
    beside: Callable[[np.ndarray], Beside],
    kept: float = 0.0,
    bounds: tuple[np.ndarray, np.ndarray] | None = None,
) -> tuple[np.ndarray, float]:
    """The step s (n,) and what it gains without the damping.

    Parameters
    ----------
    factor, right : F (m, n), r (m,);  damping : δ
    moving : which unknowns move (n,), and what one of s is of each (n,)
    beside : of a step
    kept : share of the distance to every wall that the step keeps
    bounds : of the step, (n,) lowest and (n,) highest; none where None
    """
    low, high = bounds or (np.full(right.size, -np.inf), np.full(right.size, np.inf))
    start = np.zeros(right.size)
    here = beside(start)
    model = _Linearised(factor, right, damping, *moving, kept * np.maximum(here.walls.values, 0.0), low, high)
    every = np.arange(here.walls.values.size)
    # most often no wall is near: its slopes are asked for once one is
    planes = model.planes(start, here.walls, every if here.walls.touched else every[:0])
    first, nearest = model.cost(start, here), np.min(here.walls.values - model.margins)
    best, lowest, near, there = start, first, start, here
    for _ in range(_TURNS):
        step, promised = model.least(planes, near, there)
        near, there = step, beside(step)
        reached = model.cost(step, there)
        if reached < lowest:
            best, lowest = step, reached
        if reached - promised < max(_SETTLED, _SHARE * (first - lowest)):
            break
        if not len(planes[0]):
            planes = model.planes(start, here.walls, every)
        slopes, offsets = model.planes(step, there.walls, np.flatnonzero(there.walls.values < model.margins))
        # at the start no plane lies lower than the least eigenvalue there, but for what real parts do to the walls
        planes = np.concatenate([planes[0], slopes]), np.concatenate([planes[1], np.maximum(offsets, nearest)])
    for _ in range(_HALVINGS):  # what real parts do to the walls is not linear
        if lowest < first:
            break
        step = step / 2
        best, lowest = step, model.cost(step, beside(step))
    return best, first - lowest + damping * float(best @ best)
