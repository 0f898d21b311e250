"""Comparison and verdict on data simulated by the model itself: evidence, two effects, effects hidden by constants,
left-out bands.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from diagnosis.conftest import FREQUENCY
from femu_piezo.diagnosis import verdict as verdicts
from femu_piezo.diagnosis.confounding import parallel, tangents
from femu_piezo.diagnosis.hypotheses import Weighing
from femu_piezo.diagnosis.rules import Rules
from femu_piezo.diagnosis.selection import compare
from femu_piezo.diagnosis.starts import starts
from femu_piezo.diagnosis.verdict import judge, no_imitation
from femu_piezo.effects.effect import Effect
from femu_piezo.inference.fit import Fit, fit
from femu_piezo.inference.held_out import misfit_of_unseen
from femu_piezo.measurement.autoregression import Autoregression
from femu_piezo.measurement.sweeps import SweepData, stacked
from femu_piezo.specimen.file import CONSTANTS
from femu_piezo.study.diagnose import _gain
from tests.noise import noisy

NOISE = 1e-3


def data_with(setup, sizes: dict[str, float], seed: int, known: bool = True, noise: float = NOISE) -> SweepData:
    """A noisy sweep of the plate with effects of the given sizes."""
    z = setup.evaluation.impedance(*setup.with_effects(sizes))
    return setup.data(noisy(z, noise, seed), noise, known)


def run(setup, data, *, placed: bool = True):
    """Comparison and verdict.

    placed : whether candidates at a place, which cost most of the time, are among those tried
    """
    start = setup.x * (1 + 0.02 * np.cos(np.arange(setup.x.size)))
    library = [effect for effect in setup.library.values() if placed or effect.local is None]
    result = compare(setup.evaluation, data, setup.unknowns, start, library)
    return result, judge(result)


@pytest.mark.slow
def test_two_effects_are_both_named(setup):
    """A resistance and a wrong width: named, sizes within 4 deviations, and the error of left-out bands is that of
    noise.
    """
    truth = {"series_resistance": 2.0, "wrong_width": 0.006}
    result, verdict = run(setup, data_with(setup, truth, 1), placed=False)
    assert {cause.effect.key for cause in verdict.causes} == set(truth)
    assert verdict.word == "effect"
    for cause in verdict.causes:
        assert abs(cause.values[0] - truth[cause.effect.key]) < 4 * cause.std[0]
        assert cause.probability > 0.9
    assert result.final.held_out.rms == pytest.approx(1.0, abs=0.2)


@pytest.mark.slow
def test_an_uneven_body_gives_the_verdict_unknown_and_its_profile(setup):
    """The form "uneven body", which is no cause, competes with a taper and a gradient of the poling.

    A resistance hidden as well is found; since the uneven body counts as unexplained, its stated probability is below
    0.9.
    """
    truth = (0.02, 0.0, 0.05, 0.01, 0.1, 0.02)
    data = data_with(setup, {"uneven_body": truth, "series_resistance": 1.0}, 2)
    names = ("series_resistance", "poling_gradient", "tapered_width", "uneven_body")
    library = [setup.library[name] for name in names]
    result = compare(setup.evaluation, data, setup.unknowns, setup.x, library)
    verdict = judge(result)
    assert verdict.word == "unknown" and [form.effect.key for form in verdict.forms] == ["uneven_body"]
    assert [cause.effect.key for cause in verdict.causes] == ["series_resistance"]
    assert result.causes[0].probability > 0.99 and verdict.causes[0].probability < 0.9
    form = verdict.forms[0]
    assert np.all(np.abs(form.values - truth) < 4 * form.std)


@pytest.mark.slow
def test_no_third_cause_is_sought_where_an_uneven_body_is_all_there_is(setup):
    """The verdict is unknown without any cause, and the search tries no set that enlarges a pair ("... and ...")."""
    data, steps = data_with(setup, {"uneven_body": (0.02, 0.0, 0.05, 0.01, 0.1, 0.02)}, 2), []
    names = ("series_resistance", "poling_gradient", "tapered_width", "wrong_width", "point_mass", "uneven_body")
    library = [setup.library[name] for name in names]
    result = compare(setup.evaluation, data, setup.unknowns, setup.x, library, progress=steps.append)
    assert judge(result).word == "unknown" and not result.causes
    assert any(words.startswith("candidate with ") for words in steps)
    assert not any(" and " in words for words in steps)


@pytest.mark.parametrize(("shares", "word"), [((0.3, 0.2), "effect"), ((0.3, 0.4), "unknown")])
def test_causes_that_each_leave_most_of_the_misfit_are_no_explanation(setup, monkeypatch, shares, word):
    """Two causes leave a tenth of the misfit of the base, and each a share of what there is without it."""
    truth = {"series_resistance": 2.0, "wrong_width": 0.006}
    library = [setup.library[name] for name in truth]
    data = data_with(setup, truth, 1)
    result = replace(compare(setup.evaluation, data, setup.unknowns, setup.x, library), discrepant=True)
    assert len(result.causes) == 2
    left = {id(cause.fit_without): share for cause, share in zip(result.causes, shares, strict=True)}
    monkeypatch.setattr(verdicts, "unexplained_share", lambda before, *_: left.get(id(before), 0.1))
    monkeypatch.setattr(verdicts, "_beyond_noise", lambda *_: True)
    found = judge(result)
    assert found.word == word and found.unexplained == 0.1
    assert [cause.probability for cause in found.causes] == [
        pytest.approx(cause.probability * no_imitation(share, 0.5))
        for cause, share in zip(result.causes, shares, strict=True)
    ]


@pytest.mark.parametrize("known", [True, False])
def test_null_stays_null(setup, known):
    """Three sweeps without an effect: verdict none, and the stray capacitance is reported as hidden by ε33T."""
    for seed in range(3):
        result, verdict = run(setup, data_with(setup, {}, 10 + seed, known))
        assert verdict.word == "none"
        assert result.causes == ()
        hidden = {effect.key: constant for effect, constant in verdict.hidden}
        assert hidden["stray_capacitance"] == "eps33T"


@pytest.mark.slow
@pytest.mark.parametrize("known", [True, False])
def test_false_alarms_are_rare(setup, known):
    """300 sweeps without an effect, candidates at a place included: one false alarm at most.

    One alarm in 300 bounds the rate by 1.6 % at 95 % confidence (Clopper and Pearson).
    """
    library, alarms = list(setup.library.values()), 0
    start = setup.x * (1 + 0.02 * np.cos(np.arange(setup.x.size)))
    for seed in range(300):
        data = data_with(setup, {}, 1000 + seed, known)
        alarms += bool(compare(setup.evaluation, data, setup.unknowns, start, library).causes)
    assert alarms <= 1


def test_candidates_are_listed_with_their_best_fits(setup):
    """The fit of the named cause is brought to its end after the first round of fits: the list has this one."""
    library = [setup.library[name] for name in ("series_resistance", "leakage")]
    result = compare(
        setup.evaluation, data_with(setup, {"series_resistance": 2.0}, 5), setup.unknowns, setup.x, library
    )
    (trial,) = (trial for trial in result.singles if trial.effect.key == "series_resistance")
    assert trial.fit is result.final


@pytest.mark.parametrize("placed", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_what_no_candidate_describes_is_unknown(setup, placed):
    """A bump of log |Z| near 160 kHz: the residual has structure there, and no cause is named with confidence."""
    data = data_with(setup, {}, 3)
    bump = 0.02 / (1 + ((FREQUENCY - 160e3) / 4e3) ** 2)
    _, verdict = run(setup, replace(data, impedance=data.impedance * np.exp(bump)), placed=placed)
    assert verdict.word == "unknown"
    assert all(cause.probability < 0.9 for cause in verdict.causes)
    assert any(low < 170e3 and high > 150e3 for low, high in verdict.after.worst_Hz)


def test_prediction_of_left_out_bands_is_that_of_fits_without_them(setup):
    """(I − H_bb)^-1 r_b against refits without the band: within 0.1 of the noise.

    The misfit of the unseen band agrees within 5 %.
    """
    data = data_with(setup, {}, 4)
    found = fit(setup.evaluation, data, setup.unknowns, [setup.x])
    predicted, bands = found.held_out.predicted, np.array_split(np.arange(FREQUENCY.size), 10)
    for points in bands[1::3]:
        kept = np.setdiff1d(np.arange(FREQUENCY.size), points)
        evaluation = type(setup.evaluation)(setup.model, setup.evaluation.omega[kept])
        refit = fit(evaluation, data.select(kept), setup.unknowns, [setup.x])
        residual, slopes = data.whitened(*setup.evaluation.with_jacobian(setup.unknowns, refit.x))
        unseen = residual[points] + 1j * residual[points + FREQUENCY.size]
        assert np.max(np.abs(unseen - predicted[points])) < 0.1
        rows = np.concatenate([points, points + FREQUENCY.size])
        square = np.sum(found.residual[points] * predicted[points].real)
        square += np.sum(found.residual[points + FREQUENCY.size] * predicted[points].imag)
        assert misfit_of_unseen(residual[rows], slopes[rows], refit.covariance) == pytest.approx(
            np.sqrt(square / rows.size), rel=0.05
        )


def test_misfit_of_left_out_bands_is_one_for_a_right_model_whatever_a_band_decides():
    """Linear models of noise in which a single band determines one of three unknowns.

    Without that band its prediction is uncertain: the rms error exceeds the noise by 30 %, but over its own uncertainty
    the misfit is 1.
    """
    count, rng = 200, np.random.default_rng(8)
    data = SweepData(np.arange(1.0, count + 1), np.ones(count, complex), np.full(count, NOISE), True)
    jacobian = rng.standard_normal((2 * count, 3))
    jacobian[:, 2] *= np.tile(np.where(np.isin(np.arange(count), data.bands()[1]), 1.0, 0.02), 2)
    span = np.linalg.qr(jacobian)[0]
    unknowns, nothing = SimpleNamespace(prior_std=np.ones(3)), np.zeros((0, 3))
    scores, misfits = [], []
    for _ in range(50):
        residual = rng.standard_normal(2 * count)
        residual -= span @ (span.T @ residual)
        fitted = Fit(unknowns, np.zeros(3), data, residual, jacobian, nothing[:, 0], nothing, np.zeros(count))
        scores.append(fitted.held_out.rms)
        misfits.append(fitted.held_out.misfit)
    assert np.mean(scores) > 1.3
    assert np.mean(misfits) == pytest.approx(1.0, abs=0.02) and np.std(misfits) < 0.06


def test_gain_is_of_log_z_where_the_noise_of_neighbours_is_correlated():
    """A smooth misfit of 1 % that no unknown explains: in the bands left out it is 1 % with any memory of the noise.

    Whitened, as the noise of neighbours is by four fifths the same, it is a third of that.
    """
    count = 200
    misfit = 0.01 * np.exp(1j * np.linspace(0, 3, count))
    noise, none = np.full(count, NOISE), np.zeros((2 * count, 1))
    data = SweepData(np.arange(1.0, count + 1), np.ones(count, complex), noise, True)
    sweeps = [SimpleNamespace(fitted=np.ones(count, dtype=bool), relative_noise=noise)]
    for memory in ((), (Autoregression((0.8,)),)):
        data = replace(data, noise_memory=memory)
        residual, unknowns = stacked(data.over_noise(misfit)), SimpleNamespace(prior_std=np.ones(1))
        fitted = Fit(unknowns, np.zeros(1), data, residual, none, np.zeros(1), np.eye(1), np.zeros(count))
        gain = _gain(None, SimpleNamespace(base=fitted, final=fitted), sweeps)
        assert gain["held_out_before"] == pytest.approx(0.01, rel=1e-9) and gain["noise_floor"] == pytest.approx(NOISE)
    assert fitted.held_out.rms == pytest.approx(0.01 / NOISE / 3, rel=0.1)


@pytest.mark.parametrize("known", [True, False])
def test_evidence_learns_the_noise(setup, known):
    """Noise stated 1.1 to 10 times too small changes the log odds of a leakage by less than 10 %.

    With noise stated 100 times too large the misfit is far below it, and there is no evidence for the cause.
    """

    def odds(factor: float) -> float:
        """Log odds of a leakage against none with the noise stated as `factor` times the true one."""
        data = data_with(setup, {"leakage": 3e-6}, 5, known)
        data = replace(data, relative_noise=factor * data.relative_noise)
        result = compare(setup.evaluation, data, setup.unknowns, setup.x, [setup.library["leakage"]])
        return result.singles[0].fit.log_evidence - fit(setup.evaluation, data, setup.unknowns, [setup.x]).log_evidence

    right = odds(1.0)
    assert right > 10
    assert [odds(factor) for factor in (0.9, 0.5, 0.1)] == pytest.approx([right] * 3, rel=0.1)
    assert odds(100.0) < 0.01


def test_starts_weigh_outliers_as_a_robust_fit_does(setup):
    """Four readings are 10 to 20 % off, and a Cauchy loss sets them aside with the weight 1/(1 + (r/s)²).

    With it the starts of a wedge promise less than the χ² of the fit, where without it they promise 1000 times as much;
    and the slope at a site of a crack is that of the weighted residual, by a difference.
    """
    data = data_with(setup, {"wedge": 0.03}, 3)
    away = np.ones(FREQUENCY.size)
    away[[4, 20, 35, 50]] = 1.1, 1.15, 0.9, 1.2
    data = replace(data, impedance=data.impedance * away)
    base = fit(setup.evaluation, data, setup.unknowns, [setup.x], loss="cauchy")
    wedge = starts(setup.evaluation, base, setup.library["wedge"])
    others = [start for start in wedge if start.x[-1] > 0.5]  # in scales; one start is at rest
    assert len(others) == len(wedge) - 1 == 3
    assert all(start.promised_chi_square < base.chi_square - 3 for start in others)
    assert max(start.linear.log_evidence for start in others) > base.log_evidence + 10

    crack = starts(setup.evaluation, base, setup.library["local_crack"])[0]
    column, step = crack.columns_of(crack.cause).start, 1e-3

    def residual(size: float) -> np.ndarray:
        x = crack.x.copy()
        x[column] = crack.cause.rest[0] / crack.cause.scale[0] + size
        error = np.log(setup.evaluation.impedance(crack.linear.parameters, x) / data.impedance) * np.sqrt(2) / NOISE
        return np.concatenate([error.real, error.imag])

    share = (1 + (residual(0.0) / base.level) ** 2) ** -0.5
    slope = share * (residual(step) - residual(0.0)) / step
    found = crack.linear.jacobian[:, column]
    assert np.linalg.norm(found - slope) < 0.01 * np.linalg.norm(slope)


def test_likeness_of_an_effect_with_itself_and_with_another(setup):
    """A resistance is parallel to itself and not to a width; a stray capacitance is hidden by the free constants."""
    data = data_with(setup, {}, 6)
    base = fit(setup.evaluation, data, setup.unknowns, [setup.x])
    alone = [starts(setup.evaluation, base, effect)[0] for effect in setup.library.values() if effect.local is None]
    found = {t.effect.key: t for t in tangents(base, alone)}
    assert parallel(found["series_resistance"], found["series_resistance"], 1.0)
    assert not parallel(found["series_resistance"], found["wrong_width"], 1.0)
    assert found["stray_capacitance"].hidden and not found["wrong_width"].hidden


@pytest.mark.parametrize("share", [0.0, pytest.param(0.15, marks=pytest.mark.slow)])
def test_a_misfit_beyond_the_noise_makes_the_verdict_unknown(setup, share):
    """A resistance, and ripples of 15 % of Z that no candidate makes and that are too rough for a smooth
    discrepancy.
    """
    ripples = share * np.sin(np.arange(FREQUENCY.size) * 0.9) * np.exp(1j * np.arange(FREQUENCY.size) * 0.2)
    data = data_with(setup, {"series_resistance": 8.0}, 1)
    data = replace(data, impedance=data.impedance * (1 + ripples))
    result, verdict = run(setup, data, placed=share > 0)
    assert not result.discrepant
    assert verdict.word == ("unknown" if share else "effect")


def test_odds_of_sets_are_those_of_the_formula():
    """p^|S| π^δ (1 − π)^(1 − δ), p = q/(N + F) and π = F p: q causes are expected, laws of one cause share its p.

    Three causes, one of them with two laws; q = 0.5 and F = 3.01.
    """
    library = [Effect(name, name, (), law=law) for name, law in (("a", ""), ("b", ""), ("c", "one"), ("c", "two"))]
    weighing, each = Weighing(None, None, library, Rules()), 0.5 / 6.01
    chances = [each, each, each / 2, each / 2]
    assert [weighing.log_prior[effect.key] for effect in library] == pytest.approx(np.log(chances))
    assert weighing.discrepancy_prior == pytest.approx(3.01 * each)
    assert sum(chances) + weighing.discrepancy_prior == pytest.approx(0.5)

    parameters = SimpleNamespace(candidates=("a", library[2].key), causes=(library[0], library[2]))
    found = SimpleNamespace(parameters=parameters, log_evidence=-7.0, learned=SimpleNamespace(log_evidence=4.0))
    of_set = weighing.hypothesis(found)
    plain = np.exp(-7.0) * each * each / 2 * (1 - 3.01 * each)
    discrepant = np.exp(-7.0 + 4.0) * each * each / 2 * 3.01 * each
    assert of_set.log_plain == pytest.approx(np.log(plain)) and of_set.discrepant
    assert of_set.log_with_discrepancy == pytest.approx(np.log(discrepant))
    assert of_set.log_posterior == pytest.approx(np.log(plain + discrepant))


def test_probability_that_a_cause_is_no_imitation():
    """A cause leaves a share of the misfit: its odds are `expected` (1 − left)/left, here with 0.5 causes expected."""
    chances = np.array([no_imitation(left, 0.5) for left in (0.0, 0.01, 1 / 7, 1 / 3, 1.0)])
    assert chances == pytest.approx([1.0, 0.9802, 0.75, 0.5, 0.0], abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("height", [0.0, 0.02])
def test_a_second_cause_is_doubted_where_an_undescribed_resonance_is_as_large(setup, height):
    """A resistance, and a wrong width whose change is far smaller than that of the resistance.

    With a resonance that no candidate describes and about as large as the change by the width, the width has a
    probability below 0.85, and without it above 0.99.
    """
    bump = height / (1 + 1j * (FREQUENCY - 160e3) / 4e3)
    data = data_with(setup, {"series_resistance": 60.0, "wrong_width": 0.003}, 3)
    result, verdict = run(setup, replace(data, impedance=data.impedance * np.exp(bump)), placed=False)
    first, second = verdict.causes
    assert [first.effect.key, second.effect.key] == ["series_resistance", "wrong_width"]
    assert first.probability > 0.9 and verdict.unexplained < 0.05
    assert result.causes[1].probability > 0.95
    assert second.probability < 0.85 if height else second.probability > 0.99
    if height:
        assert str(result.final.discrepancy) == "a resonance of its own near 159 kHz"


def test_a_cause_of_many_standard_deviations_is_not_said_to_be_imitated_by_constants(setup):
    """A resistance of one scale is hidden by the constants in this noise, a resistance of ten scales is not."""
    data = data_with(setup, {"series_resistance": 20.0}, 1, noise=0.02)
    result, verdict = run(setup, data, placed=False)
    (cause,) = verdict.causes
    assert cause.effect.key == "series_resistance" and cause.values[0] > 10 * cause.std[0]
    assert not [title for title in cause.indistinguishable_from if title.removeprefix("tan_") in CONSTANTS]
    (tangent,) = tangents(result.base, [starts(setup.evaluation, result.base, cause.effect)[0]])
    assert tangent.hides(1.0) and not tangent.hidden
