"""Effects of how a sweep is taken (too fast, at too high a drive), on a circuit with one resonance solved in time
and at each amplitude.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.optimize import brentq

from femu_piezo.effects.effect import EffectContext
from femu_piezo.effects.library import drive_level, sweep_too_fast
from femu_piezo.effects.softening import softened
from femu_piezo.material.library import library_material
from tests import k31_bar

#: A series branch of L, R, C parallel to C0 = STATIC: resonance (rad/s), Q, C0 (F).
RESONANCE, QUALITY, STATIC = 2 * np.pi * 100e3, 80.0, 1e-9
INDUCTANCE = 1 / (RESONANCE**2 * 0.1 * STATIC)
RESISTANCE = RESONANCE * INDUCTANCE / QUALITY
OMEGA = 2 * np.pi * np.linspace(96e3, 103e3, 141)


def motional(omega, softer: complex = 0.0):
    """Admittance of the branch whose capacitance is 1 + `softer` times as large."""
    elastance = RESONANCE**2 * INDUCTANCE / (1 + softer)
    return 1j * omega / (elastance - omega**2 * INDUCTANCE + 1j * omega * RESISTANCE)


def inside(omega, *beside, slopes=None):
    """Z of the circuit and its slopes (none), as effects of acquisition ask for the response of the body."""
    return 1 / (motional(omega) + 1j * omega * STATIC), np.zeros((omega.size, 0), dtype=complex)


def bar(omega, share: float = 0.0, softer: float = 1.0):
    """Z of a lossy thin k31 bar of 20 x 2 x 1 mm, with d times 1 + `share` and s times `softer`²."""
    s, d, eps = 16e-12 * (1 - 0.015j) * softer**2, -2.7e-10 * (1 - 0.01j) * (1 + share), 3e-8 * (1 - 0.02j)
    return k31_bar.impedance(omega, (20e-3, 2e-3, 1e-3), 7500.0, s, d, eps)


def test_softer_body_by_the_same_body_at_other_frequencies():
    """Z(ω; s w²) = w Z(ωw; s, d/w), and the derivative of Z in w at w = 1 that `softened` gives, against
    differences.
    """
    omega, w = 2 * np.pi * np.linspace(60e3, 120e3, 61), 1.003
    np.testing.assert_allclose(bar(omega, softer=w), w * bar(omega * w, share=1 / w - 1), rtol=1e-12)

    def inside(omega, *beside, slopes=None):
        share = float(beside[0][1][0]) if beside else 0.0
        return bar(omega, share), np.zeros((omega.size, 0), dtype=complex)

    exact = (bar(omega, softer=1 + 1e-5) - bar(omega, softer=1 - 1e-5)) / 2e-5
    found = softened(inside, omega)[1][0]
    np.testing.assert_allclose(found, exact, rtol=1e-3)


@pytest.fixture(scope="module")
def effects():
    """Name → effect of the modules `sweep_too_fast` and `drive_level`."""
    context = EffectContext(100e3, ("s11",), library_material("pzt-5h").constants, {}, 7500.0, 1e-3, 2e3)
    return {e.name: e for module in (sweep_too_fast, drive_level) for e in module.candidates(context)}


def swept(rate: float) -> np.ndarray:
    """Y of the branch from its current in time, the convolution of its impulse response with a voltage exp(jφ(t)).

    The frequency grows by `rate` (Hz/s): φ(t − τ) = φ(t) − ωτ + 2π rate τ²/2.
    """
    fade = RESISTANCE / (2 * INDUCTANCE)
    ringing = np.sqrt(RESONANCE**2 - fade**2)
    time = np.linspace(0.0, 24 / fade, 60001)
    impulse = np.exp(-fade * time) * (np.cos(ringing * time) - fade / ringing * np.sin(ringing * time)) / INDUCTANCE
    bent = impulse * np.exp(1j * np.pi * rate * time**2)
    return np.array([simpson(bent * np.exp(-1j * omega * time), x=time) for omega in OMEGA])


def test_impulse_response_is_that_of_the_branch():
    """Without a rate of change of the frequency."""
    np.testing.assert_allclose(swept(0.0), motional(OMEGA), rtol=1e-4)


@pytest.mark.parametrize("direction", [1, -1])
def test_law_of_a_fast_sweep_against_the_current_in_time(effects, direction):
    """Rates of 0.03 γ² and twice that, γ half the bandwidth: the error of the law is of second order in the rate,
    and below 0.09 of the change.
    """
    half = RESONANCE / (2 * QUALITY)
    errors, changes = [], []
    for share in (0.03, 0.06):
        rate = direction * share * half**2 / (2 * np.pi)
        z = effects["sweep_too_fast"].acquisition(inside, OMEGA, np.array([rate]))[0]
        found, exact, still = 1 / z - 1j * OMEGA * STATIC, swept(rate), motional(OMEGA)
        changes.append(np.max(np.abs(exact - still)))
        errors.append(np.max(np.abs(found - exact)))
    assert changes[0] > 0.02 * np.max(np.abs(motional(OMEGA)))
    assert errors[0] < 3 * 0.03 * changes[0]
    assert errors[1] / errors[0] == pytest.approx(4, rel=0.15)


def leaning(softening: float, ratio: float) -> np.ndarray:
    """Z of the circuit whose branch softens with its own current, by the amplitude that is consistent with it at
    each frequency.
    """
    top = np.max(np.abs(motional(OMEGA) + 1j * OMEGA * STATIC)) ** 2
    found = []
    for omega in OMEGA:

        def answer(level, omega=omega):
            return motional(omega, softening * level * (1 - 1j * ratio)) + 1j * omega * STATIC

        level = brentq(lambda level: abs(answer(level)) ** 2 / top - level, 0.0, 4.0, xtol=1e-14)
        found.append(1 / answer(level))
    return np.array(found)


def test_law_of_the_drive_level_against_the_consistent_amplitude(effects):
    """The resonance leans by a third of its width.

    The law is off by less than half its stated error; the resonance is lower in frequency and weaker.
    """
    softening, ratio = 0.7 / QUALITY, 0.4
    z = effects["drive_level"].acquisition(inside, OMEGA, np.array([softening, ratio]))[0]
    exact, bare = leaning(softening, ratio), inside(OMEGA)[0]
    change = np.abs(np.log(exact / bare))
    assert np.max(np.abs(np.log(z / exact))) < effects["drive_level"].parameters[0].law_error / 2 * np.max(change)
    assert np.argmin(np.abs(z)) < np.argmin(np.abs(bare)) and np.min(np.abs(z)) > np.min(np.abs(bare))


def test_the_unit_of_the_amplitude_is_that_of_the_resonance_however_sharp_it_is():
    """Z of a branch with a quality of 4000, of which a step between the frequencies about the resonance is 1.3 widths:
    what a softening changes is the same wherever these lie.
    """
    resistance = RESONANCE * INDUCTANCE / 4000

    def sharp(omega, *beside, slopes=None):
        share = float(beside[0][1][0]) if beside else 0.0  # the current grows with the square of d
        z = resistance + 1j * INDUCTANCE * (omega - RESONANCE**2 / omega)
        return z / (1 + share) ** 2, np.zeros((omega.size, 0), dtype=complex)

    def at_resonance(fundamental):
        context = EffectContext(fundamental, ("s11",), library_material("pzt-5h").constants, {}, 7500.0, 1e-3, 2e3)
        (effect,) = drive_level.candidates(context)
        return effect.acquisition(sharp, np.array([RESONANCE]), np.array([1e-5, 0.4]))[0][0] - resistance

    step = 0.08 / 240 * RESONANCE / (2 * np.pi)
    changes = [at_resonance(RESONANCE / (2 * np.pi) + share * step) for share in (0.0, 0.3, 0.5)]
    np.testing.assert_allclose(changes, changes[0], rtol=1e-3)


def test_the_drive_level_of_a_frequency_does_not_depend_on_the_others(effects):
    """Z with the band of the resonance left out, as of a held-out band, and about the overtone alone."""
    acquisition, parameters = effects["drive_level"].acquisition, np.array([2e-3, 0.4])

    def inside(omega, *beside, slopes=None):
        share = float(beside[0][1][0]) if beside else 0.0
        return bar(omega, share), np.zeros((omega.size, 0), dtype=complex)

    omega = 2 * np.pi * np.concatenate([np.linspace(90e3, 110e3, 401), np.linspace(280e3, 330e3, 401)])
    whole = acquisition(inside, omega, parameters)[0]
    overtone = np.arange(omega.size) > 400
    for kept in (overtone, np.abs(omega - 2 * np.pi * 98e3) > 2 * np.pi * 5e3):
        np.testing.assert_allclose(acquisition(inside, omega[kept], parameters)[0], whole[kept], rtol=1e-12)
