"""The rational model and its fit: derivatives, roots and deviations against independent arithmetic."""

from dataclasses import replace

import numpy as np
import pytest

from femu_piezo.extraction.covariance import Spread, errors_about, fisher_spread, systematic_error, systematic_spread
from femu_piezo.extraction.fit import Fit, NormalisedSweep, correlation, fit, solve_linear
from femu_piezo.extraction.model import FrequencyAxis, RationalModel
from femu_piezo.extraction.order import _least, _splits
from femu_piezo.extraction.vector_fitting import relocated_poles
from femu_piezo.measurement.sweeps import SweepData
from tests.noise import circular_noise

from .bar import Bar, sweep

OMEGA = 2 * np.pi * np.linspace(30e3, 45e3, 60)


def two_modes():
    """A rational model with two modes and a background of degree two."""
    return RationalModel(
        FrequencyAxis.of(OMEGA),
        1e-9,
        np.array([-0.3 + 0.04j, 0.5 + 0.02j]),
        np.array([0.2 + 0.01j, 0.05 - 0.002j]),
        np.array([0.7 - 0.01j, 0.1 + 0.02j, -0.03j]),
    )


def test_axis_maps_to_the_unit_interval_and_back():
    axis = FrequencyAxis.of(OMEGA)
    x = axis.x(OMEGA)
    assert x[0] == pytest.approx(-1) and x[-1] == pytest.approx(1)
    assert axis.eigenvalue(x) == pytest.approx(OMEGA**2)


def test_charge_is_the_pole_residue_sum():
    """Y/(jω) against the sum written out by hand."""
    model, x = two_modes(), np.linspace(-1, 1, 7)
    by_hand = 0.7 - 0.01j + (0.1 + 0.02j) * x - 0.03j * (2 * x**2 - 1)
    by_hand = by_hand + (0.2 + 0.01j) / (-0.3 + 0.04j - x) + (0.05 - 0.002j) / (0.5 + 0.02j - x)
    assert model.charge(x) == pytest.approx(by_hand, rel=1e-14, abs=0)
    assert model.admittance(OMEGA)[[0, -1]] == pytest.approx(
        1j * OMEGA[[0, -1]] * 1e-9 * by_hand[[0, -1]], rel=1e-9, abs=0
    )


def test_jacobian_and_slope_are_the_complex_derivatives():
    """In every parameter and in the frequency, against differences."""
    model, x, step = two_modes(), np.linspace(-1, 1, 9), 1e-6
    theta = model.parameters
    for k in range(theta.size):
        for direction in (1, 1j):  # the model is holomorphic: real and imaginary steps give the same derivative
            moved = [model.with_parameters(theta + sign * step * direction * np.eye(theta.size)[k]) for sign in (1, -1)]
            numeric = (moved[0].charge(x) - moved[1].charge(x)) / (2 * step * direction)
            assert model.jacobian(x)[:, k] == pytest.approx(numeric, rel=1e-6, abs=1e-7)
    numeric = (model.charge(x + step) - model.charge(x - step)) / (2 * step)
    assert model.charge_slope(x) == pytest.approx(numeric, rel=1e-6)


def test_zeros_are_every_root_and_move_as_their_derivative_says():
    model = two_modes()
    zeros = model.zeros()
    assert zeros.size == 4  # two modes and a background of degree two give four roots
    assert np.abs(model.charge(zeros)).max() < 1e-12
    change = 1e-7 * (np.arange(model.size) - 2.5j)
    moved = model.with_parameters(model.parameters + change).zeros()
    for zero in zeros:
        nearest = moved[np.argmin(np.abs(moved - zero))]
        assert nearest - zero == pytest.approx(model.zero_derivative(zero) @ change, rel=1e-4)


def test_fit_returns_the_model_that_made_the_data():
    truth = two_modes()
    data = NormalisedSweep.of(OMEGA, truth.admittance(OMEGA), np.full(OMEGA.size, 1e3))
    start = replace(truth, scale=data.scale, poles=truth.poles * (1 + 0.02j))
    found = fit(solve_linear(start, data).model, data, tolerance=1e-15)
    assert found.model.poles == pytest.approx(truth.poles, rel=1e-10)
    assert found.model.residues * data.scale == pytest.approx(truth.residues * truth.scale, rel=1e-9, abs=0)
    assert found.scale < 1e-8


