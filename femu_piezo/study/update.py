"""`update`: specimen files and measured sweeps → updated complex parameters of one material.

1. extract poles and zeros from each sweep (independent of any model);
2. start from the 1-D formulas; ε33T from the low end of a sweep where it has one (eqs 41, 42);
3. pole-zero iteration of the paper on each fundamental: (s11, d31) or (s33, d33);
4. the most probable constants, all tolerances of the specimen file marginalised, by a fit of the curves from there.

With method = "pole_zero" step 3 is the answer, as in the paper; or all poles and zeros together (appendix A) where
more is free, more specimens join, or ε33T is not known.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from femu_piezo.effects.library import Maker
from femu_piezo.effects.words import quantity
from femu_piezo.errors import InputError
from femu_piezo.inference.budget import constants_of, estimates_of
from femu_piezo.inference.fit import Fit, with_discrepancy
from femu_piezo.inference.identifiability import Identifiability, identifiability
from femu_piezo.inference.readings import contradictions
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.sampling import sample_posterior
from femu_piezo.inference.starts.many_modes import ManyModes
from femu_piezo.inference.starts.pole_zero import Step
from femu_piezo.inference.unknowns import Unknowns, material_prior
from femu_piezo.material.constants import D_FORM, PiezoConstants
from femu_piezo.measurement.discrepancy import Discrepancy
from femu_piezo.specimen.file import Specimen, Update
from femu_piezo.study.beginning import begin
from femu_piezo.study.contradicted import at_limits, contradicted, of_another_material
from femu_piezo.study.effects import has_effects
from femu_piezo.study.measured import (
    Measured,
    Sweep,
    baseline_constants,
    measure_each,
    start_constants,
    tables_of_the_first,
)
from femu_piezo.study.model_cache import Bases
from femu_piezo.study.pole_zero_update import from_poles_and_zeros, no_history, pole_zero_update
from femu_piezo.study.posterior import Posterior
from femu_piezo.study.problem import refuse_nothing_free
from femu_piezo.study.progress import Clock, Progress
from femu_piezo.study.resonances_with_effects import matched_resonances, sensitivity_with_effects
from femu_piezo.study.results import Outcome, UpdateResult, mesh_words, rms_log_error
from femu_piezo.study.shapes import electrode_notes
from femu_piezo.study.standard_figures import body_alone, capacitance_stated
from femu_piezo.study.starts import pair_names
from femu_piezo.study.subjects import Subject, subjects
from femu_piezo.study.temperature import constants_under, temperature_series
from femu_piezo.threads import with_blas_limit

#: Error of Z by the bases of the pole-zero update.
_POLE_ZERO_BASIS = 1e-5
#: Factor on the noise of a sweep from which a note says so.
_LOUD = 1.2


def update(
    specimens: Specimen | Sequence[Specimen],
    progress: Progress | None = None,
    bases: Bases | None = None,
    *,
    spectra: Sequence[Sweep] | None = None,
    effects: Iterable[Maker] | None = None,
    samples: int = 0,
) -> UpdateResult:
    """Update the free constants of a material from the measured sweeps of one or more specimens of it.

    The first specimen's [material] and [update] rule; the others bring geometry and sweep.

    Parameters
    ----------
    progress : called with the name of each step
    bases : where models and reduced bases come from; made for these specimens alone where None
    spectra : the sweeps of the specimens, in memory or in other files than theirs; those of their files where None
    effects : what the [effects] of the files may name in addition to the library
    samples : number of samples drawn from the posterior; 0 for none

    Raises
    ------
    InputError : a file, a key or a sweep cannot serve
    ConvergenceError : the iteration does not converge; the message says what to try
    """
    specimens = [specimens] if isinstance(specimens, Specimen) else list(specimens)
    refuse_nothing_free(specimens)
    clock = Clock(progress)
    clock.step("read and extract")
    return update_measured(measure_each(specimens, spectra), clock, bases, effects, samples)


@with_blas_limit
def update_measured(
    measured: Sequence[Measured],
    clock: Clock,
    bases: Bases | None = None,
    effects: Iterable[Maker] | None = None,
    samples: int = 0,
) -> UpdateResult:
    """`update` of specimens whose sweeps have been read and analysed."""
    measured, bases = list(measured), bases or Bases()
    several = subjects(measured, effects)
    method, origin = _method(measured)
    if method == "pole_zero":
        if samples:
            raise InputError("samples of the posterior need a fit of the curve; leave out --method pole-zero")
        return _by_pole_zero(several, clock, bases, origin)
    posterior = Posterior(several, clock, bases)
    posterior.mesh()
    clock.step("start")
    beginning = begin(measured, bases)
    found = posterior.base(beginning.constants)
    found = with_probable_discrepancy(found)
    drawn = None
    if samples:
        clock.step("sample")
        drawn = sample_posterior(posterior.evaluation, found, samples, progress=clock.tell)
    clock.step("curves")
    known = _known(found)
    constants = found.parameters.material.constants(found.x[: found.parameters.of_material])
    baseline, baseline_notes = baseline_constants(measured, beginning.constants)
    outcomes = tuple(
        _outcome(posterior, index, found, baseline, beginning.histories[index]) for index in range(len(measured))
    )
    clock.step(None)
    return UpdateResult(
        name=" + ".join(dict.fromkeys(one.piece.name for one in measured)),
        baseline=baseline,
        constants=constants,
        parameters=constants_of(found),
        outcomes=outcomes,
        permittivity_source="given" if origin == "given" else "fitted to the curve",
        method=method,
        fit=found,
        known=known,
        provenance=_provenance(found, measured),
        notes=(
            *baseline_notes,
            *tables_of_the_first(measured),
            *_notes(several, constants, outcomes, found, known),
            *_low_end_note(measured),
        ),
        seconds=clock.seconds,
        temperature=temperature_series(found, several),
        samples=drawn,
    )


def with_probable_discrepancy(found: Fit) -> Fit:
    """The fit, its intervals counting a discrepancy where the data ask for one."""
    learned = found.learned
    return with_discrepancy(found, learned) if learned.probable else found


def _by_pole_zero(several: Sequence[Subject], clock: Clock, bases: Bases, origin: str) -> UpdateResult:
    """The paper's update alone."""
    measured = [one.measured for one in several]
    start = start_constants(measured)
    baseline, baseline_notes = baseline_constants(measured, start)
    fundamental = _is_the_papers(measured, origin)
    histories = (no_history(measured[0].problem),) * len(measured)
    posterior = Posterior(several, clock, bases)
    if fundamental:
        full = posterior.full
        clock.step("pole-zero update")
        state = pole_zero_update(measured, full, bases, start, _POLE_ZERO_BASIS)
        start, histories = state.constants, state.histories
    else:
        clock.step("start")
        start = begin(measured, bases).constants
    found = from_poles_and_zeros(posterior, start, fundamental=fundamental)
    clock.step("curves")
    outcomes = tuple(_outcome(posterior, index, found, baseline, histories[index]) for index in range(len(measured)))
    clock.step(None)
    material = found.parameters.material
    return UpdateResult(
        name=" + ".join(dict.fromkeys(one.piece.name for one in measured)),
        baseline=baseline,
        constants=found.constants,
        parameters=estimates_of(material, found.x, found.std, found.budget),
        outcomes=outcomes,
        permittivity_source=origin,
        method="pole_zero",
        fit=None,
        known=None,
        provenance=None,
        notes=(
            *baseline_notes,
            *tables_of_the_first(measured),
            *_notes(several, found.constants, outcomes),
            *_modes_note(found, fundamental),
            *_low_end_note(measured),
        ),
        seconds=clock.seconds,
    )


