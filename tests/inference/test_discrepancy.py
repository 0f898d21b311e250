"""The discrepancy (the misfit that no unknown describes): its evidence, its effect on intervals, and that a right
model has none.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from laboratory import FREQUENCY
from scipy.special import logsumexp

from femu_piezo.inference.fit import Fit, fit, with_discrepancy
from femu_piezo.measurement import discrepancy
from femu_piezo.measurement.autoregression import autoregression
from femu_piezo.measurement.discrepancy import (
    PRIOR,
    Discrepancy,
    interpolated,
    learn_discrepancy,
    log_level_prior,
    noise_level,
    profiled,
)
from femu_piezo.measurement.discrepancy_forms import components, of_one_resonance, smooth
from femu_piezo.measurement.sweeps import SweepData, stacked

LENGTHS, SHARES, SIZES = (1 / 4, 1 / 12, 1 / 40), (0.0, 0.5, 1.0), np.geomspace(1e-6, 3.0, 27)
#: Ratio of neighbouring sizes on the grid of sizes that the discrepancy may have.
STEP = SIZES[1] / SIZES[0]


def kernel(length: float) -> np.ndarray:
    """(k, k) covariance of a Gaussian process over log f: squared exponential, length as a share of the sweep."""
    log = np.log(FREQUENCY)
    return np.exp(-0.5 * ((log[:, None] - log) / (length * np.ptp(log))) ** 2)


@pytest.mark.parametrize("length", LENGTHS)
def test_components_are_those_of_the_process(length):
    """The columns Φ of a length give Φ Φᵗ equal to the covariance of the process, within the share that left-out
    components have.
    """
    columns = components(np.log(FREQUENCY), length)
    assert np.max(np.abs(columns @ columns.T - kernel(length))) < 2e-3


@pytest.mark.parametrize(
    ("chi_square", "freedom"),
    [(99.0, 99), (130.0, 100), (3000.0, 100), (20.0, 100), (1.0, 100), (12.0, 10), (60.0, 10), (45.0, 30)],
)
@pytest.mark.parametrize("std", [0.02, 0.15])
def test_noise_level_is_the_most_probable_one(chi_square, freedom, std):
    """Against the maximum of the density on a fine grid above the floor.

    A misfit far above the stated noise decides the level by itself, √(χ²/freedom); a misfit far below it leaves the
    level at the floor, three standard deviations of its prior below the stated noise.
    """
    grid = np.linspace(-3 * std, 5.0, 200_001)
    density = -freedom * grid - 0.5 * chi_square * np.exp(-2 * grid)
    density += [log_level_prior(level, std) for level in grid]
    found = np.log(noise_level(chi_square, freedom, std))
    assert found == pytest.approx(grid[np.argmax(density)], abs=1e-4)
    if chi_square == 3000:
        assert found == pytest.approx(0.5 * np.log(30), rel=0.02)
    if chi_square <= freedom / 5:
        assert found == pytest.approx(-3 * std)


@pytest.mark.parametrize("std", [0.02, 0.15, 5.0])
@pytest.mark.parametrize("chi_square", [600.0, 1e6])
def test_interpolated_likelihoods_are_those_of_the_profiled_noise_level(chi_square, std):
    """Likelihoods interpolated over χ² against those computed at each χ², at the most probable noise level.

    Also where that level jumps from the maximum of its prior to that of the misfit. Single values agree to 1e-4, the
    largest of them to 1e-6 and their mean to 1e-9.
    """
    rng = np.random.default_rng(1)
    squares, volume = chi_square * (1 - rng.uniform(0, 0.9, 4000) ** 4), rng.exponential(20, 4000)
    found, exact = interpolated(squares, 600, std), profiled(squares, 600, std)
    assert found == pytest.approx(exact, abs=1e-4)
    best = np.argmax(exact - volume)
    assert np.argmax(found - volume) == best and found[best] == pytest.approx(exact[best], abs=1e-6)
    evidence, expected = (logsumexp(values - volume) for values in (found, exact))
    assert evidence == pytest.approx(expected, abs=1e-9)


def linear(seed: int, wave: float) -> tuple[SweepData, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A linear problem with k points: data, ∂log Z/∂log f, target (2k,), Jacobian (2k, 4) and prior deviations (4,).

    wave : amplitude of a smooth relative error in the target
    """
    rng = np.random.default_rng(seed)
    k = FREQUENCY.size
    data = SweepData(FREQUENCY, np.ones(k, complex), np.full(k, 2e-3), True)
    log_slope = -1 + 3 * rng.standard_normal(k) + 1j * rng.standard_normal(k)
    jacobian = 30 * rng.standard_normal((2 * k, 4))
    std = np.array([1.0, 0.05, 0.02, 1e-3])
    smooth = wave * np.exp(1j * np.log(FREQUENCY)) * data.weight
    target = jacobian @ (std * rng.standard_normal(4)) + rng.standard_normal(2 * k)
    return data, log_slope, target + np.concatenate([smooth.real, smooth.imag]), jacobian, std