def test_a_fit_is_abandoned_only_if_its_misfit_cannot_become_low_enough():
    """A model with one mode too few.

    With `least` just above its final misfit the fit runs to its end; with half of that it stops early.
    """
    truth = two_modes()
    data = NormalisedSweep.of(OMEGA, truth.admittance(OMEGA), np.full(OMEGA.size, 1e3))
    start = replace(truth, scale=data.scale, poles=truth.poles[:1] * (1 - 0.1j), residues=truth.residues[:1])
    start = solve_linear(start, data).model
    end = fit(start, data, tolerance=1e-12)
    useful, useless = (fit(start, data, tolerance=1e-12, least=share * end.misfit) for share in (1.001, 0.5))
    np.testing.assert_array_equal(useful.model.parameters, end.model.parameters)
    assert end.misfit < useless.misfit < 1.1 * end.misfit
    assert np.any(useless.model.parameters != end.model.parameters)
    hopeless = fit(start, data, least=-np.inf)  # no step is made where no misfit would do
    np.testing.assert_array_equal(hopeless.model.parameters, start.parameters)


def test_evidence_does_not_reward_misfits_below_rounding():
    """Of two fits below the rounding error the smaller model has more evidence, whatever the misfits; above it
    misfits count.
    """
    small = two_modes()
    data = NormalisedSweep.of(OMEGA, small.admittance(OMEGA), np.full(OMEGA.size, 1e3))
    large = replace(small, background=np.append(small.background, 0j))

    def with_misfit(model: RationalModel, share: float) -> Fit:
        """A fit whose misfit is `share` of the rounding error."""
        residual = np.full(len(data), np.sqrt(share * data.rounding / len(data)), dtype=complex)
        return Fit(model, data, residual, float(np.vdot(residual, residual).real))

    assert with_misfit(small, 0.9).evidence < with_misfit(large, 1e-3).evidence
    assert with_misfit(small, 9.0).evidence > with_misfit(large, 1e-3).evidence
    assert _least(large, with_misfit(small, 0.9)) == -np.inf
    assert with_misfit(small, 9.0).misfit > _least(large, with_misfit(small, 9.0)) > data.rounding


def test_evidence_is_the_information_criterion_of_the_relative_errors():
    """N ln(S/n) + k ln(N) N/(N − k − 1) − 2 Σ ln weight²: written out for 60 readings and 7 complex parameters."""
    model = two_modes()
    weight = np.linspace(500.0, 2000.0, OMEGA.size)
    data = NormalisedSweep.of(OMEGA, model.admittance(OMEGA), weight)
    errors = circular_noise(OMEGA.size, 1e-3, 8)
    found = Fit(model, data, weight * np.expm1(errors), 1.0)
    likelihood = 120 * np.log(np.sum(np.abs(weight * errors) ** 2) / 60) - 2 * np.sum(np.log(weight**2))
    assert found.evidence == pytest.approx(likelihood + 14 * np.log(120) * 120 / 105, rel=1e-12)


def test_vector_fitting_finds_all_poles_of_a_rational_function():
    """Y/(jω) of two poles and a background of degree two, from two poles spread over the sweep."""
    model = two_modes()
    data = NormalisedSweep.of(OMEGA, model.admittance(OMEGA), np.ones(OMEGA.size))
    found = relocated_poles(data, 2)
    assert sorted(found, key=np.real) == pytest.approx(sorted(model.poles, key=np.real), rel=1e-8)


