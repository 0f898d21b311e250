"""Counts over many judged draws: the confusion matrix, and rates against their required values."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import beta

from hidden_effects.judge import Outcome


def clopper_pearson(count: int, total: int, level: float = 0.95) -> tuple[float, float]:
    """Clopper-Pearson interval of a share of which `count` of `total` were observed."""
    tail = (1 - level) / 2
    low = beta.ppf(tail, count, total - count + 1) if count else 0.0
    high = beta.ppf(1 - tail, count + 1, total - count) if count < total else 1.0
    return float(low), float(high)


@dataclass(frozen=True)
class Rate:
    """How often something held, against the share that is required."""

    words: str
    count: int
    total: int
    least: float

    @property
    def holds(self) -> bool:
        """Whether the share reaches the required one; true where nothing was drawn."""
        return self.count >= self.least * self.total

    def line(self) -> str:
        """The rate as a line of text with the 95 % Clopper-Pearson interval of the share."""
        if not self.total:
            return f"      {self.words}: none drawn"
        low, high = clopper_pearson(self.count, self.total)
        share = self.count / self.total
        return (
            f"{'holds' if self.holds else 'FAILS'} {self.words}: {self.count} of {self.total} = {share:.1%} "
            f"(95 %: {low:.1%} to {high:.1%}), asked {self.least:.1%}"
        )


def matrix(outcomes: Sequence[Outcome]) -> str:
    """A line for each hidden effect or pair: what the diagnosis named, and how often."""
    said: dict[str, Counter] = defaultdict(Counter)
    for o in outcomes:
        words = " + ".join(o.truth) or "none"
        row = f"{o.kind} {words}" + ("" if o.detectable or o.kind == "null" else " (not detectable)")
        said[row][" + ".join(o.said) or o.word] += 1
    return "\n".join(
        f"{row:70s} " + ", ".join(f"{name} × {count}" for name, count in counts.most_common())
        for row, counts in sorted(said.items())
    )


def rates(outcomes: Sequence[Outcome]) -> list[Rate]:
    """All rates that the study is required to reach, for single effects without and with variants, nulls,
    undescribed effects and pairs.
    """
    found = []
    library = [o for o in outcomes if o.kind == "single" and o.detectable]
    variants = [o for o in outcomes if o.kind == "variant" and o.detectable]
    for words, group in (("single effects", library), ("variants", variants), ("both", library + variants)):
        found.append(Rate(f"{words}: first or in its class", sum(o.in_class for o in group), len(group), 0.95))
        found.append(Rate(f"{words}: first", sum(o.first for o in group), len(group), 0.8))
    right = [o for o in library + variants if o.first]
    sizes = [next(iter(o.sizes.values())) for o in right if o.sizes]
    found.append(Rate("size within 3 σ", sum(abs(s) < 3 for s in sizes), len(sizes), 0.97))
    places = [s for o in right for s in list(o.sizes.values())[1:]]
    found.append(Rate("further parameters within 3 σ", sum(abs(s) < 3 for s in places), len(places), 0.97))
    nulls = [o for o in outcomes if o.kind == "null"]
    found.append(Rate("nulls: none", sum(o.word == "none" for o in nulls), len(nulls), 39 / 40))
    strange = [o for o in outcomes if o.kind == "undescribed" and o.detectable]
    found.append(Rate("undescribed: no confident name", sum(not o.confident for o in strange), len(strange), 0.9))
    pairs = [o for o in outcomes if o.kind == "pair" and o.detectable]
    found.append(Rate("pairs: both named", sum(o.first for o in pairs), len(pairs), 0.8))
    found.append(Rate("pairs: both named or in a class", sum(o.in_class for o in pairs), len(pairs), 0.8))
    exact = [o for o in library if o.first and o.word == "effect"]
    # in a laboratory, as every prefix of a name says, tolerances make the error of a right prediction larger than noise
    ideal = [o for o in exact if ":" not in o.name]
    for words, good in (
        ("noise", [o.ratio[0] < 1.3 for o in ideal]),
        ("what noise makes of their prediction", [o.misfit < 1.3 for o in exact]),
    ):
        found.append(Rate(f"single effects: unseen points within 1.3 × {words}", sum(good), len(good), 1.0))
    biases = [value for o in exact for value in o.bias.values()]
    found.append(Rate("single effects: constants within 3 σ", sum(abs(b) < 3 for b in biases), len(biases), 0.97))
    return found


def report(outcomes: Sequence[Outcome]) -> str:
    """Matrix, rates and times."""
    seconds = [o.seconds for o in outcomes]
    times = f"seconds per diagnosis: median {np.median(seconds):.1f}, longest {max(seconds):.1f}"
    return "\n".join([matrix(outcomes), *(rate.line() for rate in rates(outcomes)), times])
