"""Separations of causes that plans of further measurements predict, against fits to data of those measurements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.conftest import AXES, DENSITY, FREQUENCY, SIZE
from femu_piezo.diagnosis.next_measurement import Plan, Point, Remembered, Separation, separation, strength, summary
from femu_piezo.diagnosis.readings import readings
from femu_piezo.effects.effect import EffectContext, EffectParameter
from femu_piezo.effects.library import library
from femu_piezo.inference.ensemble import with_owner
from femu_piezo.inference.fit import fit
from femu_piezo.inference.readings import Reading
from femu_piezo.inference.response import Evaluation
from femu_piezo.measurement.sweeps import SweepData
from femu_piezo.study.planning import _beyond

NOISE = 1e-3


@pytest.fixture(scope="module")
def low(setup):
    """Points below 126 kHz, under the width modes, and the evaluation there."""
    kept = FREQUENCY < 126e3
    return kept, Evaluation(setup.model, setup.evaluation.omega[kept])


def unbiased(effect):
    """The effect with practically no prior on its size."""
    size, *others = effect.parameters
    return replace(effect, parameters=(replace(size, spread=1e6), *others))


def fitted(evaluation, frequency, impedance, parameters, start):
    data = SweepData(frequency, impedance, np.full(impedance.size, NOISE), True)
    return fit(evaluation, data, parameters, [start])


def test_wider_band_separates_as_a_fit_to_it_does(setup, low):
    """Noise-free data of a wrong width up to 126 kHz, explained by a wrong s13.

    The misfit of s13 that the plan predicts for a band up to 225 kHz, against a refit to that band.
    """
    kept, evaluation = low
    wrong = unbiased(setup.library["wrong_insensitive_parameter:s13"])
    first, truth = setup.with_effects({"wrong_width": 0.004})
    z = setup.evaluation.impedance(first, truth)
    second = setup.unknowns.with_candidate(wrong)
    narrow = fitted(evaluation, FREQUENCY[kept], z[kept], second, np.concatenate([setup.x, [0.1, 0.0]]))
    plan = Plan("wider band", setup.evaluation, np.full(z.size, NOISE))
    present = replace(plan, evaluation=evaluation, relative_noise=plan.relative_noise[kept])
    points = Point(first, truth), Point(second, narrow.x)
    expected = separation(plan, *points)
    reached = np.linalg.norm(fitted(setup.evaluation, FREQUENCY, z, second, narrow.x).residual)
    assert expected == pytest.approx(reached, rel=0.1)
    assert separation(present, *points) == pytest.approx(np.linalg.norm(narrow.residual), rel=0.05)
    assert expected > 5 * separation(present, *points)
    quiet = replace(plan, relative_noise=plan.relative_noise / 3)
    assert separation(quiet, *points) == pytest.approx(3 * expected, rel=1e-5)


@pytest.mark.parametrize("low", [1e3, 90e3])
def test_a_planned_wider_band_has_points_up_to_its_end(low):
    """Of a sweep of a wide band, of a narrow one and of one with crowded points about a resonance."""
    even = np.linspace(low, 110e3, 200)
    for present in (even, np.union1d(even, np.linspace(99e3, 101e3, 150))):
        more = _beyond(present, 1.5)
        assert more[-1] == pytest.approx(165e3) and more.size <= 250
        assert more[0] - 110e3 == pytest.approx(np.diff(more)[0]) and np.ptp(np.diff(more)) < 1e-6
    assert np.diff(_beyond(np.linspace(1e3, 110e3, 200), 1.5))[0] == pytest.approx(109e3 / 199, rel=0.02)


def test_the_tolerance_of_a_further_specimen_bounds_the_strength(setup, low):
    """A tolerance τ that acts as the cause does adds to its variance: 1/strength² grows by (τ/size)²."""
    kept, evaluation = low
    parameters, x = setup.with_effects({"wrong_width": 0.0})
    plan = Plan("as it is", evaluation, np.full(np.count_nonzero(kept), NOISE))
    width, tolerance, size = setup.library["wrong_width"], 2e-3, 0.01
    (one,) = width.parameters
    with_tolerance = replace(width, parameters=(replace(one, tolerance=tolerance),)).within_tolerance
    alone = strength(plan, Point(parameters, x), 0, size)
    bounded = strength(
        replace(plan, tolerances=(with_owner(with_tolerance, "the second"),)), Point(parameters, x), 0, size
    )
    assert bounded == pytest.approx((alone**-2 + (tolerance / size) ** 2) ** -0.5, rel=1e-4)
    assert bounded < 0.9 * alone


def test_strength_is_size_over_its_standard_deviation(setup, low):
    """Against the deviation of a fit to noise-free data."""
    kept, evaluation = low
    parameters, x = setup.with_effects({"wrong_width": 0.0})
    z = evaluation.impedance(parameters, x)
    plan = Plan("as it is", evaluation, np.full(z.size, NOISE))
    width = unbiased(setup.library["wrong_width"])
    found = fitted(evaluation, FREQUENCY[kept], z, setup.unknowns.with_candidate(width), x)
    # without misfit the noise level is estimated below 1, within the prior of the level; the division takes it out
    expected = 0.01 / (found.std[-1] / found.noise_scale * width.scale[0])
    assert np.exp(-3 * found.data.level_std) <= found.noise_scale * (1 + 1e-9) <= 1.0
    assert strength(plan, Point(parameters, x), 0, 0.01) == pytest.approx(expected, rel=1e-3)


def test_slopes_of_several_causes_at_rest_serve_each(setup, low):
    """A single evaluation with all causes serves the strengths of each alone, for two plans: one with the present
    noise, one with a third of it.
    """
    kept, evaluation = low
    keys = ["wrong_width", "electrode_mass", "leakage"]
    evaluated = []

    class Counted:
        @staticmethod
        def with_jacobian(parameters, x):
            evaluated.append(parameters.names)
            return evaluation.with_jacobian(parameters, x)

    plain = Plan("as it is", evaluation, np.full(np.count_nonzero(kept), NOISE))
    shared = replace(plain, evaluation=Remembered(Counted()))
    with_all = setup.unknowns
    for key in keys:
        with_all = with_all.with_candidate(setup.library[key])
    common_point = Point(with_all, with_all.carried(setup.unknowns, setup.x))
    for key in keys:
        parameters = setup.unknowns.with_candidate(setup.library[key])
        x, size = parameters.carried(setup.unknowns, setup.x), setup.library[key].scale[0]
        expected = strength(plain, Point(parameters, x), 0, size)
        for one in (shared, replace(shared, words="quieter", relative_noise=plain.relative_noise / 3)):
            found = strength(one, Point(parameters, x, common_point), 0, size)
            times = plain.relative_noise[0] / one.relative_noise[0]
            assert found == pytest.approx(expected * times, rel=1e-6 if times == 1 else 0.2)
    assert len(evaluated) == 1


def test_a_tolerance_lowers_the_strength_of_a_cause(setup):
    """A wrong s12, with a width known exactly or to 0.2 %: the plan predicts what a fit gives."""
    width = setup.library["wrong_width"]
    loose = replace(width, parameters=(replace(width.parameters[0], tolerance=2e-3),))
    found = []
    for effect in (width, loose):
        parameters = replace(setup.unknowns, effects=(effect,))
        parameters = parameters.with_candidate(setup.library["wrong_insensitive_parameter:s12"])
        x = parameters.carried(setup.unknowns, setup.x)
        plan = Plan("as it is", setup.evaluation, np.full(FREQUENCY.size, NOISE))
        found.append(strength(plan, Point(parameters, x), 1, 0.01))
        one = fitted(setup.evaluation, FREQUENCY, setup.evaluation.impedance(parameters, x), parameters, x)
        cause = parameters.effects[1]
        std = one.std[-2] / one.noise_scale * cause.scale[0]
        # the fit has a prior on the size of the cause, which the plan has not
        alone = 1 / np.sqrt(1 / std**2 - 1 / cause.spread[0] ** 2)
        assert found[-1] == pytest.approx(0.01 / alone, rel=2e-2)
    assert found[0] > 1.5 * found[1]


def test_readings_add_what_they_measure(setup, low):
    """A micrometer to 0.1 % separates a wrong width of 0.4 % by 4 σ on its own; a balance measures film and
    dimensions together.
    """
    kept, evaluation = low
    names = ("wrong_width", "electrode_mass", "stray_capacitance")
    effects = [setup.library[name] for name in names]
    constants = setup.material.constants(setup.x)
    context = EffectContext(117e3, ("s11",), constants, {"width": (1,)}, 7500.0, SIZE[2])
    found = dict(readings(effects, {"": context}))
    assert len(found) == 3
    weighed = found["weigh the specimen, to 0.1 %"]
    assert weighed["wrong_width", ""] == pytest.approx(1000.0)
    assert weighed["electrode_mass", ""] == pytest.approx(1000 * 2 / (7500 * SIZE[2]))
    dull = Plan("", evaluation, np.full(int(kept.sum()), 1e3))  # noise so large that the sweep has no information
    wide = setup.with_effects({"wrong_width": 0.004})
    plan = replace(dull, readings=found["measure the width with a micrometer, to 0.1 %"])
    assert strength(plan, Point(*wide), 0, 0.004) == pytest.approx(4.0, rel=1e-3)
    both = Point(*wide), Point(*setup.with_effects({"electrode_mass": 0.0}))
    assert separation(plan, *both) == pytest.approx(4.0, rel=1e-3)
    # the balance cannot separate width and film, which may weigh the same
    assert separation(replace(dull, readings=weighed), *both) < 0.1


def test_a_reading_that_the_fits_have_seen_counts_as_a_planned_one_does(setup, low):
    """The mass in the file of the specimen, against a planned weighing that is as exact."""
    kept, evaluation = low
    context = EffectContext(117e3, ("s11",), setup.material.constants(setup.x), {"width": (1,)}, DENSITY, SIZE[2])
    effects = [setup.library[name] for name in ("wrong_width", "electrode_mass")]
    weighed = dict(readings(effects, {"": context}))["weigh the specimen, to 0.1 %"]
    volume = float(np.prod(SIZE))
    mass = Reading("mass", DENSITY * volume, 1e-3 * DENSITY * volume, "", DENSITY, volume, SIZE[0] * SIZE[1])
    dull = Plan("", evaluation, np.full(int(kept.sum()), 1e3))
    wide, film = setup.with_effects({"wrong_width": 0.004}), setup.with_effects({"electrode_mass": 0.0})
    seen = [Point(replace(parameters, readings=(mass,)), x) for parameters, x in (wide, film)]
    balance = replace(dull, readings=weighed)
    assert strength(dull, seen[0], 0, 0.004) == pytest.approx(strength(balance, Point(*wide), 0, 0.004), rel=1e-3)
    assert strength(dull, Point(*wide), 0, 0.004) < 0.1 * strength(dull, seen[0], 0, 0.004)
    # film and width may weigh the same, without it any film may: neither is told from the other by the mass alone
    assert separation(dull, *seen) < 0.1


def test_a_balance_reads_whatever_changes_the_mass(setup):
    """The planned weighing of every effect, against differences of the mass that a fit would have as a reading."""
    context = EffectContext(117e3, ("s11", "d31", "eps33T"), setup.constants, AXES, DENSITY, SIZE[2], 2e3, SIZE)
    known = {effect.key: effect for effect in library(context)}
    weighed = dict(readings(list(known.values()), {"": context}))["weigh the specimen, to 0.1 %"]
    mass = DENSITY * float(np.prod(SIZE))
    balance = Reading("mass", mass, 1e-3 * mass, "", DENSITY, float(np.prod(SIZE)), SIZE[0] * SIZE[1])
    for key, effect in known.items():
        rest = setup.with_effects({key: effect.rest})
        own = rest[0].columns(0)
        slopes = balance.row(*rest)[1][own] / effect.scale
        planned = weighed.get((effect.name, ""), np.zeros(slopes.size))
        np.testing.assert_allclose(planned, slopes, rtol=1e-9, err_msg=key)
    assert {"wrong_density", "wrong_length", "film_stiffness", "point_mass"} <= {name for name, _ in weighed}


def test_each_of_two_fixtures_is_read_by_itself(setup, low):
    """Stray capacitances of two fixtures: two readings, each of which tells that of its own fixture, to 0.05 pF."""
    kept, evaluation = low
    effects = [with_owner(setup.library["stray_capacitance"], name) for name in ("jig", "clamp")]
    found = readings(effects, {})
    assert [words.partition(",")[0] for words, _ in found] == [
        f"measure the open fixture without the specimen ({name})" for name in ("jig", "clamp")
    ]
    dull = Plan("", evaluation, np.full(int(kept.sum()), 1e6))  # noise so large that the sweep has no information
    for own in range(2):
        parameters = setup.unknowns.with_candidate(effects[own])
        x = parameters.carried(setup.unknowns, setup.x)
        told = [strength(replace(dull, readings=slopes), Point(parameters, x), 0, 1e-12) for _, slopes in found]
        assert told[own] == pytest.approx(20.0, rel=1e-3) and told[1 - own] < 0.01


def test_a_weighed_piece_is_not_to_be_weighed(setup):
    """Its mass is known; its dimensions are measured all the same."""
    constants = setup.material.constants(setup.x)
    context = EffectContext(117e3, (), constants, AXES, DENSITY, SIZE[2], 2e3, SIZE, density_from_mass=True)
    words = dict(readings([effect for effect in library(context) if effect.resizes], {"": context}))
    assert words and not any("weigh" in one for one in words)


def test_recommendation_carries_the_figures():
    stray = EffectParameter("capacitance", "F", 0.0, 1e-9, 1e-12, 2e-11)
    share = EffectParameter("relative_error", "1", -0.1, 0.1, 0.005, 0.02)
    pairs = [
        Separation("sweep farther", "stray_capacitance", "eps33T", stray, 0.1, 412.3),
        Separation("sweep farther", "wrong_width", "s12", None, 0.1, 12.3),
        Separation("sweep farther", "wrong_thickness", "s11", share, 0.1, 9.0),
    ]
    assert summary(pairs) == (
        "sweep farther: expected to distinguish wrong_thickness of 2 % from s11 by 9.0 σ, "
        "wrong_width from s12 by 12 σ, stray_capacitance of 20 pF from eps33T by over 100 σ"
    )
    assert [one.to_json()["size"] for one in pairs] == ["2e-11 F", "", "0.02"]
