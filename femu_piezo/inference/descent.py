"""The descent of a fit: Levenberg-Marquardt steps within bounds and walls, the noise level estimated on the way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from femu_piezo.errors import ConvergenceError
from femu_piezo.inference.losses import LOSS, level_of, weight_of
from femu_piezo.inference.step import damped_step
from femu_piezo.inference.triangle import solved
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.inference.walls import WallsAndReadings, further_rows
from femu_piezo.measurement.sweeps import SweepData
from femu_piezo.threads import Once, in_parallel

#: A coarse fit, one that is to be ranked and a close one stop where the next step promises a smaller gain in χ² (at the
#: noise level) than this. The gain is also Σ (distance of an unknown from the minimum over its standard deviation)².
COARSE, RANKED, CLOSE = 1.0, 0.03, 1e-6
#: Most evaluations of a coarse fit, and of the others.
FEW, MANY = 12, 100
#: A descent is on its way while its next step promises more than this share of χ². Several descents are compared once
#: each has ceased to be on its way, or has made so many runs of `FEW` evaluations.
_ON_ITS_WAY, _RUNS = 0.1, 4
#: Evaluations over which the gain per evaluation is averaged.
_PACE = 15
#: Gain in χ² at the noise level that the next step of a close fit may still promise after the last evaluation.
UNSETTLED = 10.0
#: Damping of the first step, in units of the prior precision; the least damping that changes a step, from which it
#: rises at least; the factors by which it falls and rises. It falls where a step gained more than the first share of
#: what it promised, and rises where it gained less than the second.
_DAMPING, _FELT, _EASED, _RAISED, _KEPT, _BROKEN = 1e-3, 0.1, 0.1, 10.0, 0.75, 0.25
#: Noise level above which a fit is far from its end. There its steps keep this share of their distance to every wall,
#: unless they gain less than `COARSE` so: a fit that slides along a wall may end in a minimum that one from the inside
#: does not meet.
_FAR, _DISTANCE = 2.0, 0.5
#: Number of points x at which walls and readings are kept, which need no Z.
_PLACES = 4
#: Change of the logarithm of the noise level below which the level of a fit counts as settled.
NEAR_LEVEL = 0.03


class Response(Protocol):
    """Z of the sweeps at given unknowns (`Evaluation`, `Ensemble`)."""

    def impedance(self, parameters: Unknowns, x: np.ndarray) -> np.ndarray:
        """Z (k,), ohm."""

    def with_jacobian(self, parameters: Unknowns, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Z (k,), ohm, and its slopes (k, n_x)."""

    def at(self, factor: float) -> Response:
        """This response at frequencies multiplied by a factor."""


#: Whitened residual (2k,) and Jacobian (2k, n_x) of the data, then those (m,), (m, n_x) of priors, walls, readings.
Parts = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Posterior:
    """The terms of the cost that a fit minimises: data, priors, walls and readings."""

    response: Response
    data: SweepData
    parameters: Unknowns
    _kept: Once = field(default_factory=lambda: Once(_PLACES), init=False, repr=False, compare=False)

    def parts(self, x: np.ndarray) -> Parts:
        """Residuals and Jacobians at x (n_x,)."""
        data = self.data.whitened(*self.response.with_jacobian(self.parameters, x))
        return *data, *further_rows(self.parameters, x, self.walls_and_readings(x))

    def walls_and_readings(self, x: np.ndarray) -> WallsAndReadings:
        """Walls and readings at x (n_x,), which need no Z; kept, as a step and `parts` ask for them at the same x."""
        return self._kept.get(x.tobytes(), lambda: WallsAndReadings.at(self.parameters, x))


