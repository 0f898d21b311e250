"""Statistics of a lot: distribution of every quantity, control limits, outliers by name, drift over serial number.

Centre and spread are median and MAD, so that outliers do not widen the limits that should show them. The serial number
of a job is its place in the natural order of the file names.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from femu_piezo.batch.table import NOTES_APART
from femu_piezo.output.curves import PRINTED
from femu_piezo.specimen.file import CONSTANTS

#: Columns of a table that have a distribution, in the order of the report.
QUANTITIES = (*CONSTANTS, *(f"{name}_tan" for name in CONSTANTS), "k_eff", "rms_log_error")
#: Fewest specimens from which limits, outliers and drift are estimated.
FEWEST = 8
#: Chance of one false outlier, or one false drift, in a whole lot.
FALSE_ALARM = 0.05
_MAD_TO_SIGMA = 1.4826
#: What differs among notes of one kind.
_VARYING = re.compile(rf"\b(tan_)?({'|'.join(CONSTANTS)})\b|[-+−]?\d[\d.]*(e[-+]?\d+)?( ?%)?|[(),;]")
#: Most digits of a number in words.
_MOST_DIGITS = 12
#: Relative spread below which values count as equal.
_EQUAL = 1e-9


@dataclass(frozen=True)
class Outlier:
    """A value far off its lot: `distance` in robust standard deviations from the centre (or from the drift line).

    `cause` and `diagnosis` are those of its diagnosis, "" where there is none; `notes` are the notes of the update.
    """

    number: int
    file: str
    quantity: str
    value: float
    distance: float
    reason: str
    cause: str
    diagnosis: str
    notes: str


@dataclass(frozen=True)
class Distribution:
    """One quantity over the lot, SI.

    Attributes
    ----------
    number, values : (n,) serial numbers and values of the specimens that have one
    centre, sigma : median and robust standard deviation
    limits : control limits centre ± 3 sigma; beyond : how many lie outside
    measurement : median standard deviation of a single value by its own fit, None where unknown
    drift : change over the whole lot by a line through the inliers; drift_p : Kendall's test of no drift
    drifts : whether the drift is significant
    line : (n,) the drift line at each value where it is significant, else the centre
    """

    quantity: str
    number: np.ndarray
    values: np.ndarray
    centre: float
    sigma: float
    limits: tuple[float, float]
    beyond: int
    measurement: float | None
    drift: float
    drift_p: float
    drifts: bool
    line: np.ndarray

    def to_json(self) -> dict:
        """JSON types only."""
        quantiles = np.percentile(self.values, [0, 5, 25, 50, 75, 95, 100])
        names = ("minimum", "p5", "p25", "median", "p75", "p95", "maximum")
        return {
            "count": int(self.values.size),
            "mean": float(np.mean(self.values)),
            "std": float(np.std(self.values, ddof=1)) if self.values.size > 1 else None,
            **{name: float(value) for name, value in zip(names, quantiles, strict=True)},
            "robust_std": self.sigma,
            "control_limits": list(self.limits),
            "beyond_limits": self.beyond,
            "measurement_std": self.measurement,
            "drift": {"over_lot": self.drift, "p_value": self.drift_p, "significant": self.drifts},
        }


@dataclass(frozen=True)
class Lot:
    """The statistics of a lot.

    Attributes
    ----------
    counts : number of specimens, and of those of each status
    verdicts, causes : how many diagnoses came to which verdict, and named which cause first
    faults : files without a result, with the reason;  doubtful : files whose result is of little use, and why
    notes : what is told of at least half of the updates: of how many, in the words of the first; most frequent first
    same : files with the same content of their sweeps, several in each group
    """

    counts: dict[str, int]
    verdicts: dict[str, int]
    causes: dict[str, int]
    distributions: tuple[Distribution, ...]
    outliers: tuple[Outlier, ...]
    faults: tuple[tuple[str, str], ...]
    doubtful: tuple[tuple[str, str], ...] = ()
    notes: tuple[tuple[int, str], ...] = ()
    same: tuple[tuple[str, ...], ...] = ()

    def to_json(self) -> dict:
        """JSON types only."""
        return {
            "counts": self.counts,
            "verdicts": self.verdicts,
            "causes": self.causes,
            "quantities": {one.quantity: one.to_json() for one in self.distributions},
            "outliers": [vars(one) for one in self.outliers],
            "faults": [{"file": file, "reason": reason} for file, reason in self.faults],
            "doubtful": [{"file": file, "reason": reason} for file, reason in self.doubtful],
            "notes": [{"count": count, "note": note} for count, note in self.notes],
            "same_sweeps": [list(files) for files in self.same],
        }


def lot_of(rows: Sequence[dict], same: Sequence[tuple[str, ...]] = ()) -> Lot:
    """The statistics of the rows of a table; `same` as in `Lot`."""
    good = [row for row in rows if row["status"] == "ok"]
    names = [name for name in QUANTITIES if sum(row.get(name) is not None for row in good) > 0]
    distributions = tuple(_distribution(name, good, len(names)) for name in names)
    rows_by_number = {row["number"]: row for row in good}
    outliers = [item for one in distributions for item in _outliers(one, len(names), rows_by_number)]
    outliers.sort(key=lambda item: (item.number, -abs(item.distance)))
    counts = {"specimens": len(rows)} | {
        status: sum(row["status"] == status for row in rows) for status in ("ok", "failed", "lost")
    }
    faults = tuple((row["file"], row["reason"]) for row in rows if row["status"] != "ok")
    doubtful = tuple((row["file"], row["doubt"]) for row in good if row.get("doubt"))
    verdicts, causes = (_counted(good, column) for column in ("verdict", "cause"))
    files = {row["file"] for row in good}
    groups = (tuple(file for file in group if file in files) for group in same)
    return Lot(
        counts,
        verdicts,
        causes,
        distributions,
        tuple(outliers),
        faults,
        doubtful,
        _common_notes(good),
        tuple(group for group in groups if len(group) > 1),
    )


def _common_notes(good: Sequence[dict]) -> tuple[tuple[int, str], ...]:
    """`Lot.notes`: notes are alike where their words are, without numbers and names of constants and specimens."""
    of_kind: dict[str, list[str]] = {}
    for row in good:
        first: dict[str, str] = {}
        for told in filter(None, (row.get("notes") or "").split(NOTES_APART)):
            note = told.removeprefix(f"{row.get('specimen')}: ")
            first.setdefault(" ".join(_VARYING.sub(" ", note).split()), note)
        for kind, note in first.items():
            of_kind.setdefault(kind, []).append(note)
    common = [(len(notes), notes[0]) for notes in of_kind.values() if 1 < len(notes) >= len(good) / 2]
    return tuple(sorted(common, key=lambda item: -item[0]))


def _counted(rows: Sequence[dict], column: str) -> dict[str, int]:
    """Value → how many rows have it, the most frequent first."""
    found = Counter(row[column] for row in rows if row.get(column))
    return dict(sorted(found.items(), key=lambda item: (-item[1], item[0])))


def _distribution(name: str, good: Sequence[dict], tested: int) -> Distribution:
    with_value = [row for row in good if row.get(name) is not None]
    number, values = (
        np.array([row["number"] for row in with_value]),
        np.array([row[name] for row in with_value], dtype=float),
    )
    stds = [row[f"{name}_std"] for row in with_value if row.get(f"{name}_std") is not None]
    centre = float(np.median(values))
    sigma = _robust_std(values - centre)
    drift, p, line = 0.0, 1.0, np.full(values.size, centre)
    if values.size >= FEWEST and sigma > 0:
        inliers = np.abs(values - centre) <= 5 * sigma
        if np.unique(values[inliers]).size > 1:
            p = float(stats.kendalltau(number, values).pvalue)
            slope, offset = np.polyfit(number[inliers] - number.mean(), values[inliers], 1)
            drift = float(slope * np.ptp(number))
            line = offset + slope * (number - number.mean())
    drifts = bool(p < FALSE_ALARM / max(1, tested))
    limits = (centre - 3 * sigma, centre + 3 * sigma)
    beyond = int(np.sum((values < limits[0]) | (values > limits[1]))) if values.size >= FEWEST else 0
    return Distribution(
        quantity=name,
        number=number,
        values=values,
        centre=centre,
        sigma=sigma,
        limits=limits,
        beyond=beyond,
        measurement=float(np.median(stds)) if stds else None,
        drift=drift,
        drift_p=p,
        drifts=drifts,
        line=line if drifts else np.full(values.size, centre),
    )


def _robust_std(residual: np.ndarray) -> float:
    return float(_MAD_TO_SIGMA * np.median(np.abs(residual - np.median(residual))))


def _outliers(distribution: Distribution, tested: int, rows: dict[int, dict]) -> list[Outlier]:
    """Values so far from `line` that a normal lot of this size has one in any quantity with chance `FALSE_ALARM`."""
    residual = distribution.values - distribution.line
    scale = max(_robust_std(residual), _EQUAL * abs(distribution.centre))
    if distribution.values.size < FEWEST or scale == 0:
        return []
    # the MAD of few values is uncertain: Student's distribution with the degrees of freedom of such an estimate
    critical = stats.t.isf(
        FALSE_ALARM / (2 * tested * distribution.values.size), max(2.0, 0.37 * (distribution.values.size - 1))
    )
    found = []
    for number, value, distance in zip(
        distribution.number.tolist(), distribution.values.tolist(), residual / scale, strict=True
    ):
        if abs(distance) > critical:
            reason = _reason(distribution, number, distance)
            row = rows[number]
            told = {name: row.get(name) or "" for name in ("cause", "diagnosis", "notes")}
            found.append(Outlier(number, row["file"], distribution.quantity, value, float(distance), reason, **told))
    return found


def _reason(distribution: Distribution, number: int, distance: float, factor: float = 1.0, unit: str = "") -> str:
    """Why the value of piece `number` is an outlier; it is written in a unit, with its factor from SI."""
    about = "the drift of the lot" if distribution.drifts else "the median of the lot"
    side, at = "above" if distance > 0 else "below", distribution.number == number
    value, line = (factor * float(one[at][0]) for one in (distribution.values, distribution.line))
    shown, expected = (_to_a_tenth(one, value - line) for one in (value, line))
    return f"{distribution.quantity} = {shown}{unit} is {abs(distance):.1f} σ {side} {about} ({expected}{unit})"


def counts_words(lot: Lot) -> str:
    """How many specimens there are, and how many gave a result."""
    counts = lot.counts
    return (
        f"{counts['specimens']} specimen{'s' * (counts['specimens'] != 1)}: {counts['ok']} updated, "
        f"{counts['failed']} refused or not converged, {counts['lost']} lost"
    )


def lot_text(lot: Lot) -> str:
    """The report in words, constants in the units of an update."""
    of_quantity = {one.quantity: one for one in lot.distributions}
    lines = [counts_words(lot), *(_distribution_line(one) for one in lot.distributions)]
    if any(one.values.size < FEWEST for one in lot.distributions):
        lines.append(
            f"values beyond the limits are counted, and outliers and drift looked for, among {FEWEST} or more values"
        )
    for words, found in (("diagnoses", lot.verdicts), ("first causes", lot.causes)):
        if found:
            lines.append(f"{words}: " + ", ".join(f"{name} {count}" for name, count in found.items()))
    for file in dict.fromkeys(one.file for one in lot.outliers):
        of_file = [one for one in lot.outliers if one.file == file]
        reasons = (
            _reason(of_quantity[one.quantity], one.number, one.distance, *_unit(one.quantity)) for one in of_file
        )
        lines.append(f"outlier {file}: " + "; ".join(reasons))
        if of_file[0].diagnosis:
            lines.append(f"    diagnosis: {of_file[0].diagnosis}")
        if of_file[0].notes:
            lines.append(f"    notes: {of_file[0].notes}")
    lines += [f"doubtful result of {file}: {reason}" for file, reason in lot.doubtful]
    lines += [f"{count} of {lot.counts['ok']} updates, the first: {note}" for count, note in lot.notes]
    lines += [f"the same sweep, counted as {len(files)} pieces: {', '.join(files)}" for files in lot.same]
    lines += [f"no result for {file}: {reason}" for file, reason in lot.faults]
    return "\n".join(lines) + "\n"


def _distribution_line(one: Distribution) -> str:
    """Median, spread, limits and drift of one quantity."""
    factor, unit = _unit(one.quantity)
    if one.values.size == 1:
        std = "" if one.measurement is None else f", std of the measurement {_share(one.measurement, one.centre)}"
        return f"{one.quantity:13s} {factor * one.centre:.5g}{unit}, one value{std}"
    apart = factor * (one.limits[1] - one.limits[0])
    centre, low, high = (_to_a_tenth(factor * value, apart) for value in (one.centre, *one.limits))
    drifts = (
        f", drifts by {100 * one.drift / one.centre:+.3g} % over the lot (p = {one.drift_p:.1g})" if one.drifts else ""
    )
    beyond = f"{one.beyond} beyond" if one.values.size >= FEWEST else "values beyond are not counted"
    return (
        f"{one.quantity:13s} median {centre}{unit}, robust std {_share(one.sigma, one.centre)}"
        + ("" if one.measurement is None else f", std of one measurement {_share(one.measurement, one.centre)}")
        + f", limits {low} … {high}{unit} ({beyond}){drifts}"
    )


def _to_a_tenth(value: float, apart: float) -> str:
    """A number to a tenth of the distance `apart` to others: with five digits at least, `_MOST_DIGITS` at most."""
    digits = 5
    if apart and value:
        digits = int(np.clip(np.floor(np.log10(abs(value))) - np.floor(np.log10(abs(apart))) + 2, 5, _MOST_DIGITS))
    return f"{value:.{digits}g}"


def _unit(quantity: str) -> tuple[float, str]:
    """Factor from SI and unit, with a space before it, of a quantity; 1 and "" where it has none."""
    factor, unit = PRINTED.get(quantity, (1.0, ""))
    return factor, f" {unit}" if unit else ""


def _share(sigma: float, centre: float) -> str:
    return f"{100 * sigma / abs(centre):.2g} %" if centre else f"{sigma:.2g}"
