"""Two effects at once: the gain that linearisation predicts for a pair, and a pair of which neither is the best
single effect.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from diagnosis.test_compare import data_with
from femu_piezo.diagnosis.rules import Rules
from femu_piezo.diagnosis.selection import _Search, compare
from femu_piezo.diagnosis.starts import _least_within, log_evidence_of_pairs, start_together, starts
from femu_piezo.diagnosis.verdict import judge
from femu_piezo.inference.fit import fit, linear_fit
from femu_piezo.inference.step import bounded_step

TRUTH = {"series_inductance": 4e-6, "electrode_mass": 0.08}


@pytest.fixture(scope="module")
def smooth(setup):
    """Effects of the library without sites and without dispersion."""
    return [effect for effect in setup.library.values() if effect.sites is None and not effect.dispersive]


def test_predicted_gain_of_two_effects_is_that_of_a_linearised_fit_with_both(setup):
    """Residual and slopes of single starts added, against a linearised fit with both effects: χ² within 1e-3."""
    data = data_with(setup, {"series_inductance": 3e-7, "electrode_mass": 0.002}, 2)
    base = fit(setup.evaluation, data, setup.unknowns, [setup.x])
    alone = [starts(setup.evaluation, base, setup.library[key])[0] for key in TRUTH]
    together = start_together(base, *alone)
    direct, _ = linear_fit(setup.evaluation, base, together.linear.parameters, together.x)
    assert together.promised_chi_square == pytest.approx(direct.chi_square, rel=1e-3)
    assert together.promised_chi_square < min(start.promised_chi_square for start in alone)
    assert np.allclose(together.alone()[: base.x.size], base.x)


def test_pair_of_which_neither_is_the_best_single_effect(setup, smooth):
    """An inductance and a film of mass are named though another single effect has the highest evidence."""
    data = data_with(setup, TRUTH, 1)
    result = compare(setup.evaluation, data, setup.unknowns, setup.x, smooth)
    verdict = judge(result)
    fitted = [trial for trial in result.singles if trial.fit is not None]
    assert max(fitted, key=lambda trial: trial.fit.log_evidence).effect.key not in TRUTH
    assert {cause.effect.key for cause in verdict.causes} == set(TRUTH) and verdict.word == "effect"
    for cause in verdict.causes:
        assert abs(cause.values[0] - TRUTH[cause.effect.key]) < 4 * cause.std[0]
        assert cause.probability > 0.9


def test_a_set_that_was_only_extrapolated_is_fitted_from_its_other_cause(setup, smooth):
    """Linearisation without causes promises the pair as much as a fit reaches, so that its χ² alone asks for no fit."""
    data = data_with(setup, TRUTH, 1)
    base = fit(setup.evaluation, data, setup.unknowns, [setup.x])
    alone = [starts(setup.evaluation, base, setup.library[key])[0] for key in TRUTH]
    single = fit(setup.evaluation, data, alone[1].linear.parameters, [alone[1].stepped()])
    truth = [setup.library[key] for key in TRUTH]
    both = fit(
        setup.evaluation, data, single.parameters.with_candidate(truth[0]), [start_together(base, *alone[::-1]).x]
    )
    search = _Search(base, setup.evaluation, smooth, Rules(), "linear", lambda step: None)
    search._keep([single, replace(both, extrapolated=True)])
    found = {effect.key: enlarged for effect, enlarged in search._expand(single)}
    assert not found[truth[0].key].extrapolated


@pytest.mark.slow
def test_pair_for_which_a_third_effect_is_more_probable_as_a_single_cause(setup, smooth):
    """By more than 10 in log odds; the pair is named all the same."""
    truth = {"wrong_thickness": -0.02, "electrode_mass": 0.08}
    data = data_with(setup, truth, 1, noise=3e-4)  # at 1e-3 a wrong s12 alone leaves no more than the noise
    result = compare(setup.evaluation, data, setup.unknowns, setup.x, smooth)
    odds = {trial.effect.key: trial.log_odds for trial in result.singles}
    assert max(odds[key] for key in set(odds) - set(truth)) > odds["wrong_thickness"] + 10
    assert {found.effect.key for found in result.causes} == set(truth)
    for found in result.causes:
        (named,) = [trial for trial in found.fits if trial.effect.key == found.effect.key]
        assert named.log_odds == 0 and abs(named.values[0] - truth[found.effect.key]) < 4 * named.std[0]


@pytest.mark.slow
def test_pair_with_an_effect_whose_slope_vanishes_at_rest(setup, smooth):
    """Bare end strips act with the square of their width, and a wrong width."""
    data = data_with(setup, {"electrode_margin": 0.2e-3, "wrong_width": 0.004}, 1)
    result = compare(setup.evaluation, data, setup.unknowns, setup.x, smooth)
    assert {found.effect.key for found in result.causes} == {"electrode_margin", "wrong_width"}


def test_no_pair_where_nothing_is_left(setup, smooth):
    """A sweep without an effect: every single candidate is tried and less probable than none, and no pair is.

    Candidates at a place, whose operators cost the most, are tried only where a misfit remains.
    """
    result = compare(setup.evaluation, data_with(setup, {}, 3), setup.unknowns, setup.x, smooth)
    assert len(result.singles) == sum(effect.local is None for effect in smooth) < len(smooth)
    assert result.causes == () and not result.discrepant
    assert max(trial.log_odds for trial in result.singles) < 0


def test_predicted_evidence_of_all_pairs_is_that_of_each(setup, smooth):
    """The small systems of all pairs at once against the linearised fit of each pair, in log evidence.

    Within 10 % of the gain and 2, since the two take the unknowns of the base fit to move at different noise levels.
    """
    base = fit(setup.evaluation, data_with(setup, TRUTH, 1), setup.unknowns, [setup.x])
    alone = [starts(setup.evaluation, base, effect)[0] for effect in smooth[:9]]
    promises = log_evidence_of_pairs(base, alone)
    for first, second in combinations(range(len(alone)), 2):
        each = start_together(base, alone[first], alone[second]).linear.log_evidence
        above = promises[first, second] - each
        assert abs(above) < 0.1 * (each - base.log_evidence) + 2


def test_nearly_parallel_causes_are_not_both_held_where_one_leaves_its_bounds():
    """The one farthest outside is held on its bound, and the other returns inside: the minimum within bounds."""
    matrix = np.eye(2) + 1e6 * np.array([[1.0, 0.9999], [0.9999, 1.0]])
    slope, low, high = -matrix @ [30.0, -28.0], np.array([-5.0, 0.0]), np.array([5.0, 5.0])
    factor = np.linalg.cholesky(matrix)
    least = bounded_step(factor.T, np.linalg.solve(factor, slope), low, high)
    found = _least_within(matrix[None], slope[None], low[None], high[None])[0]
    assert found == pytest.approx(least, rel=1e-6, abs=1e-7)  # `bounded_step` may pass a bound by 1e-8
    assert 0 < found[0] < 5