@dataclass(frozen=True)
class MovedPosterior(Posterior):
    """The terms of the cost of a fit to perturbed data.

    Attributes
    ----------
    moved : (2k,) added to the whitened residual of the data
    pulled : (m,) added to the residuals of the priors, its first n_x, and of the readings, its last
    """

    moved: np.ndarray
    pulled: np.ndarray

    def parts(self, x: np.ndarray) -> Parts:
        """Residuals and Jacobians at x (n_x,)."""
        residual, jacobian, further, slopes = super().parts(x)
        further[: x.size] += self.pulled[: x.size]
        return residual + self.moved, jacobian, further, slopes

    def walls_and_readings(self, x: np.ndarray) -> WallsAndReadings:
        """Walls and perturbed readings at x (n_x,)."""
        plain = super().walls_and_readings(x)
        return replace(plain, read=plain.read + self.pulled[self.pulled.size - plain.read.size :])


@dataclass(frozen=True)
class _Linear:
    """A model linearised at some point, unknowns in prior standard deviations.

    Attributes
    ----------
    moving : (n,) numbers of the unknowns that may move
    triangle : (n + 1, n + 1) R of their Jacobian and of the residual, data and priors
    determined : number of unknowns that the data determine, Σ (1 − posterior/prior variance)
    """

    moving: np.ndarray
    triangle: np.ndarray
    determined: float


