"""The estimate of the noise of a sweep against the noise that was added."""

from __future__ import annotations

import numpy as np
import pytest

from femu_piezo.errors import InputError
from femu_piezo.measurement.noise import NoiseModel, estimate_noise
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from tests.noise import with_noise

from .sweeps import HARD, SOFT, bar_impedance


@pytest.mark.parametrize("level", [1e-4, 3e-4, 1e-3, 3e-3])
@pytest.mark.parametrize("points", [61, 201, 801, 1601])
@pytest.mark.parametrize(
    ("material", "band"), [(SOFT, (30e3, 50e3)), (SOFT, (32e3, 42e3)), (HARD, (38e3, 46e3)), (HARD, (1e3, 2e5))]
)
def test_relative_noise(level: float, points: int, material: dict, band: tuple[float, float]) -> None:
    frequency = np.linspace(*band, points)
    impedance = bar_impedance(frequency, **material)
    for seed in range(3):
        noisy = with_noise(impedance, level * np.abs(impedance), seed)
        model = estimate_noise(ImpedanceSpectrum(frequency, noisy))
        ratio = np.median(model.std(impedance) / np.abs(impedance)) / level
        limit = 1.40 if points == 61 else 1.25
        assert 1 / limit < ratio < limit


def test_curvature_of_a_resonance_is_not_noise() -> None:
    """100 Hz … 500 kHz in 61 points puts three steps between pole and zero: at most twice the noise of 1e-4 is
    estimated.
    """
    frequency = np.linspace(1e2, 5e5, 61)
    impedance = bar_impedance(frequency, **SOFT)
    exact = estimate_noise(ImpedanceSpectrum(frequency, impedance))
    assert np.median(exact.std(impedance) / np.abs(impedance)) < 2e-4
    dense = np.linspace(30e3, 50e3, 401)
    exact = estimate_noise(ImpedanceSpectrum(dense, bar_impedance(dense, **SOFT)))
    assert exact.relative < 1e-9


@pytest.mark.parametrize(("relative", "additive"), [(0.0, 1.0), (1e-3, 1.0), (1e-3, 5.0), (3e-4, 0.3)])
def test_relative_and_additive_noise_are_separated(relative: float, additive: float) -> None:
    frequency = np.linspace(30e3, 50e3, 401)
    impedance = bar_impedance(frequency, **SOFT)  # 82 … 13 900 ohm
    truth = NoiseModel(relative, additive)
    for seed in range(3):
        model = estimate_noise(ImpedanceSpectrum(frequency, with_noise(impedance, truth.std(impedance), seed)))
        ratio = model.std(impedance) / truth.std(impedance)
        assert 1 / 1.2 < np.median(ratio) < 1.2
        assert ratio.min() > 0.5
        assert ratio.max() < 2


def test_known_noise_is_used() -> None:
    frequency = np.linspace(30e3, 50e3, 101)
    impedance = bar_impedance(frequency, **SOFT)
    for truth in (NoiseModel(2e-3, 0.0), NoiseModel(0.0, 3.0), NoiseModel(1e-3, 1.0)):
        model = estimate_noise(ImpedanceSpectrum(frequency, impedance, truth.std(impedance)))
        np.testing.assert_allclose(model.std(impedance), truth.std(impedance), rtol=0.1)


def test_few_points() -> None:
    frequency = np.linspace(30e3, 50e3, 9)
    impedance = with_noise(bar_impedance(np.linspace(30e3, 31e3, 9), **SOFT), 1.0, 0)
    assert 0.1 < np.median(estimate_noise(ImpedanceSpectrum(frequency, impedance)).std(impedance)) < 10
    with pytest.raises(InputError, match="7 points are too few"):
        estimate_noise(ImpedanceSpectrum(frequency[:7], impedance[:7]))


def test_a_spike_does_not_raise_the_noise() -> None:
    frequency = np.linspace(30e3, 50e3, 401)
    impedance = bar_impedance(frequency, **SOFT)
    noisy = with_noise(impedance, 1e-3 * np.abs(impedance), 4)
    noisy[200] *= 1.5
    model = estimate_noise(ImpedanceSpectrum(frequency, noisy))
    assert np.median(model.std(impedance) / np.abs(impedance)) == pytest.approx(1e-3, rel=0.2)
