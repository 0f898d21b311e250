"""The slow study: draws of every effect, nulls, pairs and undescribed effects; confusion matrix and rates.

pytest -m slow tests/hidden_effects -s
HIDDEN_DRAWS=3 HIDDEN_NULLS=10 HIDDEN_ONLY=point_mass,mounting HIDDEN_PROCESSES=2 HIDDEN_RESULTS=study.jsonl …

HIDDEN_DRAWS (of each effect), HIDDEN_NULLS, HIDDEN_PAIRS, HIDDEN_UNDESCRIBED, HIDDEN_SEED: numbers;
HIDDEN_LABORATORY=1: specimen and instrument are off by their tolerances; HIDDEN_ONLY: some of the effects;
HIDDEN_ROUND=1: disks and rings in a laboratory instead of plates and bars; HIDDEN_BARS=1: bars over two of their modes;
HIDDEN_RESULTS: file of finished draws, from which a study is resumed. How well its probabilities and deviations are
calibrated: python -m tests.hidden_effects.calibration study.jsonl --out DIR
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from hidden_effects.catalogue import EFFECTS
from hidden_effects.confusion import rates, report
from hidden_effects.draws import BAR, BAR_EFFECTS, draw
from hidden_effects.judge import judge_draw
from hidden_effects.round_draws import ROUND, ROUND_EFFECTS, draw_round
from hidden_effects.study import jobs, jobs_of_shapes, run


def _number(name: str, default: int) -> int:
    """An integer from the environment."""
    return int(os.environ.get(f"HIDDEN_{name}", default))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed", "least"),
    [
        ("laboratory:series_inductance+poling_gradient", 102004, 0.9),
        ("laboratory:electrode_margin", 103000, 0.9),
        ("laboratory:electrode_margin", 105002, 0.9),
        ("laboratory:electrode_margin", 117000, 0.9),
        ("laboratory:electrode_margin", 117001, 0.9),
        ("laboratory:point_mass", 116000, 0.9),
        ("laboratory:mounting+series_inductance", 104002, 0.9),
        ("laboratory:point_mass+series_resistance", 109009, 0.5),
        ("laboratory:frequency_dependent_elastic_loss+edge_depoling", 141001, 0.9),
        ("disk:mounting", 260000, 0.9),
        ("ring:frequency_dependent_elastic_loss", 310000, 0.9),
        ("ring:local_crack", 320001, 0.9),
        ("disk:local_crack", 320002, 0.9),
        ("disk:point_mass", 380000, 0.9),
        ("disk:local_crack", 395000, 0.9),
        ("disk:poling_gradient", 450000, 0.9),
        ("disk:contact_gap", 540000, 0.9),
        ("disk:temperature_drift", 540000, 0.9),
        ("laboratory:point_mass", 500000, 0.9),
        ("ring:fluid_load", 600000, 0.5),
        ("disk:unequal_electrode_mass", 600000, 0.9),
    ],
)
def test_causes_whose_fits_take_many_steps_are_found(name, seed, least, tmp_path):
    """Draws whose cause is missed if candidates are judged by rough fits or by linearisation alone.

    102004, 103000: after a rough fit other causes are predicted to gain more: three stand for the margin, a third one
    for the pair.

    105002: next to the unequal margin a gradient of the poling has a probability of 1.00.

    117000, 117001: no set holds the margin if its fit begins at the constants of the base fit.

    116000: linearisation at the onset of the mass predicts a gain 22 below that of its fit.

    104002, 109009: neither cause of the pair gains anything over a discrepancy by itself. Where every resonance may
    have an error of its own, the point mass of 109009 explains the sweep hardly better than such errors: it is named
    with 0.6.

    141001: by linearisation next to the first cause, the second one explains less than errors of every resonance.

    disk 260000: the descent to the three points takes a detour; after twelve evaluations one to a support in the middle
    lies lower.

    ring 310000: a support at a place fits as well as the losses, and linearisation predicts less for both than they
    gain, and less for the losses than the support gains.

    320001, 320002: rough fits of the crack end at wrong places, below what linearisation predicts, and need further
    starts.

    disk 380000, 395000: linearised at four times its mass, the point mass is predicted to gain nothing; the crack is
    predicted to gain less than a point mass does.

    disk 450000: a small gradient of the opposite sign traps the fit, and a support then has a probability of 1.00.

    disk 540000, gap: a fit of the constants alone ends at the wall of the stable materials, where no basis is exact.

    disk 540000, drift: a parabola in d between ±0.4 % misses the zero by twice the noise, and a crack fits better.

    ring and disk 600000: tolerances compensate the effect, the compliance s13 of the ring by six of its deviations.
    Where they stand linearisation promises a quarter of the evidence, and a support was named with 1.00. An elastic
    loss fits the ring as well as its fluid does.

    mass 500000: it is 1.6 deviations from zero, as its place makes up for it; a step is 2000 times less probable.
    """
    make = draw_round if name.startswith(("disk:", "ring:")) else draw
    outcome = judge_draw(make(name, seed), tmp_path)
    assert set(outcome.said) == set(outcome.truth) and min(outcome.said.values()) > least
    assert outcome.sizes and all(abs(size) < 3 for size in outcome.sizes.values())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        ("second_piece", 107004),
        ("delamination", 105003),
        ("tuned_mass", 107008),
        ("tuned_mass", 280000),
        ("half_film", 112007),
        ("range_switch", 400002),
    ],
)
def test_undescribed_effects_have_no_confident_name(kind, seed, tmp_path):
    """The verdict names no cause with a probability above 0.9.

    Each draw needs a form of misfit that is no cause: without a resonance of its own, the second piece is explained by
    three causes with 1.00; without an uneven body, half a film by a taper with 0.99; without a step, the change of
    range, too small to be a fault of the data, by a dispersion with 0.97. The second tuned mass (280000) looks like a
    point mass that leaves 2 % of the misfit of the fitted points.
    """
    assert not judge_draw(draw(f"laboratory:undescribed:{kind}", seed), tmp_path).confident


@pytest.mark.slow
def test_smoothed_noise_is_no_effect(tmp_path):
    """Noise averaged over three points, in a laboratory: taken as white noise it would give the verdict unknown."""
    outcome = judge_draw(draw("laboratory:none", 104015), tmp_path)
    assert outcome.word == "none" and not outcome.said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed"), [("stray_capacitance", 700000), ("stray_capacitance", 710000), ("cable", 710000)]
)
def test_a_capacitance_beside_a_bar_as_large_as_its_own_is_found(name, seed, tmp_path):
    """Leads of 20 to 33 pF beside bars of 20 pF: named first, or told beside a cable or a capacitance as likely.

    Without them the constants are driven off by the size of the capacitance. From there stray 700000 was told as a
    cable alone with 1.00, stray 710000 as a cable with an elastic loss, and cable 710000 was unknown.
    """
    outcome = judge_draw(draw(f"bar:{name}", seed), tmp_path)
    assert outcome.word == "effect" and outcome.in_class


@pytest.mark.slow
def test_confusion_matrix(capsys):
    """Every rate of the study reaches its required value."""
    only, seed, shapes, offered = os.environ.get("HIDDEN_ONLY", ""), _number("SEED", 1000), [], list(EFFECTS)
    if _number("ROUND", 0):
        shapes, offered = [f"{shape}:" for shape in ROUND], list(ROUND_EFFECTS)
    elif _number("BARS", 0):
        shapes, offered = [BAR], list(BAR_EFFECTS)
    effects = only.split(",") if only else offered
    if shapes:
        wanted = jobs_of_shapes(shapes, effects, draws=_number("DRAWS", 5), nulls=_number("NULLS", 20), seed=seed)
    else:
        wanted = jobs(
            effects,
            draws=_number("DRAWS", 10),
            nulls=_number("NULLS", 40),
            pairs=_number("PAIRS", 10),
            undescribed=_number("UNDESCRIBED", 10),
            seed=seed,
            laboratory=bool(_number("LABORATORY", 0)),
        )
    file = os.environ.get("HIDDEN_RESULTS")
    outcomes = []
    for outcome in run(wanted, _number("PROCESSES", 1), Path(file) if file else None):
        outcomes.append(outcome)
        with capsys.disabled():
            print(f"[{len(outcomes)}/{len(wanted)}] {outcome.line()}", flush=True)
    with capsys.disabled():
        print("\n" + report(outcomes))
    assert not [rate.line() for rate in rates(outcomes) if not rate.holds]
