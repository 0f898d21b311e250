"""The slow study: draws of every effect, nulls, pairs and what no candidate describes; confusion matrix and rates.

pytest -m slow tests/hidden_effects -s
HIDDEN_DRAWS=3 HIDDEN_NULLS=10 HIDDEN_ONLY=point_mass,mounting HIDDEN_PROCESSES=2 HIDDEN_RESULTS=study.jsonl …

HIDDEN_DRAWS (of each effect), HIDDEN_NULLS, HIDDEN_PAIRS, HIDDEN_UNDESCRIBED, HIDDEN_SEED: numbers;
HIDDEN_LABORATORY=1: specimen and instrument are off by their tolerances; HIDDEN_ONLY: some of the effects;
HIDDEN_ROUND=1: disks and rings in a laboratory instead of plates and bars;
HIDDEN_RESULTS: file of finished draws, with which a study goes on where it ended. Whether the probabilities and
deviations in it are worth what they say: python -m tests.hidden_effects.calibration study.jsonl --out DIR
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from hidden_effects.catalogue import EFFECTS
from hidden_effects.confusion import rates, report
from hidden_effects.draws import draw
from hidden_effects.judge import judge_draw
from hidden_effects.round_draws import ROUND_EFFECTS, draw_round
from hidden_effects.study import jobs, round_jobs, run


def _number(name: str, default: int) -> int:
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
    ],
)
def test_causes_whose_fits_take_many_steps_are_found(name, seed, least, tmp_path):
    """After a rough fit other causes promise more: three of them stood for a margin, a third one for a pair.

    Beside the unequal margin of 105002 a gradient of poling stood at 1.00, and no set held those of 117000 and 117001
    where their fits began at the constants of the base. The onset of the mass of 116000 promises 22 less than it holds.
    Of the two pairs after it neither cause gains anything by itself over a discrepancy, and where every resonance may
    have an error of its own the point mass explains the sweep hardly better than that: it is named with 0.6. Of the
    last pair the second cause explains less than such errors, by linearisation beside the first. The descent to the
    three points under the disk takes a detour: after twelve evaluations one that ends at the middle lay lower. Beside
    the losses of the ring a support under it, at a place, left as little: linearisation had promised less of both than
    they hold, and of the losses less than the support held, so that they were not fitted. The rough fits of the two
    cracks ended at wrong places, below what was promised of them, and were not tried from others. Linearisation at four
    times the mass under the disk promised nothing of it, and less of the crack after it than a mass held. A small
    gradient of the poling of the other sign held the fit of the last one, and a support stood for it at 1.00.
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
def test_what_nothing_describes_has_no_confident_name(kind, seed, tmp_path):
    """A second piece, told as three causes at 1.00 without a resonance of its own; a stretch that is soft; a mass.

    Half a film, told as a taper at 0.99 without an uneven body. The second tuned mass was a point mass at 0.95, which
    left 2 % of the misfit of the points that were fitted. A change of range, too small for a fault of the data, was a
    dispersion at 0.97 without a step.
    """
    assert not judge_draw(draw(f"laboratory:undescribed:{kind}", seed), tmp_path).confident


@pytest.mark.slow
def test_smoothed_noise_is_no_effect(tmp_path):
    """Averages over three points of a laboratory's plate; taken as white noise the verdict was unknown."""
    outcome = judge_draw(draw("laboratory:none", 104015), tmp_path)
    assert outcome.word == "none" and not outcome.said


@pytest.mark.slow
def test_confusion_matrix(capsys):
    """Every rate of the study reaches what is asked for."""
    only, on_disks, seed = os.environ.get("HIDDEN_ONLY", ""), bool(_number("ROUND", 0)), _number("SEED", 1000)
    effects = only.split(",") if only else list(ROUND_EFFECTS if on_disks else EFFECTS)
    if on_disks:
        wanted = round_jobs(effects, draws=_number("DRAWS", 5), nulls=_number("NULLS", 20), seed=seed)
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
