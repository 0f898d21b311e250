"""The search for the model order: where it begins, and where it looks for one more mode."""

import numpy as np
import pytest

from femu_piezo.extraction import extract
from femu_piezo.extraction.fit import NormalisedSweep, refit
from femu_piezo.extraction.order import _likely_poles, _standing_out, search
from femu_piezo.measurement.spectrum import ImpedanceSpectrum

from .bar import Bar, sweep

BAR = Bar()


def normalised(stop: float, relative: float = 1e-3, **options) -> NormalisedSweep:
    """A noisy sweep of the bar from 20 kHz to `stop`."""
    spectrum = sweep(BAR, np.linspace(20e3, stop, 401), relative=relative, **options)
    return NormalisedSweep.of(spectrum.omega, spectrum.admittance, np.ones(len(spectrum)))


@pytest.mark.parametrize(("stop", "modes"), [(30e3, 0), (90e3, 1), (130e3, 2), (300e3, 4)])
def test_the_search_begins_with_the_modes_that_stand_out(stop, modes):
    """Starts lie within a half-width and a step of the poles; of several modes the highest peak comes first."""
    data = normalised(stop)
    began = _standing_out(data, max_modes=10)
    true = np.array([(BAR.pole(n) - data.axis.center) / data.axis.half_width for n in range(1, modes + 1)])
    assert began.poles.size == modes
    assert np.all(np.abs(began.poles - true) < true.imag + data.x[-1] - data.x[-2])
    assert _standing_out(data, max_modes=1).poles.size == min(modes, 1)


@pytest.mark.parametrize("seed", range(5))
def test_noise_does_not_stand_out(seed):
    """With noise of 3 % and a loss of 1.5 % every third point is a local maximum, and the one mode alone is found."""
    assert _standing_out(normalised(90e3, relative=0.03, seed=seed), max_modes=10).poles.size == 1


def test_an_overtone_above_the_sweep_is_looked_for_where_it_is():
    """The next overtone is at three times the fundamental.

    A single pole that stands for all overtones lies above it, since those above contribute.
    """
    data = normalised(90e3, relative=1e-4)
    place = _likely_poles(refit(_standing_out(data, 10), data))[0]
    overtone = (BAR.pole(2).real - data.axis.center) / data.axis.half_width
    assert 1 < overtone < place.real < 2 * overtone
    found = search(data, 10).best.model
    assert found.poles.size == 2
    assert 1 < overtone < found.poles.real.max() < 2 * overtone


def test_a_computed_curve_with_a_dispersion_is_extracted_in_few_steps():
    """The charge of a bar and of a capacitor ∝ (jω)^-0.1, without noise: no function of ω² of few poles; poles and
    zeros to 1e-6 of their widths, and no search for modes in what no instrument sees.
    """
    bar, frequency = Bar(), np.geomspace(1e3, 130e3, 801)

    def charge(omega):
        return bar.charge(omega) + 3e-10 * (1j * omega / 1e5) ** -0.1

    omega = 2 * np.pi * frequency
    found = extract(ImpedanceSpectrum(frequency, 1 / (1j * omega * charge(omega))))
    assert len(found.orders) < 150
    for n, (pole, zero) in enumerate(zip(found.resonances.poles, found.resonances.zeros, strict=True), 1):
        root = np.sqrt(bar.zero(n))
        for _ in range(30):
            step = 1e-4 * root
            root -= charge(root) * 2 * step / (charge(root + step) - charge(root - step))
        for value, truth in ((pole.eigenvalue, bar.pole(n)), (zero.eigenvalue, root**2)):
            assert abs(value - truth) < 1e-6 * truth.imag
    assert n == 2
