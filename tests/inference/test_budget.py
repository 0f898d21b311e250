"""The uncertainty budget: squares of its parts add up to the variance, and each part is how the fit moves with its
source.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from laboratory import TOLERANCES, shifted

from femu_piezo.inference.budget import SOURCES, budget, constants_of
from femu_piezo.inference.fit import fit, with_discrepancy


@pytest.fixture(scope="module")
def found(lab):
    """A fit of a laboratory sweep whose noise is stated as large as the fit finds it, so that the noise level is 1."""
    truth = lab.truth(11)
    data = lab.measured(lab.evaluation.impedance(lab.unknowns, truth), 11, known=False)
    for _ in range(4):
        fitted = fit(lab.evaluation, data, lab.unknowns, [truth])
        data = replace(data, relative_noise=data.relative_noise * fitted.noise_scale)
    assert fitted.noise_scale == pytest.approx(1.0, abs=1e-3)
    return fitted


def sum_of_squares(parts: dict[str, np.ndarray]) -> np.ndarray:
    return np.sum([part**2 for part in parts.values()], axis=0)


def test_squares_add_up_to_the_variances(found):
    parts = budget(found)
    assert tuple(parts) == tuple(source for source in SOURCES if source in parts)
    assert {"noise", "geometry", "density", "held", "instrument", "prior"} <= set(parts)
    np.testing.assert_allclose(sum_of_squares(parts), found.std**2, rtol=1e-9)


def test_squares_add_up_with_discrepancy_mesh_error_and_causes(lab, found):
    """With a smooth misfit, an error of the mesh, and length and leakage as causes."""
    wave = np.exp(3e-3 * np.sin(np.linspace(0, 5, found.data.impedance.size)))
    data = replace(
        found.data,
        impedance=found.data.impedance * wave,
        model_share=np.linspace(0.0, 0.5, wave.size),
    )
    unknowns = lab.unknowns.with_candidate(lab.library["wrong_length"]).with_candidate(lab.library["leakage"])
    plain = fit(lab.evaluation, data, unknowns, [unknowns.carried(found.parameters, found.x)])
    one = with_discrepancy(plain, plain.learned)
    assert plain.learned.probable
    parts = budget(one)
    assert {"mesh", "discrepancy"} <= set(parts)
    np.testing.assert_allclose(sum_of_squares(parts), one.std**2, rtol=1e-9)
    leak = unknowns.columns(unknowns.index("leakage"))
    assert parts["discrepancy"][leak] > 0 and parts["mesh"][leak] > 0
    assert parts["mesh"][leak] < parts["noise"][leak]  # the mesh has at most half of the variance of any point


def test_squares_add_up_at_the_wall(lab):
    """Priors ask for tangents that would create energy: the fit is held at the wall, whose rows enter covariance and
    budget alike.
    """
    active = {"tan_s11": (0.02, 1e-3), "tan_d31": (0.2, 1e-2), "tan_eps33T": (0.02, 1e-3)}
    unknowns = replace(lab.ideal, prior=lab.ideal.prior | active)
    data = lab.measured(lab.evaluation.impedance(lab.ideal, lab.ideal.prior_mean), 3, 0.3)
    one = fit(lab.evaluation, data, unknowns, [lab.material.x_of(lab.free.start)])
    assert np.any(one.further_residual[one.x.size :] < 0)
    np.testing.assert_allclose(sum_of_squares(budget(one)), one.std**2, rtol=1e-9)


@pytest.mark.parametrize("source", ["geometry", "density", "held", "instrument", "prior"])
def test_part_of_a_source_is_how_the_fit_moves_with_it(lab, found, source):
    """Root of Σ (Δx for one deviation of a prior mean)² over the unknowns of a source, Δx by new fits."""
    kinds = {
        "geometry": ("wrong_length", "wrong_width", "wrong_thickness"),
        "density": ("wrong_density",),
        "held": ("wrong_insensitive",),
        "instrument": ("series", "stray", "instrument"),
        "prior": ("s11", "d31", "eps33T", "tan_s11", "tan_d31", "tan_eps33T"),
    }[source]
    columns = [i for i, name in enumerate(found.parameters.names) if name.startswith(kinds)]
    assert columns
    moved, by = [], 0.3
    for column in columns:
        ends = []
        for sign in (1, -1):
            other = shifted(found.parameters, column, sign * by)
            ends.append(fit(lab.evaluation, found.data, other, [found.x]).x)
        moved.append((ends[0] - ends[1]) / (2 * by))
    expected = np.sqrt(np.sum(np.square(moved), axis=0))
    part = budget(found)[source]
    # the budget is linear: within 2 %, or within 1 % of the whole deviation where the part is small
    assert np.all(np.abs(part - expected) < 0.02 * expected + 0.01 * found.std)


def test_part_of_the_noise_is_how_the_fit_moves_with_every_reading(lab, found):
    """Re and Im of log Z of each reading moved by their standard deviation in turn, and fitted anew."""
    moved = []
    for point in range(found.data.impedance.size):
        for direction in (1.0, 1.0j):
            z = found.data.impedance.copy()
            z[point] *= np.exp(direction * found.data.relative_noise[point] / np.sqrt(2))
            moved.append(fit(lab.evaluation, replace(found.data, impedance=z), lab.unknowns, [found.x]).x - found.x)
    expected = np.sqrt(np.sum(np.square(moved), axis=0))
    part = budget(found)["noise"]
    assert np.all(np.abs(part - expected) < 0.03 * expected + 0.01 * found.std)


def test_estimates_carry_the_budget_in_their_units(found):
    parts, scale = budget(found), found.parameters.material.scale
    for index, (name, one) in enumerate(constants_of(found).items()):
        assert one.value == pytest.approx(scale[index] * found.x[2 * index], rel=1e-6, abs=0)
        assert one.std == pytest.approx(abs(scale[index]) * found.std[2 * index], rel=1e-6, abs=0)
        for source, part in one.budget.items():
            assert part == pytest.approx(abs(scale[index]) * parts[source][2 * index], rel=1e-6, abs=0), (name, source)
            assert one.tan_budget[source] == pytest.approx(parts[source][2 * index + 1], rel=1e-6, abs=0)
        assert sum(part**2 for part in one.budget.values()) == pytest.approx(one.std**2, rel=1e-9, abs=0)
        assert sum(part**2 for part in one.tan_budget.values()) == pytest.approx(one.tan_std**2, rel=1e-9, abs=0)
        assert one.to_json()["budget"] == one.budget


def test_largest_parts_are_those_of_the_formulas_of_the_bar(lab, found):
    """s11 ∝ 1/(ρ L² f²) depends on calliper and balance, ε33T = C t/(w L) on the calliper and on the accuracy of
    |Z|.

    The sweep determines the width a little by itself, so that the calliper contributes slightly less to ε33T.
    """
    parts, length, width, thickness = budget(found), 0.02 / 12, 0.02 / 3, 0.005 / 1
    assert parts["geometry"][0] == pytest.approx(2 * length, rel=0.1)
    assert parts["density"][0] == pytest.approx(0.003, rel=0.1)
    assert parts["noise"][0] < 0.1 * parts["geometry"][0]
    whole = np.sqrt(length**2 + width**2 + thickness**2)
    assert 0.7 * whole < parts["geometry"][4] < 1.02 * whole
    assert parts["geometry"][4] == max(part[4] for part in parts.values())
    assert 0.5 * TOLERANCES["accuracy"] < parts["instrument"][4] < 2 * TOLERANCES["accuracy"]


def test_mesh_error_moves_what_is_fitted_as_a_shift_of_frequency_does(lab):
    """The part of the mesh against refits of sweeps whose C = 1/(jω Z) is shifted along frequency by half the relative
    error of λ, band by band.
    """
    error, ideal = 2e-4, lab.ideal
    x = lab.material.x_of(lab.free.start)
    data = lab.measured(lab.evaluation.impedance(ideal, x), 1, noise=1e-5)
    plain = fit(lab.evaluation, data, ideal, [x])
    found = fit(lab.evaluation, replace(data, mesh_error=np.full(data.frequency.size, error)), ideal, [x])
    shift = 1 - error / 2
    change = lab.evaluation.at(shift).impedance(ideal, x) / lab.evaluation.impedance(ideal, x)
    shifted_sweep = data.impedance * shift * change
    moved = []
    for band in data.bands():
        impedance = data.impedance.copy()
        impedance[band] = shifted_sweep[band]
        moved.append(fit(lab.evaluation, replace(data, impedance=impedance), ideal, [x]).x - plain.x)
    np.testing.assert_allclose(budget(found)["mesh"], np.linalg.norm(moved, axis=0), rtol=0.05)
    np.testing.assert_allclose(sum_of_squares(budget(found)), found.std**2, rtol=1e-9)
    assert np.all(budget(plain)["mesh"] == 0)
