"""Whether the study's stated probabilities and deviations are worth what they say: tables and two pictures.

    python -m tests.hidden_effects.calibration study.jsonl --out DIR

Probabilities: a reliability curve, and Brier's score (Mon. Weather Rev. 78 (1950) 1) with its expectation if every
stated probability is right and their difference in deviations (Spiegelhalter, Stat. Med. 5 (1986) 421). Deviations:
the probability integral transform u = Φ((estimated − true)/std), which is uniform on (0, 1) if values are normal with
the stated deviation (Dawid, J. R. Stat. Soc. A 147 (1984) 278); many values near 0 and 1 mean deviations too small. Of
the posterior averaged over all sets of causes u is the share above the true value, and Φ⁻¹(u) the error in deviations.
Rates have Clopper-Pearson 95 % intervals.

The probability of a named cause is that of the verdict. Those of all candidates come from the comparison of sets,
before they are reduced for a misfit that no cause explains.

The draws hide every effect equally often, and more often than a laboratory has them. A probability that is right in a
laboratory may be too small here; never too large.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import binom, kstest, norm

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hidden_effects.confusion import clopper_pearson
from hidden_effects.judge import Outcome
from hidden_effects.study import read

#: Ends of the bins of all probabilities, and of the probabilities of named causes, most of which are near one.
EVEN = np.linspace(0.0, 1.0, 6)
NAMED = np.array([0.0, 0.5, 0.9, 0.99, 0.999, 1.0])
#: Number of bins of a histogram of u, and probability that a share lies in its band.
_BINS, _LEVEL = 10, 0.95
#: Numbers of stated deviations for which the table counts the errors within them.
_WITHIN = (1.0, 2.0, 3.0)
_NORMAL = "u = Φ((estimated − true)/std)"
_BLUE, _GREY = "#1f4e79", "#8c8c8c"


@dataclass(frozen=True)
class Bin:
    """Stated probabilities between two ends: their mean, and how often the events came true."""

    low: float
    high: float
    mean: float
    count: int
    total: int

    @property
    def share(self) -> float:
        """Share of the events that came true."""
        return self.count / self.total

    @property
    def interval(self) -> tuple[float, float]:
        """Clopper-Pearson 95 % interval of the share."""
        return clopper_pearson(self.count, self.total)

    @property
    def holds(self) -> bool:
        """Whether the mean of the stated probabilities lies in the interval."""
        return self.interval[0] <= self.mean <= self.interval[1]


def reliability(chance: np.ndarray, was: np.ndarray, ends: np.ndarray = EVEN) -> list[Bin]:
    """Non-empty bins of the stated probabilities `chance` (n,); `was` (n,) says which events came true."""
    place = np.clip(np.searchsorted(ends, chance, side="right") - 1, 0, ends.size - 2)
    found = []
    for number in np.unique(place):
        inside = place == number
        low, high = float(ends[number]), float(ends[number + 1])
        found.append(Bin(low, high, float(chance[inside].mean()), int(was[inside].sum()), int(inside.sum())))
    return found


@dataclass(frozen=True)
class Brier:
    """Brier's score of n probabilities.

    Attributes
    ----------
    score : mean of (p − y)²
    expected : what it would be if every p were right, mean of p (1 − p)
    deviations : how many standard deviations the score lies above that (Spiegelhalter's z); nan where all p are 0 or 1
    """

    score: float
    expected: float
    deviations: float


def brier(chance: np.ndarray, was: np.ndarray) -> Brier:
    """Brier's score of stated probabilities (n,), where `was` (n,) says which events came true."""
    score, expected = float(np.mean((chance - was) ** 2)), float(np.mean(chance * (1 - chance)))
    spread = np.sqrt(np.sum((1 - 2 * chance) ** 2 * chance * (1 - chance)))
    return Brier(score, expected, chance.size * (score - expected) / spread if spread > 0 else np.nan)


@dataclass(frozen=True)
class Transform:
    """The transform u of estimated values, several from each draw.

    Attributes
    ----------
    by_name : name of the constant or parameter → u of each draw, independent of one another
    draws : number of draws
    """

    by_name: dict[str, np.ndarray]
    draws: int

    @property
    def all(self) -> np.ndarray:
        """u of all names."""
        return np.concatenate([*self.by_name.values(), np.zeros(0)])

    @property
    def p_value(self) -> float:
        """p-value of a uniform u: the smallest p-value of Kolmogorov and Smirnov over all names, times their number
        (Bonferroni).

        Names are tested one by one, since the values of a draw are correlated.
        """
        each = [kstest(u, "uniform").pvalue for u in self.by_name.values() if u.size]
        return float(min(1.0, len(each) * min(each))) if each else np.nan

    def within(self, deviations: float) -> tuple[int, int]:
        """Number of values within so many stated deviations, and number of all values."""
        near = np.abs(norm.ppf(self.all)) < deviations
        return int(near.sum()), near.size


def transform(values: Iterable[dict[str, float]]) -> Transform:
    """u of (estimated − true)/std by name, of all draws."""
    values = list(values)
    names = dict.fromkeys(name for one in values for name in one)
    by_name = {name: norm.cdf([one[name] for one in values if name in one]) for name in names}
    return Transform(by_name, sum(bool(one) for one in values))


def band(draws: int, each: float = 1.0, bins: int = _BINS, level: float = _LEVEL) -> tuple[float, float]:
    """Range in which the share of a bin lies if u is uniform.

    each : number of values of a draw that count as independent; 1 where they are fully correlated
    """
    total = max(1, round(draws * each))
    low, high = binom.ppf([(1 - level) / 2, (1 + level) / 2], total, 1 / bins) / total
    return float(low), float(high)


@dataclass(frozen=True)
class Calibration:
    """All figures of the pictures and the table.

    Attributes
    ----------
    named : (n,), (n,) probabilities that were stated with a name, and whether the cause was there
    in_class : how many of these causes were there, or are reported as not to be told from one that was
    candidates : the same of every candidate of every draw, named or not; empty where the results lack them
    constants : of the free constants of draws that were judged rightly;  all_constants : of all draws
    averaged_constants : of all draws, by the posterior averaged over all sets of causes
    shown_constants : of draws whose sweep shows all that is hidden in them, however they were judged
    sizes : of the causes that were named rightly, the first parameter of each
    """

    named: tuple[np.ndarray, np.ndarray]
    in_class: int
    candidates: tuple[np.ndarray, np.ndarray]
    constants: Transform
    all_constants: Transform
    averaged_constants: Transform
    shown_constants: Transform
    sizes: Transform


def calibration(outcomes: Sequence[Outcome]) -> Calibration:
    """Calibration over judged draws, without those whose sweep was refused."""
    outcomes = [one for one in outcomes if one.word != "refused"]
    right = [one for one in outcomes if _right(one)]
    return Calibration(
        named=_against_truth((one.said, _true(one)) for one in outcomes),
        in_class=sum(bool({title, *one.alike[title]} & {*_true(one)}) for one in outcomes for title in one.said),
        candidates=_against_truth((one.chances, _true(one)) for one in outcomes),
        constants=transform(one.bias for one in right),
        all_constants=transform(one.bias for one in outcomes),
        averaged_constants=transform({name: float(-norm.ppf(p)) for name, p in one.below.items()} for one in outcomes),
        shown_constants=transform(one.bias for one in outcomes if one.kind == "null" or one.detectable),
        sizes=transform({"first parameter": next(iter(one.sizes.values()))} for one in right if one.sizes),
    )


def _right(one: Outcome) -> bool:
    """Whether a draw was judged rightly: the verdict "none" for a null, else exactly the true causes named."""
    return one.word == "none" if one.kind == "null" else one.word == "effect" and set(one.said) == set(one.truth)


def _true(one: Outcome) -> tuple[str, ...]:
    """Names that are right for a draw: the hidden effects and those that come with them."""
    return (*one.truth, *one.along)


def _against_truth(stated: Iterable[tuple[dict[str, float], Sequence[str]]]) -> tuple[np.ndarray, np.ndarray]:
    """All stated probabilities, and whether each was of a true cause."""
    pairs = [(chance, title in truth) for chances, truth in stated for title, chance in chances.items()]
    return np.array([chance for chance, _ in pairs], float), np.array([was for _, was in pairs], bool)


def report(found: Calibration) -> str:
    """The table as text."""
    lines = [f"{found.in_class} of the named causes true, or reported as not to be told from what is"]
    for words, (chance, was), ends in (
        ("named causes", found.named, NAMED),
        ("all candidates", found.candidates, EVEN),
    ):
        lines.append(f"probabilities of {words}: {chance.size} stated, {int(was.sum())} of them true")
        if not chance.size:
            continue
        for one in reliability(chance, was, ends):
            low, high = one.interval
            lines.append(
                f"  {one.low:5.3f} to {one.high:5.3f}: mean {one.mean:.4f}, true {one.count} of {one.total} = "
                f"{one.share:.3f} (95 %: {low:.3f} to {high:.3f}) {'' if one.holds else 'NOT WITHIN'}".rstrip()
            )
        score = brier(chance, was)
        lines.append(
            f"  Brier's score {score.score:.4f}; {score.expected:.4f} if every probability were right "
            f"({score.deviations:+.1f} standard deviations between)"
        )
    for words, one in (
        ("constants, draws judged rightly", found.constants),
        ("constants, draws that show what is hidden", found.shown_constants),
        ("constants, all draws", found.all_constants),
        ("constants averaged over causes, all draws", found.averaged_constants),
        ("sizes of causes named rightly", found.sizes),
    ):
        lines += _transform_lines(words, one)
    return "\n".join(lines)


def _transform_lines(words: str, one: Transform) -> list[str]:
    lines = [f"{words}: {one.all.size} values of {one.draws} draws"]
    if not one.all.size:
        return lines
    for deviations in _WITHIN:
        count, total = one.within(deviations)
        low, high = clopper_pearson(count, total)
        asked = 2 * norm.cdf(deviations) - 1
        lines.append(
            f"  within {deviations:g} deviations: {count} of {total} = {count / total:.3f} "
            f"(95 %: {low:.3f} to {high:.3f}), normal {asked:.4f}"
        )
    words = "p-value of evenness (Kolmogorov-Smirnov by name, the smallest times their number)"
    return [*lines, f"  {words}: {one.p_value:.3g}"]


def reliability_figure(found: Calibration) -> Figure:
    """Stated probabilities against how often they were right: all candidates, and by decade those with a name."""
    figure = Figure(figsize=(9.0, 4.3), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot([0, 1], [0, 1], color=_GREY, linewidth=1, linestyle="--", label="if every probability is right")
    if found.candidates[0].size:
        bins = reliability(*found.candidates)
        _points(left, [one.mean for one in bins], bins)
    left.set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.03), xlabel="stated probability", ylabel="share that was there")
    left.set_title("every candidate of every draw", fontsize=11, loc="left")
    bins = reliability(*found.named, NAMED) if found.named[0].size else []
    places = list(range(len(bins)))
    means = [one.mean for one in bins]
    right.plot(places, means, "_", color=_GREY, markersize=28, markeredgewidth=2, label="mean stated")
    _points(right, places, bins)
    labels = [f"{one.low:g}\nto {one.high:g}\nn = {one.total}" for one in bins]
    right.set(xticks=places, xticklabels=labels, xlim=(-0.6, max(len(bins), 1) - 0.4), ylim=(-0.03, 1.03))
    right.set(xlabel="stated probability", ylabel="share that was there")
    right.set_title("causes that were named", fontsize=11, loc="left")
    right.tick_params(axis="x", labelsize=8.5)
    for axes in (left, right):
        axes.grid(True, axis="y", color="#e6e6e6", linewidth=0.6)
    every = [one.get_legend_handles_labels() for one in (left, right)]
    handles = {label: handle for both in every for handle, label in zip(*both, strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    return figure


def _points(axes: Axes, places: Sequence[float], bins: Sequence[Bin]) -> None:
    """Shares of the bins with their 95 % intervals."""
    shares = np.array([one.share for one in bins])
    intervals = np.array([one.interval for one in bins]).reshape(-1, 2)
    reach = np.abs(intervals - shares[:, None]).T
    words = "share that was there, 95 %"
    axes.errorbar(places, shares, reach, fmt="o", color=_BLUE, capsize=3, markersize=5, label=words)


def transform_figure(found: Calibration) -> Figure:
    """Histograms of u with the band in which a uniform u stays."""
    figure = Figure(figsize=(12.0, 4.0), layout="constrained")
    parts = (
        ("constants, draws judged rightly", found.constants, _NORMAL),
        (
            "constants averaged over causes, all draws",
            found.averaged_constants,
            "u = share of the average above the truth",
        ),
        ("sizes of causes named rightly", found.sizes, _NORMAL),
    )
    for axes, (words, one, label) in zip(figure.subplots(1, 3), parts, strict=True):
        _histogram(axes, words, one, label)
    return figure


def _histogram(axes: Axes, words: str, one: Transform, label: str) -> None:
    edges = np.linspace(0, 1, _BINS + 1)
    axes.set(xlim=(0, 1), xlabel=label, ylabel="share of the values")
    if not one.all.size:
        axes.set_title(f"{words}: none", fontsize=11, loc="left")
        return
    together, apart = band(one.draws), band(one.draws, one.all.size / one.draws)
    if one.all.size > one.draws:
        axes.axhspan(*together, color="#efefef", zorder=0, label="even, 95 %: values of a draw as one")
        axes.axhspan(*apart, color="#d5dbe1", zorder=0, label="even, 95 %: all values apart")
    else:
        axes.axhspan(*together, color="#d5dbe1", zorder=0, label="even, 95 %")
    shares = np.histogram(one.all, edges)[0] / one.all.size
    axes.stairs(shares, edges, color=_BLUE, linewidth=1.8)
    axes.axhline(1 / _BINS, color=_GREY, linewidth=1, linestyle="--")
    axes.set_ylim(0, 1.45 * max(shares.max(), together[1]))
    axes.set_title(
        f"{words}\n{one.all.size} values of {one.draws} draws, p = {one.p_value:.2g}", fontsize=10.5, loc="left"
    )
    axes.legend(loc="upper left", frameon=False, fontsize=8.5)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table of a file of results, write reliability.png and transform.png."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("results", type=Path, help="file of JSON lines that HIDDEN_RESULTS named")
    parser.add_argument("--out", type=Path, required=True, help="folder of the pictures")
    wish = parser.parse_args(arguments)
    found = calibration(read(wish.results))
    print(report(found))
    wish.out.mkdir(parents=True, exist_ok=True)
    reliability_figure(found).savefig(wish.out / "reliability.png", dpi=130)
    transform_figure(found).savefig(wish.out / "transform.png", dpi=130)


if __name__ == "__main__":
    main()
