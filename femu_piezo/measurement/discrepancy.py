"""The discrepancy: an error of log Z that no effect of the model describes, its size, form and evidence.

    log Z_data = log Z_model + Φ c + noise,   c normal of variance σ²

The columns of Φ are those of a form (`femu_piezo.measurement.discrepancy_forms`): a smooth function of frequency, an
error of every resonance, a further resonance, a step. Kennedy and O'Hagan (J. R. Statist. Soc. B 63 (2001) 425) add
such a function to a model so that the errors of the model widen the intervals. A sweep shows a discrepancy only by the
change of log Z that it makes, so σ is the rms of Re and Im of that change over a sweep. σ, the form and its parameter
(a correlation length, a ratio or a frequency) are learned from the evidence.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from femu_piezo.measurement.discrepancy_forms import WEIGHTS, Alternatives, Form, Sides
from femu_piezo.measurement.sweeps import SweepData
from femu_piezo.threads import made_once

#: Standard deviations that compete (equal prior weight each).
_SIGMAS = np.geomspace(1e-6, 3.0, 27)
#: Squared norm in the rows of the data below which a unit direction of the span of the unknowns is left out: it would
#: remove no larger a share of what the other directions leave of a column.
_UNREACHED = 1e-4
#: Rounding error of Σ τ g below which the columns are projected off the span of the unknowns in their principal axes.
_ROUNDING = 1e-3
#: Corner of a bordered matrix, so large that its Cholesky factor exists.
_LARGE = 1e200
#: Range of χ² over its degrees of freedom in which likelihoods are interpolated, and nodes per factor of e.
_RANGE, _NODES = (1e-9, 1e25), 200
#: Prior probability that a sweep holds something that the model does not describe.
PRIOR = 0.1


@dataclass(frozen=True)
class Discrepancy:
    """A discrepancy with its learned size.

    Attributes
    ----------
    form : the most probable one;  place : its parameter, as in `Alternatives.places`
    sigma : rms over a sweep of Re and Im of the change of log Z that it makes, at the noise level found with it
    level : factor on the noise found with it
    log_evidence : over that of no discrepancy, the evidence averaged over forms, their parameters, and sizes
    columns : (2k, m) change of log Z by every coefficient at its standard deviation, whitened and over the noise level:
        in a fit whose noise has the level s, the discrepancy has the covariance s² columns columnsᵗ
    """

    form: Form
    place: float
    sigma: float
    level: float
    log_evidence: float
    columns: np.ndarray

    @property
    def probable(self) -> bool:
        """Whether it is more probable than none."""
        return self.log_evidence > np.log(1 / PRIOR - 1)

    def __str__(self) -> str:
        if self.form == "smooth":
            return "a smooth function of frequency"
        if self.form == "of every resonance":
            return "a separate error at every resonance"
        return f"{self.form} near {self.place / 1e3:.3g} kHz"

    @property
    def over_noise(self) -> float:
        """rms of the change of log Z over the noise, where it acts: points weigh by the square of their change."""
        squares = np.sum(self.columns**2, axis=1).reshape(2, -1).mean(axis=0)
        return float(np.sqrt(np.sum(squares**2) / np.sum(squares)))

    @made_once
    def _principal(self) -> tuple[np.ndarray, np.ndarray]:
        """Variances v (m,) of the discrepancy, and its principal axes (2k, m), columns of length √v."""
        variances, axes = np.linalg.eigh(self.columns.T @ self.columns)
        return np.maximum(variances, 0.0), self.columns @ axes

    def whitened(self, rows: np.ndarray) -> np.ndarray:
        """S⁻¹ of rows (2k,) or (2k, n) that are whitened by the noise; S Sᵗ = I + columns columnsᵗ, S symmetric."""
        variances, along = self._principal
        grown = np.sqrt(1 + variances)
        return rows - (along / (grown * (1 + grown))) @ (along.T @ rows)


def learn_discrepancy(
    data: SweepData,
    residual: np.ndarray,
    span: np.ndarray,
    forms: Iterable[Iterable[Alternatives]],
    weight: np.ndarray | float = 1.0,
    without: float | None = None,
) -> Discrepancy:
    """The most probable discrepancy for the residual of a fit, all unknowns of the fit marginalised (linear).

    With P = I − Q Qᵗ, Q the span of the unknowns within their priors, the residual r = P r_0 of data and priors and
    columns Φ, G = Φᵗ P Φ = V diag(g) Vᵗ, the evidence over none at the noise level s, τ = (σ/s)², is

        ½ Σ [ (vᵗΦᵗr/s)² τ/(1 + τ g) − log(1 + τ g) ].

    Parameters
    ----------
    residual : (2k + m,) r, whitened, the data first;  span : (2k, n) Q, the rows of the data
    forms : forms that compete, with prior weights `WEIGHTS`, and the alternatives of each, of equal weight
    weight : (2k,) that a robust loss gives the data; its square root is a factor in residual and span
    without : log likelihood of no discrepancy, where its span is another; where None, that of `residual` at its most
        probable noise level
    """
    none = float(profiled(residual @ residual, len(span), data.level_std)) if without is None else without
    fitted = _FitResidual(data, residual, span, np.sqrt(np.broadcast_to(weight, len(span))), none)
    gains = fitted.gains([one for form in forms for one in form])
    means: dict[Form, list[float]] = {}
    for one in gains:
        means.setdefault(one.form, []).append(one.mean)
    of_forms = {form: _log_mean(np.array(mean)) for form, mean in means.items()}
    weights = np.array([WEIGHTS[form] for form in of_forms])
    best = max(gains, key=lambda one: one.most + np.log(WEIGHTS[one.form]))
    level = float(noise_level(best.chi_square, len(span), data.level_std))
    gain = _log_mean(np.array(list(of_forms.values())), weights)
    chosen = best.alternative
    columns = best.size * fitted.columns(chosen)
    return Discrepancy(best.form, float(chosen.places[0]), float(best.size * level), level, gain, columns)


def _log_mean(logs: np.ndarray, weights: np.ndarray | None = None) -> float:
    """Logarithm of the (weighted) mean of numbers with these logarithms."""
    most = float(np.max(logs))
    shares = np.exp(logs - most)
    return most + float(np.log(np.mean(shares) if weights is None else np.average(shares, weights=weights)))


@dataclass(frozen=True)
class _Gains:
    """Log evidence of alternatives over no discrepancy, and the best of them.

    Attributes
    ----------
    mean : log of the mean evidence of all alternatives and sizes
    most : log evidence of the best;  size : its σ/s;  chi_square : χ² with it
    alternatives, number : all, and the number of the best
    """

    mean: float
    most: float
    size: float
    chi_square: float
    alternatives: Alternatives
    number: int

    @property
    def form(self) -> Form:
        return self.alternatives.form

    @property
    def alternative(self) -> Alternatives:
        """The best alternative alone."""
        return self.alternatives.chosen(self.number)


@dataclass(frozen=True)
class _FitResidual:
    """The residual of a fit and the span of its unknowns; arguments as of `learn_discrepancy`.

    share : (2k,) square root of the weight
    none : log likelihood without a discrepancy
    """

    data: SweepData
    residual: np.ndarray
    span: np.ndarray
    share: np.ndarray
    none: float

    @made_once
    def chi_square(self) -> float:
        """χ² of data and priors without a discrepancy."""
        return float(self.residual @ self.residual)

    @made_once
    def sides(self) -> Sides:
        """The residual of the data, then p orthogonal directions of the span in the rows of the data, (2k, 1 + p)."""
        values, vectors = np.linalg.eigh(self.span.T @ self.span)
        reached = self.span @ vectors[:, values > _UNREACHED]
        return Sides(self.data, self.share, np.column_stack([self.residual[: len(self.span)], reached]))

    def columns(self, one: Alternatives) -> np.ndarray:
        """(2k, m) of a single alternative, whitened, at σ = 1."""
        rows, white = one.indices_in(self.data), one.whitened(self.data)[:, 0]
        found = np.zeros((len(self.span), white.shape[1]))
        found[rows] = white * self.share[rows, None]
        return found

    def gains(self, every: Sequence[Alternatives]) -> list[_Gains]:
        """Gains of each of several sets of alternatives."""
        of_each = [self._chi_square_and_volume(one) for one in every]
        chi_squares, volume = (np.concatenate([part.ravel() for part in parts]) for parts in zip(*of_each, strict=True))
        ends = np.cumsum([part.size for part, _ in of_each])[:-1]
        gains = np.split(interpolated(chi_squares, len(self.span), self.data.level_std) - volume - self.none, ends)
        return [
            self._best(one, own.reshape(chi_square.shape), chi_square)
            for one, own, (chi_square, _) in zip(every, gains, of_each, strict=True)
        ]

    def _chi_square_and_volume(self, one: Alternatives) -> tuple[np.ndarray, np.ndarray]:
        """χ² (s, n) with each alternative at every size, and the volume ½ Σ log(1 + τ g) of each."""
        if len(one.places) == 1:
            values, turned = one.along_axes(self.sides)
            trace = np.sum(values) * (2 if np.iscomplexobj(turned) else 1)
            if np.finfo(float).eps * _SIGMAS[-1] ** 2 * trace < _ROUNDING:
                gained, volume = _by_principal_axes(values, turned[:, 1:], turned[:, 0])
                return self.chi_square - gained, volume
        squares, sides = one.products(self.sides)
        inside, along = sides[:, :, 1:], sides[:, :, 0]
        reduced = squares - inside @ inside.transpose(0, 2, 1)
        # elimination for many alternatives of few columns, eigenvalues for one of many
        gained, volume = (_by_elimination if len(reduced) > 1 else _by_eigenvalues)(reduced, along)
        return self.chi_square - gained, volume

    @staticmethod
    def _best(one: Alternatives, gains: np.ndarray, chi_square: np.ndarray) -> _Gains:
        """Gains of alternatives whose log evidence and χ² (s, n) at every size are given."""
        size, which = np.unravel_index(np.argmax(gains), gains.shape)
        return _Gains(
            mean=_log_mean(gains),
            most=float(gains[size, which]),
            size=float(_SIGMAS[size]),
            chi_square=float(chi_square[size, which]),
            alternatives=one,
            number=int(which),
        )


def _by_principal_axes(values: np.ndarray, inside: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(s, 1) bᵗ(1/τ + G)^-1 b and ½ log|1 + τ G| at every size, of G = diag(g) − U Uᵗ.

    With ω = τ/(1 + τ g) and W = I − Uᵗ ω U they are bᵗω b + cᵗ W^-1 c, c = Uᵗω b, and ½ Σ log(1 + τ g) + ½ log|W|.

    values, inside, along : g (m,), U (m, p), b (m,);  U Uᵗ is no more than diag(g), so that no eigenvalue of W is below
        the least 1/(1 + τ g), which has to be far above rounding. Of complex U and b, Re and Im are rows of their own,
        with the same g.
    """
    sizes, count = _SIGMAS[:, None] ** 2, inside.shape[1]
    grown = 1 + sizes * np.maximum(values, 0.0)
    weights, both = sizes / grown, np.concatenate([inside.T, along[None]])
    rows, columns = np.tril_indices(count + 1)
    pairs, times = both.real[rows] * both.real[columns], 1
    if np.iscomplexobj(both):
        pairs, times = pairs + both.imag[rows] * both.imag[columns], 2
    products = np.zeros((len(sizes), count + 1, count + 1))  # [U, b]ᵗω [U, b], the lower triangle
    products[:, rows, columns] = weights @ pairs.T
    unreduced, diagonal = products[:, -1, -1].copy(), np.arange(count)
    products[:, :count, :count] *= -1
    products[:, diagonal, diagonal] += 1
    products[:, -1, -1] = _LARGE
    factor = np.linalg.cholesky(products)  # of W, and in its last row L^-1 c
    gained = unreduced + np.sum(factor[:, -1, :count] ** 2, axis=1)
    volume = 0.5 * times * np.sum(np.log(grown), axis=1) + np.sum(np.log(factor[:, diagonal, diagonal]), axis=1)
    return gained[:, None], volume[:, None]


