"""Control charts of a production (ISO 7870-2, Shewhart), and the drift of a quantity over time.

Individuals: limits from the moving range of two, so that a drift does not widen them. Lots (X̄): limits of the mean of
a lot from the scatter within lots. Drift: a line through the means of the lots. The variance between lots, beyond what
the scatter of their pieces explains, is estimated with the line (restricted likelihood) and enters the deviation of its
slope, as pieces of one lot are no independent evidence of a trend. An error that all pieces have in common (a density,
an instrument) makes no drift.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
from scipy import stats
from scipy.optimize import minimize_scalar

from femu_piezo.batch.lot import FALSE_ALARM, QUANTITIES

#: Fewest values that have control limits, and fewest lots or pieces that have a drift.
FEWEST, FEWEST_FOR_DRIFT = 8, 3
#: Number of values in a row on one side of the centre that is a shift (ISO 7870-2, test 2).
RUN = 9
#: Seconds of a month, and the shortest time over which anything drifts.
MONTH_S, SHORTEST_S = 365.25 / 12 * 86400, 86400.0
#: Mean moving range of two over the standard deviation of a normal variable.
_RANGE_OF_TWO = 2 / np.sqrt(np.pi)


@dataclass(frozen=True)
class Individuals:
    """Chart of single values (n,) in their order.

    Attributes
    ----------
    centre, sigma : mean, and the standard deviation from the mean moving range; limits : centre ± 3 sigma
    beyond : indices outside the limits;  shifted : indices that end `RUN` or more values on one side of the centre
    """

    centre: float
    sigma: float
    limits: tuple[float, float]
    beyond: tuple[int, ...]
    shifted: tuple[int, ...]


@dataclass(frozen=True)
class Means:
    """Chart of the means of lots, in the order of time.

    Attributes
    ----------
    lots : names;  time : (k,) mean time of the pieces, s since 1970;  count, mean : (k,)
    centre : mean of all pieces;  within : standard deviation within lots, None where every lot has one piece
    limits : (k, 2) centre ± 3 within/√count, NaN where within is not known;  beyond : indices outside of them
    """

    lots: tuple[str, ...]
    time: np.ndarray
    count: np.ndarray
    mean: np.ndarray
    centre: float
    within: float | None
    limits: np.ndarray
    beyond: tuple[int, ...]


@dataclass(frozen=True)
class Drift:
    """A line over time.

    Attributes
    ----------
    per_month, std : slope and its standard deviation, 1/month;  p : p-value of no drift, Student's t of `freedom`
    at, offset : the line is offset + per_month (t − at), t and at in months since 1970
    between : standard deviation between lots about the line, beyond what the scatter of their pieces explains
    significant : whether p is below `FALSE_ALARM` over the number of quantities tested
    of_lots : whether the line goes through means of lots; through single pieces where the lots are too few
    """

    per_month: float
    std: float
    p: float
    freedom: int
    at: float
    offset: float
    between: float
    significant: bool
    of_lots: bool

    def in_percent(self, centre: float) -> str:
        """Change per month and its deviation in % of a mean that is not 0; of a negative one the magnitude counts."""
        return f"{100 * self.per_month / centre:+.2g} ± {100 * self.std / abs(centre):.2g} %"


@dataclass(frozen=True)
class Control:
    """One quantity of all lots, SI: time (n,) in s since 1970 and values (n,), with the charts that they allow."""

    quantity: str
    time: np.ndarray
    values: np.ndarray
    individuals: Individuals | None
    means: Means
    drift: Drift | None

    def to_json(self) -> dict[str, Any]:
        """JSON types only."""
        individuals, means, drift = self.individuals, self.means, self.drift
        return {
            "count": int(self.values.size),
            "individuals": individuals
            and {
                "centre": individuals.centre,
                "sigma": individuals.sigma,
                "limits": list(individuals.limits),
                "beyond": len(individuals.beyond),
                "shifted": len(individuals.shifted),
            },
            "lots": [
                {
                    "lot": name,
                    "count": int(count),
                    "mean": float(mean),
                    "limits": None if means.within is None else limits.tolist(),
                    "beyond": index in means.beyond,
                }
                for index, (name, count, mean, limits) in enumerate(
                    zip(means.lots, means.count, means.mean, means.limits, strict=True)
                )
            ],
            "within_std": means.within,
            "drift": drift
            and {
                "per_month": drift.per_month,
                "std": drift.std,
                "p_value": drift.p,
                "significant": drift.significant,
                "between_lots_std": drift.between,
                "through": "lots" if drift.of_lots else "pieces",
            },
        }


def controls(rows: Sequence[dict[str, Any]], quantities: Sequence[str] = ()) -> tuple[Control, ...]:
    """The charts of every quantity of rows, which are in the order of measurement.

    Parameters
    ----------
    rows : of `femu_piezo.store.read.read_pieces`
    quantities : columns wanted; constants, tangents, k_eff and misfit where there are none
    """
    good = [row for row in rows if row["status"] == "ok"]
    names = [name for name in quantities or QUANTITIES if any(row.get(name) is not None for row in good)]
    return tuple(_control(name, [row for row in good if row.get(name) is not None], len(names)) for name in names)


def _control(name: str, rows: Sequence[dict[str, Any]], tested: int) -> Control:
    values = np.array([row[name] for row in rows], dtype=float)
    time = np.array([_seconds(row["measured"]) for row in rows])
    means = lot_means([row["lot"] for row in rows], time, values)
    if len(means.lots) >= FEWEST_FOR_DRIFT:
        variance = np.zeros(means.mean.size) if means.within is None else means.within**2 / means.count
        drift = trend(means.time, means.mean, variance, tested=tested, of_lots=True)
    else:
        drift = trend(time, values, np.zeros(values.size), tested=tested, of_lots=False)
    return Control(name, time, values, individuals(values) if values.size >= FEWEST else None, means, drift)


def individuals(values: np.ndarray) -> Individuals:
    """The chart of values (n,), n at least 2."""
    centre = float(np.mean(values))
    sigma = float(np.mean(np.abs(np.diff(values))) / _RANGE_OF_TWO)
    limits = (centre - 3 * sigma, centre + 3 * sigma)
    beyond = np.flatnonzero((values < limits[0]) | (values > limits[1]))
    side, run, shifted = np.sign(values - centre), 0, []
    for index in range(values.size):
        run = run + 1 if index and side[index] == side[index - 1] != 0 else 1
        if run >= RUN:
            shifted.append(index)
    return Individuals(centre, sigma, limits, tuple(beyond.tolist()), tuple(shifted))


def lot_means(lots: Sequence[str], time: np.ndarray, values: np.ndarray) -> Means:
    """The chart of the lots of n pieces; time (n,) in s, values (n,)."""
    names, index = np.unique(np.array(lots, dtype=object).astype(str), return_inverse=True)
    count = np.bincount(index)
    mean, when = (np.bincount(index, weights=one) / count for one in (values, time))
    freedom = values.size - count.size
    within = float(np.sqrt(np.sum((values - mean[index]) ** 2) / freedom)) if freedom > 0 else None
    order, centre = np.argsort(when, kind="stable"), float(np.mean(values))
    half = 3 * (np.nan if within is None else within) / np.sqrt(count[order])
    limits = centre + half[:, None] * np.array([-1.0, 1.0])
    beyond = np.flatnonzero(np.abs(mean[order] - centre) > half)
    return Means(
        tuple(names[order].tolist()),
        when[order],
        count[order],
        mean[order],
        centre,
        within,
        limits,
        tuple(beyond.tolist()),
    )


def trend(
    time: np.ndarray, values: np.ndarray, variance: np.ndarray, *, tested: int = 1, of_lots: bool = True
) -> Drift | None:
    """The line through values (k,) at times (k,) in s; None where they are fewer than three, equal, or within a day.

    Slope and variance between lots are those of the largest restricted likelihood. The standard deviation of the slope
    is that of Knapp and Hartung (Stat. Med. 22 (2003) 2693), which holds for few lots, and never below the usual one.

    Parameters
    ----------
    variance : (k,) of each value, from the scatter within its lot
    tested : number of quantities that share the chance of a false alarm
    """
    months, size = time / MONTH_S, values.size
    spread = float(np.var(values))
    if size < FEWEST_FOR_DRIFT or np.ptp(time) < SHORTEST_S or spread == 0:
        return None
    at = float(np.mean(months))
    lines = np.column_stack([np.ones(size), months - at])

    def solved(between: float) -> tuple[np.ndarray, np.ndarray, float, float]:
        """Line, its covariance, weighted sum of squares and −2 log restricted likelihood at a variance between lots."""
        weight = 1 / (variance + between)
        covariance = np.linalg.inv(lines.T @ (weight[:, None] * lines))
        line = covariance @ (lines.T @ (weight * values))
        squares = float(weight @ (values - lines @ line) ** 2)
        return line, covariance, squares, squares - np.sum(np.log(weight)) - np.log(np.linalg.det(covariance))

    logs = np.log(spread) + np.array([-18.0, 5.0])
    found = minimize_scalar(lambda log: solved(np.exp(log))[3], bounds=logs, method="bounded")
    between = float(np.exp(found.x))
    if np.all(variance > 0) and solved(0.0)[3] <= found.fun:
        between = 0.0
    line, covariance, squares, _ = solved(between)
    freedom = size - 2
    std = float(np.sqrt(covariance[1, 1] * max(1.0, squares / freedom)))
    p = float(2 * stats.t.sf(abs(line[1]) / std, freedom))
    significant = p < FALSE_ALARM / tested
    return Drift(
        float(line[1]), std, p, freedom, at, float(line[0]), float(np.sqrt(between)), bool(significant), of_lots
    )


def _seconds(time: datetime) -> float:
    return time.timestamp()
