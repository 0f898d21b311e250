"""`extract` on the exact 1-D bar: true poles and zeros are known to all digits."""

import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from femu_piezo.errors import InputError
from femu_piezo.extraction import extract
from femu_piezo.extraction.limitations import find_missing
from femu_piezo.extraction.order import is_passive
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from tests.noise import circular_noise, noisy

from .bar import Bar, sweep

BAR = Bar()


def relative_errors(found, true):
    return [abs(r.eigenvalue / value - 1) for r, value in zip(found, true, strict=True)]


@pytest.mark.parametrize(
    ("low", "high", "points", "modes"),
    [(28e3, 48e3, 401, [1]), (90e3, 130e3, 401, [2]), (20e3, 200e3, 801, [1, 2, 3])],
)
def test_noise_free_poles_and_zeros_are_exact(low, high, points, modes):
    found = extract(sweep(BAR, np.linspace(low, high, points))).resonances
    assert max(relative_errors(found.poles, [BAR.pole(n) for n in modes])) < 1e-8
    assert max(relative_errors(found.zeros, [BAR.zero(n) for n in modes])) < 1e-8


def test_viscous_circuit_is_exact_too():
    """Butterworth-Van Dyke circuit: C0 beside R-L-C, poles −R/2L ± j…, no hysteretic loss anywhere."""
    frequency = np.linspace(28e3, 48e3, 401)
    c0, c1, w1, q = 1e-9, 0.14e-9, 2 * np.pi * 35e3, 60.0
    inductance = 1 / (w1**2 * c1)
    resistance = w1 * inductance / q
    s = 2j * np.pi * frequency
    z = 1 / (s * c0 + 1 / (resistance + s * inductance + 1 / (s * c1)))
    decay = resistance / (2 * inductance)
    pole = -decay + 1j * np.sqrt(w1**2 - decay**2)
    zero = -decay + 1j * np.sqrt((1 / c1 + 1 / c0) / inductance - decay**2)
    found = extract(ImpedanceSpectrum(frequency, z)).resonances
    assert found.poles[0].pole_s == pytest.approx(pole, rel=1e-8)
    assert found.zeros[0].pole_s == pytest.approx(zero, rel=1e-8)


def test_residues_are_those_of_y_and_z():
    found = extract(sweep(BAR, np.linspace(28e3, 48e3, 401))).resonances
    # Y = s·Q, Q = R/(λ_p + s²): residue at s = p is R/2
    assert found.poles[0].residue == pytest.approx(BAR.residue_of_charge(1) / 2, rel=1e-8)
    zero = found.zeros[0]
    radius = 1e-4 * abs(zero.pole_s)
    circle = radius * np.exp(2j * np.pi * np.arange(32) / 32)
    s = zero.pole_s + circle
    z = 1 / (s * BAR.charge(s / 1j))
    assert zero.residue == pytest.approx(np.mean(z * circle), rel=1e-6)


def test_noise_is_learned_from_the_sweep():
    found = extract(sweep(BAR, np.linspace(28e3, 48e3, 801), relative=1e-3, seed=1))
    assert found.noise.relative == pytest.approx(1e-3, rel=0.1)
    assert found.noise.additive == 0.0
    both = extract(sweep(BAR, np.linspace(28e3, 48e3, 1601), relative=1e-3, additive=2.0, seed=2))
    assert both.noise.relative == pytest.approx(1e-3, rel=0.15)
    assert both.noise.additive == pytest.approx(2.0, rel=0.15)


def correlated_noise(count, seed):
    """(count,) errors of deviation 1 with correlations of 0.7 per step."""
    white, noise = circular_noise(count, 1.0, seed), np.zeros(count, complex)
    noise[0] = white[0]
    for k in range(1, noise.size):
        noise[k] = 0.7 * noise[k - 1] + np.sqrt(1 - 0.7**2) * white[k]
    return noise


@pytest.mark.parametrize("given", [False, True])
def test_deviations_count_the_correlation_of_neighbours(given):
    """Noise of 0.1 % with correlated neighbours, over seven octaves: |δλ| over its deviation, 16 sweeps.

    As a smooth error of the frequency such noise would make the deviations a hundred times too large. It may be given
    with the sweep, and be ten times as large about the resonance.
    """
    frequency, pulls = np.linspace(500, 60e3, 401), []
    level = np.where(given & (np.abs(frequency - 36e3) < 6e3), 1e-2, 1e-3)
    for seed in range(16):
        impedance = BAR.impedance(frequency) * (1 + level * correlated_noise(frequency.size, seed))
        known = level if given else None
        found = extract(ImpedanceSpectrum.from_impedance(frequency, impedance, relative_noise=known))
        pole = found.resonances.poles[0]
        assert pole.std_Hz < (10 if given else 1)
        pulls.append(abs(pole.eigenvalue - BAR.pole(1)) / np.sqrt(np.trace(pole.covariance)))
    # |δλ|² over its mean: the mean of 32 squared Gaussian errors is within 1 ± 3 √(2/32)
    assert 1 - 3 * np.sqrt(2 / 32) < np.mean(np.square(pulls)) < 1 + 3 * np.sqrt(2 / 32)


