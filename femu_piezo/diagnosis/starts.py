"""Where fits with a further effect may begin, and what linearisation there promises."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from femu_piezo.diagnosis.effect import Effect
from femu_piezo.diagnosis.evaluation import Evaluation
from femu_piezo.diagnosis.fitting import JointFit, SweepData, linear_fit, linearised
from femu_piezo.diagnosis.joint import JointParameters

#: Size, over its scale, at which a parameter starts "at rest": there every slope exists.
_REST = 1e-3
#: Most promising sites of an effect at a place that fits start from.
_SITES = 3


@dataclass(frozen=True)
class Start:
    """Where a fit with one more effect may begin.

    Attributes
    ----------
    x : (n_x,) the unknowns of the fit before, then the effect's
    linear : the fit that linearisation there promises, places of the effect held
    """

    x: np.ndarray
    linear: JointFit

    @property
    def promised(self) -> float:
        """χ² by linearisation."""
        return self.linear.chi_square

    @property
    def own(self) -> slice:
        """Columns of the new effect."""
        return self.linear.parameters.columns(len(self.linear.parameters.effects) - 1)

    def alone(self) -> np.ndarray:
        """(n_x,) the start with the effect's own step alone, within the inner half of its range."""
        low, high = self.linear.parameters.bounds[self.own].T / 2
        return np.concatenate([self.x[: self.own.start], np.clip(self.linear.x[self.own], low, high)])


def starts(evaluation: Evaluation, data: SweepData, current: JointFit, effect: Effect) -> list[Start]:
    """Starts of a fit with one more effect, the most promising first.

    At its most promising sites where it sits at a place; else at rest and at the values that its parameters list.
    """
    parameters = current.parameters.with_effect(effect)
    if effect.sites is not None:
        return _at_sites(evaluation, data, current, effect, parameters)
    found = []
    for values in (effect.rest + _REST * effect.scale, *listed_values(effect)):
        x = np.concatenate([current.x, values / effect.scale])
        found.append(Start(x, linear_fit(evaluation, data, parameters, x, np.arange(x.size))))
    return sorted(found, key=lambda start: start.promised)


def listed_values(effect: Effect) -> list[np.ndarray]:
    """Values (n,) that the first parameter's `starts` list, the others at rest."""
    return [np.array([value, *effect.rest[1:]]) for value in effect.parameters[0].starts]


def _at_sites(evaluation, data: SweepData, current: JointFit, effect: Effect, parameters: JointParameters):
    """The sites with the largest gain in χ² by linearisation at size zero, each with the size that gives it."""
    z = data.impedance * np.exp(current.log_error)
    slopes = evaluation.slopes_at_sites(current.parameters, current.x, effect) / z[:, None] * data.weight[:, None]
    rows = np.concatenate([slopes.real, slopes.imag])
    pull = np.zeros((current.prior_residual.size, rows.shape[1]))
    whole = np.concatenate([current.jacobian, current.prior_jacobian])
    span = np.linalg.svd(whole, full_matrices=False)[0]
    columns = np.concatenate([rows, pull])
    outside = columns - span @ (span.T @ columns)
    residual = np.concatenate([current.residual, current.prior_residual])
    power, along = np.sum(outside**2, axis=0), -(outside.T @ residual)
    low, high = effect.bounds[0]
    size = np.clip(along / np.where(power > 0, power, np.inf), low, high / 2)
    gain = 2 * size * along - size**2 * power
    return [
        _at_site(data, current, effect, parameters, rows[:, site], size[site], effect.sites[site, 1:])
        for site in np.argsort(-gain)[:_SITES]
    ]


def _at_site(data, current: JointFit, effect: Effect, parameters: JointParameters, slopes, size: float, place):
    """The start of `size` at a site, with the promise of the slopes (2k,) there."""
    before, count = current.x.size, len(effect.parameters)
    at_rest = np.concatenate([current.x, [effect.rest[0] / effect.scale[0]], place / effect.scale[1:]])
    prior, prior_slopes = parameters.prior(at_rest)
    rows = np.zeros((slopes.size, count))
    rows[:, 0] = slopes * effect.scale[0]
    pad = np.zeros((current.prior_residual.size, count))
    whole = np.block([[current.jacobian, rows], [current.prior_jacobian, pad]])
    jacobian = np.concatenate([whole, prior_slopes[-count:]])
    residual = np.concatenate([current.residual, current.prior_residual, prior[-count:]])
    moving = np.arange(before + 1)
    linear = linearised(data, parameters, at_rest, residual, jacobian, moving)
    if linear.x[before] * effect.scale[0] < effect.bounds[0, 0]:  # a size of the wrong sign: nothing is gained
        linear = replace(linear, x=at_rest, residual=current.residual, prior_residual=residual[slopes.size :])
    x = at_rest.copy()
    x[before] = size / effect.scale[0]
    return Start(x, linear)
