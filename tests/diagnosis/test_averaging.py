"""Constants averaged over sets of causes: the distribution by hand, and that its intervals hold what they say."""

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

#: Deviations within which a normal value is with the probability of the stated intervals.
REACH = norm.ppf((1 + LEVEL) / 2)


def test_one_part_is_normal():
    mean, std = np.array([1.6e-11, 0.02]), np.array([3e-14, 4e-5])
    one = Averaged(((),), (False,), np.ones(1), mean[None], std[None])
    assert one.below(mean + np.array([0, 4e-5])) == pytest.approx([0.5, norm.cdf(1)])
    away = (one.interval(LEVEL) - mean[:, None]) / std[:, None]
    assert away == pytest.approx(np.array([[-REACH, REACH]] * 2), abs=1e-3)


def test_a_faint_chance_of_far_away_lengthens_the_interval_by_what_it_takes_from_the_tails():
    """3 % far above, all of it beyond: above the end c are 0.97 (1 − Φ(c)) + 0.03, below 0.97 Φ(−c) is 0.025."""
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


def test_what_a_sweep_cannot_show_is_as_probable_as_before_and_widens_what_imitates_it(setup):
    """A stray capacitance is one with ε33T: its set has about the share it had before, and moves that alone."""
    library = [setup.library[name] for name in ("stray_capacitance", "series_resistance")]
    result = compare(setup.evaluation, data_with(setup, {}, 21), setup.unknowns, setup.x, library)
    one, final = result.averaged, result.final
    assert result.found == () and one.weights.sum() == pytest.approx(1)
    each = Rules().expected_causes / (len(library) + sum(WEIGHTS.values()))
    assert result.probabilities["stray_capacitance"] == pytest.approx(each, rel=0.5)
    shares = {causes: one.weights[[own == causes for own in one.causes]].sum() for causes in one.causes}
    assert shares[("stray_capacitance",)] == pytest.approx(result.probabilities["stray_capacitance"], abs=0.02)
    length = np.diff(one.interval(LEVEL))[:, 0] / (2 * REACH * final.std[:6] * np.abs(_units(final)))
    eps33T = 2 * final.parameters.material.free.names.index("eps33T")
    assert np.argmax(length) == eps33T and length[eps33T] > 1.02
    assert one.spread_by(eps33T, _value(final, eps33T)[0], (), False) == (("stray_capacitance",), False)
    assert np.all(np.delete(length, [eps33T, eps33T + 1]) < 1.1) and np.all(length > 0.99)


def test_of_a_clear_cause_the_intervals_are_those_of_its_set(setup):
    data = data_with(setup, {"series_resistance": 2.0}, 22)
    library, rules = [setup.library[name] for name in ("series_resistance", "leakage")], Rules(expected_causes=0.01)
    result = compare(setup.evaluation, data, setup.unknowns, setup.x, library, rules=rules)
    final, ends = result.final, result.averaged.interval(LEVEL)
    assert [one.effect.key for one in result.found] == ["series_resistance"]
    own = np.array([_value(final, place) for place in range(ends.shape[0])])
    away = (ends - own[:, :1]) / own[:, 1:]
    assert away == pytest.approx(np.array([[-1.0, 1.0]] * len(own)), abs=0.05)


@pytest.mark.slow
def test_intervals_hold_what_they_say_where_causes_are_as_frequent_as_assumed(setup):
    """Causes and sizes drawn from their priors: 95 % lie inside whatever was named, fewer by the named set alone."""
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
    scale = final.parameters.material.scale
    return np.stack([scale, np.ones_like(scale)], axis=1).ravel()


def _value(final, place: int) -> tuple[float, float]:
    """A constant or tangent of the named set in SI, and half the length of its interval."""
    unit = _units(final)[place]
    return unit * final.x[place], REACH * abs(unit) * final.std[place]
