"""The identities that the reduction is based on: shifted driven states, Krylov vectors, projections, uniform loss,
residuals; and thread limits.
"""

from __future__ import annotations

import numpy as np
import pytest

from femu_piezo.errors import ConvergenceError
from femu_piezo.forward import krylov
from femu_piezo.forward.krylov import driven_krylov
from femu_piezo.forward.linear_solver import factorize
from femu_piezo.forward.model import POTENTIAL_SCALE, ElectroelasticModel
from femu_piezo.forward.projection import TermProjections
from femu_piezo.forward.reduced_basis import ReducedBasis
from femu_piezo.forward.reduction import reduce_model
from femu_piezo.forward.training import TrainingSet, leading_residuals, state_residuals
from femu_piezo.geometry.shapes import Plate
from femu_piezo.material.constants import E_FORM, ElasticForm
from femu_piezo.material.library import library_material
from femu_piezo.threads import available_cores, blas_limit, useful_threads

PZT = library_material("pzt-5h").constants.lossless()
E_CONSTANTS = PZT.to_e_form()
TOP = (2 * np.pi * 200e3) ** 2


@pytest.fixture(scope="module")
def model():
    return ElectroelasticModel(Plate(12e-3, 5e-3, 1e-3).domain((5, 2, 1)), 7500.0)


def _reference(model):
    """Stiffness, shift, load of the terminals, factors and static response at that shift."""
    stiffness, shift = model.stiffness(E_CONSTANTS), 0.4 * TOP
    load = np.zeros(model.size)
    load[-1] = -1.0
    factor = factorize(stiffness - shift * model.mass)
    return stiffness, shift, load, factor, factor.solve(load)


def test_driven_state_from_the_shifted_one(model):
    """bᵗx = bᵗx_0 + s x_0ᵗMx, where s = ω² − σ."""
    stiffness, shift, load, _, start = _reference(model)
    for omega in 2 * np.pi * np.array([20e3, 150e3]):
        state = factorize(stiffness - omega**2 * model.mass).solve(load)
        expected = load @ start + (omega**2 - shift) * (start @ (model.mass @ state))
        assert load @ state == pytest.approx(expected, rel=1e-9, abs=0)


def test_krylov_vectors_hold_the_driven_states(model, monkeypatch):
    stiffness, shift, load, factor, start = _reference(model)
    split = int(np.count_nonzero(model.mass.diagonal()))
    mass = model.mass[:split, :split]
    vectors = driven_krylov(factor, mass, start, shift, TOP, 1e-8)
    basis = np.linalg.qr(vectors / np.linalg.norm(vectors, axis=0))[0]
    for frequency in (5e3, 80e3, 199e3):
        state = factorize(stiffness - (2 * np.pi * frequency) ** 2 * model.mass).solve(load)
        assert np.linalg.norm(state - basis @ (basis.T @ state)) < 1e-4 * np.linalg.norm(state)
    monkeypatch.setattr(krylov, "_MOST_STEPS", 3)
    with pytest.raises(ConvergenceError, match="Lanczos"):
        driven_krylov(factor, mass, start, shift, TOP, 1e-8)


def test_projections_are_the_terms_on_the_basis(model):
    rng = np.random.default_rng(0)
    projections = TermProjections(model)
    u = rng.standard_normal((projections.displacements, 4))
    p = rng.standard_normal((model.size - projections.displacements, 3))
    for columns in (0, 1, 4):
        projections.project(u[:, :columns], p[:, : max(1, columns - 1)])
    whole = np.zeros((model.size, 7))
    whole[: projections.displacements, :4] = u
    whole[projections.displacements :, 4:] = p[:, [1, 2, 0]]
    for matrix, name in zip(projections.project(u, p), E_FORM, strict=True):
        exact = whole.T @ (model.term(name) @ whole)
        np.testing.assert_allclose(matrix, exact, atol=1e-12 * np.abs(exact).max())
    coefficients, states = rng.standard_normal(10), rng.standard_normal((model.size, 2))
    stiffness = sum(c * model.term(name) for c, name in zip(coefficients, E_FORM, strict=True))
    exact = (stiffness - TOP * model.mass) @ states
    found = model.operator(coefficients, TOP) @ states
    np.testing.assert_allclose(found, exact, atol=1e-12 * np.abs(exact).max())
    np.testing.assert_allclose(model.diagonal(coefficients)[:-1], stiffness.diagonal()[:-1])


