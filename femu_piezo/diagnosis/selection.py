"""Which causes the data demand: sets of causes compared by their evidence, the discrepancy competing with all of them.

A hypothesis is a set of causes S, with or without a discrepancy δ. With q causes expected, N candidates of equal prior
probability p, and forms of unknown errors that weigh as much as F candidates, p = q/(N + F) and δ has π = F p; the
posterior is proportional to

    p(data | S, δ) p^|S| π^δ (1 − π)^(1−δ),

p(data | S, δ) by Laplace's method with everything else marginalised (`femu_piezo.inference.fit`). The probability of a
cause is the summed posterior of the sets that hold it. The search enlarges the best sets by one cause after another
until that gains nothing (twice in succession where the best set has a discrepancy), then exchanges each cause of the
best set; it ends where the verdict would be "unknown". Candidates are screened by linearisation and fitted roughly
before they are fitted closely. An uneven body is an unknown error that changes the body (`Effect.of_unknown`): it is
added to every set and excludes any other discrepancy; sets with it are not enlarged, and it keeps no cause out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import combinations

import numpy as np
from scipy.special import logsumexp

from femu_piezo.diagnosis.averaging import averaged
from femu_piezo.diagnosis.comparison import Comparison, NamedCause, Trial
from femu_piezo.diagnosis.enlargement import Enlargement
from femu_piezo.diagnosis.hypotheses import Hypothesis, Weighing
from femu_piezo.diagnosis.rules import Rules
from femu_piezo.diagnosis.starts import Start, log_evidence_of_pairs, start_together
from femu_piezo.diagnosis.whiteness import unexplained_share
from femu_piezo.effects.effect import Effect
from femu_piezo.inference.descent import CLOSE
from femu_piezo.inference.fit import Fit, fit, with_discrepancy
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.measurement.sweeps import SweepData
from femu_piezo.threads import blas_limit, in_parallel

#: Number of pairs of causes that are fitted, the best by linearisation.
_PAIRS = 4

Tell = Callable[[str], None]


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
    """The search for the most probable set of causes, with the sets fitted so far."""

    def __init__(self, base: Fit, response, library: tuple[Effect, ...], rules: Rules, loss: str, tell: Tell) -> None:
        self._library, self._rules, self._tell = library, rules, tell
        self._weighing = Weighing(response, base.data, library, rules, loss)
        self._base = self._weighing.hypothesis(base)
        self._known: dict[frozenset[str], Hypothesis] = {frozenset(): self._base}
        self._starts: list[list[Start]] = []  # of each single candidate
        self._taken_out: set[tuple[frozenset[str], str]] = set()  # set, and cause taken out of it
        self._replaced: set[tuple[frozenset[str], str, str]] = set()  # set, cause and what took its place
        # set → every further candidate with the fit of the set enlarged by it
        self._expanded: dict[frozenset[str], tuple[tuple[Effect, Fit | None], ...]] = {}

    def _keep(self, fits: Iterable[Fit | None]) -> None:
        new = [self._weighing.hypothesis(fit_) for fit_ in fits if fit_ is not None]
        list(in_parallel(lambda hypothesis: hypothesis.log_posterior, new))  # each caches what this computes
        for hypothesis in new:
            old = self._known.get(hypothesis.keys)
            if old is None or hypothesis.rank > old.rank:
                self._known[hypothesis.keys] = hypothesis

    def run(self) -> None:
        """Enlarge the best sets by one cause after another, then exchange each cause of the best."""
        beam, fruitless = [self._base], 0
        for size in range(1, self._rules.most_causes + 1):
            if size > 2 and self._unknown():
                break  # no cause describes what two causes leave
            before = self._described().log_posterior
            for current in beam:
                self._keep(f for _, f in self._expand(current.fit))
            if size == 1 and self._rules.most_causes > 1:
                self._keep(self._pairs(frozenset().union(*(one.keys for one in self._beam(1)))))
            best, tried, beam = self._described(), bool(beam), self._beam(size)
            fruitless = fruitless + 1 if tried and best.log_posterior <= before else 0
            # a discrepancy may stand for several causes together: one of them gains nothing then, two may
            if fruitless == (2 if best.discrepant else 1):
                break
        # | runs all: an exchange may bring up a set in which a cause is superfluous
        while (self._exchange() | self._thinned() | self._replaced_by_circuits()) and not self._unknown():
            pass

    def _beam(self, size: int) -> list[Hypothesis]:
        """The best sets of `size` causes to enlarge: fitted, near the best, and without forms of unknown errors."""
        known = (h for h in self._known.values() if len(h.keys) == size and not h.fit.extrapolated and not h.forms)
        found = sorted(known, key=lambda one: -one.log_posterior)
        least = self._described().log_posterior - self._rules.contender
        return [one for one in found[: self._rules.beam] if one.log_posterior > least]

    def _best(self) -> Hypothesis:
        """The best set; one with a form of an unknown error only if clearly better than causes that leave nothing."""
        best, described = max(self._known.values(), key=lambda one: one.rank), self._described()
        alike = best.log_posterior < described.log_posterior + self._rules.alike
        return described if alike and described.keys and not described.discrepant else best

    def _described(self) -> Hypothesis:
        """The best set without a form of an unknown error."""
        return max((one for one in self._known.values() if not one.forms), key=lambda one: one.rank)

    def _unknown(self) -> bool:
        """Whether the verdict would be "unknown": a discrepancy, and no cause or causes that leave much unexplained.

        The verdict makes an exception for a discrepancy that may be correlated noise, and looks at what each of several
        causes leaves without the others; neither is tested here.
        """
        best = self._best()
        if not best.discrepant and not best.forms:
            return False
        if not best.causes:
            return True
        described = self._known.get(best.causes, self._base).fit
        return unexplained_share(self._base.fit, described, self._rules.significant) > self._rules.unexplained

    def _thinned(self) -> bool:
        """Fit the sets near the best without their least significant cause; whether a better set was found.

        A set is enlarged from where its own fit ended. A further cause may only have helped that fit to its minimum:
        then the set can do without it.
        """
        best = self._described()
        least = best.log_posterior - self._rules.contender
        near = [h for h in self._known.values() if h.log_posterior > least and not h.fit.extrapolated and not h.forms]
        for one in near:
            weakest = self._insignificant(one.fit)
            if len(one.keys) > 1 and weakest is not None:
                self._without(one.fit, weakest)
        return self._described().keys != best.keys

    def _exchange(self) -> bool:
        """Try every candidate in each place of the best set; whether a better set was found."""
        best = self._described()
        if len(best.keys) < 2:
            return False
        for key in best.keys:
            self._keep(f for _, f in self._expand(self._without(best.fit, key)))
        return self._described().keys != best.keys

    def _replaced_by_circuits(self) -> bool:
        """Replace each cause of the best set by circuits it may be confused with; whether a better set was found.

        A set is enlarged from where the constants make up for a cause that it lacks. If that is a circuit larger than
        the specimen, the way from there is long, and the fit of another circuit that explains as much may stop in a
        minimum on it. From where the fit of the best set ended the way is short.
        """
        best, found = self._described(), []
        for cause in best.fit.parameters.causes:
            for other in self._library:
                known = self._known.get(best.keys - {cause.key} | {other.key})
                near = known is not None and known.log_posterior > best.log_posterior - self._rules.alike
                new = (best.keys, cause.key, other.key) not in self._replaced
                if new and not near and other.circuit and other.key not in best.keys and _confusable(cause, other):
                    self._replaced.add((best.keys, cause.key, other.key))
                    found.append(best.fit.parameters.without_candidate(cause.key).with_candidate(other))
        own = best.fit.parameters, best.fit.x
        self._keep(in_parallel(lambda unknowns: self._weighing.fitted(unknowns, [unknowns.carried(*own)]), found))
        return self._described().keys != best.keys

    def _without(self, current: Fit, key: str) -> Fit:
        """The set without one cause, fitted from where it stands with it; an earlier fit may have ended elsewhere."""
        whole = frozenset(current.parameters.candidates)
        keys = whole - {key}
        if keys and (whole, key) not in self._taken_out:
            self._taken_out.add((whole, key))
            parameters, before = current.parameters.without_candidate(key), self._known.get(keys)
            self._keep([self._weighing.fitted(parameters, [parameters.carried(current.parameters, current.x)])])
            if before is not None and self._known[keys].log_posterior > before.log_posterior + self._rules.alike:
                self._expanded.pop(keys, None)  # made from a worse fit
        return self._known[keys].fit if keys in self._known else self._base.fit

    def _expand(self, current: Fit) -> tuple[tuple[Effect, Fit | None], ...]:
        """Every candidate that is not in the current set, with the fit of the set enlarged by it; kept by set."""
        keys = frozenset(current.parameters.candidates)
        if keys not in self._expanded:
            titles = {effect.title for effect in current.parameters.causes}
            with_local = self._weighing.leaves_something(current)  # these candidates take longest
            others = [e for e in self._library if e.title not in titles and (with_local or e.local is None)]
            words = f"candidate with {' and '.join(sorted(keys))}" if keys else "candidate"
            unions = {effect.key: self._known.get(keys | {effect.key}) for effect in others}
            known = {key: one.fit for key, one in unions.items() if one is not None and not one.fit.extrapolated}
            enlarged = Enlargement(self._weighing, current, others, known, self._tell, words)
            self._expanded[keys] = enlarged.fits
            if not keys:
                self._starts = enlarged.starts
        return self._expanded[keys]

    def _pairs(self, enlarged: frozenset[str]) -> list[Fit | None]:
        """Fits of the best pairs of causes by linearisation: each cause of a pair may explain little by itself.

        Causes whose place is sought and forms of unknown errors are left out; the latter are added to every set anyway.

        enlarged : keys of causes that are enlarged by every other one anyway
        """
        current = self._base.fit
        every = (start for starts in self._starts for start in starts)
        singles = [start for start in every if start.cause.sites is None and not start.cause.of_unknown]
        promised: dict[frozenset[str], tuple[float, int, int]] = {}
        promises = log_evidence_of_pairs(current, singles)
        for first, second in combinations(range(len(singles)), 2):
            causes = singles[first].cause, singles[second].cause
            keys = frozenset(cause.key for cause in causes)
            if causes[0].title != causes[1].title and not keys & enlarged:
                promise = promises[first, second] + sum(self._weighing.log_prior[cause.key] for cause in causes)
                promised[keys] = max(promised.get(keys, (-np.inf, 0, 0)), (float(promise), first, second))
        best, described = sorted(promised.items(), key=lambda item: -item[1][0])[:_PAIRS], self._described()
        large = max(1.0, described.fit.chi_square / described.fit.residual.size)
        near = described.log_posterior - self._rules.contender * large
        least = max(near, current.log_evidence + self._rules.promise)  # as for single causes, without a discrepancy
        worth = [
            start_together(current, singles[first], singles[second])
            for keys, (promise, first, second) in best
            if promise > least and keys not in self._known
        ]
        self._tell("pairs")
        return list(in_parallel(lambda s: self._weighing.fitted(s.linear.parameters, [s.x, s.alone()]), worth))

    def comparison(self) -> Comparison:
        """The most probable set without the causes it could do without, and probabilities over all sets."""
        best = self._finished(self._best())
        final = self._settled(best)
        while weakest := self._insignificant(final):
            rest = self._finished(self._weighing.hypothesis(self._without(best.fit, weakest)))
            # the alternative to a single cause may be an error that nothing describes: then their odds decide
            alone = len(best.keys) == 1 and rest.discrepant and not best.discrepant
            if rest.log_posterior < best.log_posterior - (self._rules.alike if alone else self._rules.contender):
                break  # the data demand the cause, although its size is uncertain: a damped support's, like its place
            best, final = rest, self._settled(rest)
        for effect in final.parameters.causes:  # before the sum of all posteriors, in which these sets count
            self._without(best.fit, effect.key)
        total = logsumexp([other.log_posterior for other in self._known.values()])
        base = final if not best.keys else self._settled(self._base)
        named = tuple(self._named(best, effect, total) for effect in final.parameters.causes)
        described = best.fit
        for effect in best.forms:
            described = self._without(described, effect.key)
        return Comparison(
            base=base,
            singles=tuple(self._alone(effect) for effect, _ in self._expand(self._base.fit)),
            starts=tuple(of_candidate[0] for of_candidate in self._starts),
            final=final,
            described=described,
            causes=tuple(sorted((f for f in named if not f.effect.of_unknown), key=lambda item: -item.log_odds)),
            forms=tuple(f for f in named if f.effect.of_unknown),
            discrepant=best.discrepant,
            averaged=averaged(list(self._known.values())),
            rules=self._rules,
            probabilities={effect.title: self._probability(effect.title, total) for effect in self._library},
        )

    def _alone(self, effect: Effect) -> Trial:
        """The best fit with an effect as the only cause, whichever set it was reached from, and its log odds."""
        known = self._known.get(frozenset({effect.key}))
        if known is None:
            return Trial(effect, None, -np.inf)
        return Trial(effect, known.fit, known.log_posterior - self._base.log_posterior)

    def _finished(self, hypothesis: Hypothesis) -> Hypothesis:
        """The hypothesis with a close fit; fits of the search are only exact enough to rank sets."""
        found = self._weighing.fitted(hypothesis.fit.parameters, [hypothesis.fit.x], CLOSE) if hypothesis.keys else None
        if found is not None:
            self._known[hypothesis.keys] = self._weighing.hypothesis(found)
        return self._known[hypothesis.keys]

    def _settled(self, hypothesis: Hypothesis) -> Fit:
        """The fit of a hypothesis; its intervals count a discrepancy where one is probable."""
        return with_discrepancy(hypothesis.fit, hypothesis.fit.learned) if hypothesis.discrepant else hypothesis.fit

    def _insignificant(self, final: Fit) -> str | None:
        """Key of the least significant cause; None where that is significant enough, or there is no cause."""
        away = {effect.key: self._significance(final, effect) for effect in final.parameters.causes}
        key = min(away, key=away.__getitem__, default=None)
        return None if key is None or away[key] > self._rules.significant else key

    def _significance(self, final: Fit, effect: Effect) -> float:
        """Distance of a cause from rest in standard deviations or tolerances, by its most significant parameter."""
        number = final.parameters.index(effect.key)
        away = np.abs(final.parameters.values(final.x)[number] - effect.rest)
        std = np.maximum(final.std_of_effects[number], effect.tolerance)
        sizes = [index for index, parameter in enumerate(effect.parameters) if not parameter.optional]
        return float(np.max(away[sizes] / std[sizes]))

    def _named(self, final: Hypothesis, effect: Effect, total: float) -> NamedCause:
        rest = final.keys - {effect.key}
        others = {h.keys - rest: h for h in self._known.values() if rest < h.keys and len(h.keys) == len(final.keys)}
        by_key = {e.key: e for e in self._library}
        fits = [
            Trial(by_key[next(iter(keys))], h.fit, h.log_posterior - final.log_posterior)
            for keys, h in others.items()
            if len(keys) == 1
        ]
        without, described = self._known.get(rest), final.causes - {effect.key}
        fitted = [h.fit for keys, h in self._known.items() if keys <= described and not h.fit.extrapolated]
        return NamedCause(
            effect=effect,
            probability=self._probability(effect.title, total),
            fits=tuple(sorted(fits, key=lambda trial: -trial.log_odds)),
            fit_without=min(fitted, key=lambda fit_: fit_.chi_square),
            log_odds=np.inf if without is None else final.log_posterior - without.log_posterior,
        )

    def _probability(self, title: str, total: float) -> float:
        """Summed posterior of the known sets that hold a cause, over that of all sets, whose log is `total`."""
        titles = (({cause.title for cause in h.fit.parameters.causes}, h) for h in self._known.values())
        holding = [h.log_posterior for held, h in titles if title in held]
        return float(np.exp(logsumexp(holding) - total)) if holding else 0.0


def _confusable(first: Effect, second: Effect) -> bool:
    """Whether one of two effects is said to be hard to tell from the other."""
    return second.name in first.confusable_with or first.name in second.confusable_with
