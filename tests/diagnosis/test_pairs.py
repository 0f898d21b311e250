"""Two effects at once: what linearisation of both promises, and a pair of which neither is the best single effect."""

from __future__ import annotations

import numpy as np
import pytest
from femu_piezo.diagnosis.compare import compare
from femu_piezo.diagnosis.search import best_pair
from femu_piezo.inference.joint import JointParameters

from diagnosis.conftest import FREQUENCY
from diagnosis.test_compare import data_with
from femu_piezo.diagnosis.confounding import tangents
from femu_piezo.diagnosis.starts import start_together, starts
from femu_piezo.diagnosis.verdict import judge
from femu_piezo.inference.fit import fit_joint, linear_fit

TRUTH = {"series_inductance": 4e-6, "electrode_mass": 0.08}


@pytest.fixture(scope="module")
def smooth(setup):
    return [effect for effect in setup.library.values() if effect.sites is None and not effect.dispersive]


def test_slopes_of_two_effects_together_promise_what_both_in_one_fit_do(setup):
    data = data_with(setup, {"series_inductance": 3e-7, "electrode_mass": 0.002}, 2)
    base = fit_joint(setup.evaluation, data, JointParameters(setup.material), [setup.x])
    alone = [starts(setup.evaluation, data, base, setup.library[key])[0] for key in TRUTH]
    together = start_together(data, base, *alone)
    parameters = together.linear.parameters
    direct = linear_fit(setup.evaluation, data, parameters, together.x, np.arange(together.x.size))
    assert together.promised == pytest.approx(direct.chi_square, rel=1e-3)
    assert together.promised < min(start.promised for start in alone)
    assert np.allclose(together.alone()[: base.x.size], base.x)


def test_pair_of_which_neither_is_the_best_single_effect(setup, smooth):
    data = data_with(setup, TRUTH, 1)
    result = compare(setup.evaluation, data, JointParameters(setup.material), setup.x, smooth)
    verdict = judge(result, tangents(setup.evaluation, result.base, smooth), FREQUENCY)
    best = min((fit.bic, effect.key) for effect, fit in result.singles if fit is not None)[1]
    assert best not in TRUTH
    assert {cause.effect.key for cause in verdict.causes} == set(TRUTH) and verdict.word == "effect"
    for cause in verdict.causes:
        assert abs(cause.values[0] - TRUTH[cause.effect.key]) < 4 * cause.std[0]
        assert cause.probability > 0.9


def test_pair_with_an_effect_whose_slope_vanishes_at_rest(setup, smooth):
    """A bare strip acts with the square of its width."""
    data = data_with(setup, {"electrode_margin": 0.2e-3, "wrong_width": 0.004}, 1)
    base = fit_joint(setup.evaluation, data, JointParameters(setup.material), [setup.x])
    pair = best_pair(setup.evaluation, data, base, smooth)
    assert {effect.key for effect in pair.parameters.effects} == {"electrode_margin", "wrong_width"}


def test_no_pair_where_nothing_is_left(setup, smooth):
    data = data_with(setup, {}, 3)
    base = fit_joint(setup.evaluation, data, JointParameters(setup.material), [setup.x])
    pair = best_pair(setup.evaluation, data, base, smooth)
    assert pair is None or base.bic - pair.bic < 6