def test_noise_of_the_file_is_used_and_doubted():
    frequency = np.linspace(28e3, 48e3, 401)
    honest = extract(sweep(BAR, frequency, relative=1e-3, noise=True, seed=3))
    assert honest.status == "ok" and honest.noise.origin == "file"
    assert honest.reduced_chi_square == pytest.approx(1, abs=0.25)
    data = sweep(BAR, frequency, relative=1e-3, noise=True, seed=3)
    wrong = extract(ImpedanceSpectrum(frequency, data.impedance, data.noise / 10))
    assert wrong.status == "noise_underestimated"
    ratio = wrong.resonances.poles[0].std_Hz / honest.resonances.poles[0].std_Hz
    assert ratio == pytest.approx(1, rel=0.2)


@pytest.mark.parametrize("points", [14, 19])
def test_a_systematic_error_of_few_points_is_named(points):
    """The impedance turns about its true value, twice over the sweep, by 5 %."""
    frequency = np.linspace(30e3, 50e3, points)
    error = 0.05 * np.exp(4j * np.pi * np.arange(points) / points)
    impedance = BAR.impedance(frequency) * np.exp(error)
    found = extract(ImpedanceSpectrum.from_impedance(frequency, impedance, relative_noise=1e-3))
    assert "correlated_residual" in [finding.code for finding in found.findings]


def test_deviations_are_said_to_be_multiplied_only_where_they_are():
    """By the noise that is stated too small, and not where a systematic error widens them."""
    frequency = np.linspace(28e3, 48e3, 401)
    data = sweep(BAR, frequency, relative=1e-3, noise=True, seed=3)
    for error, multiplied in ((0.0, True), (0.02 * np.sin((frequency - 28e3) ** 1.3 / 1500), False)):
        found = extract(ImpedanceSpectrum(frequency, data.impedance * (1 + error), data.noise / 10))
        assert found.status == "noise_underestimated"
        assert ("multiplied by this factor" in found.notes[0]) == multiplied


def test_coupling_and_its_deviation():
    found = extract(sweep(BAR, np.linspace(28e3, 48e3, 401), relative=1e-3, seed=4))
    (pair,) = found.pairs
    truth = np.sqrt(1 - BAR.pole(1).real / BAR.zero(1).real)
    assert 0 < pair.std_k_eff < 1e-5
    assert found.figures["k_eff"].std == pair.std_k_eff
    assert abs(pair.k_eff - truth) < 4 * pair.std_k_eff


@pytest.mark.parametrize(
    ("modes", "told", "zero_Hz"),
    [
        # a weak mode between the pole and the zero of a strong one: no passive mode by itself has its zero
        ([(193.85e3, 0.0081, 0.113), (195.08e3, 0.0313, 0.02)], 0, 206.5e3),
        # a weak mode below another: its pole is doubtful, its zero is not
        ([(219.2e3, 0.0153, 0.0005), (220.39e3, 0.0132, 0.017), (242.42e3, 0.013, 0.094)], 1, 221.6e3),
    ],
)
def test_a_mode_keeps_its_zero_beside_a_weak_one(modes, told, zero_Hz):
    frequency = np.linspace(60e3, 300e3, 601)
    square = (2 * np.pi * frequency) ** 2
    eigenvalues = [(2 * np.pi * pole) ** 2 * (1 + 1j * loss) for pole, loss, _ in modes]
    terms = [share * one.real / (one - square) for one, (*_, share) in zip(eigenvalues, modes, strict=True)]
    z = 1 / (2j * np.pi * frequency * 1e-9 * (1 - 0.01j + sum(terms)))
    found = extract(ImpedanceSpectrum(frequency, noisy(z, 1e-3, seed=1)))
    pairs = {round(pair.pole.frequency_Hz / modes[told][0], 3): pair.zero.frequency_Hz for pair in found.pairs}
    assert pairs[1.0] == pytest.approx(zero_Hz, rel=1e-3)


