"""Intervals hold the truth as often as they say, in a laboratory where nothing is exactly as the file has it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from laboratory import NOISE
from scipy.stats import kstest

from femu_piezo.diagnosis.whiteness import strain_of
from femu_piezo.inference.fit import Fit, fit
from femu_piezo.measurement.autoregression import autoregression

#: The shares of one draw scatter by about 0.23 (its six constants err together), so the mean of 100 by 0.023.
DRAWS = 100


def fitted(lab, truth: np.ndarray, seed: int) -> Fit:
    """The fit of a sweep of a specimen that is so."""
    data = lab.measured(lab.evaluation.impedance(lab.unknowns, truth), seed)
    return fit(lab.evaluation, data, lab.unknowns, [lab.unknowns.prior_mean])


@pytest.fixture(scope="module")
def fits(lab):
    """Dimensions, density, held constants and their tangents, gain, phase and residue are off by their tolerances."""
    return [fitted(lab, lab.truth(seed), seed) for seed in range(DRAWS)]


@pytest.fixture(scope="module")
def pulls(lab, fits):
    """(draws, 6) errors of constants and tangents over their deviations; (draws, others) of the tolerances."""
    found = [(one.x - lab.truth(seed)) / one.std for seed, one in enumerate(fits)]
    return np.split(np.array(found), [lab.unknowns.of_material], axis=1)


def test_constants_and_tangents_lie_in_their_intervals(pulls):
    own = np.abs(pulls[0])
    assert 0.62 < np.mean(own < 1) < 0.74
    assert 0.92 < np.mean(own < 2) < 0.98


def test_no_constant_is_biased_or_has_an_interval_of_another_size(pulls):
    """Each of the six by itself: means within 3.3, variances within 3.3 of their own errors."""
    assert np.all(np.abs(pulls[0].mean(axis=0)) < 3.3 / np.sqrt(DRAWS))
    assert np.all(np.abs(np.mean(pulls[0] ** 2, axis=0) - 1) < 3.3 * np.sqrt(2 / DRAWS))


def test_what_has_a_tolerance_lies_in_its_interval(pulls):
    assert np.mean(np.abs(pulls[1]) < 1) == pytest.approx(0.683, abs=0.03)
    assert np.mean(np.abs(pulls[1]) < 2) == pytest.approx(0.954, abs=0.015)


def test_tolerances_look_strained_as_rarely_as_they_say(lab, fits):
    """The probabilities of right ones are even on (0, 1); a plate that is twelve tolerances too wide is seen."""
    chances = [strain_of(one) for one in fits]
    assert kstest(chances, "uniform").pvalue > 1e-3
    truth = lab.truth(0)
    width = lab.unknowns.columns(lab.unknowns.index("wrong_width")).start
    truth[width] += 12 * lab.unknowns.prior_std[width]
    assert strain_of(fitted(lab, truth, 0)) < 1e-4


def test_noise_alone_promises_far_too_much(lab):
    """The same sweeps by a fit that takes all but the noise as known: what the tolerances are for."""
    for seed in range(3):
        truth = lab.truth(seed)
        data = lab.measured(lab.evaluation.impedance(lab.unknowns, truth), seed)
        whole = fit(lab.evaluation, data, lab.unknowns, [lab.unknowns.prior_mean])
        ideal = fit(lab.evaluation, data, lab.ideal, [truth[: lab.ideal.count]])
        assert np.all(ideal.std[[0, 2, 4]] < 0.2 * whole.std[[0, 2, 4]])
        assert np.max(np.abs(ideal.x - truth[:6]) / ideal.std) > 5


@pytest.mark.parametrize(("known", "whitened"), [(True, True), (False, True), (True, False)])
def test_intervals_hold_where_neighbours_err_alike(lab, known, whitened):
    """Noise averaged over three points, as its correlations say; taken as white, deviations are far too small."""
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
