"""How far a planned measurement would tell two causes apart, in σ, by the model at the fits there are.

Two fits A and B explain the present data alike. In the planned data A predicts d_A. What B then misses, all its
unknowns (constants and effect) fitted again from where they stand, is their separation:

    min_x ‖ d_A − d_B(x) ‖,   whitened by the noise of the planned data.

An effect that a constant imitates is told from it as soon as its size is known against that constant: size/σ(size),
all other unknowns free.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import least_squares

from femu_piezo.effects.effect import Effect
from femu_piezo.inference.ensemble import Ensemble, is_common, owned_by
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.threads import Once

#: Most evaluations of a refit, relative gain of a step in χ² below which it has settled, and distance from bounds at
#: which it starts, over the range.
_EVALUATIONS, _SETTLED, _INSIDE = 40, 1e-3, 1e-9
#: Separation beyond which the figure has no meaning, and pairs told in one recommendation.
_FAR, _TOLD = 100, 3
#: Evaluations that are kept.
_KEPT = 4


@dataclass(frozen=True)
class Plan:
    """Data that there would be after a further measurement, the present ones included.

    Attributes
    ----------
    words : what to do
    evaluation : of all sweeps
    relative_noise : (k,) sqrt(E|δZ/Z|²) of theirs
    owner : name that effects get which belong to the one specimen there is now
    readings : direct readings: (effect name, its specimen) → (n,) slope of the reading in the effect's parameters over
        the reading's σ; readings of several effects add up to one number
    new_sweeps : whether there are sweeps beyond the present ones
    tolerances : further unknowns within their tolerances: what is known of a further specimen
    """

    words: str
    evaluation: Evaluation | Ensemble | Remembered
    relative_noise: np.ndarray = field(repr=False)
    owner: str = ""
    readings: Mapping[tuple[str, str], np.ndarray] = field(default_factory=dict)
    new_sweeps: bool = False
    tolerances: tuple[Effect, ...] = ()
    _triangles: Once = field(default_factory=lambda: Once(_KEPT), init=False, repr=False, compare=False)

    def widened(self, point: Point) -> Point:
        """The point with the unknowns of the plan, each where it is expected."""
        parameters = replace(point.parameters, effects=(*point.parameters.effects, *self.tolerances))
        expected = [effect.rest / effect.scale for effect in self.tolerances]
        among = None if point.among is None else self.widened(point.among)
        return Point(parameters, np.concatenate([point.x, *expected]), among)

    def owned(self, parameters: Unknowns) -> Unknowns:
        """The unknowns with every effect that is not common as that of its specimen."""

        def own(effect):
            return owned_by(effect, self.owner)

        renamed = {effect.key: own(effect).key for effect in parameters.effects}
        return replace(
            parameters,
            effects=tuple(own(effect) for effect in parameters.effects),
            candidates=tuple(renamed[key] for key in parameters.candidates),
            fixed=tuple((own(effect), values) for effect, values in parameters.fixed),
        )

    def predicted(self, parameters: Unknowns, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Whitened log Z of all sweeps as Re, Im, then the reading: (2k + 1,), and the Jacobian (2k + 1, n_x)."""
        owned = self.owned(parameters)
        z, slopes = self.evaluation.with_jacobian(owned, x)
        weight = np.sqrt(2.0) / self.relative_noise
        rows = slopes / z[:, None] * weight[:, None]
        reading, row = 0.0, np.zeros((1, x.size))
        for index, (effect, values) in enumerate(zip(owned.effects, owned.values(x), strict=True)):
            slope = self.readings.get((effect.name, "" if is_common(effect) else effect.specimen))
            if slope is not None:
                reading += float(slope @ (values - effect.rest))
                row[0, owned.columns(index)] = slope * effect.scale
        logs = np.log(z) * weight
        return np.concatenate([logs.real, logs.imag, [reading]]), np.concatenate([rows.real, rows.imag, row])

    def triangle(self, point: Point) -> np.ndarray:
        """(n, n_x) R of the Jacobian, whose columns have the lengths and angles of those of all data; kept."""
        key = point.parameters.names, point.x.tobytes()
        return self._triangles.get(
            key, lambda: np.asarray(np.linalg.qr(self.predicted(point.parameters, point.x)[1], mode="r"))
        )


@dataclass(frozen=True)
class Point:
    """Unknowns of a fit and where they stand.

    Attributes
    ----------
    x : (n_x,)
    among : a point of the same curve with further unknowns, whose slopes hold those of this one; None for itself
    """

    parameters: Unknowns
    x: np.ndarray
    among: Point | None = None


