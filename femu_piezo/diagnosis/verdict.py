"""none / effect / unknown, with causes, what they cannot be told from, and what to measure next."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from femu_piezo.diagnosis.comparison import Comparison, NamedCause
from femu_piezo.diagnosis.confounding import Tangent, parallel, tangents
from femu_piezo.diagnosis.whiteness import Remaining, noise_level_of, remaining_of, unexplained_share
from femu_piezo.effects.effect import Effect
from femu_piezo.inference.fit import Fit

#: Misfit in σ of a fit with another cause in place of the named one, from which the two differ whatever their tangents
#: say: at least so large, and this share of what the named one changes, as the laws of causes are approximate.
_REFUTED, _OF_CHANGE = 10.0, 0.1


@dataclass(frozen=True)
class Size:
    """A fitted parameter of a cause: value and standard deviation in a unit of SI."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class Cause:
    """A named cause; prints as its title.

    Attributes
    ----------
    values, std : of its parameters, SI; the deviation includes what the law's approximations miss
    probability : summed posterior of the sets of causes that hold it, times its chance of being real (`no_imitation`)
    indistinguishable_from : names of effects or constants (as "s11", or "NAME (constant)" for a held one)
    """

    effect: Effect
    values: np.ndarray
    std: np.ndarray
    probability: float
    indistinguishable_from: tuple[str, ...]

    @property
    def parameters(self) -> dict[str, Size]:
        """Name of a parameter → its size."""
        found = zip(self.effect.parameters, self.values, self.std, strict=True)
        return {one.name: Size(float(value), float(std), one.unit) for one, value, std in found}

    def __str__(self) -> str:
        return self.effect.title


@dataclass(frozen=True, eq=False, repr=False)
class Verdict:
    """The answer: prints as its word, and equals it as a string.

    Attributes
    ----------
    before, after : tests of the residuals of the base and of the final fit
    unexplained : share of the base's misfit beyond noise that the named causes leave, as an amplitude (rms)
    hidden : effects that this sweep cannot show: (effect, the constant that imitates it)
    forms : forms of unknown errors in the final fit
    measurements : what to measure next, once that has been planned
    """

    word: Literal["none", "effect", "unknown"]
    causes: tuple[Cause, ...]
    before: Remaining
    after: Remaining
    unexplained: float
    hidden: tuple[tuple[Effect, str], ...]
    forms: tuple[Cause, ...] = ()
    measurements: tuple[str, ...] = ()

    @property
    def extension(self) -> tuple[Cause, ...]:
        """What the final model has beyond the base: causes, then forms of unknown errors."""
        return (*self.causes, *self.forms)

    def __str__(self) -> str:
        return self.word

    def __repr__(self) -> str:
        return f"Verdict({self.word!r}: {', '.join(map(str, self.causes)) or 'no cause'})"

    def __eq__(self, other: object) -> bool:
        return self.word == other if isinstance(other, str) else self is other

    def __hash__(self) -> int:
        return hash(self.word)


def judge(comparison: Comparison) -> Verdict:
    """The verdict of a comparison."""
    moves = tangents(comparison.base, comparison.starts)
    before, after = remaining_of(comparison.base), remaining_of(comparison.final)
    final, rules = comparison.final, comparison.rules
    discrepant = comparison.discrepant and _beyond_noise(final, rules.significant)
    # the residuals may be too rough for a smooth discrepancy, and still be no noise
    discrepant |= after.correlated and final.marginal.level > rules.loudest
    discrepant |= bool(comparison.forms)

    def share_left(before: Fit) -> float:
        """Share of the misfit of a fit that the named causes leave unexplained; 0 where that may be noise."""
        return unexplained_share(before, comparison.described, rules.significant) if discrepant else 0.0

    left = [share_left(found.fit_without) for found in comparison.causes]
    causes = tuple(
        _cause(found, comparison, moves, no_imitation(share, rules.expected_causes))
        for found, share in zip(comparison.causes, left, strict=True)
    )
    # several causes that all may be imitations can share out the misfit of an error that none of them describes
    unknown = discrepant and all(share > rules.unexplained for share in left)
    word = "unknown" if unknown else "effect" if causes else "none"
    hidden = tuple((t.effect, t.nearest) for t in moves if t.hidden)
    forms = tuple(_cause(found, comparison, moves, 1.0) for found in comparison.forms)
    return Verdict(word, causes, before, after, share_left(comparison.base), hidden, forms)


def no_imitation(left: float, expected: float) -> float:
    """Chance that a cause is real which leaves the share `left` of the misfit, as an amplitude, unexplained.

    Either an error that no cause describes is all there is and resembles the cause; or it comes on top of one of the
    `expected` causes (prior mean number). The odds of the second are expected (1 − left)/left: the less a cause leaves,
    the less likely is the resemblance.
    """
    there = expected * (1 - left)
    return there / (there + left)


def _beyond_noise(final: Fit, significant: float) -> bool:
    """Whether the discrepancy changes log Z, where it acts, by more than the noise of a point.

    A smaller one counts as correlated noise; it widens the intervals all the same.
    """
    discrepancy = final.discrepancy or final.learned
    return discrepancy.over_noise * discrepancy.level > max(noise_level_of(final, significant), 1.0)


def _cause(found: NamedCause, comparison: Comparison, moves: list[Tangent], genuine: float) -> Cause:
    effect, final = found.effect, comparison.final
    place = final.parameters.index(effect.key)
    values = final.parameters.values(final.x)[place]
    tangent = next(t for t in moves if t.effect.key == effect.key)
    size = float(np.max(np.abs((values - effect.rest) / effect.scale)[effect.sizes]))
    alike = [other.title for other in comparison.indistinguishable_from[effect.key]]
    odds = -0.5 * max(_REFUTED, _OF_CHANGE * tangent.visible * size) ** 2
    refuted = {trial.effect.title for trial in found.fits if trial.fit is not None and trial.log_odds < odds}
    others = [t for t in moves if t.effect.title not in refuted | {effect.title}]
    alike += [t.effect.title for t in others if parallel(tangent, t, size)]
    if tangent.hides(size):
        alike.append(tangent.nearest)
    return Cause(
        effect=effect,
        values=values,
        std=final.std_of_effects[place],
        probability=found.probability * genuine,
        indistinguishable_from=tuple(other for other in dict.fromkeys(alike) if other != effect.title),
    )
