"""Constants averaged over sets of causes: the mixture distribution by hand, and that its intervals hold the truth as
often as stated.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm

from diagnosis.test_compare import data_with
from femu_piezo.diagnosis.averaging import LEVEL, Averaged
from femu_piezo.diagnosis.rules import Rules
from femu_piezo.diagnosis.selection import compare
from femu_piezo.measurement.discrepancy_forms import WEIGHTS

#: Half-width of the stated intervals for a normal value, in standard deviations.
REACH = norm.ppf((1 + LEVEL) / 2)


def test_one_part_is_normal():
    """A single set of causes: probabilities and interval are those of a normal distribution."""
    mean, std = np.array([1.6e-11, 0.02]), np.array([3e-14, 4e-5])
    one = Averaged(((),), (False,), np.ones(1), mean[None], std[None])
    assert one.below(mean + np.array([0, 4e-5])) == pytest.approx([0.5, norm.cdf(1)])
    away = (one.interval(LEVEL) - mean[:, None]) / std[:, None]
    assert away == pytest.approx(np.array([[-REACH, REACH]] * 2), abs=1e-3)


def test_an_improbable_set_far_away_lengthens_the_interval():
    """A set with 3 % whose value lies 1e4 deviations above: ends of the intervals are quantiles of the mixture, by
    hand.

    0.97 Φ(c) is 0.025 at the lower end of the 95 % interval and 0.95 at the upper end of the 90 % interval. With a wide
    second set the upper end lies inside it, found by a root search.
    """
    two, parts = ((), ("cable",)), (np.array([0.97, 0.03]), np.array([[0.0], [1e4]]), np.array([[1.0], [2.0]]))
    one = Averaged(two, (False, False), *parts)
    assert one.interval(0.95)[0, 0] == pytest.approx(norm.ppf(0.025 / 0.97), abs=1e-3)
    assert one.interval(0.9)[0, 1] == pytest.approx(norm.ppf(0.95 / 0.97), abs=1e-3)
    assert one.spread_by(0, 0.0, (), False) == (("cable",), False)
    assert one.spread_by(0, 0.0, ("cable",), False) == ((), False)
    assert replace(one, causes=((), ()), discrepant=(False, True)).spread_by(0, 0.0, (), False) == ((), True)
    above = replace(one, std=np.array([[1.0], [5e3]]))
    by_hand = brentq(lambda at: 0.97 * norm.cdf(at) + 0.03 * norm.cdf((at - 1e4) / 5e3) - 0.975, 0, 1e5)
    assert above.interval(0.95)[0, 1] == pytest.approx(by_hand, rel=1e-6)


def test_a_cause_that_the_sweep_cannot_show_keeps_its_prior_probability(setup):
    """A stray capacitance acts as an error of ε33T does: its set keeps about its prior probability, and widens the
    interval of ε33T alone.
    """
    library = [setup.library[name] for name in ("stray_capacitance", "series_resistance")]
    result = compare(setup.evaluation, data_with(setup, {}, 21), setup.unknowns, setup.x, library)
    one, final = result.averaged, result.final
    assert result.causes == () and one.weights.sum() == pytest.approx(1)
    each = Rules().expected_causes / (len(library) + sum(WEIGHTS.values()))
    assert result.probabilities["stray_capacitance"] == pytest.approx(each, rel=0.5)
    shares = {causes: one.weights[[own == causes for own in one.causes]].sum() for causes in one.causes}
    assert shares[("stray_capacitance",)] == pytest.approx(result.probabilities["stray_capacitance"], abs=0.02)
    length = np.diff(one.interval(LEVEL))[:, 0] / (2 * REACH * final.std[:6] * np.abs(_units(final)))
    eps33T = 2 * final.parameters.material.free.names.index("eps33T")
    assert np.argmax(length) == eps33T and length[eps33T] > 1.02
    assert one.spread_by(eps33T, _value(final, eps33T)[0], (), False) == (("stray_capacitance",), False)
    assert np.all(np.delete(length, [eps33T, eps33T + 1]) < 1.1) and np.all(length > 0.99)


def test_with_a_clear_cause_the_intervals_are_those_of_its_set(setup):
    """A series resistance of 2 ohm, within 5 % of half an interval."""
    data = data_with(setup, {"series_resistance": 2.0}, 22)
    library, rules = [setup.library[name] for name in ("series_resistance", "leakage")], Rules(expected_causes=0.01)
    result = compare(setup.evaluation, data, setup.unknowns, setup.x, library, rules=rules)
    final, ends = result.final, result.averaged.interval(LEVEL)
    assert [one.effect.key for one in result.causes] == ["series_resistance"]
    of_set = np.array([_value(final, place) for place in range(ends.shape[0])])
    away = (ends - of_set[:, :1]) / of_set[:, 1:]
    assert away == pytest.approx(np.array([[-1.0, 1.0]] * len(of_set)), abs=0.05)


@pytest.mark.slow
def test_intervals_hold_what_they_say_where_causes_are_as_frequent_as_assumed(setup):
    """400 draws with causes and sizes from their priors: 95 % of true values lie in the averaged intervals.

    Fewer lie in the intervals of the named set alone; beyond four deviations lie less than 0.2 % of the values by the
    average and more than 1 % by the named set.
    """
    library = [setup.library[name] for name in ("stray_capacitance", "series_resistance", "wrong_width")]
    each = Rules().expected_causes / (len(library) + sum(WEIGHTS.values()))
    rng, inside, by_named, beyond, beyond_named = np.random.default_rng(5), [], [], [], []
    for seed in range(400):
        sizes = {}
        for effect in library:
            size = effect.parameters[0].spread * 0.01 ** rng.random() * rng.standard_normal()
            if rng.random() < each:
                sizes[effect.key] = abs(size) if effect.parameters[0].low == 0 else size
        data = data_with(setup, sizes, 5000 + seed)
        result = compare(setup.evaluation, data, setup.unknowns, setup.x, library)
        ends, below = result.averaged.interval(LEVEL), result.averaged.below(truth := _units(result.final) * setup.x)
        own = np.array([_value(result.final, place) for place in range(truth.size)])
        inside.append((ends[:, 0] < truth) & (truth < ends[:, 1]))
        by_named.append(np.abs(truth - own[:, 0]) < own[:, 1])
        beyond.append(np.minimum(below, 1 - below) < norm.cdf(-4))
        beyond_named.append(np.abs(truth - own[:, 0]) > 4 / REACH * own[:, 1])
    assert 0.93 < np.mean(inside) < 0.97
    assert np.mean(by_named) < np.mean(inside)
    assert np.mean(beyond) < 0.002 < 0.01 < np.mean(beyond_named)


def _units(final) -> np.ndarray:
    """(6,) SI units of constants and tangents in the order of x."""
    scale = final.parameters.material.scale
    return np.stack([scale, np.ones_like(scale)], axis=1).ravel()


def _value(final, place: int) -> tuple[float, float]:
    """A constant or tangent of the named set of causes in SI, and half the length of its interval."""
    unit = _units(final)[place]
    return unit * final.x[place], REACH * abs(unit) * final.std[place]
