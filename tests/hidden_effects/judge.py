"""Holds what `diagnose` said of a draw against the key, and counts."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from femu_piezo.specimen import read_specimen
from femu_piezo.study.diagnose import diagnose
from hidden_effects.draws import Draw

#: Misfit that the effect leaves after a refit of the base, in σ, above which it counts as detectable.
DETECTABLE = 8.0


@dataclass(frozen=True)
class Outcome:
    """One judged draw.

    Attributes
    ----------
    said : the verdict word, or the title of the first cause
    sigma : root of the χ² that the true effect takes away from the base fit, by the true noise
    in_class : the true effect is first or stands beside the first
    deviation : (estimated − true size)/std where the true effect is first
    """

    truth: str
    word: str
    said: str
    probability: float
    sigma: float
    in_class: bool
    deviation: float | None
    seconds: float


def true_title(draw: Draw) -> str:
    return f"{draw.effect}:{draw.detail}" if draw.detail else draw.effect


def judge_draw(draw: Draw, folder: Path) -> Outcome:
    """Write specimen and sweep, diagnose them, compare with the key."""
    result = diagnose(read_specimen(draw.write(folder)))
    verdict, base = result.verdict, result.comparison.base
    scale = float(np.median(result.relative_noise / draw.noise))
    true = [f for e, f in result.comparison.singles if e.title == true_title(draw) and f is not None]
    gain = max((base.chi_square - f.chi_square for f in true), default=0.0)
    first = verdict.causes[0] if verdict.causes else None
    names = [] if first is None else [first.effect.title, *first.indistinguishable_from]
    right = first is not None and first.effect.title == true_title(draw)
    return Outcome(
        truth=true_title(draw),
        word=verdict.word,
        said=first.effect.title if first is not None else verdict.word,
        probability=0.0 if first is None else first.probability,
        sigma=float(np.sqrt(max(0.0, gain))) * scale,
        in_class=true_title(draw) in names,
        deviation=float((first.values[0] - draw.size) / first.std[0]) if right else None,
        seconds=sum(result.seconds.values()),
    )


@dataclass
class Confusion:
    """Counts over many draws."""

    outcomes: list[Outcome] = field(default_factory=list)

    def detectable(self) -> list[Outcome]:
        return [o for o in self.outcomes if o.truth != "none" and o.sigma > DETECTABLE]

    def text(self) -> str:
        """One line per true effect: how often what was said, and the summary."""
        said: dict[str, Counter] = defaultdict(Counter)
        for o in self.outcomes:
            said[o.truth if o.truth == "none" or o.sigma > DETECTABLE else f"{o.truth} (below 8 σ)"][o.said] += 1
        lines = [
            f"{truth:46s} " + ", ".join(f"{name} × {count}" for name, count in counts.most_common())
            for truth, counts in sorted(said.items())
        ]
        seen, nulls = self.detectable(), [o for o in self.outcomes if o.truth == "none"]
        sizes = [abs(o.deviation) for o in seen if o.deviation is not None]
        lines += [
            f"detectable: {len(seen)}; first: {sum(o.said == o.truth for o in seen)}; first or in its class: "
            f"{sum(o.in_class for o in seen)}",
            f"size within 3 σ: {sum(d < 3 for d in sizes)} of {len(sizes)}",
            f"nulls: {len(nulls)}; none said: {sum(o.word == 'none' for o in nulls)}",
            f"seconds per diagnosis: median {np.median([o.seconds for o in self.outcomes]):.1f}, "
            f"longest {max(o.seconds for o in self.outcomes):.1f}",
        ]
        return "\n".join(lines)
