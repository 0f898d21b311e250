"""Hexahedra of any order: conformity, patch test and convergence rates on cells numbered and turned at random."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse.linalg as spla
import skfem
from scipy.optimize import brentq
from scipy.special import jnp_zeros
from skfem.models.poisson import laplace, mass
from skfem.refdom import RefHex

from femu_piezo.forward.eigen import solve_eigen
from femu_piezo.forward.hex_element import ElementHexP, lobatto_nodes
from femu_piezo.forward.model import ElectroelasticModel, scalar_basis
from femu_piezo.geometry.boxes import tensor_box
from femu_piezo.geometry.catalogue import disk
from femu_piezo.geometry.domain import Domain
from femu_piezo.material.library import library_material

PZT = library_material("pzt-5h").constants.lossless()
LINES = (np.array([0.0, 0.6, 1.0]), np.array([0.0, 0.5, 1.2]), np.array([0.0, 0.3, 0.7]))


def rotations() -> list[list[int]]:
    """The 24 ways to number the vertices of a cell that keep its handedness."""
    corners, found = RefHex.p.T - 0.5, []
    for axes, signs in itertools.product(itertools.permutations(range(3)), itertools.product((1, -1), repeat=3)):
        turn = np.diag(signs)[list(axes)]
        if np.linalg.det(turn) > 0:
            found.append([int(np.argmin(np.linalg.norm(corners - corner, axis=1))) for corner in corners @ turn])
    return found


def turned(mesh: skfem.MeshHex, seed: int = 0) -> skfem.MeshHex:
    """The same mesh with vertices and cells renumbered and every cell turned at random; boundaries stay in place."""
    rng, ways = np.random.default_rng(seed), rotations()
    cells = np.array([column[ways[rng.integers(24)]] for column in mesh.t.T]).T
    number = rng.permutation(mesh.p.shape[1])
    places = np.empty_like(mesh.p)
    places[:, number] = mesh.p
    fresh = skfem.MeshHex(places, number[cells][:, rng.permutation(mesh.nelements)])
    boundaries = mesh.boundaries or {}
    centres = {name: mesh.p[:, mesh.facets[:, facets]].mean(axis=1) for name, facets in boundaries.items()}
    near = {
        name: (lambda x, own=own: np.min(np.linalg.norm(x[:, :, None] - own[:, None], axis=0), axis=1) < 1e-9)
        for name, own in centres.items()
    }
    return fresh.with_boundaries(near)


def distorted(mesh: skfem.MeshHex) -> skfem.MeshHex:
    """Inner vertices moved, faces of the box kept."""
    x, y, z = mesh.p
    bump = x * (1 - x) * y * (1.2 - y) * z * (0.7 - z)
    return replace(mesh, doflocs=mesh.p + np.outer([6.0, -4.0, 5.0], bump))


@pytest.mark.parametrize("order", range(2, 9))
def test_neighbours_agree_on_their_face(order):
    """Any coefficients give a continuous function, whose values at the nodes are the coefficients."""
    mesh = turned(distorted(skfem.MeshHex.init_tensor(*LINES)))
    basis = scalar_basis(mesh, order)
    inner, field = np.flatnonzero(mesh.f2t[1] >= 0), np.random.default_rng(1).standard_normal(basis.N)
    sides = [skfem.InteriorFacetBasis(mesh, basis.elem, facets=inner, side=side, intorder=3) for side in (0, 1)]
    first_side, second_side = (np.asarray(side.interpolate(field)) for side in sides)
    np.testing.assert_allclose(first_side, second_side, rtol=0, atol=1e-12)
    linear = np.array([1.0, -2.0, 0.5]) @ basis.doflocs
    np.testing.assert_allclose(basis.interpolate(linear).grad[1], -2.0, rtol=1e-10)


def test_nodes_are_those_of_gauss_lobatto():
    np.testing.assert_allclose(lobatto_nodes(4), (1 + np.array([-1, -np.sqrt(3 / 7), 0, np.sqrt(3 / 7), 1])) / 2)
    np.testing.assert_allclose(lobatto_nodes(1), [0, 1])


def test_order_two_is_the_element_of_scikit_fem():
    mesh = skfem.MeshHex.init_tensor(*LINES)
    of_order_two, known = scalar_basis(mesh, 2), skfem.Basis(mesh, skfem.ElementHex2(), intorder=4)
    np.testing.assert_allclose(of_order_two.doflocs, known.doflocs, atol=1e-14)
    assert abs(laplace.assemble(of_order_two) - laplace.assemble(known)).max() < 1e-12


@pytest.mark.parametrize("order", [1, 3, 6])
def test_patch(order):
    """A uniform strain and field leave no force and no charge at inner nodes of distorted, turned cells."""
    mesh = turned(distorted(tensor_box(LINES)))
    model = ElectroelasticModel(Domain(mesh, ("x_max",), ("x_min",)), 1.0, order)
    slopes = np.random.default_rng(2).standard_normal((4, 3)) * np.array([1, 1, 1, 1e9])[:, None]
    operator = model.products.stiffness(np.tensordot(PZT.to_e_form().vector().real, model.unit_tensors, axes=1))
    load = (operator @ (slopes @ model.basis.doflocs).ravel()).reshape(4, -1)
    inner = np.setdiff1d(np.arange(model.basis.N), model.basis.get_dofs().all())
    assert order == 1 or inner.size > 0
    scale = np.abs(load).max(axis=1, keepdims=True)
    assert np.all(np.abs(load[:, inner]) < 1e-11 * scale)


def free_eigenvalues(basis: skfem.CellBasis, count: int) -> np.ndarray:
    """(count,) lowest eigenvalues of −Δ with free faces, in ascending order."""
    stiff, inertia = laplace.assemble(basis), mass.assemble(basis)
    return np.sort(spla.eigsh(stiff, count, M=inertia, sigma=-1.0, return_eigenvectors=False))


@pytest.mark.parametrize("order", [2, 3, 4, pytest.param(5, marks=pytest.mark.slow)])
def test_eigenvalues_of_a_box_converge_with_twice_the_order(order):
    """λ = π² (i²/a² + j²/b² + k²/c²) on a × b × c, however the cells are turned."""
    sides, found = (1.0, 1.2, 0.7), []
    for count in (2, 3):
        lines = [np.linspace(0, side, count + 1) for side in sides]
        found.append(free_eigenvalues(scalar_basis(turned(skfem.MeshHex.init_tensor(*lines)), order), 7)[1:])
    modes = itertools.product(range(6), repeat=3)
    exact = np.sort([np.pi**2 * sum((n / side) ** 2 for n, side in zip(m, sides, strict=True)) for m in modes])[1:7]
    coarse, fine = (values[:4] / exact[:4] - 1 for values in found)
    assert np.all(fine > -1e-11)
    assert np.all(np.log(coarse / fine) / np.log(1.5) > 2 * order - 0.5)
    assert np.all(np.abs(found[1] / exact - 1) < 0.03 * 30.0 ** (2 - order))


@pytest.mark.parametrize(("edge", "error"), [(0.55, 2e-3), (0.3, 1e-4)])
def test_eigenvalues_of_a_meshed_disk(edge, error):
    """Radial modes of a quarter disk meshed by gmsh are zeros of J_0'; the remaining error is that of the rounded
    edge.
    """
    found = free_eigenvalues(scalar_basis(disk(2.0, 0.5).domain(edge).mesh, 4), 5)
    assert np.min(np.abs(found / jnp_zeros(0, 1)[0] ** 2 - 1)) < error


def test_thickness_modes_between_mirrors_are_exact():
    """A layer without lateral motion: open λ = (nπ/t)² c33D/ρ; short X = k_t² tan X at half the thickness.

    Exact in three dimensions, with all couplings, and reached on turned cells of order 6.
    """
    thickness, density, form = 0.7e-3, 7500.0, PZT.to_e_form()
    mesh = turned(tensor_box([np.array(line) * 1e-3 for line in ([0, 0.6], [0, 0.5, 1.2], [0, 0.3, 0.7])]))
    sides = {"x_min": 0, "x_max": 0, "y_min": 1, "y_max": 1}
    model = ElectroelasticModel(Domain(mesh, ("z_max",), ("z_min",), sides), density, order=6)
    stiffened = form.c33.real + form.e33.real**2 / form.eps33S.real
    coupling = form.e33.real**2 / (form.eps33S.real * stiffened)
    at = brentq(lambda x: coupling * np.tan(x) - x, 0.1, np.pi / 2 - 1e-6)
    for circuit, exact in (("open", np.pi / 2), ("short", at)):
        value = (2 * exact / thickness) ** 2 * stiffened / density
        modes = solve_eigen(model, form, circuit, 4, near_Hz=0.999 * np.sqrt(value) / (2 * np.pi))
        assert np.min(np.abs(modes.eigenvalues.real / value - 1)) < 1e-9


def test_an_order_below_one_is_refused():
    with pytest.raises(ValueError, match="at least 1"):
        ElementHexP(0)
