"""Differences in frequency, Q and k_eff of every resonance, on circuits whose poles are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from femu_piezo.extraction import extract
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.study.pole_zero_residuals import match, pole_zero_residuals
from tests.noise import noisy

FREQUENCY = np.linspace(50e3, 250e3, 501)
NOISE = 1e-3
#: Modes of the "specimen": frequency of the pole (Hz), loss, C_i/C_0.
MODES = ((100e3, 0.015, 0.08), (180e3, 0.012, 0.01))


def circuit(modes) -> np.ndarray:
    """Z, ohm, of C_0 = 1 nF parallel to modes Y_i = jω C_i ω_i²(1 + jη)/(ω_i²(1 + jη) − ω²)."""
    omega = 2 * np.pi * FREQUENCY
    capacitance = np.ones(omega.size, dtype=complex)
    for pole, loss, share in modes:
        eigenvalue = (2 * np.pi * pole) ** 2 * (1 + 1j * loss)
        capacitance += share * eigenvalue / (eigenvalue - omega**2)
    return 1 / (1j * omega * 1e-9 * capacitance)


def measured(modes, seed: int) -> ImpedanceSpectrum:
    z = circuit(modes)
    return ImpedanceSpectrum(FREQUENCY, noisy(z, NOISE, seed), NOISE * np.abs(z))


def residuals(model, seed: int = 1, modes=MODES):
    """Differences of the circuit `model` from a noisy sweep of the circuit `modes`."""
    extraction = extract(measured(modes, seed))
    return pole_zero_residuals(extraction, np.full(FREQUENCY.size, NOISE), circuit(model))


def test_known_differences_are_found():
    """The upper mode of the model is 0.2 % too high, its Q 10 % too low, and its coupling doubled."""
    pole, loss, share = MODES[1]
    found = residuals((MODES[0], (1.002 * pole, loss / 0.9, 4 * share)))
    assert len(found.poles) == len(found.zeros) == 2
    lower, upper = found.poles
    assert upper.frequency[0] == pytest.approx(0.2, abs=0.01)
    assert upper.quality[0] == pytest.approx(-10, abs=1)
    assert upper.frequency[1] > 10 and upper.quality[1] < -10
    # k_eff² ≈ C_i/C at the pole: twice the coupling, less the second order of the share
    assert upper.coupling[0] == pytest.approx(100, abs=5)
    assert abs(lower.frequency[1]) < 4 and abs(lower.quality[1]) < 4
    assert lower.coupling[0] < -1  # the stronger upper mode adds to the static compliance and so shifts the lower zero
    assert found.unexplained == found.extra == ()


def test_right_model_differs_by_noise_alone():
    """Over 15 draws differences over their deviations have an rms of 1, within 3.5 of its standard errors and 0.1."""
    sigmas = []
    for seed in range(15):
        found = residuals(MODES, seed)
        assert found.unexplained == found.extra == ()
        sigmas += [d.frequency[1] for d in (*found.poles, *found.zeros)]
        sigmas += [value for d in found.poles for value in (d.quality[1], d.coupling[1])]
    assert np.sqrt(np.mean(np.square(sigmas))) == pytest.approx(1, abs=3.5 / np.sqrt(2 * len(sigmas)) + 0.1)


def test_resonance_that_the_simulation_lacks_is_unexplained():
    """A third mode in the measurement alone."""
    found = residuals(MODES, modes=(*MODES, (140e3, 0.012, 0.003)))
    poles = [r for r in found.unexplained if r.kind == "pole"]
    assert len(poles) == 1 and poles[0].frequency_Hz == pytest.approx(140e3, rel=1e-3)
    assert found.extra == ()
    assert [d.model is None for d in found.poles] == [False, True, False]
    assert found.to_json()["measured_only"][0]["kind"] == "pole"


def test_resonance_that_the_measurement_lacks_is_extra():
    """A third mode in the model alone."""
    found = residuals((*MODES, (140e3, 0.012, 0.003)))
    assert found.unexplained == ()
    assert [r.frequency_Hz for r in found.extra if r.kind == "pole"] == [pytest.approx(140e3, rel=1e-3)]


def test_partner_beyond_the_end_of_the_sweep_is_no_stranger():
    """A pole 0.3 % below the end of the sweep in the model and 0.3 % above it in the specimen is neither unexplained
    nor extra.
    """
    edge = FREQUENCY[-1]
    found = residuals((*MODES, (0.997 * edge, 0.012, 0.01)), modes=(*MODES, (1.003 * edge, 0.012, 0.01)))
    assert found.unexplained == found.extra == ()


def test_weak_neighbour_is_not_taken_for_a_strong_mode():
    """Modes 1 % apart in frequency are not matched if their couplings differ by a factor of 100."""
    strong, weak = (
        extract(measured(m, 2)).resonances.poles for m in (((100e3, 0.015, 0.08),), ((101e3, 0.015, 8e-4),))
    )
    assert match([*strong], [*weak]) == [None]
    assert match([*strong], [*weak, *strong]) == [1]
    assert match([], [*weak]) == [] and match([*weak], []) == [None]


def test_extraction_started_with_modes_of_another_sweep_ends_at_the_same_modes():
    """The other sweep starts at a higher frequency, is of a body with three times the admittance, and has a further
    mode.
    """
    other = measured((*MODES, (220e3, 0.02, 0.005)), 2)
    part = slice(60, None)
    start = extract(ImpedanceSpectrum(FREQUENCY[part], other.impedance[part] / 3, other.noise[part] / 3)).model
    assert start.poles.size == 3
    plain, begun = (extract(measured(MODES, 1), start=one) for one in (None, start))
    for kind in ("poles", "zeros"):
        found = [[r.frequency_Hz for r in getattr(one.resonances, kind)] for one in (plain, begun)]
        assert found[1] == pytest.approx(found[0], rel=1e-8)
