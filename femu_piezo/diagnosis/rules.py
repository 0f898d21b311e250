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
        "prior mean number of causes in a sweep, shared alike by all candidates of the library; of the forms of what "
        "none of them describes two weigh as much as a candidate, as an uneven body among these does, and errors of "
        "every resonance a hundredth; times what a cause explains over what it leaves undescribed, the odds of the "
        "cause against something unknown that looks like it",
    )
    significant: float = _rule(
        3.0,
        "a cause that the set could do without is named from this many of its own standard deviations, and of its "
        "tolerance, away from nothing",
    )
    alike: float = _rule(
        3.0,
        "causes are not told apart where the log odds of their sets differ by less: 20 to 1; a rough fit that has "
        "settled is brought to its end where it may come as near to the best",
    )
    unexplained: float = _rule(
        0.25, "above this share of the misfit (rms) that the named causes leave, the verdict is unknown"
    )
    loudest: float = _rule(
        3.0,
        "residuals whose neighbours are alike are no noise where they are more than this many times the noise that is "
        "stated or seen; smaller ones may be correlated noise",
    )
    most_causes: int = _rule(
        3, "most causes that may act together; a third is sought where two leave no verdict of unknown"
    )
    beam: int = _rule(2, "best sets of causes that are enlarged by one more cause")
    promise: float = _rule(
        -3.0,
        "a candidate, or a pair of them, is fitted where linearisation promises more log odds than this over the set "
        "without it",
    )
    doubt: float = _rule(
        0.05,
        "causes at a place are tried where what is left of the sweep, or how far the unknowns lie from their priors, "
        "is less probable than this by chance, or where a discrepancy explains it better than noise; about one sweep "
        "in ten of those that hold no cause leaves so much",
    )
    contender: float = _rule(
        10.0,
        "a candidate is tried whose log odds are within this (22 000 to 1) of the best, times χ² per residual there",
    )

    def to_json(self) -> dict:
        """Name → value and principle."""
        return {
            one.name: {"value": getattr(self, one.name), "principle": one.metadata["principle"]} for one in fields(self)
        }
