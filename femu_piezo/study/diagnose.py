"""`diagnose`: specimen file and sweep → what the simulation gets wrong, the named cause, the gain."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from femu_piezo.diagnosis.compare import Comparison
from femu_piezo.diagnosis.effects import REFERENCE, library
from femu_piezo.diagnosis.evaluation import Evaluation
from femu_piezo.diagnosis.fitting import JointFit
from femu_piezo.diagnosis.likeness import tangents
from femu_piezo.diagnosis.verdict import Verdict, judge
from femu_piezo.extraction import extract
from femu_piezo.measurement.noise import estimate_noise
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.specimen import Specimen
from femu_piezo.study.diagnosis_run import LEAST_ERROR, Progress, Run
from femu_piezo.study.diagnosis_start import first_constants
from femu_piezo.study.effects import effect_context, known_effects
from femu_piezo.study.measured import Measured, measure
from femu_piezo.study.pole_zero_residuals import PoleZeroResiduals, pole_zero_residuals
from femu_piezo.updating.parameters import Estimate, estimates


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

    @cached_property
    def pole_zero(self) -> tuple[PoleZeroResiduals, PoleZeroResiduals]:
        """Base and final model against the poles and zeros of the whole sweep, held-out band included."""
        measured = extract(self.spectrum)
        base = pole_zero_residuals(measured, self.relative_noise, self.curves[0])
        if not self.verdict.causes:
            return base, base
        return base, pole_zero_residuals(measured, self.relative_noise, self.curves[1])

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
    noise = np.hypot(_relative_noise(measured), LEAST_ERROR)
    fitted = _mask(measured)
    context = effect_context(
        measured.problem, measured.pair.pole.frequency_Hz, float(np.median(np.abs(measured.spectrum.impedance)))
    )
    fixed = known_effects(measured.problem, context.fundamental_Hz, context.impedance)
    taken = {effect.title for effect, _ in fixed}
    candidates = tuple(effect for effect in library(context) if effect.title not in taken)
    clock["read and extract"], began = time.perf_counter() - began, time.perf_counter()
    tell("first update")
    start = first_constants(specimen, measured)
    clock["first update"], began = time.perf_counter() - began, time.perf_counter()
    run = Run(measured, noise, fitted, fixed, candidates)
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


def _mask(measured: Measured) -> np.ndarray:
    return np.isin(measured.spectrum.frequency, measured.fitted.frequency)


def _relative_noise(measured: Measured) -> np.ndarray:
    """(k,) over the whole sweep: of the file, else estimated from the roughness of the fitted part alone."""
    impedance = measured.spectrum.impedance
    if measured.spectrum.noise is not None:
        return measured.spectrum.noise / np.abs(impedance)
    return estimate_noise(measured.fitted).std(impedance) / np.abs(impedance)


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
