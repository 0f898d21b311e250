"""Modes of a class of symmetry, several of one frequency among them."""

import numpy as np
import scipy.sparse as sp

from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.parity import ParityClass, modes_below
from femu_piezo.geometry.shapes import Plate
from tests.materials import PZT5H


def test_all_six_rigid_body_modes_of_a_body_without_mirror_planes_are_found():
    """ARPACK starts from one vector, which holds one combination of modes that have the same frequency."""
    body = ElectroelasticModel(Plate(12e-3, 5e-3, 1e-3).domain((12, 5, 2), (), 2), 7500.0)
    whole = ParityClass(body, PZT5H.to_e_form(), ())
    top = (2 * np.pi * 253e3) ** 2
    modes = whole.modes(top)
    free = whole.prolongation.T @ modes / np.asarray(whole.prolongation.power(2).sum(axis=0)).ravel()[:, None]
    squares = np.einsum("ik,ik->k", free, whole.stiffness @ free)
    assert np.sum(np.abs(squares) < 1e-6 * top) == 6
    np.testing.assert_allclose(free.T @ (whole.mass @ free), np.eye(free.shape[1]), atol=1e-8)


def test_all_modes_of_one_frequency_are_found():
    values = np.sort(np.concatenate([np.zeros(6), np.repeat(np.linspace(0.05, 0.9, 6), 2), np.linspace(1.05, 50, 400)]))
    modes = modes_below(sp.diags(values).tocsr(), sp.eye(values.size).tocsr(), 1.0, repeated=True)
    assert modes.shape == (values.size, 18)
    np.testing.assert_allclose(np.linalg.norm(modes[:18], axis=0), 1.0)