@dataclass(frozen=True)
class Remembered:
    """An evaluation that keeps what it was asked for last: plans of the same sweeps ask for the same."""

    evaluation: Evaluation | Ensemble
    _kept: Once = field(default_factory=lambda: Once(_KEPT), init=False, repr=False, compare=False)

    def with_jacobian(self, parameters: Unknowns, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Z (k,) and ∂Z/∂x (k, n_x), ohm."""
        key = parameters.names, x.tobytes()
        return self._kept.get(key, lambda: self.evaluation.with_jacobian(parameters, x))


@dataclass(frozen=True)
class Separation:
    """What a planned measurement would bring.

    Attributes
    ----------
    measurement : in words
    cause, other : titles of the two, the other an effect or a constant
    size : in words, the size of `cause` that the figure holds for where it is not named in the data; else ""
    now, expected : σ with the present data and with those of the plan
    """

    measurement: str
    cause: str
    other: str
    size: str
    now: float
    expected: float


def summary(planned: Sequence[Separation]) -> str:
    """What one measurement would bring for several pairs, the closest pairs first, as a recommendation."""
    ordered = sorted(planned, key=lambda one: one.expected)
    pairs = [
        f"{one.cause}{' of ' + one.size if one.size else ''} from {one.other} {_figure(one.expected)}"
        for one in ordered
    ]
    more = f" and {len(pairs) - _TOLD} more" if len(pairs) > _TOLD else ""
    return f"{ordered[0].measurement}: expected separation of {', '.join(pairs[:_TOLD])}{more}"


def _figure(sigma: float) -> str:
    if sigma > _FAR:
        return f"over {_FAR} σ"
    return f"{sigma:.{0 if sigma >= 10 else 1}f} σ"


def between(plan: Plan, first: Point, second: Point) -> float:
    """σ by which the second cause misses what the first predicts, all its unknowns refitted."""
    first, second = plan.widened(first), plan.widened(second)
    wanted, _ = plan.predicted(first.parameters, first.x)
    rows = _prior_rows(second)
    turn = 2 * np.pi * np.sqrt(2.0) / plan.relative_noise
    phases = slice(turn.size, 2 * turn.size)

    def pulled(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        reached, jacobian = plan.predicted(second.parameters, x)
        difference = reached - wanted
        difference[phases] -= turn * np.round(difference[phases] / turn)  # phases differ by less than half a turn
        return np.concatenate([difference, rows @ (x - second.x)]), np.concatenate([jacobian, rows])

    low, high = second.parameters.bounds.T
    found = least_squares(
        lambda x: pulled(x)[0],
        np.clip(second.x, low + _INSIDE * (high - low), high - _INSIDE * (high - low)),
        lambda x: pulled(x)[1],
        (low, high),
        x_scale="jac",
        ftol=_SETTLED,
        max_nfev=_EVALUATIONS,
    )
    return float(np.sqrt(2 * found.cost))


def strength(plan: Plan, point: Point, effect: int, size: float) -> float:
    """size/σ of the first parameter of the effect number `effect`, all other unknowns free; size in SI."""
    point = plan.widened(point)
    whole = point.among or point
    jacobian = plan.triangle(whole)[:, [whole.parameters.names.index(name) for name in point.parameters.names]]
    own = point.parameters.columns(effect)
    others = np.delete(np.arange(point.x.size), own.start)
    rows = _prior_rows(point)
    return (
        abs(size)
        / point.parameters.effects[effect].scale[0]
        * _left(jacobian[:, own.start], jacobian[:, others], rows[:, others])
    )


def _left(target: np.ndarray, jacobian: np.ndarray, prior: np.ndarray) -> float:
    """min_δ ‖(target, 0) − (jacobian, prior) δ‖."""
    whole = np.concatenate([jacobian, prior])
    padded = np.concatenate([target, np.zeros(len(prior))])
    return float(np.linalg.norm(padded - whole @ _solved(whole, padded)))


def _solved(matrix: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The least-squares solution, columns scaled to one."""
    norm = np.linalg.norm(matrix, axis=0)
    norm[norm == 0] = 1.0
    return np.linalg.lstsq(matrix / norm, target, rcond=1e-12)[0] / norm


def _prior_rows(point: Point) -> np.ndarray:
    """(m, n_x) slopes of the priors of everything but the sizes of causes, their first parameters."""
    parameters = point.parameters
    sizes = [parameters.columns(parameters.index(key)).start for key in parameters.candidates]
    return np.delete(np.diag(1 / parameters.prior_std), sizes, axis=0)
