"""Which causes a sweep demands, by the models of its specimen: the comparison that a diagnosis rests on."""

from __future__ import annotations

from collections.abc import Sequence

from femu_piezo.diagnosis.comparison import Comparison
from femu_piezo.diagnosis.rules import Rules
from femu_piezo.diagnosis.selection import compare_from
from femu_piezo.errors import ConvergenceError
from femu_piezo.study.beginning import begin
from femu_piezo.study.model_cache import Bases
from femu_piezo.study.posterior import Posterior
from femu_piezo.study.progress import Clock
from femu_piezo.study.subjects import Subject, shared_library


def compare_causes(
    several: Sequence[Subject], clock: Clock, bases: Bases, rules: Rules
) -> tuple[Posterior, Comparison]:
    """The models of the sweeps, and the comparison of sets of causes.

    Without its cause a sweep may be so far from the model that no fit of the constants alone settles; the comparison
    then starts from a coarse fit, and where even that has no start, at the constants of the file.
    """
    library = tuple(effect for effect in shared_library(several) if effect.is_candidate)
    posterior = Posterior(several, clock, bases, library)
    posterior.mesh()
    clock.step("start")
    start = several[0].problem.fitted
    try:
        start = begin([one.measured for one in several], bases).constants
    except ConvergenceError:
        if start.physical_faults(passive=False):
            raise
    base = posterior.base(start, settled=False)
    clock.step("compare")
    return posterior, compare_from(
        base, posterior.evaluation, library, rules=rules, loss=posterior.loss, progress=clock.tell
    )
