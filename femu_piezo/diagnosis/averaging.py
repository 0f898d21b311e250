"""The free constants averaged over causes: their posterior over all sets of causes (Bayesian model averaging).

    p(θ | data) = Σ_h P(h | data) N(θ; x_h, C_h)

over the sets h that were compared, each without and with a discrepancy (Hoeting et al., Stat. Sci. 14 (1999) 382). The
standard deviation of the named set holds only if that set is the true one. The sum also counts the sets that the data
hardly tell from the named one, and causes that a sweep cannot show and that stay as probable as a priori, such as a
wrong length that s11 compensates. Causes outside the library do not count. Where a cause of a small probability is
present after all, a constant may lie outside of its interval. The sum is not normal, so its intervals are
those of the distribution itself (Guide to the Expression of Uncertainty in Measurement, supplement 1, 7.7).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import brentq
from scipy.special import logsumexp, ndtr

from femu_piezo.inference.fit import Fit, with_discrepancy
from femu_piezo.threads import in_parallel

if TYPE_CHECKING:
    from femu_piezo.diagnosis.hypotheses import Hypothesis

#: Probability of the intervals that are stated.
LEVEL = 0.95
#: Parts of the sum whose log posterior is lower than the best by more than this are left out: fewer than a hundred of
#: them do not change such an interval.
_REACH = 10.0
#: Quantiles are sought within this many standard deviations of the mean of some part of the sum.
_FAR = 10.0
#: Tolerance of quantiles, relative to the smallest standard deviation of the parts.
_EXACT = 1e-4


@dataclass(frozen=True)
class Averaged:
    """The posterior of free constants and loss tangents: m parts, each a set of causes without or with a discrepancy.

    Attributes
    ----------
    causes : (m,) keys of the causes of each part;  discrepant : (m,) whether the part has a discrepancy as well
    weights : (m,) posterior probability of each part
    mean, std : (m, 2n) value and loss tangent of each of n constants in each part, SI
    """

    causes: tuple[tuple[str, ...], ...]
    discrepant: tuple[bool, ...]
    weights: np.ndarray = field(repr=False)
    mean: np.ndarray = field(repr=False)
    std: np.ndarray = field(repr=False)

    def below(self, values: np.ndarray) -> np.ndarray:
        """(2n,) posterior probability that each value, or tangent, is less than that in `values` (2n,)."""
        return self.weights @ ndtr((values - self.mean) / self.std)

    def quantiles(self, share: float) -> np.ndarray:
        """(2n,) quantile of each value, or tangent, at the probability `share`."""
        return np.array([self._quantile(place, share) for place in range(self.mean.shape[1])])

    def _quantile(self, place: int, share: float) -> float:
        mean, std = self.mean[:, place], self.std[:, place]
        ends = float(np.min(mean - _FAR * std)), float(np.max(mean + _FAR * std))
        return float(
            brentq(
                lambda at: self.weights @ ndtr((at - mean) / std) - share,
                *ends,
                xtol=_EXACT * float(std.min()),
                maxiter=1000,
            )
        )

    def interval(self, level: float) -> np.ndarray:
        """(2n, 2) ends of the interval that holds each value, or tangent, with probability `level`; equal tails."""
        return np.stack([self.quantiles((1 - level) / 2), self.quantiles((1 + level) / 2)], axis=1)

    def spread_by(
        self, place: int, about: float, named: tuple[str, ...], discrepant: bool
    ) -> tuple[tuple[str, ...], bool] | None:
        """Causes, and whether a discrepancy, of the set that adds most to the mean square distance from `about`.

        The named set does not count. None where no other set adds at least half of what all others add together.

        place : number of the value or tangent, 0 to 2n − 1
        """
        squares = self.weights * ((self.mean[:, place] - about) ** 2 + self.std[:, place] ** 2)
        adds: dict[tuple[tuple[str, ...], bool], float] = {}
        for causes, has_discrepancy, square in zip(self.causes, self.discrepant, squares, strict=True):
            part = tuple(sorted(causes)), has_discrepancy
            if part != (tuple(sorted(named)), discrepant):
                adds[part] = adds.get(part, 0.0) + float(square)
        most = max(adds, key=adds.__getitem__, default=None)
        return most if most is not None and adds[most] >= sum(adds.values()) / 2 else None


def averaged(hypotheses: Sequence[Hypothesis]) -> Averaged:
    """The posterior averaged over the hypotheses, without and with a discrepancy, that are not far below the best."""
    parts = [(hypothesis.log_plain, hypothesis, False) for hypothesis in hypotheses] + [
        (hypothesis.log_with_discrepancy, hypothesis, True)
        for hypothesis in hypotheses
        if np.isfinite(hypothesis.log_with_discrepancy)
    ]
    best = max(log for log, *_ in parts)
    near = [part for part in parts if part[0] >= best - _REACH]
    material = hypotheses[0].fit.parameters.material
    unit = np.stack([material.scale, np.ones_like(material.scale)], axis=1).ravel()

    def std(part: tuple[float, Hypothesis, bool]) -> np.ndarray:
        _, hypothesis, discrepant = part
        fit: Fit = with_discrepancy(hypothesis.fit, hypothesis.fit.learned if discrepant else None)
        return fit.std[: unit.size]

    logs = np.array([log for log, *_ in near])
    return Averaged(
        causes=tuple(tuple(cause.key for cause in hypothesis.fit.parameters.causes) for _, hypothesis, _ in near),
        discrepant=tuple(discrepant for *_, discrepant in near),
        weights=np.exp(logs - logsumexp(logs)),
        mean=unit * [hypothesis.fit.x[: unit.size] for _, hypothesis, _ in near],
        std=np.abs(unit) * list(in_parallel(std, near)),
    )
