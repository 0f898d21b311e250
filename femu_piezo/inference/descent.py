"""The way down of a fit: Levenberg and Marquardt within bounds and walls, the level of the noise found on the way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from scipy.linalg import solve_triangular

from femu_piezo.errors import ConvergenceError
from femu_piezo.inference.losses import LOSS, level_of, weight_of
from femu_piezo.inference.step import Beside, damped_step
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.inference.walls import Walls, readings
from femu_piezo.measurement.sweeps import SweepData
from femu_piezo.threads import Once, in_parallel

#: Gain in χ² at the noise level below which a coarse fit stops, one that is to be ranked, and a close one: there the
#: squares of the deviations that unknowns are away sum up to this. Most evaluations of a coarse fit and of the others.
COARSE, RANKED, CLOSE = 1.0, 0.03, 1e-6
FEW, MANY = 12, 100
#: A descent is on its way while its next step promises more than this share of χ². One of several is compared with the
#: others when it no longer is, or after so many runs of `FEW` evaluations.
_ON_ITS_WAY, _RUNS = 0.1, 4
#: Evaluations over which what each brings is averaged.
_PACE = 15
#: Gain in χ² at the noise level that a close fit may still promise when it runs out of evaluations.
UNSETTLED = 10.0
#: Damping of the first step, in the precision of the prior, the least that changes a step, and the factors by which it
#: falls and, from there on, rises; shares of what a step promised, above which it falls and below which it rises.
_DAMPING, _FELT, _EASED, _RAISED, _KEPT, _BROKEN = 1e-3, 0.1, 0.1, 10.0, 0.75, 0.25
#: Noise level above which a fit is far from its end, and the share of the distance to every wall that its steps keep
#: there as long as they gain by it: along a wall it would slide to minima that a fit which comes from inside passes by.
_FAR, _DISTANCE = 2.0, 0.5
#: Places at which what needs no Z is kept.
_PLACES = 4
#: Change of the logarithm of the noise level below which a fit counts as made at it.
NEAR_LEVEL = 0.03


class Response(Protocol):
    """Z of the sweeps at given unknowns (`Evaluation`, `Ensemble`)."""

    def impedance(self, parameters: Unknowns, x: np.ndarray) -> np.ndarray:
        """Z (k,), ohm."""

    def with_jacobian(self, parameters: Unknowns, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Z (k,), ohm, and its slopes (k, n_x)."""

    def at(self, factor: float) -> Response:
        """The same at frequencies larger by a factor."""


#: Whitened residual and Jacobian of the data, then those of priors and wall.
Parts = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Posterior:
    """What a fit minimises."""

    response: Response
    data: SweepData
    parameters: Unknowns
    _beside: Once = field(default_factory=lambda: Once(_PLACES), init=False, repr=False, compare=False)

    def parts(self, x: np.ndarray) -> Parts:
        """Residuals and Jacobians at x (n_x,)."""
        std, beside = self.parameters.prior_std, self.beside(x)
        return (
            *self.data.whitened(*self.response.with_jacobian(self.parameters, x)),
            np.concatenate([(x - self.parameters.prior_mean) / std, beside.walls.rows, beside.read]),
            np.concatenate([np.diag(1 / std), beside.walls.row_slopes, beside.along]),
        )

    def beside(self, x: np.ndarray) -> Beside:
        """What needs no Z; kept, as a step asks for it where it begins and a fit where it ends."""
        return self._beside.get(x.tobytes(), lambda: Beside(Walls(self.parameters, x), *readings(self.parameters, x)))