def test_two_near_modes_are_one_with_a_term_of_third_power():
    """½r/(z + δ − x) + ½r/(z − δ − x) = r/(z − x) + r δ²/(z − x)³ + O(δ⁴): by it a mode is split at the right δ."""
    whole = two_modes()
    apart, z, r = 0.004 + 0.001j, whole.poles[0], whole.residues[0]
    halves = np.array([z + apart, z - apart, whole.poles[1]]), np.array([r / 2, r / 2, whole.residues[1]])
    split = replace(whole, poles=halves[0], residues=halves[1])
    data = NormalisedSweep.of(OMEGA, split.admittance(OMEGA), np.full(OMEGA.size, 1e4))
    one = fit(solve_linear(replace(whole, scale=data.scale), data).model, data, tolerance=1e-12)
    tried = []
    found = _splits(one, 5, tried)
    assert min(found, key=lambda f: f.misfit).misfit < 1e-12 * one.misfit
    near = min(found, key=lambda f: f.misfit).model.poles
    for pole in halves[0]:
        assert np.min(np.abs(near - pole)) < 1e-6


def test_residual_is_the_relative_error_of_the_impedance():
    truth = two_modes()
    data = NormalisedSweep.of(OMEGA, truth.admittance(OMEGA), np.full(OMEGA.size, 1e3))
    off = replace(truth, scale=data.scale, poles=truth.poles + 0.01)
    z_data, z_model = 1 / truth.admittance(OMEGA), 1 / off.admittance(OMEGA)
    assert fit(off, data, max_steps=0).residual == pytest.approx(1e3 * (z_data / z_model - 1), rel=1e-9)


def test_correlation_of_a_first_order_error():
    """A complex first-order autoregression, within four standard errors."""
    n, phi = 4000, 0.8 * np.exp(0.3j)
    white = circular_noise(n, 1.0, 1)
    error = np.zeros(n, complex)
    error[0] = white[0] / np.sqrt(1 - abs(phi) ** 2)
    for i in range(1, n):
        error[i] = phi * error[i - 1] + white[i]
    assert correlation(error) == pytest.approx(phi, abs=4 * np.sqrt((1 - abs(phi) ** 2) / n))


def test_fisher_spread_is_the_scatter_of_repeated_fits():
    """Covariance of a pole over 150 draws of noise."""
    bar, frequency, noise = Bar(), np.linspace(28e3, 48e3, 101), 1e-3
    poles = []
    for seed in range(150):
        data = sweep(bar, frequency, relative=noise, seed=seed)
        rows = NormalisedSweep.of(data.omega, data.admittance, np.full(101, 1 / noise))
        at = (bar.pole(1) - rows.axis.center) / rows.axis.half_width
        start = RationalModel(rows.axis, rows.scale, np.array([at]), np.zeros(1, complex), np.zeros(3, complex))
        found = fit(solve_linear(start, rows).model, rows, tolerance=1e-12)
        poles.append(found.model.poles[0])
    spread = fisher_spread(found.model, rows)
    stated = spread.covariance(np.eye(found.model.size)[:1])
    sample = np.cov(np.real(poles), np.imag(poles))
    # the relative variance of a sample variance of 150 draws is 2/149; four standard deviations are allowed
    assert np.diag(sample) == pytest.approx(np.diag(stated), rel=4 * np.sqrt(2 / 149))
    assert abs(sample[0, 1]) < 4 * stated[0, 0] / np.sqrt(149) + abs(stated[0, 1])


def test_a_pole_without_a_residue_is_unknown_and_leaves_the_others_known():
    """No point depends on such a pole: its deviation is beyond all numbers that matter, those of the others finite."""
    bar, frequency = Bar(), np.linspace(28e3, 48e3, 101)
    data = sweep(bar, frequency, relative=1e-3, seed=1)
    rows = NormalisedSweep.of(data.omega, data.admittance, np.full(101, 1e3))
    at = (bar.pole(1) - rows.axis.center) / rows.axis.half_width
    start = RationalModel(rows.axis, rows.scale, np.array([at]), np.zeros(1, complex), np.zeros(3, complex))
    one = solve_linear(start, rows).model
    two = RationalModel(
        one.axis, one.scale, np.append(one.poles, 0.3 + 0.01j), np.append(one.residues, 0), one.background
    )
    alone, beside = (np.linalg.norm(fisher_spread(model, rows).factor, axis=1) for model in (one, two))
    assert np.all(np.isfinite(beside)) and beside[1] > 1e90
    assert np.delete(beside, [1, 3]) == pytest.approx(alone, rel=0.2)


