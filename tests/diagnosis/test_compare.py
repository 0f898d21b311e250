"""Comparison and verdict on data made by the model itself: evidence, two effects, hidden ones, left-out bands."""

from __future__ import annotations

import numpy as np
import pytest
from femu_piezo.diagnosis.compare import compare
from femu_piezo.inference.blocks import weak_prior
from femu_piezo.inference.joint import JointParameters

from diagnosis.conftest import FREQUENCY
from femu_piezo.diagnosis.confounding import parallel, tangents
from femu_piezo.diagnosis.verdict import judge
from femu_piezo.inference.fit import JointFit, SweepData, fit_joint, whitened

NOISE = 1e-3


def data_with(setup, sizes: dict[str, float], seed: int, known: bool = True) -> SweepData:
    """A noisy sweep with effects of given sizes."""
    parameters, x = JointParameters(setup.material), setup.x
    for key, size in sizes.items():
        parameters, x = parameters.with_effect(setup.library[key]), np.append(x, size / setup.library[key].scale)
    z = setup.evaluation.impedance(parameters, x)
    normal = np.random.default_rng(seed).standard_normal((2, z.size))
    z = z * (1 + NOISE * (normal[0] + 1j * normal[1]) / np.sqrt(2))
    prior = weak_prior(setup.material, setup.material.free.start)
    return SweepData(z, np.full(z.size, NOISE), known, prior)


def run(setup, data):
    start = setup.x * (1 + 0.02 * np.cos(np.arange(setup.x.size)))
    library = list(setup.library.values())
    result = compare(setup.evaluation, data, JointParameters(setup.material), start, library)
    return result, judge(result, tangents(setup.evaluation, result.base, library), FREQUENCY)


def test_two_effects_are_both_named(setup):
    truth = {"series_resistance": 2.0, "wrong_width": 0.006}
    result, verdict = run(setup, data_with(setup, truth, 1))
    assert {cause.effect.key for cause in verdict.causes} == set(truth)
    assert verdict.word == "effect"
    for cause in verdict.causes:
        assert abs(cause.values[0] - truth[cause.effect.key]) < 4 * cause.std[0]
        assert cause.probability > 0.9
    assert result.final.held_out_score == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("known", [True, False])
def test_null_stays_null(setup, known):
    for seed in range(3):
        result, verdict = run(setup, data_with(setup, {}, 10 + seed, known))
        assert verdict.word == "none"
        assert result.found == ()
        hidden = {effect.key: constant for effect, constant in verdict.hidden}
        assert hidden["stray_capacitance"] == "eps33T"


@pytest.mark.slow
@pytest.mark.parametrize("known", [True, False])
def test_false_alarms_are_rare(setup, known):
    """300 nulls, effects at a place included: one alarm at most.

    One alarm in 300 bounds the rate by 1.6 % at 95 % confidence (Clopper and Pearson).
    """
    library, alarms = list(setup.library.values()), 0
    start = setup.x * (1 + 0.02 * np.cos(np.arange(setup.x.size)))
    for seed in range(300):
        data = data_with(setup, {}, 1000 + seed, known)
        alarms += bool(compare(setup.evaluation, data, JointParameters(setup.material), start, library).found)
    assert alarms <= 1


def test_what_no_candidate_describes_is_unknown(setup):
    """A bump near 160 kHz: structure is left, placed, and no cause is named with confidence."""
    data = data_with(setup, {}, 3)
    bump = 0.02 / (1 + ((FREQUENCY - 160e3) / 4e3) ** 2)
    data = SweepData(data.impedance * np.exp(bump), data.relative_noise, True, data.prior)
    _, verdict = run(setup, data)
    assert verdict.word == "unknown"
    assert all(cause.probability < 0.9 for cause in verdict.causes)
    assert any(low < 170e3 and high > 150e3 for low, high in verdict.after.worst_Hz)


def test_prediction_of_left_out_bands_is_that_of_fits_without_them(setup):
    """(I − H_bb)^-1 r_b against refits that do not see the band: within a tenth of σ."""
    data = data_with(setup, {}, 4)
    parameters = JointParameters(setup.material)
    fit = fit_joint(setup.evaluation, data, parameters, [setup.x])
    predicted = fit.predicted(5)
    for points in np.array_split(np.arange(FREQUENCY.size), 5):
        kept = np.setdiff1d(np.arange(FREQUENCY.size), points)
        evaluation = type(setup.evaluation)(setup.model, setup.evaluation.omega[kept])
        other = fit_joint(evaluation, data.select(kept), parameters, [setup.x])
        residual, slopes = whitened(setup.evaluation, data, parameters, other.x)
        unseen = residual[points] + 1j * residual[points + FREQUENCY.size]
        assert np.max(np.abs(unseen - predicted[points])) < 0.1
        rows = np.concatenate([points, points + FREQUENCY.size])
        square = np.sum(fit.residual[points] * predicted[points].real)
        square += np.sum(fit.residual[points + FREQUENCY.size] * predicted[points].imag)
        assert other.unseen_misfit(residual[rows], slopes[rows]) == pytest.approx(np.sqrt(square / rows.size), rel=0.05)


def test_misfit_of_left_out_bands_is_one_for_a_right_model_whatever_a_band_decides(setup):
    """Linear models of noise, one unknown of which only a band can tell: predictions err by more than the noise."""
    count, rng = 200, np.random.default_rng(8)
    data = SweepData(
        np.ones(count, complex), np.full(count, NOISE), True, weak_prior(setup.material, setup.material.free.start)
    )
    jacobian = rng.standard_normal((2 * count, 3))
    jacobian[:, 2] *= np.tile(np.where(np.isin(np.arange(count), data.bands()[1]), 1.0, 0.02), 2)
    span = np.linalg.qr(jacobian)[0]
    scores, misfits = [], []
    for _ in range(50):
        residual = rng.standard_normal(2 * count)
        residual -= span @ (span.T @ residual)
        fit = JointFit(None, np.zeros(3), residual, jacobian, np.zeros((0, 3)), np.zeros(0), (), data)
        scores.append(fit.held_out_score)
        misfits.append(fit.left_out_misfit)
    assert np.mean(scores) > 1.3
    assert np.mean(misfits) == pytest.approx(1.0, abs=0.02) and np.std(misfits) < 0.06


def test_evidence_profiles_the_noise(setup):
    """Noise estimated too small does not change BIC differences; misfit far below an estimated noise is no evidence."""
    library = [setup.library["leakage"]]
    gains = []
    for factor in (1.0, 0.5, 100.0):
        data = data_with(setup, {"leakage": 3e-6}, 5, known=False)
        data = SweepData(data.impedance, factor * data.relative_noise, False, data.prior)
        result = compare(setup.evaluation, data, JointParameters(setup.material), setup.x, library)
        gains.append(result.base.bic - result.singles[0][1].bic)
    assert gains[0] > 20
    assert gains[1] == pytest.approx(gains[0], rel=0.05)
    assert gains[2] < 0


def test_likeness_of_an_effect_with_itself_and_with_another(setup):
    data = data_with(setup, {}, 6)
    base = fit_joint(setup.evaluation, data, JointParameters(setup.material), [setup.x])
    found = {t.effect.key: t for t in tangents(setup.evaluation, base, list(setup.library.values()))}
    assert parallel(found["series_resistance"], found["series_resistance"], 1.0)
    assert not parallel(found["series_resistance"], found["wrong_width"], 1.0)
    assert found["stray_capacitance"].hidden and not found["wrong_width"].hidden
