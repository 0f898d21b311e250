"""Local compliance of a face under a patch: half-space limit, and the modes through the thickness that the model
already contains.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from femu_piezo.effects.effect import EffectContext
from femu_piezo.effects.library import mounting
from femu_piezo.effects.local.face_compliance import FaceCompliance, yielding_beyond
from femu_piezo.effects.local.faces import BoxFace
from femu_piezo.geometry.shapes import Plate
from femu_piezo.material.library import library_material

YOUNG, POISSON, THICKNESS, DENSITY = 60e9, 0.3, 1.5e-3, 7500.0


def isotropic(cutoff_omega: float, radii: tuple[float, float], poling: int = 2, covered: bool = True) -> FaceCompliance:
    shear = YOUNG / (2 * (1 + POISSON))
    lame = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    normal = lame + 2 * shear
    constants = (normal, lame, lame, normal, shear, 0.0, 0.0, 0.0, 1e-9, 1e-9)
    return FaceCompliance(constants, poling, covered, DENSITY, THICKNESS, cutoff_omega, radii)


@pytest.mark.parametrize("covered", [True, False])
@pytest.mark.parametrize("poling", range(3))
def test_short_waves_see_a_half_space(poling, covered):
    """C(k) → 2 (1 − ν²)/(E k) along the normal and (2 − ν)/(2 − 2ν) times that along the face, averaged over
    directions.
    """
    k = np.array([10.0]) / THICKNESS
    found = yielding_beyond(isotropic(0.0, (1e-5, 1e-4), poling, covered), k)[0] * YOUNG * k / (2 * (1 - POISSON**2))
    ratio = (2 - POISSON) / (2 - 2 * POISSON)
    np.testing.assert_allclose(found, [ratio, ratio, 1.0], rtol=2e-4)


def test_small_patch_on_a_half_space():
    """16 (1 − ν²)/(3π² E a), less the share of waves below the cutoff, which is proportional to the radius a."""
    excess = []
    for radius in (8e-5, 1.6e-4):
        compliance = isotropic(2 * np.pi * 0.3e6, (radius / 2, 2 * radius))
        half_space = 3 * np.pi**2 * YOUNG * radius / (16 * (1 - POISSON**2))
        excess.append(compliance.stiffness(radius)[0][2] / half_space - 1)
    assert 0 < excess[0] < 0.08
    assert excess[1] == pytest.approx(2 * excess[0], rel=0.1)


def test_local_compliance_falls_with_the_modes_of_the_model():
    """Under a patch as wide as the thickness most of the compliance is in the modes; slopes in the radius are exact."""
    low, high = (isotropic(2 * np.pi * top, (3e-4, 3e-3)) for top in (0.3e6, 1.0e6))
    assert np.all(low.stiffness(1e-3)[0] < 0.7 * high.stiffness(1e-3)[0])
    h = 1e-7
    difference = (high.stiffness(1e-3 + h)[0] - high.stiffness(1e-3 - h)[0]) / (2 * h)
    np.testing.assert_allclose(high.stiffness(1e-3)[1], difference, rtol=1e-5)


@pytest.mark.parametrize("axis", range(3))
def test_a_support_gives_way_along_each_axis_by_its_own_compliance(axis):
    """k in series with 1/C_i, on a body whose unknowns shift it along x, y and z, poled along one of them."""
    constants, plate = library_material("pzt-5h").constants, Plate(12e-3, 6e-3, 1.5e-3, direction=(1, 0, 1))
    turned = {"upper": plate.upper_face, "poling_axis": axis, "field_axis": axis}
    context = EffectContext(1e5, (), constants, {}, DENSITY, THICKNESS, **turned)
    shifts = BoxFace((6e-3, 3e-3), np.eye(3)[None, None], np.zeros((3, 3), dtype=bool), np.zeros(3), 1)
    (effect,), places = mounting.candidates(context), SimpleNamespace(face=shifts, size=3, cutoff_omega=2e6)
    contact, stiffness, radius = effect.parameters[-1], 1e8, 5e-4
    terms = effect.local(places, np.ones(1), np.array([stiffness, 0.0, 2e-3, 1e-3, radius]))
    yielding = 1 / FaceCompliance.of(context, 2e6, (contact.low, contact.high)).stiffness(radius)[0]
    assert (np.ptp(yielding[:2]) > 0.1 * yielding[0]) == (axis < 2)
    found = sum(term.value[0] * term.matrix for term in terms)
    np.testing.assert_allclose(found, np.diag(1 / (1 / stiffness + yielding)), rtol=1e-12)
