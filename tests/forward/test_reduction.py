"""The reduced model against the full one: at random constants, for several plates, with its estimated error above
the true one.
"""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from femu_piezo.errors import ConvergenceError
from femu_piezo.forward.eigen import solve_eigen
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import _predicted, _ratios, reduce_model
from femu_piezo.forward.response import full_impedance
from femu_piezo.geometry.shapes import Plate
from femu_piezo.inference.free_constants import FreeConstants
from femu_piezo.material.constants import PiezoConstants
from tests.materials import FORWARD_LOSSY as LOSSY
from tests.materials import PZT5H as PZT


def resonances_Hz(modal, band: float) -> np.ndarray:
    """Frequencies of all poles and zeros in the band, Hz, where an error of the basis is largest."""
    values = np.concatenate([modal.eigenvalues, modal.zeros[0]]).real
    frequency = np.sqrt(values[values > 0]) / (2 * np.pi)
    return frequency[(frequency > 100.0) & (frequency < band)]


def true_error(model, reduced, e_form, band: float, most: int = 8, extra=None) -> float:
    """Largest relative error of Z at up to `most` poles and zeros and at three other frequencies."""
    special = resonances_Hz(reduced.modal(e_form, extra), band)
    chosen = np.random.default_rng(0).permutation(special)[:most]
    frequency = np.concatenate([chosen, [100.0, 0.55 * band, band]])
    full = full_impedance(model, e_form, frequency, extra)
    return float(np.max(np.abs(reduced.impedance(e_form, frequency, extra) / full - 1)))


