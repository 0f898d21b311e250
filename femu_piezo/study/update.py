"""`update`: specimen file and measured sweep → updated complex parameters.

1. extract poles and zeros from the sweep (independent of any model);
2. start from the 1-D formulas; ε33T from the low end of the sweep where it has one (eqs 41, 42);
3. pole-zero iteration of the paper on the fundamental: (s11, d31) or (s33, d33);
4. where the sweep has no low end, or more constants are free: maximum-likelihood fit of the curve.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from femu_piezo.measurement.readers import read_spectrum

from femu_piezo.errors import InputError
from femu_piezo.extraction import Extraction, extract
from femu_piezo.extraction.roots import Pair
from femu_piezo.forward.fundamental import pair_of, reduced_source
from femu_piezo.forward.reduction import ReducedModel, reduce_model
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.material.simplified import simplify
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.resonances import Resonance
from femu_piezo.specimen import Specimen, Update
from femu_piezo.study.inputs import Problem, prepare
from femu_piezo.updating.curve import fit_curve, rms_log_error
from femu_piezo.updating.parameters import Estimate, FreeConstants, estimates
from femu_piezo.updating.pole_zero import (
    Step,
    propagate_covariance,
    static_permittivity,
    update_pair,
    update_simplified,
)
from femu_piezo.updating.start import bar_start

#: A sweep reaches low frequency where it starts below this share of the fundamental pole: there the plate is free
#: and uniform, and the error of eq 41 is about (f/f_p)² k² ≈ 2e-4.
LOW_FREQUENCY_SHARE = 0.03
#: Relative range of the free constants that one reduced basis covers, and how far they may leave it.
_SPREAD, _LEAVE = 0.25, 0.3
#: Eigenvalue error allowed at the end of the sweep when only the fundamental is fitted: the curve is then a picture.
_PICTURE_ACCURACY = 1e-3

Progress = Callable[[str], None]


@dataclass(frozen=True)
class UpdateResult:
    """Everything `update` found.

    Attributes
    ----------
    baseline, constants : the ten constants before and after
    parameters : free constant → estimate
    permittivity_source : how ε33T was obtained, in words
    history : the pole-zero iterations
    frequency : (n,) Hz of the sweep;  measured, base_curve, updated_curve : (n,) complex ohm
    rms_before, rms_after : rms |Δ log Z| over the sweep
    seconds : step → time
    """

    problem: Problem
    extraction: Extraction
    pair: Pair
    baseline: PiezoConstants
    constants: PiezoConstants
    parameters: dict[str, Estimate]
    model_pair: tuple[Resonance, Resonance]
    permittivity_source: str
    method: str
    history: tuple[Step, ...]
    spectrum: ImpedanceSpectrum
    base_curve: np.ndarray
    updated_curve: np.ndarray
    notes: tuple[str, ...]
    unknowns: int
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def rms_before(self) -> float:
        return rms_log_error(self.base_curve, self.spectrum.impedance)

    @property
    def rms_after(self) -> float:
        return rms_log_error(self.updated_curve, self.spectrum.impedance)

    def to_json(self) -> dict:
        """The contract of update.json."""
        measured = (self.pair.pole, self.pair.zero)
        records = [
            {
                "measured": data.to_json(),
                "model": {"frequency_Hz": model.frequency_Hz, "loss": model.loss},
            }
            for data, model in zip(measured, self.model_pair, strict=True)
        ]
        return {
            "specimen": self.problem.specimen.name,
            "parameters": {name: estimate.to_json() for name, estimate in self.parameters.items()},
            "poles": [records[0]],
            "zeros": [records[1]],
            "iterations": len(self.history) - 1,
            "converged": True,
            "method": self.method,
            "permittivity": self.permittivity_source,
            "rms_log_error": {"baseline": self.rms_before, "updated": self.rms_after},
            "constants": {
                name: {"value": value.real, "tan": self.constants.tangent(name)}
                for name, value in self.constants.as_dict().items()
            },
            "history": [
                {
                    "constants": {
                        name: {"value": getattr(step.constants, name).real, "tan": step.constants.tangent(name)}
                        for name in self.parameters
                    },
                    "pole": _record(step.eigenvalues[0], "pole"),
                    "zero": _record(step.eigenvalues[1], "zero"),
                }
                for step in self.history
            ],
            "notes": list(self.notes),
            "unknowns": self.unknowns,
            "seconds": self.seconds,
        }


def _record(eigenvalue: complex, kind) -> dict[str, float]:
    resonance = Resonance(kind, complex(eigenvalue))
    return {"frequency_Hz": resonance.frequency_Hz, "loss": resonance.loss}


class _Clock:
    """Names the steps to `progress` and keeps their times."""

    def __init__(self, progress: Progress | None) -> None:
        self.seconds: dict[str, float] = {}
        self._progress = progress or (lambda step: None)
        self._last, self._name = time.perf_counter(), None

    def step(self, name: str | None) -> None:
        now = time.perf_counter()
        if self._name is not None:
            self.seconds[self._name] = round(self.seconds.get(self._name, 0.0) + now - self._last, 4)
        self._last, self._name = now, name
        if name is not None:
            self._progress(name)


def update(specimen: Specimen, progress: Progress | None = None) -> UpdateResult:
    """Update the free constants of a specimen from its measured sweep.

    Raises
    ------
    InputError : the file, a key or the sweep cannot serve
    ConvergenceError : the iteration does not converge; the message says what to try
    """
    clock = _Clock(progress)
    clock.step("read")
    if specimen.measurement is None:
        raise InputError(f'{specimen.path or specimen.name}: there is no [measurement] with file = "…" to update from')
    problem = prepare(specimen)
    spectrum = read_spectrum(
        specimen.measurement.file, correct_phase=specimen.measurement.correct_phase, noise=specimen.measurement.noise
    )
    fitted = _without_held_out(spectrum, specimen.measurement.held_out)
    clock.step("extract poles and zeros")
    extraction = extract(fitted)
    pair = fundamental_pair(extraction, spectrum)
    start, eps_source = _start(problem, fitted, pair)
    method = _method(specimen, problem, eps_source)
    clock.step("mesh and assemble")
    band = float(max(spectrum.frequency[-1], 1.05 * pair.zero.frequency_Hz))
    model = _model(problem, pair, band, fitted, method)
    clock.step("reduce")
    outcome = _Fit(problem, model, band, clock).run(start, pair, extraction, fitted, method)
    clock.step("curves")
    base_curve = reduce_model(model, [problem.constants], band).impedance(
        problem.constants.to_e_form(), spectrum.frequency
    )
    modal = outcome.reduced.modal(outcome.constants.to_e_form())
    pole, zero = pair_of(modal, pair.pole.frequency_Hz)
    clock.step(None)
    return UpdateResult(
        problem=problem,
        extraction=extraction,
        pair=pair,
        baseline=problem.constants,
        constants=outcome.constants,
        parameters=_parameters(outcome, eps_source, extraction),
        model_pair=(Resonance("pole", pole), Resonance("zero", zero)),
        permittivity_source="fitted to the curve" if method == "curve" else eps_source[0],
        method=method,
        history=outcome.history,
        spectrum=spectrum,
        base_curve=base_curve,
        updated_curve=modal.impedance(spectrum.omega),
        notes=(*spectrum.notes, *extraction.notes, *_passivity_note(outcome.constants)),
        unknowns=model.size,
        seconds=clock.seconds,
    )


def fundamental_pair(extraction: Extraction, spectrum: ImpedanceSpectrum) -> Pair:
    """The pole-zero pair of strongest coupling in the sweep; InputError where there is none."""
    sound = [pair for pair in extraction.pairs if np.isfinite(pair.k_eff)]
    if not sound:
        raise InputError(
            f"{spectrum.source}: no resonance with both its pole and its zero was found between "
            f"{spectrum.frequency[0]:.6g} and {spectrum.frequency[-1]:.6g} Hz"
            + (f" ({'; '.join(extraction.notes)})" if extraction.notes else "")
            + "; measure a band that holds both"
        )
    return max(sound, key=lambda pair: pair.k_eff)


def _without_held_out(spectrum: ImpedanceSpectrum, band: tuple[float, float] | None) -> ImpedanceSpectrum:
    if band is None:
        return spectrum
    return spectrum.select((spectrum.frequency < band[0]) | (spectrum.frequency > band[1]))


def _start(problem: Problem, spectrum: ImpedanceSpectrum, pair: Pair) -> tuple[PiezoConstants, tuple[str, complex]]:
    """Start constants (1-D formulas) and the permittivity with its origin."""
    eps = problem.constants.eps33T
    origin = "given"
    if "eps33T" in problem.specimen.material.free:
        origin = "curve"
        if spectrum.frequency[0] < LOW_FREQUENCY_SHARE * pair.pole.frequency_Hz:
            origin = f"low frequency ({spectrum.frequency[0]:.6g} Hz, eqs 41 and 42)"
            eps = _low_permittivity(problem, spectrum, pair)
    bar = bar_start(
        problem.plate.poling,
        problem.plate.length,
        problem.density,
        pair.pole.frequency_Hz,
        pair.zero.frequency_Hz,
        eps.real,
    )
    free = set(problem.specimen.material.free)
    values = {name: value * (1 - 0.01j) for name, value in bar.items() if name in free}
    constants = problem.constants.with_values(eps33T=eps, **values)
    if problem.specimen.material.simplified:
        constants = simplify(constants, problem.plate.poling).full()
    constants.check(f"{problem.specimen.path}: start values of the 1-D bar", passive=False)
    return constants, (origin, eps)


def _low_permittivity(problem: Problem, spectrum: ImpedanceSpectrum, pair: Pair) -> complex:
    """Mean permittivity of the first point and all below 1 % of the pole, where the plate is static to 2e-5."""
    low = spectrum.frequency <= max(spectrum.frequency[0], 0.01 * pair.pole.frequency_Hz)
    gap, area = problem.plate.electrode_gap, problem.plate.electrode_area
    return complex(np.mean(static_permittivity(spectrum.frequency[low], spectrum.impedance[low], gap, area)))


def _method(specimen: Specimen, problem: Problem, eps_source: tuple[str, complex]) -> str:
    """ "pole_zero" where the paper's two unknowns and a known permittivity suffice, else "curve"."""
    wish = (specimen.update or Update()).method
    pair_names = {"s11", "d31"} if problem.plate.poling == "thickness" else {"s33", "d33"}
    enough = set(specimen.material.free) - {"eps33T"} == pair_names and eps_source[0] != "curve"
    if wish == "pole_zero" and not enough:
        raise InputError(
            f'{specimen.path or specimen.name}: update.method = "pole_zero" finds {" and ".join(sorted(pair_names))} '
            "at a known eps33T; the sweep does not reach low frequency or other constants are free, so give eps33T "
            'and take it out of material.free, or use method = "curve"'
        )
    return "pole_zero" if enough and wish != "curve" else "curve"


