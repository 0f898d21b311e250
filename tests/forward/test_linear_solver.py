"""One symbolic analysis serves all matrices of a pattern; without rslab, SuperLU solves."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import scipy.sparse as sp

from femu_piezo.errors import ConvergenceError
from femu_piezo.forward import linear_solver
from femu_piezo.forward.linear_solver import Analysis, Factorization, factorize
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.shapes import Plate
from femu_piezo.material.library import library_material

E_FORM = library_material("pzt-5h").constants.lossless().to_e_form()


def test_one_analysis_serves_a_sweep():
    """Three frequencies."""
    model = ElectroelasticModel(Plate(12e-3, 5e-3, 1e-3).domain((4, 2, 1)), 7500.0)
    stiffness, right = model.stiffness(E_FORM), np.arange(1.0, model.size + 1)
    analysis = Analysis()
    for omega in (1e5, 5e5, 1e6):
        matrix = stiffness - omega**2 * model.mass
        np.testing.assert_allclose(analysis.factorize(matrix).solve(right), factorize(matrix).solve(right), rtol=1e-9)
    assert analysis.analyses == 1
    analysis.factorize(model.mass[:50, :50])  # another pattern needs another analysis
    assert analysis.analyses == 2


def test_without_rslab_superlu_solves(monkeypatch):
    model = ElectroelasticModel(Plate(12e-3, 5e-3, 1e-3).domain((2, 1, 1)), 7500.0)
    matrix, right = model.stiffness(E_FORM) + model.mass, np.arange(1.0, model.size + 1)
    expected = factorize(matrix).solve(right)
    monkeypatch.setattr(linear_solver, "rslab", None)
    found = factorize(matrix)
    analysis = Analysis()
    for part in (matrix, sp.tril(matrix)):
        solver = analysis.solver(sp.csc_matrix(part))
        assert solver.backend == "scipy"
        np.testing.assert_allclose(solver.solve(right), expected, rtol=1e-8, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(found.solve(right), expected, rtol=1e-8, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("dtype", [float, complex])
def test_no_right_hand_side_has_no_solution(dtype):
    """An empty set of right-hand sides gives an empty set of solutions, as for a disk whose response to an uneven
    film adds nothing to its modes.
    """
    found = factorize(sp.eye(5, format="csr")).solve(np.zeros((5, 0), dtype=dtype))
    assert found.shape == (5, 0) and found.dtype == dtype


class Spoilt:
    """A solver that makes one column wrong by a relative error, for the first `times` solutions."""

    def __init__(self, solver, share: float, column: int, times: int) -> None:
        self._solver, self._share, self._column, self.times = solver, share, column, times

    def solve(self, right: np.ndarray) -> np.ndarray:
        """The solutions (n, k), one of them wrong."""
        found = self._solver.solve(right)
        if self.times:
            self.times -= 1
            found[:, self._column] *= 1 + self._share
        return found


@pytest.mark.parametrize("column", [0, 7, 29])
def test_one_wrong_solution_among_many_is_detected(column):
    """A few sums of the columns show it: it is refined once, and an error is raised if the solver stays wrong."""
    model = ElectroelasticModel(Plate(12e-3, 5e-3, 1e-3).domain((2, 1, 1)), 7500.0)
    matrix = sp.csc_matrix(model.stiffness(E_FORM) + model.mass)
    right = np.random.default_rng(column).standard_normal((model.size, 30))
    solver = Analysis().solver(matrix)
    expected = factorize(matrix).solve(right)
    once = Spoilt(solver, 1e-4, column, times=1)
    found = Factorization(matrix, once, matrix.diagonal()).solve(right)
    assert once.times == 0
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    always = Factorization(matrix, Spoilt(solver, 0.5, column, times=9), matrix.diagonal())
    with pytest.raises(ConvergenceError, match="nearly singular"):
        always.solve(right)
    always.check(expected, right)
    with pytest.raises(ConvergenceError):
        always.check(np.where(np.arange(30) == column, 0.0, expected), right)


_AFTER_A_THREAD = """
import threading
import numpy as np
import scipy.sparse as sp

def load():
    import femu_piezo.forward.linear_solver

loader = threading.Thread(target=load)
loader.start()
loader.join()
from femu_piezo.forward.linear_solver import factorize

matrix = sp.diags([-1.0, -1.0, 5.0, -1.0, -1.0], [-40, -1, 0, 1, 40], shape=(3000, 3000), format="csc")
for _ in range(20):
    factorize(matrix).solve(np.ones((3000, 30)))
"""


def test_the_solver_may_be_loaded_by_a_thread_that_ends():
    """As where a program with windows imports the package in a thread; the factorisation then ended the process."""
    done = subprocess.run([sys.executable, "-c", _AFTER_A_THREAD], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