def _method(measured: list[Measured]) -> tuple[str, str]:
    """("pole_zero" or "curve", origin of ε33T); "auto" is the curve, which holds the poles and zeros and more."""
    first = measured[0]
    specimen, free = first.problem.specimen, set(first.problem.specimen.material.free)
    names = set(pair_names(first.problem.plate))
    if "eps33T" not in free:
        origin = "given"
    elif first.permittivity is not None:
        origin = f"low frequency ({first.spectrum.frequency[0]:.6g} Hz, eqs 41 and 42)"
    else:
        origin = "curve"
    if (specimen.update or Update()).method != "pole_zero":
        return "curve", origin
    if has_effects(measured) or (specimen.material.simplified and not _is_the_papers(measured, origin)):
        raise InputError(
            f'{specimen.path or specimen.name}: update.method = "pole_zero" cannot include [effects], and of the '
            f'simplified material it finds only {" and ".join(sorted(names))} at a known eps33T; use method = "curve"'
        )
    return "pole_zero", "prior" if origin == "curve" else origin


def _is_the_papers(measured: Sequence[Measured], origin: str) -> bool:
    """Whether the fundamental of one specimen determines what is free at a known ε33T, as in the paper's main part."""
    free = set(measured[0].problem.specimen.material.free)
    names = set(pair_names(measured[0].problem.plate))
    return len(measured) == 1 and bool(names) and free - {"eps33T"} == names and origin not in ("curve", "prior")


