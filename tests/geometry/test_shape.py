"""The error of waves in elements of an order, by which meshes are chosen."""

import re

import numpy as np
import pytest
import scipy.linalg as sl

from femu_piezo.errors import InputError
from femu_piezo.forward.tensor_grid import line_products
from femu_piezo.geometry.shape import check_unknowns, wave_error


def error_of_a_wave(order: int, phase: float) -> float:
    """Relative error of k² of the wave e^(jkx) on an endless line of equal elements; phase : k h over one element."""
    nodes = np.linspace(0, 1, order + 1)
    mass, _, _, stiffness = line_products(nodes, 0.0, 1.0).reshape(4, order + 1, order + 1)
    joined = np.eye(order + 1, order, dtype=complex)
    joined[-1, 0] = np.exp(1j * phase)  # the last node is the first one of the next element
    squares = sl.eigh(joined.conj().T @ stiffness @ joined, joined.conj().T @ mass @ joined, eigvals_only=True)
    return np.min(np.abs(squares / phase**2 - 1))


@pytest.mark.parametrize(("order", "phase"), [(1, 0.1), (2, 0.3), (3, 0.6), (4, 0.8), (5, 1.2)])
def test_error_of_waves_is_that_of_periodic_elements(order: int, phase: float) -> None:
    """[p!/(2p)!]² (k h)^(2p) / (2p + 1), to leading order in k h."""
    assert wave_error(order, phase) == pytest.approx(error_of_a_wave(order, phase), rel=0.05)


@pytest.mark.parametrize(("unknowns", "entries", "told"), [(1e6, 1e6, "1e+06 unknowns"), (2e5, 2e8, "2e+08 entries")])
def test_a_model_too_large_is_refused_by_what_is_too_large(unknowns: float, entries: float, told: str) -> None:
    with pytest.raises(InputError, match=re.escape(told)):
        check_unknowns(unknowns, entries)
