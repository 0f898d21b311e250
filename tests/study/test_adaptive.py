"""An adaptive sweep: what it reaches, when it ends, and that no narrow resonance is missed.

The data come from an independent discretisation (`hidden_effects`), with every quantity off by its tolerance.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hidden_effects.draws import Draw, draw

from femu_piezo.errors import InputError
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.study.adaptive import Wish, adapt, joined, next_frequencies, watching
from femu_piezo.study.linearised import Linearised, _median_over
from femu_piezo.study.update import update
from tests.study.bench import BAND, Bench, specimen_of

#: Peak of |ΔZ/Z| above which a resonance is plainly visible in a dense sweep.
PLAIN = 0.1


@pytest.fixture(scope="module")
def drawn() -> Draw:
    return draw("laboratory:none", 3)


@pytest.fixture
def specimen(drawn, tmp_path):
    return specimen_of(drawn, tmp_path)


@pytest.mark.slow
def test_hundred_points_tell_what_four_hundred_equally_spaced_do(drawn, specimen, bases):
    """Deviations are at most 10 % larger, that of the tangent of s11, which noise limits, smaller; the truth lies
    within 4 of them.
    """
    bench = Bench(drawn)
    found = adapt(specimen, bench, Wish(points=100, band_Hz=BAND), bases=bases)
    assert found.ended == "points" and len(found.spectrum) == 100 == sum(one.size for one in bench.asked)
    assert all(BAND[0] <= one.min() and one.max() <= BAND[1] for one in bench.asked)
    dense = update(specimen, bases=bases, spectra=[bench(np.linspace(*BAND, 401))]).parameters
    last = found.states[-1].deviations
    for name, one in dense.items():
        assert last[name] < 1.1 * one.std / abs(one.value) and last[f"tan_{name}"] < 1.1 * one.tan_std
    assert last["tan_s11"] < dense["s11"].tan_std
    after = update(specimen, bases=bases, spectra=[found.spectrum]).parameters
    for name, one in after.items():
        truth = drawn.theta[["s11", "s12", "s13", "s33", "s44", "d31", "d33", "d15", "eps11T", "eps33T"].index(name)]
        assert abs(one.value - truth.real) < 4 * one.std and abs(one.tan + truth.imag / truth.real) < 4 * one.tan_std
    assert found.states[-1].departures == ()


@pytest.mark.slow
def test_it_ends_when_the_wanted_deviation_is_reached(drawn, specimen, bases):
    """The tangent of s11 to 0.7 of what the first points state."""
    coarse = adapt(specimen, Bench(drawn), Wish(points=64, band_Hz=BAND), bases=bases)
    goal = {"tan_s11": 0.7 * coarse.states[0].deviations["tan_s11"]}
    found = adapt(specimen, Bench(drawn), Wish(points=400, band_Hz=BAND, deviations=goal), bases=bases)
    assert found.ended == "deviations" and len(found.spectrum) < 400
    assert found.states[-1].deviations["tan_s11"] <= goal["tan_s11"] < coarse.states[0].deviations["tan_s11"]


def test_it_ends_when_more_points_would_not_help(drawn, specimen, bases):
    """The tolerances of density and length leave s11 an uncertainty of about 0.5 %, whatever is measured."""
    wish = Wish(points=400, band_Hz=BAND, deviations={"s11": 1e-4})
    found = adapt(specimen, Bench(drawn), wish, bases=bases)
    assert found.ended == "tolerances" and len(found.spectrum) < 400
    assert found.states[-1].deviations["s11"] > 1e-3 and "tolerances" in found.sentence
    assert found.sentence.endswith("would have been visible") == (not found.states[-1].departures)


def test_an_interrupted_measurement_is_resumed(drawn, specimen, bases):
    """No point is measured twice, and the budget of points counts the existing ones."""
    wish = Wish(points=100, band_Hz=BAND)
    first = Bench(drawn)
    begun = first(watching(BAND, 100)[:37])
    bench = Bench(drawn)
    found = adapt(specimen, bench, wish, begun, bases=bases)
    again = np.concatenate(bench.asked)
    assert again.size == 63 and np.unique(np.concatenate([again, begun.frequency])).size == 100
    assert np.all(np.isin(begun.frequency, found.spectrum.frequency))


@pytest.mark.parametrize(
    ("before", "points", "asked"),
    [(70, 100, 30), (98, 100, 2), (100, 64, 0), pytest.param(32, 64, 32, marks=pytest.mark.slow)],
)
def test_points_of_a_measurement_with_another_number_of_points_count(drawn, specimen, bases, before, points, asked):
    begun, bench = Bench(drawn)(np.linspace(*BAND, before)), Bench(drawn)
    found = adapt(specimen, bench, Wish(points=points, band_Hz=BAND), begun, bases=bases)
    assert sum(one.size for one in bench.asked) == asked and found.ended == "points"
    assert len(found.spectrum) == before + asked


@pytest.mark.slow
def test_the_next_frequencies_without_an_instrument_are_those_of_the_loop(drawn, specimen):
    """`next_frequencies` after the first points gives the second request of the loop."""
    bench = Bench(drawn)
    adapt(specimen, bench, Wish(points=100, band_Hz=BAND))
    first = Bench(drawn)(bench.asked[0])
    assert next_frequencies(specimen, first, Wish(points=100, band_Hz=BAND)) == pytest.approx(bench.asked[1])


def test_points_at_one_frequency_are_averaged():
    first = ImpedanceSpectrum(np.array([1.0, 2.0]), np.array([1.0, 4.0 + 0j]))
    together = joined(first, ImpedanceSpectrum(np.array([2.0, 3.0]), np.array([6.0 + 2j, 1.0])))
    assert together.frequency.tolist() == [1.0, 2.0, 3.0] and together.impedance[1] == 5.0 + 1j


@pytest.mark.parametrize(
    ("wish", "words"),
    [
        (Wish(points=20), "at least 32"),
        (Wish(deviations={"s33": 0.01}), "s33"),
        (Wish(deviations={"s11": 0.0}), "0.005"),
        (Wish(band_Hz=(2e5, 1e5)), "no band"),
    ],
)
def test_impossible_wishes_are_refused_before_anything_is_measured(specimen, drawn, wish, words):
    bench = Bench(drawn)
    with pytest.raises(InputError, match=words):
        adapt(specimen, bench, wish)
    assert not bench.asked


def test_a_sweep_without_a_resonance_ends_with_the_reason(drawn, specimen, bases):
    """A capacitor: the whole budget of points goes into the search for a resonance."""

    def capacitor(frequency: np.ndarray) -> ImpedanceSpectrum:
        normal = np.random.default_rng(frequency.size).standard_normal(frequency.size)
        return ImpedanceSpectrum(frequency, (1 + 5e-4 * normal) / (2j * np.pi * frequency * 1e-9) + 1.0)

    with pytest.raises(InputError, match="no resonance"):
        adapt(specimen, capacitor, Wish(points=64, band_Hz=BAND), bases=bases)


def hidden(seed: int, expected_quality: float) -> tuple[float, float, float]:
    """A mode (f, Q, k_eff²) at a random place, with one to four times the expected Q, whose narrowest peak is
    plainly visible.
    """
    rng = np.random.default_rng([2126, seed])
    quality = expected_quality * np.exp(rng.uniform(0, np.log(4)))
    return float(rng.uniform(60e3, 235e3)), float(quality), float(PLAIN / quality * np.exp(rng.uniform(0, np.log(10))))


def misses(seeds, folder: Path, bases) -> list[int]:
    """Seeds whose mode is visible in a dense sweep, but is not reported as a departure near its place, or has fewer
    than 3 of the 100 points within a bandwidth.
    """
    found, shown = [], 0
    for seed in seeds:
        drawn = draw("laboratory:none", seed % 5)
        bench = Bench(drawn, hidden(seed, expected_quality=65))
        dense = np.linspace(*BAND, 801)
        without = Bench(drawn).clean(dense)
        if np.max(np.abs(bench.clean(dense) / without - 1)) < PLAIN / 2:
            continue
        shown += 1
        result = adapt(specimen_of(drawn, folder), bench, Wish(points=100, band_Hz=BAND), bases=bases)
        place, quality, _ = bench.mode
        near = np.abs(np.array(result.states[-1].departures) - place) < place / quality
        within = np.abs(result.spectrum.frequency - place) < place / quality
        if not np.any(near) or np.sum(within) < 3:
            found.append(seed)
    assert shown > 0.6 * len(seeds)
    return found


def test_crowded_points_do_not_move_the_median_over_the_band():
    """Ninety points within a hundredth of the band, where values are 30 times as large: the median over frequency is
    that of the rest.
    """
    frequency = np.union1d(np.linspace(0.0, 100.0, 101), np.linspace(50.01, 50.99, 90))
    values = np.where(np.abs(frequency - 50.5) < 0.5, 30.0, 1.0) + 1e-3 * frequency
    assert np.median(values) > 1.05 and _median_over(np.gradient(frequency), values) == pytest.approx(1.05, abs=2e-3)


@pytest.mark.parametrize(("share", "seen"), [(1.0, True), (0.7, False)])
def test_a_mode_of_the_least_coupling_departs_in_the_middle_of_the_widest_gap(share, seen):
    """A lossless mode of `share` times that coupling, Y = jωC [1 + k²/(1 − (f/f0)²)], between two of the points that
    are farthest apart; its neighbours have no noise of their own.
    """
    frequency, noise = np.linspace(100e3, 110e3, 41), 1e-3
    about = object.__new__(Linearised)
    about._frequency, about._noise, about._reach = frequency, np.full(frequency.size, noise), 0.0
    about._resonances = np.array([(2 * np.pi * 105e3) ** 2])
    square, place = share * about.least_coupling() ** 2, frequency[19:21].mean()
    assert about.least_coupling() ** 2 == pytest.approx(4 * np.sqrt(1.5) * noise * 250 / 100.25e3, rel=1e-3)
    about.__dict__["_log_error"] = np.log(1 + square / (1 - (frequency / place) ** 2)) + 0j
    assert bool(np.any(about._departing_from(0.0))) == seen


@pytest.mark.slow
def test_a_hidden_narrow_mode_is_found(tmp_path, bases):
    assert misses(range(1), tmp_path, bases) == []


@pytest.mark.slow
def test_no_hidden_narrow_mode_that_a_dense_sweep_shows_is_missed(tmp_path, bases):
    assert misses(range(50), tmp_path, bases) == []
