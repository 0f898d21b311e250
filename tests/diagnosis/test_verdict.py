"""What a named cause cannot be told from: by the tangents of both, unless a fit with the other one shows it can."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from femu_piezo.diagnosis.comparison import NamedCause, Trial
from femu_piezo.diagnosis.confounding import Tangent
from femu_piezo.diagnosis.verdict import _cause


def effect(name: str) -> SimpleNamespace:
    usual = SimpleNamespace(usual=1.0, scale=1.0)
    one, rest = np.ones(1), np.zeros(1)
    return SimpleNamespace(key=name, title=name, rest=rest, scale=one, sizes=np.array([0]), parameters=(usual,))


@pytest.mark.parametrize(
    ("change", "log_odds", "fitted", "alike"),
    [(20.0, -20.0, True, True), (20.0, -300.0, True, False), (20.0, -300.0, False, True), (400.0, -300.0, True, True)],
)
def test_a_fit_that_is_far_worse_refutes_parallel_tangents(change, log_odds, fitted, alike):
    """Both effects change the sweep by so many σ in the same direction; a misfit of 24 σ is much of 20, little of 400.

    A fit that did not settle shows nothing.
    """
    mass, length = effect("end_mass"), effect("wrong_length")
    moves = [Tangent(one, np.array([[change], [0.0]]), change, "s11") for one in (mass, length)]
    parameters = SimpleNamespace(index=lambda key: 0, values=lambda x: [np.ones(1)])
    final = SimpleNamespace(parameters=parameters, x=None, std_of_effects=[np.full(1, 0.1)])
    comparison = SimpleNamespace(final=final, indistinguishable_from={"end_mass": ()})
    other = Trial(length, final if fitted else None, log_odds)
    found = _cause(NamedCause(mass, 1.0, (other,), None, 50.0), comparison, moves, 1.0)
    assert ("wrong_length" in found.indistinguishable_from) == alike
