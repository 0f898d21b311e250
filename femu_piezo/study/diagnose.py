"""`diagnose`: specimen file and sweep → what the simulation gets wrong, the named cause, the gain."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from femu_piezo.diagnosis.compare import Comparison, compare
from femu_piezo.diagnosis.effects import REFERENCE, library
from femu_piezo.diagnosis.evaluation import Evaluation
from femu_piezo.diagnosis.extended_model import ExtendedModel, extend_model
from femu_piezo.diagnosis.fitting import JointFit, SweepData
from femu_piezo.diagnosis.joint import JointParameters
from femu_piezo.diagnosis.likeness import tangents
from femu_piezo.diagnosis.verdict import Verdict, judge
from femu_piezo.errors import ConvergenceError
from femu_piezo.forward.reduction import reduce_model
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.measurement.noise import estimate_noise
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.specimen import Specimen, Update
from femu_piezo.study.effects import effect_context, known_effects
from femu_piezo.study.measured import Measured, measure
from femu_piezo.study.update import update
from femu_piezo.updating.data import CurveData, weak_prior
from femu_piezo.updating.least_squares import fit
from femu_piezo.updating.parameters import Estimate, FreeConstants, MaterialParameters, estimates

#: Mesh error (relative, of eigenvalues at the end of the sweep) and error of the reduced model, as shares of the noise,
#: and the ranges they are kept in.
_MESH_SHARE, _MESH_RANGE = 1 / 60, (5e-6, 1e-4)
_BASIS_SHARE, _BASIS_RANGE = 1 / 30, (5e-6, 5e-5)
#: Relative error of Z that the finest mesh leaves: sweeps are not taken to be more exact than the model.
_LEAST_ERROR = 10 * _MESH_RANGE[0]
#: Relative range of the free and of the held constants that the basis is trained for, and how far a base fit may
#: leave the first before the basis is made anew.
_FREE_SPREAD, _HELD_SPREAD, _LEAVE = 0.05, 0.1, 0.08
#: Mesh error of the first update, whose constants are only where to begin.
_FIRST_ACCURACY = 1e-3
#: rms |Δ log Z| of the first update above which a fit from the constants of the file is tried as well.
_POOR = 0.05

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Diagnosis:
    """Everything `diagnose` found.

    Attributes
    ----------
    spectrum : the whole sweep;  fitted : boolean mask of the points that fits saw
    relative_noise : (k,) of the whole sweep
    curves : Z of base and final model over the whole sweep
    gain : rms |Δ log Z| of the held-out band (or of bands predicted without them) before and after, and of the noise
    seconds : step → time
    """

    specimen: Specimen
    spectrum: ImpedanceSpectrum
    fitted: np.ndarray
    relative_noise: np.ndarray
    comparison: Comparison
    verdict: Verdict
    curves: tuple[np.ndarray, np.ndarray]
    gain: dict[str, float]
    reference_Hz: float
    unknowns: int
    reduced_size: int
    notes: tuple[str, ...]
    seconds: dict[str, float]

    def constants(self, fit: JointFit) -> dict[str, Estimate]:
        """Free constants of a fit with standard deviations."""
        material, x = fit.parameters.material, fit.x
        own = 2 * material.scale.size
        covariance = material.theta_covariance(x[:own], fit.covariance[:own, :own])
        return dict(zip(material.free.names, estimates(material.theta(x[:own]), covariance), strict=True))


def diagnose(specimen: Specimen, progress: Progress | None = None, *, most: int = 3) -> Diagnosis:
    """Compare every candidate effect with the sweep of a specimen.

    Parameters
    ----------
    progress : called with the name of each step
    most : most effects that may act together

    Raises
    ------
    InputError : a file, a key or a sweep cannot serve
    ConvergenceError : the base model cannot be fitted
    """
    tell, clock = progress or (lambda step: None), {}
    began = time.perf_counter()
    tell("read and extract")
    measured = measure(specimen)
    noise = np.hypot(_relative_noise(measured), _LEAST_ERROR)
    fitted = _mask(measured)
    context = effect_context(
        measured.problem, measured.pair.pole.frequency_Hz, float(np.median(np.abs(measured.spectrum.impedance)))
    )
    fixed = known_effects(measured.problem, context.fundamental_Hz, context.impedance)
    taken = {effect.title for effect, _ in fixed}
    candidates = tuple(effect for effect in library(context) if effect.title not in taken)
    clock["read and extract"], began = time.perf_counter() - began, time.perf_counter()
    tell("first update")
    start = _first_constants(specimen, measured)
    clock["first update"], began = time.perf_counter() - began, time.perf_counter()
    run = _Run(measured, noise, fitted, fixed, candidates)
    comparison, model = run.compare(start, tell, clock, most)
    began = time.perf_counter()
    tell("verdict")
    evaluation = Evaluation(model, measured.fitted.omega)
    verdict = judge(comparison, tangents(evaluation, comparison.base, candidates), measured.fitted.frequency)
    whole = Evaluation(model, measured.spectrum.omega)
    curves = tuple(whole.impedance(fit.parameters, fit.x) for fit in (comparison.base, comparison.final))
    clock["verdict"] = time.perf_counter() - began
    return Diagnosis(
        specimen=specimen,
        spectrum=measured.spectrum,
        fitted=fitted,
        relative_noise=noise,
        comparison=comparison,
        verdict=verdict,
        curves=curves,
        gain=_gain(comparison, curves, measured, noise, fitted),
        reference_Hz=context.fundamental_Hz,
        unknowns=run.unknowns,
        reduced_size=model.size,
        notes=(*measured.spectrum.notes, *run.notes),
        seconds={step: round(value, 3) for step, value in clock.items()},
    )


def _first_constants(specimen: Specimen, measured: Measured) -> PiezoConstants:
    """Constants near the solution on a coarse mesh that knows no effects: by an update, or by a fit from the file's.

    The better of the two: the pole-zero update starts from thin-body formulas, which fail where the modes of two
    dimensions meet; the file's constants may be far away.
    """
    wish = (specimen.update or Update()).model_copy(update={"accuracy": _FIRST_ACCURACY})
    plain = specimen.model_copy(update={"update": wish, "effects": None})
    problem, found = measured.problem, []
    try:
        result = update(plain)
        found.append((result.outcomes[0].rms_after, result.constants))
    except ConvergenceError as error:
        reason = error
    if not found or found[0][0] > _POOR:
        highest = problem.equivalent_frequency(measured.band_Hz, _FIRST_ACCURACY)
        free = problem.free(problem.constants)
        training = free.training_sets(free.start, 0.15)
        reduced = reduce_model(problem.model(highest, _FIRST_ACCURACY), training, measured.band_Hz, accuracy=1e-4)
        curve = CurveData("first", reduced, measured.fitted, np.full(len(measured.fitted), 1e-2))
        material = MaterialParameters.around(free, free.start)
        try:
            solution = fit([curve, weak_prior(material, free.start)], material, free.start, noise_known=False)
            rms = float(np.sqrt(np.mean(solution.residual**2))) * 1e-2
            found.append((rms, free.constants(solution.theta)))
        except ConvergenceError as error:
            reason = error
    if not found:
        raise reason
    return min(found, key=lambda item: item[0])[1]


def _mask(measured: Measured) -> np.ndarray:
    return np.isin(measured.spectrum.frequency, measured.fitted.frequency)


def _relative_noise(measured: Measured) -> np.ndarray:
    """(k,) over the whole sweep: of the file, else estimated from the roughness of the fitted part alone."""
    impedance = measured.spectrum.impedance
    if measured.spectrum.noise is not None:
        return measured.spectrum.noise / np.abs(impedance)
    return estimate_noise(measured.fitted).std(impedance) / np.abs(impedance)


class _Run:
    """Mesh, basis and comparison; the basis is made anew where the base fit leaves its range."""

    def __init__(self, measured: Measured, noise: np.ndarray, fitted: np.ndarray, fixed, candidates) -> None:
        self._measured, self._fixed, self._candidates = measured, fixed, candidates
        self._noise = noise[fitted]
        typical = float(np.median(noise))
        self._accuracy = float(np.clip(typical * _MESH_SHARE, *_MESH_RANGE))
        self._basis_accuracy = float(np.clip(typical * _BASIS_SHARE, *_BASIS_RANGE))
        self.notes: tuple[str, ...] = ()
        if typical < 2 * _LEAST_ERROR:
            self.notes = (
                f"the noise of the sweep is near or below the error of the model; errors of Z below {_LEAST_ERROR:.0e} "
                "count as noise",
            )
        self.unknowns = 0

    def compare(
        self, start: PiezoConstants, tell: Progress, clock: dict[str, float], most: int
    ) -> tuple[Comparison, ExtendedModel]:
        began = time.perf_counter()
        problem, highest = self._measured.problem, self._measured.band_Hz
        tell("mesh and assemble")
        model = problem.model(problem.equivalent_frequency(highest, self._accuracy), self._accuracy)
        self.unknowns = model.size
        clock["mesh and assemble"], began = time.perf_counter() - began, time.perf_counter()
        constants = start
        for _ in range(3):
            tell(f"reduce {model.size} unknowns")
            free = problem.free(constants)
            effects = (*self._candidates, *(effect for effect, _ in self._fixed))
            extended = extend_model(model, _training(constants, free), effects, highest, accuracy=self._basis_accuracy)
            clock["reduce"] = clock.get("reduce", 0.0) + time.perf_counter() - began
            began = time.perf_counter()
            comparison = self._compared(extended, free, tell, most)
            clock["compare"] = clock.get("compare", 0.0) + time.perf_counter() - began
            began = time.perf_counter()
            material = comparison.base.parameters.material
            own = comparison.base.x[: 2 * material.scale.size]
            if np.max(np.abs(own[0::2] - 1)) <= _LEAVE:
                break
            constants = material.constants(own)
        return comparison, extended

    def _compared(self, extended: ExtendedModel, free: FreeConstants, tell: Progress, most: int) -> Comparison:
        material = MaterialParameters.around(free, free.start)
        prior = weak_prior(material, free.start)
        data = SweepData(self._measured.fitted.impedance, self._noise, self._measured.spectrum.noise is not None, prior)
        parameters = JointParameters(material, (), self._fixed)
        evaluation = Evaluation(extended, self._measured.fitted.omega)
        start = material.x_of(free.start)
        return compare(evaluation, data, parameters, start, self._candidates, most=most, progress=tell)


def _training(constants: PiezoConstants, free: FreeConstants) -> list[PiezoConstants]:
    """The start with its losses, corners of the free constants, and every held constant moved.

    One way each: the reduction watches the point mirrored at the start by itself.
    """
    lossless = constants.lossless()
    sets = [constants, *free.training_sets(free.start, _FREE_SPREAD, 4)[1:]]
    for name, value in lossless.as_dict().items():
        if name not in free.names and value != 0:
            moved = (lossless.with_values(**{name: value * (1 + sign * _HELD_SPREAD)}) for sign in (1, -1))
            sets += [item for item in moved if not item.physical_faults()][:1]
    return sets


def _gain(
    comparison: Comparison, curves, measured: Measured, noise: np.ndarray, fitted: np.ndarray
) -> dict[str, float]:
    """rms |Δ log Z| of points that the fit did not see, before and after, against the noise."""

    def rms(values: np.ndarray) -> float:
        return float(np.sqrt(np.mean(np.abs(values) ** 2)))

    if np.all(fitted):
        weight = comparison.base.data.weight
        errors = [fit.predicted() / weight for fit in (comparison.base, comparison.final)]
        floor = rms(noise)
    else:
        unseen = ~fitted
        errors = [np.log(curve[unseen] / measured.spectrum.impedance[unseen]) for curve in curves]
        floor = rms(noise[unseen])
    return {"held_out_before": rms(errors[0]), "held_out_after": rms(errors[1]), "noise_floor": floor}


def extended_specimen(diagnosis: Diagnosis) -> Specimen:
    """The specimen file with the updated constants and the named effects as known."""
    final, specimen = diagnosis.comparison.final, diagnosis.specimen
    material = final.parameters.material
    constants = material.constants(final.x[: 2 * material.scale.size])
    values = {}
    for name in final.parameters.material.free.names:
        values[name] = getattr(constants, name).real
        values[f"tan_{name}"] = max(0.0, constants.tangent(name)) if name[0] in "se" else constants.tangent(name)
    effects: dict[str, dict[str, float]] = {key: dict(table) for key, table in (specimen.effects or {}).items()}
    for effect, own in zip(final.parameters.effects, final.parameters.values(final.x), strict=True):
        table = effects.setdefault(effect.name, {})
        table.update({parameter.name: float(value) for parameter, value in zip(effect.parameters, own, strict=True)})
        if effect.dispersive:
            table.setdefault(REFERENCE, diagnosis.reference_Hz)
    return specimen.model_copy(
        update={"material": specimen.material.model_copy(update=values), "effects": effects or None}
    )