def test_uniform_loss_has_a_closed_form(model):
    """F(ω) = (1+jη) [C∞ + Σ g²/(λ − ω²/(1+jη))], where λ, g, C∞ are those of the lossless plate."""
    reduced, loss = reduce_model(model, [PZT], 200e3), 0.01
    real = reduced.modal(E_CONSTANTS)
    lossy = reduced.modal(ElasticForm.from_vector(E_CONSTANTS.vector() * (1 + 1j * loss)))
    assert not np.iscomplexobj(real.eigenvalues)
    omega = 2 * np.pi * np.array([1e3, 130e3, 200e3])
    resolvent = 1 / (real.eigenvalues - omega[:, None] ** 2 / (1 + 1j * loss))
    charge = (1 + 1j * loss) * (real.clamped_capacitance + resolvent @ real.charges**2)
    np.testing.assert_allclose(1j * omega * reduced.admittance_factor * charge, lossy.admittance(omega), rtol=1e-9)


def test_residuals_of_training_states(model):
    """A z − λ M z of modes; the potential of the electrode has no residual once its charge is subtracted."""
    _, shift, _, factor, start = _reference(model)
    basis = ReducedBasis(model, E_CONSTANTS.vector().real, start)
    basis.add(driven_krylov(factor, basis.mass, start, shift, TOP, 1e-4), 1e-8)
    values = E_CONSTANTS.vector().real
    moved = values * np.where(np.arange(10) < 5, 1.1, 0.9)
    item = TrainingSet.of(basis.matrices(), basis.u.shape[1], moved, TOP)
    operator = model.stiffness(ElasticForm.from_vector(moved))
    eigenvalues = item.modal.zeros[0][item.modal.zeros[0] < 1.5 * TOP]
    states = basis.matrix @ item.states[:, : eigenvalues.size]
    exact = operator @ states - (model.mass @ states) * eigenvalues
    found = state_residuals(basis, item)
    difference = np.abs(found[:, : eigenvalues.size] - exact).max()
    assert difference < 1e-7 * np.abs(operator @ states).max()
    np.testing.assert_allclose(
        basis.matrix.T @ found, 0.0, atol=1e-6 * np.abs(basis.matrix.T @ (operator @ states)).max()
    )
    assert basis.p[-1, 0] == pytest.approx(1 / POTENTIAL_SCALE, rel=1e-14, abs=0)


def test_leading_residuals_are_principal_directions(model):
    """Of all residuals, each divided by √scale, singular vectors times singular values, longest first; √scale again."""
    _, _, _, _, start = _reference(model)
    values = E_CONSTANTS.vector().real
    basis = ReducedBasis(model, values, start)
    vectors = np.random.default_rng(1).standard_normal((model.size, 6))
    basis.add(vectors, 1e-8)
    factors = (np.where(np.arange(10) < 5, 1.1, 0.9), np.where(np.arange(10) < 5, 0.95, 1.0))
    sets = [TrainingSet.of(basis.matrices(), basis.u.shape[1], values * factor, TOP) for factor in factors]
    scale = np.abs(model.diagonal(values))
    every = np.hstack([state_residuals(basis, item) for item in sets]) / np.sqrt(scale)[:, None]
    left, lengths, _ = np.linalg.svd(every, full_matrices=False)
    found = leading_residuals(basis, sets, scale, 1e-3) / np.sqrt(scale)[:, None]
    count = int(np.sum(lengths > 1e-3 * lengths[0]))
    assert 1 < count < every.shape[1] and found.shape[1] == count
    np.testing.assert_allclose(np.abs(left[:, :count].T @ found), np.diag(lengths[:count]), atol=1e-6 * lengths[0])


def test_blocks_of_vectors_make_the_basis_of_all(model):
    """A basis that takes vectors in blocks spans what it spans where it takes them together.

    A share of 0.05 leaves out the last block, none of whose vectors is that small beside the largest of its own.
    """
    _, _, _, _, start = _reference(model)
    vectors = np.random.default_rng(2).standard_normal((model.size, 9)) * np.repeat([1.0, 0.3, 1e-9], [4, 4, 1])
    together, apart = (ReducedBasis(model, E_CONSTANTS.vector().real, start) for _ in range(2))
    assert together.add(vectors, 0.05) == apart.add_all((vectors[:, at : at + 4] for at in (0, 4, 8)), 0.05) == 16
    for one, other in ((together.u, apart.u), (together.p, apart.p)):
        assert one.shape == other.shape
        np.testing.assert_allclose(
            other @ np.linalg.lstsq(other, one, rcond=None)[0], one, atol=1e-6 * np.abs(one).max()
        )


def test_thread_limits_only_go_down():
    from threadpoolctl import threadpool_info

    def threads():
        return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]

    before = threads()
    with blas_limit(1):
        assert set(threads()) == {1}
    with blas_limit(64):
        assert max(threads()) <= max(before)
    assert threads() == before
    assert useful_threads(2_000) == 1
    assert 1 <= useful_threads(10**6) <= min(available_cores(), 4)