@dataclass(frozen=True)
class MovedPosterior(Posterior):
    """What a fit minimises where the whitened data are moved by (2k,), and priors and readings by (n_x + m,)."""

    moved: np.ndarray
    pulled: np.ndarray

    def parts(self, x: np.ndarray) -> Parts:
        """Residuals and Jacobians at x (n_x,)."""
        residual, jacobian, further, slopes = super().parts(x)
        further[: x.size] += self.pulled[: x.size]
        return residual + self.moved, jacobian, further, slopes

    def beside(self, x: np.ndarray) -> Beside:
        """What needs no Z, the readings moved."""
        plain = super().beside(x)
        return replace(plain, read=plain.read + self.pulled[self.pulled.size - plain.read.size :])


class Descent:
    """Levenberg-Marquardt within bounds, unknowns in units of their prior standard deviations.

    The noise level is an unknown among the others: every step is made at the one that is most probable with what the
    steps before have left. So far from the solution, where the misfit is large, data count for less against priors and
    a robust loss sets hardly anything aside; both come into force as the misfit falls to the noise. An unknown on its
    bound stays there while the gradient points outwards; steps end at bounds. χ² has a natural unit, so the
    descent ends where the next step promises less than a given gain.

    Attributes
    ----------
    x : (n_x,) where it stands;  parts : residuals and Jacobians there
    level : factor on the noise; `fixed` where that is given
    promise : gain in χ² that the next step promises, as last computed at `_promised_at`; it leads to `_ahead`
    """

    def __init__(self, posterior: Posterior, start: np.ndarray, loss: str, fixed: float | None = None) -> None:
        self.posterior, self.loss, self._fixed = posterior, loss, fixed
        self._low, self._high = posterior.parameters.bounds.T
        margin = posterior.parameters.margin
        self.x = np.clip(start, self._low + margin, self._high - margin)
        self.parts = posterior.parts(self.x)
        self.level, self.promise, self._damping, self._determined = np.inf, np.inf, _DAMPING, 0.0
        self._ahead, self._promised_at = self.x, None

    def cost(self, parts: Parts, level: float) -> float:
        """χ² of data and priors at a noise level, as the loss counts it."""
        residual, _, further, _ = parts
        cost = float(np.sum(LOSS[self.loss][0]((residual / level) ** 2)) + further @ further)
        return cost if np.isfinite(cost) else np.inf

    def run(self, gain: float, most: int) -> Descent:
        """Descend until the next step promises less than `gain`, or evaluations bring less; by at most so many."""
        count, seen, gained = 0, 0, 0.0
        while count < most and np.isfinite(self.cost(self.parts, self.level)):
            if count >= seen + _PACE:
                if gained < _PACE * gain:  # along a ridge that bends
                    return self
                seen, gained = count, 0.0
            before = self.level
            self._settle_level()
            settled = abs(np.log(before / self.level)) < NEAR_LEVEL
            told = settled and self._promised_at is self.x  # by the run before
            linear = None
            here = self.cost(self.parts, self.level)
            while count < most:
                if not told:
                    linear = linear or self._linear(self.x, self.parts)
                    self._ahead, self.promise = self._stepped(self.x, *linear)
                    self._promised_at = self.x
                if self.promise < gain and settled:
                    return self
                count, told, other = count + 1, False, self._ahead
                if self.promise < gain:  # the level alone moves yet
                    break
                parts = self.posterior.parts(other)
                kept = (here - self.cost(parts, self.level)) / self.promise
                if -np.inf < kept < 0 and count < most:
                    # one step along a ridge that bends ends beside it, and the next one comes back
                    further, _ = self._stepped(other, *self._linear(other, parts))
                    beyond, count = self.posterior.parts(further), count + 1
                    back = (here - self.cost(beyond, self.level)) / self.promise
                    if back > _BROKEN:
                        other, parts, kept = further, beyond, back
                if kept > _KEPT:
                    self._damping *= _EASED
                elif kept < _BROKEN:
                    self._damping = max(self._damping, _FELT) * _RAISED
                if kept > 0:
                    self.x, self.parts = other, parts
                    gained += kept * self.promise
                    break
        return self

    def leap(self, count: int) -> None:
        """Full steps, whatever they cost; back to where it stood unless the last one is the best."""
        best = self.x, self.parts
        for _ in range(count):
            self._settle_level()
            self.x, _ = self._stepped(self.x, *self._linear(self.x, self.parts))
            self.parts = self.posterior.parts(self.x)
        if not self.cost(self.parts, self.level) < self.cost(best[1], self.level):
            self.x, self.parts = best

    def _settle_level(self) -> None:
        """The most probable noise level with what is left here."""
        residual, known = self.parts[0], self.posterior.data.level_std
        weight, free = weight_of(self.loss, residual / self.level), residual.size - self._determined
        self.level = self._fixed or level_of(weight * residual**2, weight, self.loss, free, known)

    def _linear(self, x: np.ndarray, parts: Parts) -> tuple[np.ndarray, np.ndarray]:
        """Unknowns that may move, and R of Jacobian and residual of data and priors at x (n_x,), at the noise level."""
        residual, jacobian, further, slopes = parts
        share = np.sqrt(weight_of(self.loss, residual / self.level)) / self.level
        std = self.posterior.parameters.prior_std
        own = np.column_stack([jacobian * std, residual]) * share[:, None]
        beside = np.column_stack([slopes * std, further])
        gradient = own[:, :-1].T @ own[:, -1] + beside[:, :-1].T @ beside[:, -1]
        held = ((x <= self._low) & (gradient > 0)) | ((x >= self._high) & (gradient < 0))
        moving = np.flatnonzero(~held)
        rows = np.concatenate([own, beside[: x.size]])
        triangle = np.asarray(np.linalg.qr(rows[:, [*moving, -1]], mode="r"))
        of_data = solve_triangular(triangle[:-1, :-1], own[:, moving].T, trans="T")
        self._determined = float(np.sum(of_data**2))
        return moving, triangle

    def _stepped(self, x: np.ndarray, moving: np.ndarray, triangle: np.ndarray) -> tuple[np.ndarray, float]:
        """Where the damped step from x (n_x,) leads, and the gain that it promises."""
        std = self.posterior.parameters.prior_std[moving]

        def at(step: np.ndarray) -> np.ndarray:
            found = x.copy()
            found[moving] = np.clip(x[moving] + std * step, self._low[moving], self._high[moving])
            return found

        for kept in (_DISTANCE, 0.0) if self.level > _FAR else (0.0,):
            step, gain = damped_step(
                triangle[: moving.size, :-1],
                triangle[: moving.size, -1],
                self._damping,
                (moving, std),
                lambda step: self.posterior.beside(at(step)),
                kept,
                ((self._low - x)[moving] / std, (self._high - x)[moving] / std),
            )
            if gain > COARSE:
                break
        return at(step), gain


def descended(posterior: Posterior, starts: Sequence[np.ndarray], gain: float, loss: str) -> Descent:
    """The best of several descents from starts (n_x,), at its end; arguments as of `fit`."""

    def comparable(start: np.ndarray) -> Descent:
        """A descent from there; one that takes a detour lies above others that have settled, until it has gone on."""
        one = Descent(posterior, start, loss)
        for _ in range(_RUNS if len(starts) > 1 else 1):
            one.run(COARSE, FEW)
            if not one.promise > _ON_ITS_WAY * one.cost(one.parts, one.level):
                break
        return one

    ends: list[Descent] = list(in_parallel(comparable, starts))
    level = min(one.level for one in ends)
    best = min(ends, key=lambda one: one.cost(one.parts, level))
    coarse = gain >= COARSE
    if not coarse:
        best.run(gain, MANY)
    if not np.isfinite(best.cost(best.parts, best.level)) or (not coarse and best.promise > UNSETTLED):
        raise ConvergenceError(
            f"no fit of {', '.join(posterior.parameters.material.free.names)} settled: check dimensions, density and "
            "poling, or free fewer constants"
        )
    return best
