"""A set of causes with each of some candidates added, fits only where they may matter.

Candidates are screened by linearisation at the most promising places, fitted roughly in the order of what that
promises, as long as one may yet be the best, and those near the best are fitted closely.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from femu_piezo.diagnosis.hypotheses import Weighing
from femu_piezo.diagnosis.starts import Start, of_either_sign, promise_of, relocated, starts, stepped_start, unstrained
from femu_piezo.diagnosis.whiteness import strain_of
from femu_piezo.effects.effect import Effect
from femu_piezo.inference.descent import COARSE
from femu_piezo.inference.fit import Fit
from femu_piezo.threads import in_parallel

#: Candidates that are fitted roughly before those that promise less are judged by them.
_AT_ONCE = 2
#: Share of the log odds that linearisation promises by which it may be wrong: the law of a large cause is not linear,
#: and a place is only as near as the next site.
_NONLINEAR = 0.1
#: A rough fit this near to what linearisation promised (in χ², over χ² per residual) has found the minimum there is.
_AS_PROMISED = 1.0
#: χ² per residual above which a rough fit may have settled at a wrong place.
_LEFT = 2.0


@dataclass
class _Prospect:
    """A candidate beside the set.

    Attributes
    ----------
    starts : where its fits may begin, the most promising first
    promised : log odds of the set with it over the set, by linearisation
    known : a close fit with it that was made before
    rough, odds : its rough fit, and the log odds of that; None and −inf where none settled
    tried : whether it was fitted
    close : the fit to go by once all is done; of what was not fitted, what linearisation promises
    """

    effect: Effect
    starts: list[Start]
    promised: float
    known: Fit | None
    rough: Fit | None = None
    odds: float = -np.inf
    tried: bool = False
    close: Fit | None = None


class Enlargement:
    """One set of causes, enlarged.

    Parameters
    ----------
    current : the fit of the set
    candidates : that it does not hold
    known : key of a candidate → the fit with it, where it was made before
    tell, words : called with the words and the key of every candidate that was screened

    Attributes
    ----------
    starts : of every candidate, as it was screened, the most promising first
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
        self._first = not current.parameters.candidates
        self._forms = weighing.forms_beside(current)
        self._level = current.learned.level if self._forms else None
        self._before = weighing.log_evidence(current, self._forms, self._level)
        self._prospects = self._screened(candidates, known, tell, words)
        self.starts = [one.starts for one in self._prospects]
        self._fit_roughly()
        if self._first:
            self._fit_from_steps()
        if self._first and self._unexplained():
            self._fit_the_rest()
        if self._forms:
            self._fit_loudest()
        if self._first and self._strained():
            self._fit_unstrained()
        self._fit_closely()

    @property
    def fits(self) -> tuple[tuple[Effect, Fit | None], ...]:
        """Every candidate with its fit: of what was not fitted what linearisation promises, None where none settled."""
        return tuple((one.effect, one.close if one.tried else one.starts[0].linear) for one in self._prospects)

    @property
    def _of_causes(self) -> Iterator[_Prospect]:
        """Those of causes alone: a form of what none of them describes keeps no cause from a fit."""
        return (one for one in self._prospects if not one.effect.of_unknown)

    def _odds(self, one: Fit, effect: Effect) -> float:
        """Log odds of the set with a candidate over the set."""
        found = self._weighing.log_evidence(one, self._forms, self._level)
        return found - self._before + self._weighing.log_prior[effect.key]

    def _screened(
        self,
        candidates: Sequence[Effect],
        known: Mapping[str, Fit],
        tell: Callable[[str], None],
        words: str,
    ) -> list[_Prospect]:
        # those at a place take longest: a core that ends with one of them leaves the other without work
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

    def _settle(self, chosen: Sequence[_Prospect], fits: Sequence[Fit | None]) -> None:
        """Rough fits of some candidates."""
        for one, found in zip(chosen, fits, strict=True):
            one.tried, one.rough = True, found
            if found is not None:
                one.odds = self._odds(found, one.effect)

    def _fit_roughly(self) -> None:
        """Causes by what they promise, then forms of what none of them describes."""
        in_order = sorted(self._prospects, key=lambda one: one.promised)[::-1]
        by_promise = [one for one in in_order if one.promised > self._rules.promise]
        by_promise.sort(key=lambda one: one.effect.of_unknown)
        before = [one for one in by_promise if one.known is not None]
        self._settle(before, [one.known for one in before])
        untried = [one for one in by_promise if not one.tried]
        # the best one alone: most often no other is worth a fit after it
        for batch in [untried[:1], *(untried[n : n + _AT_ONCE] for n in range(1, len(untried), _AT_ONCE))]:
            worth = [one for one in batch if self._hopeful(one) or self._may_hold_more(one)]
            self._settle(worth, list(in_parallel(self._roughly, worth)))

    def _fit_from_steps(self) -> None:
        """Constants that make up for a cause move far with it: what it promises shows from where they went.

        It is asked of causes that by linearisation explain most of the misfit, and of all where no fit explains it.
        """
        unexplained = self._unexplained()
        left = [
            one
            for one in self._prospects
            if one.promised > self._rules.promise
            and one.rough is None
            and one.effect.sites is None
            and (unexplained or self._explains_most(one))
        ]
        response, current = self._weighing.response, self._current
        further = in_parallel(lambda one: stepped_start(response, current, one.starts[0]), left)
        for one, start in zip(left, further, strict=True):
            one.starts = sorted([*one.starts, start], key=promise_of)
            one.promised = max(one.promised, self._odds(start.linear, one.effect))
        worth = [one for one in left if self._hopeful(one)]
        self._settle(worth, list(in_parallel(self._roughly, worth)))

    def _fit_the_rest(self) -> None:
        """Causes that linearisation promises nothing of: a misfit counts as unexplained once every one was fitted."""
        rest = [one for one in self._of_causes if not one.tried]
        self._settle(rest, list(in_parallel(self._roughly, rest)))

    def _fit_loudest(self) -> None:
        """The cause at no place that explains most beside noise alone.

        A discrepancy that follows every resonance leaves no cause much to explain, and linearisation beside a wrong set
        less still: a fit shows what it holds.
        """
        even = [one for one in self._of_causes if one.effect.sites is None]
        loudest = max(even, key=lambda one: one.starts[0].linear.log_evidence, default=None)
        if loudest is not None and not loudest.tried:
            self._settle([loudest], [self._roughly(loudest)])

    def _fit_unstrained(self) -> None:
        """The best cause may have stopped on its way; where it is strained in itself, another may not be."""
        leading = self._leading()
        others = [one for one in self._of_causes if one is not leading]
        for batch in ([leading] if leading else [], others):
            found = list(in_parallel(self._from_means, batch))
            better = [
                (one, fit)
                for one, fit in zip(batch, found, strict=True)
                if fit is not None and (one.rough is None or fit.log_evidence > one.rough.log_evidence)
            ]
            self._settle([one for one, _ in better], [fit for _, fit in better])
            if not self._strained():
                break

    def _fit_closely(self) -> None:
        """Every rough fit that may be the best brought to its end, the most hopeful first."""
        best = max((one.odds for one in self._of_causes), default=-np.inf)
        by_hope = sorted((one for one in self._prospects if one.tried), key=self._hope, reverse=True)
        for batch in (by_hope[n : n + _AT_ONCE] for n in range(0, len(by_hope), _AT_ONCE)):
            ends = in_parallel(lambda one, best=best: self._closely(one, best), batch)
            for one, found in zip(batch, list(ends), strict=True):
                one.close = found
                if found is not None and not one.effect.of_unknown:
                    best = max(best, self._odds(found, one.effect))

    def _roughly(self, one: _Prospect) -> Fit | None:
        likely = one.starts if self._first and one.effect.sites is not None else one.starts[:1]
        begins = [one.starts[0].x, *(start.stepped() for start in likely)]
        begins += [start.x for start in of_either_sign(one.starts)] if self._first else []
        return self._weighing.fitted(one.starts[0].linear.parameters, begins, COARSE)

    def _from_means(self, one: _Prospect) -> Fit | None:
        places = unstrained(self._weighing.response, self._current, one.effect)
        return self._weighing.fitted(places[0].linear.parameters, [place.x for place in places], COARSE)

    def _hopeful(self, one: _Prospect) -> bool:
        """Whether a fit may yet be the best, by what linearisation promises; within more where the misfit is large.

        Beside a discrepancy, which takes what is left, no misfit is large.
        """
        rough = [] if self._forms else [other.rough for other in self._of_causes if other.rough is not None]
        large = min((fit.chi_square / fit.residual.size for fit in rough), default=1.0)
        best = max((other.odds for other in self._of_causes), default=-np.inf)
        least = best - self._rules.contender * max(1.0, large)
        return one.promised + _NONLINEAR * max(one.promised, 0.0) > least

    def _may_hold_more(self, one: _Prospect) -> bool:
        """Whether a fit may find much more than linearisation promises of a candidate that explains most of the misfit.

        What linearisation leaves may be curvature where constants make up for small sizes, where no fit explains the
        misfit, or where the best one outdid its promise.
        """
        return self._explains_most(one) and bool(one.effect.start_sizes or self._unexplained() or self._outdone())

    def _explains_most(self, one: _Prospect) -> bool:
        """Whether linearisation promises that a candidate explains most of the misfit, whatever others do."""
        left, misfit, size = one.starts[0].promised, self._current.chi_square, self._current.residual.size
        return left - size < (misfit - size) / 2

    def _outdone(self) -> bool:
        """Whether the best fit, beside no discrepancy, found more of its cause than linearisation had promised."""
        best = None if self._forms else self._leading()
        return best is not None and best.odds - best.promised > self._rules.contender + _NONLINEAR * abs(best.promised)

    def _unexplained(self) -> bool:
        """Whether there is a misfit that no fit with a cause explains, nor a discrepancy."""
        if self._forms:
            return False
        data = self._current.data
        by_noise = self._current.residual.size * np.exp(2 * self._rules.significant * data.level_std)
        fits = [fit for one in self._of_causes for fit in (one.rough, one.close) if fit is not None]
        return all(fit.chi_square > by_noise for fit in (self._current, *fits))

    def _leading(self) -> _Prospect | None:
        """The cause with the best fit so far."""
        fitted = [(one, one.rough.log_evidence) for one in self._of_causes if one.rough is not None]
        return max(fitted, key=lambda pair: pair[1], default=(None, 0.0))[0]

    def _strained(self) -> bool:
        """Whether tolerances make up for something in the best fit with a cause, too."""
        best = self._leading()
        return best is not None and best.rough is not None and strain_of(best.rough) < self._rules.doubt

    def _hope(self, one: _Prospect) -> float:
        """Log odds of a rough fit brought to its end: what its next step or linearisation promises."""
        return one.promised if one.rough is None else max(one.odds + one.rough.promise / 2, one.promised)

    def _closely(self, one: _Prospect, best: float) -> Fit | None:
        """A close fit where it may come near the best log odds, from further starts where more was promised."""
        rough, places = one.rough, one.starts
        unfinished = rough is not None and rough.promise > COARSE  # it ran out of evaluations
        goes_on = self._first and unfinished and self._unexplained()
        # it ended at a wrong place, below what was promised of it
        astray = rough is not None and one.odds < one.promised - self._rules.alike and self._may_hold_more(one)
        # what settled and promises no more is known well enough where it is not among the best
        near = self._rules.contender if rough is None or unfinished else self._rules.alike
        if self._hope(one) < best - near and not goes_on and not astray:
            return rough
        reached, unit = np.inf, _AS_PROMISED
        if rough is not None:
            reached, unit = rough.chi_square, _AS_PROMISED * max(1.0, rough.chi_square / rough.residual.size)
        further = [places[0].alone()] if reached > places[0].promised + unit else []
        further += [start.x for start in places[1:] if start.promised < reached - unit]
        if rough is not None and rough.chi_square > _LEFT * rough.residual.size:
            elsewhere = relocated(self._weighing.response, rough, one.effect)
            further += [start.x for start in elsewhere if start.promised < reached - unit]
        if one.known is not None and not further:
            return rough
        begins = further if rough is None else [rough.x, *further]
        return self._weighing.fitted(places[0].linear.parameters, begins)
