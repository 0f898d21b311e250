"""Intervals hold the truth as often as stated, in a laboratory where every quantity of the file is off by its
tolerance.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from laboratory import NOISE
from scipy.stats import kstest

from femu_piezo.diagnosis.whiteness import strain_of
from femu_piezo.inference.fit import Fit, fit
from femu_piezo.measurement.autoregression import autoregression

#: Number of draws. The share of intervals that hold scatters by 0.23 from draw to draw, since the errors of its six
#: unknowns are correlated; the mean over 100 draws scatters by 0.023.
DRAWS = 100


def fitted(lab, truth: np.ndarray, seed: int) -> Fit:
    """The fit of a noisy sweep of a specimen with the unknowns `truth`, started at the prior means."""
    data = lab.measured(lab.evaluation.impedance(lab.unknowns, truth), seed)
    return fit(lab.evaluation, data, lab.unknowns, [lab.unknowns.prior_mean])


@pytest.fixture(scope="module")
def fits(lab):
    """Fits of 100 drawn specimens: dimensions, density, held constants and tangents, gain, phase and residue are off
    by their tolerances.
    """
    return [fitted(lab, lab.truth(seed), seed) for seed in range(DRAWS)]


@pytest.fixture(scope="module")
def pulls(lab, fits):
    """Errors over stated deviations: (draws, 6) of constants and tangents, (draws, m) of the unknowns with a
    tolerance.
    """
    found = [(one.x - lab.truth(seed)) / one.std for seed, one in enumerate(fits)]
    return np.split(np.array(found), [lab.unknowns.of_material], axis=1)


def test_constants_and_tangents_lie_in_their_intervals(pulls):
    size = np.abs(pulls[0])
    assert 0.62 < np.mean(size < 1) < 0.74
    assert 0.92 < np.mean(size < 2) < 0.98


def test_no_constant_is_biased_or_has_an_interval_of_another_size(pulls):
    """Each of the six unknowns: mean and variance of its pulls lie within 3.3 of their standard deviations of 0 and
    1.
    """
    assert np.all(np.abs(pulls[0].mean(axis=0)) < 3.3 / np.sqrt(DRAWS))
    assert np.all(np.abs(np.mean(pulls[0] ** 2, axis=0) - 1) < 3.3 * np.sqrt(2 / DRAWS))


def test_what_has_a_tolerance_lies_in_its_interval(pulls):
    assert np.mean(np.abs(pulls[1]) < 1) == pytest.approx(0.683, abs=0.03)
    assert np.mean(np.abs(pulls[1]) < 2) == pytest.approx(0.954, abs=0.015)


def test_tolerances_look_strained_as_rarely_as_they_say(lab, fits):
    """`strain_of`, a p-value, is uniform on (0, 1) for right tolerances and below 1e-4 for a plate twelve tolerances
    too wide.
    """
    chances = [strain_of(one) for one in fits]
    assert kstest(chances, "uniform").pvalue > 1e-3
    truth = lab.truth(0)
    width = lab.unknowns.columns(lab.unknowns.index("wrong_width")).start
    truth[width] += 12 * lab.unknowns.prior_std[width]
    assert strain_of(fitted(lab, truth, 0)) < 1e-4


def test_noise_alone_promises_far_too_much(lab):
    """Fits that take all but the noise as exactly known state less than a fifth of the deviations of the constants.

    The largest error of a constant or tangent is then more than 5 of the stated deviations.
    """
    for seed in range(3):
        truth = lab.truth(seed)
        data = lab.measured(lab.evaluation.impedance(lab.unknowns, truth), seed)
        whole = fit(lab.evaluation, data, lab.unknowns, [lab.unknowns.prior_mean])
        ideal = fit(lab.evaluation, data, lab.ideal, [truth[: lab.ideal.count]])
        assert np.all(ideal.std[[0, 2, 4]] < 0.2 * whole.std[[0, 2, 4]])
        assert np.max(np.abs(ideal.x - truth[:6]) / ideal.std) > 5


@pytest.mark.parametrize(("known", "whitened"), [(True, True), (False, True), (True, False)])
def test_intervals_hold_where_neighbours_err_alike(lab, known, whitened):
    """Noise averaged over three neighbouring points.

    With its correlations taken into account the pulls have an rms of about 1; taken as white noise, of 1.4 to 2.
    """
    truth = lab.material.x_of(lab.free.start)
    z = lab.evaluation.impedance(lab.ideal, truth)
    squares = []
    for seed in range(40):
        normal = np.random.default_rng([77, seed]).standard_normal((2, z.size + 2))
        mean = np.lib.stride_tricks.sliding_window_view(normal, 3, 1).sum(axis=2) / np.sqrt(6)
        data = replace(lab.measured(z, 0, known=known), impedance=z * (1 + NOISE * (mean[0] + 1j * mean[1])))
        if whitened:
            data = replace(data, noise_memory=(autoregression(np.log(data.impedance / z)),))
        found = fit(lab.evaluation, data, lab.ideal, [truth])
        squares.append(((found.x - truth) / found.std) ** 2)
    rms = np.sqrt(np.mean(squares))
    assert 0.85 < rms < 1.2 if whitened else 1.4 < rms < 2.0
