"""Scattered operators against the triple product with the prolongation."""

from __future__ import annotations

import numpy as np
import pytest

from femu_piezo.forward.gradient_products import extended_tensor
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.shapes import Plate
from femu_piezo.material.constants import E_FORM, ElasticForm
from femu_piezo.material.library import library_material

E_CONSTANTS = library_material("pzt-5h").constants.to_e_form()


@pytest.mark.parametrize("poling", ["thickness", "length"])
@pytest.mark.parametrize("axes", [(0, 1, 2), (1,), ()])
@pytest.mark.parametrize("order", [1, 2])
def test_equal_to_the_triple_product(poling, axes, order):
    model = ElectroelasticModel(Plate(8e-3, 5e-3, 1e-3, poling).domain((3, 2, 2), axes), 7500.0, order)
    lossy = ElasticForm.from_vector(E_CONSTANTS.vector() * (1 + 0.01j * np.arange(10)))
    for constants in (E_CONSTANTS.lossless(), lossy):
        fast = model.stiffness(constants)
        nodal = model.products.stiffness(extended_tensor(constants, model.rotation))
        slow = model.prolongation.T @ nodal @ model.prolongation
        assert abs(fast - slow).max() < 1e-13 * abs(slow).max()
        assert fast.has_canonical_format
        assert abs(fast - fast.T).max() < 1e-13 * abs(slow).max()


def test_unit_terms_add_up():
    model = ElectroelasticModel(Plate(8e-3, 5e-3, 1e-3).domain((3, 2, 1)), 7500.0)
    values = E_CONSTANTS.lossless().vector().real
    total = sum(value * model.term(name) for value, name in zip(values, E_FORM, strict=True))
    whole = model.stiffness(E_CONSTANTS.lossless())
    assert abs(total - whole).max() < 1e-12 * abs(whole).max()
