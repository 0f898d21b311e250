"""The misfit of the best linear body: the noise for linear bodies, and more for others."""

from __future__ import annotations

import numpy as np
import pytest

from femu_piezo.extraction.linear_body import linear_body_misfit
from femu_piezo.inference.starts.thin_body import k31_bar_admittance
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from tests.noise import circular_noise

FREQUENCY = np.linspace(100e3, 160e3, 201)


def admittance(frequency: np.ndarray) -> np.ndarray:
    """Y of a bar 12 × 3 × 1 mm with its length mode near 128 kHz; the next mode is at three times that."""
    return k31_bar_admittance(
        2 * np.pi * frequency, 12e-3, 3e-3, 1e-3, 7700.0, 13.7e-12 * (1 - 0.012j), -130e-12 * (1 - 0.02j), 1.15e-8
    )


def spectrum(y: np.ndarray, noise: float) -> ImpedanceSpectrum:
    return ImpedanceSpectrum(FREQUENCY, (1 + circular_noise(y.size, noise, 1)) / y)


@pytest.mark.parametrize("resistance", [0.0, 40.0])
def test_linear_body_is_followed_to_the_noise(resistance: float) -> None:
    """Also with leads; the next mode of the bar is part of the background."""
    noise = 2e-3
    sweep = spectrum(1 / (1 / admittance(FREQUENCY) + resistance), noise)
    clean = spectrum(1 / (1 / admittance(FREQUENCY) + resistance), 0.0)
    drawn = np.sqrt(np.mean(np.abs(sweep.impedance / clean.impedance - 1) ** 2))
    misfit = linear_body_misfit(sweep, [127e3])
    assert 0.95 * drawn < misfit < drawn  # twelve fitted numbers reduce the squares by 12/402
    assert linear_body_misfit(sweep, [127e3], np.full(FREQUENCY.size, noise)) == pytest.approx(misfit / noise, rel=1e-6)


def test_two_resonances_are_followed() -> None:
    """A bar and a weak second resonance; with a single resonance the misfit is five times as large."""
    lam = (2 * np.pi * 140e3) ** 2 * (1 + 0.01j)
    more = 1j * 2 * np.pi * FREQUENCY * 2e-12 * lam / (lam - (2 * np.pi * FREQUENCY) ** 2)
    sweep = spectrum(admittance(FREQUENCY) + more, 1e-3)
    assert linear_body_misfit(sweep, [127e3, 140e3]) == pytest.approx(1e-3, rel=0.1)
    assert linear_body_misfit(sweep, [127e3]) > 5e-3


def test_resonance_just_above_the_sweep_is_part_of_the_body() -> None:
    """A strong resonance a tenth above the end of the sweep, for which a smooth background is not curved enough."""
    lam = (2 * np.pi * 176e3) ** 2 * (1 + 0.01j)
    more = 1j * 2 * np.pi * FREQUENCY * 4e-12 * lam / (lam - (2 * np.pi * FREQUENCY) ** 2)
    assert linear_body_misfit(spectrum(admittance(FREQUENCY) + more, 1e-3), [127e3]) == pytest.approx(1e-3, rel=0.1)


def test_resonance_that_moves_with_the_current_is_not_followed() -> None:
    """A body that softens: where the conductance is highest, the frequency is lower by 0.4 %."""
    strength = admittance(FREQUENCY).real
    soft = admittance(FREQUENCY * (1 + 4e-3 * strength / strength.max()))
    assert linear_body_misfit(spectrum(soft, 1e-3), [127e3]) > 10e-3


def test_no_resonance_is_an_error() -> None:
    with pytest.raises(ValueError, match="at least one pole"):
        linear_body_misfit(spectrum(admittance(FREQUENCY), 1e-3), [])
