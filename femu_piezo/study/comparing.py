"""Which causes a sweep demands, by the models of its specimen: the comparison that a diagnosis rests on."""

from __future__ import annotations

from collections.abc import Sequence

from femu_piezo.diagnosis.rules import Rules
from femu_piezo.diagnosis.selection import Comparison, compare_from
from femu_piezo.diagnosis.whiteness import remaining
from femu_piezo.inference.fit import Fit
from femu_piezo.study.beginning import begin
from femu_piezo.study.model_cache import Bases
from femu_piezo.study.posterior import Posterior
from femu_piezo.study.progress import Clock
from femu_piezo.study.subjects import Subject, shared_library

#: Probability of what is left over by chance below which effects at a place are tried as well.
_DOUBT = 0.05


def compare_causes(
    several: Sequence[Subject], clock: Clock, bases: Bases, rules: Rules
) -> tuple[Posterior, Comparison]:
    """Models and comparison; effects at a place join where something is left that they might explain.

    Without its cause a sweep may be so far from the model that no fit of the constants alone ends; what a cause
    explains is asked all the same.
    """
    library = tuple(effect for effect in shared_library(several) if effect.is_candidate)
    clock.step("start")
    start = begin([one.measured for one in several], bases).constants
    posterior = Posterior(several, clock, bases, library)
    base = posterior.base(start, settled=False)
    if not _leaves_something(base):
        library = tuple(effect for effect in library if effect.local is None)
    clock.step("compare")
    return posterior, compare_from(
        base, posterior.evaluation, library, rules=rules, loss=posterior.loss, progress=clock.tell
    )


def _leaves_something(base: Fit) -> bool:
    """Whether a fit leaves more than about one null in ten does."""
    left = remaining(base.residual, base.determined, base.data.frequency, base.data.noise_known, base.data.sweeps)
    doubt = min(left.p_white, 1.0 if left.p_size is None else left.p_size)
    return doubt < _DOUBT or base.learned.log_evidence > 0
