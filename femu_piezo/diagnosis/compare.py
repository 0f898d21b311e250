"""Every candidate effect fitted with all free constants, compared by evidence; forward search for further ones.

An effect is accepted where it predicts bands that the fit did not see better than the model without it, and the
evidence gains more than its price: BIC pays for the parameter, 2 ln N for having chosen among N candidates, and a
margin against errors of model and noise that are no effect. The weak prior of every parameter counts in χ².
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from femu_piezo.diagnosis.effect import Effect
from femu_piezo.diagnosis.evaluation import Evaluation
from femu_piezo.diagnosis.fitting import JointFit, SweepData, fit_joint, whitened
from femu_piezo.diagnosis.joint import JointParameters
from femu_piezo.errors import ConvergenceError

#: Evidence (in units of BIC) beyond BIC and 2 ln N that an effect must bring.
MARGIN = 6.0
#: Candidates within this of the best are not told apart by the data.
ALIKE = 6.0


@dataclass(frozen=True)
class Found:
    """One accepted effect and what else could stand in its place.

    Attributes
    ----------
    effect : the accepted one
    alternatives : every candidate in its place, the others of the final set kept, best first: (effect, BIC)
    without : BIC of the final set without it
    """

    effect: Effect
    alternatives: tuple[tuple[Effect, float], ...]
    without: float

    @property
    def alike(self) -> tuple[Effect, ...]:
        """Other causes that the data do not tell from it."""
        best = self.alternatives[0][1]
        return tuple(e for e, bic in self.alternatives if bic < best + ALIKE and e.title != self.effect.title)

    def probabilities(self) -> dict[str, float]:
        """Probability of each candidate (by key) in this place; prior: one half that none is there, the rest equal."""
        count = len(self.alternatives)
        logs = np.array([-self.without / 2, *(-bic / 2 - np.log(count) for _, bic in self.alternatives)])
        weights = np.exp(logs - logs.max())
        weights /= weights.sum()
        return {effect.key: float(w) for (effect, _), w in zip(self.alternatives, weights[1:], strict=True)}


@dataclass(frozen=True)
class Comparison:
    """The base fit, each candidate alone, and the effects accepted one after another.

    Attributes
    ----------
    singles : each candidate alone with the constants (None where its fit did not settle), in the order of the library
    final : the fit with all accepted effects; the base where there is none
    found : the accepted effects
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
    price = 2 * np.log(len(library)) + MARGIN
    singles: tuple[tuple[Effect, JointFit | None], ...] = ()
    current, chosen = base, []
    for number in range(most):
        tried = _try_all(evaluation, data, current, [e for e in library if e not in chosen], progress, number)
        singles = singles or tried
        sound = [(e, fit) for e, fit in tried if fit is not None and fit.held_out_score < current.held_out_score]
        if not sound:
            break
        effect, fit = min(sound, key=lambda item: item[1].bic)
        if current.bic - fit.bic < price:
            break
        current, chosen = fit, [*chosen, effect]
        if len(chosen) > 1:
            current, chosen = _swapped(evaluation, data, base, current, chosen, library, progress)
    found = tuple(_places(evaluation, data, base, current, chosen, library, singles, progress))
    return Comparison(base, singles, current, found)


def _try_all(evaluation, data, current: JointFit, candidates, progress, number: int):
    """Each candidate on top of the current fit."""
    words = ("candidates", "second effect", "third effect")[min(number, 2)]
    found = []
    for effect in candidates:
        progress(f"{words}: {effect.key}")
        found.append((effect, _extended(evaluation, data, current, effect)))
    return tuple(found)


def _extended(evaluation, data, current: JointFit, effect: Effect) -> JointFit | None:
    """The current fit with one more effect, from the step that linearisation gives, from rest and the listed starts."""
    parameters = current.parameters.with_effect(effect)
    rest = np.concatenate([current.x, (effect.rest + 1e-3 * effect.scale) / effect.scale])
    linear = _linear_step(evaluation, data, parameters, rest)
    listed = [np.concatenate([current.x, np.atleast_1d(value) / effect.scale]) for value in effect.parameters[0].starts]
    try:
        return fit_joint(evaluation, data, parameters, [linear, rest, *listed])
    except (ConvergenceError, np.linalg.LinAlgError):
        return None


def _linear_step(evaluation: Evaluation, data: SweepData, parameters: JointParameters, x: np.ndarray) -> np.ndarray:
    """One Gauss-Newton step, the effect's parameters kept in the inner half of their range."""
    residual, jacobian = whitened(evaluation, data, parameters, x)
    norm = np.linalg.norm(jacobian, axis=0)
    norm[norm == 0] = 1.0
    step = np.linalg.lstsq(jacobian / norm, -residual, rcond=1e-9)[0] / norm
    own = parameters.columns(len(parameters.effects) - 1)
    low, high = parameters.bounds[own].T / 2
    return np.concatenate([x[: own.start], np.clip(x[own] + step[own], low, high)])


def _refit(evaluation, data, base: JointFit, current: JointFit, effects: Sequence[Effect]) -> JointFit | None:
    """The base with a set of effects, started from the current values of those it shares."""
    fit = base
    values = dict(zip((e.key for e in current.parameters.effects), current.parameters.values(current.x), strict=True))
    parameters, x = base.parameters, current.x[: base.x.size]
    for effect in effects:
        if effect.key in values:
            parameters = parameters.with_effect(effect)
            x = np.concatenate([x, values[effect.key] / effect.scale])
    new = [effect for effect in effects if effect.key not in values]
    try:
        fit = fit_joint(evaluation, data, parameters, [x])
    except (ConvergenceError, np.linalg.LinAlgError):
        return None
    for effect in new:
        extended = _extended(evaluation, data, fit, effect)
        if extended is None:
            return None
        fit = extended
    return fit


def _alternatives(evaluation, data, base, current, chosen, place: int, library, progress):
    """(effect, fit) for every candidate in one place of the chosen set, and the fit without that place."""
    rest = [effect for index, effect in enumerate(chosen) if index != place]
    without = _refit(evaluation, data, base, current, rest)
    tried = []
    for effect in library:
        if effect not in rest:
            progress(f"instead of {chosen[place].key}: {effect.key}")
            fit = None if without is None else _extended(evaluation, data, without, effect)
            if fit is not None:
                tried.append((effect, fit))
    if without is None or not tried:
        raise ConvergenceError(f"the fit without {chosen[place].key} did not settle")
    return sorted(tried, key=lambda item: item[1].bic), without


def _swapped(evaluation, data, base, current, chosen, library, progress):
    """Exchange earlier choices for better ones now that a further effect is known."""
    for place in range(len(chosen) - 1):
        tried, _ = _alternatives(evaluation, data, base, current, chosen, place, library, progress)
        effect, fit = tried[0]
        if effect.key != chosen[place].key and fit.bic < current.bic - 1e-6:
            chosen = [*chosen[:place], *chosen[place + 1 :], effect]
            current = fit
    return current, chosen


def _places(evaluation, data, base, current, chosen, library, singles, progress):
    for place, effect in enumerate(chosen):
        if len(chosen) == 1:
            tried = sorted(((e, f) for e, f in singles if f is not None), key=lambda item: item[1].bic)
            without = base
        else:
            tried, without = _alternatives(evaluation, data, base, current, chosen, place, library, progress)
        yield Found(effect, tuple((e, f.bic) for e, f in tried), without.bic)
