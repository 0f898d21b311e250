"""Disks and rings of curved high-order cells: exact limits, reference codes, convergence, and the accuracy asked
for.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import skfem
from scipy.optimize import brentq
from scipy.special import jv, jvp, yv, yvp

from femu_piezo.errors import InputError
from femu_piezo.forward.eigen import solve_eigen
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import reduce_model
from femu_piezo.forward.thin_limits import thin_disk_eigenvalues
from femu_piezo.geometry.catalogue import disk, ring
from femu_piezo.geometry.plane_mesh import extruded, polar_plane
from femu_piezo.geometry.quality import boundary_area, check_electrodes, check_elements
from femu_piezo.geometry.round_body import Divisions, divisions_for, round_domain
from femu_piezo.geometry.slab import Electrodes
from femu_piezo.material.library import LibraryMaterial, library_material
from tests.variants import variants

MM, EVERY, UP = 1e-3, (0, 1, 2), (0.0, 0.0, 1.0)
ACCURACIES = (1e-3, 1e-4, 1e-5)
PIC181 = library_material("pic181")
#: Radii and thickness (m), material, end of the band (Hz), most unknowns for an accuracy of 1e-5.
BODIES = {
    "disk 20 x 1 mm": ((0.0, 10 * MM), 1 * MM, "tj52-hd", 300e3, 2500),
    "ring 20/8 x 1 mm": ((4 * MM, 10 * MM), 1 * MM, "tj52-hd", 300e3, 2500),
    "disk 35 x 2 mm": ((0.0, 17.5 * MM), 2 * MM, "pic255", 500e3, 9000),
    "ring 38/13 x 6 mm": ((6.5 * MM, 19 * MM), 6 * MM, "pzt-8", 150e3, 6000),
    "tall ring": ((7.6 * MM, 10 * MM), 6 * MM, "pzt-4", 250e3, 6000),
    "thick disk": ((0.0, 5 * MM), 4 * MM, "pzt-5h", 400e3, 8000),
}


def shear_wavenumber(material: LibraryMaterial, frequency_Hz: float) -> float:
    slowest = max(material.constants.s44.real, material.constants.s66.real)
    return 2 * np.pi * frequency_Hz * np.sqrt((material.density or 7900.0) * slowest)


def driven(radii, thickness: float, divisions: Divisions, name: str, band: float) -> list[tuple]:
    """(λ, weights) of the poles, then of the zeros below the end of the band; weights relative to the largest."""
    material = library_material(name)
    model = ElectroelasticModel(round_domain(radii, thickness, divisions, EVERY, UP), material.density or 7900.0)
    constants = material.constants.lossless()
    modal = reduce_model(model, [constants], band, accuracy=1e-6).modal(constants.to_e_form())
    found = []
    for values, amplitudes in ((modal.eigenvalues, modal.charges), (modal.zeros[0], modal.zero_amplitudes)):
        inside = (values > 0) & (values < (2 * np.pi * band) ** 2)
        weights = amplitudes[inside] ** 2 / values[inside]
        found.append((values[inside], weights / weights.max()))
    return found


def errors(found: list[tuple], exact: list[tuple]) -> np.ndarray:
    """Relative errors of λ of all poles and zeros that the terminals drive by more than 1e-5 of the most strongly
    driven one.
    """
    result = []
    for (values, weights), (truth, strength) in zip(found, exact, strict=True):
        for value, weight in zip(truth[strength > 1e-5], strength[strength > 1e-5], strict=True):
            result.append(np.min(np.abs(values[weights > 0.1 * weight] / value - 1), initial=1.0))
    return np.array(result)


@pytest.mark.parametrize("body", variants(BODIES, slow=["disk 35 x 2 mm"]))
def test_the_accuracy_asked_for_is_kept(body):
    radii, thickness, name, band, most = BODIES[body]
    wavenumber = shear_wavenumber(library_material(name), band)
    chosen = {accuracy: divisions_for(radii, thickness, thickness / 2, wavenumber, accuracy) for accuracy in ACCURACIES}
    assert chosen[1e-5].unknowns() < most
    fine = replace(chosen[1e-5], order=chosen[1e-5].order + 1)
    exact = driven(radii, thickness, fine, name, band)
    for accuracy, divisions in chosen.items():
        found = errors(driven(radii, thickness, divisions, name, band), exact)
        assert found.size >= 2 and found.max() < accuracy


@pytest.mark.slow
def test_convergence_with_the_order():
    """Two cells along the radius: the errors of all poles and zeros fall by a factor of ten and more per order.

    Largest relative error of λ below 300 kHz, 1 mm thick, against three cells of order 8:

        order   unknowns   disk of 20 mm   ring of 20 and 8 mm
          3          309          1.5e-3                3.4e-4
          4          676          3.8e-5                2.3e-6
          5         1255          1.0e-6                1.3e-7
          6         2094          1.8e-8                1.2e-8
    """
    for radii in ((0.0, 10 * MM), (4 * MM, 10 * MM)):
        exact = driven(radii, 1 * MM, Divisions(8, 3, 1, 1), "tj52-hd", 300e3)
        table = [
            errors(driven(radii, 1 * MM, Divisions(order, 2, 1, 1), "tj52-hd", 300e3), exact).max()
            for order in (4, 5, 6)
        ]
        assert table[0] < 1e-4 and table[-1] < 1e-7
        assert np.all(np.diff(np.log10(table)) < -1)


def test_pic181_disk_has_the_reference_radial_mode():
    """Frequencies of another code with six digits."""
    domain = disk(10 * MM, 1 * MM).domain_for(1e-5, 3e5, 1947.0)
    model = ElectroelasticModel(domain, PIC181.density)
    for circuit, reference in (("short", 229_543), ("open", 261_050)):
        modes = solve_eigen(model, PIC181.constants.to_e_form(), circuit, 4)
        found = np.sqrt(modes.eigenvalues[modes.dominant_index(reference)].real) / (2 * np.pi)
        assert found == pytest.approx(reference, rel=2e-5)


def extrapolated(radii, circuit: str, near_Hz: float) -> float:
    """λ of a mode in the limit of a thin body: it varies as the square of the thickness, then as its fourth power."""
    found = []
    for thickness in (0.2 * MM, 0.1 * MM):
        domain = round_domain(radii, thickness, Divisions(6, 2, 1, 1), EVERY, UP)
        model = ElectroelasticModel(domain, PIC181.density)
        modes = solve_eigen(model, PIC181.constants.to_e_form(), circuit, 6, 0.9 * near_Hz)
        found.append(modes.eigenvalues[modes.dominant_index(near_Hz)].real)
    return (4 * found[1] - found[0]) / 3


@pytest.mark.parametrize("circuit", ["short", pytest.param("open", marks=pytest.mark.slow)])
def test_thin_disk_has_the_bessel_roots(circuit):
    roots = thin_disk_eigenvalues(PIC181.constants, PIC181.density, 10 * MM, 2, circuit).real
    for root in roots:
        found = extrapolated((0.0, 10 * MM), circuit, np.sqrt(root) / (2 * np.pi))
        assert found == pytest.approx(root, rel=2e-7)


def thin_ring_pole(inner: float, outer: float, near_Hz: float) -> float:
    """λ of a thin ring under plane stress: u = A J1(kr) + B Y1(kr), u' + ν u/r = 0 at both edges."""
    s11, s12 = PIC181.constants.s11.real, PIC181.constants.s12.real
    nu, speed = -s12 / s11, 1 / np.sqrt(PIC181.density * s11 * (1 - (s12 / s11) ** 2))

    def determinant(k: float) -> float:
        a, b = ([k * d(1, k * r) + nu * f(1, k * r) / r for r in (inner, outer)] for f, d in ((jv, jvp), (yv, yvp)))
        return a[0] * b[1] - a[1] * b[0]

    guess = 2 * np.pi * near_Hz / speed
    return (speed * brentq(determinant, 0.9 * guess, 1.1 * guess, xtol=1e-9)) ** 2


