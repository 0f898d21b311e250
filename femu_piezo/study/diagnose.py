"""`diagnose`: specimen file and sweep → what the simulation gets wrong, the named cause, the gain."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from femu_piezo.diagnosis.averaging import LEVEL
from femu_piezo.diagnosis.comparison import Comparison
from femu_piezo.diagnosis.next_measurement import Separation
from femu_piezo.diagnosis.rules import Rules
from femu_piezo.diagnosis.verdict import Verdict, judge
from femu_piezo.effects.library import FREE, REFERENCE, TEMPERATURE, Maker
from femu_piezo.errors import ConvergenceError, InputError
from femu_piezo.extraction import extract
from femu_piezo.extraction.linear_body import linear_body_misfit
from femu_piezo.forward.modal import ModalModel
from femu_piezo.inference.budget import constants_of
from femu_piezo.inference.ensemble import is_common
from femu_piezo.inference.fit import Fit
from femu_piezo.inference.held_out import misfit_of_unseen
from femu_piezo.inference.readings import contradictions
from femu_piezo.inference.unknowns import Estimate
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.resonances import Resonance
from femu_piezo.specimen.file import Specimen
from femu_piezo.standards.figures import StandardFigures
from femu_piezo.study.comparing import compare_causes
from femu_piezo.study.contradicted import of_another_material
from femu_piezo.study.measured import Measured, Sweep, conditions_of, measure_each, tables_of_the_first
from femu_piezo.study.model_cache import Bases
from femu_piezo.study.planning import recommended, separations
from femu_piezo.study.pole_zero_residuals import PoleZeroResiduals, pole_zero_residuals
from femu_piezo.study.posterior import Posterior
from femu_piezo.study.problem import refuse_nothing_free
from femu_piezo.study.progress import Clock, Progress
from femu_piezo.study.results import mesh_words, rms
from femu_piezo.study.shapes import electrode_notes
from femu_piezo.study.standard_figures import body_alone, capacitance_stated, figures_of
from femu_piezo.study.subjects import LEAST_ERROR, Subject, subjects
from femu_piezo.study.temperature import COEFFICIENTS, constants_under
from femu_piezo.threads import in_parallel, made_once, with_blas_limit

#: Most resonances of a linear body that is fitted for comparison.
_FEW = 4
#: A linear body misses the points as well from this share of the model's misfit and this multiple of the noise on.
_NEARLY, _CLEARLY = 0.6, 3.0


@dataclass(frozen=True)
class DiagnosedSweep:
    """One sweep of a specimen, with its base and final model.

    Attributes
    ----------
    name : name of the specimen in the causes, "" for the only one
    spectrum : the whole sweep;  fitted : boolean mask of the points that fits saw
    relative_noise : (k,) of the whole sweep
    curves : Z of base and final model over the whole sweep, each (k,), ohm
    reference_Hz : frequency at which laws over frequency are anchored
    mesh : the mesh of the model and its error, in words
    measured : the sweep with its poles and zeros
    constants : of the final model under the conditions of this sweep
    body : these constants on the body of the file, without causes and tolerances (`body_alone`)
    capacitance : of the final model (`capacitance_stated`)
    """

    specimen: Specimen
    name: str
    spectrum: ImpedanceSpectrum
    fitted: np.ndarray = field(repr=False)
    relative_noise: np.ndarray = field(repr=False)
    curves: tuple[np.ndarray, np.ndarray] = field(repr=False)
    reference_Hz: float
    mesh: str
    measured: Measured
    constants: PiezoConstants
    body: ModalModel = field(repr=False)
    capacitance: float | None

    @made_once
    def pole_zero(self) -> tuple[PoleZeroResiduals, PoleZeroResiduals]:
        """Base and final model against the poles and zeros of the whole sweep, held-out band included."""
        measured = self.measured.extraction if np.all(self.fitted) else extract(self.spectrum)
        curves = self.curves[:1] if np.array_equal(*self.curves) else self.curves
        found = list(in_parallel(lambda z: pole_zero_residuals(measured, self.relative_noise, z), curves))
        return found[0], found[-1]

    @made_once
    def figures(self) -> tuple[StandardFigures, ...]:
        """Standard figures of the sweep, one for each mode that the standards know, beside those of the final model."""
        return figures_of(self.measured, self.constants, self.curves[1], self.capacitance, self.body)

    @made_once
    def linear_body(self) -> LinearBody | None:
        """Misfit of the best linear body with the measured resonances; None where there are none, or more than four."""
        poles = [one.measured.frequency_Hz for one in self.pole_zero[0].poles]
        if not 0 < len(poles) <= _FEW:
            return None
        error = np.abs(np.log(self.curves[0] / self.spectrum.impedance)) / self.relative_noise
        simulated = replace(self.spectrum, impedance=self.curves[0])
        least, control = (linear_body_misfit(z, poles, self.relative_noise) for z in (self.spectrum, simulated))
        return LinearBody(len(poles), least, control, float(np.sqrt(np.mean(error**2))))


@dataclass(frozen=True)
class LinearBody:
    """Misfit that the best linear body leaves of a sweep, against that of the base model.

    Attributes
    ----------
    resonances : number of resonances of the body
    least : rms misfit of the body over the noise;  model : that of the base model
    control : `least` for the curve of the base model in place of the sweep; as that model is linear, this misfit comes
        from its resonances beyond the sweep
    """

    resonances: int
    least: float
    control: float
    model: float

    @property
    def to_blame(self) -> bool:
        """Whether it misses the points nearly as much as the model, so that the simulation is not what is wrong."""
        return np.sqrt(max(self.least**2 - self.control**2, 0.0)) > max(_NEARLY * self.model, _CLEARLY)


@dataclass(frozen=True)
class Diagnosis:
    """Everything `diagnose` found; properties of a single sweep are those of the sweep `shown`.

    Attributes
    ----------
    sweeps : all sweeps of all specimens
    gain : rms |Δ log Z| of the held-out band (or of bands predicted without them) before and after, and of the noise;
        "over_expected": the misfit after over what noise makes of such a prediction by a right model
    seconds : step → time
    separations : what further measurements would bring, by the model
    shown : number of the sweep that `specimen`, `spectrum`, `curves` and so on belong to
    """

    comparison: Comparison
    verdict: Verdict
    gain: dict[str, float]
    unknowns: int
    reduced_size: int
    notes: tuple[str, ...]
    seconds: dict[str, float]
    sweeps: tuple[DiagnosedSweep, ...]
    separations: tuple[Separation, ...] = ()
    shown: int = 0

    def of(self, index: int) -> Diagnosis:
        """The diagnosis with sweep number `index` shown, and the worst bands of that sweep alone."""
        verdict = replace(self.verdict, before=self.verdict.before.of(index), after=self.verdict.after.of(index))
        return replace(self, verdict=verdict, shown=index)

    @property
    def specimen(self) -> Specimen:
        """The specimen of the sweep shown, as that of this sweep alone."""
        return self.sweeps[self.shown].specimen

    @property
    def piece(self) -> Specimen:
        """The specimen of the sweep shown, with all its sweeps."""
        return self.sweeps[self.shown].measured.piece

    @property
    def spectrum(self) -> ImpedanceSpectrum:
        """The whole sweep shown."""
        return self.sweeps[self.shown].spectrum

    @property
    def fitted(self) -> np.ndarray:
        """(k,) bool: the points that fits saw."""
        return self.sweeps[self.shown].fitted

    @property
    def relative_noise(self) -> np.ndarray:
        """(k,) relative noise of the whole sweep shown."""
        return self.sweeps[self.shown].relative_noise

    @property
    def curves(self) -> tuple[np.ndarray, np.ndarray]:
        """Z of base and final model over the whole sweep, ohm."""
        return self.sweeps[self.shown].curves

    @property
    def reference_Hz(self) -> float:
        """Fundamental, Hz, at which laws over frequency are anchored."""
        return self.sweeps[self.shown].reference_Hz

    @property
    def linear_body(self) -> LinearBody | None:
        """Misfit of the best linear body to the sweep shown, where the verdict is "unknown"; else None."""
        return self.sweeps[self.shown].linear_body if self.verdict.word == "unknown" else None

    @property
    def pole_zero(self) -> tuple[PoleZeroResiduals, PoleZeroResiduals]:
        """Poles and zeros of the sweep shown against those of base and final model."""
        return self.sweeps[self.shown].pole_zero

    @property
    def without_partner(self) -> tuple[tuple[Resonance, ...], tuple[Resonance, ...]]:
        """Clear resonances that the sweep alone has, then those that the final model alone has.

        None where a cause is how the sweep was taken: resonances that bend or drift look like several, or like none.
        """
        if any(cause.effect.acquisition is not None for cause in self.verdict.causes):
            return (), ()
        final = self.pole_zero[1]
        return final.unexplained, final.extra

    @made_once
    def before(self) -> dict[str, Estimate]:
        """Free constants of the base model with standard deviations and budgets."""
        return constants_of(self.comparison.base)

    @made_once
    def after(self) -> dict[str, Estimate]:
        """Free constants of the final model with deviations and budgets, and their intervals averaged over causes."""
        found, intervals = constants_of(self.comparison.final), self.comparison.averaged.interval(LEVEL)
        pairs = intervals.reshape(-1, 2, 2).tolist()
        return {
            name: replace(estimate, interval=tuple(value), tan_interval=tuple(tangent))
            for (name, estimate), (value, tangent) in zip(found.items(), pairs, strict=True)
        }


@with_blas_limit
def diagnose(
    specimens: Specimen | Sequence[Specimen],
    progress: Progress | None = None,
    bases: Bases | None = None,
    *,
    rules: Rules | None = None,
    spectra: Sequence[Sweep] | None = None,
    effects: Iterable[Maker] | None = None,
) -> Diagnosis:
    """Compare sets of candidate effects with the sweep of a specimen, or with those of several of one material.

    [material] and [update] are those of the first specimen; constants and fixture are common, other effects belong to
    one specimen.

    Parameters
    ----------
    progress : called with the name of each step
    bases : where models and bases come from; made for these specimens alone where None
    rules : prior probabilities and thresholds
    spectra : the sweeps of the specimens, in memory or in other files than theirs; those of their files where None
    effects : the candidates, effects or functions of an `EffectContext`; those of the library where None

    Raises
    ------
    InputError : a file, a key or a sweep cannot serve
    ConvergenceError : the base model cannot be fitted
    """
    specimens = [specimens] if isinstance(specimens, Specimen) else list(specimens)
    refuse_nothing_free(specimens)
    if not isinstance(rules, Rules | None):
        raise InputError(f"rules are a femu_piezo.diagnosis.rules.Rules, not a {type(rules).__name__}")
    clock, bases, rules = Clock(progress), bases or Bases(), rules or Rules()
    clock.step("read and extract")
    several = subjects(measure_each(specimens, spectra), effects)
    posterior, comparison = compare_causes(several, clock, bases, rules)
    clock.step("verdict")
    verdict = judge(comparison)
    under = [_constants_under(posterior, index, comparison.final) for index in range(len(several))]
    sweeps = tuple(
        DiagnosedSweep(
            specimen=one.problem.specimen,
            name=one.name,
            spectrum=one.measured.spectrum,
            fitted=one.fitted,
            relative_noise=one.noise,
            curves=(posterior.curve(index, comparison.base), posterior.curve(index, comparison.final)),
            reference_Hz=one.context.fundamental_Hz,
            mesh=mesh_words(posterior.full[index], posterior.models[index]),
            measured=one.measured,
            constants=under[index],
            body=body_alone(posterior, index, comparison.final, under[index]),
            capacitance=capacitance_stated(one.measured, partial(posterior.impedance, index, comparison.final)),
        )
        for index, one in enumerate(several)
    )
    clock.step("plan")
    planned, unplanned = _planned(several, posterior, comparison, verdict)
    clock.step(None)
    return Diagnosis(
        comparison=comparison,
        verdict=replace(verdict, measurements=recommended(verdict, planned)),
        gain=_gain(posterior, comparison, sweeps),
        unknowns=posterior.unknowns,
        reduced_size=sum(model.size for model in set(posterior.models)),
        notes=(
            *(note for one in several for note in one.measured.spectrum.notes),
            *tables_of_the_first([one.measured for one in several]),
            *dict.fromkeys(note for one in several for note in electrode_notes(one.measured.piece)),
            *_accuracy_notes(several),
            *(note for one in several for note in one.noise_notes),
            *contradictions(comparison.final),
            *of_another_material(comparison.final, several[0].problem.specimen.material.base),
            *unplanned,
        ),
        seconds={step: round(value, 3) for step, value in clock.seconds.items()},
        sweeps=sweeps,
        separations=planned,
    )


def _constants_under(posterior: Posterior, index: int, final: Fit) -> PiezoConstants:
    """The constants of a fit under the conditions of one sweep."""
    _, unknowns, columns = posterior.whole_sweep(index, final)
    return constants_under(unknowns, final.x[columns])


def _planned(
    several: Sequence[Subject], posterior: Posterior, comparison: Comparison, verdict: Verdict
) -> tuple[tuple[Separation, ...], tuple[str, ...]]:
    """Separations by further measurements; none, and a note, where the constants are too far off to simulate."""
    try:
        return separations(several, posterior, comparison, verdict), ()
    except ConvergenceError as error:
        return (), (f"No further measurement was planned: {error}",)


def _accuracy_notes(several: Sequence[Subject]) -> tuple[str, ...]:
    if min(float(np.median(one.noise)) for one in several) >= 2 * LEAST_ERROR:
        return ()
    return (
        f"the noise of the sweep is near or below the numerical error of the model; relative errors of Z below "
        f"{LEAST_ERROR:.0e} are counted as noise",
    )


def _gain(posterior: Posterior, comparison: Comparison, sweeps: Sequence[DiagnosedSweep]) -> dict[str, float]:
    """rms |Δ log Z| of points that the fit did not see, before and after, against the noise.

    Noise also moves the constants that predict such points; `over_expected` is the misfit after in units of what
    noise at the points and in all unknowns makes of it: 1 for a right model.
    """

    final = comparison.final
    unseen = [(index, sweep) for index, sweep in enumerate(sweeps) if not np.all(sweep.fitted)]
    if unseen:
        errors = [
            np.concatenate([np.log(one.curves[i] / one.spectrum.impedance)[~one.fitted] for _, one in unseen])
            for i in (0, 1)
        ]
        floor = np.concatenate([one.relative_noise[~one.fitted] for _, one in unseen])
        slopes = np.concatenate([posterior.log_slopes(index, final)[~one.fitted] for index, one in unseen])
        weight = np.sqrt(2) / floor
        whitened, slopes = errors[1] * weight, slopes * weight[:, None]
        parts = (np.concatenate([whitened.real, whitened.imag]), np.concatenate([slopes.real, slopes.imag]))
        misfit = misfit_of_unseen(*parts, final.covariance)
    else:
        errors = [fit.data.from_noise(fit.held_out.predicted) for fit in (comparison.base, final)]
        floor = np.concatenate([one.relative_noise for one in sweeps])
        misfit = final.held_out.misfit
    return {
        "held_out_before": rms(errors[0]),
        "held_out_after": rms(errors[1]),
        "noise_floor": rms(floor),
        "over_expected": misfit,
    }


def extended_specimen(diagnosis: Diagnosis) -> Specimen:
    """The specimen file of the specimen shown with the named effects; simulations give the fitted curve.

    [fitted] holds the fitted constants and the fitted values of effects with a tolerance; the parameters of the named
    effects are free. A further fit starts from these values, but its priors are centred on those of the file as before,
    so that no data count twice.
    """
    final, specimen = diagnosis.comparison.final, diagnosis.specimen
    owner, fixtures = diagnosis.sweeps[diagnosis.shown].name, set()
    conditions = diagnosis.sweeps[diagnosis.shown].measured.conditions
    own_temperatures = {one.celsius for one in conditions_of(diagnosis.piece)} - {None}
    reference = None if conditions.celsius is None else conditions.celsius - conditions.warmer_K
    if diagnosis.piece.sweep is not None:
        specimen, fixtures = diagnosis.piece, {one.fixture for one in diagnosis.piece.sweep}
    material = final.parameters.material
    constants = material.constants(final.x[: final.parameters.of_material])
    values = {}
    for name in material.free.names:
        values[name] = getattr(constants, name).real
        values[f"tan_{name}"] = constants.tangent(name)
    tables: dict[str, dict] = {
        "effects": {key: dict(table) for key, table in (specimen.effects or {}).items()},
        "fitted": {"material": values},
    }
    for effect, fitted in zip(final.parameters.effects, final.parameters.values(final.x), strict=True):
        if effect.owner not in {"", owner, *fixtures}:
            continue
        if effect.name == COEFFICIENTS and own_temperatures <= {reference}:
            continue  # the fitted constants are those at the reference
        named = effect.freed or effect.key in final.parameters.candidates
        title = f"{effect.name} ({effect.owner})" if effect.owner in fixtures else effect.name
        table = tables["effects" if named else "fitted"].setdefault(title, {})
        found = {parameter.name: float(value) for parameter, value in zip(effect.parameters, fitted, strict=True)}
        table.update(found)
        if named:
            table[FREE] = tuple(dict.fromkeys((*table.get(FREE, ()), *found)))
        if effect.dispersive or effect.acquisition is not None:
            anchored = diagnosis.sweeps[0 if is_common(effect) else diagnosis.shown]
            table.setdefault(REFERENCE, anchored.reference_Hz)
        if effect.name == COEFFICIENTS:
            table[TEMPERATURE] = reference
    return specimen.model_copy(update={kind: table or None for kind, table in tables.items()})
