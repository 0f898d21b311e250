"""Operators scattered into a fixed sparsity pattern, against the triple product with the prolongation."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from femu_piezo.forward.gradient_products import extended_tensor
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.shapes import Plate
from femu_piezo.material.constants import E_FORM, ElasticForm
from femu_piezo.material.library import library_material

E_CONSTANTS = library_material("pzt-5h").constants.to_e_form()


@pytest.mark.parametrize("poling", ["thickness", "length"])
@pytest.mark.parametrize("axes", [(0, 1, 2), (1,), ()])
@pytest.mark.parametrize("order", [1, 2])
def test_equal_to_the_triple_product(poling, axes, order):
    model = ElectroelasticModel(Plate(8e-3, 5e-3, 1e-3, poling).domain((3, 2, 2), axes), 7500.0, order)
    lossy = ElasticForm.from_vector(E_CONSTANTS.vector() * (1 + 0.01j * np.arange(10)))
    for constants in (E_CONSTANTS.lossless(), lossy):
        fast = model.stiffness(constants)
        nodal = model.products.stiffness(extended_tensor(constants, model.rotation))
        slow = model.prolongation.T @ nodal @ model.prolongation
        assert abs(fast - slow).max() < 1e-13 * abs(slow).max()
        assert fast.has_canonical_format
        assert abs(fast - fast.T).max() < 1e-13 * abs(slow).max()


def test_unit_terms_add_up():
    model = ElectroelasticModel(Plate(8e-3, 5e-3, 1e-3).domain((3, 2, 1)), 7500.0)
    values = E_CONSTANTS.lossless().vector().real
    total = sum(value * model.term(name) for value, name in zip(values, E_FORM, strict=True))
    whole = model.stiffness(E_CONSTANTS.lossless())
    assert abs(total - whole).max() < 1e-12 * abs(whole).max()


def test_inertia_and_further_terms_stay_on_the_pattern():
    """K − ω²M + s A has the pattern of K, also where entries cancel; an entry of A outside the pattern extends it."""
    model = ElectroelasticModel(Plate(8e-3, 5e-3, 1e-3).domain((3, 2, 2)), 7500.0)
    pattern, tensor, omega = model._pattern, extended_tensor(E_CONSTANTS.lossless(), model.rotation).real, 4e5
    whole = model.stiffness(E_CONSTANTS.lossless())
    found = pattern.stiffness(tensor, omega**2 * model.density)
    expected = whole - omega**2 * model.mass
    assert abs(found - expected).max() < 1e-13 * abs(expected).max()
    found = pattern.added(found, -expected)
    assert found.nnz == whole.nnz and abs(found).max() < 1e-13 * abs(expected).max()
    row = int(np.argmin(np.diff(whole.indptr)))
    column = int(np.setdiff1d(np.arange(model.size), whole[row].indices)[0])
    apart = sp.csr_matrix(([1.0], ([row], [column])), shape=whole.shape)
    assert pattern.added(whole, 2.0 * apart)[row, column] == 2.0
    mass = pattern.stiffness(np.zeros_like(tensor), -model.density)  # mass alone, of a body without stiffness
    assert abs(mass - model.mass).max() < 1e-13 * abs(model.mass).max()


def test_factors_of_one_model_share_an_analysis():
    """At several shifts and constants; a further term outside the pattern needs a second analysis."""
    model = ElectroelasticModel(Plate(8e-3, 5e-3, 1e-3).domain((3, 2, 2)), 7500.0)
    n, ends = model.basis.N, np.flatnonzero(np.isclose(model.basis.doflocs[0], model.basis.doflocs[0].max()))
    column = sp.csr_matrix((np.ones(ends.size), (ends, np.zeros(ends.size, int))), shape=(4 * n, 1))
    # a spring on the mean of an end couples nodes that no cell has in common
    model = model.with_terms({}, {"spring": (column @ column.T).tocsr(), "film": sp.identity(4 * n, format="csr")})
    values, right = E_CONSTANTS.lossless().vector().real, np.arange(1.0, model.size + 1)
    for shift, spring, film in ((0.0, 0, 0), (1e11, 0, 0), (1e11, 0, 3e4), (3e11, 0, 1e5), (3e11, 2e5, 1e5)):
        coefficients = np.append(values, [spring, film])
        found = model.factorize(coefficients, shift).solve(right)
        residual = model.operator(coefficients, shift) @ found - right
        assert np.linalg.norm(residual) < 1e-8 * np.linalg.norm(right)
        assert model.analysis.analyses == (1 if not spring else 2)
