"""What approximate laws may miss: in stated deviations, and in what is left to explain. And the lateral stiffness."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from femu_piezo.inference.blocks import weak_prior
from femu_piezo.inference.joint import JointParameters
from hidden_effects.build import Build

from diagnosis.conftest import DENSITY, FREQUENCY, FUNDAMENTAL, SIZE
from femu_piezo.effects.local.operators import lateral_tensor
from femu_piezo.inference.fit import SweepData, fit_joint, with_law_misses

NOISE = 2e-4


def fitted(setup, key: str, z: np.ndarray, values):
    data = SweepData(z, np.full(z.size, NOISE), True, weak_prior(setup.material, setup.material.free.start))
    parameters = JointParameters(setup.material).with_effect(setup.library[key])
    start = np.append(setup.x, np.array(values) / setup.library[key].scale)
    return fit_joint(setup.evaluation, data, parameters, [start])


def noisy(z: np.ndarray) -> np.ndarray:
    normal = np.random.default_rng(4).standard_normal((2, z.size))
    return z * (1 + NOISE * (normal[0] + 1j * normal[1]) / np.sqrt(2))


def test_constants_lie_within_deviations_that_hold_the_error_of_the_law(setup):
    """Bare ends of 0.4 mm by the independent solver: noise alone promises ε33T far too closely."""
    margin = 0.4e-3
    built = Build(np.array(SIZE), DENSITY, setup.theta, FUNDAMENTAL)
    built.margins = (margin, margin)
    fit = fitted(setup, "electrode_margin", noisy(built.impedance(FREQUENCY)), (margin,))
    honest = with_law_misses(setup.evaluation, fit)
    truth = np.append(setup.x, margin / setup.library["electrode_margin"].scale)
    assert np.max(np.abs(fit.x - truth) / fit.std) > 3
    assert np.max(np.abs(honest.x - truth) / honest.std) < 3
    assert honest.excess_beyond_law < fit.excess


def test_laws_without_approximation_change_nothing(setup):
    parameters = JointParameters(setup.material).with_effect(setup.library["series_resistance"])
    x = np.append(setup.x, 1.0)
    z = noisy(setup.evaluation.impedance(parameters, x))
    fit = fitted(setup, "series_resistance", z, (1.0,))
    same = with_law_misses(setup.evaluation, fit)
    assert same.law_misses is None
    assert same.excess_beyond_law == same.excess


def test_error_of_a_law_in_one_band_is_explained_by_it(setup):
    """A law that is 3 % too strong or too weak in bands by turns: what is left of χ² is what noise gives."""
    effect = setup.library["local_crack"]
    values = np.array([0.05e-3, 2.1e-3, 0.3e-3])
    parameters = JointParameters(setup.material).with_effect(effect)
    cracked, whole = (
        setup.evaluation.impedance(parameters, np.append(setup.x, own / effect.scale)) for own in (values, effect.rest)
    )
    share = np.concatenate([np.full(p.size, 0.03 * (-1) ** i) for i, p in enumerate(np.array_split(FREQUENCY, 10))])
    z = noisy(cracked * (cracked / whole) ** share)
    honest = with_law_misses(setup.evaluation, fitted(setup, "local_crack", z, values))
    spread = np.sqrt(2 * honest.freedom)
    assert honest.excess > 6 * spread
    assert honest.excess_beyond_law < 3 * spread


def test_lateral_stiffness_is_that_of_a_layer_free_of_normal_stress(setup):
    """c^L by the inverse of the compliances that remain when T_xx = T_xy = T_xz = 0."""
    constants = setup.material.constants(setup.x).lossless()
    units = setup.model_of_part.unit_tensors
    found = lateral_tensor(np.tensordot(constants.to_e_form().vector().real, units, axes=1))
    assert np.max(np.abs(found[:3, 0, :3])) < 1e-9 * np.max(np.abs(found))
    assert not np.any(found[3]) and not np.any(found[:, :, 3])
    compliance = np.array([[constants.s11, constants.s13], [constants.s13, constants.s33]]).real
    stiffness = np.linalg.inv(compliance)  # of S_yy, S_zz
    assert np.allclose([found[1, 1, 1, 1], found[1, 1, 2, 2], found[2, 2, 2, 2]], stiffness[[0, 0, 1], [0, 1, 1]])
    assert np.isclose(found[1, 2, 1, 2], 1 / constants.s44.real)


def test_structured_misfit_widens_deviations_by_the_jackknife_over_bands(setup):
    """Against linear least squares without each band in turn; noise alone leaves the deviations as they are."""
    data = SweepData(
        noisy(setup.evaluation.impedance(JointParameters(setup.material), setup.x)),
        np.full(FREQUENCY.size, NOISE),
        True,
        weak_prior(setup.material, setup.material.free.start),
    )
    parameters = JointParameters(setup.material)
    plain = fit_joint(setup.evaluation, data, parameters, [setup.x])
    wave = np.exp(2e-3 * np.sin(FREQUENCY / 8e3))
    fit = fit_joint(setup.evaluation, replace(data, impedance=data.impedance * wave), parameters, [setup.x])
    whole = np.concatenate([fit.jacobian, fit.prior_jacobian])
    residual = np.concatenate([fit.residual, fit.prior_residual])
    shifts = []
    for points in np.array_split(np.arange(FREQUENCY.size), 10):
        kept = np.setdiff1d(np.arange(residual.size), [*points, *(points + FREQUENCY.size)])
        shifts.append(np.linalg.lstsq(whole[kept], -residual[kept], rcond=None)[0])
    shifts = np.array(shifts)
    scaled = fit.noise_scale**2 * np.linalg.inv(whole.T @ whole)
    expected = scaled + 0.9 * shifts.T @ shifts
    std = np.sqrt(np.diag(expected))
    assert np.max(std / np.sqrt(np.diag(scaled))) > 1.5
    assert np.max(np.abs(fit.covariance - expected) / np.outer(std, std)) < 1e-5
    before = np.concatenate([plain.jacobian, plain.prior_jacobian])
    assert np.allclose(plain.covariance, plain.noise_scale**2 * np.linalg.inv(before.T @ before), rtol=1e-6)
