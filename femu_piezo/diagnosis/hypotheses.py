"""Sets of causes as hypotheses: how they are fitted, and how probable each is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from femu_piezo.diagnosis.rules import Rules
from femu_piezo.diagnosis.whiteness import remaining_of, strain_of
from femu_piezo.effects.effect import Effect
from femu_piezo.errors import ConvergenceError
from femu_piezo.inference.descent import RANKED, Response
from femu_piezo.inference.fit import Fit, fit
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.measurement.discrepancy_forms import WEIGHTS, Alternatives
from femu_piezo.measurement.sweeps import SweepData
from femu_piezo.threads import made_once


@dataclass(frozen=True)
class Hypothesis:
    """A set of causes with its fit.

    Attributes
    ----------
    log_prior : log prior probability of the set, up to a constant
    discrepancy_prior : prior probability of a discrepancy
    """

    fit: Fit
    log_prior: float
    discrepancy_prior: float

    @property
    def keys(self) -> frozenset[str]:
        """Keys of the causes, forms of unknown errors included."""
        return frozenset(self.fit.parameters.candidates)

    @property
    def forms(self) -> list[Effect]:
        """The causes that are forms of unknown errors (`Effect.of_unknown`)."""
        return [cause for cause in self.fit.parameters.causes if cause.of_unknown]

    @property
    def causes(self) -> frozenset[str]:
        """Keys of the causes, forms of unknown errors left out."""
        return self.keys - {form.key for form in self.forms}

    @made_once
    def log_plain(self) -> float:
        """log posterior (up to a constant) without a discrepancy."""
        return self.fit.log_evidence + self.log_prior + float(np.log1p(-self.discrepancy_prior))

    @made_once
    def log_with_discrepancy(self) -> float:
        """log posterior (same constant) with a discrepancy; −inf where the set has a form of an unknown error."""
        if self.forms:
            return -np.inf
        return (
            self.fit.log_evidence
            + self.fit.learned.log_evidence
            + self.log_prior
            + float(np.log(self.discrepancy_prior))
        )

    @property
    def discrepant(self) -> bool:
        """Whether a discrepancy is more probable than none."""
        return self.log_with_discrepancy > self.log_plain

    @property
    def log_posterior(self) -> float:
        """log posterior of the set, with a discrepancy or without."""
        return float(np.logaddexp(self.log_plain, self.log_with_discrepancy))

    @property
    def rank(self) -> tuple[bool, float]:
        """Key to rank sets by: fitted ones are above those that are only extrapolated, then more probable ones."""
        return not self.fit.extrapolated, self.log_posterior


class Weighing:
    """Fits of one sweep, or of several, and the prior probabilities of sets of causes.

    Parameters
    ----------
    response, data, loss : as of `femu_piezo.inference.fit.fit`
    library : the candidates; all causes have the same prior probability, which the laws of a cause share equally

    Attributes
    ----------
    log_prior : key of a candidate → log prior probability;  discrepancy_prior : prior probability of a discrepancy
    """

    def __init__(
        self, response: Response, data: SweepData, library: Sequence[Effect], rules: Rules, loss: str = "linear"
    ) -> None:
        self.response, self.rules, self._data, self._loss = response, rules, data, loss
        each = rules.expected_causes / (len({effect.title for effect in library}) + sum(WEIGHTS.values()))
        laws = {effect.key: sum(other.title == effect.title for other in library) for effect in library}
        self.log_prior = {key: float(np.log(each / count)) for key, count in laws.items()}
        self.discrepancy_prior = each * sum(WEIGHTS.values())

    def fitted(self, parameters: Unknowns, places: Sequence[np.ndarray], gain: float = RANKED) -> Fit | None:
        """The fit from several starts (n_x,); None where it does not settle."""
        try:
            return fit(self.response, self._data, parameters, places, gain=gain, loss=self._loss)
        except (ConvergenceError, np.linalg.LinAlgError):
            return None

    def hypothesis(self, of: Fit) -> Hypothesis:
        """The set of causes of a fit, with its prior."""
        return Hypothesis(of, sum(self.log_prior[key] for key in of.parameters.candidates), self.discrepancy_prior)

    def forms_beside(self, current: Fit) -> list[list[Alternatives]]:
        """Forms of the discrepancy of a set of causes, where that is more probable than none; else an empty list.

        A further cause is worth a fit only where it explains more than the discrepancy. A set without causes gets none:
        the first of several causes may explain less.
        """
        return current.forms if current.parameters.candidates and self.hypothesis(current).discrepant else []

    def log_evidence(self, one: Fit, forms: list[list[Alternatives]], level: float | None) -> float:
        """log p(data) of a fit; where `forms` are given, summed over a discrepancy of these forms and none.

        level : factor on the noise from which that of the discrepancy is sought
        """
        if not forms:
            return one.log_evidence
        with_it = one.log_evidence + one.learned_of(forms, level).log_evidence + float(np.log(self.discrepancy_prior))
        return float(np.logaddexp(one.log_evidence + np.log1p(-self.discrepancy_prior), with_it))

    def leaves_something(self, current: Fit) -> bool:
        """Whether residuals or deviations from priors leave something that a cause with `local` terms might explain."""
        remaining = remaining_of(current)
        doubt = min(remaining.p_white, 1.0 if remaining.p_size is None else remaining.p_size, strain_of(current))
        return doubt < self.rules.doubt or current.learned.log_evidence > 0