def _by_eigenvalues(matrices: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(s, n) bᵗ(1/τ + G)^-1 b and ½ log|1 + τ G| at every size, of G (n, m, m) and b (n, m)."""
    values, vectors = np.linalg.eigh(matrices)
    along = np.einsum("nab,na->nb", vectors, right) ** 2
    sizes = _SIGMAS[:, None, None] ** 2
    grown = 1 + sizes * np.maximum(values, 0.0)
    return np.sum(sizes / grown * along, axis=2), 0.5 * np.sum(np.log(grown), axis=2)


def _by_elimination(matrices: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `_by_eigenvalues`, by elimination of unknowns one by one, all matrices and sizes at once: for few unknowns."""
    sizes, count = _SIGMAS[:, None] ** 2, right.shape[1]
    rest = [[sizes * matrices[:, row, column] for column in range(row + 1)] for row in range(count)]
    rhs = [np.broadcast_to(right[:, row], (len(sizes), len(right))) for row in range(count)]
    gained, determinant = 0.0, 1.0
    for first in range(count):
        pivot = 1 + np.maximum(rest[first][first], 0.0)
        gained, determinant = gained + rhs[first] ** 2 / pivot, determinant * pivot
        for row in range(first + 1, count):
            share = rest[row][first] / pivot
            rhs[row] = rhs[row] - share * rhs[first]
            for column in range(first + 1, row + 1):
                rest[row][column] = rest[row][column] - share * rest[column][first]
    return sizes * gained, 0.5 * np.log(determinant)


#: Lowest logarithm of a noise level that is considered, in its prior standard deviations below 0.
_FLOOR = 3.0


def noise_level(chi_square: np.ndarray | float, freedom: float, level_std: float) -> np.ndarray | float:
    """Factor s on the noise: the most probable one, its logarithm known beforehand to `level_std`.

    chi_square : one, or (m,), each of which has its own factor

    Maximises −n log s − χ²/(2 s²) + log p(log s). The prior p is Gaussian near 1. Its tail above is that of Cauchy's
    distribution, since a stated noise may be a mere guess. Below it ends at −3 level_std, since the noise that was seen
    between neighbours, and the error of the model, are there in any case.
    """
    given, floor = np.asarray(chi_square, dtype=float), -_FLOOR * level_std
    level = np.stack([np.zeros_like(given), 0.5 * np.log(np.maximum(given, 1e-12) / freedom)])
    for _ in range(60):  # Newton steps, at most twice those that take `hold`, no less, as the curvature of the prior
        pull, hold = given * np.exp(-2 * level), 2 / (2 * level_std**2 + level**2)
        bend = np.maximum(2 * pull + hold * (1 - hold * level**2), pull + hold / 2)
        old, level = level, np.maximum(level + (pull - freedom - hold * level) / bend, floor)
        if np.all(np.abs(level - old) < 1e-12):
            break
    first, second = (_log_likelihood(one, given, freedom, level_std) for one in level)
    return np.exp(np.where(first > second, *level))[()]


def log_level_prior(level: np.ndarray | float, level_std: float) -> np.ndarray | float:
    """log p of the logarithm of a noise level (one, or an array (m,) of them), up to a constant."""
    return -np.log1p(0.5 * (level / level_std) ** 2)


def _log_likelihood(level, chi_square, freedom: float, level_std: float):
    return -freedom * level - 0.5 * chi_square * np.exp(-2 * level) + log_level_prior(level, level_std)


def profiled(chi_square: np.ndarray | float, freedom: float, level_std: float) -> np.ndarray | float:
    """log likelihood of χ² (one, or (m,)) at its most probable noise level, up to a constant."""
    level = np.log(noise_level(chi_square, freedom, level_std))
    return _log_likelihood(level, chi_square, freedom, level_std)


def interpolated(chi_square: np.ndarray, freedom: int, level_std: float) -> np.ndarray:
    """(m,) `profiled` of χ² (m,) within `_RANGE`, by cubic polynomials in log χ² with slopes −χ²/(2 s²) at nodes."""
    low, high = _RANGE
    return _between_nodes(freedom, level_std)(np.log(np.clip(chi_square / freedom, low, high)))


@lru_cache(maxsize=8)
def _between_nodes(freedom: int, level_std: float) -> CubicHermiteSpline:
    """Spline of `profiled` over log(χ²/freedom); kept, as the fits of a sweep all need the same."""
    low, high = np.log(_RANGE)
    nodes = np.linspace(low, high, round((high - low) * _NODES) + 1)
    chi_square = freedom * np.exp(nodes)
    level = np.log(noise_level(chi_square, freedom, level_std))
    slopes = -0.5 * chi_square * np.exp(-2 * level)
    return CubicHermiteSpline(nodes, _log_likelihood(level, chi_square, freedom, level_std), slopes)