class Descent:
    """Levenberg-Marquardt within bounds, unknowns in units of their prior standard deviations.

    The noise level is an unknown too: every step is made at the level that is most probable for the residual at its
    start. Far from the solution, where the misfit is large, the data thus weigh less against the priors and a robust
    loss sets hardly any point aside; both effects vanish as the misfit falls to the noise. An unknown on its bound
    stays there while the cost falls outwards; steps end at bounds. χ² has a natural unit, so the descent ends where
    the next step promises less than a given gain.

    Attributes
    ----------
    x : (n_x,) current unknowns;  parts : residuals and Jacobians there
    level : factor on the noise; `fixed` where that is given
    promised_gain : gain in χ² that the next step promises, last computed at `_promised_at`; this step leads to `_ahead`
    """

    def __init__(self, posterior: Posterior, start: np.ndarray, loss: str, fixed: float | None = None) -> None:
        self.posterior, self.loss, self._fixed = posterior, loss, fixed
        self._low, self._high = posterior.parameters.bounds.T
        margin = posterior.parameters.margin
        self.x = np.clip(start, self._low + margin, self._high - margin)
        self.parts = posterior.parts(self.x)
        self.level, self.promised_gain, self._damping, self._determined = np.inf, np.inf, _DAMPING, 0.0
        self._ahead, self._promised_at = self.x, None

    def cost(self, parts: Parts, level: float) -> float:
        """χ² of data (by the loss), priors, walls and readings at a noise level; inf where it is not finite."""
        residual, _, further, _ = parts
        cost = float(np.sum(LOSS[self.loss][0]((residual / level) ** 2)) + further @ further)
        return cost if np.isfinite(cost) else np.inf

    def run(self, gain: float, most: int) -> Descent:
        """Descend until a step promises, or evaluations gain on average, less than `gain`; by `most` evaluations."""
        count, seen, gained = 0, 0, 0.0
        while count < most and np.isfinite(self.cost(self.parts, self.level)):
            if count >= seen + _PACE:
                if gained < _PACE * gain:  # along a curved ridge
                    return self
                seen, gained = count, 0.0
            before = self.level
            self._settle_level()
            settled = abs(np.log(before / self.level)) < NEAR_LEVEL
            promised = settled and self._promised_at is self.x  # in the run before
            linear = None
            here = self.cost(self.parts, self.level)
            while count < most:
                if not promised:
                    linear = linear or self._linear(self.x, self.parts)
                    self._determined = linear.determined
                    self._ahead, self.promised_gain = self._stepped(self.x, linear)
                    self._promised_at = self.x
                if self.promised_gain < gain and settled:
                    return self
                count, promised, ahead = count + 1, False, self._ahead
                if self.promised_gain < gain:  # only the level has not settled
                    break
                parts = self.posterior.parts(ahead)
                share = (here - self.cost(parts, self.level)) / self.promised_gain
                if -np.inf < share < 0 and count < most:
                    # a step along a curved ridge ends off it, and the next one comes back to it
                    further, _ = self._stepped(ahead, self._linear(ahead, parts))
                    beyond, count = self.posterior.parts(further), count + 1
                    share_back = (here - self.cost(beyond, self.level)) / self.promised_gain
                    if share_back > _BROKEN:
                        ahead, parts, share = further, beyond, share_back
                if share > _KEPT:
                    self._damping *= _EASED
                elif share < _BROKEN:
                    self._damping = max(self._damping, _FELT) * _RAISED
                if share > 0:
                    self.x, self.parts = ahead, parts
                    gained += share * self.promised_gain
                    break
        return self

    def leap(self, count: int) -> None:
        """Make so many steps, whatever they cost; go back to the start unless the last one ends lower."""
        best = self.x, self.parts
        for _ in range(count):
            self._settle_level()
            linear = self._linear(self.x, self.parts)
            self._determined = linear.determined
            self.x, _ = self._stepped(self.x, linear)
            self.parts = self.posterior.parts(self.x)
        if not self.cost(self.parts, self.level) < self.cost(best[1], self.level):
            self.x, self.parts = best

    def _settle_level(self) -> None:
        """Set the noise level: the fixed one, or the most probable one for the residual at x."""
        residual, known = self.parts[0], self.posterior.data.level_std
        weight, free = weight_of(self.loss, residual / self.level), residual.size - self._determined
        self.level = self._fixed or level_of(weight * residual**2, weight, self.loss, free, known)

    def _linear(self, x: np.ndarray, parts: Parts) -> _Linear:
        """The model linearised at x (n_x,), without walls and readings, at the noise level."""
        residual, jacobian, further, slopes = parts
        share = np.sqrt(weight_of(self.loss, residual / self.level)) / self.level
        std = self.posterior.parameters.prior_std
        data_rows = np.column_stack([jacobian * std, residual]) * share[:, None]
        other_rows = np.column_stack([slopes * std, further])
        gradient = data_rows[:, :-1].T @ data_rows[:, -1] + other_rows[:, :-1].T @ other_rows[:, -1]
        held = ((x <= self._low) & (gradient > 0)) | ((x >= self._high) & (gradient < 0))
        moving = np.flatnonzero(~held)
        rows = np.concatenate([data_rows, other_rows[: x.size]])
        triangle = np.asarray(np.linalg.qr(rows[:, [*moving, -1]], mode="r"))
        # R^-1 R^-T is the covariance of the unknowns, whose priors have deviation 1
        inverse = solved(triangle[:-1, :-1], np.eye(moving.size))
        return _Linear(moving, triangle, moving.size - float(np.sum(inverse**2)))

    def _stepped(self, x: np.ndarray, linear: _Linear) -> tuple[np.ndarray, float]:
        """Point (n_x,) to which the damped step from x (n_x,) leads, and the gain that it promises."""
        moving, triangle = linear.moving, linear.triangle
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
                lambda step: self.posterior.walls_and_readings(at(step)),
                kept,
                ((self._low - x)[moving] / std, (self._high - x)[moving] / std),
            )
            if gain > COARSE:
                break
        return at(step), gain


def descended(posterior: Posterior, starts: Sequence[np.ndarray], gain: float, loss: str) -> Descent:
    """The best of coarse descents from several starts (n_x,), brought to its end; arguments as of `fit`."""

    def comparable(start: np.ndarray) -> Descent:
        """A coarse descent, continued while it is on its way: on a detour it costs more than settled ones."""
        one = Descent(posterior, start, loss)
        for _ in range(_RUNS if len(starts) > 1 else 1):
            one.run(COARSE, FEW)
            if not one.promised_gain > _ON_ITS_WAY * one.cost(one.parts, one.level):
                break
        return one

    ends: list[Descent] = list(in_parallel(comparable, starts))
    level = min(one.level for one in ends)
    best = min(ends, key=lambda one: one.cost(one.parts, level))
    coarse = gain >= COARSE
    if not coarse:
        best.run(gain, MANY)
    if not np.isfinite(best.cost(best.parts, best.level)) or (not coarse and best.promised_gain > UNSETTLED):
        raise ConvergenceError(
            f"no fit of {', '.join(posterior.parameters.material.free.names)} settled: check dimensions, density and "
            "poling, or free fewer constants"
        )
    return best
