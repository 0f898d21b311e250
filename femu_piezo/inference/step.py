"""One damped Gauss-Newton step of a fit with walls, which cost only where an eigenvalue is negative.

    min over low ≤ s ≤ high   |F s + r|² + δ |s|² + Σ min(0, λ_i(s))²/TOLERANCE² + Σ readings²

F and r are data and priors, linearised. The walls (`femu_piezo.inference.walls`) and the readings of other instruments
cost next to nothing to evaluate and are not linearised. The minimum is approached from beyond the walls, by cutting
planes (Kelley, J. SIAM 8 (1960) 703): a material that passes no wall fulfils λ_i + ∇λ_i·(s − s_k) ≥ 0 for every
eigenvalue at every s_k, as the loss matrix is linear in the losses. Each turn adds the planes of the eigenvalues that
are beyond their walls at the minimum of the turn before. So a step that begins on a wall slides along it. Bounds of
unknowns are planes that no step passes; the other unknowns make up for what a bounded one cannot do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from femu_piezo.inference.triangle import solved
from femu_piezo.inference.walls import Walls, WallsAndReadings

#: Most turns within one step; most halvings of a step that no turn has brought to a lower cost; most iterations of the
#: non-negative least squares over the number of planes.
_TURNS, _HALVINGS, _PASSES = 20, 20, 30
#: Slope of the planes that stand for bounds: where the data determine an unknown to a thousandth of its prior standard
#: deviation, at most 1e-6 of a step lies beyond the bound, and less where they determine it less.
_HARD = 1e6
#: The turns end where χ² is above the minimum that the planes allow by less than the first number, or by less than the
#: second times the gain so far: the model of the data is only linear, so that more turns gain nothing.
_SETTLED, _SHARE = 1e-7, 1e-2


#: Planes G s + c ≥ 0: G (p, n) and c (p,).
_Planes = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class _Linearised:
    """Data and priors, linearised at the start of a step, and the least distance from the walls.

    Attributes
    ----------
    factor, right : F (m, n), r (m,);  damping : δ
    which, unit : numbers (n,) of the unknowns that move, and change (n,) of each for s = 1
    margins : value, over the tolerance, that every eigenvalue should keep at least
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

    def cost(self, step: np.ndarray, there: WallsAndReadings) -> float:
        """Cost of a step (n,), its damping included."""
        misfit, passed = self.factor @ step + self.right, np.minimum(there.walls.values - self.margins, 0.0)
        return float(misfit @ misfit + self.damping * (step @ step) + passed @ passed + there.read @ there.read)

    def planes(self, step: np.ndarray, walls: Walls, chosen: np.ndarray) -> _Planes:
        """Tangent planes of the eigenvalues number `chosen` (p,) at a step (n,); without any, no slopes are made."""
        if not chosen.size:
            return np.zeros((0, step.size)), np.zeros(0)
        slopes = walls.slopes[np.ix_(chosen, self.which)] * self.unit
        return slopes, (walls.values - self.margins)[chosen] - slopes @ step

    def least(self, planes: _Planes, near: np.ndarray, there: WallsAndReadings) -> tuple[np.ndarray, float]:
        """The step (n,) of least cost with planes and bounds, readings linearised about the step `near`; its cost.

        With R of all rows but the planes, s₀ the minimum without planes, W = R⁻ᵗGᵗ, and μ ≥ 0 how far s is beyond each,

            s = s₀ + R⁻¹W μ,    |μ + G s₀ + c|² + |W μ|² least,    the cost |R (s − s₀)|² + |μ|² over that of s₀.
        """
        size, along = self.unit.size, there.along[:, self.which] * self.unit
        rows = np.concatenate([self.factor, np.sqrt(self.damping) * np.eye(size), along])
        values = np.concatenate([self.right, np.zeros(size), there.read - along @ near])
        triangle = np.asarray(np.linalg.qr(np.column_stack([rows, values]), mode="r"))
        step, more = _least_with_planes(triangle[:-1], planes, self.low, self.high)
        return step, float(triangle[-1, -1] ** 2) + more


def bounded_step(rows: np.ndarray, values: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The step s (n,) of least |A s + b|² for rows A (m, n) and values b (m,), low ≤ s ≤ high."""
    triangle = np.asarray(np.linalg.qr(np.column_stack([rows, values]), mode="r"))
    return _least_with_planes(triangle[: low.size], (np.zeros((0, low.size)), np.zeros(0)), low, high)[0]


def _least_with_planes(
    triangle: np.ndarray, planes: _Planes, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, float]:
    """The step (n,) of least |R s + v|² + |μ|², [R, v] (n, n + 1) upper triangular, and that cost less min |R s + v|².

    μ ≥ 0 is how far the step is beyond each plane; bounds become planes once the step would leave them.
    """
    upper, (slopes, offsets) = triangle[:, :-1], planes
    free, size = solved(upper, -triangle[:, -1]), low.size
    held, step, cost = np.zeros(size, dtype=bool), free, 0.0
    while True:
        ahead = slopes @ free + offsets
        if np.any(ahead < 0):
            through = solved(upper, slopes.T, transposed=True)
            system = np.concatenate([np.eye(len(slopes)), through])
            try:
                passed, _ = nnls(system, np.append(-ahead, np.zeros(size)), maxiter=_PASSES * len(slopes))
            except RuntimeError:  # not converged: the last step; `damped_step` halves it where it costs more
                return np.clip(step, low, high), cost
            moved = through @ passed
            step, cost = free + solved(upper, moved), float(moved @ moved + passed @ passed)
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
    terms: Callable[[np.ndarray], WallsAndReadings],
    kept: float = 0.0,
    bounds: tuple[np.ndarray, np.ndarray] | None = None,
) -> tuple[np.ndarray, float]:
    """The step s (n,) and what it gains without the damping.

    Parameters
    ----------
    factor, right : F (m, n), r (m,);  damping : δ
    moving : numbers (n,) of the unknowns that move, and change (n,) of each for s = 1
    terms : step (n,) → walls and readings there
    kept : share of the distance to every wall that the step keeps
    bounds : (n,) lowest and (n,) highest step; none where None
    """
    low, high = bounds or (np.full(right.size, -np.inf), np.full(right.size, np.inf))
    start = np.zeros(right.size)
    here = terms(start)
    model = _Linearised(factor, right, damping, *moving, kept * np.maximum(here.walls.values, 0.0), low, high)
    numbers = np.arange(here.walls.values.size)
    # slopes of walls are computed only once one is near, which is rare
    planes = model.planes(start, here.walls, numbers if here.walls.touched else numbers[:0])
    first, nearest = model.cost(start, here), np.min(here.walls.values - model.margins)
    best, lowest, near, there = start, first, start, here
    for _ in range(_TURNS):
        step, promised = model.least(planes, near, there)
        near, there = step, terms(step)
        reached = model.cost(step, there)
        if reached < lowest:
            best, lowest = step, reached
        if reached - promised < max(_SETTLED, _SHARE * (first - lowest)):
            break
        if not len(planes[0]):
            planes = model.planes(start, here.walls, numbers)
        slopes, offsets = model.planes(step, there.walls, np.flatnonzero(there.walls.values < model.margins))
        # only the nonlinear action of real parts could put a plane below the least eigenvalue at the start
        planes = np.concatenate([planes[0], slopes]), np.concatenate([planes[1], np.maximum(offsets, nearest)])
    for _ in range(_HALVINGS):  # eigenvalues are not linear in the real parts
        if lowest < first:
            break
        step = step / 2
        best, lowest = step, model.cost(step, terms(step))
    return best, first - lowest + damping * float(best @ best)
