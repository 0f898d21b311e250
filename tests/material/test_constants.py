"""Conversions of constants, their derivatives, and physical checks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from femu_piezo.errors import InputError
from femu_piezo.material.constants import D_FORM, EPS0, ElasticForm, PiezoConstants
from femu_piezo.material.library import library_material, library_names
from femu_piezo.material.voigt import (
    axes_with_poling,
    piezoelectric_matrix,
    piezoelectric_tensor,
    stiffness_matrix,
    stiffness_tensor,
)

PZT = library_material("pzt-5h").constants

factors = st.lists(st.floats(0.9, 1.1), min_size=10, max_size=10)
tangents = st.lists(st.floats(0.0, 0.1), min_size=10, max_size=10)


def lossy(scale, tan) -> PiezoConstants:
    return PiezoConstants.from_vector(PZT.vector() * np.array(scale) * (1 - 1j * np.array(tan)))


@given(factors, tangents)
@settings(max_examples=50, deadline=None)
def test_round_trip_is_exact_for_complex_constants(scale, tan):
    constants = lossy(scale, tan)
    back = constants.to_e_form().to_d_form()
    np.testing.assert_allclose(back.vector(), constants.vector(), rtol=1e-10, atol=0)


def test_e_form_satisfies_the_constitutive_law():
    """T = c S − eᵗE and D = e S + ε^S E must follow from S = s T + dᵗE, D = d T + ε^T E for any T, E."""
    constants = lossy(np.linspace(0.92, 1.08, 10), np.linspace(0.005, 0.03, 10))
    e_form = constants.to_e_form()
    rng = np.random.default_rng(3)
    stress, field = rng.standard_normal(6) * 1e6, rng.standard_normal(3) * 1e4
    strain = constants.compliance() @ stress + constants.piezoelectric().T @ field
    displacement = constants.piezoelectric() @ stress + constants.permittivity() @ field
    np.testing.assert_allclose(e_form.stiffness() @ strain - e_form.piezoelectric().T @ field, stress, rtol=1e-9)
    np.testing.assert_allclose(e_form.piezoelectric() @ strain + e_form.permittivity() @ field, displacement, rtol=1e-9)


def test_e_form_of_pzt5h_matches_the_data_sheet():
    """Morgan TP-226 prints c and e of PZT-5H as well as s and d: an independent check of the conversion."""
    e_form = PZT.to_e_form()
    assert e_form.c33.real == pytest.approx(117e9, rel=0.01)
    assert e_form.c11.real == pytest.approx(126e9, rel=0.02)
    assert e_form.e31.real == pytest.approx(-6.5, rel=0.02)
    assert e_form.e33.real == pytest.approx(23.3, rel=0.01)
    assert e_form.e15.real == pytest.approx(17.0, rel=0.01)
    # ε33S is the difference of 3400 and 1930; the three digits of d and c fix the latter to 2 %.
    assert (PZT.eps33T - e_form.eps33S).real / EPS0 == pytest.approx(3400 - 1470, rel=0.02)


def test_jacobian_against_complex_step():
    """A complex step has no cancellation: ∂f/∂x = Im f(x + ih)/h for the lossless set."""
    jacobian = PZT.e_form_jacobian().real
    for column, name in enumerate(D_FORM):
        step = 1e-30 * abs(getattr(PZT, name))
        moved = PZT.with_values(**{name: getattr(PZT, name) + 1j * step}).to_e_form().vector().imag / step
        np.testing.assert_allclose(jacobian[:, column], moved, rtol=1e-9, atol=1e-12 * np.abs(moved).max())


def test_jacobian_is_holomorphic():
    constants = lossy(np.ones(10), np.full(10, 0.02))
    jacobian = constants.e_form_jacobian()
    for column, name in enumerate(D_FORM):
        size = abs(getattr(constants, name))
        for direction in (1.0, 1j):
            step = 1e-5 * size * direction
            ahead = constants.with_values(**{name: getattr(constants, name) + step}).to_e_form().vector()
            behind = constants.with_values(**{name: getattr(constants, name) - step}).to_e_form().vector()
            slope = (ahead - behind) / (2 * step)
            np.testing.assert_allclose(jacobian[:, column], slope, rtol=1e-6, atol=1e-7 * np.abs(slope).max())


@pytest.mark.parametrize("name", library_names())
def test_library_materials_are_physical(name):
    material = library_material(name)
    assert material.constants.physical_faults() == []
    assert 7000 < material.density < 8000
    assert material.source


def test_unknown_library_name_names_the_nearest():
    with pytest.raises(InputError, match="pzt-5h"):
        library_material("pzt5h")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"s11": -16e-12}, "s11"),
        ({"s12": -17e-12}, "not positive definite"),
        ({"d33": 900e-12}, "not positive definite"),
        ({"d15": 1500e-12}, "d15"),
        ({"s33": 20.7e-12 * (1 + 0.01j)}, "create energy"),
        (
            {name: getattr(PZT, name).real * (1 - 0.02j) for name in ("s12", "s33", "d33")},
            "s11, s13, d31, eps33T have no",
        ),
    ],
)
def test_unphysical_constants_are_named(change, words):
    with pytest.raises(InputError, match=words):
        PZT.with_values(**change).check()


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        ({"s11": -16e-12}, "sign"),
        ({"d33": 900e-12}, "unstable"),
        ({"s33": 20.7e-12 * (1 + 0.01j)}, "active"),
    ],
)
def test_faults_have_a_kind(change, kind):
    """Constants that are only active have no fault where losses are not checked."""
    constants = PZT.with_values(**change)
    assert {fault.kind for fault in constants.physical_faults()} == {kind}
    assert bool(constants.physical_faults(passive=False)) == (kind != "active")


def test_a_missing_loss_tangent_is_blamed_only_where_it_would_help():
    """Not a constant that is zero, and not one whose own tangent leaves the material active, as that of d33 is too
    large.
    """
    lossy = {name: getattr(PZT, name).real * (1 - 0.015j) for name in D_FORM}
    without = PZT.with_values(**lossy | {"s11": lossy["s11"].real})
    assert "s11 have no loss tangent" in str(without.physical_faults()[0])
    too_large = lossy | {"d33": lossy["d33"].real * (1 - 0.05j)}
    for also in ({"d31": 0.0}, {"s12": lossy["s12"].real}):
        (fault,) = (one for one in PZT.with_values(**too_large | also).physical_faults() if one.kind == "active")
        assert "that of d is too large" in str(fault) and "have no" not in str(fault)


def test_passivity_is_hollands_condition():
    """Im s11 Im ε33T ≥ (Im d31)² with all other constants lossless: violated just beyond equality."""
    tan = 0.02
    s11, eps = PZT.s11 * (1 - 1j * tan), PZT.eps33T * (1 - 1j * tan)
    # Im s12 must follow s11 so that only the pair (s11, d31, ε33T) is at its limit.
    limit = np.sqrt(s11.imag * eps.imag)
    base = PZT.with_values(s11=s11, eps33T=eps)
    assert base.with_values(d31=PZT.d31 + 0.70j * limit).physical_faults() == []
    assert base.with_values(d31=PZT.d31 + 0.72j * limit).physical_faults() != []


def test_tangent_convention():
    """A positive tangent is a negative imaginary part for positive d-form constants."""
    constants = PiezoConstants.from_real({name: value.real for name, value in PZT.as_dict().items()}, {"d31": 0.013})
    assert constants.d31.imag == pytest.approx(-0.013 * constants.d31.real, rel=1e-6, abs=0)
    assert constants.tangent("d31") == pytest.approx(0.013)
    assert constants.tangent("s11") == 0


@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3).filter(lambda v: np.linalg.norm(v) > 0.1))
@settings(max_examples=30, deadline=None)
def test_voigt_round_trip_and_rotation(direction):
    e_form = PZT.to_e_form()
    np.testing.assert_array_equal(stiffness_matrix(stiffness_tensor(e_form.stiffness())), e_form.stiffness())
    np.testing.assert_array_equal(
        piezoelectric_matrix(piezoelectric_tensor(e_form.piezoelectric())), e_form.piezoelectric()
    )
    rotation = axes_with_poling(np.array(direction))
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(rotation @ direction, [0, 0, np.linalg.norm(direction)], atol=1e-12)


def test_engineering_shear():
    """A pure shear S12 = 1e-6 stores ½ c66 (2 S12)²: tensor and Voigt forms agree."""
    e_form = PZT.to_e_form()
    strain = np.zeros((3, 3))
    strain[0, 1] = strain[1, 0] = 1e-6
    tensor = stiffness_tensor(e_form.stiffness())
    energy = 0.5 * np.einsum("ij,ijkl,kl", strain, tensor, strain)
    assert energy == pytest.approx(0.5 * e_form.c66 * (2e-6) ** 2)


def test_e_form_names_ten_constants():
    assert len(ElasticForm.names()) == len(D_FORM) == 10
