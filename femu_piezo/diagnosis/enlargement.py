"""A set of causes enlarged by each of several candidates; fits are made only where they may matter.

Candidates are screened by linearisation at their most promising starts, which promises log odds for each. They are
fitted roughly in the order of these log odds as long as one may still become the best; those near the best are then
fitted closely.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from femu_piezo.diagnosis.hypotheses import Weighing
from femu_piezo.diagnosis.starts import Start, of_either_sign, relocated, starts, starts_at_prior_means, stepped_start
from femu_piezo.diagnosis.whiteness import strain_of
from femu_piezo.effects.effect import Effect
from femu_piezo.inference.descent import COARSE
from femu_piezo.inference.fit import Fit
from femu_piezo.threads import in_parallel

#: Candidates are fitted in batches of this size; the results of a batch tell whether later candidates are worth a fit.
_AT_ONCE = 2
#: Relative error of the log odds that linearisation promises: the law of a large cause is not linear, and its place may
#: lie between two sites.
_NONLINEAR = 0.1
#: A rough fit has found the minimum if its χ² is above what linearisation promised by less than this times χ² per
#: residual.
_AS_PROMISED = 1.0
#: χ² per residual above which a rough fit may have settled at a wrong place.
_MISPLACED = 2.0


@dataclass
class _Prospect:
    """A candidate that may enlarge the set.

    Attributes
    ----------
    starts : where fits with it may begin, the most promising first
    promised_odds : log odds of the set with it over the set without it, by linearisation
    known : fit of the enlarged set that the search has already, from another set; None where there is none
    rough, odds : rough fit with it, and log odds by that fit; None and −inf where there is none or it did not settle
    tried : whether a rough fit was made
    close : final fit of a candidate that was tried; None where it did not settle
    """

    effect: Effect
    starts: list[Start]
    promised_odds: float
    known: Fit | None
    rough: Fit | None = None
    odds: float = -np.inf
    tried: bool = False
    close: Fit | None = None


class Enlargement:
    """One set of causes, enlarged by each candidate.

    Parameters
    ----------
    current : the fit of the set
    candidates : effects that the set does not hold
    known : key of a candidate → fit of the set with it, where the search has one already
    tell, words : `tell` is called with `words` and the key of every candidate that was screened

    Attributes
    ----------
    starts : list of starts of every candidate by the screening, the most promising first
    """

    def __init__(
        self,
        weighing: Weighing,
        current: Fit,
        candidates: Sequence[Effect],
        known: Mapping[str, Fit],
        tell: Callable[[str], None],
        words: str,
    ) -> None:
        self._weighing, self._rules, self._current = weighing, weighing.rules, current
        self._from_no_cause = not current.parameters.candidates
        self._forms = weighing.forms_beside(current)
        self._level = current.learned.level if self._forms else None
        self._log_evidence = weighing.log_evidence(current, self._forms, self._level)
        self._prospects = self._screened(candidates, known, tell, words)
        self.starts = [prospect.starts for prospect in self._prospects]
        if self._from_no_cause and self._driven_off():
            self._fit_circuits()
        self._fit_roughly()
        if self._from_no_cause:
            self._fit_from_steps()
            if strain_of(self._current) < self._rules.doubt:
                self._screen_from_means()
            if self._unexplained():
                self._fit_the_rest()
        if self._forms:
            self._fit_loudest()
        if self._from_no_cause and self._strained():
            self._fit_unstrained()
        self._fit_closely()

    @property
    def fits(self) -> tuple[tuple[Effect, Fit | None], ...]:
        """Every candidate with its final fit (None where it did not settle), or the linearised one if not tried."""
        return tuple(
            (prospect.effect, prospect.close if prospect.tried else prospect.starts[0].linear)
            for prospect in self._prospects
        )

    @property
    def _of_causes(self) -> Iterator[_Prospect]:
        """The candidates that are causes: forms of unknown errors are to keep no cause from a fit."""
        return (prospect for prospect in self._prospects if not prospect.effect.of_unknown)

    @property
    def _best_odds(self) -> float:
        """Log odds of the cause with the best fit so far; −inf where none is fitted."""
        return max((prospect.odds for prospect in self._of_causes), default=-np.inf)

    def _odds(self, enlarged: Fit, effect: Effect) -> float:
        """Log odds of the set with a candidate over the set without it."""
        log_evidence = self._weighing.log_evidence(enlarged, self._forms, self._level)
        return log_evidence - self._log_evidence + self._weighing.log_prior[effect.key]

    def _screened(
        self,
        candidates: Sequence[Effect],
        known: Mapping[str, Fit],
        tell: Callable[[str], None],
        words: str,
    ) -> list[_Prospect]:
        # candidates with `local` terms take longest and go first: started last, one would leave the other cores idle
        order = sorted(candidates, key=lambda effect: effect.local is None)
        found: dict[str, list[Start]] = {}
        for effect, own in zip(
            order,
            in_parallel(lambda effect: starts(self._weighing.response, self._current, effect), order),
            strict=True,
        ):
            tell(f"{words}: {effect.key}")
            found[effect.key] = own
        every = [found[effect.key] for effect in candidates]
        promised = in_parallel(lambda own: max(self._odds(start.linear, start.cause) for start in own), every)
        return [
            _Prospect(effect, own, promise, known.get(effect.key))
            for effect, own, promise in zip(candidates, every, promised, strict=True)
        ]

    def _record(self, chosen: Sequence[_Prospect], fits: Sequence[Fit | None]) -> None:
        """Record the rough fits of some candidates, None where they did not settle."""
        for prospect, found in zip(chosen, fits, strict=True):
            prospect.tried, prospect.rough = True, found
            if found is not None:
                prospect.odds = self._odds(found, prospect.effect)

    def _record_better(self, chosen: Sequence[_Prospect], fits: Sequence[Fit | None]) -> None:
        """Record the fits that are better than rough ones before, and those of candidates that had none."""
        better = [
            (prospect, fit)
            for prospect, fit in zip(chosen, fits, strict=True)
            if prospect.rough is None or (fit is not None and fit.log_evidence > prospect.rough.log_evidence)
        ]
        self._record([prospect for prospect, _ in better], [fit for _, fit in better])

    def _driven_off(self) -> bool:
        """Whether the fit has moved a constant farther from the specimen file than its prior deviation."""
        parameters = self._current.parameters
        moved = (self._current.x - parameters.prior_mean) / parameters.prior_std
        return bool(np.any(np.abs(moved[: parameters.of_material]) > 1))

    def _fit_circuits(self) -> None:
        """Fit the circuits, also from what the specimen file states.

        A circuit as large as the specimen drives the constants of a fit without it far off. From there linearisation
        promises nothing of it, and descents stop on their long way back.
        """
        circuits = [prospect for prospect in self._of_causes if prospect.effect.circuit is not None]
        self._record(circuits, list(in_parallel(self._from_file, circuits)))

    def _fit_roughly(self) -> None:
        """Fit causes in the order of the log odds they promise, then forms of unknown errors."""
        in_order = sorted(self._prospects, key=lambda prospect: prospect.promised_odds)[::-1]
        by_promise = [prospect for prospect in in_order if prospect.promised_odds > self._rules.promise]
        by_promise.sort(key=lambda prospect: prospect.effect.of_unknown)
        before = [prospect for prospect in by_promise if prospect.known is not None]
        self._record(before, [prospect.known for prospect in before])
        untried = [prospect for prospect in by_promise if not prospect.tried]
        # the most promising one is fitted alone: after it, most often no other is worth a fit
        for batch in [untried[:1], *(untried[n : n + _AT_ONCE] for n in range(1, len(untried), _AT_ONCE))]:
            worth = [prospect for prospect in batch if self._hopeful(prospect) or self._may_hold_more(prospect)]
            self._record(worth, list(in_parallel(self._roughly, worth)))

    def _fit_from_steps(self) -> None:
        """Screen candidates without a rough fit again from where their linearised step ends, and fit the hopeful ones.

        Constants that compensate a cause move far with it: only from there linearisation shows what the cause promises.
        Candidates whose place is sought are left out; the others must explain most of the misfit by linearisation,
        unless no fit explains it.
        """
        unexplained = self._unexplained()
        without_fit = [
            prospect
            for prospect in self._prospects
            if prospect.promised_odds > self._rules.promise
            and prospect.rough is None
            and prospect.effect.sites is None
            and (unexplained or self._explains_most(prospect))
        ]
        response, current = self._weighing.response, self._current
        self._fit_promising(without_fit, lambda prospect: stepped_start(response, current, prospect.starts[0]))

    def _screen_from_means(self) -> None:
        """Screen causes again one step from the prior means of the tolerances, and fit those that now promise more.

        For a set whose tolerances are strained: they may compensate the true cause, and where they stand linearisation
        promises little of it. It promises too little by half the χ² of the priors at most. Causes whose place is sought
        are left out.
        """
        relief = float(self._current.further_residual @ self._current.further_residual) / 2
        chosen = [
            prospect
            for prospect in self._of_causes
            if prospect.effect.sites is None
            and max(prospect.promised_odds, prospect.odds) + relief > self._best_odds - self._rules.contender
        ]
        response, current = self._weighing.response, self._current

        def one_step(prospect: _Prospect) -> Start:
            return stepped_start(response, current, starts_at_prior_means(response, current, prospect.effect)[0])

        self._fit_promising(chosen, one_step)

    def _fit_promising(self, chosen: Sequence[_Prospect], screening: Callable[[_Prospect], Start]) -> None:
        """Screen candidates at one more start each; fit the hopeful ones that it promises more than they have."""
        more = []
        for prospect, start in zip(chosen, in_parallel(screening, chosen), strict=True):
            promise = self._odds(start.linear, prospect.effect)
            prospect.starts = sorted([*prospect.starts, start], key=attrgetter("promised_chi_square"))
            prospect.promised_odds = max(prospect.promised_odds, promise)
            if promise > prospect.odds + self._rules.alike:
                more.append(prospect)
        worth = [prospect for prospect in more if self._hopeful(prospect)]
        self._record_better(worth, list(in_parallel(self._roughly, worth)))

    def _fit_the_rest(self) -> None:
        """Fit the causes not tried so far: a misfit counts as unexplained only once every cause was fitted."""
        rest = [prospect for prospect in self._of_causes if not prospect.tried]
        self._record(rest, list(in_parallel(self._roughly, rest)))

    def _fit_loudest(self) -> None:
        """Fit the cause without sites that has the largest evidence by linearisation, discrepancies left out.

        A discrepancy that follows every resonance leaves little for a cause to explain, and by linearisation at a wrong
        set still less: only a fit shows what the cause explains.
        """
        without_sites = [prospect for prospect in self._of_causes if prospect.effect.sites is None]
        loudest = max(without_sites, key=lambda prospect: prospect.starts[0].linear.log_evidence, default=None)
        if loudest is not None and not loudest.tried:
            self._record([loudest], [self._roughly(loudest)])

    def _fit_unstrained(self) -> None:
        """Fit the leading cause again from the prior means of the tolerances; if it stays strained, all other causes.

        The fit of the leading cause may have stopped on its way; if it is strained at its end as well, that of another
        cause may not be.
        """
        leading = self._leading()
        others = [prospect for prospect in self._of_causes if prospect is not leading]
        for batch in ([leading] if leading else [], others):
            self._record_better(batch, list(in_parallel(self._from_means, batch)))
            if not self._strained():
                break

    def _fit_closely(self) -> None:
        """Bring every rough fit that may be the best to its end, the most hopeful first."""
        best = self._best_odds
        by_hope = sorted((prospect for prospect in self._prospects if prospect.tried), key=self._hope, reverse=True)
        for batch in (by_hope[n : n + _AT_ONCE] for n in range(0, len(by_hope), _AT_ONCE)):
            ends = in_parallel(lambda prospect, best=best: self._closely(prospect, best), batch)
            for prospect, found in zip(batch, list(ends), strict=True):
                prospect.close = found
                if found is not None and not prospect.effect.of_unknown:
                    best = max(best, self._odds(found, prospect.effect))

    def _roughly(self, prospect: _Prospect, *further: np.ndarray) -> Fit | None:
        """A rough fit from the starts of the screening, and from further places (n_x,)."""
        likely = prospect.starts if self._from_no_cause and prospect.effect.sites is not None else prospect.starts[:1]
        begins = [*further, prospect.starts[0].x, *(start.stepped() for start in likely)]
        begins += [start.x for start in of_either_sign(prospect.starts)] if self._from_no_cause else []
        return self._weighing.fitted(prospect.starts[0].linear.parameters, begins, COARSE)

    def _from_file(self, prospect: _Prospect) -> Fit | None:
        """A rough fit that also begins at what the specimen file states."""
        return self._roughly(prospect, prospect.starts[0].linear.parameters.prior_mean)

    def _from_means(self, prospect: _Prospect) -> Fit | None:
        at_means = starts_at_prior_means(self._weighing.response, self._current, prospect.effect)
        return self._weighing.fitted(at_means[0].linear.parameters, [start.x for start in at_means], COARSE)

    def _hopeful(self, prospect: _Prospect) -> bool:
        """Whether a fit may still become the best, by what linearisation promises; a large misfit widens the margin.

        No misfit counts as large where the set has a discrepancy, which takes up what causes leave.
        """
        rough = [] if self._forms else [other.rough for other in self._of_causes if other.rough is not None]
        large = min((fit.chi_square / fit.residual.size for fit in rough), default=1.0)
        least = self._best_odds - self._rules.contender * max(1.0, large)
        return prospect.promised_odds + _NONLINEAR * max(prospect.promised_odds, 0.0) > least

    def _may_hold_more(self, prospect: _Prospect) -> bool:
        """Whether a fit may find much more than linearisation promises of a candidate that explains most of the misfit.

        The misfit that linearisation leaves may be due to curvature where constants compensate small sizes
        (`Effect.start_sizes`), where no fit explains the misfit, or where the best fit gained more than promised.
        """
        return self._explains_most(prospect) and bool(
            prospect.effect.start_sizes or self._unexplained() or self._outdone()
        )

    def _explains_most(self, prospect: _Prospect) -> bool:
        """Whether by linearisation a candidate explains more than half of the misfit of the set beyond noise."""
        misfit, size = self._current.chi_square, self._current.residual.size
        return prospect.starts[0].promised_chi_square - size < (misfit - size) / 2

    def _outdone(self) -> bool:
        """Whether the best fit gained clearly more than linearisation promised; False if the set has a discrepancy."""
        best = None if self._forms else self._leading()
        if best is None:
            return False
        return best.odds - best.promised_odds > self._rules.contender + _NONLINEAR * abs(best.promised_odds)

    def _unexplained(self) -> bool:
        """Whether χ² of the set and of every fit with a cause is beyond noise; False if the set has a discrepancy."""
        if self._forms:
            return False
        data = self._current.data
        by_noise = self._current.residual.size * np.exp(2 * self._rules.significant * data.level_std)
        fits = [fit for prospect in self._of_causes for fit in (prospect.rough, prospect.close) if fit is not None]
        return all(fit.chi_square > by_noise for fit in (self._current, *fits))

    def _leading(self) -> _Prospect | None:
        """The cause with the best fit so far."""
        fitted = [(prospect, prospect.rough.log_evidence) for prospect in self._of_causes if prospect.rough is not None]
        return max(fitted, key=lambda pair: pair[1], default=(None, 0.0))[0]

    def _strained(self) -> bool:
        """Whether even in the best fit with a cause the effects lie improbably far from their priors (`strain_of`)."""
        best = self._leading()
        return best is not None and best.rough is not None and strain_of(best.rough) < self._rules.doubt

    def _hope(self, prospect: _Prospect) -> float:
        """Log odds that a close fit may reach: the larger of what the next step and linearisation promise."""
        if prospect.rough is None:
            return prospect.promised_odds
        return max(prospect.odds + prospect.rough.promised_gain / 2, prospect.promised_odds)

    def _closely(self, prospect: _Prospect, best: float) -> Fit | None:
        """A close fit where it may come near the best log odds, else the rough fit.

        The close fit also begins at starts whose linearisation promises a lower χ² than the rough fit has reached.
        """
        rough, screened = prospect.rough, prospect.starts
        unfinished = rough is not None and rough.promised_gain > COARSE  # it ran out of evaluations
        goes_on = self._from_no_cause and unfinished and self._unexplained()
        # its odds stayed below what was promised, so it ended at a wrong place
        astray = (
            rough is not None
            and prospect.odds < prospect.promised_odds - self._rules.alike
            and self._may_hold_more(prospect)
        )
        # a settled fit is exact enough unless it is that near the best
        below_best = self._rules.contender if rough is None or unfinished else self._rules.alike
        if self._hope(prospect) < best - below_best and not goes_on and not astray:
            return rough
        reached, margin = np.inf, _AS_PROMISED
        if rough is not None:
            reached, margin = rough.chi_square, _AS_PROMISED * max(1.0, rough.chi_square / rough.residual.size)
        further = [screened[0].alone()] if reached > screened[0].promised_chi_square + margin else []
        further += [start.x for start in screened[1:] if start.promised_chi_square < reached - margin]
        if rough is not None and rough.chi_square > _MISPLACED * rough.residual.size:
            elsewhere = relocated(self._weighing.response, rough, prospect.effect)
            further += [start.x for start in elsewhere if start.promised_chi_square < reached - margin]
        if prospect.known is not None and not further:
            return rough
        begins = further if rough is None else [rough.x, *further]
        return self._weighing.fitted(screened[0].linear.parameters, begins)
