"""The elements chosen for a plate keep the accuracy that is asked for, on bodies of several proportions."""

from __future__ import annotations

import numpy as np
import pytest

from femu_piezo.errors import InputError
from femu_piezo.forward.eigen import solve_eigen
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import driven_modal
from femu_piezo.geometry.shape import fits
from femu_piezo.geometry.shapes import LEAST_ALONG, Plate
from femu_piezo.material.library import LibraryMaterial, library_material
from tests.variants import variants

BODIES = {
    "long plate": (Plate(40e-3, 5e-3, 1e-3), "tj52-hd", 200e3),
    "short plate": (Plate(12e-3, 6.5e-3, 1.5e-3), "pzt-5h", 225e3),
    "square plate": (Plate(10e-3, 9e-3, 1e-3), "pzt-4", 250e3),
    "block": (Plate(8e-3, 4e-3, 3e-3), "tj52-hd", 300e3),
    "thick bar": (Plate(23e-3, 5e-3, 5e-3, "length"), "pzt-5h", 170e3),
    "cube": (Plate(6e-3, 6e-3, 6e-3), "pzt-4", 280e3),
}


def values(plate: Plate, elements: tuple, material: LibraryMaterial, band: float) -> np.ndarray:
    """Eigenvalues of all modes of the driven class below the end of the band, short-circuited then open."""
    order, divisions = elements
    model = ElectroelasticModel(plate.domain(divisions, order=order), material.density or 7900.0)
    found = []
    for circuit in ("short", "open"):
        modes = solve_eigen(model, material.constants.lossless().to_e_form(), circuit, 9, near_Hz=0.4 * band)
        found.append(np.sort(modes.eigenvalues.real))
        assert found[-1].max() > (2 * np.pi * band) ** 2
    return np.concatenate([part[part < (2 * np.pi * band) ** 2] for part in found])


@pytest.mark.parametrize("body", variants(BODIES, slow=["long plate", "square plate", "block", "thick bar", "cube"]))
def test_the_accuracy_asked_for_is_kept(body):
    """Every pole and zero, against the mesh for 1e-5 with elements of one order more."""
    plate, name, band = BODIES[body]
    material = library_material(name)
    shear = 1 / np.sqrt((material.density or 7900.0) * max(material.constants.s44.real, material.constants.s66.real))
    order, divisions = plate.elements(1e-5, band, shear)
    exact = values(plate, (order + 1, divisions), material, band)
    for accuracy in (1e-3, 1e-4):
        found = values(plate, plate.elements(accuracy, band, shear), material, band)
        assert found.size == exact.size >= 2
        assert np.max(np.abs(found / exact - 1)) < accuracy


@pytest.mark.parametrize("direction", [(1, 0, 1), (0.1, 0, 1)])
def test_waves_of_bending_are_followed_where_the_poling_is_tilted(direction):
    """Driven modes: without the waves of bending their error was 5e-3 at 1e-3, and with elements of third order 1.6e-3
    at 5e-4."""
    plate, material, band = Plate(6e-3, 4e-3, 1e-3, direction=direction), library_material("pzt-5h"), 300e3
    shear = 1 / np.sqrt(material.density * max(material.constants.s44.real, material.constants.s66.real))

    def driven(accuracy: float) -> np.ndarray:
        model = ElectroelasticModel(plate.domain_for(accuracy, band, shear), material.density)
        modal = driven_modal(model, material.constants.lossless(), 1.05 * band)
        squares = modal.eigenvalues.real
        coupling = modal.charges**2 / np.abs(squares * modal.clamped_capacitance)
        # modes that symmetry keeps from being driven are in the basis by rounding, with a coupling below 1e-20
        return np.sort(squares[(coupling > 1e-7) & (squares < (2 * np.pi * band) ** 2)])

    exact = driven(2e-5)
    assert exact.size > 2
    for accuracy in (1e-3, 5e-4):
        assert np.max(np.abs(driven(accuracy) / exact - 1)) < 1.3 * accuracy


def test_a_few_elements_of_high_order_are_enough():
    """A plate 40 × 5 × 1 mm to 300 kHz, for which quadratic elements need 119 100 unknowns."""
    order, divisions = Plate(40e-3, 5e-3, 1e-3).elements(1e-5, 300e3, 1706.0)
    assert order > 4 and np.prod(divisions) <= 10
    assert Plate(40e-3, 5e-3, 1e-3).domain_for(1e-5, 300e3, 1706.0).order == order


def test_a_given_order_is_kept():
    order, divisions = Plate(40e-3, 5e-3, 1e-3).elements(1e-4, 300e3, 1706.0, order=2)
    assert order == 2 and np.prod(divisions) > 100


def test_too_large_a_mesh_is_refused():
    with pytest.raises(InputError, match="lower the highest frequency"):
        Plate(40e-3, 5e-3, 1e-3).elements(1e-6, 3e6, 1706.0)


def test_a_short_plate_takes_an_order_whose_mesh_can_be_solved():
    """A rod 5 × 5 × 15 mm poled along 15 mm has spare elements along x, with which order 7 is too large."""
    order, divisions = Plate(5e-3, 5e-3, 15e-3).elements(1e-6, 300e3, 1750.0)
    assert divisions[0] == LEAST_ALONG // 2
    assert fits(4 * np.prod(order * np.array(divisions) + 1), 16 * np.prod(divisions) * (order + 1) ** 6)
