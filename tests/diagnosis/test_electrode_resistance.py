"""Sheet resistance of the electrodes: the law against a thin bar between two resistive electrodes, solved along its
length.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from femu_piezo.effects.effect import EffectContext
from femu_piezo.effects.library.electrode_resistance import candidates
from femu_piezo.material.constants import D_FORM, PiezoConstants

LENGTH, WIDTH, THICKNESS, DENSITY = 40e-3, 5e-3, 1e-3, 7900.0
S11, D31, EPS33T = 16.5e-12 * (1 - 0.014j), -274e-12 * (1 - 0.012j), 3.0e-8 * (1 - 0.015j)
#: Two bands, around pole and zero of the fundamental and of its overtone, Hz.
FREQUENCY = np.concatenate([np.linspace(5e3, 60e3, 56), np.linspace(95e3, 120e3, 51)])


def bar(sheet: float, contact: float) -> np.ndarray:
    """Z (k,) by transfer matrices of V, I, u and the stress T along a bar with the sheet resistance in both
    electrodes.

    V' = −2 R_sq/W I,  I' = −jωW (ε V/t + d T),  u' = s T + d V/t,  T' = −ρω² u; contact : place of the contact over
    half the length
    """
    found = []
    for omega in 2 * np.pi * FREQUENCY:
        matrix = np.zeros((4, 4), dtype=complex)  # of V, I, u/µm, T/MPa
        matrix[0, 1] = -2 * sheet / WIDTH
        matrix[1, 0], matrix[1, 3] = -1j * omega * WIDTH * EPS33T / THICKNESS, -1j * omega * WIDTH * D31 * 1e6
        matrix[2, 0], matrix[2, 3] = D31 / THICKNESS * 1e6, S11 * 1e12
        matrix[3, 2] = -DENSITY * omega**2 * 1e-12
        left, right = (expm(matrix * LENGTH / 2 * part) for part in (1 + contact, 1 - contact))
        # unknown V and u at both ends, and the current fed in at the contact under one volt
        rows, wanted = np.zeros((5, 5), dtype=complex), np.zeros(5, dtype=complex)
        back = np.linalg.inv(right)
        rows[:4, 0:2], rows[:4, 2:4] = left[:, [0, 2]], -back[:, [0, 2]]
        rows[1, 4] = 1.0  # current to the right is that from the left and the fed one
        rows[4, 0:2], wanted[4] = left[0, [0, 2]], 1.0
        found.append(1 / np.linalg.solve(rows, wanted)[4])
    return np.array(found)


@pytest.fixture(scope="module")
def effect():
    """The effect of the library for this bar."""
    values = dict.fromkeys(D_FORM, 1e-12 + 0j) | {"s11": S11, "d31": D31, "eps33T": EPS33T}
    constants = PiezoConstants.from_vector(np.array([values[name] for name in D_FORM]))
    size = (LENGTH, WIDTH, THICKNESS)
    context = EffectContext(37e3, ("s11",), constants, {}, DENSITY, THICKNESS, 2e3, size)
    (found,) = candidates(context)
    return found


@pytest.mark.parametrize("contact", [0.0, 0.4, 1.0])
def test_law_of_a_thin_bar_with_resistive_electrodes(effect, contact):
    """Slope of Z at zero sheet resistance, relative to Z: within 1e-4 of its largest value over the sweep, at each
    place of the contact.

    The law is linear in the sheet resistance.
    """
    sheet = 1e-4
    bare = bar(0.0, contact)
    exact = (bar(sheet, contact) - bare) / sheet
    z, _, slopes = effect.circuit(2 * np.pi * FREQUENCY, bare, np.array([sheet, contact * LENGTH / 2]))
    np.testing.assert_allclose(slopes[:, 0], (z - bare) / sheet, rtol=1e-6)
    assert np.max(np.abs((slopes[:, 0] - exact) / bare)) < 1e-4 * np.max(np.abs(exact / bare))


def test_resistance_far_below_resonance(effect):
    """The charge is even along the bar: each electrode adds R_sq L/(3W) if contacted at its end, and a quarter of
    that if in the middle.
    """
    omega = 2 * np.pi * np.array([100.0])
    z = 1 / (1j * omega * EPS33T * LENGTH * WIDTH / THICKNESS)
    for contact, share in ((LENGTH / 2, 1 / 3), (0.0, 1 / 12)):
        found = effect.circuit(omega, z, np.array([1.0, contact]))[0] - z
        assert found[0] == pytest.approx(2 * LENGTH / WIDTH * share, rel=1e-3)


def test_electrodes_damp_the_antiresonance_and_leads_do_not(effect):
    """Electrodes lower the peak of |Z|; a resistance in the leads with the same loss at resonance raises it."""
    bare = bar(0.0, 0.0)
    z = effect.circuit(2 * np.pi * FREQUENCY, bare, np.array([2.0, 0.0]))[0]
    resonance, peak = int(np.argmin(np.abs(bare[:56]))), int(np.argmax(np.abs(bare[:56])))
    lead = bare + (z - bare)[resonance].real
    assert abs(z[peak]) < abs(bare[peak]) < abs(lead[peak])
