"""Errors of approximate laws of effects enter stated deviations and the budget; and the lateral stiffness of the
crystal.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hidden_effects.build import Build

from diagnosis.conftest import DENSITY, FREQUENCY, FUNDAMENTAL, SIZE
from femu_piezo.effects.local.plane_stress import unstressed
from femu_piezo.inference.budget import budget
from femu_piezo.inference.fit import Fit, fit, with_discrepancy
from femu_piezo.inference.laws import law_misses
from tests.noise import noisy

NOISE = 2e-4


def fitted(setup, key: str, z: np.ndarray, values) -> tuple[Fit, Fit]:
    """A fit that knows of noise alone, and one with the error of the law and the discrepancy learned from the
    residual.
    """
    parameters, start = setup.with_effects({key: values})
    found = fit(setup.evaluation, setup.data(z, NOISE), parameters, [start])
    return replace(found, law=None), with_discrepancy(found, found.learned)


def test_constants_lie_within_deviations_that_hold_the_error_of_the_law(setup):
    """Bare ends of 0.8 mm by the independent solver: with noise alone, an error is above 3 stated deviations; with
    the error of the law and a discrepancy none is.

    For narrower ends other constants absorb nearly all of the law's error.
    """
    margin = 0.8e-3
    built = Build(np.array(SIZE), DENSITY, setup.theta, FUNDAMENTAL)
    built.margins = (margin, margin)
    plain, honest = fitted(setup, "electrode_margin", noisy(built.impedance(FREQUENCY), NOISE, 4), margin)
    truth = np.append(setup.x, margin / setup.library["electrode_margin"].scale)
    assert np.max(np.abs(plain.x - truth) / plain.std) > 3
    assert plain.learned.probable
    assert np.max(np.abs(honest.x - truth) / honest.std) < 3


def test_a_margin_that_is_known_has_the_error_of_its_law_too(setup):
    """Margins of 0.4 mm given in the file: deviations of the constants count the error of the law."""
    margin, effect = 0.4e-3, setup.library["electrode_margin"]
    built = Build(np.array(SIZE), DENSITY, setup.theta, FUNDAMENTAL)
    built.margins = (margin, margin)
    known = replace(setup.unknowns, fixed=((effect, np.array([margin])),))
    found = fit(setup.evaluation, setup.data(noisy(built.impedance(FREQUENCY), NOISE, 4), NOISE), known, [setup.x])
    assert np.max(np.abs(found.x - setup.x) / replace(found, law=None).std) > 3
    assert np.max(np.abs(found.x - setup.x) / found.std) < 3


def test_the_error_of_a_law_as_a_whole_is_one_of_its_parameters(setup):
    """Size, place and width of a crack have a deviation of 0.9 of the law's relative error at least, and less than
    half of that without it.

    The part "law" of the budget is the difference in variance.
    """
    crack = setup.library["local_crack"]
    values = np.array([1e-2 * SIZE[0], 0.3 * SIZE[0], SIZE[0] / 40])
    parameters, x = setup.with_effects({"local_crack": values})
    data = setup.data(noisy(setup.evaluation.impedance(parameters, x), NOISE, 4), NOISE)
    found = fit(setup.evaluation, data, parameters, [x])
    shares = np.array([parameter.law_error for parameter in crack.parameters])
    assert np.all(shares > 0)
    columns = parameters.columns(0)
    least = shares * found.x[columns]
    assert np.all(found.std[columns] > 0.9 * least) and np.all(replace(found, law=None).std[columns] < 0.5 * least)
    parts = budget(found)
    np.testing.assert_allclose(np.sum([part**2 for part in parts.values()], axis=0), found.std**2, rtol=1e-9)
    np.testing.assert_allclose(parts["law"] ** 2, found.std**2 - replace(found, law=None).std ** 2, rtol=1e-6)


def test_misses_of_a_law_are_those_of_its_formulas(setup):
    """Of a crack: e p ∂log Z/∂p of each parameter; and in each band e p ∂log Z/∂p of the size less what the other
    unknowns do as well within their priors, by normal equations.
    """
    crack = setup.library["local_crack"]
    parameters, x = setup.with_effects({"local_crack": np.array([5e-3 * SIZE[0], 0.3 * SIZE[0], SIZE[0] / 40])})
    data = setup.data(setup.evaluation.impedance(parameters, x), NOISE)
    jacobian = data.whitened(*setup.evaluation.with_jacobian(parameters, x))[1]
    found = law_misses(setup.evaluation, data, parameters, x, jacobian)
    own = np.arange(parameters.of_material, x.size)
    shares = np.array([parameter.law_error for parameter in crack.parameters])
    np.testing.assert_allclose(found[:, : own.size], jacobian[:, own] * shares * x[own], rtol=1e-12)
    others, miss = np.delete(np.arange(x.size), own), shares[0] * x[own[0]] * jacobian[:, own[0]]
    slopes = jacobian[:, others]
    precision = slopes.T @ slopes + np.diag(1 / parameters.prior_std[others] ** 2)
    miss = miss - slopes @ np.linalg.solve(precision, slopes.T @ miss)
    bands = np.array_split(np.arange(FREQUENCY.size), 10)
    in_bands = found[:, own.size :]
    assert in_bands.shape[1] == len(bands)
    for points, column in zip(bands, in_bands.T, strict=True):
        rows = np.concatenate([points, points + FREQUENCY.size])
        np.testing.assert_allclose(column[rows], miss[rows], atol=1e-6 * np.abs(miss).max())
        assert not np.any(np.delete(column, rows))


def test_laws_without_approximation_ask_for_no_discrepancy(setup):
    """A series resistance is exact: no discrepancy and no part "law" in the budget."""
    z = noisy(setup.evaluation.impedance(*setup.with_effects({"series_resistance": 1.0})), NOISE, 4)
    plain, found = fitted(setup, "series_resistance", z, 1.0)
    assert not plain.learned.probable
    assert "law" not in budget(found)


def test_lateral_stiffness_is_that_of_a_layer_free_of_normal_stress(setup):
    """Stiffness under T_xx = T_xy = T_xz = 0 against the inverse of the remaining compliances."""
    constants = setup.material.constants(setup.x).lossless()
    units = setup.model_of_part.unit_tensors
    found = unstressed(np.tensordot(constants.to_e_form().vector().real, units, axes=1), 0)
    assert np.max(np.abs(found[:3, 0, :3])) < 1e-9 * np.max(np.abs(found))
    assert not np.any(found[3]) and not np.any(found[:, :, 3])
    compliance = np.array([[constants.s11, constants.s13], [constants.s13, constants.s33]]).real
    stiffness = np.linalg.inv(compliance)  # of S_yy, S_zz
    assert np.allclose([found[1, 1, 1, 1], found[1, 1, 2, 2], found[2, 2, 2, 2]], stiffness[[0, 0, 1], [0, 1, 1]])
    assert np.isclose(found[1, 2, 1, 2], 1 / constants.s44.real)
