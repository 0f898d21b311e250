"""Tests of the residual of a fit: false alarms counted on white noise, and structure found."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from femu_piezo.diagnosis import whiteness as module
from femu_piezo.diagnosis.whiteness import remaining, unexplained_share, whiteness


def test_false_alarm_rate_on_white_noise():
    """Of 2000 residuals of white noise at most 1 % are called structured (nominal 0.4 %), with the noise known."""
    rng = np.random.default_rng(1)
    frequency = np.linspace(1e3, 1e5, 300)
    alarms = sum(remaining(rng.standard_normal(600), 0, frequency, True).structured for _ in range(2000))
    assert 1 <= alarms <= 20


def test_p_values_of_whiteness_are_uniform():
    rng = np.random.default_rng(2)
    values = np.array([whiteness(rng.standard_normal(600)) for _ in range(2000)])
    for level in (0.01, 0.1, 0.5):
        assert np.mean(values < level) == pytest.approx(level, abs=4 * np.sqrt(level / 2000) + 0.15 * level)


def test_noise_level_affects_the_size_of_the_residual_but_not_its_whiteness():
    """A residual 1.2 times the stated noise is structured only where the noise is known."""
    noise = np.random.default_rng(3).standard_normal(600)
    assert whiteness(3 * noise) == pytest.approx(whiteness(noise))
    frequency = np.linspace(1e3, 1e5, 300)
    assert remaining(1.2 * noise, 0, frequency, True).structured
    assert not remaining(1.2 * noise, 0, frequency, False).structured


def test_structure_below_the_noise_does_not_count():
    """A smooth residual counts at one standard deviation of the noise and not at a tenth of it."""
    smooth = np.sin(np.linspace(0, 20, 600))
    frequency = np.linspace(1e3, 1e5, 300)
    assert remaining(smooth, 0, frequency, False).structured
    assert not remaining(0.1 * smooth, 0, frequency, False).structured


def test_a_bump_is_found_and_placed():
    """A smooth bump of 3 σ, about a twelfth of the sweep wide, in Re."""
    frequency = np.linspace(0.0, 1.0, 300) + 1.0
    bump = 3 * np.exp(-0.5 * ((frequency - 1.7) / 0.04) ** 2)
    residual = np.random.default_rng(4).standard_normal(600) + np.concatenate([bump, 0 * bump])
    left = remaining(residual, 0, frequency, False)
    assert left.structured
    low, high = left.worst_Hz[0]
    assert 1.6 < low < high < 1.8


@pytest.mark.parametrize(
    ("chi_square", "predicted", "share"), [(250.0, 1.0, 0.25), (250.0, 3.0, 0.5), (50.0, 0.9, 0.0), (5000.0, 9.0, 1.0)]
)
def test_unexplained_share_is_the_larger_one_of_fitted_and_predicted_points(chi_square, predicted, share, monkeypatch):
    """200 residuals at the level of the noise.

    Before: χ² of 1000, and left-out bands off by √33 times what noise makes.
    """
    monkeypatch.setattr(module, "with_discrepancy", lambda fit, none: fit)

    def fit(chi_square: float, predicted: float) -> SimpleNamespace:
        data, held_out = SimpleNamespace(level_std=0.1), SimpleNamespace(misfit=predicted)
        return SimpleNamespace(
            chi_square=chi_square, held_out=held_out, residual=np.zeros(200), noise_scale=1.0, data=data
        )

    before = fit(1000.0, np.sqrt(33.0))
    assert unexplained_share(before, fit(chi_square, predicted), 3.0) == pytest.approx(share)
    assert unexplained_share(fit(150.0, 0.9), fit(chi_square, predicted), 3.0) == 0.0