def _low_end_note(measured: Sequence[Measured]) -> tuple[str, ...]:
    """A note where ε33T is read off k33 sweeps alone, whose capacitance is not much above that of a fixture."""
    read = [one for one in measured if one.permittivity is not None and "eps33T" in one.problem.specimen.material.free]
    if not read or any(one.problem.plate.poling == "thickness" for one in read):
        return ()
    plate, eps = read[0].problem.plate, abs(read[0].permittivity)
    picofarad = 1e12 * eps * plate.electrode_area / plate.electrode_gap
    share = float(f"{100 / picofarad:.2g}")
    return (
        f"ε33T is found from the capacitance at the low end of a sweep along the poling, {picofarad:.2g} pF, of which "
        f"1 pF of stray capacitance is {share:g} %: take ε33T from a k31 plate of the lot, by "
        "eps33T and std_eps33T of its update, or update both together",
    )


def _modes_note(found: ManyModes, fundamental: bool) -> tuple[str, ...]:
    if fundamental:
        return ()
    used, every = (sum(map(len, of_each)) for of_each in (found.used, found.measured))
    words = f"{used} of {every} measured poles and zeros determine the constants"
    if found.rms_residual > 1:
        misfit = f"{found.rms_residual:.2g} standard deviations"
        words += f"; the model misses them by {misfit}, which widens the stated ones alike"
    return (words,)


def _outcome(
    posterior: Posterior, index: int, found: Fit | ManyModes, base: PiezoConstants, history: tuple[Step, ...]
) -> Outcome:
    """Curves and matched resonances of one specimen at the solution."""
    one = posterior.several[index].measured
    evaluation, unknowns, columns = posterior.whole_sweep(index, found)
    x, model = found.x[columns], posterior.full[index]
    matched, constants = matched_resonances(one, evaluation, unknowns, x), constants_under(unknowns, x)
    return Outcome(
        measured=one,
        matched=matched,
        capacitance=capacitance_stated(one, partial(posterior.impedance, index, found)),
        base_curve=_baseline_curve(posterior, evaluation, unknowns, base),
        updated_curve=posterior.curve(index, found),
        history=history,
        to_sensitivity=partial(sensitivity_with_effects, one.problem.specimen.name, evaluation, unknowns, x),
        unknowns=model.size,
        mesh=mesh_words(model, posterior.models[index]),
        constants=constants,
        body=body_alone(posterior, index, found, constants),
        noise=float(np.median(posterior.several[index].noise)),
        noise_memory=posterior.several[index].noise_memory,
    )


def _baseline_curve(posterior: Posterior, evaluation: Evaluation, own: Unknowns, base: PiezoConstants) -> np.ndarray:
    """Z (k,) of the constants of the file with its known effects, ohm."""
    free = posterior.problem.free(base)
    unknowns, x = Unknowns.of_constants(free, own.fixed)

    def made() -> np.ndarray:
        return evaluation.impedance(unknowns, x)

    return made() if own.fixed else posterior.bases.curve(evaluation.model, evaluation.omega, free, made)


def _known(found: Fit) -> Identifiability:
    """How well data determine each constant, with the weak prior in place of the file's; tolerances marginalised."""
    parameters = found.parameters
    count, free = parameters.of_material, parameters.material.free
    weak = replace(parameters, prior=material_prior(free, {}, {})).prior_std
    further = found.further_jacobian.copy()
    further[:count, :count] = np.diag(1 / weak[:count])
    rows = np.concatenate([found.factored.triangle / (found.level * parameters.prior_std), further])
    others = rows.shape[1] - count
    # R of the columns, those of the constants last: its last block is what the others leave of these
    ordered = np.hstack([rows[:, count:] * parameters.prior_std[count:], rows[:, :count]])
    marginal = np.linalg.qr(ordered, mode="r")[others:, others:]
    told = identifiability(marginal, parameters.material.names, found.x[:count])
    size = np.where([name.startswith("tan_") for name in told.names], 1.0, np.abs(found.x[:count]))
    return replace(told, std=np.maximum(told.std, found.std[:count] / size))  # a discrepancy widens them