@pytest.mark.parametrize(("points", "softening"), [(401, 0.005), pytest.param(801, 0.007, marks=pytest.mark.slow)])
def test_a_mode_that_the_drive_softens_keeps_its_zero(points, softening):
    """Without noise its curve takes several poles, some of which gain energy: these are no modes and have no zeros."""
    frequency, pole, zero, loss = np.linspace(30e3, 400e3, points), 167.3e3, 237.5e3, 0.015
    share, softer = (zero / pole) ** 2 - 1, 0.0

    def impedance(softer):
        eigenvalue = (2 * np.pi * pole * (1 - softer)) ** 2
        mode = share * eigenvalue / (eigenvalue * (1 + 1j * loss) - (2 * np.pi * frequency) ** 2)
        return 1 / (2j * np.pi * frequency * 1e-11 * (1 - 1j * loss) * (1 + mode))

    largest = np.max(1 / np.abs(impedance(0.0)))
    for _ in range(30):
        softer = softening / (np.abs(impedance(softer)) * largest) ** 2
    (pair,) = extract(ImpedanceSpectrum(frequency, impedance(softer))).pairs
    assert pair.zero.frequency_Hz == pytest.approx(zero, rel=1e-3)


@pytest.mark.parametrize(("tan_d31", "order", "remarks"), [(0.013, -1, 1), (0.0155, 0, 0), (0.02, 1, 1)])
def test_coupling_phase_is_the_balance_of_the_losses(tan_d31, order, remarks):
    """k² = d²/(s ε) has the loss angle tan δ + tan φ − 2 tan θ, and so has k_eff² of the fundamental to first order."""
    bar = Bar(d31=-293.25e-12 * (1 - 1j * tan_d31))
    found = extract(sweep(bar, np.linspace(28e3, 48e3, 401), relative=1e-4, seed=7))
    (pair,) = found.pairs
    exact = np.angle(1 - bar.pole(1) / bar.zero(1))
    assert abs(pair.coupling_phase - exact) < 4 * pair.std_coupling_phase < 1e-4
    assert pair.coupling_phase == pytest.approx(0.015 + 0.016 - 2 * tan_d31, abs=2e-4)
    assert len(found.remarks) == remarks
    assert not any(re.search(r"\de-\d", remark) for remark in found.remarks)
    if order:
        assert np.sign(pair.zero.quality_factor - pair.pole.quality_factor) == order


@pytest.mark.parametrize(
    ("low", "high", "status", "poles", "zeros"),
    [
        (28e3, 37e3, "zero_outside_sweep", 1, 0),
        (37e3, 48e3, "pole_outside_sweep", 0, 1),
        (50e3, 80e3, "no_resonance", 0, 0),
    ],
)
def test_what_lies_outside_is_named(low, high, status, poles, zeros):
    found = extract(sweep(BAR, np.linspace(low, high, 301), relative=1e-3, seed=5))
    assert found.status == status
    assert len(found.resonances.poles) == poles and len(found.resonances.zeros) == zeros
    for r in found.resonances.poles + found.resonances.zeros:
        truth = BAR.pole(1) if r.kind == "pole" else BAR.zero(1)
        assert abs(r.eigenvalue / truth - 1) < 1e-4


def test_a_sweep_between_a_pole_and_its_zero_is_to_be_widened():
    """Neither lies inside, and both are seen."""
    pole, zero = (np.sqrt(one.real) / (2 * np.pi) for one in (BAR.pole(1), BAR.zero(1)))
    inside = np.linspace(pole + 0.1 * (zero - pole), zero - 0.3 * (zero - pole), 301)
    found = extract(sweep(BAR, inside, relative=1e-4, seed=5))
    assert found.status == "no_resonance"
    assert f"a pole is seen beyond, at an extrapolated {pole:.0f}"[:-1] in found.findings[0].sentence


@pytest.mark.parametrize(
    ("missing", "far", "words"),
    [
        (
            "pole",
            [40e3, 45e3, 130e3],
            "resonance (pole) outside the sweep, below 50000 Hz, at an extrapolated 45000 Hz",
        ),
        ("pole", [130e3], "resonance (pole) outside the sweep, below 50000 Hz; widen"),
        (
            "zero",
            [40e3, 105e3, 110e3],
            "antiresonance (zero) outside the sweep, above 100000 Hz, at an extrapolated 105",
        ),
    ],
)
def test_what_lies_outside_is_sought_on_its_side(missing, far, words):
    """A pole below the sweep or a zero above it, the nearest one."""
    other = "zero" if missing == "pole" else "pole"
    one = SimpleNamespace(kind=other, frequency_Hz=70e3)
    roots = SimpleNamespace(
        sound_and_doubtful=lambda kind: (one,) if kind == other else (),
        outside=tuple(SimpleNamespace(kind=missing, frequency_Hz=frequency) for frequency in far),
    )
    (finding,) = find_missing(roots, ImpedanceSpectrum(np.linspace(50e3, 100e3, 51), np.ones(51, complex)))
    assert words in finding.sentence


