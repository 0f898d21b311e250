"""Fourier orders of disks and rings against global polynomials for Cartesian components."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
import scipy.linalg as sl
from hidden_effects import reduced
from hidden_effects.round_body import RoundBody

from femu_piezo.effects.local.faces import BoxFace, Face, RoundFace
from femu_piezo.forward.gradient_products import extended_tensor
from femu_piezo.forward.revolution import Section
from femu_piezo.material.library import library_material

MATERIAL = library_material("pzt-5h").constants.lossless()
TENSOR = extended_tensor(MATERIAL.to_e_form(), np.eye(3)).real
THICKNESS, DENSITY, TOP_HZ = 1.5e-3, 7500.0, 320e3
RADII = {"disk": (0.0, 6e-3), "ring": (2.5e-3, 6e-3)}


def section(name: str) -> Section:
    return Section.fine_for(RADII[name], THICKNESS, DENSITY, 2 * np.pi * TOP_HZ / 1500.0)


@pytest.mark.parametrize(
    ("name", "flipped"),
    [
        pytest.param(one, way, marks=[pytest.mark.slow] * (way and one == "ring"))
        for one in RADII
        for way in (False, True)
    ],
)
def test_frequencies_of_all_orders_against_global_polynomials(name, flipped):
    """Short-circuited modes symmetric about θ = 0: all orders together are the modes of the whole body, each once."""
    top, found = (2 * np.pi * TOP_HZ) ** 2, []
    for number in range(10):
        order = section(name).order(number)
        modes = order.modes(TENSOR, flipped, top)
        np.testing.assert_allclose(modes.T @ (order.mass @ modes), np.eye(modes.shape[1]), atol=1e-8)
        found += np.einsum("ik,ik->k", modes, order.stiffness(TENSOR) @ modes).tolist()
    part = RoundBody(RADII[name], THICKNESS, DENSITY, 16, 5).part((-1 if flipped else 1,))
    constants = reduced._constants(MATERIAL.vector().real)
    stiffness = reduced._condensed(part.elastic, part.coupling, part.dielectric, constants)[:-1, :-1]
    exact = sl.eigh(stiffness, part.mass, subset_by_value=(-np.inf, top), eigvals_only=True)
    assert len(found) == exact.size
    rigid = exact < 1e-6 * top
    assert np.sum(rigid) == (
        2 if flipped else 1
    )  # rigid motions: a shift along z and a tilt where flipped, else a shift along x
    np.testing.assert_allclose(np.sort(found)[~rigid], exact[~rigid], rtol=1e-4)


def test_forms_of_a_shift_and_of_a_tilt_vanish():
    """Rigid motions of order 1 have no strain: u_x = 1, and u_z = x with u_x = −z."""
    order = section("disk").order(1)
    r, z = (part.ravel() for part in np.meshgrid(*(line.places for line in _lines("disk")), indexing="ij"))
    none = np.zeros_like(r)
    shift = np.concatenate([none + 1, none - 1, none, none])
    tilt = np.concatenate([-z, z, r, none])
    for motion in (shift, tilt):
        energy = motion @ (order.stiffness(TENSOR) @ motion)
        scale = TENSOR[0, 0, 0, 0] * THICKNESS
        assert abs(energy) < 1e-9 * scale * max(1.0, np.max(np.abs(motion)) ** 2)


def _lines(name: str):
    """The elements along r and along z."""
    of_body = section(name)
    return of_body.radial, of_body.axial


def test_slopes_of_a_face_are_those_of_its_displacements():
    """∂N/∂x and ∂N/∂y against differences, also off the plane θ = 0 and at x < 0."""
    rng = np.random.default_rng(3)
    face = RoundFace((0.0, 6e-3), rng.standard_normal((7, 3, 5)), np.array([0, 1, 2, 3, 5]), np.arange(5), 8)
    assert_slopes_are_those_of_differences(face, ((3e-3, 0.0), (2e-3, 1.5e-3), (-1e-3, 2e-3), (5e-3, 4e-3)))


def assert_slopes_are_those_of_differences(face: Face, points: Iterable[tuple[float, float]]) -> None:
    for x, y in points:
        _, slopes = face.at(x, y)
        h = 1e-8
        for axis, step in enumerate(((h, 0.0), (0.0, h))):
            ahead, behind = (face.at(x + s * step[0], y + s * step[1])[0] for s in (1, -1))
            np.testing.assert_allclose(slopes[axis], (ahead - behind) / (2 * h), rtol=1e-5, atol=1e-2)


def box_face() -> BoxFace:
    """A face of 12 x 6 mm with one unknown of each parity about x and y."""
    rng, flipped = np.random.default_rng(4), np.array([[0, 1, 0, 1], [0, 0, 1, 1], [0, 0, 0, 0]], dtype=bool)
    return BoxFace((6e-3, 3e-3), rng.standard_normal((7, 6, 3, 4)), flipped, np.arange(4), 8)


def test_a_face_continues_by_parity_beyond_its_mirror_lines():
    """About x = 0 the driven u_x is odd, the driven u_y and u_z are even, and all the other way where flipped."""
    face = box_face()
    value, beyond = (face.at(x, 1e-3)[0] for x in (2e-3, -2e-3))
    sign = np.array([[-1, 1, -1, 1], [1, -1, 1, -1], [1, -1, 1, -1]])
    np.testing.assert_allclose(beyond, sign * value)
    assert_slopes_are_those_of_differences(face, ((2e-3, 1e-3), (-2e-3, 1e-3), (2e-3, -1e-3), (-7e-3, -4e-3)))


@pytest.mark.parametrize(
    ("face", "edges"),
    [
        (box_face(), [((6e-3, 1e-3), (1, 0)), ((2e-3, 3e-3), (0, 1)), ((2e-3, -3e-3), (0, -1))]),
        (
            RoundFace((2e-3, 6e-3), np.random.default_rng(5).standard_normal((9, 3, 2)), np.arange(2), np.arange(2), 8),
            [((6e-3, 0.0), (1, 0)), ((2e-3, 0.0), (-1, 0)), ((0.0, 6e-3), (0, 1))],
        ),
    ],
    ids=["plate", "ring"],
)
def test_a_face_continues_straight_beyond_its_edges(face, edges):
    """As polynomials of high order it would grow by orders of magnitude under a patch that reaches over an edge."""
    for place, outward in edges:
        at, ahead, behind = (face.at(*(place + step * np.array(outward)))[0] for step in (0.2e-3, 0.4e-3, 0.0))
        np.testing.assert_allclose(ahead - at, at - behind, rtol=1e-9, atol=1e-9)
        slope = np.tensordot(np.array(outward), face.at(*place)[1], axes=1)
        np.testing.assert_allclose(at - behind, 0.2e-3 * slope, rtol=1e-9, atol=1e-9)
