"""Gradient products by their Kronecker structure against assembled ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from femu_piezo.forward.model import ElectroelasticModel, scalar_basis
from femu_piezo.forward.tensor_grid import TensorGrid
from femu_piezo.geometry.catalogue import plate
from femu_piezo.geometry.shapes import Plate
from femu_piezo.geometry.slab import Electrodes


@pytest.mark.parametrize("order", [2, 3, 6])
def test_products_are_those_of_the_assembled_matrices(order):
    """The documented ∫ ∂_aφ_i ∂_bφ_j dV = X ⊗ Y ⊗ Z, and the mass, on random vectors."""
    plate = Plate(11e-3, 6e-3, 1.3e-3)
    products = ElectroelasticModel(plate.domain((3, 2, 1), order=order), 7500.0).products
    plain = replace(products, grid=None)
    vectors = np.random.default_rng(order).standard_normal((products.size, 4))
    assert products.grid is not None
    for a in range(3):
        for b in range(3):
            exact = plain.times(a, b, vectors)[products.nodes]
            found = products.times(a, b, vectors[products.nodes])
            np.testing.assert_allclose(found, exact, rtol=0, atol=1e-12 * np.abs(exact).max())
    exact = plain.mass_times(vectors)
    np.testing.assert_allclose(products.mass_times(vectors), exact, rtol=0, atol=1e-12 * np.abs(exact).max())


def test_forms_of_fields_with_themselves_are_those_of_any_two():
    """Half of the parts and their transposes give vᵗA v for all unit constants, also where some of the fields
    vanish.
    """
    model = ElectroelasticModel(Plate(11e-3, 6e-3, 1.3e-3).domain((3, 2, 1), order=3), 7500.0)
    fields = np.random.default_rng(1).standard_normal((4, model.products.size, 5))
    for used in ((0, 1, 2, 3), (1, 3)):
        chosen = np.zeros_like(fields)
        chosen[list(used)] = fields[list(used)]
        exact = model.products.between(chosen, chosen, model.unit_tensors)
        found = model.products.within(chosen, model.unit_tensors)
        np.testing.assert_allclose(found, exact, rtol=0, atol=1e-12 * np.abs(exact).max())
        np.testing.assert_array_equal(found, found.transpose(0, 2, 1))


def test_other_bases_have_no_grid():
    """A part of the cells, moved cells, and cells graded towards the rim of an electrode are no regular box."""
    model = ElectroelasticModel(Plate(10e-3, 5e-3, 1e-3).domain((2, 2, 1), order=3), 7500.0)
    part = model.basis.__class__(model.basis.mesh, model.basis.elem, elements=np.array([0]))
    assert TensorGrid.of(part) is None
    bent = model.basis.mesh.translated((0, 0, 0))
    points = bent.p.copy()
    points[0] += 0.1 * points[1]
    sheared = model.basis.__class__(replace(bent, doflocs=points), model.basis.elem)
    assert TensorGrid.of(sheared) is None
    half = plate(10e-3, 6e-3, 1e-3, electrodes=Electrodes(span=(0.0, 5e-3))).domain(3e-3, order=3)
    assert TensorGrid.of(scalar_basis(half.mesh, 3)) is None