def test_clipped_peak_is_named_and_left_out():
    frequency = np.linspace(28e3, 48e3, 401)
    z = sweep(BAR, frequency, relative=1e-4, seed=6).impedance
    ceiling = 0.6 * np.abs(z).max()
    clipped = np.where(np.abs(z) > ceiling, z / np.abs(z) * ceiling, z)
    found = extract(ImpedanceSpectrum(frequency, clipped))
    assert found.status == "clipped"
    assert np.array_equal(found.used, np.abs(z) <= ceiling)
    assert abs(found.resonances.zeros[0].eigenvalue / BAR.zero(1) - 1) < 1e-5


def test_too_few_points_are_named():
    found = extract(sweep(BAR, np.linspace(34e3, 36e3, 5)))
    assert found.status == "too_few_points" and found.resonances.poles == ()
    assert json.loads(json.dumps(found.to_json()))["points_used"] == 0


def test_a_sweep_clipped_to_nothing_is_named():
    frequency = np.linspace(28e3, 48e3, 12)
    z = BAR.impedance(frequency)
    found = extract(ImpedanceSpectrum(frequency, z / np.abs(z) * 100.0))
    assert found.status == "too_few_points"
    assert "clipped" in [f.code for f in found.findings]


def test_json_contract():
    record = json.loads(json.dumps(extract(sweep(BAR, np.linspace(28e3, 48e3, 201), relative=1e-3)).to_json()))
    assert set(record["poles"][0]) == {"frequency_Hz", "loss", "std_Hz", "std_loss"}
    assert record["zeros"][0]["frequency_Hz"] == pytest.approx(np.sqrt(BAR.zero(1).real) / 2 / np.pi, rel=1e-5)


def test_impossible_readings_are_refused():
    z = BAR.impedance(np.linspace(28e3, 48e3, 50))
    z[7] = np.nan
    with pytest.raises(InputError, match=r"30857\.1 Hz"):
        extract(ImpedanceSpectrum(np.linspace(28e3, 48e3, 50), z))
    with pytest.raises(InputError, match="guess"):
        extract(ImpedanceSpectrum(np.linspace(28e3, 48e3, 50), np.ones(50)), method="guess")


@pytest.mark.parametrize("most", [0, 2])
def test_a_start_with_more_modes_than_are_wanted_is_cut(most):
    data = sweep(BAR, np.linspace(20e3, 250e3, 401), relative=1e-3)
    start = extract(data).model
    assert start.poles.size > 2
    assert extract(data, max_modes=most, start=start).model.poles.size <= most


def test_a_start_with_a_pole_of_negative_residue_is_dropped():
    """Data of a resonance and a pole of negative residue, started with both: only the first remains."""
    model = extract(sweep(BAR, np.linspace(28e3, 48e3, 401))).model
    (pole,), (residue,) = model.poles, model.residues
    start = replace(
        model, poles=np.array([pole, pole + pole.imag]), residues=residue * np.array([1.0 - 0.1j, -0.2 + 0.1j])
    )
    frequency = np.linspace(28e3, 48e3, 401)
    impedance = 1 / start.admittance(2 * np.pi * frequency)
    found = extract(ImpedanceSpectrum(frequency, impedance, noise=1e-3 * np.abs(impedance)), start=start)
    assert found.model.poles.size >= 1
    assert is_passive(found.model)


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_a_sweep_without_loss_is_told_so(noise):
    """With and without noise; a bar of low loss in more noise, on a grid that misses its peaks, is no such sweep."""
    frequency = np.linspace(20e3, 130e3, 301)
    bare = Bar(s11=15.84e-12, d31=-293.25e-12, eps33=2422.5 * 8.854e-12)
    found = extract(ImpedanceSpectrum(frequency, noisy(bare.impedance(frequency), noise, 1)))
    assert [finding.code for finding in found.findings] == ["lossless"] and not found.resonances.poles
    fine = 1 - 2e-4j
    sharp = Bar(s11=15.84e-12 * fine, d31=-293.25e-12 * fine, eps33=2422.5 * 8.854e-12 * fine)
    found = extract(ImpedanceSpectrum(frequency, noisy(sharp.impedance(frequency), 3e-3, 1)))
    assert "lossless" not in [finding.code for finding in found.findings]
