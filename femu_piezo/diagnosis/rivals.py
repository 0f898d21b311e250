"""The two best causes of a comparison: what a further measurement should tell apart first."""

from __future__ import annotations

from dataclasses import dataclass

from femu_piezo.diagnosis.comparison import Comparison
from femu_piezo.inference.fit import Fit


@dataclass(frozen=True)
class Rivals:
    """Two explanations of the same data.

    Attributes
    ----------
    first, second : titles of the causes, the more probable one first; "no cause" for none
    fits : fit with the first cause and fit with the second, all other causes alike
    log_odds : of the first over the second
    enough : log odds from which the two count as told apart
    named : whether the first is a cause that the comparison names
    """

    first: str
    second: str
    fits: tuple[Fit, Fit]
    log_odds: float
    enough: float
    named: bool

    @property
    def told_apart(self) -> bool:
        """Whether the first cause is named and told from the second."""
        return self.named and self.log_odds > self.enough

    def to_json(self) -> dict:
        """ "rivals" of a round in measure.json."""
        return {"first": self.first, "second": self.second, "log_odds": self.log_odds, "told": self.told_apart}


def rivals(comparison: Comparison) -> Rivals | None:
    """The pair that is hardest to tell apart; None where there is no such pair.

    Where causes are named: one of them and the best candidate in its place. Where none is named but a discrepancy is
    probable: the two best candidates alone. Else the best candidate alone and "no cause", unless the odds for no cause
    are decisive.
    """
    enough = comparison.rules.alike
    alternatives = [
        (found.effect.title, trial)
        for found in comparison.causes
        for trial in found.fits
        if trial.fit is not None and trial.effect.title != found.effect.title
    ]
    if alternatives:
        title, other = max(alternatives, key=lambda pair: pair[1].log_odds)
        return Rivals(title, other.effect.title, (comparison.final, other.fit), -other.log_odds, enough, True)
    singles = sorted(
        (trial for trial in comparison.singles if trial.fit is not None), key=lambda trial: -trial.log_odds
    )
    if comparison.causes or not singles:
        return None
    best, title = singles[0], singles[0].effect.title
    if comparison.discrepant:
        second = next((trial for trial in singles if trial.effect.title != title), None)
        if second is None:
            return None
        odds = best.log_odds - second.log_odds
        return Rivals(title, second.effect.title, (best.fit, second.fit), odds, enough, False)
    if best.log_odds < -enough:
        return None
    if best.log_odds < 0:
        return Rivals("no cause", title, (comparison.base, best.fit), -best.log_odds, enough, False)
    return Rivals(title, "no cause", (best.fit, comparison.base), best.log_odds, enough, False)
