"""Pole-zero iteration, curve fit and identifiability, on data computed by exact formulas."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from laboratory import FUNDAMENTAL

from femu_piezo.effects.extended_model import extend_model
from femu_piezo.errors import ConvergenceError, InputError
from femu_piezo.forward.fundamental import full_source, reduced_source
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.shapes import Plate
from femu_piezo.inference.fit import Fit, fit
from femu_piezo.inference.free_constants import FreeConstants
from femu_piezo.inference.identifiability import identifiability
from femu_piezo.inference.matching import match
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.starts.many_modes import ManyModes
from femu_piezo.inference.starts.pole_zero import update_pair
from femu_piezo.inference.starts.thin_body import k31_bar_admittance
from femu_piezo.inference.terminal_roots import root_slopes, terminal_roots
from femu_piezo.inference.unknowns import MaterialParameters, Unknowns, material_prior
from femu_piezo.material.library import library_material
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.measurement.sweeps import SweepData
from femu_piezo.resonances import Resonance
from tests.materials import FORWARD_LOSSY as LOSSY
from tests.noise import noisy_sweep

#: A bar so slender that the 1-D formula, which needs no discretisation, holds to 1e-5.
BAR = Plate(40e-3, 0.2e-3, 0.2e-3)
DENSITY = 7500.0
FREE = ("s11", "d31", "eps33T")


@pytest.fixture(scope="module")
def bar():
    """The full and the reduced model of the bar, free constants started 10 to 15 % off, and the exact sweep."""
    model = ElectroelasticModel(BAR.domain((20, 1, 1)), DENSITY)
    away = LOSSY.with_values(
        s11=LOSSY.s11.real * 1.15 + 0j, d31=LOSSY.d31.real * 0.85 + 0j, eps33T=LOSSY.eps33T.real * 1.1 + 0j
    )
    free = FreeConstants.of(away, FREE)
    accuracy = 1e-8  # errors of the sensitivities are the square root of the errors of eigenvalues
    reduced = extend_model(model, free.training_sets(free.start, 0.25), (), 60e3, accuracy=accuracy)
    frequency = np.linspace(20e3, 60e3, 401)
    y = k31_bar_admittance(2 * np.pi * frequency, 40e-3, 0.2e-3, 0.2e-3, DENSITY, LOSSY.s11, LOSSY.d31, LOSSY.eps33T)
    return model, reduced, free, ImpedanceSpectrum(frequency, 1 / y)


def _fitted(bar, spectrum: ImpedanceSpectrum, start: np.ndarray) -> Fit:
    """The most probable constants of a sweep with 0.1 % of noise, started at the complex constants `start`."""
    _, reduced, free, _ = bar
    data = SweepData(spectrum.frequency, spectrum.impedance, np.full(len(spectrum), 1e-3), True)
    unknowns = Unknowns(MaterialParameters.around(free, free.start), material_prior(free, {}, {}))
    return fit(Evaluation(reduced, spectrum.omega), data, unknowns, [unknowns.material.x_of(start)])


def test_curve_fit_recovers_the_exact_bar(bar):
    _, _, free, spectrum = bar
    found = _fitted(bar, spectrum, free.start)
    for name, value in zip(FREE, found.parameters.material.theta(found.x), strict=True):
        exact = getattr(LOSSY, name)
        assert value.real == pytest.approx(exact.real, rel=1e-4, abs=0), name
        assert -value.imag / value.real == pytest.approx(LOSSY.tangent(name), rel=5e-3), name


def test_intervals_of_the_curve_fit_hold_the_truth(bar):
    """40 draws of 0.1 % noise: estimates are unbiased and scatter as their covariance states.

    The means of pulls lie within 3.3 of their standard deviations.
    """
    _, _, free, spectrum = bar
    exact = _fitted(bar, spectrum, free.start)
    truth, pulls = exact.parameters.material.theta(exact.x), []
    for seed in range(40):
        found = _fitted(bar, noisy_sweep(spectrum, 1e-3, seed), truth)
        pulls.append((found.x - exact.x) / found.std)
    pulls = np.array(pulls)
    assert np.all(np.abs(pulls.mean(axis=0)) < 3.3 / np.sqrt(40))
    assert np.mean(np.abs(pulls) < 1) == pytest.approx(0.683, abs=0.09)
    assert np.mean(np.abs(pulls) < 2) == pytest.approx(0.954, abs=0.05)


def test_pole_zero_newton_recovers_the_exact_bar(bar):
    """The pole of the 1-D bar is known in closed form; its zero is the root of Y, found to rounding."""
    _, reduced, free, _ = bar
    pole = (np.pi / 40e-3) ** 2 / (DENSITY * LOSSY.s11)
    k2 = LOSSY.d31**2 / (LOSSY.s11 * LOSSY.eps33T)
    x = 1.75 + 0j  # root of (1 − k²) X cos X + k² sin X beyond π/2
    for _ in range(60):
        slope = (1 - k2) * (np.cos(x) - x * np.sin(x)) + k2 * np.cos(x)
        x -= ((1 - k2) * x * np.cos(x) + k2 * np.sin(x)) / slope
    assert 1.6 < x.real < 2.0
    zero = (2 * x / 40e-3) ** 2 / (DENSITY * LOSSY.s11)
    two = FreeConstants.of(free.constants(free.start).with_values(eps33T=LOSSY.eps33T), ("s11", "d31"))
    found = update_pair(reduced_source(reduced), two, np.array([pole, zero]))
    assert found.constants.s11 == pytest.approx(LOSSY.s11, rel=1e-4, abs=0)
    assert found.constants.d31 == pytest.approx(LOSSY.d31, rel=1e-3, abs=0)


def test_reduced_and_full_sources_agree(bar):
    model, reduced, free, _ = bar
    constants = free.constants(free.start * (1 - 0.01j))
    small, full = reduced_source(reduced)(constants, 35e3), full_source(model)(constants, 35e3)
    np.testing.assert_allclose(small.eigenvalues, full.eigenvalues, rtol=1e-6)
    share = constants.to_e_form().vector() / full.eigenvalues[:, None]  # ∂log λ/∂log c
    np.testing.assert_allclose(small.sensitivities * share, full.sensitivities * share, atol=1e-6)


def test_contradictory_pole_and_zero_are_refused(bar):
    """A zero at three times the frequency of its pole (nine times its λ) would need a coupling that no passive ceramic
    has.
    """
    _, reduced, free, _ = bar
    pole = (np.pi / 40e-3) ** 2 / (DENSITY * LOSSY.s11)
    two = FreeConstants.of(free.constants(free.start), ("s11", "d31"))
    with pytest.raises(ConvergenceError, match="pole"):
        update_pair(reduced_source(reduced), two, np.array([pole, 9 * pole]))


def test_identifiability_names_confounded_unknowns():
    """Two unknowns with the same effect on the data: their sum is determined, their difference is not."""
    rng = np.random.default_rng(0)
    base = rng.standard_normal((200, 3))
    jacobian = np.column_stack([base[:, 0], base[:, 1], base[:, 1] * (1 + 1e-14), base[:, 2] * 1e4])
    told = identifiability(jacobian, ("a", "b", "c", "tan_a"), np.ones(4))
    assert told.verdict("tan_a") == "well"
    assert told.verdict("b") == told.verdict("c") == "not"
    assert np.isinf(told.std[1]) or told.std[1] > 1e6
    assert told.std_alone[1] == pytest.approx(1 / np.linalg.norm(base[:, 1]))
    assert "b" in told.weakest(1)[0] and "c" in told.weakest(1)[0]


def test_identifiability_is_the_covariance():
    """Standard deviations and correlations are those of (JᵗJ)^-1, relative to the values of constants and absolute for
    tangents.
    """
    rng = np.random.default_rng(1)
    jacobian, values = rng.standard_normal((50, 4)), np.array([2.0, 0.01, 3.0, 0.02])
    told = identifiability(jacobian, ("a", "tan_a", "b", "tan_b"), values)
    relative = np.array([2.0, 1.0, 3.0, 1.0])
    covariance = np.linalg.inv(jacobian.T @ jacobian) / np.outer(relative, relative)
    np.testing.assert_allclose(told.std, np.sqrt(np.diag(covariance)), rtol=1e-10)
    np.testing.assert_allclose(told.correlation, covariance / np.outer(told.std, told.std), atol=1e-10)


@pytest.mark.parametrize("kind", ["pole", "zero"])
def test_slopes_of_terminal_roots_are_exact(lab, kind):
    """∂/∂x of the fundamental pole or zero in every unknown against central differences.

    Unknowns of the instrument's accuracy move neither.
    """
    unknowns, x = lab.unknowns, lab.truth(3)

    def root(at: np.ndarray) -> np.ndarray:
        modal = lab.evaluation.modal(unknowns, at)
        near = modal.eigenvalues if kind == "pole" else modal.zeros[0]
        start = near[np.argmin(np.abs(near - (2 * np.pi * FUNDAMENTAL) ** 2))]
        terminals = lab.evaluation.terminals(unknowns, at, lab.evaluation.modal(unknowns, at))
        return terminal_roots(terminals, kind, np.sqrt(start[None] + 0j))

    slopes = root_slopes(lab.evaluation, unknowns, x, kind, root(x))[0]
    for column, name in enumerate(unknowns.names):
        step = np.zeros(x.size)
        step[column] = 1e-4 * min(1.0, unknowns.prior_std[column])
        expected = (root(x + step) - root(x - step))[0] / (2 * step[column])
        assert abs(slopes[column] - expected) < 1e-5 * np.abs(slopes).max(), name
        if name.startswith("instrument"):
            assert abs(slopes[column]) < 1e-9 * np.abs(slopes).max(), name


def test_matching_follows_strength_where_modes_cross():
    """A weak mode crosses a strong one: the strong measured mode stays paired with the strong mode of the model."""
    measured = (
        Resonance("pole", 1.00e10 + 1e8j, residue=1e10),
        Resonance("pole", 1.02e10 + 1e8j, residue=1e7),
    )
    model = np.array([0.995e10, 1.03e10]) + 1e8j
    weak_first = match(measured, model, np.array([1e-2, 1.0]))
    assert list(weak_first) == [1, 0]
    strong_first = match(measured, model, np.array([1.0, 1e-2]))
    assert list(strong_first) == [0, 1]


def test_matching_refuses_more_modes_than_the_model_has():
    measured = tuple(Resonance("pole", 1e10 * (k + 1) + 1e8j) for k in range(3))
    with pytest.raises(ConvergenceError, match="3 were measured"):
        match(measured, np.array([1e10, 2e10]) + 1e8j, np.ones(2))


def test_a_resonance_that_the_model_does_not_have_displaces_no_other():
    """Distances in log λ add up, so a chain of wrong partners would cost the same as one resonance without any."""
    measured = [Resonance("pole", complex((2 * np.pi * f) ** 2)) for f in (35e3, 45e3, 105e3)]
    model = (2 * np.pi * np.array([35.2e3, 104e3, 170e3])) ** 2 * (1 + 0.02j)
    assert list(match(measured, model, np.ones(3), 0.5)) == [0, -1, 1]
    assert list(match(measured, model[:1], np.ones(1), 0.5)) == [0, -1, -1]


def test_free_constants_that_cannot_be_free_are_refused():
    simple = library_material("tj52-hd").constants
    with pytest.raises(InputError, match="simplified"):
        FreeConstants.of(simple, ("s11", "s13"), simplified=True)
    with pytest.raises(InputError, match="d15"):
        FreeConstants.of(simple, ("s11", "d15"))


def test_simplified_free_constants_move_together(target):
    """In the simplified material s33, s44 and d33 follow from the three free constants."""
    free = FreeConstants.of(target.full(), FREE, simplified=True)
    theta = np.array([16e-12 - 1e-13j, -3e-10 + 1e-12j, 2e-8 - 1e-10j])
    moved = free.constants(theta)
    assert moved.s33 == moved.s11 == theta[0]
    assert moved.s44 == pytest.approx(2 * (moved.s11 - moved.s12), rel=1e-6, abs=0)
    assert (moved.d31, moved.eps33T, moved.d33) == (theta[1], theta[2], 0)


def test_the_misfit_of_poles_and_zeros_counts_the_constants_that_follow_them():
    """Errors three times as large as stated, of 14 numbers that determine 6 unknowns: 3, and not 3 √(8/14)."""
    free = FreeConstants.of(LOSSY, FREE)
    unknowns = Unknowns(MaterialParameters.around(free, free.start), material_prior(free, {}, {}))
    rng, squares, start = np.random.default_rng(0), [], unknowns.prior_mean
    jacobian = 1e3 * rng.normal(size=(14, start.size))
    for _ in range(200):
        error = 3 * rng.normal(size=14) + jacobian @ (unknowns.prior_std * rng.normal(size=start.size))
        before = ManyModes(unknowns, start, (), (), error, jacobian, np.zeros((14, 0)), np.zeros((0, start.size)))
        step = -before.gain @ np.concatenate([error, np.zeros(start.size)])
        squares.append(replace(before, x=start + step, residual=error + jacobian @ step).rms_residual ** 2)
    # the mean of 200 · 8 squared Gaussian errors is within 1 ± 3 √(2/1600)
    assert abs(np.mean(squares) / 9 - 1) < 3 * np.sqrt(2 / 1600)
