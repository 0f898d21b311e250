"""The one fit: the most probable unknowns of a sweep, their covariance, and the evidence for the model.

    −2 log p(x | data) = Σ 2 |log Z_model(x) − log Z|²/σ² + Σ ((x − mean)/std)² + walls

up to a constant, σ² the mean square of the complex relative error of a point: either part has the deviation σ/√2. The
level of σ is found with x: it begins at that of the misfit and falls to that of the noise.
Free constants, tolerances and effects are all in x (`femu_piezo.inference.unknowns`). `update` is this fit; `diagnose`
is this fit for several lists of causes. The model is linearised about the solution (Laplace): with J the Jacobian of
data and priors, H = JᵗJ, the covariance is H^-1 and the evidence

    log p(data) = −½ χ² − ½ log det(H Σ_prior) + constant,

in which a wall that is touched bounds the integral over x and is no information. The errors of the laws of causes
(`femu_piezo.inference.laws`) are unknowns too: a second cause has to explain more than the error of the law of a first.
Priors of causes are not quite normal: `femu_piezo.inference.priors` computes what that adds to the evidence.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import block_diag

from femu_piezo.inference.descent import (
    CLOSE,
    MANY,
    NEAR_LEVEL,
    UNSETTLED,
    Descent,
    MovedPosterior,
    Posterior,
    Response,
    descended,
)
from femu_piezo.inference.held_out import HeldOut
from femu_piezo.inference.laws import law_misses, log_slope
from femu_piezo.inference.losses import level_of, weight_of
from femu_piezo.inference.marginal import Columns, Marginal, Unexplained, behind_walls
from femu_piezo.inference.priors import log_prior_gain
from femu_piezo.inference.step import bounded_step
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.measurement.discrepancy import Discrepancy, learn_discrepancy, log_level_prior, profiled
from femu_piezo.measurement.discrepancy_forms import (
    Alternatives,
    of_every_resonance,
    of_one_resonance,
    of_one_step,
    shared_smooth,
)
from femu_piezo.measurement.sweeps import SweepData
from femu_piezo.threads import blas_limit, made_once

#: Steps that a fit to perturbed data makes at its beginning, whatever they cost.
_LEAPS = 3
#: Most turns in which a linearised fit, or a discrepancy, and its noise level are found one after the other.
_TURNS = 5
#: Change of the logarithm of the noise level below which the level of the evidence counts as settled.
_EXACT_LEVEL = 1e-3


@dataclass(frozen=True)
class Fit:
    """The most probable unknowns, and the model linearised there.

    Attributes
    ----------
    x : (n_x,) solution
    residual : (2k,) whitened (log Z_model − log Z)/σ, Re then Im
    jacobian : (2k, n_x) ∂residual/∂x
    further_residual, further_jacobian : (m,), (m, n_x) of the priors, the walls of the material, the readings
    log_slope : (k,) ∂log Z/∂log f of the model
    impedance : (k,) Z of the model, ohm; None where the fit is extrapolated
    level : factor on the noise that the fit was made with
    loss : name of the loss of the data
    weight : (2k,) ρ' that the loss gives the data; its square root is a factor in residual, jacobian, law and mesh
    promised_gain : gain in χ² that a further step promises, of a fit that was not brought to its end
    extrapolated : whether x follows from the model linearised at another point, without Z at x
    discrepancy : counted in the intervals beside noise and priors; None where there is none
    law, mesh : (2k, m) whitened errors of the laws of causes and of the mesh, each column one standard deviation; the
        intervals count them
    """

    parameters: Unknowns
    x: np.ndarray
    data: SweepData
    residual: np.ndarray = field(repr=False)
    jacobian: np.ndarray = field(repr=False)
    further_residual: np.ndarray = field(repr=False)
    further_jacobian: np.ndarray = field(repr=False)
    log_slope: np.ndarray = field(repr=False)
    impedance: np.ndarray | None = field(default=None, repr=False)
    level: float = 1.0
    loss: str = "linear"
    weight: np.ndarray | float = field(default=1.0, repr=False)
    promised_gain: float = 0.0
    extrapolated: bool = False
    discrepancy: Discrepancy | None = field(default=None, repr=False)
    law: np.ndarray | None = field(default=None, repr=False)
    mesh: np.ndarray | None = field(default=None, repr=False)

    @made_once
    def _rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Residual and Jacobian of data, priors, walls and readings, the data whitened by noise and discrepancy."""
        residual, jacobian = self.residual, self.jacobian
        if self.discrepancy is not None:
            whitened = self.discrepancy.whitened(np.column_stack([residual, jacobian]))
            residual, jacobian = whitened[:, 0], whitened[:, 1:]
        return (
            np.concatenate([residual, self.further_residual]),
            np.concatenate([jacobian, self.further_jacobian]),
        )

    @made_once
    def factored(self) -> Columns:
        """The Jacobian of all rows for x in prior standard deviations, that of the data in factors.

        The data are whitened by the noise alone.
        """
        std = self.parameters.prior_std
        return Columns.of(self.jacobian * std, self.further_jacobian * std)

    @made_once
    def _whitened(self) -> Columns:
        """The Jacobian of all rows for x in prior standard deviations, the data whitened by noise and discrepancy."""
        if self.discrepancy is None:
            return self.factored
        rows, count = self._rows[1] * self.parameters.prior_std, self.residual.size
        return Columns.of(rows[:count], rows[count:])

    @made_once
    def _basis(self) -> np.ndarray:
        """Q of the rows of `_whitened` at the noise level of the fit."""
        return np.linalg.qr(self._whitened.rows(self.level))[0]

    @property
    def on_bound(self) -> tuple[str, ...]:
        """Names of the unknowns that ended on a bound."""
        ended = self.parameters.on_bound(self.x)
        return tuple(name for name, there in zip(self.parameters.names, ended, strict=True) if there)

    @property
    def chi_square(self) -> float:
        """Σ residual² of data and priors."""
        residual = self._rows[0]
        return float(residual @ residual)

    @property
    def freedom(self) -> int:
        """Residuals of the data minus unknowns that the data determine."""
        return round(self.residual.size - self.determined)

    @property
    def determined(self) -> float:
        """Number of unknowns that the data determine, Σ (1 − posterior/prior variance) of independent combinations."""
        return float(np.sum(self._basis[: len(self._whitened.triangle)] ** 2))

    @made_once
    def noise_scale(self) -> float:
        """Most probable factor on the noise; with a discrepancy, at the estimate that a fit with it would have."""
        residual = self._rows[0]
        if self.discrepancy is not None:
            projected = self._whitened.projected(residual, self.level)
            residual = residual - self.level * self._whitened.expanded(self._basis @ (self._basis.T @ projected))
        squares = residual[: self.residual.size] ** 2
        return level_of(squares, self.weight, self.loss, self.residual.size - self.determined, self.data.level_std)

    @property
    def _walls(self) -> np.ndarray:
        """(m,) bool: which rows of `further_jacobian` are walls that the estimate touches."""
        found = np.any(self.further_jacobian != 0, axis=1)
        found[: self.x.size] = False
        found[found.size - len(self.parameters.readings) :] = False
        return found

    @made_once
    def prior_rows(self) -> np.ndarray:
        """F (m, n_x): `further_jacobian`, the rows of walls that the estimate touches weighted.

        A wall cuts off a part of the normal distribution. With its weighted row in place of the cut the distribution
        has the same rms distance from the estimate. So the row of a wall that is just touched, which cuts off one half,
        has the weight 0, and the intervals are as long as without it.
        """
        walls = self._walls
        if not np.any(walls):
            return self.further_jacobian
        columns, held, weights = self.factored, walls & (self.further_residual < 0), (~walls).astype(float)
        projected = columns.projected(np.concatenate([self.residual, self.further_residual]), self.level)
        weights[held] = behind_walls(
            columns.rows(self.level), projected, columns.in_all_rows(walls), columns.in_all_rows(held)
        )[2]
        return weights[:, None] * self.further_jacobian

    @made_once
    def precision_inverse(self) -> np.ndarray:
        """H^-1 (n_x, n_x), H = JᵗJ/s² + FᵗF, s the noise level of the fit, F the `prior_rows`."""
        std = self.parameters.prior_std
        return _inverse(np.concatenate([self.factored.triangle / self.level, self.prior_rows * std]), std)

    @made_once
    def _reduced_gain(self) -> np.ndarray:
        """A Q (n_x, r), with A = A Q Qᵗ the `gain` and Q (2k, r) the basis of `factored`."""
        along = self.factored.triangle / self.parameters.prior_std
        return self.precision_inverse @ along.T / self.level**2

    @made_once
    def gain(self) -> np.ndarray:
        """A (n_x, 2k): how the estimate moves with the whitened data, H^-1 Jᵗ over the square of the noise level."""
        return self._reduced_gain @ self.factored.basis.T

    @made_once
    def covariance(self) -> np.ndarray:
        """(n_x, n_x) of the estimate: s² A (I + K) Aᵗ + A L Lᵗ Aᵗ + A M Mᵗ Aᵗ + H^-1 Fᵗ F H^-1.

        The terms are those of the noise at its most probable level s, of a discrepancy of covariance s² K where one is
        probable, of errors L of the laws of causes (`femu_piezo.inference.laws`) and M of the mesh, and of the priors F
        (`prior_rows`). Without discrepancy, laws and mesh this is H^-1. The estimate itself counts noise and priors
        alone, so that its curve is the closest there is; a discrepancy widens the intervals by s² A K Aᵗ. No factor
        for misfit is applied beyond that. The coverage is tested in tests/inference/test_coverage.py.
        """
        gain, basis = self._reduced_gain, self.factored.basis
        found = self.noise_scale**2 * gain @ gain.T
        if self.discrepancy is not None:
            moved = self.noise_scale * gain @ (basis.T @ self.discrepancy.columns)
            found = found + moved @ moved.T
        for misses in (self.law, self.mesh):
            if misses is not None:
                moved = gain @ (basis.T @ misses)
                found = found + moved @ moved.T
        pulled = self.precision_inverse @ self.prior_rows.T
        return found + pulled @ pulled.T

    @property
    def std(self) -> np.ndarray:
        """(n_x,) standard deviations of the unknowns."""
        return np.sqrt(np.diag(self.covariance))

    @made_once
    def marginal(self) -> Marginal:
        """The linearised model, unknowns and errors of laws (unknowns of prior deviation 1) integrated out.

        Its residual is that with errors of laws at their best values, the unknowns following them. What the unknowns
        could gain without errors of laws is not gained: a fit that was not brought to its end stays where it is.
        """
        columns, right, walls, held = self._with_laws
        count, unknowns = self.residual.size, self.x.size
        if columns is self.factored:
            return Marginal.of(columns, right, self.noise_scale, walls, held)
        free = np.flatnonzero(~self.parameters.on_bound(self.x))
        moving = np.append(free, np.arange(unknowns, columns.triangle.shape[1]))

        def followed(which: np.ndarray, right: np.ndarray, level: float) -> np.ndarray:
            """Change (2k + m,) of a residual by the best values of some columns, at a noise level."""
            projected = columns.projected(right, level)
            step = np.linalg.lstsq(columns.rows(level)[:, which], -projected, rcond=1e-12)[0]
            return columns.expanded(columns.rows()[:, which] @ step)

        ended, level = right + followed(free, right, self.level), self.noise_scale
        for _ in range(MANY):
            found = Marginal.of(columns, right + followed(moving, ended, level), level, walls, held)
            freedom = count - float(np.sum(found.basis[:count] ** 2))
            level = level_of(found.residual**2, self.weight, self.loss, freedom, self.data.level_std)
            if abs(np.log(level / found.level)) < _EXACT_LEVEL:
                break
        return found

    @made_once
    def _with_laws(self) -> tuple[Columns, np.ndarray, np.ndarray, np.ndarray]:
        """Columns of unknowns and errors of laws, residual (2k + m,), and two choices of the m rows that are no data.

        These are (m,) bool: rows of walls that are touched, and those of them that hold the estimate.
        """
        laws, columns = self.law, self.factored
        count = 0 if laws is None else laws.shape[1]
        if laws is not None and count:
            others = block_diag(columns.others, np.eye(count))
            columns = Columns.of(np.hstack([self.jacobian * self.parameters.prior_std, laws]), others)
        right = np.concatenate([self.residual, self.further_residual, np.zeros(count)])
        walls = np.append(self._walls, np.zeros(count, dtype=bool))
        return columns, right, walls, walls & (right[self.residual.size :] < 0)

    @made_once
    def log_evidence(self) -> float:
        """log p(data) by Laplace's method at the most probable noise level, without a discrepancy."""
        model, std = self.marginal, self.data.level_std
        misfit = float(model.residual @ model.residual) / model.level**2 + float(model.further @ model.further)
        level = self.residual.size * np.log(model.level) - log_level_prior(np.log(model.level), std)
        return float(-0.5 * misfit + model.log_volume - level) + self.log_prior_gain

    @made_once
    def log_prior_gain(self) -> float:
        """Gain in log evidence by the priors of causes of `femu_piezo.inference.priors` in place of normal ones."""
        if not self.parameters.causes:
            return 0.0
        covariance, std, found = self.marginal.covariance, self.parameters.prior_std, 0.0
        for cause in self.parameters.causes:
            own = self.parameters.columns(self.parameters.index(cause.key))
            found += float(log_prior_gain(cause, self.x[own], covariance[own, own] * np.outer(std[own], std[own])))
        return found

    @made_once
    def learned(self) -> Discrepancy:
        """The most probable discrepancy for the residual that unknowns and errors of laws do not explain."""
        return self.learned_of(self.forms)

    @property
    def forms(self) -> list[list[Alternatives]]:
        """Forms that a discrepancy may have; without Z of the model only the smooth one. Large ones are not kept."""
        forms: list[Iterable[Alternatives]] = [shared_smooth(self.data, self.log_slope)]
        if self.impedance is not None:
            forms.append(of_every_resonance(self.data, self.impedance))
            forms.append(of_one_resonance(self.data, self.impedance, self.log_slope))
            forms.append(of_one_step(self.data, self.log_slope))
        return [list(form) for form in forms]

    def learned_of(self, forms: list[list[Alternatives]], level: float | None = None) -> Discrepancy:
        """The most probable discrepancy of some forms, as `learned`.

        With a discrepancy the noise may be a fraction of what it is without one. The data then determine the unknowns
        better, so noise level and discrepancy are found in turns. Unknowns on a bound stay there: with a discrepancy
        they would go beyond.

        level : factor on the noise at the first turn; that of `marginal` where None
        """
        plain = self._unexplained(self._at_level(self.marginal.level) if self.on_bound else self.marginal)
        for _ in range(1 + _TURNS):
            unexplained = plain if level is None else self._unexplained(self._at_level(level))
            none = plain.log_likelihood - unexplained.log_volume
            found = learn_discrepancy(self.data, unexplained.residual, unexplained.span, forms, self.weight, none)
            level = found.level
            if abs(np.log(level / unexplained.level)) < NEAR_LEVEL:
                break
        return found

    def _at_level(self, level: float) -> Marginal:
        """The linearised model at a noise level, unknowns that are on no bound and errors of laws integrated out."""
        columns, right, walls, held = self._with_laws
        inside = columns.without(np.flatnonzero(self.parameters.on_bound(self.x)))
        return Marginal.of(inside, right, level, walls, held)

    def _unexplained(self, model: Marginal) -> Unexplained:
        """The part of the residual that no change of unknowns or errors of laws explains, with its likelihood."""
        count = self.residual.size
        rest = np.concatenate([model.residual / model.level, model.further])
        rest = (rest - model.basis @ (model.basis.T @ rest)) * model.level
        likelihood = float(profiled(float(rest @ rest), count, self.data.level_std))
        return Unexplained(rest, model.basis[:count], model.level, model.log_volume, likelihood + model.log_volume)

    def weighted(self, rows: np.ndarray) -> np.ndarray:
        """Whitened rows (2k,) or (2k, n) times the square root of the weight that the loss gives the data."""
        return (rows.T * np.sqrt(self.weight)).T

    @property
    def log_error(self) -> np.ndarray:
        """(k,) complex log Z_model − log Z."""
        return self.data.log_error(self.residual / np.sqrt(self.weight))

    @property
    def std_of_effects(self) -> list[np.ndarray]:
        """Standard deviations of each effect's parameters, SI."""
        return [
            self.std[self.parameters.columns(number)] * effect.scale
            for number, effect in enumerate(self.parameters.effects)
        ]

    @property
    def span(self) -> np.ndarray:
        """(2k, n) Q: r − Q Qᵗ r is what no change of the unknowns within their priors, or of laws, explains."""
        return self.marginal.basis[: self.residual.size]

    @made_once
    def held_out(self) -> HeldOut:
        """Predictions of bands by fits that do not see them, noise alone in the likelihood."""
        basis = np.linalg.qr(self.factored.rows(self.level))[0]
        return HeldOut(self.data, self.residual, self.factored.expanded(basis)[: self.residual.size])


