"""Separation of two causes by the choice of frequencies, on an independent discretisation (`hidden_effects`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hidden_effects.draws import draw

from femu_piezo.diagnosis.rivals import rivals
from femu_piezo.diagnosis.rules import Rules
from femu_piezo.effects.library import circuits, electrode_resistance, losses, relaxation
from femu_piezo.study.adaptive import Wish, adapt
from femu_piezo.study.comparing import compare_causes
from femu_piezo.study.linearised import Linearised
from femu_piezo.study.measured import measure_each
from femu_piezo.study.progress import Clock
from femu_piezo.study.subjects import subjects
from tests.study.bench import BAND, Bench, misfit_of_wrong, specimen_of


@pytest.fixture(scope="module")
def compared(bases, tmp_path_factory):
    """A plate whose permittivity falls with frequency, compared after 64 points; a relaxation explains such a fall
    as well.
    """
    drawn = draw("laboratory:dielectric_dispersion", 0)
    specimen = specimen_of(drawn, tmp_path_factory.mktemp("separation"))
    spectrum = Bench(drawn, level=1e-3, series=(21,))(np.linspace(*BAND, 64))
    several = subjects(measure_each([specimen], [spectrum]), [losses.candidates, relaxation.candidates])
    return compare_causes(several, Clock(lambda step: None), bases, Rules())


def test_the_pair_is_the_named_cause_and_the_best_in_its_place(compared):
    """The named cause and its best alternative; log odds and whether they count as separated."""
    two = rivals(compared[1])
    assert (two.first, two.second, two.named) == ("dielectric_dispersion", "relaxation", True)
    assert two.log_odds == -next(t.log_odds for t in compared[1].causes[0].fits if t.effect.title == "relaxation")
    assert two.told_apart == (two.log_odds > Rules().alike)
    assert not replace(two, named=False, log_odds=99.0).told_apart


def test_where_nothing_is_named_the_pair_is_the_best_cause_and_none(compared):
    """Or the two best causes where a misfit remains; no pair where every cause is improbable."""
    comparison = compared[1]
    alone = replace(comparison, final=comparison.base, causes=(), discrepant=False)
    by_title = {one.effect.title: one for one in comparison.singles}
    odds = {"relaxation": -1.0, "dielectric_dispersion": -2.0}
    weak = tuple(replace(by_title[title], log_odds=value) for title, value in odds.items())
    two = rivals(replace(alone, singles=weak))
    assert (two.first, two.second, two.log_odds) == ("no cause", "relaxation", 1.0)
    assert rivals(replace(alone, singles=tuple(replace(one, log_odds=-9.0) for one in weak))) is None
    two = rivals(replace(alone, singles=weak, discrepant=True))
    assert (two.first, two.second, two.told_apart) == ("relaxation", "dielectric_dispersion", False)


def test_sixteen_points_tell_what_sixty_four_equally_spaced_do(compared):
    """Misfit of either cause fitted to noiseless data of the other: above 0.9 of that with 64 further points.

    The gain by 16 chosen points is more than three times that by 16 equally spaced ones.
    """
    posterior, comparison = compared
    rival_causes = rivals(comparison)
    about = Linearised(posterior, comparison.final, 0.0)
    chosen, whole = about.most_separating(BAND, rival_causes.fits, 16)
    few, many = (np.linspace(*BAND, count + 2)[1:-1] for count in (16, 64))
    assert np.unique(chosen).size == 16 and BAND[0] <= chosen.min() and chosen.max() <= BAND[1]
    assert whole > about.separation(rival_causes.fits, chosen) > 3 * about.separation(rival_causes.fits, few)
    for right, wrong in (rival_causes.fits, rival_causes.fits[::-1]):
        before, best, equal, dense = (
            misfit_of_wrong(posterior, right, wrong, extra) for extra in (np.zeros(0), chosen, few, many)
        )
        assert best > 0.9 * dense and best - before > 3 * (equal - before) > 0


@pytest.mark.slow
def test_it_ends_when_the_causes_are_separated(bases, tmp_path, monkeypatch):
    """After a second round at least, since the first points are not chosen to separate the two causes.

    Candidates are circuits and the resistance of the electrodes.
    """
    drawn = draw("laboratory:series_resistance", 6)
    offered = [circuits.candidates, electrode_resistance.candidates]
    monkeypatch.setattr("femu_piezo.study.adaptive.subjects", lambda measured: subjects(measured, offered))
    bench = Bench(drawn, level=2e-3, series=(21,))
    found = adapt(specimen_of(drawn, tmp_path), bench, Wish(128, band_Hz=BAND, separate=True), bases=bases)
    last = found.states[-1]
    assert found.ended == "separated" and len(found.states) >= 2 and len(found.spectrum) < 128
    assert last.rivals.first == "series_resistance" and last.rivals.log_odds > Rules().alike
    assert f"series_resistance is distinguished from {last.rivals.second}" in found.sentence
    assert found.to_json()["rounds"][-1]["rivals"]["told"] is True
