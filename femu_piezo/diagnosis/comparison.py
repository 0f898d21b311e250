"""What a comparison of sets of causes finds: every candidate tried, the causes named, and their alternatives."""

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
    fit : with the candidate; None where it did not settle
    log_odds : log posterior odds of the set with the candidate over the set that it is compared with
    """

    effect: Effect
    fit: Fit | None = field(repr=False)
    log_odds: float

    @property
    def values(self) -> np.ndarray:
        """(n,) fitted parameters of the candidate, SI."""
        return self.fit.parameters.values(self.fit.x)[self.fit.parameters.index(self.effect.key)]

    @property
    def std(self) -> np.ndarray:
        """(n,) standard deviations of the parameters, SI."""
        return self.fit.std_of_effects[self.fit.parameters.index(self.effect.key)]


@dataclass(frozen=True)
class NamedCause:
    """A cause, or form of an unknown error, of the final set, and the candidates that could take its place.

    Attributes
    ----------
    effect : the cause
    probability : summed posterior of the sets that hold it
    fits : the final set with each candidate (the cause included) in place of the cause, best first; odds over the final
        set
    fit_without : the fit of least χ² with no causes but the others of the final set, and no form of an unknown error
    log_odds : log odds of the final set over the set without the cause
    """

    effect: Effect
    probability: float
    fits: tuple[Trial, ...] = field(repr=False)
    fit_without: Fit = field(repr=False)
    log_odds: float


@dataclass(frozen=True)
class Comparison:
    """The base fit, each candidate alone, and the most probable set of causes.

    Attributes
    ----------
    base : fit without causes, with a discrepancy in the likelihood where one is probable
    singles : each candidate alone, in the order of the library; odds over no cause
    starts : for each single candidate, the most promising start of its fits
    final : fit of the most probable set, without causes that are neither significant nor demanded by the data; the base
        where no cause remains
    described : fit of the final set without forms of unknown errors (`Effect.of_unknown`)
    causes : the causes of the final set, first the one with the highest log odds of the set over that without it
    forms : the forms of unknown errors in the final set
    discrepant : whether the final set is more probable with a discrepancy than without
    averaged : the free constants over all sets
    probabilities : title of every candidate → summed posterior of the sets that hold it
    """

    base: Fit
    singles: tuple[Trial, ...] = field(repr=False)
    starts: tuple[Start, ...] = field(repr=False)
    final: Fit
    described: Fit
    causes: tuple[NamedCause, ...]
    forms: tuple[NamedCause, ...]
    discrepant: bool
    averaged: Averaged
    rules: Rules = field(default_factory=Rules)
    probabilities: dict[str, float] = field(default_factory=dict)

    @property
    def indistinguishable_from(self) -> dict[str, tuple[Effect, ...]]:
        """Key of a named cause or form → candidates that the data do not tell from it."""
        return {
            named.effect.key: tuple(
                trial.effect
                for trial in named.fits
                if trial.log_odds > -self.rules.alike and trial.effect.title != named.effect.title
            )
            for named in (*self.causes, *self.forms)
        }
