"""Equations 30-40 and 66-74 against the exact conversion, and their inverses."""

from __future__ import annotations

import numpy as np
import pytest

from femu_piezo.material.constants import EPS0
from femu_piezo.material.simplified import (
    SimplifiedK31,
    SimplifiedK33,
    compliance_from_stiffness,
    stiffness_from_compliance,
    stiffness_ratio,
)

K33 = SimplifiedK33(18.846e-12 * (1 - 0.0213j), 545.46e-12 * (1 - 0.022j), 3291 * EPS0 * (1 - 0.0111j), -4.5e-12)


def test_k31_closed_forms_agree_with_the_exact_conversion(target):
    e_form = target.full().to_e_form()
    beta = 2 * target.alpha / (1 + target.alpha)
    expected = {
        "c11": target.c11,
        "c12": target.alpha * target.c11,
        "c13": target.alpha * target.c11,
        "c33": target.c11,
        "c44": (1 - target.alpha) * target.c11 / 2,
        "e31": target.e31,
        "e33": beta * target.e31,
        "e15": 0,
        "eps11S": 0,
        "eps33S": target.eps33S,
    }
    for name, value in expected.items():
        assert getattr(e_form, name) == pytest.approx(value, rel=1e-12, abs=1e-30), name
    assert e_form.e33 == pytest.approx(2 * target.d31 * target.c11 * target.alpha)


def test_k33_closed_forms_agree_with_the_exact_conversion():
    e_form = K33.full().to_e_form()
    assert e_form.c33 == pytest.approx(K33.c33, rel=1e-12)
    assert e_form.c13 == pytest.approx(K33.alpha * K33.c33, rel=1e-12)
    assert e_form.e33 == pytest.approx(K33.e33, rel=1e-12)
    assert e_form.e31 == pytest.approx(K33.alpha * K33.e33, rel=1e-12)
    assert e_form.eps33S == pytest.approx(K33.eps33S, rel=1e-12, abs=0)
    assert e_form.e15 == 0


@pytest.mark.parametrize("s", [14.4e-12, 15.84e-12 * (1 - 0.016j), 22e-12 * (1 - 0.1j)])
def test_eq_34_inverts_eq_30(s):
    c = stiffness_from_compliance(s, -4.5e-12)
    assert compliance_from_stiffness(c, -4.5e-12) == pytest.approx(s, rel=1e-12, abs=0)
    assert stiffness_ratio(s, -4.5e-12) * c == pytest.approx(np.linalg.inv(_isotropic(s, -4.5e-12))[0, 1], rel=1e-12)


def _isotropic(s, cross):
    return np.array([[s, cross, cross], [cross, s, cross], [cross, cross, s]])


def test_inverse_of_both_simplifications(target):
    back = SimplifiedK31.from_stiffness(target.c11, target.gamma, target.eps33T, target.s12)
    assert back.s11 == pytest.approx(target.s11, rel=1e-12, abs=0)
    assert back.d31 == pytest.approx(target.d31, rel=1e-12, abs=0)
    back = SimplifiedK33.from_stiffness(K33.c33, K33.kappa, K33.eps33T, K33.s13)
    assert back.s33 == pytest.approx(K33.s33, rel=1e-12, abs=0)
    assert back.d33 == pytest.approx(K33.d33, rel=1e-12, abs=0)
