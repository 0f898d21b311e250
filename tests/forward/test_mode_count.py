"""Inertia counts against computed eigenpairs, and against the poles and zeros of the reduced model."""

from __future__ import annotations

import numpy as np
import pytest

from femu_piezo.forward import linear_solver
from femu_piezo.forward.eigen import solve_eigen
from femu_piezo.forward.linear_solver import Analysis, factorize
from femu_piezo.forward.mode_count import count_modes_below
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import reduce_model
from femu_piezo.geometry.shapes import Plate
from femu_piezo.material.library import library_material

PZT = library_material("pzt-5h").constants.lossless()


@pytest.mark.parametrize("circuit", ["short", "open"])
@pytest.mark.parametrize(("axes", "rigid"), [((0, 1, 2), 0), ((), 6)])
def test_count_equals_the_eigenvalues(circuit, axes, rigid):
    divisions = (4, 2, 1) if axes else (6, 3, 1)
    model = ElectroelasticModel(Plate(12e-3, 5e-3, 1e-3).domain(divisions, axes), 7500.0)
    e_form = PZT.to_e_form()
    values = solve_eigen(model, e_form, circuit, 18).eigenvalues.real
    frequency = np.sqrt(np.maximum(values, 0.0)) / (2 * np.pi)
    assert count_modes_below(model, e_form, 2000.0, circuit) == rigid
    for below in (rigid + 2, 14):
        middle = (frequency[below - 1] + frequency[below]) / 2
        assert count_modes_below(model, e_form, middle, circuit) == below


def test_the_reduced_model_misses_no_mode_of_the_eighth():
    """Every mode of the eighth is driven, so the reduced model must hold exactly as many as the inertia proves."""
    band = 300e3
    model = ElectroelasticModel(Plate(20e-3, 5e-3, 1e-3).domain((8, 2, 1)), 7500.0)
    modal = reduce_model(model, [PZT], band).modal(PZT.to_e_form())
    for circuit, values in (("short", modal.eigenvalues), ("open", modal.zeros[0])):
        found = np.count_nonzero(values < (2 * np.pi * band) ** 2)
        assert found == count_modes_below(model, PZT.to_e_form(), band, circuit) > 3


def test_one_analysis_serves_a_sweep():
    model = ElectroelasticModel(Plate(12e-3, 5e-3, 1e-3).domain((4, 2, 1)), 7500.0)
    stiffness, right = model.stiffness(PZT.to_e_form()), np.arange(1.0, model.size + 1)
    analysis = Analysis()
    for omega in (1e5, 5e5, 1e6):
        matrix = stiffness - omega**2 * model.mass
        np.testing.assert_allclose(analysis.factorize(matrix).solve(right), factorize(matrix).solve(right), rtol=1e-9)
    assert analysis.analyses == 1
    analysis.factorize(model.mass[:50, :50])  # another pattern is analysed anew
    assert analysis.analyses == 2


def test_without_rslab_superlu_solves_and_the_count_is_refused(monkeypatch):
    model = ElectroelasticModel(Plate(12e-3, 5e-3, 1e-3).domain((2, 1, 1)), 7500.0)
    monkeypatch.setattr(linear_solver, "rslab", None)
    assert factorize(model.stiffness(PZT.to_e_form()) + model.mass).backend == "scipy"
    with pytest.raises(linear_solver.ConvergenceError, match="rslab"):
        count_modes_below(model, PZT.to_e_form(), 1e4, "open")
