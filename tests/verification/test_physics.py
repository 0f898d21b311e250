"""Limits and balances: 1-D bars, VM175, energy, passivity, convergence, sensitivities."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import newton

from femu_piezo.forward.eigen import solve_eigen
from femu_piezo.forward.linear_solver import factorize
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.response import driven_state, full_impedance
from femu_piezo.geometry.shapes import Plate
from femu_piezo.inference.starts.thin_body import bar_permittivity, bar_start, k31_bar_admittance, k33_bar_impedance
from femu_piezo.material.constants import D_FORM, E_FORM
from femu_piezo.material.library import library_material
from tests.materials import FORWARD_LOSSY as LOSSY
from tests.materials import PZT5H as PZT


def test_slender_k31_bar_is_the_1d_formula():
    """Full anisotropy; width and thickness of 1/200 of the length leave an effect of lateral inertia of 3e-5."""
    plate = Plate(40e-3, 0.2e-3, 0.2e-3)
    model = ElectroelasticModel(plate.domain((14, 1, 1)), 7500.0)
    frequency = np.array([1e3, 20e3, 34e3, 39e3, 60e3, 104e3])
    z = full_impedance(model, LOSSY.to_e_form(), frequency)
    y = k31_bar_admittance(2 * np.pi * frequency, 40e-3, 0.2e-3, 0.2e-3, 7500.0, LOSSY.s11, LOSSY.d31, LOSSY.eps33T)
    poles = solve_eigen(model, LOSSY.to_e_form(), "short", 2, near_Hz=30e3)
    exact = (np.pi / 40e-3) ** 2 / (7500.0 * LOSSY.s11)
    assert poles.eigenvalues[poles.dominant_index(35e3)] == pytest.approx(exact, rel=1e-4)
    np.testing.assert_allclose(z[[0, 1, 4]] * y[[0, 1, 4]], 1.0, atol=1e-4)
    np.testing.assert_allclose(
        z * y, 1.0, atol=3e-3
    )  # near a resonance a relative error of 1e-5 in λ is one of 1e-5/tan φ in Z


def test_slender_k33_bar_is_the_1d_formula():
    plate = Plate(20e-3, 0.1e-3, 0.1e-3, "length")
    model = ElectroelasticModel(plate.domain((14, 1, 1)), 7500.0)
    frequency = np.array([1e3, 40e3, 64e3, 80e3, 120e3, 200e3])
    z = full_impedance(model, LOSSY.to_e_form(), frequency)
    exact = k33_bar_impedance(2 * np.pi * frequency, 20e-3, 1e-8, 7500.0, LOSSY.s33, LOSSY.d33, LOSSY.eps33T)
    k2 = LOSSY.d33**2 / (LOSSY.s33 * LOSSY.eps33T)
    zeros = solve_eigen(model, LOSSY.to_e_form(), "open", 2, near_Hz=70e3)
    assert zeros.eigenvalues[zeros.dominant_index(80e3)] == pytest.approx(
        (np.pi / 20e-3) ** 2 / (7500.0 * LOSSY.s33 * (1 - k2)), rel=1e-4
    )
    np.testing.assert_allclose(z / exact, 1.0, atol=1e-3)


@pytest.mark.parametrize("poling", ["thickness", "length"])
def test_bar_start_inverts_the_bar_formulas(poling):
    """From pole and zero of a lossless 1-D bar the start values are its constants."""
    length, density = 30e-3, 7600.0
    if poling == "thickness":
        pole = 1 / (2 * length * np.sqrt(density * PZT.s11.real))
        grid = np.linspace(1.0001 * pole, 1.2 * pole, 200001)
        y = k31_bar_admittance(2 * np.pi * grid, length, 1, 1, density, PZT.s11.real, PZT.d31.real, PZT.eps33T.real)
        zero = grid[np.argmin(np.abs(y))]
    else:
        k2 = PZT.d33.real**2 / (PZT.s33.real * PZT.eps33T.real)
        zero = 1 / (2 * length * np.sqrt(density * PZT.s33.real * (1 - k2)))
        grid = np.linspace(0.5 * zero, 0.9999 * zero, 200001)
        z = k33_bar_impedance(2 * np.pi * grid, length, 1, density, PZT.s33.real, PZT.d33.real, PZT.eps33T.real)
        pole = grid[np.argmin(np.abs(z))]
    for name, value in bar_start(poling, length, density, pole, zero, PZT.eps33T.real).items():
        assert value == pytest.approx(getattr(PZT, name).real, rel=2e-4, abs=0), name
    omega = 2 * np.pi * 0.8 * pole
    if poling == "thickness":
        y = k31_bar_admittance(omega, length, 1, 1, density, PZT.s11.real, PZT.d31.real, PZT.eps33T.real)
        gap, area = 1.0, length
    else:
        y = 1 / k33_bar_impedance(omega, length, 1, density, PZT.s33.real, PZT.d33.real, PZT.eps33T.real)
        gap, area = length, 1.0
    assert bar_permittivity(poling, pole, zero, 0.8 * pole, y, gap, area) == pytest.approx(PZT.eps33T.real, rel=1e-3)


@pytest.mark.parametrize("poling", ["thickness", "length"])
def test_bar_start_gives_the_losses_of_a_lossy_bar(poling):
    """From complex pole and zero of a lossy 1-D bar, where Y or Z is infinite and 0: its complex constants, exactly."""
    length, density = 30e-3, 7600.0
    s11, s33 = PZT.s11.real * (1 - 0.012j), PZT.s33.real * (1 - 0.014j)
    d31, d33, eps33T = PZT.d31.real * (1 - 0.02j), PZT.d33.real * (1 - 0.017j), PZT.eps33T.real * (1 - 0.025j)
    if poling == "thickness":
        truth = {"s11": s11, "d31": d31}
        pole = 1 / (2 * length * np.sqrt(density * s11))
        zero = newton(
            lambda f: k31_bar_admittance(2 * np.pi * f, length, 1, 1, density, s11, d31, eps33T), 1.05 * pole, tol=1e-9
        )
    else:
        truth = {"s33": s33, "d33": d33}
        zero = 1 / (2 * length * np.sqrt(density * s33 * (1 - d33**2 / (s33 * eps33T))))
        pole = newton(
            lambda f: k33_bar_impedance(2 * np.pi * f, length, 1, density, s33, d33, eps33T), 0.8 * zero, tol=1e-9
        )
    found = bar_start(poling, length, density, complex(pole), complex(zero), eps33T)
    for name, value in truth.items():
        assert found[name] == pytest.approx(value, rel=1e-9, abs=0), name


def test_vm175_cube():
    """Boucher, Lagier, Maerfeld (1981); converged values of two quadratic meshes within 0.02 %. c66 = 3.0e10 there is
    not (c11 − c12)/2, so it enters as a further term."""
    material = library_material("pzt-4-vm175")
    domain = Plate(0.02, 0.02, 0.02).domain((6, 6, 6))
    unit = np.zeros((4, 3, 4, 3))
    unit[0, 1, 0, 1] = unit[0, 1, 1, 0] = unit[1, 0, 0, 1] = unit[1, 0, 1, 0] = 1.0
    products = ElectroelasticModel(domain, material.density).products
    model = ElectroelasticModel(domain, material.density, extra_terms={"c66": products.stiffness(unit)})
    e_form = material.constants.to_e_form()
    extra = {"c66": 3.0e10 - e_form.c66.real}
    found = {}
    for circuit in ("short", "open"):
        modes = solve_eigen(model, e_form, circuit, 6, near_Hz=70e3, extra=extra)
        strong = modes.participation > 0.02
        found[circuit] = np.sqrt(modes.eigenvalues.real[strong]) / (2 * np.pi)
    np.testing.assert_allclose(found["short"], [65101, 88141], rtol=1e-3)
    np.testing.assert_allclose(found["open"], [79808, 93581], rtol=1e-3)
    np.testing.assert_allclose([*found["short"], *found["open"]], [65101, 88141, 79808, 93581], rtol=2e-4)


@pytest.fixture(scope="module")
def small():
    return ElectroelasticModel(Plate(8e-3, 5e-3, 1e-3).domain((4, 2, 1)), 7500.0)


def test_energy_balance(small):
    """Power at the terminals equals the power lost in the volume, ½ω Im(xᴴ A x) of the driven state."""
    e_form = LOSSY.to_e_form()
    for frequency in (50e3, 190e3, 260e3):
        omega = 2 * np.pi * frequency
        state = driven_state(small, e_form, frequency)
        lost = 0.5 * omega * np.imag(state.conj() @ (small.stiffness(e_form) @ state))
        z_part = state[-1] / (1j * omega)  # Z in scaled units: potential over the current jω of a unit charge
        terminal = 0.5 * np.real(z_part) * omega**2
        assert terminal == pytest.approx(lost, rel=1e-8, abs=0)
        assert terminal > 0


def test_a_passive_material_gives_a_passive_impedance(small):
    z = full_impedance(small, LOSSY.to_e_form(), np.linspace(1e3, 600e3, 60))
    assert LOSSY.physical_faults() == []
    assert np.all(z.real > 0)


def test_lossless_plate_has_a_reactance_that_rises_with_frequency(small):
    """Foster's theorem between resonances, as a check of signs."""
    z = full_impedance(small, PZT.to_e_form(), np.array([100e3, 101e3, 230e3, 231e3]))
    assert np.all(np.abs(z.real) < 1e-6 * np.abs(z.imag))
    assert z[1].imag > z[0].imag
    assert z[3].imag > z[2].imag
    assert z[0].imag < 0