def _provenance(found: Fit, measured: Sequence[Measured]) -> dict[str, dict[str, float]]:
    """Constant → sweep or "prior" → its share of what is known of the real part.

    The share of the prior is its precision (1/variance) over that of all together. The sweeps share the rest by what
    each adds to the precision, as the first and as the last one: two that show the same share as their precisions, two
    that only together determine a constant share alike. All other unknowns are marginalised.
    """
    k, std = found.residual.size // 2, found.parameters.prior_std
    slopes, further = found.jacobian * (std / found.level), found.further_jacobian * std
    of_sweeps = (slopes[np.concatenate([own, own + k])] for own in found.data.sweeps)
    forms, of_prior = [rows.T @ rows for rows in of_sweeps], further.T @ further

    def precision(form: np.ndarray) -> np.ndarray:
        """(n_x,) 1/variance, per prior deviation, of each unknown by normal equations (n_x, n_x) beside the prior's."""
        return 1 / np.diag(np.linalg.inv(form + of_prior))

    every = sum(forms)
    prior, joint = precision(np.zeros_like(every)), precision(every)
    adds = np.array([joint - prior])  # of one sweep
    if len(forms) > 1:
        adds = np.maximum([precision(form) - prior + joint - precision(every - form) for form in forms], 0.0)
    shares = (1 - prior / joint) * adds / np.maximum(adds.sum(axis=0), np.finfo(float).tiny)
    names = [one.problem.specimen.name for one in measured]
    return {
        name: {
            **dict(zip(names, shares[:, 2 * index].tolist(), strict=True)),
            "prior": float((prior / joint)[2 * index]),
        }
        for index, name in enumerate(found.parameters.material.free.names)
    }


def _notes(
    several: Sequence[Subject],
    constants: PiezoConstants,
    outcomes: tuple[Outcome, ...],
    found: Fit | None = None,
    known: Identifiability | None = None,
) -> tuple[str, ...]:
    measured = [one.measured for one in several]
    notes = [note for one in measured for note in one.spectrum.notes]
    notes += dict.fromkeys(note for one in measured for note in electrode_notes(one.piece))
    notes += [f"poles and zeros: {note}" for one in measured for note in one.extraction.notes]
    if measured[0].problem.specimen.material.simplified:
        notes.append(
            "the simplified material is taken as exact: the standard deviations do not include what it gets wrong; "
            "leave out simplified for those of all constants"
        )
    faults = constants.physical_faults(tolerance=1e-3)
    held = set(D_FORM) - set(measured[0].problem.specimen.material.free)
    of_other = [] if found is None else of_another_material(found, measured[0].problem.specimen.material.base)
    where = "" if found is None else ", together with the held ones of the file"
    notes += [f"updated constants{where}: {fault}" for fault in faults]
    if held and not of_other and any(fault.kind == "unstable" for fault in faults):
        notes.append("the constants that are held may be those of another material: see material.base and its values")
    notes += [note for one in several for note in one.noise_notes]
    if known is not None:
        loose = [name for name in known.names if known.verdict(name) == "not"]
        if loose:
            whose = "its value and standard deviation rest" if len(loose) == 1 else "their values and deviations rest"
            notes.append(f"the data alone do not determine {', '.join(loose)}: {whose} on the prior as well")
    notes += of_other
    if found is not None:
        notes += contradicted(found) + _fit_notes(found)
    doubts = ((outcome.measured.problem.specimen.name, outcome.doubt) for outcome in outcomes)
    notes += [f"{name}: {doubt}: look at the curve before using the constants" for name, doubt in doubts if doubt]
    return tuple(notes)


def _size_words(curve: np.ndarray, data: np.ndarray, discrepancy: Discrepancy) -> str:
    """The size of a discrepancy, and what of it remains where constants and tolerances make up for most.

    curve, data : (k,) Z of the fit and of the sweeps, ohm
    """
    told = f"about {discrepancy.sigma:.1g} of |Z| (rms)"
    remains = rms_log_error(curve, data) / np.sqrt(2)
    if remains > 0.5 * discrepancy.sigma:
        return told
    return f"{told}, of which the fit leaves {remains:.1g}"


def _fit_notes(found: Fit) -> list[str]:
    notes = contradictions(found) + at_limits(found)
    sizes = zip(found.parameters.effects, found.parameters.values(found.x), found.std_of_effects, strict=True)
    for effect, values, std in sizes:
        if effect.freed:
            of_each = zip(effect.parameters, values, std, strict=True)
            told = ", ".join(f"{p.name} = {quantity(p, float(value), float(sigma))}" for p, value, sigma in of_each)
            notes.append(f"{effect.title}, which the file leaves free, was fitted together with the constants: {told}")
    if found.discrepancy is not None and found.impedance is not None:
        size = _size_words(found.impedance, found.data.impedance, found.discrepancy)
        notes.append(
            f"the model is off by {found.discrepancy}, {size}; the standard deviations count that, and "
            "`femu-piezo diagnose` looks for its cause"
        )
    if found.data.noise_known and found.noise_scale > _LOUD:
        notes.append(
            f"the sweep is {found.noise_scale:.3g} times as noisy as stated: the standard deviations are based on the "
            "noise found"
        )
    return notes
