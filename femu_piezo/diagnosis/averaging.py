"""The free constants whatever the cause: their posterior averaged over all sets of causes (Bayesian model averaging).

    p(θ | data) = Σ_h P(h | data) N(θ; x_h, C_h)

over the sets that were compared, each without and with a discrepancy beside it (Hoeting et al., Stat. Sci. 14 (1999)
382). The standard deviation of the named set holds if that set is the true one. In this sum have a share as well the
sets that the data hardly tell from it, and the causes that a sweep cannot show, which are as probable as they were
before: a length that is wrong within what s11 makes up for. Causes that are in no library have no share. The sum is not
normal, so that its intervals are those of the distribution itself (Guide to the Expression of Uncertainty in
Measurement, supplement 1, 7.7).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
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
#: Log odds below the best at which a part is left out: less than a hundred of them have no share in such an interval.
_REACH = 10.0
#: Deviations of every part of the sum beyond which a quantile is not looked for.
_FAR = 10.0
#: Share of the least deviation to which quantiles are found.
_EXACT = 1e-4


@dataclass(frozen=True)
class Averaged:
    """The posterior of free constants and loss tangents over m parts, sets of causes without or with a discrepancy.

    Attributes
    ----------
    causes : (m,) titles of the causes of each part;  discrepant : (m,) whether it has a discrepancy beside them
    weights : (m,) posterior probability of each
    mean, std : (m, 2n) value and loss tangent of each of n constants in each part, SI
    """

    causes: tuple[tuple[str, ...], ...]
    discrepant: tuple[bool, ...]
    weights: np.ndarray
    mean: np.ndarray
    std: np.ndarray

    def below(self, values: np.ndarray) -> np.ndarray:
        """(2n,) probability that each value, or tangent, is less than these (2n,)."""
        return self.weights @ ndtr((values - self.mean) / self.std)

    def quantiles(self, share: float) -> np.ndarray:
        """(2n,) below which each value, or tangent, is with this probability."""
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
        """(2n, 2) ends between which each is with probability `level`, as probable below as above."""
        return np.stack([self.quantiles((1 - level) / 2), self.quantiles((1 + level) / 2)], axis=1)

    def spread_by(
        self, place: int, about: float, named: tuple[str, ...], discrepant: bool
    ) -> tuple[tuple[str, ...], bool] | None:
        """Causes, and whether a discrepancy, of the parts that add most to the mean square distance from a value.

        Those of the named set itself do not count; None where no other set adds half of what all others do.
        """
        squares = self.weights * ((self.mean[:, place] - about) ** 2 + self.std[:, place] ** 2)
        adds: dict[tuple[tuple[str, ...], bool], float] = {}
        for causes, own, square in zip(self.causes, self.discrepant, squares, strict=True):
            which = tuple(sorted(causes)), own
            if which != (tuple(sorted(named)), discrepant):
                adds[which] = adds.get(which, 0.0) + float(square)
        most = max(adds, key=adds.__getitem__, default=None)
        return most if most is not None and adds[most] >= sum(adds.values()) / 2 else None


def averaged(hypotheses: Sequence[Hypothesis]) -> Averaged:
    """Over those that are not far less probable than the best."""
    parts = [(one.log_plain, one, False) for one in hypotheses] + [
        (one.log_with_discrepancy, one, True) for one in hypotheses if np.isfinite(one.log_with_discrepancy)
    ]
    best = max(log for log, *_ in parts)
    near = [part for part in parts if part[0] >= best - _REACH]
    material = hypotheses[0].fit.parameters.material
    unit = np.stack([material.scale, np.ones_like(material.scale)], axis=1).ravel()

    def std(part: tuple[float, Hypothesis, bool]) -> np.ndarray:
        _, one, discrepant = part
        fit: Fit = with_discrepancy(one.fit, one.fit.learned if discrepant else None)
        return fit.std[: unit.size]

    logs = np.array([log for log, *_ in near])
    return Averaged(
        causes=tuple(tuple(cause.title for cause in one.fit.parameters.causes) for _, one, _ in near),
        discrepant=tuple(discrepant for *_, discrepant in near),
        weights=np.exp(logs - logsumexp(logs)),
        mean=unit * [one.fit.x[: unit.size] for _, one, _ in near],
        std=np.abs(unit) * list(in_parallel(std, near)),
    )