@pytest.mark.parametrize("mode", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_thin_ring_has_the_bessel_roots(mode):
    radii, near = (4 * MM, 10 * MM), (84e3, 321e3)[mode]
    exact = thin_ring_pole(*radii, near)
    assert extrapolated(radii, "short", np.sqrt(exact) / (2 * np.pi)) == pytest.approx(exact, rel=2e-7)


@pytest.mark.parametrize("inner", [0.0, 4 * MM])
@pytest.mark.parametrize("mirrors", [EVERY, (1, 2), (0,), (1,), ()])
def test_parts_have_volume_electrodes_and_planes(inner, mirrors):
    domain = round_domain((inner, 10 * MM), 1 * MM, Divisions(4, 2, 1, 1), mirrors, UP)
    check_elements(domain.mesh)
    check_electrodes(domain.mesh, "hot", domain.ground[0])
    area = np.pi * ((10 * MM) ** 2 - inner**2)
    assert domain.volume == pytest.approx(area * MM, rel=1e-9, abs=0)
    assert boundary_area(domain.mesh, "hot") * domain.copies / domain.voltage_factor == pytest.approx(
        area, rel=1e-9, abs=0
    )
    for name, axis in domain.symmetry.items():
        assert np.all(domain.mesh.p[axis, domain.mesh.facets[:, domain.mesh.boundaries[name]]] < 1e-15)


@pytest.mark.slow
def test_the_whole_has_the_driven_modes_of_the_part():
    """An eighth of a disk against the whole; and a disk poled along x, with one mirror plane, against quadratic
    hexahedra of gmsh.
    """
    part, whole = (disk(10 * MM, 2 * MM).domain_for(1e-5, 3e5, 1947.0, symmetric) for symmetric in (True, False))
    assert (part.copies, whole.copies) == (8, 1)
    found = []
    e_form = PIC181.constants.to_e_form()
    for domain in (part, whole):
        modes = solve_eigen(ElectroelasticModel(domain, PIC181.density), e_form, "short", 8, 226e3)
        found.append(modes.eigenvalues[modes.dominant_index(226e3)].real)
    assert found[0] == pytest.approx(found[1], rel=1e-5)
    askew = disk(6 * MM, 2 * MM, direction=(1.0, 0.0, 0.0))
    curved = askew.domain_for(1e-4, 4e5, 1947.0)
    plain = askew._domain(askew._quadratic(0.4 * MM, askew.mirrors), 2, askew.mirrors)
    assert curved.order > 2 and plain.order == 2 and curved.copies == plain.copies == 2
    models = (ElectroelasticModel(domain, PIC181.density) for domain in (curved, plain))
    values = [solve_eigen(model, e_form, "short", 9).eigenvalues for model in models]
    np.testing.assert_allclose(values[0].real[-4:], values[1].real[-4:], rtol=1e-3)


def test_curved_cells_know_their_maps():
    """The inverse map returns reference points, areas of facets are those of the rim, and vertices cannot be moved
    without the maps.
    """
    mesh = extruded(polar_plane(np.array([1.0, 1.5, 3.0]), np.linspace(0, np.pi, 3)), np.array([0.0, 0.5]))
    rng, cells = np.random.default_rng(1), np.array([0, 3])
    at = rng.uniform(0, 1, (3, 2, 5))
    np.testing.assert_allclose(mesh.mapping().invF(mesh.mapping().F(at, cells), cells), at, atol=1e-9)
    rim = mesh.facets_satisfying(lambda x: np.hypot(x[0], x[1]) > 1.6, boundaries_only=True)
    rim = rim[np.ptp(mesh.p[2, mesh.facets[:, rim]], axis=0) > 0]
    rim = rim[np.all(np.hypot(*mesh.p[:2])[mesh.facets[:, rim]] > 2.9, axis=0)]
    facets = skfem.FacetBasis(mesh, mesh.elem(), facets=rim, intorder=8)
    assert facets.dx.sum() == pytest.approx(1.5 * np.pi, rel=1e-9)
    radial = facets.global_coordinates()[:2] / 3.0
    np.testing.assert_allclose(np.asarray(facets.normals)[:2], np.asarray(radial), atol=1e-8)
    with pytest.raises(ValueError, match="without its maps"):
        mesh.scaled(2.0).mapping()


def test_which_shapes_are_round_bodies_and_too_large_meshes_are_refused():
    assert disk(10 * MM, 1 * MM).radii == (0.0, 5 * MM) and ring(10 * MM, 4 * MM, 1 * MM).radii == (2 * MM, 5 * MM)
    assert disk(10 * MM, 1 * MM, electrodes=Electrodes(margin=1 * MM)).radii is None
    assert disk(10 * MM, 1 * MM, elements="tetrahedron").radii is None
    with pytest.raises(InputError, match="lower the highest frequency"):
        disk(10 * MM, 1 * MM).domain_for(1e-6, 5e7, 1900.0)
