"""Threads that share an element, a curved mesh or an analysis each get the right results."""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import scipy.sparse as sp
import skfem

from femu_piezo.forward.hex_element import ElementHexP
from femu_piezo.forward.linear_solver import Analysis
from femu_piezo.geometry.catalogue import disk

_THREADS, _TURNS = 4, 40


@pytest.fixture
def eager():
    """Threads that switch at nearly every bytecode."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def _alone_and_together(answer: Callable[[int], np.ndarray]) -> None:
    """Assert that results in several threads are those in one."""
    expected = [answer(number) for number in range(_THREADS)]
    with ThreadPoolExecutor(_THREADS) as pool:
        for number, found in enumerate(pool.map(lambda n: [answer(n) for _ in range(_TURNS)], range(_THREADS))):
            for one in found:
                np.testing.assert_array_equal(one, expected[number])


def test_an_element(eager):
    mesh, element = skfem.MeshHex.init_tensor([0.0, 1.0, 3.0], [0.0, 1.0], [0.0, 1.0]), ElementHexP(2)
    mapping = mesh.mapping()
    points = [np.random.default_rng(n).random((3, n + 1)) for n in range(_THREADS)]
    _alone_and_together(lambda n: np.array([element.gbasis(mapping, points[n], i)[0].grad for i in range(27)]))


def test_a_curved_mesh(eager):
    mapping = disk(10e-3, 1e-3).domain(5e-3, order=3).mesh.mapping()
    points = [np.random.default_rng(n).random((3, n + 1)) for n in range(_THREADS)]
    _alone_and_together(lambda n: np.array([mapping.J(i, j, points[n]) for i in range(3) for j in range(3)]))


def test_an_analysis(eager):
    analysis = Analysis()
    matrices = [sp.diags([[4.0] * n, [1.0] * (n - 1), [1.0] * (n - 1)], [0, -1, 1]).tocsc() for n in range(20, 24)]
    _alone_and_together(lambda n: analysis.factorize(matrices[n]).solve(np.arange(1.0, len(matrices[n].indptr))))
