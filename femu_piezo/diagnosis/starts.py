"""Where fits with a further cause may begin, and what linearisation there promises."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, product
from operator import attrgetter

import numpy as np
from scipy.optimize import lsq_linear

from femu_piezo.effects.effect import Effect
from femu_piezo.inference.fit import Fit, linear_fit, stepped
from femu_piezo.inference.priors import log_prior_gain
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.inference.walls import further_rows
from femu_piezo.measurement.discrepancy import noise_level, profiled
from femu_piezo.measurement.sweeps import stacked

#: Size, over its scale, from which a parameter starts "at rest": not zero, so that every slope exists.
_REST = 1e-3
#: Sizes up to this, over their scale, count as at rest.
_AT_REST = 1.001 * _REST
#: Iterations between the steps of two causes and the noise level.
_TURNS = 4
#: Number of most promising sites of an effect at a place from which fits start.
_SITES = 3
#: Key that sorts starts, the most promising first.
_BY_PROMISE = attrgetter("promised_chi_square")


@dataclass(frozen=True)
class Start:
    """Where a fit with one or two more causes may begin.

    Attributes
    ----------
    x : (n_x,) the unknowns of the current fit, and those of the new causes
    linear : the fit that linearisation promises from x; a place is held where it starts from size zero (`_at_site`)
    residual : (2k,) whitened residual of the data where the model is linearised: x, or size zero at a site
    """

    x: np.ndarray
    linear: Fit
    residual: np.ndarray = field(repr=False)

    @property
    def promised_chi_square(self) -> float:
        """χ² that linearisation promises."""
        return self.linear.chi_square

    @property
    def cause(self) -> Effect:
        """The last of the new causes."""
        return self.linear.parameters.causes[-1]

    def columns_of(self, effect: Effect) -> slice:
        """Columns of the parameters of a cause in x."""
        parameters = self.linear.parameters
        return parameters.columns(parameters.index(effect.key))

    def direction(self, current: Fit) -> np.ndarray:
        """(2k, 1) change of the whitened sweep per scale of the size: slope, or secant from rest to the start."""
        own, effect = self.columns_of(self.cause), self.cause
        moved = self.x[own.start] - effect.rest[0] / effect.scale[0]
        if effect.sites is not None or current.parameters.has(effect) or abs(moved) <= _AT_REST:
            return self.linear.jacobian[:, own.start : own.start + 1]
        return (self.residual - current.residual)[:, None] / moved

    def stepped(self) -> np.ndarray:
        """(n_x,) end of the linearised step, within the bounds."""
        return np.clip(self.linear.x, *self.linear.parameters.bounds.T)

    def alone(self) -> np.ndarray:
        """(n_x,) x with the linearised step of the last cause alone, within half its bounds."""
        x, own = self.x.copy(), self.columns_of(self.cause)
        low, high = self.linear.parameters.bounds[own].T / 2
        x[own] = np.clip(self.linear.x[own], low, high)
        return x


def starts(response, current: Fit, effect: Effect) -> list[Start]:
    """Starts of a fit with one more cause, the most promising first.

    An effect at a place starts at its most promising sites, judged by linearisation at size zero and at its
    `start_sizes`. An effect that the fit holds within its tolerance starts from the fitted value. Any other starts at
    rest and at the values that its parameters list.
    """
    parameters = current.parameters.with_candidate(effect)
    x = parameters.carried(current.parameters, current.x)
    own, found = parameters.columns(parameters.index(effect.key)), []
    if effect.sites is not None:
        found = _at_sites(response, current, effect, parameters, x)
        for share, site in product(effect.start_sizes, effect.sites):
            at = x.copy()
            at[own] = site / effect.scale
            at[own.start + effect.sizes] *= share
            found.append(Start(at, *linear_fit(response, current, parameters, at)))
        return sorted(found, key=_BY_PROMISE)[:_SITES]
    if current.parameters.has(effect):
        lifted = _widened(current, parameters, x, {}, current.residual)
        return [Start(x, stepped(lifted), current.residual)]
    for values in (effect.rest + _REST * effect.scale, *_listed(effect)):
        at = x.copy()
        at[own] = values / effect.scale
        if abs(at[own.start] - effect.rest[0] / effect.scale[0]) <= _AT_REST:
            found.append(_at_rest(response, current, effect, parameters, at))
        else:
            found.append(Start(at, *linear_fit(response, current, parameters, at)))
    return sorted(found, key=_BY_PROMISE)


def _at_rest(response, current: Fit, effect: Effect, parameters: Unknowns, x: np.ndarray) -> Start:
    """The start at x (n_x,) with the effect at rest, so that all other slopes are those of the current fit."""
    own = parameters.columns(parameters.index(effect.key))
    residual, slopes = current.data.whitened(*response.with_jacobian(parameters.alone(effect, x), x[own]))
    residual, columns = current.weighted(residual), {effect.key: current.weighted(slopes)}
    return Start(x, stepped(_widened(current, parameters, x, columns, residual)), residual)


def starts_at_prior_means(response, current: Fit, effect: Effect) -> list[Start]:
    """The most promising starts with all tolerances at their prior means: at sites, or at rest and the listed values.

    In a fit that lacks the true cause, tolerances may have moved far to compensate it; no descent leads back.
    """
    parameters = current.parameters.with_candidate(effect)
    carried, x, found = parameters.carried(current.parameters, current.x), parameters.prior_mean.copy(), []
    x[: parameters.of_material] = carried[: parameters.of_material]
    for cause in current.parameters.causes:
        columns = parameters.columns(parameters.index(cause.key))
        x[columns] = carried[columns]
    own = parameters.columns(parameters.index(effect.key))
    at_rest = effect.rest + _REST * effect.scale
    for values in [at_rest, *_listed(effect)] if effect.sites is None else effect.sites:
        at = x.copy()
        at[own] = values / effect.scale
        found.append(Start(at, *linear_fit(response, current, parameters, at)))
    return sorted(found, key=_BY_PROMISE)[:_SITES]


def of_either_sign(found: Sequence[Start]) -> list[Start]:
    """The starts of an effect nearest to rest with a negative and with a positive size; empty unless both exist.

    Empty for an effect at a place as well. Constants may compensate small sizes of the wrong sign better than sizes
    near the true one: then no descent leads there from rest, and linearisation promises nothing.
    """
    effect = found[0].cause
    away = np.array([start.x[start.columns_of(effect).start] - effect.rest[0] / effect.scale[0] for start in found])
    beyond = [np.flatnonzero(sign * away > _AT_REST) for sign in (-1, 1)]
    if effect.sites is not None or not all(side.size for side in beyond):
        return []
    return [found[side[np.argmin(np.abs(away[side]))]] for side in beyond]


def stepped_start(response, current: Fit, start: Start) -> Start:
    """The start at the end of the linearised step of another one, within the bounds."""
    x = start.stepped()
    return Start(x, *linear_fit(response, current, start.linear.parameters, x))


def relocated(response, reached: Fit, effect: Effect) -> list[Start]:
    """Starts with the cause moved to each site, all else as the fit found it; the `_SITES` most promising, best first.

    The first starts have the constants of the fit without the cause. Where constants hide small sizes of the cause
    (`Effect.start_sizes`; empty for other effects), these may be too far off to tell one site from another.
    """
    if effect.sites is None or not effect.start_sizes:
        return []
    own = reached.parameters.columns(reached.parameters.index(effect.key))
    placed, found = np.setdiff1d(np.arange(len(effect.parameters)), effect.sizes), []
    for site in effect.sites:
        x = reached.x.copy()
        x[own.start + placed] = (site / effect.scale)[placed]
        found.append(Start(x, *linear_fit(response, reached, reached.parameters, x)))
    return sorted(found, key=_BY_PROMISE)[:_SITES]


def _listed(effect: Effect) -> list[np.ndarray]:
    """Parameters (n,), SI, to start from besides rest: each listed value of each parameter, the others at rest.

    A listed value of an optional parameter is also combined with each listed size: without a size it changes nothing.
    """
    found: list[np.ndarray] = []
    for optional in (False, True):
        sizes = list(found)
        for number, parameter in enumerate(effect.parameters):
            for value in parameter.starts if parameter.optional == optional else ():
                for before in (effect.rest + _REST * effect.scale, *sizes):
                    values = before.copy()
                    values[number] = value
                    found.append(values)
    return found


def log_evidence_of_pairs(current: Fit, alone: Sequence[Start]) -> np.ndarray:
    """(m, m) log evidence of a fit with the causes of two of m starts, by linearisation; above the diagonal, else −inf.

    The span of the unknowns of the current fit is projected out. Two causes with columns C per prior deviation leave

        χ² = rᵗr/s² + 2 gᵗp + pᵗM p,    M = I + CᵗC/s²,  g = Cᵗr/s²,

    of a residual r by the steps p within bounds (`_least_within`), and lower the evidence by ½ log det M; s is the most
    probable noise level. The changes of the residual from the current fit to each of the two starts are added.
    """
    rows, basis = current.residual.size, current.span
    columns, offsets = [], []
    for start in alone:
        own = start.columns_of(start.cause)
        columns.append(start.linear.jacobian[:, own] * start.linear.parameters.prior_std[own])
        offsets.append(start.residual - current.residual)
    widths = [part.shape[1] for part in columns]
    all_of = np.column_stack([current.residual, *offsets, *columns])
    all_of = all_of - basis @ (basis.T @ all_of)
    gram, ends = all_of.T @ all_of, np.cumsum([1 + len(alone), *widths])
    found = np.full((len(alone), len(alone)), -np.inf)
    limits = np.hstack([np.zeros((2, 0)), *map(_limits, alone)])
    of_widths: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for first, second in combinations(range(len(alone)), 2):
        of_widths.setdefault((widths[first], widths[second]), []).append((first, second))
    for wide, pairs in of_widths.items():
        places = np.array(pairs)
        own = np.hstack([ends[places[:, [side]]] + np.arange(width) for side, width in enumerate(wide)])
        low, high = limits[:, own - ends[0]]
        changed = np.hstack([np.zeros((len(pairs), 1), dtype=int), 1 + places])
        square = gram[changed[:, :, None], changed[:, None, :]].sum(axis=(1, 2))
        along = gram[own[:, :, None], changed[:, None, :]].sum(axis=2)
        inner, level = gram[own[:, :, None], own[:, None, :]], np.full((len(pairs), 1), current.level)
        for _ in range(_TURNS):
            matrix, slope = np.eye(own.shape[1]) + inner / level[:, :, None] ** 2, along / level**2
            steps = _least_within(matrix, slope, low, high)
            gained = -2 * np.sum(slope * steps, axis=1) - np.einsum("ki,kij,kj->k", steps, matrix, steps)
            left = np.maximum(square - gained * level[:, 0] ** 2, 0.0)
            level[:, 0] = noise_level(left, rows - current.determined, current.data.level_std)
        price = 0.5 * np.linalg.slogdet(matrix)[1]
        by_priors = _prior_gains(alone, places, steps, np.linalg.inv(matrix))
        found[tuple(places.T)] = profiled(left, rows, current.data.level_std) - price + by_priors
    left = current.residual - basis @ (basis.T @ current.residual)
    return found - profiled(float(left @ left), rows, current.data.level_std) + current.log_evidence


def _limits(start: Start) -> np.ndarray:
    """(2, n) lowest and highest steps of the parameters of the cause of a start, in prior standard deviations."""
    parameters, own = start.linear.parameters, start.columns_of(start.cause)
    return (parameters.bounds[own].T - start.x[own]) / parameters.prior_std[own]


def _least_within(matrix: np.ndarray, slope: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(k, n) steps p that minimise 2 gᵗp + pᵗM p within bounds, in nearly all cases, for M (k, n, n) and g (k, n).

    The step that is farthest outside its bounds is held at its bound and the rest solved again, until all are inside.
    """
    held, right = np.zeros(slope.shape, dtype=bool), -slope
    while True:
        steps = np.linalg.solve(np.where(held[:, :, None], np.eye(slope.shape[1]), matrix), right[:, :, None])[:, :, 0]
        out = np.where(held, 0.0, np.maximum(low - steps, steps - high))
        leaving = (out > 0) & (out == out.max(axis=1, keepdims=True))
        if not np.any(leaving):
            return steps
        held |= leaving
        right = np.where(leaving, np.clip(steps, low, high), right)


