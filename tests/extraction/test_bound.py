"""Poles and zeros reach the Cramér-Rao bound, and stated deviations are the true ones."""

import numpy as np
import pytest

from femu_piezo.extraction import extract
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from tests.noise import noisy

from .bar import Bar, close_pair, truth_of
from .bounds import cramer_rao, score

BAR = Bar()


def study(truth, frequency, noise, draws, seed=0):
    """Scores of the first pole and zero over `draws` draws, against the bound."""
    bound = cramer_rao(truth, frequency, noise)
    omega = 2 * np.pi * frequency
    exact = 1 / (1j * omega * truth.charge(omega))
    errors, stated = {"pole": [], "zero": []}, {"pole": [], "zero": []}
    for draw in range(draws):
        found = extract(ImpedanceSpectrum(frequency, noisy(exact, noise, [seed, draw]))).resonances
        for kind, group, values in (("pole", found.poles, truth.poles), ("zero", found.zeros, truth.zeros)):
            assert len(group) == len(values)
            nearest = min(group, key=lambda r, value=values[0]: abs(r.eigenvalue - value))
            errors[kind].append(nearest.eigenvalue - values[0])
            stated[kind].append(np.sqrt(np.diag(nearest.covariance)))
    return {
        kind: score(errors[kind], stated[kind], (bound.poles if kind == "pole" else bound.zeros)[0]) for kind in errors
    }


@pytest.mark.parametrize(("low", "high", "mode"), [(28e3, 48e3, 1), (90e3, 130e3, 2)])
def test_bound_in_a_few_draws(low, high, mode):
    draws = 16
    for s in study(truth_of(BAR, mode), np.linspace(low, high, 401), 1e-3, draws).values():
        # mean of 2·draws squared Gaussian errors: four of its standard deviations above the goal of 1.15
        assert s.rms**2 < 1.15**2 * (1 + 4 / np.sqrt(draws))
        assert s.rms**2 > 1 - 4 / np.sqrt(draws)
        assert s.cover95 > 0.95 - 4 * np.sqrt(0.95 * 0.05 / (2 * draws))


@pytest.mark.slow
@pytest.mark.parametrize("noise", [1e-4, 1e-3, 3e-3])
@pytest.mark.parametrize(("low", "high", "mode"), [(28e3, 48e3, 1), (90e3, 130e3, 2)])
def test_goals_of_the_extraction(low, high, mode, noise):
    for s in study(truth_of(BAR, mode), np.linspace(low, high, 401), noise, 400, seed=1).values():
        assert s.rms <= 1.15
        assert s.bias < 0.2
        assert 0.63 <= s.cover68 <= 0.73
        assert 0.92 <= s.cover95 <= 0.98


@pytest.mark.slow
@pytest.mark.parametrize(
    "frequency",
    [np.linspace(28e3, 48e3, 61), np.linspace(28e3, 48e3, 1601), np.geomspace(28e3, 48e3, 201)],
    ids=["61", "1601", "log"],
)
def test_goals_on_other_grids(frequency):
    for s in study(truth_of(BAR, 1), frequency, 1e-3, 400, seed=2).values():
        assert s.rms <= 1.15
        assert 0.63 <= s.cover68 <= 0.73
        assert 0.92 <= s.cover95 <= 0.98


@pytest.mark.kernels
def test_two_modes_one_percent_and_forty_decibel_apart():
    truth, frequency = close_pair(BAR), np.linspace(28e3, 48e3, 401)
    omega = 2 * np.pi * frequency
    found = extract(ImpedanceSpectrum(frequency, 1 / (1j * omega * truth.charge(omega)))).resonances
    assert [r.eigenvalue for r in found.poles] == pytest.approx(truth.poles, rel=1e-8)
    assert sorted((r.eigenvalue for r in found.zeros), key=abs) == pytest.approx(sorted(truth.zeros, key=abs), rel=1e-8)
    for s in study(truth, frequency, 1e-4, 10).values():
        assert s.rms**2 < 1.15**2 * (1 + 4 / np.sqrt(10))


@pytest.mark.kernels
def test_no_mode_is_invented():
    """White noise on a capacitor, and on one mode: no further mode is reported."""
    frequency = np.linspace(50e3, 80e3, 301)
    for seed in range(20):
        z = noisy(1 / (2j * np.pi * frequency * 1e-9 * (1 - 0.015j)), 1e-3, [3, seed])
        assert extract(ImpedanceSpectrum(frequency, z)).status == "no_resonance"