def _model(problem: Problem, pair: Pair, band: float, fitted: ImpedanceSpectrum, method: str):
    accuracy = (problem.specimen.update or Update()).accuracy
    exact_up_to = fitted.frequency[-1] if method == "curve" else 1.05 * pair.zero.frequency_Hz
    equivalent = max(exact_up_to, band * (accuracy / max(accuracy, _PICTURE_ACCURACY)) ** 0.25)
    return problem.model(equivalent, accuracy)


@dataclass(frozen=True)
class _Outcome:
    constants: PiezoConstants
    free: FreeConstants
    theta: np.ndarray
    covariance: np.ndarray | None
    history: tuple[Step, ...]
    reduced: ReducedModel


class _Fit:
    """Pole-zero iteration and curve fit on a reduced basis that follows the constants."""

    def __init__(self, problem: Problem, model, band: float, clock: _Clock) -> None:
        self._problem, self._model, self._band, self._clock = problem, model, band, clock

    def run(
        self, start: PiezoConstants, pair: Pair, extraction: Extraction, fitted: ImpedanceSpectrum, method: str
    ) -> _Outcome:
        constants, anchor, history = start, None, ()
        for _ in range(6):
            free = self._problem.free(constants)
            if anchor is None or np.max(np.abs(free.start.real / anchor - 1)) > _LEAVE:
                self._clock.step("reduce")
                anchor = free.start.real
                training = free.training_sets(free.start, _SPREAD)
                reduced = reduce_model(self._model, training, self._band)
            self._clock.step("pole-zero update")
            outcome = self._pole_zero(free, reduced, pair, extraction)
            history = history or outcome.history
            if method == "curve":
                self._clock.step("curve fit")
                outcome = self._curve(outcome, fitted, extraction)
            constants = outcome.constants
            if np.max(np.abs(outcome.theta.real / anchor - 1)) <= _LEAVE:
                break
        return _Outcome(**{**outcome.__dict__, "history": history})

    def _pole_zero(self, free: FreeConstants, reduced: ReducedModel, pair: Pair, extraction: Extraction) -> _Outcome:
        measured = np.array([pair.pole.eigenvalue, pair.zero.eigenvalue])
        base = free.constants(free.start)
        poling = self._problem.plate.poling
        names = ("s11", "d31") if poling == "thickness" else ("s33", "d33")
        two = FreeConstants.of(base, names, simplified=self._problem.specimen.material.simplified, poling=poling)
        if self._problem.specimen.material.simplified:
            found = update_simplified(reduced_source(reduced), simplify(base, poling), measured, base.eps33T)
        else:
            found = update_pair(reduced_source(reduced), two, measured)
        covariance = _pair_covariance(extraction, pair)
        covariance = None if covariance is None else propagate_covariance(found, two, covariance)
        theta = np.array([getattr(found.constants, name) for name in free.names])
        full = None
        if covariance is not None:
            full = np.zeros((2 * theta.size, 2 * theta.size))
            where = [2 * free.names.index(name) + part for name in names for part in (0, 1) if name in free.names]
            if len(where) == 4:
                full[np.ix_(where, where)] = covariance
        return _Outcome(found.constants, free, theta, full, found.history, reduced)

    def _curve(self, start: _Outcome, fitted: ImpedanceSpectrum, extraction: Extraction) -> _Outcome:
        noise = extraction.noise
        known = noise is not None and noise.origin == "file"
        relative = np.abs(_sigma(fitted, extraction) / fitted.impedance)
        fit = fit_curve(start.reduced, start.free, fitted, relative, start.theta, noise_known=known)
        return _Outcome(
            start.free.constants(fit.theta), start.free, fit.theta, fit.covariance, start.history, start.reduced
        )


