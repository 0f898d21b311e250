"""Jumps, spikes, mains lines and quantised readings are found where they are; clean sweeps have none."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from femu_piezo.errors import InputError
from femu_piezo.measurement.faults import _candidates, local_faults
from femu_piezo.measurement.readers import read_spectrum, write_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from tests.noise import with_noise

from .sweeps import HARD, SOFT, bar_impedance

BANDS = [(30e3, 50e3), (32e3, 42e3), (1e3, 5e5), (38e3, 44e3), (100.0, 2e4), (5e3, 120e3)]


def noisy(points: int, level: float, material: dict, seed: int, band=(30e3, 50e3)) -> tuple[np.ndarray, np.ndarray]:
    frequency = np.linspace(*band, points)
    impedance = bar_impedance(frequency, **material)
    return frequency, with_noise(impedance, level * np.abs(impedance), seed)


def faults_of(frequency: np.ndarray, impedance: np.ndarray) -> dict[str, list[int]]:
    """Kind of each fault found → numbers of its points."""
    return {fault.kind: fault.indices.tolist() for fault in local_faults(ImpedanceSpectrum(frequency, impedance))}


@pytest.mark.kernels
def test_clean_noisy_sweeps_have_hardly_any_faults() -> None:
    """200 sweeps of 61 … 1601 points, noise 1e-4 … 3e-3, linear and logarithmic, with and without resonances: two
    false alarms at most.
    """
    rng, alarms = np.random.default_rng(7), 0
    for seed in range(200):
        points, level = int(rng.choice([61, 101, 201, 401, 801, 1601])), 10 ** rng.uniform(-4, -2.52)
        band = BANDS[rng.integers(len(BANDS))]
        frequency = np.geomspace(*band, points) if rng.random() < 0.3 else np.linspace(*band, points)
        impedance = bar_impedance(frequency, **(SOFT, HARD)[seed % 2])
        alarms += bool(faults_of(frequency, with_noise(impedance, level * np.abs(impedance), seed)))
    assert alarms <= 2


def test_neighbours_predict_a_cubic_and_a_rational_function_exactly() -> None:
    """A cubic in log Z, and a quadratic over a linear polynomial, at unequal distances."""
    x = np.linspace(-0.5, 0.5, 40) + np.random.default_rng(4).uniform(-0.006, 0.006, 40)
    frequency = 1e4 * (x + 1.5)
    for impedance in (np.exp(2 - x + 0.3j * x**2 - 0.5 * x**3), (1 + 2j * x - x**2) / (x - 0.1 - 0.08j)):
        assert np.max(_candidates(frequency, impedance, np.full(40, 1e-9))[2:-2]) < 1e-2


@pytest.mark.kernels
@pytest.mark.parametrize("thinned", [False, True])
def test_every_spike_and_jump_is_looked_at_closely(thinned: bool) -> None:
    """Spikes of one to three points, and jumps, of 15 deviations at every place: fewer than 3 % are no candidates.

    A clean sweep has few candidates.
    """
    rng = np.random.default_rng(8)
    frequency, clean = noisy(401, 1e-3, SOFT, 5)
    if thinned:
        keep = np.sort(rng.choice(401, 240, replace=False))
        frequency, clean = frequency[keep], clean[keep]
    sigma, missed = np.full(frequency.size, 1e-3), 0
    assert np.sum(_candidates(frequency, clean, sigma) > 3) < 4 + 0.04 * frequency.size
    places = range(6, frequency.size - 8)
    for place in places:
        for end in (place + 1, place + 2, place + 3, frequency.size):
            impedance = clean.copy()
            impedance[place:end] *= 1 + 15e-3 * np.exp(2j * np.pi * rng.random())
            distance = _candidates(frequency, impedance, sigma)
            if end == frequency.size:
                missed += bool(min(distance[place - 1], distance[place]) < 2.5)
            else:
                missed += bool(distance[place] < 3)
    assert missed < 0.03 * 4 * len(places)


@pytest.mark.kernels
@pytest.mark.parametrize("material", [SOFT, HARD])
@pytest.mark.parametrize("points", [101, 401])
def test_spikes_are_found_and_nothing_else(points: int, material: dict) -> None:
    """Spikes of 20 standard deviations in any direction at any place: at least 19 of 20 are found, and no other
    point.
    """
    rng, hits = np.random.default_rng(points), 0
    for seed in range(20):
        frequency, impedance = noisy(points, (1e-4, 1e-3)[seed % 2], material, seed)
        place = int(rng.integers(5, points - 5))
        impedance[place] *= 1 + 20 * (1e-4, 1e-3)[seed % 2] * np.exp(2j * np.pi * rng.random())
        found = faults_of(frequency, impedance)
        assert found in ({}, {"spike": [place]})
        hits += bool(found)
    assert hits >= 19


@pytest.mark.parametrize("stretch", [(150, 180), (60, 170), (120, 300)])
def test_a_stretch_in_another_range_is_left_out_alone(stretch) -> None:
    """Between a jump and a jump back: the readings on both sides stay, wherever the fundamental is."""
    frequency, impedance = noisy(401, 1e-3, SOFT, 1)
    impedance[slice(*stretch)] *= np.exp(0.03 - 0.02j)
    faults = local_faults(ImpedanceSpectrum(frequency, impedance))
    (fault,) = faults
    assert fault.kind == "jump" and fault.indices.tolist() == list(range(*stretch))
    assert " Hz and back between " in fault.message


def test_stairs_are_told_as_they_are() -> None:
    """Two steps up, the longest stretch first: nothing jumps back, and each stretch is told with its own step."""
    frequency, impedance = noisy(401, 1e-3, SOFT, 1)
    impedance[200:300] *= np.exp(0.03)
    impedance[300:] *= np.exp(0.07)
    first, second = local_faults(ImpedanceSpectrum(frequency, impedance))
    assert first.indices.tolist() == list(range(200, 300)) and second.indices.tolist() == list(range(300, 401))
    assert " and by " not in first.message and " back " not in first.message
    sizes = [float(re.search(r"jumps (?:by|.* and by) (\S+)%", fault.message)[1]) for fault in (first, second)]
    assert sizes == pytest.approx([100 * np.expm1(0.03), 100 * np.expm1(0.04)], abs=0.3)


@pytest.mark.kernels
@pytest.mark.parametrize("loud", [0.3, 0.7])
def test_spikes_are_seen_beside_the_noise_that_is_stated_at_their_points(loud: float) -> None:
    """A share of the sweep is stated to be thirty times as noisy; a spike of 60 deviations of the rest lies there."""
    frequency = np.linspace(30e3, 50e3, 301)
    level = np.where(np.arange(301) < loud * 301, 3e-3, 1e-4)
    for seed in range(4):
        clean = bar_impedance(frequency, **SOFT)
        impedance = with_noise(clean, level * np.abs(clean), seed)
        impedance[270] *= 1 + 60e-4
        faults = local_faults(ImpedanceSpectrum.from_impedance(frequency, impedance, relative_noise=level))
        assert [(fault.kind, fault.indices.tolist()) for fault in faults] == [("spike", [270])]


@pytest.mark.kernels
@pytest.mark.parametrize("material", [SOFT, HARD])
@pytest.mark.parametrize("points", [101, 401])
def test_jumps_are_found_at_their_place(points: int, material: dict) -> None:
    """Steps of gain and phase by 20 standard deviations: at least 19 of 20 are found, at the right point.

    The fault holds the points of the shorter side.
    """
    rng, hits = np.random.default_rng(points), 0
    for seed in range(20):
        frequency, impedance = noisy(points, (1e-4, 1e-3)[seed % 2], material, seed)
        place = int(rng.integers(15, points - 15))
        impedance[place:] *= np.exp(20 * (1e-4, 1e-3)[seed % 2] * np.exp(2j * np.pi * rng.random()))
        found = faults_of(frequency, impedance)
        shorter = list(range(place)) if place < points - place else list(range(place, points))
        hits += found == {"jump": shorter}
    assert hits >= 19


def test_lines_of_the_mains_are_named() -> None:
    frequency = np.arange(20.0, 1000.0, 5.0)
    impedance = bar_impedance(frequency, **SOFT)
    impedance = with_noise(impedance, 1e-3 * np.abs(impedance), 1)
    lines = np.isin(frequency, (50, 60, 100, 150, 250))
    impedance[lines] *= 1.1
    assert faults_of(frequency, impedance) == {"mains": np.flatnonzero(lines).tolist()}


@pytest.mark.parametrize("column", ["phase", "|Z|", "resistance"])
def test_coarse_readings_are_named(column: str) -> None:
    frequency, impedance = noisy(201, 1e-4, SOFT, 1)
    size, phase = np.abs(impedance), np.angle(impedance, deg=True)
    if column == "phase":
        phase = np.round(phase)
    if column == "|Z|":
        size = 5 * np.round(size / 5)
    read = size * np.exp(1j * np.radians(phase))
    if column == "resistance":
        read = np.round(impedance.real, -1) + 1j * np.round(impedance.imag, -1)
    faults = local_faults(ImpedanceSpectrum(frequency, read))
    assert [fault.kind for fault in faults] == ["quantised"]
    assert column in faults[0].message


def test_masking_leaves_the_good_points_and_says_so(tmp_path: Path) -> None:
    frequency, impedance = noisy(401, 1e-3, SOFT, 3)
    impedance[300] *= 1.2
    impedance[60:] *= 1.05
    write_spectrum(ImpedanceSpectrum(frequency, impedance), tmp_path / "x.csv")
    told = read_spectrum(tmp_path / "x.csv")
    assert len(told) == 401 and "jumps by +5." in told.notes[0] and "mask_faults" in told.notes[0]
    masked = read_spectrum(tmp_path / "x.csv", mask_faults=True)
    assert np.array_equal(masked.frequency, np.delete(frequency[60:], 240))
    assert all(note.startswith("left out (mask_faults)") for note in masked.notes) and len(masked.notes) == 2


def test_masking_that_leaves_too_little_is_refused(tmp_path: Path) -> None:
    frequency, impedance = noisy(400, 1e-3, SOFT, 3)
    for place in range(80, 400, 80):
        impedance[place:] *= 1.05
    write_spectrum(ImpedanceSpectrum(frequency, impedance), tmp_path / "x.csv")
    with pytest.raises(InputError, match="would leave 80 of 400 points"):
        read_spectrum(tmp_path / "x.csv", mask_faults=True)


@pytest.mark.parametrize("pair", ["RX", "GB", "ZP"])
def test_linearly_interpolated_points_are_named(pair: str) -> None:
    """Two of three points are interpolated; the original sweep is not taken for interpolated."""
    frequency, impedance = noisy(600, 3e-4, HARD, 3)
    coarse = frequency[::3]
    parts = {
        "RX": (impedance.real, impedance.imag),
        "GB": ((1 / impedance).real, (1 / impedance).imag),
        "ZP": (np.abs(impedance), np.angle(impedance)),
    }[pair]
    first, second = (np.interp(frequency, coarse, part[::3]) for part in parts)
    joined = {"RX": first + 1j * second, "GB": 1 / (first + 1j * second), "ZP": first * np.exp(1j * second)}[pair]
    assert list(faults_of(frequency, joined)) == ["interpolated"]
    assert "interpolated" not in faults_of(frequency, impedance)


@pytest.mark.parametrize(("points", "band"), [(40, (1e2, 60e3)), (301, (30e3, 50e3)), (20001, (1e3, 60e3))])
def test_simulated_sweeps_are_not_taken_for_interpolated(points: int, band: tuple[float, float]) -> None:
    frequency, impedance = noisy(points, 0.0, HARD, 1, band)
    assert "interpolated" not in faults_of(frequency, impedance)
