"""Which causes the data demand: sets of causes compared by their evidence, the discrepancy competing with all of them.

A hypothesis is a set of causes S, with or without a discrepancy δ. With N candidates of equal prior probability p and
forms of what none of them describes that weigh as much as F candidates, p = q/(N + F) and δ has π = F p; the posterior
is proportional to

    p(data | S, δ) p^|S| π^δ (1 − π)^(1−δ),

p(data | S, δ) by Laplace's method with everything else marginalised (`femu_piezo.inference.fit`). The probability of a
cause is the summed posterior of the sets that hold it. Sets are found by enlarging the best ones until that gains
nothing, once more where the best has a discrepancy, and by exchanging each cause of the best one; candidates are
screened by linearisation and fitted roughly before they are fitted closely. An uneven body, the form of a discrepancy
that is a change of the body, is tried beside every set and has no other discrepancy beside it; no set is enlarged from
one with it, and no cause left out because of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import TypeVar

import numpy as np
from scipy.special import logsumexp

from femu_piezo.diagnosis.averaging import Averaged, averaged
from femu_piezo.diagnosis.rules import Rules
from femu_piezo.diagnosis.starts import (
    Start,
    promise_of,
    promises_together,
    relocated,
    start_together,
    starts,
    stepped_start,
    unstrained,
)
from femu_piezo.diagnosis.whiteness import remaining_of, strain_of, unexplained_share
from femu_piezo.effects.effect import Effect
from femu_piezo.errors import ConvergenceError
from femu_piezo.inference.fit import CLOSE, COARSE, RANKED, Fit, fit, with_discrepancy
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.measurement.discrepancy_forms import WEIGHTS, Alternatives
from femu_piezo.measurement.sweeps import SweepData
from femu_piezo.threads import blas_limit, in_parallel, made_once

#: Pairs of causes that are fitted, of all that linearisation ranks.
_PAIRS = 4
#: Candidates that are fitted roughly before those that promise less are judged by them.
_AT_ONCE = 2
#: Share of the log odds that linearisation promises by which it may be wrong: the law of a large cause is not linear,
#: and a place is only as near as the next site.
_NONLINEAR = 0.1
#: A rough fit this near to what linearisation promised (in χ², over χ² per residual) has found the minimum there is.
_AS_PROMISED = 1.0
#: χ² per residual above which a rough fit may have settled at a wrong place.
_LEFT = 2.0

Tell = Callable[[str], None]
Item = TypeVar("Item")


@dataclass(frozen=True)
class Hypothesis:
    """A set of causes with its fit.

    Attributes
    ----------
    log_prior : of the set
    chance : prior probability of a discrepancy
    """

    fit: Fit
    log_prior: float
    chance: float

    @property
    def keys(self) -> frozenset[str]:
        """Of the causes."""
        return frozenset(self.fit.parameters.candidates)

    @property
    def forms(self) -> list[Effect]:
        """Those of what no cause describes among the causes."""
        return [cause for cause in self.fit.parameters.causes if cause.of_unknown]

    @made_once
    def log_plain(self) -> float:
        """log posterior (up to a constant) without a discrepancy."""
        return self.fit.log_evidence + self.log_prior + float(np.log1p(-self.chance))

    @made_once
    def log_with_discrepancy(self) -> float:
        """log posterior (up to the same constant) with one; what a set describes in another form has none beside."""
        if self.forms:
            return -np.inf
        return self.fit.log_evidence + self.fit.learned.log_evidence + self.log_prior + float(np.log(self.chance))

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
        """What is fitted goes before what is only extrapolated, and then what is more probable."""
        return not self.fit.extrapolated, self.log_posterior


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


def compare(
    response,
    data: SweepData,
    parameters: Unknowns,
    start: np.ndarray,
    library: Sequence[Effect],
    *,
    rules: Rules | None = None,
    loss: str = "linear",
    progress: Tell = lambda step: None,
) -> Comparison:
    """Fit the base, then sets of candidates.

    Parameters
    ----------
    response : Z of the sweeps at given unknowns
    parameters : material, tolerances and known effects: the base
    start : (n_x,) unknowns of the base
    library : the candidates
    """
    progress("base fit")
    base = fit(response, data, parameters, [start], loss=loss)
    return compare_from(base, response, library, rules=rules, loss=loss, progress=progress)


def compare_from(
    base: Fit,
    response,
    library: Sequence[Effect],
    *,
    rules: Rules | None = None,
    loss: str = "linear",
    progress: Tell = lambda step: None,
) -> Comparison:
    """`compare` with the base fitted already."""
    with blas_limit():
        search = _Search(base, response, tuple(library), rules or Rules(), loss, progress)
        search.run()
        return search.comparison()


class _Search:
    """The sets of causes fitted so far."""

    def __init__(self, base: Fit, response, library: tuple[Effect, ...], rules: Rules, loss: str, tell: Tell) -> None:
        self._response, self._library, self._rules, self._loss, self._tell = response, library, rules, loss, tell
        each = rules.expected_causes / (len({effect.title for effect in library}) + sum(WEIGHTS.values()))
        laws = {effect.key: sum(other.title == effect.title for other in library) for effect in library}
        self._log_prior = {key: float(np.log(each / count)) for key, count in laws.items()}
        self._chance = each * sum(WEIGHTS.values())
        self._base = self._hypothesis(base)
        self._known: dict[frozenset[str], Hypothesis] = {frozenset(): self._base}
        self._smooth_starts: list[Start] = []
        self._alone: tuple[Start, ...] = ()
        self._taken_out: set[tuple[frozenset[str], str]] = set()  # sets, and the cause that was left out of each
        self._expanded: dict[frozenset[str], tuple[tuple[Effect, Fit | None], ...]] = {}

    def _hypothesis(self, fit_: Fit) -> Hypothesis:
        prior = sum(self._log_prior[key] for key in fit_.parameters.candidates)
        return Hypothesis(fit_, prior, self._chance)

    def _keep(self, fits: Iterable[Fit | None]) -> None:
        new = [self._hypothesis(one) for one in fits if one is not None]
        list(in_parallel(lambda one: one.log_posterior, new))  # each keeps its own
        for one in new:
            old = self._known.get(one.keys)
            if old is None or one.rank > old.rank:
                self._known[one.keys] = one

    def run(self) -> None:
        """Enlarge the best sets by one cause after another, then exchange each cause of the best."""
        beam, fruitless = [self._base], 0
        for size in range(1, self._rules.most_causes + 1):
            if size > 2 and self._unknown():
                break  # what two causes leave is of the kind that no cause describes
            before = self._described().log_posterior
            for current in beam:
                self._keep(f for _, f in self._expand(current.fit))
            if size == 1 and self._rules.most_causes > 1:
                self._keep(self._pairs(frozenset().union(*(one.keys for one in self._beam(1)))))
            best, tried, beam = self._described(), bool(beam), self._beam(size)
            fruitless = fruitless + 1 if tried and best.log_posterior <= before else 0
            # a discrepancy stands for all of several causes: one of them may gain nothing where two do
            if fruitless == (2 if best.discrepant else 1):
                break
        while self._exchange():
            pass

    def _beam(self, size: int) -> list[Hypothesis]:
        """The best sets of so many causes, those that were fitted and may yet become the best of all.

        A form of what no cause describes is tried beside every set, and none is enlarged from one.
        """
        known = (h for h in self._known.values() if len(h.keys) == size and not h.fit.extrapolated and not h.forms)
        found = sorted(known, key=lambda one: -one.log_posterior)
        least = self._described().log_posterior - self._rules.contender
        return [one for one in found[: self._rules.beam] if one.log_posterior > least]

    def _best(self) -> Hypothesis:
        return max(self._known.values(), key=lambda one: one.rank)

    def _described(self) -> Hypothesis:
        """The best set without a form of what no cause describes."""
        return max((one for one in self._known.values() if not one.forms), key=lambda one: one.rank)

    def _unknown(self) -> bool:
        """Whether the verdict on the best set would be "unknown": it leaves much beside a discrepancy."""
        best = self._described()
        left = unexplained_share(self._base.fit, best.fit, self._rules.significant)
        return best.discrepant and left > self._rules.unexplained

    def _exchange(self) -> bool:
        """Try every candidate in each place of the best set; whether a better set was found."""
        best = self._described()
        if len(best.keys) < 2:
            return False
        for key in best.keys:
            self._keep(f for _, f in self._expand(self._without(best.fit, key)))
        return self._described().keys != best.keys

    def _without(self, current: Fit, key: str) -> Fit:
        """The set less one cause, from where it is with it: a fit from elsewhere may have ended at a wrong place."""
        whole = frozenset(current.parameters.candidates)
        keys = whole - {key}
        if keys and (whole, key) not in self._taken_out:
            self._taken_out.add((whole, key))
            parameters, before = current.parameters.without_candidate(key), self._known.get(keys)
            self._keep([self._fitted(parameters, [parameters.carried(current.parameters, current.x)])])
            if before is not None and self._known[keys].log_posterior > before.log_posterior + self._rules.alike:
                self._expanded.pop(keys, None)
        return self._known[keys].fit if keys in self._known else self._base.fit

    def _expand(self, current: Fit) -> tuple[tuple[Effect, Fit | None], ...]:
        """Every candidate that is not in the current set, added to it."""
        keys = frozenset(current.parameters.candidates)
        if keys not in self._expanded:
            titles, placed = {effect.title for effect in current.parameters.causes}, self._leaves_something(current)
            others = [e for e in self._library if e.title not in titles and (placed or e.local is None)]
            words = f"beside {' and '.join(sorted(keys))}" if keys else "candidate"
            self._expanded[keys] = self._tried(current, others, words)
        return self._expanded[keys]

    def _leaves_something(self, current: Fit) -> bool:
        """Whether a fit leaves what a cause at a place might explain, of the sweep or of its priors."""
        left = remaining_of(current)
        doubt = min(left.p_white, 1.0 if left.p_size is None else left.p_size, strain_of(current))
        return doubt < self._rules.doubt or current.learned.log_evidence > 0

    def _tried(self, current: Fit, candidates: Sequence[Effect], words: str):
        """The current fit with each candidate added; where next to nothing is promised, by linearisation."""
        if not candidates:
            return ()
        first_cause, forms = not current.parameters.candidates, self._forms_beside(current)
        level = current.learned.level if forms else None
        # those at a place take longest: a core that ends with one of them leaves the other without work
        order = sorted(range(len(candidates)), key=lambda n: candidates[n].local is None)
        names = [f"{words}: {candidates[n].key}" for n in order]

        def odds(one: Fit, effect: Effect) -> float:
            return self._log_evidence(one, forms, level) - before + self._log_prior[effect.key]

        def odds_of(fits: Mapping[int, Fit | None]) -> dict[int, float]:
            return {n: odds(one, candidates[n]) for n, one in fits.items() if one is not None}

        def known(effect: Effect) -> Fit | None:
            one = self._known.get(frozenset((*current.parameters.candidates, effect.key)))
            return None if one is None else one.fit

        def screened(number: int) -> list[Start]:
            return starts(self._response, current, candidates[number])

        before = self._log_evidence(current, forms, level)
        told = dict(zip(order, self._told(in_parallel(screened, order), names), strict=True))
        found = [told[number] for number in range(len(candidates))]
        if first_cause:
            self._alone = tuple(own[0] for own in found)
            self._smooth_starts = [s for own, e in zip(found, candidates, strict=True) if e.sites is None for s in own]
        promised = list(in_parallel(lambda own: max(odds(start.linear, start.cause) for start in own), found))
        rough: dict[int, Fit | None] = {}
        close: dict[int, Fit | None] = {}
        settled: dict[int, float] = {}

        def roughly(number: int) -> Fit | None:
            effect, places = candidates[number], found[number]
            likely = places if first_cause and effect.sites is not None else places[:1]
            begins = [places[0].x, *(place.stepped() for place in likely)]
            return self._fitted(places[0].linear.parameters, begins, COARSE)

        def settle(fits: dict[int, Fit | None]) -> None:
            rough.update(fits)
            settled.update(odds_of(fits))

        def of_causes(items: Mapping[int, Item]) -> list[Item]:
            """Those of causes alone: a form of what none of them describes keeps no cause from a fit."""
            return [one for n, one in items.items() if not candidates[n].of_unknown]

        def reach() -> float:
            return max(of_causes(settled), default=-np.inf) - self._reach(of_causes(rough))

        def hopeful(number: int) -> bool:
            """Whether a fit may yet be the best, by what linearisation promises."""
            return promised[number] + _NONLINEAR * max(promised[number], 0.0) > reach()

        def unexplained() -> bool:
            """Whether no fit with a cause explains the misfit, nor a discrepancy."""
            if forms:
                return False
            by_noise = current.residual.size * np.exp(2 * self._rules.significant * current.data.level_std)
            return all(one is None or one.chi_square > by_noise for fits in (rough, close) for one in of_causes(fits))

        def leading() -> int | None:
            """Number of the cause with the best fit so far."""
            fits = {n: one.log_evidence for n, one in rough.items() if one is not None}
            return max((n for n in fits if not candidates[n].of_unknown), key=lambda n: fits[n], default=None)

        def strained() -> bool:
            """Whether tolerances make up for something in the best fit with a cause, too."""
            best = leading()
            return best is not None and strain_of(rough[best]) < self._rules.doubt

        def from_means(number: int) -> Fit | None:
            places = unstrained(self._response, current, candidates[number])
            return self._fitted(places[0].linear.parameters, [place.x for place in places], COARSE)

        def better(one: Fit | None, other: Fit | None) -> bool:
            return one is not None and (other is None or one.log_evidence > other.log_evidence)

        def most(number: int) -> bool:
            """Whether linearisation explains most of a misfit that no fit explains; what it leaves may be curvature."""
            left, misfit, size = found[number][0].promised, current.chi_square, current.residual.size
            return unexplained() and left - size < (misfit - size) / 2

        def needless(number: int) -> bool:
            """Whether a form of what no cause describes could only stand for a cause that leaves nothing over."""
            if not candidates[number].of_unknown:
                return False
            return any(one is not None and not self._leaves_something(one) for one in of_causes(rough))

        # causes by what they promise, then forms of what none of them describes
        in_order = sorted(np.argsort(promised)[::-1].tolist(), key=lambda n: candidates[n].of_unknown)
        by_promise = [n for n in in_order if promised[n] > self._rules.promise]
        settle({n: one for n in by_promise if (one := known(candidates[n])) is not None})
        untried = [n for n in by_promise if n not in settled]
        # the best one alone: most often no other is worth a fit after it
        for batch in [untried[:1], *(untried[n : n + _AT_ONCE] for n in range(1, len(untried), _AT_ONCE))]:
            worth = [n for n in batch if (hopeful(n) or most(n)) and not needless(n)]
            settle(dict(zip(worth, in_parallel(roughly, worth), strict=True)))
        if first_cause and rough and unexplained():
            # constants that make up for a cause move far with it: what that promises shows from where they went
            left = [n for n in by_promise if n not in settled and candidates[n].sites is None]
            further = in_parallel(lambda n: stepped_start(self._response, current, found[n][0]), left)
            for number, start in zip(left, further, strict=True):
                found[number] = sorted([*found[number], start], key=promise_of)
                promised[number] = max(promised[number], odds(start.linear, candidates[number]))
            worth = [n for n in left if hopeful(n)]
            settle(dict(zip(worth, in_parallel(roughly, worth), strict=True)))

        if forms:
            # a discrepancy that follows every resonance leaves no cause much to explain, and linearisation beside a
            # wrong set less still: the one at no place that explains most beside noise alone shows by a fit what it
            # holds
            even = [n for n, one in enumerate(candidates) if one.sites is None and not one.of_unknown]
            alone = max(even, key=lambda n: found[n][0].linear.log_evidence, default=None)
            if alone is not None and alone not in rough:
                settle({alone: roughly(alone)})

        if first_cause and strained():
            # the best cause may have stopped on its way; where it is strained in itself, another may not be
            others = [n for n in range(len(candidates)) if not candidates[n].of_unknown and n != leading()]
            for batch in ([leading()], others):
                further = dict(zip(batch, in_parallel(from_means, batch), strict=True))
                settle({n: one for n, one in further.items() if better(one, rough.get(n))})
                if not strained():
                    break

        def hope(number: int) -> float:
            """Log odds of a rough fit brought to its end: what its next step or linearisation promises."""
            one = rough[number]
            return promised[number] if one is None else max(settled[number] + one.promise / 2, promised[number])

        def closely(number: int) -> Fit | None:
            one = rough[number]
            unfinished = one is not None and one.promise > COARSE  # it ran out of evaluations
            goes_on = first_cause and unfinished and unexplained()
            # what settled and promises no more is known well enough where it is not among the best
            near = self._rules.contender if one is None or unfinished else self._rules.alike
            if hope(number) < best - near and not goes_on:
                return one
            return self._closely(found[number], one, known(candidates[number]) is not None)

        best, by_hope = max(of_causes(settled), default=-np.inf), sorted(rough, key=hope, reverse=True)
        for batch in (by_hope[n : n + _AT_ONCE] for n in range(0, len(by_hope), _AT_ONCE)):
            ended = dict(zip(batch, in_parallel(closely, batch), strict=True))
            close.update(ended)
            best = max([best, *of_causes(odds_of(ended))])
        return tuple(
            (effect, close[number] if number in close else found[number][0].linear)
            for number, effect in enumerate(candidates)
        )

    def _forms_beside(self, current: Fit) -> list[list[Alternatives]]:
        """Those of a discrepancy beside some causes where that is more probable than none.

        A further cause is worth a fit where it explains more than that; beside none the first cause of several may not.
        """
        return current.forms if current.parameters.candidates and self._hypothesis(current).discrepant else []

    def _log_evidence(self, one: Fit, forms: list[list[Alternatives]], level: float | None) -> float:
        """log p(data), without a discrepancy or with one of some forms, at about a level of the noise."""
        if not forms:
            return one.log_evidence
        with_it = one.log_evidence + one.learned_of(forms, level).log_evidence + float(np.log(self._chance))
        return float(np.logaddexp(one.log_evidence + np.log1p(-self._chance), with_it))

    def _reach(self, rough: Iterable[Fit | None]) -> float:
        """Log odds within which a promise or a rough fit may yet be the best: more where the misfit is large."""
        best = min((one.chi_square / one.residual.size for one in rough if one is not None), default=1.0)
        return self._rules.contender * max(1.0, best)

    def _closely(self, places: list[Start], rough: Fit | None, settled: bool) -> Fit | None:
        """A close fit from the rough one and, where more was promised than it holds, from further starts.

        settled : the rough one is close already
        """
        reached, unit = np.inf, _AS_PROMISED
        if rough is not None:
            reached, unit = rough.chi_square, _AS_PROMISED * max(1.0, rough.chi_square / rough.residual.size)
        further = [places[0].alone()] if reached > places[0].promised + unit else []
        further += [start.x for start in places[1:] if start.promised < reached - unit]
        if rough is not None and rough.chi_square > _LEFT * rough.residual.size:
            elsewhere = relocated(self._response, rough, places[0].cause)
            further += [start.x for start in elsewhere if start.promised < reached - unit]
        if settled and not further:
            return rough
        return self._fitted(places[0].linear.parameters, further if rough is None else [rough.x, *further])

    def _pairs(self, enlarged: frozenset[str]) -> list[Fit | None]:
        """The pairs that linearisation finds best, fitted: each cause may explain little by itself.

        enlarged : causes that are enlarged by every other one anyhow
        """
        current, alone = self._base.fit, self._smooth_starts
        promised: dict[frozenset[str], tuple[float, int, int]] = {}
        promises = promises_together(current, alone)
        for first, second in combinations(range(len(alone)), 2):
            causes = alone[first].cause, alone[second].cause
            keys = frozenset(cause.key for cause in causes)
            if causes[0].title != causes[1].title and not keys & enlarged:
                promise = promises[first, second] + sum(self._log_prior[cause.key] for cause in causes)
                promised[keys] = max(promised.get(keys, (-np.inf, 0, 0)), (float(promise), first, second))
        best, described = sorted(promised.items(), key=lambda item: -item[1][0])[:_PAIRS], self._described()
        least = described.log_posterior - self._reach([described.fit])
        worth = [
            start_together(current, alone[first], alone[second])
            for keys, (promise, first, second) in best
            if promise > least and keys not in self._known
        ]
        self._tell("pairs")
        return list(in_parallel(lambda s: self._fitted(s.linear.parameters, [s.x, s.alone()]), worth))

    def _fitted(self, parameters: Unknowns, places, gain: float = RANKED) -> Fit | None:
        try:
            return fit(self._response, self._base.fit.data, parameters, places, gain=gain, loss=self._loss)
        except (ConvergenceError, np.linalg.LinAlgError):
            return None

    def _told(self, results: Iterable, names: Sequence[str]):
        for name, result in zip(names, results, strict=True):
            self._tell(name)
            yield result

    def comparison(self) -> Comparison:
        """The most probable set less what it could do without, with probabilities over all sets."""
        one = self._finished(self._best())
        final = self._settled(one)
        while weakest := self._insignificant(final):
            rest = self._finished(self._hypothesis(self._without(one.fit, weakest)))
            if rest.log_posterior < one.log_posterior - self._rules.contender:
                break  # the data demand the cause, however uncertain its size: of a damped support, beside its place
            one, final = rest, self._settled(rest)
        for effect in final.parameters.causes:  # before the sum of all posteriors, which these sets are among
            self._without(one.fit, effect.key)
        total = logsumexp([other.log_posterior for other in self._known.values()])
        base = final if not one.keys else self._settled(self._base)
        found = tuple(self._found(one, effect, total) for effect in final.parameters.causes)
        described = one.fit
        for effect in one.forms:
            described = self._without(described, effect.key)
        none = self._base.log_posterior
        return Comparison(
            base=base,
            singles=tuple(
                Trial(effect, fit_, -np.inf if fit_ is None else self._hypothesis(fit_).log_posterior - none)
                for effect, fit_ in self._expand(self._base.fit)
            ),
            starts=self._alone,
            final=final,
            described=described,
            found=tuple(sorted((f for f in found if not f.effect.of_unknown), key=lambda item: -item.without)),
            forms=tuple(f for f in found if f.effect.of_unknown),
            discrepant=one.discrepant,
            averaged=averaged(list(self._known.values())),
            rules=self._rules,
            probabilities={effect.title: self._probability(effect.title, total) for effect in self._library},
        )

    def _finished(self, one: Hypothesis) -> Hypothesis:
        """The same with a close fit, which those that were only ranked are not."""
        found = self._fitted(one.fit.parameters, [one.fit.x], CLOSE) if one.keys else None
        if found is not None:
            self._known[one.keys] = self._hypothesis(found)
        return self._known[one.keys]

    def _settled(self, one: Hypothesis) -> Fit:
        """The fit, its discrepancy in the intervals where one is probable."""
        return with_discrepancy(one.fit, one.fit.learned) if one.discrepant else one.fit

    def _insignificant(self, final: Fit) -> str | None:
        """Key of the cause that is the fewest of its deviations away from nothing, where those are too few."""
        away = {effect.key: self._significance(final, effect) for effect in final.parameters.causes}
        key = min(away, key=away.__getitem__, default=None)
        return None if key is None or away[key] > self._rules.significant else key

    def _significance(self, final: Fit, effect: Effect) -> float:
        """Deviations, and tolerances, that the most certain parameter of a cause is away from nothing."""
        number = final.parameters.index(effect.key)
        away = np.abs(final.parameters.values(final.x)[number] - effect.rest)
        std = np.maximum(final.std_of_effects[number], effect.tolerance)
        sizes = [index for index, parameter in enumerate(effect.parameters) if not parameter.optional]
        return float(np.max(away[sizes] / std[sizes]))

    def _found(self, one: Hypothesis, effect: Effect, total: float) -> Found:
        rest = one.keys - {effect.key}
        others = {h.keys - rest: h for h in self._known.values() if rest < h.keys and len(h.keys) == len(one.keys)}
        by_key = {e.key: e for e in self._library}
        fits = [
            Trial(by_key[next(iter(keys))], h.fit, h.log_posterior - one.log_posterior)
            for keys, h in others.items()
            if len(keys) == 1
        ]
        without, described = self._known.get(rest), rest - {form.key for form in one.forms}
        return Found(
            effect=effect,
            probability=self._probability(effect.title, total),
            fits=tuple(sorted(fits, key=lambda trial: -trial.log_odds)),
            rest=min((h.fit for keys, h in self._known.items() if keys <= described), key=lambda fit_: fit_.chi_square),
            without=np.inf if without is None else one.log_posterior - without.log_posterior,
        )

    def _probability(self, title: str, total: float) -> float:
        """Summed posterior of the known sets that hold a cause, over that of all (log)."""
        titles = (({cause.title for cause in h.fit.parameters.causes}, h) for h in self._known.values())
        holding = [h.log_posterior for own, h in titles if title in own]
        return float(np.exp(logsumexp(holding) - total)) if holding else 0.0
