"""`update`: specimen files and measured sweeps → updated complex parameters of one material.

1. extract poles and zeros from each sweep (independent of any model);
2. start from the 1-D formulas; ε33T from the low end of a sweep where it has one (eqs 41, 42);
3. pole-zero iteration of the paper on each fundamental: (s11, d31) or (s33, d33);
4. where no sweep has a low end, more constants are free or several specimens join: maximum-likelihood fit of the
   curves, started from 3.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.inference.unknowns import Estimate, estimates
from femu_piezo.specimen.file import Specimen, Update
from femu_piezo.study.effects import has_effects
from femu_piezo.study.measured import Measured, baseline_constants, measure, start_constants
from femu_piezo.study.model_cache import Bases
from femu_piezo.study.progress import Clock, Progress
from femu_piezo.study.results import Outcome, UpdateResult
from femu_piezo.study.shapes import electrode_notes
from femu_piezo.study.solving import Run, State
from femu_piezo.study.starts import pair_names

#: rms |Δ log Z| of an updated model that is told as poor where it is also well above the noise.
_POOR = 0.01


def update(
    specimens: Specimen | Sequence[Specimen], progress: Progress | None = None, bases: Bases | None = None
) -> UpdateResult:
    """Update the free constants of a material from the measured sweeps of one or more specimens of it.

    The first specimen's [material] and [update] rule; the others bring geometry and sweep.

    Parameters
    ----------
    progress : called with the name of each step
    bases : where models and reduced bases come from; made for these specimens alone where None

    Raises
    ------
    InputError : a file, a key or a sweep cannot serve
    ConvergenceError : the iteration does not converge; the message says what to try
    """
    specimens = [specimens] if isinstance(specimens, Specimen) else list(specimens)
    clock = Clock(progress)
    clock.step("read and extract")
    return update_measured([measure(specimen) for specimen in specimens], clock, bases)


def update_measured(measured: Sequence[Measured], clock: Clock, bases: Bases | None = None) -> UpdateResult:
    """`update` of specimens whose sweeps have been read and analysed."""
    measured = list(measured)
    start = measured[0].problem.constants if has_effects(measured) else start_constants(measured)
    baseline, baseline_notes = baseline_constants(measured, start)
    method, origin = _method(measured)
    clock.step("mesh and assemble")
    run = Run(measured, method, clock, bases or Bases())
    state = run.solve(start, method)
    clock.step("curves")
    outcomes = tuple(run.outcome(index, state, baseline) for index in range(len(measured)))
    clock.step(None)
    return UpdateResult(
        name=" + ".join(one.problem.specimen.name for one in measured),
        baseline=baseline,
        constants=state.constants,
        parameters=_parameters(state),
        outcomes=outcomes,
        permittivity_source="fitted to the curve" if method == "curve" and origin != "given" else origin,
        method=method,
        fit=state.fit,
        known=state.known,
        provenance=state.provenance,
        notes=(*baseline_notes, *_notes(measured, state, outcomes)),
        seconds=clock.seconds,
    )


def _method(measured: list[Measured]) -> tuple[str, str]:
    """("pole_zero" or "curve", origin of ε33T): poles and zeros alone where two unknowns and a known ε33T suffice."""
    first = measured[0]
    specimen, free = first.problem.specimen, set(first.problem.specimen.material.free)
    wish = (specimen.update or Update()).method
    names = set(pair_names(first.problem.plate))
    if "eps33T" not in free:
        origin = "given"
    elif first.permittivity is not None:
        origin = f"low frequency ({first.spectrum.frequency[0]:.6g} Hz, eqs 41 and 42)"
    else:
        origin = "curve"
    enough = (
        not has_effects(measured)
        and bool(names)
        and free - {"eps33T"} == names
        and origin != "curve"
        and len(measured) == 1
    )
    if wish == "pole_zero" and not enough:
        raise InputError(
            f'{specimen.path or specimen.name}: update.method = "pole_zero" finds {" and ".join(sorted(names))} of one '
            "specimen without [effects] at a known eps33T; the sweep does not reach low frequency or other constants "
            'are free, so give eps33T and take it out of material.free, or use method = "curve"'
        )
    return ("pole_zero" if enough and wish != "curve" else "curve"), origin


def _parameters(state: State) -> dict[str, Estimate]:
    if state.fit is not None:
        return state.fit.estimates
    return dict(zip(state.free.names, estimates(state.theta, state.covariance), strict=True))


def _notes(measured: list[Measured], state: State, outcomes: tuple[Outcome, ...]) -> tuple[str, ...]:
    notes = [note for one in measured for note in one.spectrum.notes]
    notes += [note for one in measured for note in electrode_notes(one.problem.specimen)]
    notes += [f"poles and zeros: {note}" for one in measured for note in one.extraction.notes]
    notes += [f"updated constants: {fault}" for fault in state.constants.physical_faults(tolerance=1e-3)]
    if state.known is not None:
        loose = [name for name in state.known.names if state.known.verdict(name) == "not"]
        if loose:
            notes.append(f"the data do not determine {', '.join(loose)}: these stand where the prior holds them")
    if state.fit is not None and state.fit.noise_scale > 1 and all(one.noise_known for one in measured):
        notes.append(
            f"the sweep misses the model by {state.fit.noise_scale:.3g} times its stated noise: the standard "
            "deviations are those of this misfit, not of the noise"
        )
    for one, outcome in zip(measured, outcomes, strict=True):
        noise = float(np.median(one.relative_noise))
        if outcome.rms_after > max(_POOR, 5 * noise):
            notes.append(
                f"{one.problem.specimen.name}: the updated model still misses the sweep by "
                f"{100 * outcome.rms_after:.2g} % rms where its noise is {100 * noise:.2g} %: look at "
                "the curve before using the constants"
            )
    return tuple(notes)
