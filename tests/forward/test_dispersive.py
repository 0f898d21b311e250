"""Frequency-dependent coefficients: against full solves at every frequency, and against the closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from femu_piezo.forward.dispersive import dispersive_response
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import reduce_model
from femu_piezo.forward.response import full_impedance
from femu_piezo.geometry.shapes import Plate
from femu_piezo.material.constants import ElasticForm, PiezoConstants
from femu_piezo.material.library import library_material

PZT = library_material("pzt-5h").constants.lossless()
LOSSY = PiezoConstants.from_vector(PZT.vector() * (1 - 0.01j * np.linspace(1, 2, 10)))
BAND = 200e3
MASS = 3e-6


@pytest.fixture(scope="module")
def loaded():
    """Plate with a point mass on the middle of its end, trained over −ω²m and the loss directions."""
    domain = Plate(20e-3, 5e-3, 1e-3).domain((7, 2, 1))
    bare = ElectroelasticModel(domain, 7500.0)
    nodes = bare.basis.N
    end = int(np.argmax(bare.basis.doflocs[0] - 1e-3 * bare.basis.doflocs[1:].sum(axis=0)))
    diagonal = np.zeros(4 * nodes)
    diagonal[end] = 1.0
    model = ElectroelasticModel(domain, 7500.0, extra_terms={"mass": sp.diags(diagonal)})
    top = -MASS * (2 * np.pi * BAND) ** 2
    return model, reduce_model(model, [(LOSSY, {"mass": share * top}) for share in (0, 0.3, 1)], BAND, accuracy=1e-6)


def _coefficients(omega):
    """Stiffness that hardens and loses with log ω, and the inertia of the mass."""
    factor = 1 + 0.01 * np.log(omega / 1e5) * (1 + 0.3j)
    elastic = LOSSY.to_e_form().vector()[None, :] * np.where(np.arange(10) < 5, factor[:, None], 1.0)
    return np.column_stack([elastic, -MASS * omega**2])


def test_against_full_solves(loaded):
    model, reduced = loaded
    omega = 2 * np.pi * np.linspace(20e3, BAND, 901)
    coefficients = _coefficients(omega)
    z = dispersive_response(reduced, _coefficients, omega).impedance
    sharp = [np.argmax(np.abs(z)), np.argmin(np.abs(z)), *np.argsort(np.abs(np.diff(np.log(z))))[-4:]]
    for index in [*sharp, 0, 300, 900]:
        c = coefficients[index]
        full = full_impedance(model, ElasticForm.from_vector(c[:10]), [omega[index] / (2 * np.pi)], {"mass": c[10]})
        assert abs(z[index] / full[0] - 1) < 1e-5  # elastic constants leave the trained range by 3 %
    exact = dispersive_response(reduced, _coefficients, omega, accuracy=0).impedance
    np.testing.assert_allclose(z, exact, rtol=1e-6)


def test_constant_coefficients_are_the_closed_form(loaded):
    _, reduced = loaded
    omega = 2 * np.pi * np.linspace(100.0, BAND, 301)
    values = reduced.coefficients(LOSSY.to_e_form())
    closed = reduced.impedance(LOSSY.to_e_form(), omega / (2 * np.pi))
    constant = dispersive_response(reduced, lambda w: np.tile(values, (w.size, 1)), omega)
    np.testing.assert_allclose(constant.impedance, closed, rtol=1e-7)
    exact = reduced.modal(LOSSY.to_e_form()).admittance_jacobian(omega) * np.where(values == 0, 1.0, values)
    found = constant.admittance_jacobian() * np.where(values == 0, 1.0, values)
    np.testing.assert_allclose(found, exact, atol=1e-6 * np.abs(exact).max())


def test_rough_coefficients_are_solved_one_by_one(loaded):
    _, reduced = loaded
    omega = 2 * np.pi * np.linspace(20e3, BAND, 901)

    def rough(w):
        coefficients = _coefficients(w)
        coefficients[:, 5:8] *= np.where(np.sin(w) > 0, 1.0, 1.3)[:, None]
        return coefficients

    exact = dispersive_response(reduced, rough, omega, accuracy=0).impedance
    np.testing.assert_array_equal(dispersive_response(reduced, rough, omega).impedance, exact)


def test_jacobian_is_the_derivative(loaded):
    """A relative change of one coefficient function, by Richardson differences of the exact response."""
    _, reduced = loaded
    omega = 2 * np.pi * np.linspace(20e3, BAND, 61)
    response = dispersive_response(reduced, _coefficients, omega)
    jacobian = response.admittance_jacobian()
    for term in (0, 3, 5, 9, 10):

        def admittance(step, term=term):
            factors = 1 + step * (np.arange(11) == term)
            return dispersive_response(reduced, lambda w: _coefficients(w) * factors, omega, accuracy=0).admittance

        coarse, fine = ((admittance(h) - admittance(-h)) / (2 * h) for h in (2e-4, 1e-4))
        slope, exact = (4 * fine - coarse) / 3, jacobian[:, term] * _coefficients(omega)[:, term]
        size = np.maximum(np.abs(slope), np.abs(response.admittance))
        assert np.all(np.abs(exact - slope) < 1e-6 * size)
