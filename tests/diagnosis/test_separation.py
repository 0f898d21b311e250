"""Expected separations against what fits to the planned data then reach."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from femu_piezo.inference.blocks import Prior
from femu_piezo.inference.joint import JointParameters

from diagnosis.conftest import FREQUENCY, SIZE
from femu_piezo.diagnosis.next_measurement import Plan, Point, Separation, between, strength, summary
from femu_piezo.diagnosis.readings import readings
from femu_piezo.effects.effect import EffectContext
from femu_piezo.inference.fit import SweepData, fit_joint
from femu_piezo.inference.response import Evaluation

NOISE = 1e-3
NO_PRIOR = Prior({})


@pytest.fixture(scope="module")
def low(setup):
    """Points below the width modes, and the evaluation there."""
    kept = FREQUENCY < 126e3
    return kept, Evaluation(setup.model, setup.evaluation.omega[kept])


def unbiased(effect):
    """The effect without a prior on its size."""
    return replace(effect, parameters=(replace(effect.parameters[0], spread=1e6),))


def fitted(evaluation, impedance, parameters, start):
    data = SweepData(impedance, np.full(impedance.size, NOISE), True, NO_PRIOR)
    return fit_joint(evaluation, data, parameters, [start])


def test_wider_band_separates_as_a_fit_to_it_does(setup, low):
    """Noise-free data of one cause up to 126 kHz; what the other cause misses in the band up to 225 kHz."""
    kept, evaluation = low
    width, wrong = setup.library["wrong_width"], unbiased(setup.library["wrong_insensitive_parameter:s13"])
    first = JointParameters(setup.material).with_effect(width)
    truth = np.append(setup.x, 0.004 / width.scale)
    z = setup.evaluation.impedance(first, truth)
    second = JointParameters(setup.material).with_effect(wrong)
    start = np.append(setup.x, 0.1)
    narrow = fitted(evaluation, z[kept], second, start)
    plan = Plan("wider band", setup.evaluation, np.full(z.size, NOISE))
    present = replace(plan, evaluation=evaluation, relative_noise=plan.relative_noise[kept])
    points = Point(first, truth), Point(second, narrow.x)
    expected = between(plan, *points, NO_PRIOR)
    reached = np.linalg.norm(fitted(setup.evaluation, z, second, narrow.x).residual)
    assert expected == pytest.approx(reached, rel=0.1)
    assert between(present, *points, NO_PRIOR) == pytest.approx(np.linalg.norm(narrow.residual), rel=0.05)
    assert expected > 5 * between(present, *points, NO_PRIOR)
    quiet = replace(plan, relative_noise=plan.relative_noise / 3)
    assert between(quiet, *points, NO_PRIOR) == pytest.approx(3 * expected, rel=1e-6)


def test_strength_is_size_over_its_standard_deviation(setup, low):
    _, evaluation = low
    width = setup.library["wrong_width"]
    parameters = JointParameters(setup.material).with_effect(width)
    x = np.append(setup.x, 0.0)
    z = evaluation.impedance(parameters, x)
    plan = Plan("as it is", evaluation, np.full(z.size, NOISE))
    fit = fitted(evaluation, z, JointParameters(setup.material).with_effect(unbiased(width)), x)
    expected = 0.01 / (fit.std[-1] * width.scale[0])
    assert strength(plan, Point(parameters, x), 0, 0.01, NO_PRIOR) == pytest.approx(expected, rel=1e-3)


def test_readings_add_what_they_measure(setup, low):
    """A micrometer alone tells a width by 1/0.1 %; a balance weighs film and dimensions together."""
    kept, evaluation = low
    names = ("wrong_width", "electrode_mass", "stray_capacitance")
    effects = [setup.library[name] for name in names]
    constants = setup.material.constants(setup.x)
    context = EffectContext(117e3, ("s11",), constants, {"width": 1}, 7500.0, SIZE[2])
    found = dict(readings(effects, {"": context}))
    assert len(found) == 3
    weighed = found["weigh the specimen, to 0.1 %"]
    assert weighed["wrong_width", ""] == pytest.approx(1000.0)
    assert weighed["electrode_mass", ""] == pytest.approx(1000 * 2 / (7500 * SIZE[2]))
    dull = Plan("", evaluation, np.full(int(kept.sum()), 1e3))  # a sweep that tells nothing
    parameters = JointParameters(setup.material).with_effect(effects[0])
    x = np.append(setup.x, 0.0)
    plan = replace(dull, readings=found["measure the width with a micrometer, to 0.1 %"])
    assert strength(plan, Point(parameters, x), 0, 0.004, NO_PRIOR) == pytest.approx(4.0, rel=1e-3)
    film = JointParameters(setup.material).with_effect(effects[1])
    both = Point(parameters, np.append(setup.x, 0.004 / 0.005)), Point(film, np.append(setup.x, 0.0))
    assert between(plan, *both, NO_PRIOR) == pytest.approx(4.0, rel=1e-3)
    # the balance cannot tell them: a film may weigh as much
    assert between(replace(dull, readings=weighed), *both, NO_PRIOR) < 0.1


def test_recommendation_carries_the_figures():
    pairs = [
        Separation("sweep farther", "stray_capacitance", "eps33T", "2e-11 F", 0.1, 412.3),
        Separation("sweep farther", "wrong_width", "s12", "", 0.1, 12.3),
    ]
    assert summary(pairs) == (
        "sweep farther: expected separation of wrong_width from s12 12 σ, stray_capacitance of 2e-11 F from eps33T "
        "over 100 σ"
    )
