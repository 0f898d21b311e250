"""Every threshold of a decision, each with the principle it follows from; written into diagnosis.json."""

from __future__ import annotations

from dataclasses import dataclass, field, fields


def _rule(value: float, principle: str):
    return field(default=value, metadata={"principle": principle})


@dataclass(frozen=True)
class Rules:
    """Prior probabilities, and what a cause must be to be named."""

    expected_causes: float = _rule(
        0.5,
        "expected number of causes in a sweep a priori, shared equally by all candidates of the library and the forms "
        "of a discrepancy: a smooth error, a resonance and a step weigh as much as a candidate, errors of every "
        "resonance a hundredth of it; multiplied by the share of the misfit that a cause explains over the share that "
        "it leaves, these are the odds that the cause is real and not imitated by an unknown error",
    )
    significant: float = _rule(
        3.0,
        "a cause is named although the other causes would suffice only where its size differs from zero by at least "
        "this many of its standard deviations, and of its tolerance; or where its log odds exceed those of contender, "
        "and for a single cause to which an unknown error is the alternative those of alike",
    )
    alike: float = _rule(
        3.0,
        "causes are indistinguishable where the log odds of their sets differ by less (20 to 1); a rough fit is "
        "completed where it may come that close to the best",
    )
    unexplained: float = _rule(
        0.25,
        "the verdict is unknown where every named cause leaves more than this share (rms) of the misfit that there is "
        "without it",
    )
    loudest: float = _rule(
        3.0,
        "residuals that are correlated between neighbouring points are not noise where they exceed the stated or "
        "estimated noise by more than this factor; smaller ones may be correlated noise",
    )
    most_causes: int = _rule(
        3, "largest number of causes that may act together; a third is sought unless the verdict with two is unknown"
    )
    beam: int = _rule(2, "number of the best sets of causes to which one more cause is added")
    promise: float = _rule(
        -3.0,
        "a candidate, or a pair of candidates, is fitted where linearisation predicts log odds above this over the set "
        "without it",
    )
    doubt: float = _rule(
        0.05,
        "causes that act at a place or differently along the body are tried where the remaining misfit, or the "
        "distance of the unknowns from their priors, is less probable than this by chance, or where a discrepancy "
        "explains it better than noise; that happens in about one of ten sweeps without a cause",
    )
    contender: float = _rule(
        10.0,
        "a candidate is tried where its log odds are within this (22 000 to 1) of the best, multiplied by χ² per "
        "residual where that exceeds 1",
    )

    def to_json(self) -> dict:
        """Name → value and principle."""
        return {
            one.name: {"value": getattr(self, one.name), "principle": one.metadata["principle"]} for one in fields(self)
        }