def test_eigenvalues_converge_with_the_fourth_power():
    plate = Plate(8e-3, 5e-3, 1e-3)
    e_form = PZT.to_e_form()

    def value(n):
        model = ElectroelasticModel(plate.domain((4 * n, 3 * n, n)), 7500.0)
        modes = solve_eigen(model, e_form, "short", 4, near_Hz=170e3)
        return modes.eigenvalues[modes.dominant_index(180e3)].real

    coarse, middle, fine = value(1), value(2), value(3)
    rate = np.log((coarse - fine) / (middle - fine)) / np.log(2)
    assert coarse > middle > fine  # conforming elements converge from above
    assert rate > 3.0


@pytest.mark.parametrize("circuit", ["short", "open"])
def test_sensitivities_against_richardson_differences(small, circuit):
    """∂λ/∂θ in every e-form and every d-form constant, complex, to 1e-8 of |λ/θ|."""
    modes = solve_eigen(small, LOSSY.to_e_form(), circuit, 4, near_Hz=185e3)
    index = modes.dominant_index(190e3)
    value = modes.eigenvalues[index]
    exact_e = modes.sensitivity(small, index, E_FORM)
    exact_d = exact_e @ LOSSY.e_form_jacobian()

    def eigenvalue(e_form):
        found = solve_eigen(small, e_form, circuit, 4, near_Hz=185e3).eigenvalues
        return found[np.argmin(np.abs(found - value))]

    def richardson(function, size):
        def central(step):
            return (function(step) - function(-step)) / (2 * step)

        return (64 * central(size / 4) - 20 * central(size / 2) + central(size)) / 45

    e_form = LOSSY.to_e_form()
    for names, exact, make in (
        (E_FORM, exact_e, lambda name, h: type(e_form)(**(e_form.as_dict() | {name: getattr(e_form, name) + h}))),
        (D_FORM, exact_d, lambda name, h: LOSSY.with_values(**{name: getattr(LOSSY, name) + h}).to_e_form()),
    ):
        origin = e_form if names is E_FORM else LOSSY
        for name, slope in zip(names, exact, strict=True):
            size = abs(getattr(origin, name))
            estimate = richardson(lambda h, name=name, make=make: eigenvalue(make(name, h)), 0.01 * size)
            assert abs(estimate - slope) * size / abs(value) < 1e-8, name


@pytest.mark.parametrize("kind", ["real", "complex"])
def test_both_solver_backends_agree(small, kind):
    e_form = PZT.to_e_form() if kind == "real" else LOSSY.to_e_form()
    matrix = small.stiffness(e_form) - (2 * np.pi * 150e3) ** 2 * small.mass
    right = np.random.default_rng(1).standard_normal((small.size, 3))
    solutions = [factorize(matrix, backend).solve(right) for backend in (None, "scipy")]
    np.testing.assert_allclose(*solutions, rtol=1e-6, atol=1e-9 * np.abs(solutions[0]).max())
