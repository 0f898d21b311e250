"""none / effect / unknown, with causes, what they cannot be told from, and what to measure next."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from femu_piezo.diagnosis.compare import Comparison, Found
from femu_piezo.diagnosis.confounding import Tangent, parallel
from femu_piezo.diagnosis.whiteness import Remaining, remaining
from femu_piezo.effects.effect import Effect
from femu_piezo.inference.fit import JointFit

#: Share of the misfit, as an amplitude, that may stay unexplained under a named cause: a real cause seldom follows the
#: law of its model, but what it leaves is small beside what it takes.
_UNEXPLAINED = 0.25
#: rms error, in σ, of bands predicted by a right model that did not see them.
_PREDICTED = 1.1


@dataclass(frozen=True)
class Cause:
    """A named cause.

    Attributes
    ----------
    values, std : of its parameters, SI; the deviation includes what the law's approximations miss
    probability : from the evidence against all other candidates and none, times the share (as an amplitude) of the
        misfit that the causes explain, and predict of bands not seen
    indistinguishable_from : names of effects or constants (as "s11", or "NAME (constant)" for a held one)
    """

    effect: Effect
    values: np.ndarray
    std: np.ndarray
    probability: float
    indistinguishable_from: tuple[str, ...]


@dataclass(frozen=True)
class Verdict:
    """The answer.

    Attributes
    ----------
    before, after : what the base and the final fit leave over
    unexplained : share of the base's misfit beyond noise that the final fit leaves, as an amplitude (rms)
    hidden : effects that this sweep cannot show: (effect, the constant that imitates it)
    measurements : what to measure next, once that has been planned
    """

    word: Literal["none", "effect", "unknown"]
    causes: tuple[Cause, ...]
    before: Remaining
    after: Remaining
    unexplained: float
    hidden: tuple[tuple[Effect, str], ...]
    measurements: tuple[str, ...] = ()


def judge(comparison: Comparison, tangents: list[Tangent], frequency: np.ndarray) -> Verdict:
    """The verdict of a comparison over the frequencies (k,), Hz, of its sweep or sweeps."""
    before, after = (
        remaining(fit.residual, fit.x.size, frequency, fit.data.noise_known, fit.data.sweeps)
        for fit in (comparison.base, comparison.final)
    )
    unexplained = _unexplained(comparison.base, comparison.final)
    doubt = max(unexplained if after.structured else 0.0, _unpredicted(comparison.base, comparison.final))
    causes = tuple(
        _cause(found, index, comparison.final, tangents, 1 - doubt) for index, found in enumerate(comparison.found)
    )
    if causes:
        word = "unknown" if after.structured and unexplained > _UNEXPLAINED else "effect"
    else:
        word = "unknown" if before.structured else "none"
    hidden = tuple((t.effect, t.nearest) for t in tangents if t.hidden)
    return Verdict(word, causes, before, after, unexplained, hidden)


def _unexplained(base: JointFit, final: JointFit) -> float:
    """√[(χ²_final − freedom)/(χ²_base − freedom)] within 0…1; 0 where the base has no excess."""
    return _amplitude(final.excess, base.excess)


def _unpredicted(base: JointFit, final: JointFit) -> float:
    """The same for bands that a fit did not see; 0 where their error is what right models have."""
    return _amplitude(final.held_out_score**2 - _PREDICTED**2, base.held_out_score**2 - 1)


def _amplitude(left: float, excess: float) -> float:
    """√(left/excess) within 0…1; 0 where there is no excess."""
    return float(np.sqrt(np.clip(left / excess, 0.0, 1.0))) if excess > 0 else 0.0


def _cause(found: Found, index: int, final: JointFit, tangents: list[Tangent], explained: float) -> Cause:
    effect = found.effect
    place = [e.key for e in final.parameters.effects].index(effect.key)
    columns = final.parameters.columns(place)
    chances = found.probabilities()
    same = [e.key for e, _ in found.fits if e.title == effect.title]
    own = next(t for t in tangents if t.effect.key == effect.key)
    alike = [e.title for e, _ in found.alike]
    values = final.parameters.values(final.x)[place]
    law_error = np.array([parameter.law_error for parameter in effect.parameters])
    size = float(np.max(np.abs(values / effect.scale)))
    alike += [t.effect.title for t in tangents if t.effect.title != effect.title and parallel(own, t, size)]
    if own.hidden:
        alike.append(own.nearest)
    alike = [other for other in dict.fromkeys(alike) if other != effect.title]
    return Cause(
        effect=effect,
        values=values,
        std=np.hypot(final.std[columns] * effect.scale, law_error * values),
        probability=float(sum(chances[key] for key in same)) * explained,
        indistinguishable_from=tuple(alike),
    )
