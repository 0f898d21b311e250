"""Reduced bases that the specimens of a lot share: computed once, and functions of rounded values alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from femu_piezo.errors import TooLargeError
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.specimen.file import Simulation, read_specimen
from femu_piezo.study.measured import measure, measure_each
from femu_piezo.study.model_cache import Bases, SharedBases
from femu_piezo.study.planning import _coarse, _ToSweep
from femu_piezo.study.posterior import Posterior
from femu_piezo.study.progress import Clock
from femu_piezo.study.subjects import subjects
from femu_piezo.study.update import update_measured
from tests.noise import noisy

TRIO = ("s11", "d31", "eps33T")


@pytest.fixture
def subject(sweeps, write_specimen_of):
    (found,) = subjects([measure(read_specimen(write_specimen_of("k31", sweeps["k31"], TRIO)))])
    return found


def moved(constants: PiezoConstants, share: float) -> PiezoConstants:
    """Constants with the free ones multiplied by 1 + `share`."""
    return constants.with_values(**{name: getattr(constants, name) * (1 + share) for name in TRIO})


@pytest.mark.slow
def test_basis_with_effects_is_made_once(subject):
    """Specimens whose noise and start differ little share a model and a basis; others get their own."""
    bases, measured = SharedBases(), subject.measured
    effects = [effect for effect in subject.library if effect.name in ("wrong_width", "leakage")]
    given = measured.problem.constants
    model = bases.model(measured, 1e-4)
    assert bases.model(measured, 1.05e-4) is model and bases.model(measured, 1e-6) is not model
    training = [bases.around(measured.problem, moved(given, share)) for share in (0.03, -0.02)]
    assert training[0] == training[1]
    first = bases.extended(model, training[:1], effects, measured, 4e-5)
    assert bases.extended(model, training[1:], list(reversed(effects)), measured, 4.2e-5) is first
    assert bases.extended(model, training[:1], effects, measured, 1e-5) is not first
    assert bases.extended(model, training[:1], effects[:1], measured, 4e-5).sectors == first.sectors
    count = bases.made
    assert bases.extended(model, training[:1], effects, measured, 4e-5) is first
    assert bases.made == count and first.estimated_error < 4e-5


def test_accuracies_with_the_same_mesh_share_a_model(subject):
    """Ten accuracies over a decade give fewer than six models, one for each mesh."""
    bases, one = SharedBases(), subject.measured
    models = [bases.model(one, accuracy) for accuracy in np.geomspace(3e-5, 3e-6, 10)]
    meshes = [(model.domain.order, model.domain.mesh.p.tobytes()) for model in models]
    equal = [[first == other for other in meshes] for first in meshes]
    assert 1 < len(set(map(id, models))) < 6  # models for ten accuracies
    assert equal == [[first is other for other in models] for first in models]


@pytest.mark.parametrize("kind", [Bases, SharedBases])
def test_bodies_with_another_order_of_elements_have_their_own_model(subject, kind):
    bases, problem = kind(), subject.measured.problem
    models = []
    for order in (None, 3, 4, None):
        specimen = problem.specimen.model_copy(update={"simulation": Simulation(order=order)})
        models.append(bases.model(replace(subject.measured, problem=replace(problem, specimen=specimen)), 1e-3))
    assert [model.order for model in models[1:3]] == [3, 4] and models[3] is models[0]


def test_pieces_of_equal_shape_share_model_and_basis(sweeps, write_specimen_of):
    """In a joint fit of two pieces and a third, which is 1 % longer, though their noise differs."""
    file = read_specimen(write_specimen_of("k31", sweeps["k31"], TRIO))
    longer = file.geometry.model_copy(update={"length": 1.01 * file.geometry.length})
    pieces = [file.model_copy(update={"name": name}) for name in ("one", "two")]
    pieces.append(file.model_copy(update={"name": "longer", "geometry": longer}))
    spectra = [
        ImpedanceSpectrum(sweeps["k31"].frequency, noisy(sweeps["k31"].impedance, level, 1))
        for level in (1e-3, 3e-4, 1e-3)
    ]
    posterior = Posterior(subjects(measure_each(pieces, spectra)), Clock(lambda step: None), Bases())
    posterior.base(posterior.problem.constants)
    for one, two, other in (posterior.full, posterior.models):
        assert one is two and other is not one


def test_a_start_near_an_earlier_one_uses_its_rough_basis(subject):
    """Free constants up to 15 % away share the basis; 25 %, or another held constant, need a new one."""
    bases, one = Bases(), subject.measured
    problem, model = one.problem, Bases().model(one, 5e-3)

    def rough(constants: PiezoConstants):
        return bases.rough(model, bases.anchor(problem, problem.free(constants)), one, 1e-3)

    given = problem.constants
    first = rough(given)
    assert rough(moved(given, 0.15)) is first and rough(moved(given, -0.15)) is first
    assert rough(moved(given, 0.25)) is not first
    assert rough(moved(given, 0.15).with_values(s33=1.05 * given.s33)) is not first


def test_one_bases_serves_other_free_constants(subject):
    """One object of `Bases` for updates that free two and three constants: each has rough bases of its own."""
    bases, problem = Bases(), subject.measured.problem
    found = []
    for free in (("s11", "d31"), TRIO, ("s11", "d31"), ("s33", "d33")):
        material = problem.specimen.material.model_copy(update={"free": free})
        own = replace(problem, specimen=problem.specimen.model_copy(update={"material": material}))
        found.append(bases.anchor(own, own.free(problem.constants)))
    assert [one.names for one in found] == [("s11", "d31"), TRIO, ("s11", "d31"), ("s33", "d33")]
    assert found[0] is found[2]


@pytest.mark.parametrize("share", [0.09, -0.09, 0.3])
def test_constants_far_from_the_file_go_to_a_grid(subject, share):
    """Bases are centred on a grid of free constants with ratio 1.1, the point nearest to the start, with the
    tangents of the file.

    All starts near a point of the grid share it.
    """
    problem = subject.measured.problem
    given = problem.constants
    around = SharedBases().around(problem, moved(given, share))
    for name in TRIO:
        ratio = getattr(around, name) / (getattr(given, name) * (1 + share))
        assert ratio.imag == pytest.approx(0.0, abs=1e-12) and abs(np.log(ratio.real)) <= np.log(1.1) / 2 + 1e-9
    assert around.s12 == given.s12
    assert SharedBases().around(problem, moved(around, 0.01)) == SharedBases().around(problem, around)


def test_the_basis_of_plans_is_made_once_for_a_lot(subject):
    """Constants of two specimens, 11 % apart, share a coarse basis, and log Z by it is that of a basis of their own
    within 0.05 in rms.
    """
    shared, one = SharedBases(), subject.measured
    problem, band = one.problem, 1.5 * one.band_Hz
    effects = [effect for effect in subject.library if effect.name in ("wrong_width", "leakage")]
    frequency = np.linspace(0.1, 1.0, 400) * band
    for share in (0.06, -0.05):
        constants = moved(problem.constants, share)
        made = shared.made
        found, unshared = (
            _coarse(bases, _ToSweep(problem, band), subject, effects, constants) for bases in (shared, Bases())
        )
        assert shared.made - made == (2 if share > 0 else 0)  # model and basis
        z, exact = (model.modal(constants.to_e_form()).impedance(2 * np.pi * frequency) for model in (found, unshared))
        assert np.sqrt(np.mean(np.abs(np.log(z / exact)) ** 2)) < 0.05
        assert np.mean(np.abs(np.log(z / exact))) < 0.01


def test_a_mesh_for_the_noise_that_is_too_large_is_replaced_by_one_for_the_file(subject, monkeypatch):
    """Its accuracy is that of [update] accuracy; where that is too large as well, the error says so, before any fit."""
    asked, refused = [], {1e-5}

    class Small(Bases):
        def model(self, one, accuracy):
            asked.append(accuracy)
            if accuracy in refused:
                raise TooLargeError("the mesh would have too many entries")
            return super().model(one, accuracy)

    monkeypatch.setattr("femu_piezo.study.posterior.mesh_accuracy", lambda several: 1e-5)
    posterior = Posterior([subject], Clock(lambda step: None), Small())
    posterior.mesh()
    assert asked == [1e-5, 1e-4] and posterior.full[0].size > 0 and posterior._meshes[0][1] == 1e-4
    refused.add(1e-4)
    with pytest.raises(TooLargeError, match="too many entries"):
        update_measured([subject.measured], Clock(lambda step: None), Small())
    assert asked[2:] == [1e-5, 1e-4]  # no model of a start
