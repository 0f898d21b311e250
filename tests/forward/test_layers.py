"""Plane meshes in layers: products without assembled matrices, and elimination by cells, against the assembled weak
forms.
"""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from femu_piezo.forward import linear_solver
from femu_piezo.forward.gradient_products import FIELDS
from femu_piezo.forward.layers import LayeredProducts
from femu_piezo.forward.linear_solver import factorize
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.catalogue import disk, plate, ring, trapezoid
from femu_piezo.geometry.regions import Circle
from femu_piezo.geometry.shapes import Plate
from femu_piezo.geometry.slab import Electrodes
from femu_piezo.material.library import library_material

MM = 1e-3
CONSTANTS = library_material("pzt-5h").constants.lossless().to_e_form()
SHIFT = (2 * np.pi * 150e3) ** 2
HALF = Electrodes(span=(0.0, 5 * MM))
BODIES = {
    "half plate": plate(10 * MM, 6 * MM, 1 * MM, electrodes=HALF),
    "half trapezoid": trapezoid(12 * MM, 6 * MM, 3 * MM, 1 * MM, electrodes=HALF),
    "ring, margin": ring(10 * MM, 4 * MM, 1 * MM, electrodes=Electrodes(margin=0.5 * MM)),
    "disk": disk(10 * MM, 1 * MM, direction=(1.0, 0.0, 1.0)),
    "holed": plate(10 * MM, 6 * MM, 1 * MM, holes=(Circle(2 * MM, (1 * MM, 0.5 * MM)),)),
}


@pytest.fixture(scope="module", params=BODIES)
def model(request) -> ElectroelasticModel:
    return ElectroelasticModel(BODIES[request.param].domain(3 * MM, order=3), 7500.0)


def close(found: np.ndarray, exact: np.ndarray, share: float = 1e-12) -> None:
    """Assert equality to a share of the largest exact value."""
    np.testing.assert_allclose(found, exact, rtol=0, atol=share * np.abs(exact).max())


def test_products_are_those_of_the_assembled_matrices(model):
    """The documented ∫ ∂_aφ_i ∂_bφ_j dV = P_ab ⊗ Z_ab, the mass, and whole operators by cells."""
    layered, plain = model.products, model.assembled
    assert isinstance(layered, LayeredProducts)
    vectors, nodes = np.random.default_rng(0).standard_normal((layered.size, 3)), layered.nodes
    for a in range(3):
        for b in range(3):
            exact = plain.times(a, b, vectors)
            close(layered.times(a, b, vectors[nodes]), exact[nodes])
            close(layered.diagonal(a, b), plain.diagonal(a, b))
    close(layered.mass_times(vectors), plain.mass_times(vectors))
    fields = np.random.default_rng(1).standard_normal((FIELDS, layered.size, 2))
    close(layered.applied(model.unit_tensors, fields), plain.applied(model.unit_tensors, fields))


def test_cells_add_up_to_the_operator(model):
    products, n = model.products, model.basis.N
    tensor = np.tensordot(CONSTANTS.vector().real, model.unit_tensors, axes=1)
    vectors = np.random.default_rng(2).standard_normal(FIELDS * n)
    found = np.zeros_like(vectors)
    for cell in range(products.cells):
        places = (n * np.arange(FIELDS)[:, None] + products.cell_nodes(cell)).ravel()
        found[places] += products.cell_operator(tensor, 7500.0 * SHIFT, cell) @ vectors[places]
    assembled = model.assembled.stiffness(tensor) - SHIFT * model.assembled.mass_matrix(7500.0)
    close(found, assembled @ vectors)


@pytest.mark.parametrize("backend", ["rslab", "scipy"])
def test_elimination_in_cells_solves_the_assembled_operator(model, backend, monkeypatch):
    """One and several right-hand sides, with and without the check of residuals, and with a further term."""
    if backend == "scipy":
        monkeypatch.setattr(linear_solver, "rslab", None)
    right = np.random.default_rng(3).standard_normal((model.size, 2))
    top = np.zeros((FIELDS, model.basis.N))
    top[:3, model.basis.get_dofs("hot").all()] = 1e-6
    spring = sp.diags(top.ravel())
    for further in ({}, {"spring": spring}):
        whole = model.with_terms({}, further)
        coefficients = np.append(CONSTANTS.vector().real, [2e9] * len(further))
        exact = factorize(whole.stiffness(CONSTANTS, dict.fromkeys(further, 2e9)) - SHIFT * model.mass).solve(right)
        found = whole.factorize(coefficients, SHIFT)
        close(found.solve(right), exact, 1e-9)
        close(found.solve(right[:, 0]), exact[:, 0], 1e-9)
        close(found.solve_unchecked(right), exact, 1e-8)


def test_boxes_and_parts_are_assembled():
    """Boxes have products along each axis instead, and a part of the cells is no complete layer."""
    box = ElectroelasticModel(Plate(10 * MM, 5 * MM, 1 * MM).domain((2, 2, 1), order=3), 7500.0)
    assert LayeredProducts.of(box.basis) is None
    basis = ElectroelasticModel(BODIES["disk"].domain(3 * MM, order=3), 7500.0).basis
    part = basis.__class__(basis.mesh, basis.elem, elements=np.array([0]))
    assert LayeredProducts.of(part) is None
