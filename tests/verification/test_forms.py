"""Weak forms: readable forms against gradient products, rigid motions, patch test, and parts of a plate against the
whole.
"""

from __future__ import annotations

import numpy as np
import pytest
import skfem

from femu_piezo.forward.forms import coupled_element, electroelastic_form, mass_form, unit_form
from femu_piezo.forward.gradient_products import assemble_gradient_products, extended_tensor, unit_tensors
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.response import full_impedance
from femu_piezo.geometry.boxes import FACES, tensor_box, unit_box
from femu_piezo.geometry.shapes import Plate
from femu_piezo.material.constants import E_FORM, ElasticForm
from femu_piezo.material.library import library_material
from femu_piezo.material.voigt import axes_with_poling

PZT = library_material("pzt-5h").constants


def _field_dofs(coupled: skfem.Basis, scalar: skfem.Basis) -> np.ndarray:
    """(4n,) degree of freedom of the composite basis that carries field f at scalar degree of freedom i."""
    result = np.empty((4, scalar.N), dtype=int)
    shapes = scalar.element_dofs.shape[0]
    local = np.asarray(coupled.element_dofs)
    vector = [3 * shape + component for component in range(3) for shape in range(shapes)]
    kinds = {}  # local number of (field, scalar shape), found from where each basis function lives
    for index in range(local.shape[0]):
        u, phi = coupled.basis[index]
        kinds[index] = 3 if np.any(np.asarray(phi)) else int(np.argmax([np.any(np.asarray(u)[c]) for c in range(3)]))
    assert len(vector) == 3 * shapes
    for index, field in kinds.items():
        u, phi = coupled.basis[index]
        values = np.asarray(phi) if field == 3 else np.asarray(u)[field]
        matches = [
            shape
            for shape in range(shapes)
            if np.allclose(values, np.broadcast_to(np.asarray(scalar.basis[shape][0]), values.shape), atol=1e-12)
        ]
        assert len(matches) == 1
        result[field, scalar.element_dofs[matches[0]]] = local[index]
    return result.ravel()


def _bases(element: skfem.Element) -> tuple[skfem.Basis, skfem.Basis, np.ndarray]:
    """The bases of one field and of all fields, and the degrees of freedom of each field in the latter."""
    mesh = unit_box((2, 1, 1)).scaled(np.array([1.3, 0.7, 0.4]))
    scalar = skfem.Basis(mesh, element, intorder=4)
    coupled = skfem.Basis(mesh, coupled_element(element), intorder=4)
    return scalar, coupled, _field_dofs(coupled, scalar)


@pytest.fixture(scope="module")
def bases():
    return _bases(skfem.ElementHex2())


@pytest.fixture(scope="module")
def linear_bases():
    return _bases(skfem.ElementHex1())


@pytest.mark.parametrize("direction", [(0, 0, 1), (1, 0, 0), (0.3, -0.5, 0.8)])
@pytest.mark.parametrize("index", range(10))
def test_unit_forms_equal_gradient_products(bases, linear_bases, index, direction):
    """Poling along axes on linear elements, and along no axis on quadratic ones."""
    scalar, coupled, dofs = linear_bases if np.count_nonzero(direction) == 1 else bases
    rotation = axes_with_poling(np.array(direction, float))
    readable = unit_form(E_FORM[index], rotation).assemble(coupled)[dofs][:, dofs]
    fast = assemble_gradient_products(scalar).stiffness(unit_tensors(rotation)[index])
    assert abs(readable - fast).max() < 1e-12 * abs(readable).max()


