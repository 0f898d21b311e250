"""Forms of a misfit that no cause describes: the right form is found with its place, and its columns are the changes
of the curve that it stands for.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from femu_piezo.measurement import discrepancy_forms
from femu_piezo.measurement.autoregression import Autoregression
from femu_piezo.measurement.discrepancy import Discrepancy, learn_discrepancy
from femu_piezo.measurement.discrepancy_forms import (
    WEIGHTS,
    Alternatives,
    Sides,
    of_every_resonance,
    of_one_resonance,
    of_one_step,
    smooth,
)
from femu_piezo.measurement.sweeps import SweepData, stacked

FREQUENCY = np.geomspace(30e3, 250e3, 400)
OMEGA = 2 * np.pi * FREQUENCY
#: Three modes of a body and one above the sweep: f (Hz), Q and strength over the capacitance.
MODES = ((55e3, 80.0, 0.15), (118e3, 60.0, 0.02), (190e3, 70.0, 0.05), (400e3, 70.0, 0.2))
NOISE = 2e-3


def eigenvalues() -> np.ndarray:
    """λ (4,), rad²/s²."""
    return np.array([(2 * np.pi * f) ** 2 * (1 + 1j / q) for f, q, _ in MODES])


def body(moved: np.ndarray | float = 0.0, stronger: np.ndarray | float = 0.0, omega: np.ndarray = OMEGA) -> np.ndarray:
    """Z (k,) of the body with each λ multiplied by 1 + `moved` and each strength by 1 + `stronger`."""
    values = eigenvalues() * (1 + moved)
    strengths = np.array([k for *_, k in MODES]) * eigenvalues() * (1 + stronger)
    capacity = 1e-9 * (1 + np.sum(strengths / (values - omega[:, None] ** 2), axis=1))
    return 1 / (1j * omega * capacity)


def log_slope() -> np.ndarray:
    """(k,) ∂log Z/∂log f."""
    step = 1e-5
    return np.log(body(omega=OMEGA * (1 + step)) / body(omega=OMEGA * (1 - step))) / (2 * step)


def sweep(impedance: np.ndarray, seed: int = 0) -> SweepData:
    """The impedance as measured, with noise."""
    noise = np.random.default_rng(seed).standard_normal((FREQUENCY.size, 2)) @ [1, 1j] * NOISE / np.sqrt(2)
    return SweepData(FREQUENCY, impedance * np.exp(noise), np.full(FREQUENCY.size, NOISE), True)


def learned(data: SweepData) -> tuple[Discrepancy, Discrepancy]:
    """The discrepancy of data from the unchanged body, learned with all forms and with the smooth form alone."""
    model, slope = body(), log_slope()
    residual, span = stacked(data.over_noise(np.log(model / data.impedance))), np.zeros((2 * FREQUENCY.size, 1))
    forms = [smooth(data, slope), of_every_resonance(data, model), of_one_resonance(data, model, slope)]
    forms.append(of_one_step(data, slope))
    of_all_forms = learn_discrepancy(data, residual, span, forms)
    return of_all_forms, learn_discrepancy(data, residual, span, [smooth(data, slope)])


def test_noise_has_no_discrepancy():
    """Ten noisy sweeps of the unchanged body."""
    assert not any(learned(sweep(body(), seed))[0].probable for seed in range(10))


@pytest.mark.parametrize("one", [0, 1, 2])
@pytest.mark.parametrize("which", ["moved", "stronger"])
def test_columns_of_every_resonance_are_changes_of_the_curve(one, which):
    """A small change of λ or strength of mode `one` is a combination of the columns, to first order.

    The three modes in the sweep have six columns; the mode far above it has none.
    """
    change = np.zeros(4, dtype=complex)
    change[one] = 1e-6 * (1 + 0.5j)
    target = np.log(body(**{which: change}) / body())
    (first, *_) = of_every_resonance(sweep(body()), body())
    columns = first.columns[:, 0]
    remainder = target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]
    assert np.linalg.norm(remainder) < 1e-3 * np.linalg.norm(target)
    assert columns.shape[1] == 6  # λ and strength of the three modes inside the sweep


def test_columns_have_the_size_that_is_said():
    """The error of log Z that the columns of each form describe has an rms of 1 in Re and in Im over the sweep."""
    data, model, slope = sweep(body()), body(), log_slope()
    at_places = of_one_resonance(data, model, slope), of_one_step(data, slope)
    for form in (smooth(data, slope), of_every_resonance(data, model), *at_places):
        for one in form:
            assert size(one) == pytest.approx(np.ones(one.places.size), rel=0.03)


def size(one: Alternatives) -> np.ndarray:
    """(n,) rms over the points of the error of log Z, for each alternative."""
    white = one.whitened(SweepData(FREQUENCY, body(), np.full(FREQUENCY.size, np.sqrt(2)), True))
    return np.sqrt(np.sum(white**2, axis=(0, 2)) / (2 * FREQUENCY.size))


@pytest.mark.parametrize("place", [71.3e3, 112.4e3, 161.7e3])
@pytest.mark.parametrize("quality", [20.0, 47.0])
def test_a_branch_beside_the_piece_is_a_resonance_of_its_own(place, quality):
    """A series branch of R, L, C parallel to the body: found within 0.75 bandwidths of its resonance, and not
    described by the smooth form.
    """
    resonance, capacity = 2 * np.pi * place, 1e-12
    branch = 1 / (1j * OMEGA * capacity) * (1 - (OMEGA / resonance) ** 2 + 1j * OMEGA / resonance / quality)
    found, smooth_alone = learned(sweep(1 / (1 / body() + 1 / branch)))
    assert found.form == "a resonance of its own" and found.probable
    assert found.place == pytest.approx(place, rel=0.75 / quality)
    assert f"{found.place / 1e3:.3g} kHz" in str(found)
    assert found.log_evidence > smooth_alone.log_evidence + 20
    assert found.level == pytest.approx(1.0, abs=0.1)


def test_an_oscillator_that_moves_with_the_piece_is_a_resonance_of_its_own():
    """Its effective mass passes through a resonance at 134 kHz, and so do the frequencies of the body."""
    resonance = 2 * np.pi * 134e3
    added = 2e-4 / (1 - (OMEGA / resonance) ** 2 * (1 - 0.03j))
    found, smooth_alone = learned(sweep(body(omega=OMEGA * np.sqrt(1 + added))))
    assert found.form == "a resonance of its own"
    assert found.place == pytest.approx(134e3, rel=0.02)
    assert found.log_evidence > smooth_alone.log_evidence + 20


@pytest.mark.parametrize("place", [40e3, 120e3, 230e3])
def test_a_step_of_the_readings_is_found_with_its_place(place):
    """Readings 0.3 % larger from one frequency on: found within 3 % of that frequency, and not described by the
    smooth form.
    """
    found, smooth_alone = learned(sweep(body() * np.where(place < FREQUENCY, 1.003, 1.0)))
    assert found.form == "a step" and found.probable
    assert found.place == pytest.approx(place, rel=0.03)
    assert str(found) == f"a step near {found.place / 1e3:.3g} kHz"
    assert found.log_evidence > smooth_alone.log_evidence + 5
    assert found.level == pytest.approx(1.0, abs=0.1)


def test_a_step_of_the_body_is_found_between_two_resonances():
    """A body softer by 0.06 % from 150 kHz on: the third resonance has moved, the second has not, so that the step
    lies between them.
    """
    found, smooth_alone = learned(sweep(body(omega=OMEGA * np.where(FREQUENCY > 150e3, 1.0003, 1.0))))
    assert found.form == "a step" and 118e3 < found.place < 190e3
    assert found.log_evidence > smooth_alone.log_evidence + 5


@pytest.mark.parametrize("seed", [5, 6])
def test_independent_errors_of_the_modes_are_found(seed):
    """An error of each λ (frequency and loss) and strength: the form "of every resonance" is more probable than the
    smooth one.
    """
    rng = np.random.default_rng(seed)
    moved, stronger = (scale * rng.standard_normal((4, 2)) @ [1, 0.1j] for scale in (3e-5, 5e-3))
    found, smooth_alone = learned(sweep(body(moved, stronger)))
    assert found.form == "of every resonance"
    assert found.log_evidence - np.log(WEIGHTS[found.form] / sum(WEIGHTS.values())) > smooth_alone.log_evidence + 10
    assert found.over_noise > 1


def test_a_smooth_error_is_found():
    """An error of the gain that varies as a sine over the sweep."""
    wave = 5e-3 * np.sin(3 * np.log(FREQUENCY / 30e3))
    assert learned(sweep(body() * np.exp(wave)))[0].form == "smooth"


def test_over_noise_is_that_of_the_points_where_it_acts():
    """A tenth of the points is off by three times the noise, the others not at all: `over_noise` is 3."""
    columns = np.zeros((200, 1))
    columns[:10], columns[100:110] = 3.0, 3.0
    assert Discrepancy("smooth", 0.1, 1.0, 1.0, 0.0, columns).over_noise == pytest.approx(3.0)


def test_errors_of_every_resonance_need_three_resonances():
    """A capacitor, and the body up to 150 kHz with two resonances, whose errors are errors of the constants: no such
    form.
    """
    data = sweep(1 / (1j * OMEGA * 1e-9))
    assert list(of_every_resonance(data, 1 / (1j * OMEGA * 1e-9))) == []
    low = FREQUENCY < 150e3
    assert list(of_every_resonance(sweep(body()).select(low), body()[low])) == []


@pytest.mark.parametrize("memory", [(), (Autoregression((0.5, 0.2)),)])
@pytest.mark.parametrize("loss", ["none", "alike", "unlike"])
def test_products_are_those_of_the_columns(memory, loss):
    """Products of the columns of each form with each other and with other vectors, for white and correlated noise.

    Each with the weights that a robust loss may give: none, alike for Re and Im, or different.
    """
    rng = np.random.default_rng(4)
    data, model, slope, k = replace(sweep(body()), noise_memory=memory), body(), log_slope(), FREQUENCY.size
    share = {"none": np.ones(2 * k), "alike": np.tile(rng.uniform(0.5, 1, k), 2), "unlike": rng.uniform(0.5, 1, 2 * k)}
    others = rng.standard_normal((2 * k, 3))
    for form in (smooth(data, slope), of_every_resonance(data, model), of_one_resonance(data, model, slope, (10.0,))):
        for one in form:
            one.products(Sides(data, np.full(2 * k, 0.7), others))  # products kept for other weights must not be used
            squares, sides = one.products(Sides(data, share[loss], others))
            columns = (one.whitened(data) * share[loss][:, None, None]).transpose(1, 2, 0)
            expected, along = columns @ columns.transpose(0, 2, 1), columns @ others
            assert np.max(np.abs(squares - expected)) < 1e-11 * np.max(np.abs(expected))
            assert np.max(np.abs(sides - along)) < 1e-11 * np.max(np.linalg.norm(columns, axis=2)) * np.sqrt(2 * k)


def test_products_without_kept_values_are_the_same(monkeypatch):
    """Long sweeps keep no products of pairs (`_KEPT`) and compute them from the rows."""
    data, model, slope, k = sweep(body()), body(), log_slope(), FREQUENCY.size
    sides = Sides(data, np.ones(2 * k), np.random.default_rng(4).standard_normal((2 * k, 3)))
    kept = list(of_one_resonance(data, model, slope, (30.0,)))
    monkeypatch.setattr(discrepancy_forms, "_KEPT", 0)
    for one, other in zip(kept, of_one_resonance(data, model, slope, (30.0,)), strict=True):
        assert one.pairs is not None and other.pairs is None
        for own, long in zip(one.products(sides), other.products(sides), strict=True):
            np.testing.assert_allclose(own, long, rtol=0, atol=1e-11 * np.max(np.abs(own)))


def test_a_chosen_alternative_has_the_columns_of_its_place():
    """`chosen` gives one place of several with its columns."""
    data, model, slope = sweep(body()), body(), log_slope()
    (several, *_) = of_one_resonance(data, model, slope, (10.0,))
    one = several.chosen(3)
    assert one.places == several.places[[3]]
    np.testing.assert_array_equal(one.columns[:, 0], several.columns[:, 3])
