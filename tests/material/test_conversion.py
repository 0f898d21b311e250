"""Constants for other programs: orders, poling axes, loss factors, checked by physics that is independent of
notation.
"""

from __future__ import annotations

import numpy as np
import pytest

from femu_piezo.errors import InputError
from femu_piezo.material.constants import EPS0
from femu_piezo.material.conversion import (
    ORDERS,
    StressCharge,
    from_ansys,
    from_stress_charge,
    reorder,
    stress_charge,
    to_ansys,
)
from tests.materials import LOSSY as PZT


def test_where_the_constants_stand_in_ansys_order():
    """Order x, y, z, xy, yz, xz: c66 is fourth, c44 fifth and sixth; e is transposed, with e15 = e_x,xz in row xz,
    column x.
    """
    c, e, eps = to_ansys(PZT)
    form = PZT.to_e_form()
    assert c[3, 3] == pytest.approx(form.c66) and c[4, 4] == pytest.approx(form.c44)
    assert c[5, 5] == pytest.approx(form.c44)
    assert e.shape == (6, 3)
    assert e[5, 0] == pytest.approx(form.e15) and e[4, 1] == pytest.approx(form.e15)
    assert e[0, 2] == pytest.approx(form.e31) and e[2, 2] == pytest.approx(form.e33)
    assert np.count_nonzero(np.abs(e) > 1e-9) == 5
    assert eps[2, 2] * EPS0 == pytest.approx(form.eps33S, rel=1e-6, abs=0)


def test_poled_along_y_as_in_the_published_example():
    """Poling along y with x unchanged: e31 is at (x, y), e33 at (y, y), as in the ANSYS sample of
    tutorials/notation.md.
    """
    _, e, eps = to_ansys(PZT, poling=(0.0, 1.0, 0.0))
    form = PZT.to_e_form()
    assert e[0, 1] == pytest.approx(form.e31) and e[2, 1] == pytest.approx(form.e31)
    assert e[1, 1] == pytest.approx(form.e33)
    assert eps[1, 1] * EPS0 == pytest.approx(form.eps33S, rel=1e-6, abs=0)


@pytest.mark.parametrize("poling", [(0, 0, 1), (0, 1, 0), (1, 0, 0), (0.3, -0.5, 0.8)])
@pytest.mark.parametrize("order", list(ORDERS))
def test_there_and_back(poling, order):
    material = stress_charge(PZT, order, poling)
    np.testing.assert_allclose(from_stress_charge(material, poling).vector(), PZT.vector(), rtol=1e-9)
    np.testing.assert_allclose(from_ansys(*to_ansys(PZT, poling), poling).vector(), PZT.vector(), rtol=1e-9)


@pytest.mark.parametrize("order", list(ORDERS))
def test_energy_does_not_depend_on_notation(order):
    """½ Sᵗ c S − E·e S of one strain and field, components written out in each order."""
    rng = np.random.default_rng(3)
    strain, field = rng.standard_normal(6), rng.standard_normal(3)
    names = {"ieee": "xx yy zz yz xz xy", "comsol": "xx yy zz yz xz xy", "ansys": "xx yy zz xy yz xz"}
    names["abaqus"] = "xx yy zz xy xz yz"
    value = dict(zip(("xx", "yy", "zz", "yz", "xz", "xy"), strain, strict=True))
    there = np.array([value[name] for name in names[order].split()])
    form, material = PZT.to_e_form(), stress_charge(PZT, order)
    exact = strain @ form.stiffness() @ strain / 2 - field @ form.piezoelectric() @ strain
    assert there @ material.stiffness @ there / 2 - field @ material.piezoelectric @ there == pytest.approx(exact)


def test_christoffel_speeds_do_not_depend_on_the_poling_axis():
    """Shear waves along the poling have the speed sqrt(c44/ρ), whatever the axis is called."""
    for axis in np.eye(3):
        material = stress_charge(PZT, "ieee", tuple(axis))
        first = int(np.flatnonzero(axis)[0])
        shear = {0: (4, 5), 1: (3, 5), 2: (3, 4)}[first]
        for index in shear:
            assert material.stiffness[index, index] == pytest.approx(PZT.to_e_form().c44)


def test_loss_factors_are_positive_and_rebuild_the_matrices():
    material = stress_charge(PZT)
    eta = material.loss_factors
    diagonal = np.diag(eta["stiffness"])
    assert np.all(diagonal > 0) and np.all(np.diag(eta["permittivity"]) > 0)
    np.testing.assert_allclose(material.stiffness.real * (1 + 1j * eta["stiffness"]), material.stiffness, atol=1e-3)
    np.testing.assert_allclose(
        material.piezoelectric.real * (1 - 1j * eta["piezoelectric"]), material.piezoelectric, atol=1e-12
    )
    shear = -PZT.s44.imag / PZT.s44.real
    assert eta["stiffness"][3, 3] == pytest.approx(shear, rel=1e-3)  # 1/(1 − j tan) has loss factor tan


def test_wrong_order_or_axis_is_refused():
    wrong = StressCharge(
        *[getattr(stress_charge(PZT), n) for n in ("stiffness", "piezoelectric", "permittivity")], "ansys"
    )
    with pytest.raises(InputError, match="order of components and the poling axis"):
        from_stress_charge(wrong)
    with pytest.raises(InputError, match="poled along"):
        from_stress_charge(stress_charge(PZT, "ieee", (1.0, 0.0, 0.0)))
    with pytest.raises(InputError, match="not known"):
        reorder(np.eye(6), "ieee", "nastran")
    with pytest.raises(InputError, match="six"):
        reorder(np.eye(3), "ieee", "ansys")