def test_energies_between_fields_equal_those_of_the_operator(bases):
    """vᵗA w of three tensors at once, also where v is zero except at some nodes of one field."""
    scalar, rng = bases[0], np.random.default_rng(1)
    products, tensors = assemble_gradient_products(scalar), unit_tensors(np.eye(3))[[0, 6, 9]]
    left, right = rng.standard_normal((4, scalar.N, 3)), rng.standard_normal((4, scalar.N, 2))
    sparse, some = np.zeros_like(left), rng.permutation(scalar.N)[:5]
    sparse[3, some] = left[3, some]
    for first in (left, sparse):
        flat = first.reshape(-1, 3)
        exact = np.array([flat.T @ (products.stiffness(tensor) @ right.reshape(-1, 2)) for tensor in tensors])
        np.testing.assert_allclose(products.between(first, right, tensors), exact, rtol=1e-12, atol=1e-12)
    first = products.within(left, tensors)
    np.testing.assert_allclose(first, products.between(left, left, tensors), rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(first, first.transpose(0, 2, 1))


def test_whole_operator_is_the_sum_of_its_terms(bases):
    scalar, coupled, dofs = bases
    e_form = PZT.to_e_form()
    readable = electroelastic_form(e_form).assemble(coupled)[dofs][:, dofs]
    fast = assemble_gradient_products(scalar).stiffness(extended_tensor(e_form, np.eye(3)).real)
    scale = np.where(np.arange(fast.shape[0]) < 3 * scalar.N, 1.0, 1e9)
    difference = (readable - fast).multiply(np.outer(scale, scale))
    assert abs(difference).max() < 1e-12 * abs(fast.multiply(np.outer(scale, scale))).max()
    mass = mass_form(7500.0).assemble(coupled)[dofs][:, dofs]
    assert abs(mass - assemble_gradient_products(scalar).mass_matrix(7500.0)).max() < 1e-12 * abs(mass).max()


def test_ready_mesh_and_tensor_grid_are_the_same_grid():
    ready, grid = unit_box((7, 1, 1)), tensor_box([np.linspace(0, 1, n + 1) for n in (7, 1, 1)])
    np.testing.assert_allclose(*(m.p[:, np.lexsort(m.p.round(9))] for m in (ready, grid)), atol=1e-12)
    for face in FACES:
        centres = [np.sort(m.p[:, m.facets[:, m.boundaries[face]]].mean(axis=1), axis=1) for m in (ready, grid)]
        np.testing.assert_allclose(*centres, atol=1e-12)


def test_rigid_bodies_and_constant_potential_cost_nothing(bases):
    """No force and no charge."""
    scalar, _, _ = bases
    matrix = assemble_gradient_products(scalar).stiffness(extended_tensor(PZT.to_e_form(), np.eye(3)).real)
    x = scalar.doflocs
    zero, one = np.zeros(scalar.N), np.ones(scalar.N)
    fields = {
        "translation": [one, zero, zero, zero],
        "rotation about z": [-x[1], x[0], zero, zero],
        "rotation about x": [zero, -x[2], x[1], zero],
        "constant potential": [zero, zero, zero, 1e9 * one],
    }
    stretched = matrix @ np.concatenate([x[0], zero, zero, zero])
    for name, field in fields.items():
        force = matrix @ np.concatenate(field)
        scaled = np.where(np.arange(force.size) < 3 * scalar.N, force, 1e9 * force)
        assert np.linalg.norm(scaled) < 1e-10 * np.linalg.norm(stretched), name


def test_patch_any_linear_field_is_exact(bases):
    """A uniform strain and field give uniform stress: interior residual zero, energy = volume × density."""
    scalar, _, _ = bases
    e_form = PZT.to_e_form()
    products = assemble_gradient_products(scalar)
    tensor = extended_tensor(e_form, np.eye(3)).real
    rng = np.random.default_rng(0)
    gradient = rng.standard_normal((4, 3)) * np.array([[1e-6], [1e-6], [1e-6], [1e3]])
    field = gradient @ scalar.doflocs
    force = products.stiffness(tensor) @ field.ravel()
    volume = 1.3 * 0.7 * 0.4
    energy = np.einsum("fa,fagb,gb", gradient, tensor, gradient) * volume
    assert field.ravel() @ force == pytest.approx(energy, rel=1e-10)
    boundary = np.unique(scalar.get_dofs(scalar.mesh.boundary_facets()).all())
    interior = np.setdiff1d(np.arange(scalar.N), boundary)
    assert interior.size > 0
    forces = force.reshape(4, -1)
    for f in range(4):
        assert np.abs(forces[f, interior]).max() < 1e-10 * np.abs(forces[f]).max()


@pytest.mark.parametrize(("poling", "size"), [("thickness", (8e-3, 5e-3, 1e-3)), ("length", (8e-3, 2e-3, 1e-3))])
def test_static_capacitance_of_a_free_plate_is_that_of_eps33T(poling, size):
    """A free plate has D = ε33T E exactly, for any anisotropy: at 1 Hz its capacitance is ε33T A/d."""
    plate = Plate(*size, poling)
    lossy = PZT.with_values(eps33T=PZT.eps33T * (1 - 0.02j), s11=PZT.s11 * (1 - 0.01j), d33=PZT.d33 * (1 - 0.015j))
    for axes in ((0, 1, 2), (1,), ()):
        model = ElectroelasticModel(plate.domain((2, 2, 2), axes), 7500.0)
        z = full_impedance(model, lossy.to_e_form(), np.array([1.0]))[0]
        capacitance = lossy.eps33T * plate.electrode_area / plate.electrode_gap
        assert 1 / (2j * np.pi * z) == pytest.approx(capacitance, rel=1e-8, abs=0)


def test_parts_of_the_plate_give_the_same_impedance():
    plate = Plate(8e-3, 5e-3, 1e-3)
    lossy = ElasticForm.from_vector(PZT.to_e_form().vector() * (1 + 0.01j))
    frequency = np.array([150e3, 230e3])
    counts = {(0, 1, 2): (4, 2, 1), (1, 2): (8, 2, 1), (2,): (8, 4, 1), (): (8, 4, 2)}
    results = [
        full_impedance(ElectroelasticModel(plate.domain(n, axes), 7500.0), lossy, frequency)
        for axes, n in counts.items()
    ]
    for result in results[1:]:
        np.testing.assert_allclose(result, results[0], rtol=1e-8)
