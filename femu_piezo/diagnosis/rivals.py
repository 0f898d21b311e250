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
    fits : with the one and with the other, all else alike
    log_odds : of the first over the second
    enough : log odds that tell them apart
    named : whether the first is a cause that the comparison names
    """

    first: str
    second: str
    fits: tuple[Fit, Fit]
    log_odds: float
    enough: float
    named: bool

    @property
    def told(self) -> bool:
        """Whether a named cause is told from the other."""
        return self.named and self.log_odds > self.enough

    def to_json(self) -> dict:
        """ "rivals" of a round in measure.json."""
        return {"first": self.first, "second": self.second, "log_odds": self.log_odds, "told": self.told}


def rivals(comparison: Comparison) -> Rivals | None:
    """The pair that is hardest to tell apart; None where nothing is named and nothing near it.

    A named cause and the best one in its place. Where none is named but something is left that none describes, the
    best two; else the best one against none, unless that is decided.
    """
    enough = comparison.rules.alike
    instead = [
        (found.effect.title, one)
        for found in comparison.found
        for one in found.fits
        if one.fit is not None and one.effect.title != found.effect.title
    ]
    if instead:
        title, other = max(instead, key=lambda pair: pair[1].log_odds)
        return Rivals(title, other.effect.title, (comparison.final, other.fit), -other.log_odds, enough, True)
    alone = sorted((one for one in comparison.singles if one.fit is not None), key=lambda one: -one.log_odds)
    if comparison.found or not alone:
        return None
    best, title = alone[0], alone[0].effect.title
    if comparison.discrepant:
        second = next((one for one in alone if one.effect.title != title), None)
        if second is None:
            return None
        odds = best.log_odds - second.log_odds
        return Rivals(title, second.effect.title, (best.fit, second.fit), odds, enough, False)
    if best.log_odds < -enough:
        return None
    if best.log_odds < 0:
        return Rivals("no cause", title, (comparison.base, best.fit), -best.log_odds, enough, False)
    return Rivals(title, "no cause", (best.fit, comparison.base), best.log_odds, enough, False)
