"""The estimated error of a mesh against elements of an order two higher, for several bodies."""

from __future__ import annotations

import numpy as np
import pytest

from femu_piezo.forward.mesh_error import mesh_error
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import driven_modal, reduce_model
from femu_piezo.geometry import catalogue
from femu_piezo.geometry.shapes import Plate
from femu_piezo.geometry.slab import Electrodes
from femu_piezo.material.constants import D_FORM
from femu_piezo.material.library import library_material
from tests.variants import variants

CONSTANTS, DENSITY = library_material("pzt-5h").constants, 7500.0
#: Slowest shear wave, m/s.
SPEED = float(np.sqrt(CONSTANTS.to_e_form().c44.real / DENSITY))
HALF = catalogue.plate(24e-3, 6e-3, 1e-3, electrodes=Electrodes(span=(2e-3, 12e-3)))
BODIES = {
    "plate, to 300 kHz": (Plate(40e-3, 5e-3, 1e-3), 300e3, 3e-4),
    "bar poled along its length": (Plate(23e-3, 5e-3, 5e-3, "length"), 250e3, 1e-4),
    "square": (Plate(20e-3, 20e-3, 2e-3), 120e3, 1e-4),
    "disk": (catalogue.disk(20e-3, 1e-3), 300e3, 1e-5),
    "thick disk": (catalogue.disk(10e-3, 2e-3), 800e3, 1e-4),
    "ring": (catalogue.ring(20e-3, 8e-3, 1e-3), 300e3, 1e-4),
    "trapezoid": (catalogue.trapezoid(30e-3, 8e-3, 4e-3, 1e-3), 150e3, 1e-3),
    "shear plate": (Plate(6e-3, 4e-3, 2e-3, direction=(1, 0, 0)), 450e3, 1e-4),
    "tilted plate": (Plate(10e-3, 5e-3, 1e-3, direction=(1, 0, 1)), 100e3, 1e-3),
}


@pytest.mark.parametrize(
    "name",
    variants(BODIES, slow=["plate, to 300 kHz", "bar poled along its length", "square", "shear plate", "tilted plate"]),
)
def test_no_eigenvalue_is_farther_off_than_stated(name):
    """The error is at most 1.2 times the stated one, and the largest stated error at most 20 times the largest true
    one.
    """
    body, band_Hz, accuracy = BODIES[name]
    model = ElectroelasticModel(body.domain_for(accuracy, band_Hz, SPEED), DENSITY)
    stated = mesh_error(model, CONSTANTS, band_Hz)
    better = ElectroelasticModel(model.domain, DENSITY, order=model.order + 2)
    squares = driven_modal(better, CONSTANTS, 1.05 * band_Hz).eigenvalues.real
    exact = np.sqrt(squares[squares > 0]) / (2 * np.pi)
    true_error = np.array([2 * np.abs(f / exact - 1).min() for f in stated.frequency])
    assert np.all(true_error < 1.2 * stated.error + 1e-10), true_error / stated.error
    assert stated.error.max() < 20 * max(true_error.max(), 1e-8)  # the estimate is not arbitrarily large


@pytest.mark.parametrize("name", ["disk", "half an electrode", pytest.param("trapezoid", marks=pytest.mark.slow)])
def test_the_error_of_the_curve_is_as_stated(name):
    """log Z of a lossy body, against elements an order two higher, in each of 20 parts of the band: at most 1.2 times
    ½ ε |∂log Z/∂log f| + ω |Z| δC in rms, and over the whole band at least a twentieth of that. Half an electrode also
    drives modes of bending, hardly, whose errors are ten times as large.
    """
    body, band_Hz, accuracy = {**BODIES, "half an electrode": (HALF, 180e3, 1e-3)}[name]
    model = ElectroelasticModel(body.domain_for(accuracy, band_Hz, SPEED), DENSITY)
    stated = mesh_error(model, CONSTANTS, band_Hz)
    lossy = CONSTANTS.with_values(**{name: getattr(CONSTANTS, name) * (1 - 0.01j) for name in D_FORM})
    frequency = np.linspace(0.02, 0.99, 2000) * band_Hz

    def curve(one: ElectroelasticModel) -> np.ndarray:
        reduced = reduce_model(one, [CONSTANTS, lossy], band_Hz, accuracy=1e-9)
        return np.log(reduced.impedance(lossy.to_e_form(), frequency))

    rough, exact = curve(model), curve(ElectroelasticModel(model.domain, DENSITY, order=model.order + 2))
    slope, charged = np.gradient(exact, np.log(frequency)), 2 * np.pi * frequency * np.exp(exact) * stated.capacitance
    error, allowed = np.abs(rough - exact), 0.5 * stated.at(frequency) * np.abs(slope) + np.abs(charged)
    parts = zip(np.array_split(error, 20), np.array_split(allowed, 20), strict=True)
    assert all(np.linalg.norm(one) < 1.2 * np.linalg.norm(most) + 1e-8 for one, most in parts)
    assert np.linalg.norm(allowed) < 20 * np.linalg.norm(error)
    if name == "half an electrode":
        strong = stated.charge > 0.1 * stated.charge.max()
        assert np.any(stated.error > 10 * stated.error[strong].min())


def test_quadratic_elements_have_no_estimate():
    model = ElectroelasticModel(Plate(20e-3, 5e-3, 1e-3).domain((8, 2, 1), order=2), DENSITY)
    assert mesh_error(model, CONSTANTS, 100e3) is None
