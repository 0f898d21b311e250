"""Where fits with a further effect may begin, and what linearisation there promises."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from femu_piezo.effects.effect import Effect
from femu_piezo.inference.fit import JointFit, SweepData, linear_fit, linearised
from femu_piezo.inference.joint import JointParameters
from femu_piezo.inference.response import Evaluation

#: Size, over its scale, at which a parameter starts "at rest": there every slope exists.
_REST = 1e-3
#: Most promising sites of an effect at a place that fits start from.
_SITES = 3


@dataclass(frozen=True)
class Start:
    """Where a fit with one or two more effects may begin.

    Attributes
    ----------
    x : (n_x,) the unknowns of the fit before, then those of the new effects
    linear : the fit that linearisation there promises, places of effects held
    before : number of the unknowns of the fit before
    """

    x: np.ndarray
    linear: JointFit
    before: int

    @property
    def promised(self) -> float:
        """χ² by linearisation."""
        return self.linear.chi_square

    @property
    def before_step(self) -> np.ndarray:
        """(2k,) residual of the data at x."""
        return self.linear.residual - self.linear.jacobian @ (self.linear.x - self.x)

    @property
    def own(self) -> slice:
        """Columns of the new effects."""
        return slice(self.before, self.x.size)

    def alone(self) -> np.ndarray:
        """(n_x,) the start with the own step of the new effects alone, within the inner half of their ranges."""
        low, high = self.linear.parameters.bounds[self.own].T / 2
        return np.concatenate([self.x[: self.before], np.clip(self.linear.x[self.own], low, high)])


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
        linear = linear_fit(evaluation, data, parameters, x, np.arange(x.size))
        found.append(Start(x, linear, current.x.size))
    return sorted(found, key=lambda start: start.promised)


def start_together(data: SweepData, current: JointFit, first: Start, second: Start) -> Start:
    """A start with two more effects, of one start of each: they are taken to change the residual independently."""
    parameters = first.linear.parameters.with_effect(second.linear.parameters.effects[-1])
    x = np.concatenate([first.x, second.x[second.own]])
    columns = np.hstack([start.linear.jacobian[:, start.own] for start in (first, second)])
    moved = current.residual + sum(start.before_step - current.residual for start in (first, second))
    linear = _linearised_with(data, replace(current, residual=moved), parameters, x, columns, np.arange(x.size))
    return Start(x, linear, current.x.size)


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
    before = current.x.size
    at_rest = np.concatenate([current.x, [effect.rest[0] / effect.scale[0]], place / effect.scale[1:]])
    columns = np.zeros((slopes.size, len(effect.parameters)))
    columns[:, 0] = slopes * effect.scale[0]
    linear = _linearised_with(data, current, parameters, at_rest, columns, np.arange(before + 1))
    if linear.x[before] * effect.scale[0] < effect.bounds[0, 0]:  # a size of the wrong sign: nothing is gained
        linear = _linearised_with(data, current, parameters, at_rest, columns, np.arange(0))
    x = at_rest.copy()
    x[before] = size / effect.scale[0]
    return Start(x, linear, before)


def _linearised_with(data, current: JointFit, parameters: JointParameters, x, columns, moving) -> JointFit:
    """What linearisation promises of a fit with new effects at rest, x (n_x,), whose slopes are columns (2k, n)."""
    prior = current.prior_residual
    pull, slopes = parameters.prior(x)
    new = slopes[-columns.shape[1] :]
    known = np.concatenate([current.jacobian, current.prior_jacobian])
    beside = np.concatenate([columns, np.zeros((prior.size, columns.shape[1]))])
    jacobian = np.concatenate([np.hstack([known, beside]), new])
    residual = np.concatenate([current.residual, prior, pull[-columns.shape[1] :]])
    return linearised(data, parameters, x, residual, jacobian, moving)