def columns_of(data: SweepData, log_slope: np.ndarray, length: float, share: float) -> np.ndarray:
    """(2k, m) whitened columns of a smooth discrepancy whose change of log Z has rms 1.

    share : part of its variance that acts along frequency, by `log_slope`, instead of directly on log Z
    """
    direct = components(np.log(FREQUENCY), length)
    moved = direct * log_slope[:, None] / np.sqrt(np.mean(np.abs(log_slope) ** 2))
    parts = [np.sqrt(1 - share) * direct, np.sqrt(share) * moved]
    whole = np.hstack([turn * part for part in parts for turn in (1, 1j)]) * data.weight[:, None]
    return np.concatenate([whole.real, whole.imag])


@pytest.mark.parametrize("way", ["principal axes", "eigenvalues", "elimination"])
@pytest.mark.parametrize("count", [1, 2, 4])
def test_gain_and_volume_of_columns_against_dense_matrices(way, count):
    """bᵗ(1/τ + G)^-1 b and ½ log|1 + τ G| at every size τ = σ², for columns of very different strengths, some
    repeated.

    G is the Gram matrix of the columns after the unknowns are projected out: they remove one direction of the data
    wholly and another by 0.7² of its square.
    """
    rng = np.random.default_rng(count)
    columns = rng.standard_normal((30, count, 9)) * np.exp(rng.uniform(-5, 5, (30, count, 1)))
    columns[:5, -1] = columns[:5, 0]
    reached = np.linalg.qr(rng.standard_normal((9, 2)))[0] * [1.0, 0.7]
    kept = np.eye(9) - reached @ reached.T
    squares, right = columns @ kept @ columns.transpose(0, 2, 1), columns @ rng.standard_normal(9)
    if way == "elimination":
        gained, volume = discrepancy._by_elimination(squares, right)
    elif way == "eigenvalues":
        gained, volume = discrepancy._by_eigenvalues(squares, right)
    else:
        parts = []
        for block, vector in zip(columns, right, strict=True):
            values, axes = np.linalg.eigh(block @ block.T)
            parts.append(discrepancy._by_principal_axes(values, axes.T @ block @ reached, axes.T @ vector))
        gained, volume = (np.hstack(part) for part in zip(*parts, strict=True))
    for gain, half_log_determinant, sigma in zip(gained, volume, discrepancy._SIGMAS, strict=True):
        grown = np.eye(9) + sigma**2 * columns.transpose(0, 2, 1) @ columns @ kept
        exact = np.einsum("ni,nij,nj->n", right, np.linalg.inv(np.eye(count) / sigma**2 + squares), right)
        np.testing.assert_allclose(gain, exact, rtol=1e-5)
        np.testing.assert_allclose(half_log_determinant, 0.5 * np.linalg.slogdet(grown)[1], rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("noise", [1e-3, 1e-4, 1e-5, 1e-6])
@pytest.mark.parametrize("smoothed", [False, True])
def test_quiet_sweeps_lose_no_evidence_by_rounding(noise, smoothed, monkeypatch):
    """The evidence as computed against that with the columns always projected off the span of the unknowns (_ROUNDING
    = 0).

    Also where the whitening of smoothed noise makes the largest variance of the columns 1e13 times the least that
    remains once the unknowns are projected out.
    """
    rng, frequency = np.random.default_rng(5), np.linspace(1e5, 3e5, 400)
    drawn = rng.standard_normal((2000, 2)) @ [1, 1j]
    memory = (autoregression(np.convolve(drawn, np.hanning(9)[1:-1], "same")),) if smoothed else ()
    data = SweepData(frequency, np.ones(400, complex), np.full(400, noise), False, noise_memory=memory)
    poles = np.array([1.3e5, 1.6e5, 2.1e5, 2.5e5]) * (1 + 5e-4j)
    parts = [1 / (pole**2 - frequency**2) for pole in poles]
    charge = 3 + 0.01 * sum(pole**2 * part for pole, part in zip(poles, parts, strict=True))
    slope = frequency * np.gradient(-np.log(frequency * charge), frequency)
    slopes = np.array([*parts, *(part**2 * frequency**2 for part in parts), np.ones(400), slope])
    slopes = slopes / np.linalg.norm(slopes, axis=1)[:, None]
    columns = stacked(data.over_noise(np.concatenate([slopes, 1j * slopes]).T))
    q = np.linalg.qr(np.concatenate([columns, np.eye(columns.shape[1])]))[0]
    misfit = stacked(data.over_noise(1e-3 * np.cos(20 * np.log(frequency)) + 0j)) + rng.standard_normal(800)
    residual = np.concatenate([misfit, np.zeros(columns.shape[1])])
    residual -= q @ (q.T @ residual)
    found = learn_discrepancy(data, residual, q[:800], [smooth(data, slope)])
    monkeypatch.setattr(discrepancy, "_ROUNDING", 0.0)
    exact = learn_discrepancy(data, residual, q[:800], [smooth(data, slope)])
    assert found.log_evidence == pytest.approx(exact.log_evidence, abs=0.05)
    assert found.sigma == pytest.approx(exact.sigma)


@pytest.mark.parametrize("wave", [0.0, 2e-3, 1e-2])
@pytest.mark.parametrize("known", [True, False])
def test_evidence_is_that_of_a_dense_gaussian(wave, known):
    """The mean over sizes, lengths and shares of p(target) with the covariance I + J Σ Jᵗ + σ² Φ Φᵗ, each at its most
    probable noise level.

    wave : amplitude of the smooth error; only one above zero makes the discrepancy probable
    """
    data, log_slope, target, jacobian, std = linear(4, wave)
    data = replace(data, noise_known=known)
    k, rows = data.impedance.size, np.concatenate([jacobian, np.diag(1 / std)])
    q = np.linalg.qr(rows * std)[0]
    whole = np.concatenate([target, np.zeros(4)])
    residual = whole - q @ (q.T @ whole)
    learned = learn_discrepancy(data, residual, q[: 2 * k], [smooth(data, log_slope)])

    def log_density(covariance: np.ndarray) -> tuple[float, float]:
        """Log density of the target at the most probable noise level, and that level."""
        factor = np.linalg.cholesky(covariance)
        white = np.linalg.solve(factor, target)
        chi_square = float(white @ white)
        level = np.log(noise_level(chi_square, 2 * k, data.level_std))
        density = -2 * k * level - 0.5 * chi_square * np.exp(-2 * level) + log_level_prior(level, data.level_std)
        return density - np.sum(np.log(np.diag(factor))), np.exp(level)

    base = np.eye(2 * k) + (jacobian * std**2) @ jacobian.T
    none, found, levels = log_density(base)[0], {}, {}
    for length, share in product(LENGTHS, SHARES):
        columns = columns_of(data, log_slope, length, share)
        for size in SIZES:
            place = (length, size, share)
            density, levels[place] = log_density(base + size**2 * columns @ columns.T)
            found[place] = density - none
    values = np.array(list(found.values()))
    expected = values.max() + np.log(np.mean(np.exp(values - values.max())))
    assert learned.log_evidence == pytest.approx(expected, abs=1e-5 * max(1.0, abs(expected)))
    best = max(found, key=found.get)
    assert (learned.place, learned.sigma / levels[best]) == pytest.approx(best[:2])
    own = columns_of(data, log_slope, best[0], best[2]) * best[1]
    np.testing.assert_allclose(learned.columns @ learned.columns.T, own @ own.T, rtol=1e-9, atol=1e-12)
    assert learned.probable == (expected > np.log(1 / PRIOR - 1)) == (wave > 0)
    change = np.sum(learned.columns**2, axis=1).reshape(2, -1).sum(axis=0) / data.weight**2
    assert np.sqrt(np.mean(change / 2)) * levels[best] == pytest.approx(learned.sigma, rel=2e-2)


@pytest.mark.parametrize("wave", [2e-3, 3e-2])
def test_evidence_where_the_discrepancy_lowers_the_noise_level(wave):
    """Priors of unknowns do not scale with the noise: p(target) with covariance s² (I + σ² Φ Φᵗ) + J Σ Jᵗ at the most
    probable s.

    A misfit of twenty times the noise raises s so far that the data weigh little against the priors. With the
    discrepancy s is small again, and the data weigh more.
    """
    data, log_slope, target, jacobian, std = linear(4, wave)
    k, gram = data.impedance.size, (jacobian * std**2) @ jacobian.T
    q, triangle = np.linalg.qr(np.concatenate([jacobian, np.diag(1 / std)]))
    best = np.linalg.solve(triangle, q.T @ np.concatenate([target, np.zeros(4)]))
    parameters = SimpleNamespace(prior_std=std, readings=(), names=tuple("abcd"), on_bound=lambda x: x == np.inf)
    found = Fit(parameters, best, data, target - jacobian @ best, -jacobian, best / std, np.diag(1 / std), log_slope)

    def log_density(columns: np.ndarray) -> float:
        """Log density of the target at the most probable noise level of a fine grid."""
        densities = []
        for level in np.geomspace(0.7, 60, 300):
            factor = np.linalg.cholesky(level**2 * (np.eye(2 * k) + columns @ columns.T) + gram)
            white = np.linalg.solve(factor, target)
            density = -0.5 * white @ white - np.sum(np.log(np.diag(factor)))
            densities.append(density + log_level_prior(np.log(level), data.level_std))
        return max(densities)

    none = log_density(np.zeros((2 * k, 1)))
    learned = found.learned
    gain = log_density(learned.columns) - none
    # the evidence learned is a mean over 27 sizes, 3 lengths and 3 shares, so the best of these counts at least 1/243
    assert gain - np.log(243) - 0.1 < learned.log_evidence < gain + 0.5


def test_an_unknown_on_its_bound_stays_there_when_a_discrepancy_is_learned():
    """The evidence of the discrepancy is that of a fit without the unknown, not that of a fit in which it is free."""
    data, log_slope, target, jacobian, std = linear(4, 3e-2)

    def fitted(which: np.ndarray, held: np.ndarray) -> Fit:
        free, deviations = ~held, std[which]
        rows = np.concatenate([jacobian[:, which], np.diag(1 / deviations)])
        values, x = np.append(target, np.zeros(which.size)), np.zeros(which.size)
        x[free] = np.linalg.lstsq(rows[:, free], values, rcond=None)[0]
        parameters = SimpleNamespace(
            prior_std=deviations, readings=(), names=tuple("abcd"[: which.size]), on_bound=lambda x: held
        )
        residual, jacobian_of_these = target - jacobian[:, which] @ x, jacobian[:, which]
        return Fit(
            parameters, x, data, residual, -jacobian_of_these, x / deviations, np.diag(1 / deviations), log_slope
        )

    every = np.arange(4)
    bound, without = fitted(every, every == 0), fitted(every[1:], every[1:] == 0)
    free = fitted(every, every > 3)
    level = bound.marginal.level
    assert bound.learned_of(bound.forms, level).log_evidence == pytest.approx(
        without.learned_of(without.forms, level).log_evidence, abs=0.05
    )
    assert abs(free.learned.log_evidence - bound.learned.log_evidence) > 0.5


def test_forms_compete_with_equal_weight():
    """The evidence of two forms is the mean of both. That of a resonance is the mean over all its places, qualities
    and sizes, here against dense covariances.
    """
    data, log_slope, target, _, _ = linear(6, 2e-3)
    impedance = np.exp(-1j * np.pi / 2 + 0.1j * np.log(FREQUENCY)) * 1e3
    k, span = data.impedance.size, np.zeros((target.size, 1))

    def forms(*which: int):
        makers = (lambda: smooth(data, log_slope), lambda: of_one_resonance(data, impedance, log_slope, (10.0,)))
        return [makers[number]() for number in which]

    one, other = (learn_discrepancy(data, target, span, forms(number)).log_evidence for number in (0, 1))
    whole = learn_discrepancy(data, target, span, forms(0, 1)).log_evidence
    assert whole == pytest.approx(np.log((np.exp(one) + np.exp(other)) / 2), abs=1e-9)

    def log_density(chi_square: float, log_volume: float) -> float:
        level = np.log(noise_level(chi_square, 2 * k, data.level_std))
        own = -2 * k * level - 0.5 * chi_square * np.exp(-2 * level) + log_level_prior(level, data.level_std)
        return own - log_volume

    none, found = log_density(float(target @ target), 0.0), []
    for alternatives in of_one_resonance(data, impedance, log_slope, (10.0,)):
        own = []
        for place in range(alternatives.places.size):
            both = alternatives.columns[:, place]
            columns = stacked(data.weight[:, None] * np.hstack([both, 1j * both]))
            for size in SIZES:
                factor = np.linalg.cholesky(np.eye(2 * k) + size**2 * columns @ columns.T)
                white = np.linalg.solve(factor, target)
                own.append(log_density(float(white @ white), float(np.sum(np.log(np.diag(factor))))) - none)
        found.append(np.mean(np.exp(own)))
    assert other == pytest.approx(np.log(np.mean(found)), abs=1e-6)


def smooth_error(seed: int, sigma: float, length: float = 1 / 6) -> np.ndarray:
    """(k,) a complex error of log Z with standard deviation `sigma`, smooth over `length` of the sweep."""
    root = np.linalg.cholesky(kernel(length) + 1e-9 * np.eye(FREQUENCY.size))
    return sigma * root @ (np.random.default_rng([77, seed]).standard_normal((FREQUENCY.size, 2)) @ [1, 1j])


@pytest.fixture(scope="module")
def truth(lab):
    """The unknowns of the ideal laboratory that the file states."""
    return lab.material.x_of(lab.free.start)


@pytest.mark.parametrize(
    ("sigma", "length", "stated"),
    [
        (3e-3, 1 / 6, 1.0),
        pytest.param(1e-2, 1 / 12, 1.0, marks=pytest.mark.slow),
        pytest.param(3e-3, 1 / 6, 0.2, marks=pytest.mark.slow),
    ],
)
def test_intervals_stay_honest_where_something_smooth_is_added(lab, sigma, length, stated):
    """40 draws of a laboratory with a smooth error of Z, 0.3 or 1 %, that no unknown describes.

    Noise and tolerances alone state deviations of the tangents of d31 and ε33T that are several times too small. With
    the discrepancy, constants and tangents lie in their intervals as often as stated, and each of the six has an
    interval of about the right size, also where the noise is five times the stated one. The length and size of the
    error are not on the grids of the discrepancy.
    """
    pulls, plain_pulls = [], []
    for seed in range(40):
        x = lab.truth(seed)
        z = lab.evaluation.impedance(lab.unknowns, x) * np.exp(smooth_error(seed, sigma, length))
        data = lab.measured(z, seed)
        data = replace(data, relative_noise=data.relative_noise * stated)
        plain = fit(lab.evaluation, data, lab.unknowns, [lab.near(x)])
        assert plain.learned.probable
        honest = with_discrepancy(plain, plain.learned)
        pulls.append((honest.x - x)[:6] / honest.std[:6])
        plain_pulls.append((plain.x - x)[:6] / plain.std[:6])
    pulls, plain_pulls = np.array(pulls), np.array(plain_pulls)
    assert np.sqrt(np.mean(plain_pulls[:, [3, 5]] ** 2)) > 2.5
    # the six pulls of a draw are correlated, so their mean over 40 draws scatters by about 0.04
    assert 0.60 < np.mean(np.abs(pulls) < 1) < 0.85
    assert np.mean(np.abs(pulls) < 2) > 0.91
    assert np.all(np.abs(np.log(np.sqrt(np.mean(pulls**2, axis=0)))) < np.log(2))


@pytest.mark.parametrize("known", [True, False])
def test_nulls_have_no_discrepancy(lab, truth, known):
    """A right model: 25 sweeps with all but the noise exactly known and 25 of a laboratory raise one false alarm at
    most.
    """
    alarms, z = 0, lab.evaluation.impedance(lab.ideal, truth)
    for seed in range(25):
        ideal = fit(lab.evaluation, lab.measured(z, seed, known=known), lab.ideal, [truth])
        x = lab.truth(seed)
        data = lab.measured(lab.evaluation.impedance(lab.unknowns, x), seed, known=known)
        whole = fit(lab.evaluation, data, lab.unknowns, [lab.near(x)])
        alarms += ideal.learned.probable + whole.learned.probable
    assert alarms <= 1


def test_a_tolerance_is_no_discrepancy(lab):
    """Eight sweeps of a laboratory: a fit that allows for noise alone finds a discrepancy in five of them at least, a
    fit with the tolerances in none.
    """
    found = []
    for seed in range(21, 29):
        x = lab.truth(seed)
        data = lab.measured(lab.evaluation.impedance(lab.unknowns, x), seed)
        found.append(fit(lab.evaluation, data, lab.ideal, [x[:6]]).learned.probable)
        assert not fit(lab.evaluation, data, lab.unknowns, [lab.near(x)]).learned.probable
    assert sum(found) >= 5


def test_white_misfit_is_noise(lab, truth):
    """Noise stated five times too small is no discrepancy: the deviations are those of the rightly stated noise within
    20 %.
    """
    z = lab.evaluation.impedance(lab.ideal, truth)
    for seed in range(5):
        data = lab.measured(z, seed)
        right = fit(lab.evaluation, data, lab.ideal, [truth])
        claimed = fit(lab.evaluation, replace(data, relative_noise=data.relative_noise / 5), lab.ideal, [truth])
        assert not claimed.learned.probable
        np.testing.assert_allclose(claimed.std, right.std, rtol=0.2)


def test_size_of_a_discrepancy_does_not_depend_on_the_stated_noise():
    """The same readings with their noise stated 1, 5 and 25 times smaller: size and unwhitened columns stay, within a
    step of the grid of sizes.
    """
    data, log_slope, target, _, _ = linear(5, 1e-2)
    size, spread = [], []
    for factor in (1.0, 5.0, 25.0):
        stated = replace(data, relative_noise=data.relative_noise / factor)
        learned = learn_discrepancy(stated, factor * target, np.zeros((target.size, 1)), [smooth(stated, log_slope)])
        size.append(learned.sigma)
        level = learned.sigma / np.sqrt(np.mean(np.sum(learned.columns**2, axis=1)) / stated.weight[0] ** 2)
        spread.append(level / factor)
    assert max(size) / min(size) < 1.01 * STEP
    assert np.ptp(np.log(spread)) < np.log(
        1.3
    )  # the noise level found, times the stated noise, is the noise of the readings


def test_each_of_several_sweeps_has_a_discrepancy_of_its_own():
    """The discrepancies of two sweeps are independent: no covariance between their points, though the misfit of the
    first alone makes it probable.
    """
    k = FREQUENCY.size
    data = SweepData(np.tile(FREQUENCY, 2), np.ones(2 * k, complex), np.full(2 * k, 1e-3), True, sizes=(k, k))
    rng = np.random.default_rng(3)
    wave = np.concatenate([1e-2 * np.sin(np.log(FREQUENCY)), np.zeros(k)]) * data.weight
    residual = np.concatenate([wave, np.zeros(2 * k)]) + rng.standard_normal(4 * k)
    forms = [smooth(data, np.zeros(2 * k, complex))]
    learned = learn_discrepancy(data, residual, np.zeros((4 * k, 1)), forms)
    assert learned.probable
    covariance = learned.columns @ learned.columns.T
    first = np.concatenate([np.arange(k), np.arange(2 * k, 3 * k)])
    second = np.setdiff1d(np.arange(4 * k), first)
    assert np.all(covariance[np.ix_(first, second)] == 0)
    assert np.all(np.diag(covariance)[second] > 0)


def test_inverse_root_of_the_covariance_of_noise_and_discrepancy():
    """`whitened` is S⁻¹, symmetric, of S Sᵗ = I + Φ Φᵗ, also for columns that are zero or repeated."""
    columns = np.random.default_rng(1).standard_normal((20, 5)) * [1.0, 1e4, 0.0, 1e-3, 1.0]
    columns[:, 4] = columns[:, 0]
    discrepancy = Discrepancy("smooth", 0.1, 1.0, 1.0, 0.0, columns)
    inverse = discrepancy.whitened(np.eye(20))
    np.testing.assert_allclose(inverse, inverse.T, atol=1e-9)
    np.testing.assert_allclose(inverse @ (np.eye(20) + columns @ columns.T) @ inverse, np.eye(20), atol=1e-6)


def test_covariance_is_the_scatter_of_the_estimate():
    """4000 draws of noise (twice the stated one), discrepancy and prior means in a linear problem: stated deviations
    within 5 % of the scatter.
    """
    data, _, _, jacobian, std = linear(9, 0.0)
    data, rng = replace(data, noise_known=False), np.random.default_rng(2)
    columns, level = 3 * rng.standard_normal((len(jacobian), 6)), 2.0
    hessian = jacobian.T @ jacobian / level**2 + np.diag(std**-2)
    noise = level * (rng.standard_normal((4000, 120)) + rng.standard_normal((4000, 6)) @ columns.T)
    means = std * rng.standard_normal((4000, 4))
    drawn = np.linalg.solve(hessian, jacobian.T @ noise.T / level**2 + means.T / std[:, None] ** 2)
    residual = noise[0] - jacobian @ drawn[:, 0]
    found = Fit(
        SimpleNamespace(prior_std=std, readings=()),
        np.zeros(4),
        data,
        residual,
        jacobian,
        np.zeros(4),
        np.diag(1 / std),
        np.zeros(FREQUENCY.size),
        level=level,
        discrepancy=Discrepancy("smooth", 0.1, 1.0, 1.0, 0.0, columns),
    )
    assert found.noise_scale == pytest.approx(level, rel=0.2)
    scale = found.noise_scale / level
    np.testing.assert_allclose(found.std, scale * drawn.std(axis=1), rtol=0.05)
