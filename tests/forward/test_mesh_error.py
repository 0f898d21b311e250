"""The estimated error of a mesh against elements of an order two higher, for several bodies."""

from __future__ import annotations

import numpy as np
import pytest

from femu_piezo.forward.mesh_error import MeshError, mesh_error
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import driven_modal, reduce_model
from femu_piezo.geometry import catalogue
from femu_piezo.geometry.shapes import Plate
from femu_piezo.geometry.slab import Electrodes
from femu_piezo.material.constants import D_FORM
from femu_piezo.material.library import library_material
from femu_piezo.measurement.sweeps import SweepData
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
    ½ ε |1 + ∂log Z/∂log f| + ω |Z| δC in rms, and over the whole band at least a twentieth of that. Half an electrode
    also drives modes of bending, hardly, whose errors are ten times as large.
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
    slope, charged = (
        1 + np.gradient(exact, np.log(frequency)),
        2 * np.pi * frequency * np.exp(exact) * stated.capacitance,
    )
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


def test_a_weak_mode_counts_near_itself_alone():
    """A strong mode of a small error beside a weak one of a large error: the weak one's counts within its width, and a
    third of the way to it that of the strong one. A single mode has its error everywhere, at 0 Hz too.
    """
    both = MeshError(np.array([100e3, 130e3]), np.array([1e-6, 1e-3]), np.array([1.0, 1e-3]), 0.0)
    near, between, at = both.at(np.array([100e3, 110e3, 130e3]))
    assert near == pytest.approx(1e-6, rel=1e-2) and between < 2e-6 and at > 4e-4
    one = MeshError(np.array([50e3]), np.array([2e-5]), np.array([3.0]), 0.0)
    np.testing.assert_allclose(one.at(np.array([0.0, 49e3, 50e3, 1e6])), 2e-5, rtol=1e-12)


def test_errors_of_the_mesh_are_common_to_the_sweeps_of_a_body():
    """Of a capacitor in three sweeps, two of one body: the change of log Z by δC, one column for each body; a shift of
    C along frequency changes nothing.
    """
    frequency, capacitance, change = np.geomspace(1e3, 1e5, 60), 1e-9, 1e-13
    z = 1 / (2j * np.pi * frequency * capacitance)
    each = (frequency, z, np.full(60, 1e-3), np.full(60, 1e-5), np.full(60, change))
    f, impedance, noise, error, charge = (np.tile(one, 3) for one in each)
    data = SweepData(
        f, impedance, noise, True, (60, 60, 60), bodies=(0, 0, 1), mesh_error=error, mesh_capacitance=charge
    )
    columns = data.mesh_misses(np.full(180, -1.0 + 0j))
    acting = columns[:, np.any(columns != 0, axis=0)]
    exact = np.log(1 / (2j * np.pi * frequency * (capacitance + change)) / z).real * np.sqrt(2) / 1e-3
    assert acting.shape == (360, 2)
    np.testing.assert_allclose(acting[:120, 0], np.tile(exact, 2), rtol=1e-3)
    np.testing.assert_allclose(acting[120:180, 1], exact, rtol=1e-3)
    assert not np.any(acting[120:180, 0]) and not np.any(acting[:120, 1]) and np.max(np.abs(acting[180:])) < 1e-9