def _prior_gains(alone: Sequence[Start], places: np.ndarray, steps: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """(m,) gain in log evidence by the priors of the causes of m pairs of starts over normal ones (`log_prior_gain`).

    places : (m, 2) numbers of the starts of each pair
    steps, covariance : (m, n), (m, n, n) of the parameters of the first causes, then of the second, in deviations of
        the priors
    """
    found, begin = np.zeros(len(places)), 0
    for numbers in places.T:
        for number in np.unique(numbers):
            start, of = alone[number], np.flatnonzero(numbers == number)
            own = start.columns_of(start.cause)
            std, end = start.linear.parameters.prior_std[own], begin + own.stop - own.start
            at = start.x[own] + std * steps[of, begin:end]
            own_covariance = covariance[of, begin:end, begin:end] * np.outer(std, std)
            found[of] += log_prior_gain(start.cause, at, own_covariance)
        begin = end
    return found


def start_together(current: Fit, first: Start, second: Start) -> Start:
    """A start with two more causes from one start of each; the changes of the residual by the two are added."""
    parameters = first.linear.parameters.with_candidate(second.cause)
    x = parameters.carried(first.linear.parameters, first.x)
    columns = {}
    for start in (first, second):
        effect, own = start.cause, start.columns_of(start.cause)
        x[parameters.columns(parameters.index(effect.key))] = start.x[own]
        columns[effect.key] = start.linear.jacobian[:, own]
    residual = current.residual + sum(start.residual - current.residual for start in (first, second))
    return Start(x, stepped(_widened(current, parameters, x, columns, residual)), residual)


def _widened(
    current: Fit, parameters: Unknowns, x: np.ndarray, columns: Mapping[str, np.ndarray], residual: np.ndarray
) -> Fit:
    """The current fit with more unknowns, linearised at x (n_x,), where the residual is (2k,).

    columns : key → (2k, n) Jacobian of the effects whose columns are not those of the current fit
    """
    old, new = current.parameters, parameters
    jacobian = np.zeros((residual.size, new.count))
    jacobian[:, : new.of_material] = current.jacobian[:, : old.of_material]
    for number, effect in enumerate(new.effects):
        if old.has(effect):
            jacobian[:, new.columns(number)] = current.jacobian[:, old.columns(old.index(effect.key))]
        if effect.key in columns:
            jacobian[:, new.columns(number)] = columns[effect.key]
    further_residual, further_jacobian = further_rows(new, x)
    return replace(
        current,
        parameters=new,
        x=x,
        residual=residual,
        jacobian=jacobian,
        further_residual=further_residual,
        further_jacobian=further_jacobian,
        discrepancy=None,
    )


def _at_sites(response, current: Fit, effect: Effect, parameters: Unknowns, x: np.ndarray) -> list[Start]:
    """Starts at the most promising sites, judged by how much χ² small sizes there gain beyond all other unknowns."""
    slopes = response.slopes_at_sites(current.parameters, current.x, effect)
    z = current.data.impedance * np.exp(current.log_error)
    slopes = current.data.over_noise(slopes / z[:, None, None]) * effect.scale[effect.sizes]
    rows = current.weighted(stacked(slopes))
    outside = rows - np.tensordot(current.span, np.tensordot(current.span.T, rows, axes=1), axes=1)
    low, high = effect.bounds[effect.sizes].T / effect.scale[effect.sizes]
    own = parameters.columns(parameters.index(effect.key))
    usual = np.diag(1 / parameters.prior_std[own][effect.sizes])
    sizes, gains = [], []
    for columns in outside.transpose(1, 0, 2):
        basis, triangle = np.linalg.qr(columns)
        right = np.append(-basis.T @ current.residual, np.zeros(len(usual)))
        one = lsq_linear(np.concatenate([triangle, usual]), right, (np.minimum(low, 0.0), high / 2), method="bvls")
        sizes.append(one.x)
        gains.append(right @ right - 2 * one.cost)
    return [
        _at_site(current, effect, parameters, x, rows[:, site], sizes[site], effect.sites[site])
        for site in np.argsort(gains)[::-1][:_SITES]
    ]


def _at_site(current: Fit, effect: Effect, parameters: Unknowns, x, slopes, sizes, site) -> Start:
    """The start at a site with sizes (s,) in their scales, linearised at size zero with slopes (2k, s), place held."""
    own = parameters.columns(parameters.index(effect.key))
    at, here = x.copy(), own.start + effect.sizes
    at[own] = site / effect.scale
    at[here] = effect.rest[effect.sizes] / effect.scale[effect.sizes]
    columns = np.zeros((len(slopes), len(effect.parameters)))
    columns[:, effect.sizes] = slopes
    at_rest = _widened(current, parameters, at, {effect.key: columns}, current.residual)
    moving = np.setdiff1d(np.arange(x.size), own.start + np.setdiff1d(np.arange(len(effect.parameters)), effect.sizes))
    linear = stepped(at_rest, moving)
    at = at.copy()
    at[here] = sizes
    return Start(at, linear, current.residual)
