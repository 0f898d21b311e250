"""Every candidate effect fitted with all free constants, compared by evidence; forward search for more, and by pairs.

An effect is accepted where it predicts bands that the fit did not see better than the model without it, and the
evidence gains more than its price: BIC pays for the parameter, 2 ln N for having chosen among N candidates, and a
margin against errors of model and noise that are no effect. The weak prior of every parameter counts in χ².
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from femu_piezo.diagnosis.search import Trials, best_pair, try_all
from femu_piezo.effects.effect import Effect
from femu_piezo.inference.fit import JointFit, SweepData, fit_joint, with_law_misses
from femu_piezo.inference.joint import JointParameters
from femu_piezo.inference.response import Evaluation

#: Evidence (in units of BIC) beyond BIC and 2 ln N that an effect must bring.
MARGIN = 6.0
#: Share of the misfit, as an amplitude, that effects whose law is an approximation may leave beyond what such laws are
#: known to miss: no further one is sought.
_LAW = 0.1
#: Share of the misfit, as an amplitude, from which what two effects leave is no third one's.
_HOPELESS = 0.25
#: rms error, in σ, of bands not seen, above which a fit may be none of the right effects.
_FORESEEN = 1.3
#: Candidates within this of the best are not told apart by the data.
ALIKE = 6.0


@dataclass(frozen=True)
class Found:
    """One accepted effect and what else could stand in its place.

    Attributes
    ----------
    effect : the accepted one
    fits : the final set with each candidate in its place, the others kept, best first
    without : BIC of the final set without it
    """

    effect: Effect
    fits: tuple[tuple[Effect, JointFit], ...]
    without: float

    @property
    def alike(self) -> tuple[tuple[Effect, JointFit], ...]:
        """Other causes that the data do not tell from it, with their fits."""
        best = self.fits[0][1].bic
        return tuple((e, fit) for e, fit in self.fits if fit.bic < best + ALIKE and e.title != self.effect.title)

    def probabilities(self) -> dict[str, float]:
        """Probability of each candidate (by key) in this place; prior: one half that none is there, the rest equal."""
        logs = np.array([-self.without / 2, *(-fit.bic / 2 - np.log(len(self.fits)) for _, fit in self.fits)])
        weights = np.exp(logs - logs.max())
        weights /= weights.sum()
        return {effect.key: float(w) for (effect, _), w in zip(self.fits, weights[1:], strict=True)}


@dataclass(frozen=True)
class Comparison:
    """The base fit, each candidate alone, and the effects accepted one after another.

    Attributes
    ----------
    singles : each candidate alone with the constants (None where its fit did not settle), in the order of the library
    final : the fit with all accepted effects; the base where there is none
    found : the accepted effects, first the one without which most is left
    """

    base: JointFit
    singles: tuple[tuple[Effect, JointFit | None], ...]
    final: JointFit
    found: tuple[Found, ...]


def compare(
    evaluation: Evaluation,
    data: SweepData,
    parameters: JointParameters,
    start: np.ndarray,
    library: Sequence[Effect],
    *,
    most: int = 3,
    progress: Callable[[str], None] = lambda step: None,
) -> Comparison:
    """Fit the base, then candidates one by one, then forward with up to `most` effects.

    Parameters
    ----------
    parameters : material and fixed effects of the base model
    start : (n_x,) unknowns of the base
    """
    progress("base fit")
    base = fit_joint(evaluation, data, parameters, [start])
    search = _Search(evaluation, data, base, tuple(library), progress)
    price = 2 * np.log(len(library)) + MARGIN
    current = base
    while len(current.parameters.effects) < most:
        fit = search.further(current, most, price)
        if fit is None:
            break
        current = with_law_misses(evaluation, search.swapped(fit))
    found = sorted(search.places(current), key=lambda place: -place.without)
    return Comparison(base, search.on_top_of(base), current, tuple(found))


def _pays(current: JointFit, fit: JointFit | None, price: float) -> bool:
    """Whether the evidence for a larger set pays for each of its further effects."""
    if fit is None:
        return False
    return current.bic - fit.bic >= price * (len(fit.parameters.effects) - len(current.parameters.effects))


def _right(fit: JointFit) -> bool:
    """Whether a fit leaves noise alone, in bands that it did not see as well."""
    return not fit.structured and fit.held_out_score < _FORESEEN


class _Search:
    """Fits of sets of effects; what was tried on top of a set is kept."""

    def __init__(self, evaluation, data: SweepData, base: JointFit, library: tuple[Effect, ...], progress) -> None:
        self._evaluation, self._data, self._base = evaluation, data, base
        self._library, self._progress = library, progress
        self._tried: dict[frozenset[str], tuple[JointFit, Trials]] = {}

    def on_top_of(self, current: JointFit) -> Trials:
        """Every candidate that is not in the current fit, added to it."""
        chosen = current.parameters.effects
        keys = frozenset(effect.key for effect in chosen)
        if keys not in self._tried:
            words = f"beside {' and '.join(sorted(keys))}" if keys else "candidate"
            tried = try_all(
                self._evaluation,
                self._data,
                current,
                [effect for effect in self._library if effect.key not in keys],
                lambda key: self._progress(f"{words}: {key}"),
            )
            self._tried[keys] = current, tried
        return self._tried[keys][1]

    def further(self, current: JointFit, most: int, price: float) -> JointFit | None:
        """The best larger set that pays for itself: with one more effect, or the best two where there are fewer.

        Two that leave nothing but noise are taken before all that could be added to the best single one is tried.
        """
        known, options = len(current.parameters.effects), []
        if known == 1 and not _right(current):
            options.append(self.pair)
            if _pays(current, self.pair, price) and not self.pair.structured:
                return self.pair
        if not self._law_explains(current) and not self._hopeless(current):
            options.append(self.one_more(current))
        if known == 0 and most > 1 and not _pays(current, options[0], price):
            options.append(self.pair)
        return min((fit for fit in options if _pays(current, fit, price)), key=lambda fit: fit.bic, default=None)

    def _hopeless(self, current: JointFit) -> bool:
        """Whether two effects or more leave so much that a further one would hardly be the rest of it."""
        return len(current.parameters.effects) > 1 and current.excess > _HOPELESS**2 * self._base.excess

    def _law_explains(self, current: JointFit) -> bool:
        """Whether the misfit is no more than what approximate laws of effects that it names are known to miss."""
        return current.law_misses is not None and current.excess_beyond_law < _LAW**2 * self._base.excess

    def one_more(self, current: JointFit) -> JointFit | None:
        """The best fit with one more effect, of those that predict bands not seen better than the current one."""
        fits = [fit for _, fit in self.on_top_of(current) if fit is not None]
        sound = [fit for fit in fits if fit.held_out_score < current.held_out_score]
        return min(sound, key=lambda fit: fit.bic, default=None)

    @cached_property
    def pair(self) -> JointFit | None:
        """The best two effects at once; None where the base leaves nothing, or none predicts better."""
        base = self._base
        if not base.structured:
            return None
        return best_pair(
            self._evaluation, self._data, base, self._library, lambda keys: self._progress(f"together: {keys}")
        )

    def swapped(self, current: JointFit) -> JointFit:
        """Exchange earlier choices for better ones now that a further effect is known."""
        for place in range(len(current.parameters.effects) - 1):
            best = self._alternatives(current, place)[1][0][1]
            if best.bic < current.bic - 1e-6:
                current = best
        return current

    def places(self, current: JointFit) -> Iterator[Found]:
        """Each effect of a fit with everything that could stand in its place."""
        for place, effect in enumerate(current.parameters.effects):
            without, fits = self._alternatives(current, place)
            yield Found(effect, fits, without.bic)

    def _alternatives(self, current: JointFit, place: int) -> tuple[JointFit, tuple[tuple[Effect, JointFit], ...]]:
        """The fit without one place of the set, and that with every candidate there, best first."""
        effect = current.parameters.effects[place]
        without = self._without(current, place)
        tried = self.on_top_of(without)
        fits = [(e, fit) for e, fit in tried if fit is not None and e.key != effect.key]
        return without, tuple(sorted([*fits, (effect, current)], key=lambda item: item[1].bic))

    def _without(self, current: JointFit, place: int) -> JointFit:
        """The set without one of its effects, refitted; the fit that was tried upon before, where there is one."""
        keys = frozenset(e.key for index, e in enumerate(current.parameters.effects) if index != place)
        if keys in self._tried:
            return self._tried[keys][0]
        if not keys:
            return self._base
        columns = current.parameters.columns(place)
        parameters = current.parameters.without_effect(place)
        x = np.delete(current.x, np.arange(columns.start, columns.stop))
        return fit_joint(self._evaluation, self._data, parameters, [x])