def test_circular_spread_is_that_of_a_circular_sample():
    """δθ = F w, w circular: Re and Im of w have ½ each, so that F/√2 and jF/√2 are a sample; all cross terms."""
    rng = np.random.default_rng(3)
    factor = rng.normal(size=(4, 4)) + 1j * rng.normal(size=(4, 4))
    gradients = rng.normal(size=(3, 4)) + 1j * rng.normal(size=(3, 4))
    sample = Spread(np.hstack([factor, 1j * factor]) / np.sqrt(2), circular=False)
    found = Spread(factor, circular=True)
    np.testing.assert_allclose(found.covariance(gradients), sample.covariance(gradients), rtol=1e-12, atol=1e-12)
    sizes = [found.size(one) ** 2 for one in gradients]
    assert sizes == pytest.approx(np.diag(found.covariance(gradients)).reshape(3, 2).sum(axis=1))


def test_sample_spread_is_a_plain_covariance():
    """Columns that are samples: covariance of Re and Im of linear functions of them."""
    rng = np.random.default_rng(2)
    columns = rng.normal(size=(3, 8)) + 1j * rng.normal(size=(3, 8))
    gradient = np.array([[1.0, 0.5j, -2.0], [0.0, 1.0, 1j]])
    moved = gradient @ columns
    parts = np.array([moved[0].real, moved[0].imag, moved[1].real, moved[1].imag])
    assert Spread(columns, circular=False).covariance(gradient) == pytest.approx(parts @ parts.T)


@pytest.mark.parametrize("length", [1 / 12, 1 / 40])
def test_stated_deviations_count_a_smooth_error(length):
    """Poles of a bar under a smooth error of 0.1 % of log Z, fits started at the truth: an rms of errors over
    deviations of about 1.

    Part of the error looks like the pole or the background and is not in the residual, from which its size and length
    are learned. Deviations may therefore be too large but must not be too small.
    """
    bar, frequency, noise, draws = Bar(), np.linspace(28e3, 48e3, 301), 1e-5, 10
    share = np.linspace(0, 1, frequency.size)
    root = np.linalg.cholesky(np.exp(-0.5 * ((share[:, None] - share) / length) ** 2) + 1e-9 * np.eye(share.size))
    pulls = []
    for seed in range(draws):
        smooth = root @ circular_noise(share.size, 1e-3, [5, seed])
        measured = sweep(bar, frequency, relative=noise, seed=seed)
        z = measured.impedance * np.exp(smooth)
        rows = NormalisedSweep.of(measured.omega, 1 / z, np.ones(frequency.size))
        at = (bar.pole(1) - rows.axis.center) / rows.axis.half_width
        start = RationalModel(rows.axis, rows.scale, np.array([at]), np.zeros(1, complex), np.zeros(6, complex))
        found = fit(solve_linear(start, rows).model, rows, tolerance=1e-10)
        points = SweepData(frequency, z, np.full(frequency.size, noise), noise_known=True)
        error, _ = systematic_error(found.model, rows, points, errors_about(found.model, rows, points))
        spread = systematic_spread(found.model, rows, points, error)
        pulls.append(abs(found.model.poles[0] - at) / spread.size(np.eye(found.model.size)[0]))
    # |δλ| over its deviation: the mean of 20 squared Gaussian errors is at most 1 + 3 √(2/20)
    assert 0.1 < np.sqrt(np.mean(np.square(pulls))) < np.sqrt(1 + 3 * np.sqrt(2 / (2 * draws)))


