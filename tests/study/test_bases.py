"""Bases that the specimens of a lot share: made once, and functions of rounded values alone."""

from __future__ import annotations

import numpy as np
import pytest

from femu_piezo.material.constants import PiezoConstants
from femu_piezo.specimen.file import read_specimen
from femu_piezo.study.measured import measure
from femu_piezo.study.model_cache import Bases, SharedBases
from femu_piezo.study.planning import _coarse, _ToSweep
from femu_piezo.study.subjects import subjects

TRIO = ("s11", "d31", "eps33T")


@pytest.fixture
def subject(sweeps, write_specimen_of):
    (found,) = subjects([measure(read_specimen(write_specimen_of("k31", sweeps["k31"], TRIO)))])
    return found


def moved(constants: PiezoConstants, share: float) -> PiezoConstants:
    """With the free constants times 1 + share."""
    return constants.with_values(**{name: getattr(constants, name) * (1 + share) for name in TRIO})


@pytest.mark.slow
def test_basis_with_effects_is_made_once(subject):
    """Specimens whose noise and start differ by little get one model and one basis; others their own."""
    bases, one = SharedBases(), subject.measured
    effects = [effect for effect in subject.library if effect.name in ("wrong_width", "leakage")]
    own = one.problem.constants
    model = bases.model(one, 1e-4)
    assert bases.model(one, 1.05e-4) is model and bases.model(one, 1e-6) is not model
    training = [bases.around(one.problem, moved(own, share)) for share in (0.03, -0.02)]
    assert training[0] == training[1]
    first = bases.extended(model, training[:1], effects, one, 4e-5)
    assert bases.extended(model, training[1:], list(reversed(effects)), one, 4.2e-5) is first
    assert bases.extended(model, training[:1], effects, one, 1e-5) is not first
    assert bases.extended(model, training[:1], effects[:1], one, 4e-5).sectors == first.sectors
    count = bases.made
    assert bases.extended(model, training[:1], effects, one, 4e-5) is first
    assert bases.made == count and first.estimated_error < 4e-5


def test_rungs_of_accuracy_with_one_mesh_have_one_model(subject):
    """Accuracies that ask for the same elements."""
    bases, one = SharedBases(), subject.measured
    models = [bases.model(one, accuracy) for accuracy in np.geomspace(3e-5, 3e-6, 10)]
    meshes = [(model.domain.order, model.domain.mesh.p.tobytes()) for model in models]
    equal = [[first == other for other in meshes] for first in meshes]
    assert 1 < len(set(map(id, models))) < 6  # of the rungs
    assert equal == [[first is other for other in models] for first in models]


def test_a_start_near_one_before_uses_its_rough_basis(subject):
    """Of other values of the free constants, not of the held ones."""
    bases, one = Bases(), subject.measured
    problem, model = one.problem, Bases().model(one, 5e-3)

    def rough(constants: PiezoConstants):
        return bases.rough(model, bases.anchor(problem, problem.free(constants)), one, 1e-3)

    own = problem.constants
    first = rough(own)
    assert rough(moved(own, 0.15)) is first and rough(moved(own, -0.15)) is first
    assert rough(moved(own, 0.25)) is not first
    assert rough(moved(own, 0.15).with_values(s33=1.05 * own.s33)) is not first


@pytest.mark.parametrize("share", [0.09, -0.09, 0.3])
def test_constants_far_from_the_file_go_to_a_grid(subject, share):
    """Within half a step of the start, with the tangents of the file; the same for all starts about there."""
    problem = subject.measured.problem
    own = problem.constants
    around = SharedBases().around(problem, moved(own, share))
    for name in TRIO:
        ratio = getattr(around, name) / (getattr(own, name) * (1 + share))
        assert ratio.imag == pytest.approx(0.0, abs=1e-12) and abs(np.log(ratio.real)) <= np.log(1.1) / 2 + 1e-9
    assert around.s12 == own.s12
    assert SharedBases().around(problem, moved(around, 0.01)) == SharedBases().around(problem, around)


def test_what_plans_are_made_with_is_made_once_for_a_lot(subject):
    """Constants of two specimens have one coarse basis, and Z there is that of a basis of their own."""
    shared, one = SharedBases(), subject.measured
    problem, band = one.problem, 1.5 * one.band_Hz
    effects = [effect for effect in subject.library if effect.name in ("wrong_width", "leakage")]
    frequency = np.linspace(0.1, 1.0, 400) * band
    for share in (0.06, -0.05):
        constants = moved(problem.constants, share)
        made = shared.made
        found, own = (
            _coarse(bases, _ToSweep(problem, band), subject, effects, constants) for bases in (shared, Bases())
        )
        assert shared.made - made == (2 if share > 0 else 0)  # model and basis
        z, exact = (model.modal(constants.to_e_form()).impedance(2 * np.pi * frequency) for model in (found, own))
        assert np.sqrt(np.mean(np.abs(np.log(z / exact)) ** 2)) < 0.05
        assert np.mean(np.abs(np.log(z / exact))) < 0.01
