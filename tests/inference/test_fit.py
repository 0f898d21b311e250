"""The fit: exact slopes in every unknown, evidence by Laplace's method against integrals, walls of the material,
robust losses.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from laboratory import FREQUENCY, NOISE, Response

from femu_piezo.inference import descent
from femu_piezo.inference.descent import CLOSE, COARSE, RANKED
from femu_piezo.inference.ensemble import Share, with_owner
from femu_piezo.inference.fit import closest, fit, linear_fit, stepped
from femu_piezo.inference.free_constants import FreeConstants
from femu_piezo.inference.laws import log_slope
from femu_piezo.inference.marginal import Columns, Marginal
from femu_piezo.inference.unknowns import MaterialParameters, Unknowns
from femu_piezo.inference.walls import TOLERANCE, Walls, further_rows
from femu_piezo.material.library import library_material
from femu_piezo.measurement.discrepancy import log_level_prior
from femu_piezo.measurement.sweeps import SweepData
from tests.variants import variants

#: Weights of the central difference of eighth order at ±1, ±2, ±3, ±4 steps.
WEIGHTS = np.array([4 / 5, -1 / 5, 4 / 105, -1 / 280])


def difference(function, x: np.ndarray, column: int, step: float) -> np.ndarray:
    """∂f/∂x of one column by the central difference of eighth order.

    Its truncation error falls with the eighth power of the step, so that steps may be large and rounding errors small.
    """
    unit = np.eye(x.size)[column]
    ends = [function(x + k * step * unit) - function(x - k * step * unit) for k in (1, 2, 3, 4)]
    return np.tensordot(WEIGHTS, ends, axes=1) / step


def test_jacobian_of_every_unknown_of_a_laboratory(lab):
    """∂log Z/∂x against differences: constants, dimensions, density, held constants, fixture, instrument, a film of
    mass, leakage and both laws over frequency.
    """
    unknowns = lab.unknowns
    for key in ("leakage", "dielectric_dispersion", "frequency_dependent_elastic_loss/causal", "electrode_mass"):
        unknowns = unknowns.with_candidate(lab.library[key])
    x = unknowns.carried(lab.unknowns, lab.truth(4))
    x[lab.unknowns.count :] = (0.5, 0.3, 1.0, 0.4, 0.2)
    z, tangents = lab.evaluation.with_jacobian(unknowns, x)
    exact = tangents / z[:, None]
    for column, name in enumerate(unknowns.names):
        step = 0.05 / np.max(np.abs(exact[:, column]))  # one step changes log Z by 5 %
        step = min(step, 0.01 * np.ptp(unknowns.bounds[column]))
        found = difference(lambda y: np.log(lab.evaluation.impedance(unknowns, y) / z), x, column, step)
        assert np.max(np.abs(found - exact[:, column])) < 1e-6 * np.max(np.abs(exact[:, column])) + 1e-12, name


def test_jacobian_of_a_weighed_body(lab):
    """Where the mass is known the density follows from the dimensions: slope in the length, and Z of a longer body
    of lower density.
    """
    from laboratory import AXES, CONSTANTS, DENSITY, FREE, FUNDAMENTAL, SIZE, TOLERANCES

    from femu_piezo.effects.effect import EffectContext
    from femu_piezo.effects.library import library

    context = EffectContext(
        FUNDAMENTAL, FREE, CONSTANTS, AXES, DENSITY, SIZE[2], tolerances=TOLERANCES, density_from_mass=True
    )
    effects = {effect.name: effect for effect in library(context)}
    length, density = effects["wrong_length"], effects["wrong_density"]
    unknowns = replace(lab.unknowns, effects=(length,))
    x = np.append(lab.material.x_of(lab.free.start), 0.8)
    z, tangents = lab.evaluation.with_jacobian(unknowns, x)
    found = difference(lambda y: np.log(lab.evaluation.impedance(unknowns, y) / z), x, 6, 0.05)
    assert np.max(np.abs(found - tangents[:, 6] / z)) < 1e-6 * np.max(np.abs(tangents[:, 6] / z))
    # at the same mass a body (1 + stretch) times as long has a density smaller by that factor
    plain = replace(lab.unknowns, effects=(lab.library["wrong_length"], density))
    stretch = 0.8 * length.scale[0]
    lighter = np.append(x, (1 / (1 + stretch) - 1) / density.scale[0])
    np.testing.assert_allclose(lab.evaluation.impedance(plain, lighter), z, rtol=1e-12)


def test_wall_and_its_hessian(lab):
    """Behind the wall, in tangents of free and held constants: slopes of ½ |rows|², and the Hessian, against
    differences.
    """
    x = lab.truth(2)
    x[3] = 0.3  # tangent of d31, so large that the material creates energy
    walls = Walls(lab.unknowns, x)
    wall, slopes = walls.rows, walls.row_slopes
    assert np.count_nonzero(wall < -1) == 1 and np.all(wall <= 0)
    moving = np.flatnonzero(np.any(slopes != 0, axis=0))
    tangents = [i for i in moving if "tan_" in lab.unknowns.names[i]]
    assert {"tan_s11", "tan_d31", "tan_eps33T"} <= {lab.unknowns.names[i] for i in tangents}
    circuits = lab.unknowns.columns(lab.unknowns.index("instrument"))
    assert not np.any(slopes[:, circuits])

    def gradient(y: np.ndarray) -> np.ndarray:
        there = Walls(lab.unknowns, y)
        return there.row_slopes.T @ there.rows

    def half_square(y: np.ndarray) -> float:
        return 0.5 * Walls(lab.unknowns, y).cost

    exact, hessian = gradient(x), slopes.T @ slopes
    for column in moving:
        assert difference(half_square, x, column, 1e-5) == pytest.approx(exact[column], rel=1e-5, abs=1e-6 * max(exact))
    # the loss matrix is linear in the tangents, so the Gauss-Newton Hessian is exact in them
    found = np.array([difference(gradient, x, column, 1e-6)[tangents] for column in tangents])
    np.testing.assert_allclose(hessian[np.ix_(tangents, tangents)], found, rtol=1e-4, atol=1e-6 * np.abs(found).max())


def test_walls_are_those_of_every_specimen_whatever_the_sweep(lab):
    """Two specimens whose files state different errors of d33, one of them impossible; conditions of a sweep are not
    counted. Slopes by differences.
    """
    held = lab.library["wrong_insensitive_parameter:d33"]
    known = [(with_owner(held, name), np.array([error, 0.0])) for name, error in (("a", 0.05), ("b", 0.6))]
    effects = tuple(effect for effect in lab.unknowns.effects if effect.key != held.key)
    warm = replace(held, name="warm", of_conditions=True)
    unknowns = replace(lab.unknowns, effects=(*effects, warm), fixed=tuple(known))
    x = unknowns.prior_mean.copy()
    x[unknowns.columns(unknowns.index(warm.key)).start] = 0.5 / warm.scale[0]
    both = Walls(unknowns, x)
    alone = []
    for name in "ab":
        own, columns = Share((name,)).of(unknowns)
        alone.append(Walls(own, x[columns]))
    assert not alone[0].touched and alone[1].touched
    np.testing.assert_allclose(both.values, np.concatenate([one.values for one in alone]), rtol=1e-12)
    np.testing.assert_allclose(both.rows, np.concatenate([one.rows for one in alone]), rtol=1e-12)

    def half_square(y: np.ndarray) -> float:
        return 0.5 * Walls(unknowns, y).cost

    exact = both.row_slopes.T @ both.rows
    for column in range(unknowns.of_material):
        assert difference(half_square, x, column, 1e-6) == pytest.approx(
            exact[column], rel=1e-4, abs=1e-6 * np.abs(exact).max()
        )


def test_residual_of_the_wall_is_the_violation_over_the_tolerance(lab):
    """The row of the wall is the lowest eigenvalue of the loss matrix over the tolerance, and zero for a passive
    material.
    """
    x = lab.ideal.prior_mean.copy()
    x[0::2], x[1::2] = 1.0, (0.015, 0.013, 0.017)
    assert not Walls(lab.ideal, x).touched
    for tangent, passive in ((0.02, True), (0.1, False), (0.3, False)):
        x[3] = tangent
        constants = lab.material.constants(x)
        wall = Walls(lab.ideal, x).rows
        assert (wall.min() == 0) == passive == (constants.physical_faults() == [])
        lowest = min(np.linalg.eigvalsh(constants.loss_block(block))[0] for block in range(constants.block_count))
        assert wall.min() * TOLERANCE == pytest.approx(min(lowest, 0.0), rel=1e-9)


def test_wall_of_stability(lab):
    """Coupling beyond 1: the rows are the negative eigenvalues of energy and loss matrix, and their slopes agree
    with differences.
    """
    x = lab.ideal.prior_mean.copy()
    for factor, stable in ((1.0, True), (2.2, False), (2.5, False)):
        x[2] = factor
        constants, walls = lab.material.constants(x), Walls(lab.ideal, x)
        wall, slopes = walls.rows, walls.row_slopes
        blocks = range(constants.block_count)
        energy = np.concatenate([np.linalg.eigvalsh(constants.energy_block(block)) for block in blocks])
        loss = np.concatenate([np.linalg.eigvalsh(constants.loss_block(block)) for block in blocks])
        assert stable == (energy.min() > 0) == (constants.physical_faults(passive=False) == [])
        behind = np.minimum(np.concatenate([energy, loss]), 0.0) / TOLERANCE
        assert wall @ wall == pytest.approx(behind @ behind, rel=1e-9)

    def half_square(y: np.ndarray) -> float:
        return 0.5 * Walls(lab.ideal, y).cost

    for column in (0, 2, 4):
        found = difference(half_square, x, column, 1e-5)
        assert found == pytest.approx((slopes.T @ wall)[column], rel=1e-5) != 0


def test_no_fit_is_of_an_unstable_body(lab):
    """Data of an unstable body: the energy matrix of the fit has no eigenvalue below −1e-3."""
    x = lab.unknowns.prior_mean.copy()
    x[:6] = lab.material.x_of(lab.free.start)
    x[2] = 2.2
    z = lab.evaluation.impedance(lab.unknowns, x)
    for unknowns in (lab.unknowns, lab.ideal):
        start = unknowns.prior_mean.copy()
        start[:6] = lab.material.x_of(lab.free.start)
        found = fit(lab.evaluation, lab.measured(z, 7), unknowns, [start], gain=COARSE)
        assert -Walls(unknowns, found.x).values.min() * TOLERANCE < 1e-3


@pytest.mark.parametrize("tangents", [(0.012, 0.025, 0.014), (0.012, 0.03, 0.014), (0.004, 0.05, 0.005)])
@pytest.mark.parametrize("loss", ["linear", "soft_l1", "huber", "cauchy"])
def test_no_fit_creates_energy(lab, loss, tangents):
    """Data of a body that creates energy: the loss matrix of the fit has no eigenvalue below −1e-3, for every loss
    function, with tolerances and without.
    """
    x = lab.unknowns.prior_mean.copy()
    x[:6] = lab.material.x_of(lab.free.start)
    x[[1, 3, 5]] = tangents
    assert lab.material.constants(x[:6]).physical_faults(tolerance=1e-3) != []
    z = lab.evaluation.impedance(lab.unknowns, x)
    for unknowns in (lab.unknowns, lab.ideal):
        data = lab.measured(z, 7)
        start = unknowns.prior_mean.copy()
        start[:6] = lab.material.x_of(lab.free.start)
        found = fit(lab.evaluation, data, unknowns, [start], loss=loss)
        # walls of the free constants together with the held ones as fitted
        assert -Walls(unknowns, found.x).values.min() * TOLERANCE < 1e-3


class Curved(Response):
    """A response log Z = A (x − x0) + B (x − x0)² that is nearly linear in any number of unknowns."""

    def __init__(self, size: int, seed: int, strength: float, curvature: float) -> None:
        rng = np.random.default_rng(seed)
        self.slopes = strength * (rng.standard_normal((30, size)) + 0.5j * rng.standard_normal((30, size)))
        self.curvature = curvature * rng.standard_normal((30, size))
        self.x0 = np.tile([1.0, 0.02], size)[:size]

    def logarithm(self, x: np.ndarray) -> np.ndarray:
        """log Z (30, …) at x (size, …)."""
        away = x - self.x0.reshape(-1, *[1] * (x.ndim - 1))
        return np.tensordot(self.slopes, away, axes=1) + np.tensordot(self.curvature, away**2, axes=1)

    def with_jacobian(self, parameters, x):
        z = np.exp(self.logarithm(x))
        return z, z[:, None] * (self.slopes + 2 * self.curvature * (x - self.x0))


class Ridge(Response):
    """A response that determines y − 3 x² far better than x (both in units of the prior); counts its evaluations."""

    def __init__(self, unknowns: Unknowns) -> None:
        self._mean, self._std, self.count = unknowns.prior_mean, unknowns.prior_std, 0

    def with_jacobian(self, parameters, x):
        self.count += 1
        first, second = (x - self._mean) / self._std
        log = np.append(1e4 * (second - 3 * first**2), np.full(29, 0.6 * (first - 1)))
        slopes = np.zeros((30, 2), dtype=complex)
        slopes[0], slopes[1:, 0] = (-6e4 * first, 1e4), 0.6
        z = np.exp(1e-3 * log)
        return z, z[:, None] * 1e-3 * slopes / self._std


def test_a_fit_along_a_curved_ridge_ends_early_unless_it_is_a_close_one(monkeypatch):
    """A fit that is only to be ranked ends where its recent steps gain less than asked; a close fit goes on to the
    minimum.

    _PACE = 1000 switches the early end off.
    """
    free = FreeConstants.of(library_material("pzt-5h").constants, ("s11",))
    real = free.start[0].real
    unknowns = Unknowns(
        MaterialParameters.around(free, free.start), {"s11": (real, 0.1 * real), "tan_s11": (0.1, 0.01)}
    )
    data = SweepData(np.linspace(1e3, 2e3, 30), np.ones(30, dtype=complex), np.full(30, 1e-3), True)
    counts, found = [], []
    for gain, pace in ((RANKED, descent._PACE), (RANKED, 1000), (CLOSE, descent._PACE)):
        monkeypatch.setattr(descent, "_PACE", pace)
        response = Ridge(unknowns)
        found.append(fit(response, data, unknowns, [unknowns.prior_mean], gain=gain))
        counts.append(response.count)
    assert counts[0] < 0.7 * counts[1] and counts[2] == counts[1]
    early, late, close = (one.chi_square for one in found)
    assert close <= late < early < late + 2


def test_all_of_a_close_fit_belongs_to_where_it_ends(lab):
    """Z, ∂log Z/∂log f, priors and walls are those at x: for a fit that starts next to its end, and one that ends on a
    wall.
    """
    x = lab.truth(3)
    unknowns, data = lab.unknowns, lab.measured(lab.evaluation.impedance(lab.unknowns, x), 3)
    first = fit(lab.evaluation, data, unknowns, [lab.near(x)])
    lossy = x.copy()
    lossy[unknowns.names.index("tan_d31")] += 0.05  # more than a passive plate has
    active = lab.measured(lab.evaluation.impedance(unknowns, lossy), 3)
    for sweep, start in ((data, first.x + 0.02 * first.std), (active, lab.near(lossy))):
        found = fit(lab.evaluation, sweep, unknowns, [start])
        z, tangents = lab.evaluation.with_jacobian(unknowns, found.x)
        slope, (residual, jacobian) = log_slope(lab.evaluation, unknowns, found.x, z), sweep.whitened(z, tangents)
        np.testing.assert_allclose(found.impedance, z, rtol=1e-12)
        np.testing.assert_allclose(found.log_slope, slope, atol=1e-4 * np.max(np.abs(slope)))
        np.testing.assert_allclose(found.residual, residual, atol=1e-8 * np.max(np.abs(residual)))
        np.testing.assert_allclose(found.jacobian, jacobian, atol=1e-8 * np.max(np.abs(jacobian)))
        further, slopes = further_rows(unknowns, found.x)
        np.testing.assert_allclose(found.further_residual, further, atol=1e-12)
        np.testing.assert_allclose(found.further_jacobian, slopes, atol=1e-9 * np.max(np.abs(slopes)))
    assert Walls(unknowns, found.x).touched


class Detour:
    """Stands for a descent.

    The one that starts at 0 settles at once with a cost of 300. The one that starts at 1 costs 400 until its third run
    and then 100.
    """

    def __init__(self, posterior, start, loss):
        self.x, self.level, self.promised_gain, self.parts, self.calls = start, 1.0, np.inf, None, 0

    def run(self, gain, most):
        self.calls += 1
        self.promised_gain = 50.0 if self.x[0] == 1 and self.calls < 3 else 0.1
        return self

    def cost(self, parts, level):
        return 300.0 if self.x[0] == 0 else 400.0 if self.calls < 3 else 100.0


def test_a_descent_that_takes_a_detour_is_compared_at_its_end(monkeypatch):
    """A descent goes on while its next step promises more than a tenth of its cost.

    A single start has no others to be compared with and ends after one coarse run; with one run allowed (_RUNS = 1) the
    detour loses.
    """
    monkeypatch.setattr(descent, "Descent", Detour)
    ends = np.array([0.0]), np.array([1.0])
    best = descent.descended(None, ends, COARSE, "linear")
    assert best.x is ends[1] and best.calls == 3
    assert descent.descended(None, ends[1:], COARSE, "linear").calls == 1
    monkeypatch.setattr(descent, "_RUNS", 1)
    assert descent.descended(None, ends, COARSE, "linear").x is ends[0]


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("curvature", [0.0, 0.02])
def test_evidence_is_the_integral_over_prior_and_likelihood(known, curvature):
    """Against the integral over a grid of the two unknowns, at the noise level of the fit.

    Exact for a linear response, within 0.02 for a slightly curved one.
    """
    free = FreeConstants.of(library_material("pzt-5h").constants, ("s11",))
    prior = {"s11": (1.05 * free.start[0].real, 0.1 * free.start[0].real), "tan_s11": (0.03, 0.04)}
    unknowns = Unknowns(MaterialParameters.around(free, free.start), prior)
    response = Curved(2, 5, 0.05, curvature)
    rng = np.random.default_rng(6)
    noise = 3e-3
    z = np.exp(response.logarithm(np.array([1.01, 0.04])) + noise * rng.standard_normal(30) * (1 + 1j) / np.sqrt(2))
    data = SweepData(np.linspace(1e3, 2e3, 30), z, np.full(30, noise), known)
    found = fit(response, data, unknowns, [unknowns.prior_mean])
    scale = found.noise_scale
    axes = [np.linspace(m - 9 * s, m + 9 * s, 401) for m, s in zip(found.x, found.std, strict=True)]
    grid = np.array(np.meshgrid(*axes, indexing="ij"))
    error = (response.logarithm(grid) - np.log(z)[:, None, None]) * np.sqrt(2) / noise
    mean, std = unknowns.prior_mean[:, None, None], unknowns.prior_std[:, None, None]
    log_density = -0.5 * np.sum(np.abs(error) ** 2, axis=0) / scale**2 - 60 * np.log(scale)
    log_density += np.sum(-0.5 * ((grid - mean) / std) ** 2 - np.log(np.sqrt(2 * np.pi) * std), axis=0)
    cell = np.prod([axis[1] - axis[0] for axis in axes])
    top = log_density.max()
    integral = top + np.log(np.sum(np.exp(log_density - top)) * cell)
    expected = integral + log_level_prior(np.log(scale), data.level_std)
    assert found.log_evidence == pytest.approx(expected, abs=1e-4 if curvature == 0 else 0.02)
    # the stated deviations are those of the same density
    share = np.exp(log_density - top)
    share /= share.sum()
    middle = np.sum(share * grid, axis=(1, 2))
    spread = np.sum(share * (grid - middle[:, None, None]) ** 2, axis=(1, 2))
    np.testing.assert_allclose(np.sqrt(spread), found.std, rtol=1e-5 if curvature == 0 else 0.02)


@pytest.mark.parametrize("away", [0.0, 0.3, 3.0, 40.0])
def test_evidence_at_a_wall_is_the_integral_in_front_of_it(away):
    """Two unknowns that must satisfy x + 2y > b, against the integral of their density over that half-plane by a
    grid.

    Twice the integral is counted, so that the evidence is continuous where a wall is just touched. away : distance of
    the unconstrained optimum behind the wall, in standard deviations
    """
    stiff, slope = 1e4, np.array([1.0, 2.0])
    columns = np.array([[2.0, 0.3], [0.1, 1.5], [1.0, 0.0], [0.0, 1.0]])
    right = -columns @ np.array([0.2, -0.1])
    deviation = np.sqrt(slope @ np.linalg.solve(columns.T @ columns, slope))
    border = slope @ np.array([0.2, -0.1]) + away * deviation
    wall = stiff * np.append(slope, -border)
    rows, residual = np.vstack([columns, wall[:2]]), np.append(right, wall[2])
    best = np.linalg.lstsq(rows, -residual, rcond=None)[0]
    residual = residual + rows @ best
    found = Marginal.of(Columns.of(rows[:2], rows[2:]), residual, 1.0, *2 * [np.arange(3) == 2])
    # coordinates: u along the wall, t the distance from it into the allowed half-plane
    along = np.array([2.0, -1.0])
    u, t = np.meshgrid(np.linspace(-12, 12, 801), np.geomspace(1e-6, 12, 1601))
    places = best + u[..., None] * along / np.sqrt(5) + (t[..., None] * slope / np.sqrt(5))
    squares = np.sum((places @ columns.T + right) ** 2, axis=-1)
    density = np.exp(-0.5 * (squares - np.sum((columns @ best + right) ** 2)))
    integral = np.trapezoid(np.trapezoid(density, u[0], axis=1), t[:, 0])
    assert found.log_volume == pytest.approx(np.log(2 * integral / (2 * np.pi)), abs=2e-3)
    if away == 0:
        plain, none = Columns.of(columns[:2], columns[2:]), np.zeros(2, dtype=bool)
        free = Marginal.of(plain, right + columns @ best, 1.0, none, none)
        assert found.log_volume == pytest.approx(free.log_volume, abs=1e-6)


def test_evidence_at_two_walls():
    """Two perpendicular walls contribute two independent factors; the same wall twice contributes hardly more than
    one.
    """

    def volume(*walls):
        rows = np.vstack([np.eye(2), *(1e4 * np.array(wall) for wall in walls)])
        residual = np.append(
            np.zeros(2), np.full(len(walls), -1e4)
        )  # the optimum without a wall lies one standard deviation behind it
        best = np.linalg.lstsq(rows, -residual, rcond=None)[0]
        held = np.arange(residual.size) > 1
        return Marginal.of(Columns.of(rows[:0], rows), residual + rows @ best, 1.0, held, held).log_volume

    of_one_wall = volume((1.0, 0.0))
    assert volume((1.0, 0.0), (0.0, 1.0)) == pytest.approx(2 * of_one_wall, abs=1e-3)
    assert volume((1.0, 0.0), (1.0, 1e-3)) == pytest.approx(of_one_wall, abs=0.05)


@pytest.mark.parametrize("away", [0.0, 0.3, 3.0, 40.0])
def test_intervals_at_a_wall_have_the_rms_width_of_the_truncated_normal(lab, away):
    """Deviation across one held wall against the rms distance from it of a truncated normal distribution, by
    quadrature.

    away : distance of the unconstrained optimum behind the wall, in standard deviations
    """
    x = lab.material.x_of(lab.free.start)
    found = fit(lab.evaluation, lab.measured(lab.evaluation.impedance(lab.ideal, x), 1), lab.ideal, [x])
    assert not np.any(found.further_jacobian[found.x.size :])
    direction = np.zeros(found.x.size)
    direction[[1, 3]] = 1.0, -0.5
    deviation = np.sqrt(direction @ found.covariance @ direction)
    stiff = 1e6 / deviation
    further, residual = found.further_jacobian.copy(), found.further_residual.copy()
    further[found.x.size] = stiff * direction
    residual[found.x.size] = (
        -away / (stiff * deviation) - 1e-12
    )  # violation at which the stiff wall balances the pull of the data
    force = stiff * -residual[found.x.size] * direction
    pulled = np.linalg.lstsq(found.jacobian.T, found.level**2 * force, rcond=None)[0]
    held = replace(found, further_jacobian=further, further_residual=residual, residual=found.residual + pulled)
    t = np.linspace(0, 12, 200001)
    density = np.exp(-0.5 * t**2 - away * t)
    expected = np.sqrt(np.sum(t**2 * density) / np.sum(density))
    rows = np.concatenate([held.jacobian / held.level, held.prior_rows])
    inverse = np.linalg.inv(rows.T @ rows)
    assert np.sqrt(direction @ inverse @ direction) / deviation == pytest.approx(expected, rel=1e-2)


def test_evidence_integrates_over_errors_of_laws():
    """Against the density of the data of a linear model, with priors, noise and errors of laws in one covariance.

    With the errors of the laws the noise level is 1 within 0.2, and no discrepancy is found; without them it is above
    3.
    """
    free = FreeConstants.of(library_material("pzt-5h").constants, ("s11",))
    prior = {"s11": (1.05 * free.start[0].real, 0.1 * free.start[0].real), "tan_s11": (0.03, 0.04)}
    unknowns = Unknowns(MaterialParameters.around(free, free.start), prior)
    response, noise, rng = Curved(2, 5, 0.05, 0.0), 3e-3, np.random.default_rng(6)
    misses = (
        8 * np.repeat(np.eye(6), 10, axis=0) * rng.standard_normal((60, 1))
    )  # whitened errors of the law, one independent error for each of six bands
    wrong = misses @ rng.standard_normal(6) * noise / np.sqrt(2)
    error = noise * rng.standard_normal(30) * (1 + 1j) / np.sqrt(2) + wrong[:30] + 1j * wrong[30:]
    z = np.exp(response.logarithm(np.array([1.01, 0.04])) + error)
    data = SweepData(np.linspace(1e3, 2e3, 30), z, np.full(30, noise), True)
    plain = fit(response, data, unknowns, [unknowns.prior_mean])
    honest = replace(plain, law=misses)
    centre = data.whitened(*response.with_jacobian(unknowns, unknowns.prior_mean))[0]

    def density(one, laws: np.ndarray) -> float:
        scale, slopes = one.marginal.level, plain.jacobian * unknowns.prior_std
        covariance = scale**2 * np.eye(60) + slopes @ slopes.T + laws @ laws.T
        _, determinant = np.linalg.slogdet(covariance)
        level = log_level_prior(np.log(scale), data.level_std)
        return float(-0.5 * (centre @ np.linalg.solve(covariance, centre) + determinant) + level)

    assert plain.log_evidence == pytest.approx(density(plain, np.zeros((60, 1))), abs=1e-6)
    assert honest.log_evidence == pytest.approx(density(honest, misses), abs=1e-6)
    assert honest.log_evidence > plain.log_evidence + 10
    assert honest.marginal.level == pytest.approx(1.0, abs=0.2) and plain.marginal.level > 3
    assert not honest.learned.probable
    # the evidence of a fit that did not converge does not rise when a law has errors of nearly zero
    unfinished = replace(plain, residual=plain.residual + 3 * plain.jacobian @ plain.std)
    almost = replace(unfinished, law=1e-9 * misses)
    assert almost.log_evidence == pytest.approx(unfinished.log_evidence, abs=1.0)
    assert unfinished.log_evidence < plain.log_evidence - 5


def test_evidence_of_one_more_unknown_is_reduced_by_its_prior(lab):
    """Under a normal prior a further unknown changes log evidence by ½ Δχ² − log(prior deviation/posterior
    deviation).

    A leak that is in the data gains more than 10, one that is not gains less.
    """
    leak = lab.library["leakage"]
    truth = lab.truth(3)
    bare = lab.evaluation.impedance(lab.unknowns, truth)
    size = 80e-9
    for impedance, there in ((bare, False), (1 / (1 / bare + size), True)):
        data = lab.measured(impedance, 3)
        base = fit(lab.evaluation, data, lab.unknowns, [lab.unknowns.prior_mean])
        with_leak = lab.unknowns.with_candidate(leak)
        with_leak_fitted = fit(lab.evaluation, data, with_leak, [with_leak.carried(lab.unknowns, base.x)])
        price = np.log(with_leak.prior_std[-1] / with_leak_fitted.std[-1])
        assert price > 2
        gain = with_leak_fitted.log_evidence - with_leak_fitted.log_prior_gain - base.log_evidence
        assert gain == pytest.approx(0.5 * (base.chi_square - with_leak_fitted.chi_square) - price, abs=0.1)
        assert (gain > 10) == there


def test_chi_square_counts_what_the_data_determine(lab):
    """χ² of the data is their number less the number of unknowns that the data determine, here between 6 and 20.

    The mean over 12 draws lies within 3.3 of its standard deviations.
    """
    squares, freedom = [], []
    for seed in range(12):
        data = lab.measured(lab.evaluation.impedance(lab.unknowns, lab.truth(seed)), seed)
        found = fit(lab.evaluation, data, lab.unknowns, [lab.unknowns.prior_mean])
        squares.append(found.residual @ found.residual)
        freedom.append(found.freedom)
        assert 6 < found.determined < 20
    assert np.mean(squares) == pytest.approx(np.mean(freedom), abs=3.3 * np.sqrt(2 * np.mean(freedom) / 12))


def test_a_linear_step_is_the_step_of_the_linearised_model(lab):
    """Against normal equations with priors; a step of some unknowns leaves the others where they are."""
    data = lab.measured(lab.evaluation.impedance(lab.unknowns, lab.truth(8)), 8)
    x = lab.unknowns.prior_mean
    before = fit(lab.evaluation, data, lab.unknowns, [x], gain=COARSE)
    promised, _ = linear_fit(lab.evaluation, before, lab.unknowns, x)
    residual, jacobian = data.whitened(*lab.evaluation.with_jacobian(lab.unknowns, x))
    level = promised.level
    precision = jacobian.T @ jacobian / level**2 + np.diag(1 / lab.unknowns.prior_std**2)
    step = np.linalg.solve(precision, -jacobian.T @ residual / level**2)
    assert level == pytest.approx(promised.noise_scale, rel=0.03)
    assert np.max(np.abs(promised.x - x - step) / lab.unknowns.prior_std) < 1e-6
    some = np.arange(3)
    further, slopes = further_rows(lab.unknowns, x)
    at_x = replace(
        before, x=x, residual=residual, jacobian=jacobian, further_residual=further, further_jacobian=slopes, level=1.0
    )
    held = stepped(at_x, some)
    assert np.array_equal(held.x[3:], x[3:]) and np.all(held.x[:3] != x[:3])


def test_a_robust_loss_sets_bad_readings_aside(lab):
    """Six of 60 readings are 5 to 30 % off.

    The linear fit is off by more than 30 deviations, that with a Cauchy loss by less than 4, that with a soft L1 loss
    by less than a tenth of the first.
    """
    truth = lab.truth(9)
    truth[6:] = 0
    z = lab.evaluation.impedance(lab.unknowns, truth)
    rng = np.random.default_rng(2)
    bad = rng.choice(FREQUENCY.size, 6, replace=False)
    z[bad] *= np.exp(rng.uniform(0.05, 0.3, 6))
    data = lab.measured(z, 9)
    start = lab.ideal.prior_mean.copy()
    start[:] = truth[:6]
    away = {
        loss: np.abs(fit(lab.evaluation, data, lab.ideal, [start], loss=loss).x - truth[:6])
        for loss in ("linear", "soft_l1", "cauchy")
    }
    clean = fit(lab.evaluation, lab.measured(lab.evaluation.impedance(lab.unknowns, truth), 9), lab.ideal, [start])
    assert np.max(away["linear"] / clean.std) > 30
    assert np.max(away["soft_l1"] / clean.std) < 0.1 * np.max(away["linear"] / clean.std)
    assert np.max(away["cauchy"] / clean.std) < 4


def deviations(lab, clean, truth) -> np.ndarray:
    """Standard deviations of a linear fit of data without bad readings that starts at the truth."""
    return fit(lab.evaluation, clean, lab.unknowns, [lab.near(truth)]).std


def away(lab, data, std, truth, loss="linear") -> float:
    """Largest error of constants and tangents in a fit from the constants of the file, in the deviations `std`."""
    found = fit(lab.evaluation, data, lab.unknowns, [lab.unknowns.prior_mean], loss=loss)
    return float(np.max((np.abs(found.x - truth) / std)[:6]))


@pytest.mark.parametrize(
    "seeds", [range(25), pytest.param(range(25, 100), marks=pytest.mark.slow)], ids=["few", "many"]
)
@pytest.mark.parametrize("noise", [1e-3, 1e-4])
def test_no_fit_ends_in_a_wrong_minimum(lab, noise, seeds):
    """Fits of 100 specimens, whose constants scatter by 3 % about the file's, from the constants of the file.

    The largest of their 600 errors is one of the noise.
    """
    found = []
    for seed in seeds:
        truth = lab.truth(seed)
        data = lab.measured(lab.evaluation.impedance(lab.unknowns, truth), seed, noise)
        found.append(away(lab, data, deviations(lab, data, truth), truth))
    assert max(found) < 4  # the largest of 600 normal numbers exceeds 4 in one of 25 cases


@pytest.mark.parametrize("seeds", [range(4), pytest.param(range(4, 15), marks=pytest.mark.slow)], ids=["few", "many"])
@pytest.mark.parametrize("known", [True, False])
def test_a_robust_loss_finds_the_solution_from_afar(lab, known, seeds):
    """Noise of 1e-5, no reading or three of 60 off by 5 to 30 %, started from the constants of the file."""
    for seed in seeds:
        truth = lab.truth(seed)
        clean = lab.measured(lab.evaluation.impedance(lab.unknowns, truth), seed, 1e-5, known)
        std = deviations(lab, clean, truth)
        for bad in (0, 3):
            rng = np.random.default_rng([5, seed])
            spoiled = clean.impedance.copy()
            spoiled[rng.choice(FREQUENCY.size, bad, replace=False)] *= np.exp(rng.uniform(0.05, 0.3, bad))
            data = replace(clean, impedance=spoiled)
            for loss in ("soft_l1", "huber", "cauchy"):
                assert away(lab, data, std, truth, loss) < 3, (seed, bad, loss)


@pytest.mark.parametrize("loss", variants(["linear", "soft_l1", "huber", "cauchy"], slow=["soft_l1", "huber"]))
def test_every_loss_finds_the_noise_and_states_right_intervals(lab, loss):
    """Sweeps twice as noisy as stated: the median level is 2 within 8 %, and the rms of errors over deviations is 1
    within 0.2.
    """
    truth = lab.truth(0)[:6]
    z, levels, pulls = lab.evaluation.impedance(lab.ideal, truth), [], []
    for seed in range(60):
        data = lab.measured(z, seed, known=False)
        data = replace(data, relative_noise=data.relative_noise / 2)
        found = fit(lab.evaluation, data, lab.ideal, [truth], loss=loss)
        assert found.noise_scale == pytest.approx(found.level, rel=0.03)
        levels.append(found.noise_scale)
        pulls.append((found.x - truth) / found.std)
    assert np.median(levels) == pytest.approx(2.0, rel=0.08)
    assert np.sqrt(np.mean(np.square(pulls))) == pytest.approx(1.0, abs=0.2)


def test_a_robust_loss_leaves_the_priors_as_they_are(lab):
    """The robust loss acts on readings only: a prior that contradicts the data by 40 deviations keeps its weight."""
    truth = lab.truth(10)
    truth[6:] = 0
    data = lab.measured(lab.evaluation.impedance(lab.unknowns, truth), 10)
    plain = fit(lab.evaluation, data, lab.ideal, [truth[:6]])
    mean, std = (plain.x[0] + 40 * plain.std[0]) * lab.material.scale[0], 0.5 * plain.std[0] * lab.material.scale[0]
    known = replace(lab.ideal, prior={**lab.ideal.prior, "s11": (mean, std)})
    for loss in ("soft_l1", "cauchy"):
        found = fit(lab.evaluation, data, known, [plain.x], loss=loss)
        assert found.x[0] - plain.x[0] > 25 * plain.std[0], loss


def test_noise_of_the_tests_is_what_it_is_called(lab):
    """The rms of |δZ/Z| in the drawn sweeps is the constant NOISE."""
    z = lab.evaluation.impedance(lab.unknowns, lab.unknowns.prior_mean)
    drawn = [np.mean(np.abs(lab.measured(z, seed).impedance / z - 1) ** 2) for seed in range(50)]
    assert np.sqrt(np.mean(drawn)) == pytest.approx(NOISE, rel=0.05)


def test_closest_ends_where_the_fit_does(lab):
    """`closest` returns the unknowns and the misfit of the fit, without its uncertainties."""
    x = lab.truth(3)
    data = lab.measured(lab.evaluation.impedance(lab.unknowns, x), 3)
    whole = fit(lab.evaluation, data, lab.unknowns, [lab.near(x)])
    x_closest, error = closest(lab.evaluation, data, lab.unknowns, [lab.near(x)])
    np.testing.assert_array_equal(x_closest, whole.x)
    np.testing.assert_allclose(error, whole.log_error, rtol=1e-12)


def test_impedance_alone_equals_that_with_its_jacobian(lab):
    """To the last bit, also where all dimensions are those of the file."""
    for x in (lab.truth(5), lab.unknowns.prior_mean):
        np.testing.assert_array_equal(
            lab.evaluation.impedance(lab.unknowns, x), lab.evaluation.with_jacobian(lab.unknowns, x)[0]
        )