def test_a_mode_that_a_smooth_error_explains_as_well_has_the_worse_evidence():
    """One true mode and ripples of 0.5 %: a second mode follows one ripple, a smooth error follows them all.

    A model without the true mode has less evidence as well.
    """
    bar, frequency = Bar(), np.linspace(28e3, 48e3, 301)
    share = np.linspace(0, 1, frequency.size)
    measured = sweep(bar, frequency, relative=1e-5)
    z = measured.impedance * np.exp(5e-3 * np.sin(2 * np.pi * 12 * share) * (1 + 1j))
    rows = NormalisedSweep.of(measured.omega, 1 / z, np.ones(frequency.size))
    points = SweepData(frequency, z, np.full(frequency.size, 1e-5), noise_known=True)
    at = (bar.pole(1) - rows.axis.center) / rows.axis.half_width
    # models with the true mode, with one more, and with none
    models = []
    for poles in ([at], [at, 0.62 + 0.05j], []):
        nothing = np.zeros(len(poles), complex)
        start = RationalModel(rows.axis, rows.scale, np.array(poles, complex), nothing, np.zeros(6, complex))
        linear = solve_linear(start, rows)
        models.append(fit(linear.model, rows).model if poles else linear.model)
    errors = errors_about(models[0], rows, points)
    true_mode, extra_mode, no_mode = (systematic_error(model, rows, points, errors)[1] for model in models)
    assert true_mode < extra_mode
    assert true_mode < no_mode


def test_modes_are_the_same_on_another_axis_and_scale():
    model, omega = two_modes(), 2 * np.pi * np.linspace(33e3, 41e3, 7)
    moved = model.normalised(FrequencyAxis.of(omega), -3e-9)
    assert moved.axis.eigenvalue(moved.poles) == pytest.approx(model.axis.eigenvalue(model.poles), rel=1e-12)
    bare = [replace(one, background=np.zeros(1, complex)) for one in (model, moved)]
    assert bare[1].admittance(omega) == pytest.approx(bare[0].admittance(omega), rel=1e-12, abs=0)


def test_all_zeros_of_many_poles_are_found():
    """24 broad poles that crowd at one end, a resonance and ten degrees of background: all 35 zeros, each once."""
    rng = np.random.default_rng(4)
    broad = -1 + np.geomspace(1e-3, 0.8, 24) * (1 + 0.7j)
    poles = np.append(broad, 0.2 + 0.004j)
    residues = np.append(np.geomspace(1e-3, 0.8, 24) * 0.02 * np.exp(0.3j * rng.standard_normal(24)), 0.003)
    background = 1.0 / (1 + np.arange(11.0)) ** 4 * np.exp(0.1j * rng.standard_normal(11))
    model = RationalModel(FrequencyAxis(2e11, 1e11), 1e-9, poles, residues, background)
    zeros = model.zeros()
    assert zeros.size == 35
    apart = np.abs(zeros[:, None] - zeros) + np.eye(35)
    assert np.min(apart) > 1e-6
    assert np.max(np.abs(model.charge(zeros) / model.charge_slope(zeros)) / (1e-3 + np.abs(zeros + 1))) < 1e-9


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_zeros_of_every_degree_of_background(degree):
    """As many as poles and degrees together, each a root; without poles those of the background alone."""
    background = np.array([0.7 - 0.01j, 0.1 + 0.02j, -0.03j, 0.02])[: degree + 1]
    whole = replace(two_modes(), background=background)
    bare = replace(whole, poles=np.zeros(0, complex), residues=np.zeros(0, complex))
    for model, count in ((whole, 2 + degree), (bare, degree)):
        zeros = model.zeros()
        assert zeros.size == count and np.all(np.abs(model.charge(zeros)) < 1e-12)
        assert count < 2 or np.min(np.abs(zeros[:, None] - zeros) + np.eye(count)) > 1e-3


def test_zeros_of_terms_that_cancel():
    """Two near poles and a background of degree 12, all of 1e7, as fits of distorted sweeps have: all 14 zeros."""
    degrees = np.arange(13)
    background = 2e7 * np.exp(-1.4 * degrees) * np.exp(2j * degrees)
    residues = 7e7 * np.array([1, -1.001 + 0.002j])
    model = replace(two_modes(), poles=np.array([0.1 + 0.03j, 0.14 + 0.06j]), residues=residues, background=background)
    zeros = model.zeros()
    assert zeros.size == 14 and np.min(np.abs(zeros[:, None] - zeros) + np.eye(14)) > 1e-3
    assert np.max(np.abs(model.charge(zeros) / model.charge_slope(zeros))) < 1e-7
