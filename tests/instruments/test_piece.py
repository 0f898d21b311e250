"""What a simulated analyser measures: noise by its accuracy chart, drift, ringing, and softening with the drive."""

from __future__ import annotations

import numpy as np
import pytest

from femu_piezo.errors import InputError
from femu_piezo.instruments.piece import Piece
from femu_piezo.specimen.file import read_specimen

FREQUENCY = np.linspace(100e3, 140e3, 201)


@pytest.fixture(scope="module")
def specimen(plate):
    return read_specimen(plate)


def test_noise_grows_with_the_impedance_and_falls_with_the_time(specimen):
    """Repeated readings at |Z| of about 100 Ω, and of 100 kΩ, where an error of 1 nS matters."""
    piece = Piece(specimen)

    def scatter(frequency: float, speed: int, averages: int) -> float:
        read = [piece.measured(np.array([frequency]), 0.5, speed, averages)[0] for _ in range(300)]
        return float(np.std(read) / abs(np.mean(read)))

    quiet, fast = scatter(119e3, 5, 1), scatter(119e3, 1, 1)
    assert quiet == pytest.approx(2e-4, rel=0.3)
    assert fast / quiet == pytest.approx(np.sqrt(0.2 / 0.003), rel=0.2)
    assert scatter(119e3, 5, 16) == pytest.approx(quiet / 4, rel=0.2)
    assert scatter(1e3, 5, 1) > 3 * quiet


def test_gain_is_of_the_instrument_and_the_seed(specimen):
    """The same seed gives the same gain error."""
    one, same, other = (Piece(specimen, seed=seed).measured(FREQUENCY, 0.5, 5, 256) for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert 1e-5 < np.abs(np.mean(other / one) - 1) < 2e-3


def resonance(z: np.ndarray) -> float:
    """Frequency of the largest conductance, Hz, by a parabola through three points."""
    top = int(np.argmax((1 / z).real))
    left, middle, right = (1 / z).real[top - 1 : top + 2]
    return FREQUENCY[top] + 0.5 * (left - right) / (left - 2 * middle + right) * (FREQUENCY[1] - FREQUENCY[0])


def test_resonances_drift_while_it_measures(specimen):
    piece = Piece(specimen, drift=1e-5)
    before = resonance(piece.measured(FREQUENCY, 0.5, 5, 1))
    clock = piece.clock
    after = resonance(piece.measured(FREQUENCY, 0.5, 5, 1))
    assert clock == pytest.approx(201 * 0.2) and after / before - 1 == pytest.approx(1e-5 * clock, rel=0.2)


def test_a_fast_sweep_still_rings(specimen):
    """Rising and falling sweeps differ near a resonance if a point takes less time than the resonance needs to
    settle.
    """
    sharp = specimen.model_copy(
        update={"material": specimen.material.model_copy(update={"tan_s11": 0.0004, "tan_d31": 0.0004})}
    )
    apart = {}
    for speed in (1, 5):
        up = Piece(sharp).measured(FREQUENCY, 0.5, speed, 16)
        down = Piece(sharp, seed=0).measured(FREQUENCY[::-1], 0.5, speed, 16)[::-1]
        apart[speed] = np.max(np.abs(up / down - 1))
    assert apart[1] > 0.05 > 5 * apart[5]


def test_softening_grows_with_the_square_of_the_drive(specimen):
    """The softening stated in [effects.drive_level] holds at the voltage of [limits]."""
    leaning = specimen.model_copy(update={"effects": {"drive_level": {"softening": 0.004}}})
    places = [resonance(Piece(leaning, seed=3).measured(FREQUENCY, voltage, 5, 4096)) for voltage in (0.006, 0.3, 0.6)]
    small, large = places[0] - places[1], places[0] - places[2]
    assert large > 50 and large / small == pytest.approx(4, rel=0.2)


def test_a_specimen_without_losses_is_refused(plate, tmp_path):
    """Its resonances have no width, so that a sweep would show noise alone."""
    lines = [line for line in plate.read_text(encoding="utf-8").splitlines() if "tan_" not in line]
    (tmp_path / "lossless.toml").write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(InputError, match="has no losses"):
        Piece(read_specimen(tmp_path / "lossless.toml"))
