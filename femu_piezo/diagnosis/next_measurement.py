"""How far a planned measurement would tell two causes apart, in σ, by the model at the fits there are.

Two fits A and B explain the present data alike. A predicts d_A for the planned data. The misfit of B to d_A, after all
unknowns of B (constants and effect) have been refitted from where they stand, is the separation of the two:

    min_x ‖ d_A − d_B(x) ‖,   whitened by the noise of the planned data.

The separation of an effect from a constant that imitates it is size/σ(size), all other unknowns free.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import least_squares

from femu_piezo.effects.effect import Effect, EffectParameter
from femu_piezo.effects.words import usual_size
from femu_piezo.inference.ensemble import Ensemble, with_default_owner
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.inference.walls import readings
from femu_piezo.threads import Once

#: Most evaluations of a refit, relative decrease of χ² in a step below which it has settled, and least distance of its
#: start from a bound, relative to the range.
_EVALUATIONS, _SETTLED, _INSIDE = 40, 1e-3, 1e-9
#: σ above which a separation is not stated as a figure, and most pairs named in one recommendation.
_FAR, _TOLD = 100, 3
#: Number of latest evaluations that are kept.
_KEPT = 4


@dataclass(frozen=True)
class Plan:
    """Data that there would be after a further measurement, the present ones included.

    Attributes
    ----------
    words : what to do
    evaluation : Z of all sweeps
    relative_noise : (k,) sqrt(E|δZ/Z|²) of all sweeps
    owner : name of the present specimen, for effects that belong to a specimen but name none
    readings : one direct reading: (effect name, its owner) → (n,) slope of the reading in the effect's parameters
        over the reading's σ; the contributions of several effects add up; empty for none
    new_sweeps : whether there are sweeps beyond the present ones
    tolerances : further unknowns, held by their tolerances: the uncertain sizes of a further specimen
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
        """The point with `tolerances` as further unknowns, each at rest."""
        parameters = replace(point.parameters, effects=(*point.parameters.effects, *self.tolerances))
        expected = [effect.rest / effect.scale for effect in self.tolerances]
        nested_in = None if point.nested_in is None else self.widened(point.nested_in)
        return Point(parameters, np.concatenate([point.x, *expected]), nested_in)

    def owned(self, parameters: Unknowns) -> Unknowns:
        """The unknowns, every effect that specimens do not share assigned to `owner` unless it names its specimen."""

        def own(effect):
            return with_default_owner(effect, self.owner)

        renamed = {effect.key: own(effect).key for effect in parameters.effects}
        return replace(
            parameters,
            effects=tuple(own(effect) for effect in parameters.effects),
            candidates=tuple(renamed[key] for key in parameters.candidates),
            fixed=tuple((own(effect), values) for effect, values in parameters.fixed),
        )

    def predicted(self, parameters: Unknowns, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Whitened log Z of all sweeps (Re, then Im) and the reading, (2k + 1,), and their Jacobian (2k + 1, n_x)."""
        owned = self.owned(parameters)
        z, slopes = self.evaluation.with_jacobian(owned, x)
        weight = np.sqrt(2.0) / self.relative_noise
        rows = slopes / z[:, None] * weight[:, None]
        reading, row = 0.0, np.zeros((1, x.size))
        for index, (effect, values) in enumerate(zip(owned.effects, owned.values(x), strict=True)):
            slope = self.readings.get((effect.name, effect.owner))
            if slope is not None:
                reading += float(slope @ (values - effect.rest))
                row[0, owned.columns(index)] = slope * effect.scale
        logs = np.log(z) * weight
        return np.concatenate([logs.real, logs.imag, [reading]]), np.concatenate([rows.real, rows.imag, row])

    def triangle(self, point: Point) -> np.ndarray:
        """(n, n_x) R of the QR of the Jacobian: its columns have the same norms and inner products; cached."""
        key = point.parameters.names, point.x.tobytes()
        return self._triangles.get(
            key, lambda: np.asarray(np.linalg.qr(self.predicted(point.parameters, point.x)[1], mode="r"))
        )


@dataclass(frozen=True)
class Point:
    """The unknowns of a fit and their values.

    Attributes
    ----------
    x : (n_x,) values, as of `Unknowns`
    nested_in : a point of the same Z with further unknowns, whose Jacobian has the columns of this point's; several
        points share its evaluation; None where the Jacobian is that of the point itself
    """

    parameters: Unknowns
    x: np.ndarray
    nested_in: Point | None = None


@dataclass(frozen=True)
class Remembered:
    """An evaluation that caches its latest results, since plans of the same sweeps evaluate the same points."""

    evaluation: Evaluation | Ensemble
    _kept: Once = field(default_factory=lambda: Once(_KEPT), init=False, repr=False, compare=False)

    def with_jacobian(self, parameters: Unknowns, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Z (k,) and ∂Z/∂x (k, n_x), ohm."""
        key = parameters.names, x.tobytes()
        return self._kept.get(key, lambda: self.evaluation.with_jacobian(parameters, x))


@dataclass(frozen=True)
class Separation:
    """How far a planned measurement would tell a cause from another explanation.

    Attributes
    ----------
    measurement : in words
    cause, other : title of the cause, and title of another effect or name of a constant
    parameter : whose usual size the separation holds for; None where the verdict names the size of `cause`
    now, expected : separation in σ with the present data and with those of the plan
    """

    measurement: str
    cause: str
    other: str
    parameter: EffectParameter | None
    now: float
    expected: float

    @property
    def size(self) -> str:
        """The usual size of `parameter` in words; "" without one."""
        return "" if self.parameter is None else usual_size(self.parameter)

    def to_json(self) -> dict[str, str | float]:
        """An item of "separations" in diagnosis.json; its size is in SI units."""
        one = self.parameter
        return {
            "measurement": self.measurement,
            "cause": self.cause,
            "other": self.other,
            "size": "" if one is None else f"{one.usual:.2g}{one.after_number}",
            "now": self.now,
            "expected": self.expected,
        }


def summary(planned: Sequence[Separation]) -> str:
    """A recommendation in words: one measurement and the separation it would bring for several pairs, least first."""
    ordered = sorted(planned, key=lambda one: one.expected)
    pairs = [
        f"{one.cause}{' of ' + one.size if one.size else ''} from {one.other} by {_figure(one.expected)}"
        for one in ordered
    ]
    more = f" and {len(pairs) - _TOLD} more" if len(pairs) > _TOLD else ""
    return f"{ordered[0].measurement}: expected to distinguish {', '.join(pairs[:_TOLD])}{more}"


def _figure(sigma: float) -> str:
    if sigma > _FAR:
        return f"over {_FAR} σ"
    return f"{sigma:.{0 if sigma >= 10 else 1}f} σ"


def separation(plan: Plan, first: Point, second: Point) -> float:
    """Separation in σ: misfit of the second point to what the first predicts, all unknowns of the second refitted."""
    first, second = plan.widened(first), plan.widened(second)
    target, read = plan.predicted(first.parameters, first.x)[0], readings(first.parameters, first.x)[0]
    rows = _prior_rows(second)
    turn = 2 * np.pi * np.sqrt(2.0) / plan.relative_noise
    phases = slice(turn.size, 2 * turn.size)

    def misfit(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual of data, priors and the readings that the fits have seen, and its Jacobian."""
        predicted, jacobian = plan.predicted(second.parameters, x)
        difference, (value, along) = predicted - target, readings(second.parameters, x)
        difference[phases] -= turn * np.round(difference[phases] / turn)  # phases differ by less than half a turn
        residual = np.concatenate([difference, rows @ (x - second.x), value - read])
        return residual, np.concatenate([jacobian, rows, along])

    low, high = second.parameters.bounds.T
    solution = least_squares(
        lambda x: misfit(x)[0],
        np.clip(second.x, low + _INSIDE * (high - low), high - _INSIDE * (high - low)),
        lambda x: misfit(x)[1],
        (low, high),
        x_scale="jac",
        ftol=_SETTLED,
        max_nfev=_EVALUATIONS,
    )
    return float(np.sqrt(2 * solution.cost))


def strength(plan: Plan, point: Point, effect: int, size: float) -> float:
    """size/σ of the first parameter of the effect number `effect`, all other unknowns free; size in SI."""
    point = plan.widened(point)
    whole = point.nested_in or point
    jacobian = plan.triangle(whole)[:, [whole.parameters.names.index(name) for name in point.parameters.names]]
    column = point.parameters.columns(effect).start
    others = np.delete(np.arange(point.x.size), column)
    jacobian = np.concatenate([jacobian, readings(point.parameters, point.x)[1]])
    rows = _prior_rows(point)
    return (
        abs(size)
        / point.parameters.effects[effect].scale[0]
        * _outside(jacobian[:, column], jacobian[:, others], rows[:, others])
    )


def _outside(target: np.ndarray, jacobian: np.ndarray, prior: np.ndarray) -> float:
    """min_δ ‖(target, 0) − (jacobian, prior) δ‖: the part of a column that the other unknowns do not explain."""
    whole = np.concatenate([jacobian, prior])
    padded = np.concatenate([target, np.zeros(len(prior))])
    return float(np.linalg.norm(padded - whole @ _solved(whole, padded)))


def _solved(matrix: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The least-squares solution, by columns scaled to norm 1."""
    norm = np.linalg.norm(matrix, axis=0)
    norm[norm == 0] = 1.0
    return np.linalg.lstsq(matrix / norm, target, rcond=1e-12)[0] / norm


def _prior_rows(point: Point) -> np.ndarray:
    """(m, n_x) Jacobian of all priors except those of the sizes (first parameters) of causes, which are free."""
    parameters = point.parameters
    sizes = [parameters.columns(parameters.index(key)).start for key in parameters.candidates]
    return np.delete(np.diag(1 / parameters.prior_std), sizes, axis=0)