CASES = {
    "k31 eighth": (Plate(40e-3, 5e-3, 1e-3), (12, 2, 1), (0, 1, 2), 200e3),
    "k31 full, six rigid bodies": (Plate(12e-3, 5e-3, 1e-3), (8, 3, 2), (), 250e3),
    "k33 bar": (Plate(20e-3, 2e-3, 2e-3, "length"), (10, 1, 1), (0, 1, 2), 250e3),
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("accuracy", [1e-4, 1e-6])
def test_one_lossy_set_is_as_accurate_as_asked(name, accuracy):
    """A basis for one set of lossy constants: true and estimated error are below the accuracy asked for."""
    plate, divisions, axes, band = CASES[name]
    model = ElectroelasticModel(plate.domain(divisions, axes), 7500.0)
    reduced = reduce_model(model, [LOSSY], band, accuracy=accuracy)
    assert true_error(model, reduced, LOSSY.to_e_form(), band) < accuracy
    assert reduced.estimated_error < accuracy
    assert reduced.size < 60


@pytest.fixture(scope="module")
def trained():
    """Model, free constants, end of the band and a basis for constants within ±15 %."""
    model = ElectroelasticModel(Plate(40e-3, 5e-3, 1e-3).domain((12, 2, 1)), 7500.0)
    free = FreeConstants.of(PZT, ("s11", "d31", "eps33T"))
    band = 200e3
    reduced = reduce_model(model, free.training_sets(free.start, 0.15), band, accuracy=1e-5)
    return model, free, band, reduced


def test_random_constants_in_the_trained_range(trained):
    """Six sets within ±15 %, with loss tangents of 0.5 to 2 %: the accuracy asked for is kept."""
    model, free, band, reduced = trained
    rng = np.random.default_rng(3)
    for _ in range(6):
        tangents = rng.uniform(0.005, 0.02, 3)
        theta = free.start.real * (1 + 0.15 * rng.uniform(-1, 1, 3)) * (1 - 1j * tangents)
        assert true_error(model, reduced, free.constants(theta).to_e_form(), band) < 1e-5


def test_poles_and_zeros_are_those_of_the_full_model(trained):
    model, free, _, reduced = trained
    theta = free.start.real * np.array([1.1, 0.9, 1.05]) * (1 - 1j * np.array([0.01, 0.02, 0.015]))
    e_form = free.constants(theta).to_e_form()
    modal = reduced.modal(e_form)
    for circuit, found in (("short", modal.eigenvalues), ("open", modal.zeros[0])):
        exact = solve_eigen(model, e_form, circuit, 6, near_Hz=60e3)
        strong = exact.eigenvalues[(exact.participation > 1e-3) & (exact.eigenvalues.real < (2 * np.pi * 190e3) ** 2)]
        assert strong.size >= 2
        for value in strong:
            assert np.min(np.abs(found - value)) < 1e-7 * abs(value)


def test_no_mode_of_the_eighth_is_missed():
    """All modes of an eighth of the plate are driven, so the reduced model must have as many in its band as the full
    one.
    """
    band, e_form = 300e3, PZT.to_e_form()
    model = ElectroelasticModel(Plate(20e-3, 5e-3, 1e-3).domain((8, 2, 1)), 7500.0)
    modal = reduce_model(model, [PZT], band).modal(e_form)
    for circuit, reduced in (("short", modal.eigenvalues), ("open", modal.zeros[0])):
        full = solve_eigen(model, e_form, circuit, 15).eigenvalues.real
        assert full.max() > (2 * np.pi * band) ** 2
        assert np.sum(reduced < (2 * np.pi * band) ** 2) == np.sum(full < (2 * np.pi * band) ** 2) > 3


def test_extra_terms_are_trained_too():
    """A point mass near the corner: its coefficient −ω²m is trained by real negative values."""
    plate, band, mass = Plate(12e-3, 5e-3, 1e-3), 150e3, 5e-6
    domain = plate.domain((6, 2, 1), (2,))
    bare = ElectroelasticModel(domain, 7500.0)
    nodes = bare.basis.N
    corner = int(np.argmax(bare.basis.doflocs.sum(axis=0)))
    diagonal = np.zeros(4 * nodes)
    diagonal[[corner, nodes + corner, 2 * nodes + corner]] = 1.0
    model = ElectroelasticModel(domain, 7500.0, extra_terms={"point_mass": sp.diags(diagonal)})
    top = -mass * (2 * np.pi * band) ** 2
    training = [(LOSSY, {"point_mass": share * top}) for share in (0.0, 0.1, 0.4, 1.0)]
    reduced = reduce_model(model, training, band, accuracy=1e-5)
    e_form = LOSSY.to_e_form()
    for share in (0.0, 0.2, 1.0):
        assert true_error(model, reduced, e_form, band, extra={"point_mass": share * top}) < 1e-5
    with pytest.raises(KeyError, match="no terms"):
        reduced.modal(e_form, {"spring": 1.0})


def test_a_term_given_by_its_tensor_is_the_one_given_by_its_matrix():
    """A shear stiffness added as a tensor or as a matrix: the same operator and impedance."""
    plate, band = Plate(12e-3, 5e-3, 1e-3), 150e3
    bare = ElectroelasticModel(plate.domain((6, 2, 1)), 7500.0)
    e_form = LOSSY.to_e_form()
    tensor = bare.unit_tensors[4] * e_form.c44.real
    by_tensor = bare.with_terms({"shear": tensor}, {})
    by_matrix = bare.with_terms({}, {"shear": bare.products.stiffness(tensor)})
    assert by_tensor.terms == by_matrix.terms == (*bare.terms, "shear") and "shear" not in bare.terms
    operators = [model.stiffness(e_form, {"shear": 0.3 + 0.01j}) for model in (by_tensor, by_matrix)]
    assert abs(operators[0] - operators[1]).max() < 1e-12 * abs(operators[1]).max()
    assert abs(by_tensor.term("shear") - by_matrix.term("shear")).max() < 1e-12 * abs(by_matrix.term("shear")).max()
    training = [(LOSSY, {"shear": share}) for share in (0.0, 0.2)]
    frequency, curves = np.linspace(1e3, band, 50), []
    for model in (by_tensor, by_matrix):
        reduced = reduce_model(model, training, band)
        curves.append(reduced.impedance(e_form, frequency, {"shear": 0.1}))
    np.testing.assert_allclose(curves[0], curves[1], rtol=1e-7)
    assert true_error(by_tensor, reduced, e_form, band, extra={"shear": 0.1}) < 1e-5


def test_an_accuracy_out_of_reach_is_reported(trained):
    """A basis that misses its target states the error it has; a useless one is refused."""
    model, free, band, _ = trained
    sets = free.training_sets(free.start, 0.15)
    reduced = reduce_model(model, sets, band, accuracy=1e-9, max_rounds=3)
    errors = [true_error(model, reduced, constants.to_e_form(), band) for constants in _lossy(sets[1:4])]
    assert 1e-9 < max(errors) < reduced.estimated_error < 1e-2
    with pytest.raises(ConvergenceError, match="narrow the band"):
        reduce_model(model, sets, band, accuracy=1e-9, max_rounds=1)


def _lossy(sets):
    """The sets of constants with a loss tangent of 0.5 %, as the estimate of the error assumes."""
    return [PiezoConstants.from_vector(item.vector() * (1 - 0.005j)) for item in sets]


def test_constants_whose_elastic_energy_is_not_positive_are_refused():
    """numpy's error on the way becomes a sentence."""
    model = ElectroelasticModel(Plate(20e-3, 4e-3, 1e-3).domain((3, 1, 1)), 7500.0)
    for wrong in ({"s12": -17e-12}, {"s44": -PZT.s44}):
        with pytest.raises(ConvergenceError, match="energy is not positive"):
            reduce_model(model, [PZT.with_values(**wrong)], 200e3)


def test_predicted_changes_of_the_correction():
    """Ratio of two successive changes, and the predicted size of all later ones.

    A change too small to be corrected takes the slowest ratio of the others, or 0.9 if there is none; a first change
    has none.
    """
    before, change = np.array([1.0, 0.1, 1e-6, np.inf]), np.array([1e-3, 2e-2, 5e-6, 0.3])
    ratio = _ratios(before, change, 1e-5)
    np.testing.assert_allclose(ratio, [1e-3, 0.2, 0.2, 0.0])
    np.testing.assert_allclose(_predicted(change, ratio), [1e-3 * 1e-3**0.5, 2e-2 * 0.2**0.5, 5e-6 * 0.2**0.5, 0.3])
    assert _ratios(before[2:3], change[2:3], 1e-5) == pytest.approx(0.9)
    assert _predicted(np.array([1.0]), np.array([0.8])) == pytest.approx(4.0)  # 0.8 + 0.64 + …