def fit(
    response: Response,
    data: SweepData,
    parameters: Unknowns,
    starts: Sequence[np.ndarray],
    *,
    gain: float = CLOSE,
    loss: str = "linear",
) -> Fit:
    """The best of coarse fits from several starts (n_x,), brought to its end.

    Parameters
    ----------
    gain : in χ² that the next step may still promise; from `COARSE` on the best coarse fit is not continued
    loss : "linear", or a robust loss of scipy ("soft_l1", "huber", "cauchy") against outliers

    Raises
    ------
    ConvergenceError : no start settles
    """
    with blas_limit():
        best = descended(Posterior(response, data, parameters), starts, gain, loss)
        impedance = data.modelled(best.parts[0])
        slope = log_slope(response, parameters, best.x, impedance)
        law = law_misses(response, data, parameters, best.x, best.parts[1])
    return _at(best, impedance, slope, law)


def closest(
    response: Response, data: SweepData, parameters: Unknowns, starts: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """(n_x,) where `fit` ends and (k,) complex log Z_model − log Z there, without the rest of a `Fit`.

    Raises ConvergenceError as `fit`.
    """
    with blas_limit():
        best = descended(Posterior(response, data, parameters), starts, CLOSE, "linear")
    return best.x, data.log_error(best.parts[0])


def _at(descent: Descent, impedance: np.ndarray, log_slope: np.ndarray, law: np.ndarray) -> Fit:
    """The fit at the end of a descent, with Z (k,), ∂log Z/∂log f (k,) and the errors of laws there.

    law : (2k, m) whitened, not yet weighted by the loss
    """
    posterior = descent.posterior
    residual, jacobian, further_residual, further_jacobian = descent.parts
    weight = weight_of(descent.loss, residual / descent.level)
    share = np.sqrt(weight)
    return Fit(
        parameters=posterior.parameters,
        x=descent.x,
        data=posterior.data,
        residual=residual * share,
        jacobian=jacobian * share[:, None],
        further_residual=further_residual,
        further_jacobian=further_jacobian,
        log_slope=log_slope,
        impedance=impedance,
        level=descent.level,
        loss=descent.loss,
        weight=weight,
        promised_gain=descent.promised_gain,
        law=law * share[:, None],
        mesh=posterior.data.mesh_misses(log_slope) * share[:, None],
    )


def precision_inverse(rows: np.ndarray, prior_std: np.ndarray) -> np.ndarray:
    """(RᵗR)^-1 (n_x, n_x) of the rows R (m, n_x) of whitened data and priors.

    By QR of the columns in prior standard deviations (n_x,), so that the product RᵗR is never formed.
    """
    return _inverse(rows * prior_std, prior_std)


def _inverse(rows: np.ndarray, prior_std: np.ndarray) -> np.ndarray:
    """(RᵗR)^-1 (n_x, n_x) for x in its units, of rows R (m, n_x) for x in prior standard deviations (n_x,)."""
    inverse = np.linalg.inv(np.linalg.qr(rows, mode="r"))
    return (inverse @ inverse.T) * np.outer(prior_std, prior_std)


def with_discrepancy(plain: Fit, discrepancy: Discrepancy | None) -> Fit:
    """The fit with intervals that count a discrepancy (none where None); `plain` itself where they do already."""
    return plain if discrepancy is plain.discrepancy else replace(plain, discrepancy=discrepancy)


def linear_fit(response: Response, before: Fit, parameters: Unknowns, x: np.ndarray) -> tuple[Fit, np.ndarray]:
    """What one Gauss-Newton step from x (n_x,) promises: the fit by linearisation, and the residual (2k,) at x.

    before : a fit to the same data, whose errors of laws and weights of the loss are taken over
    """
    residual, jacobian, further, slopes = Posterior(response, before.data, parameters).parts(x)
    residual, jacobian = before.weighted(residual), before.weighted(jacobian)
    at_x = Fit(
        parameters,
        x,
        before.data,
        residual,
        jacobian,
        further,
        slopes,
        np.zeros(residual.size // 2),
        loss=before.loss,
        weight=before.weight,
        law=before.law,
    )
    return stepped(at_x), residual


def stepped(at_x: Fit, moving: np.ndarray | None = None) -> Fit:
    """The fit at the least χ² of its linearised model within bounds, at the noise level found in turns with it.

    moving : (m,) numbers of the unknowns that move; all where None
    """
    moving = np.arange(at_x.x.size) if moving is None else moving
    std = at_x.parameters.prior_std[moving]
    low, high = ((at_x.parameters.bounds.T - at_x.x)[:, moving]) / std
    right, found = np.concatenate([at_x.residual, at_x.further_residual]), at_x
    rows = np.concatenate([at_x.jacobian, at_x.further_jacobian])[:, moving] * std
    for _ in range(_TURNS):
        weight = np.ones(right.size)
        weight[: at_x.residual.size] = 1 / found.level
        step = np.zeros(at_x.x.size)
        step[moving] = bounded_step(rows * weight[:, None], right * weight, low, high) * std
        found = replace(
            at_x,
            x=at_x.x + step,
            residual=at_x.residual + at_x.jacobian @ step,
            further_residual=at_x.further_residual + at_x.further_jacobian @ step,
            level=found.level,
            impedance=None,
            extrapolated=True,
        )
        level = found.noise_scale
        if abs(np.log(level / found.level)) < NEAR_LEVEL:
            break
        found = replace(found, level=level)
    return found


def refitted(response: Response, solution: Fit, moved: np.ndarray, pulled: np.ndarray) -> np.ndarray | None:
    """(n_x,) the solution of a fit for moved data and priors at its noise level; None where it does not settle.

    It begins with steps made whatever they cost: one along a curved ridge ends off it, and the next comes back.
    """
    posterior = MovedPosterior(response, solution.data, solution.parameters, moved, pulled)
    found = Descent(posterior, solution.x, solution.loss, solution.level)
    found.leap(_LEAPS)
    found.run(CLOSE, MANY)
    return found.x if found.promised_gain <= UNSETTLED else None