def _sigma(spectrum: ImpedanceSpectrum, extraction: Extraction) -> np.ndarray:
    if spectrum.noise is not None:
        return spectrum.noise
    if extraction.noise is None:
        return 1e-3 * np.abs(spectrum.impedance)
    return extraction.noise.std(spectrum.impedance)


def _pair_covariance(extraction: Extraction, pair: Pair) -> np.ndarray | None:
    """(4, 4) joint covariance of (Re λ, Im λ) of pole and zero out of the set's."""
    resonances = extraction.resonances
    if resonances.covariance is None:
        return None
    pole = resonances.poles.index(pair.pole)
    zero = len(resonances.poles) + resonances.zeros.index(pair.zero)
    where = [2 * pole, 2 * pole + 1, 2 * zero, 2 * zero + 1]
    return resonances.covariance[np.ix_(where, where)]


def _parameters(outcome: _Outcome, eps_source: tuple[str, complex], extraction: Extraction) -> dict[str, Estimate]:
    found = dict(zip(outcome.free.names, estimates(outcome.theta, outcome.covariance), strict=True))
    if eps_source[0].startswith("low frequency") and "eps33T" in found and found["eps33T"].std in (None, 0.0):
        noise = extraction.noise
        relative = noise.relative / np.sqrt(2) if noise is not None else None
        value = found["eps33T"]
        std = None if relative is None else value.value * relative
        found["eps33T"] = Estimate(value.value, std, value.tan, relative)
    return found


def _passivity_note(constants: PiezoConstants) -> tuple[str, ...]:
    return tuple(f"updated constants: {fault}" for fault in constants.physical_faults())
