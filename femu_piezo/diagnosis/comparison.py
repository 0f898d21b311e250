"""What a comparison of sets of causes finds: every candidate tried, the causes named, and what could stand for them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from femu_piezo.diagnosis.averaging import Averaged
from femu_piezo.diagnosis.rules import Rules
from femu_piezo.diagnosis.starts import Start
from femu_piezo.effects.effect import Effect
from femu_piezo.inference.fit import Fit


@dataclass(frozen=True)
class Trial:
    """A candidate that was tried.

    Attributes
    ----------
    fit : with it; None where it did not settle
    log_odds : of the set with it over the set that it is compared with
    """

    effect: Effect
    fit: Fit | None
    log_odds: float

    @property
    def values(self) -> np.ndarray:
        """(n,) its parameters, SI."""
        return self.fit.parameters.values(self.fit.x)[self.fit.parameters.index(self.effect.key)]

    @property
    def std(self) -> np.ndarray:
        """(n,) their standard deviations."""
        return self.fit.std_of_effects[self.fit.parameters.index(self.effect.key)]


@dataclass(frozen=True)
class Found:
    """One named cause and what else could stand in its place.

    Attributes
    ----------
    effect : the cause
    probability : summed posterior of the sets that hold it
    fits : the final set with each candidate in its place, the others kept, best first; odds over the final set
    rest : the closest fit with no causes but the others of the final set, forms of what none describes apart
    without : log odds of the final set over that set
    """

    effect: Effect
    probability: float
    fits: tuple[Trial, ...]
    rest: Fit
    without: float


@dataclass(frozen=True)
class Comparison:
    """The base fit, each candidate alone, and the most probable set of causes.

    Attributes
    ----------
    base : without causes, its discrepancy in the likelihood where one is probable
    singles : each candidate alone, in the order of the library; odds over none
    starts : where the fits of single candidates began, the most promising of each
    final : the most probable set less the causes that are neither significant nor demanded; the base where none is left
    described : the same without the forms of what no cause describes
    found : its causes, first the one without which most is left
    forms : those of what no cause describes in it
    discrepant : whether a discrepancy beside the final set is more probable than none
    averaged : the free constants over all sets
    probabilities : title of every candidate → summed posterior of the sets that hold it
    """

    base: Fit
    singles: tuple[Trial, ...]
    starts: tuple[Start, ...]
    final: Fit
    described: Fit
    found: tuple[Found, ...]
    forms: tuple[Found, ...]
    discrepant: bool
    averaged: Averaged
    rules: Rules = field(default_factory=Rules)
    probabilities: dict[str, float] = field(default_factory=dict)

    @property
    def alike(self) -> dict[str, tuple[Effect, ...]]:
        """Key of a cause → candidates that the data do not tell from it."""
        return {
            one.effect.key: tuple(
                trial.effect
                for trial in one.fits
                if trial.log_odds > -self.rules.alike and trial.effect.title != one.effect.title
            )
            for one in (*self.found, *self.forms)
        }
