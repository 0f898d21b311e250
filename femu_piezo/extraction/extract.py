"""`extract`: every pole and zero of a sweep, with uncertainties, from the sweep alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.extraction.findings import Finding, find_clipping, find_missing, too_few_points
from femu_piezo.extraction.fit import Fit, SweepData, fit
from femu_piezo.extraction.order import Candidate, search, widen
from femu_piezo.extraction.roots import Pair, pair, resonances
from femu_piezo.extraction.weighting import NoiseUsed, noise_from_residual, weight_of_file
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.resonances import Resonance, ResonanceSet

Method = Literal["maximum_likelihood"]
MAX_MODES = 12
GUARD_DEGREES = (
    1  # background degrees beyond the evidence: an omitted term biases, an idle one costs 3 % of σ
)
MIN_POINTS = 8


@dataclass(frozen=True)
class Extraction:
    """What a sweep says about the resonances of a specimen.

    Attributes
    ----------
    spectrum : the sweep that was analysed, unchanged
    used : (n,) bool, points that entered the fit (clipped ones do not)
    resonances : poles and zeros inside the sweep, joint covariance over (Re λ, Im λ)
    pairs : poles with their zeros, k_eff and its standard deviation
    outside : significant poles and zeros the fit places outside the sweep, extrapolated
    impedance : (n,) complex ohm, the fitted Z at the sweep's frequencies
    residual : (n,) complex, (Z_data − Z_fit)/σ_Z, E|·|² = 1 for a right model; nan where not used
    noise : the noise the fit used
    reduced_chi_square : Σ|residual|²/(n − p), about 1 for a right model and a right noise
    orders : every model order tried, with its evidence
    findings : what is missing or doubtful, each a code and a sentence
    method : how the resonances were obtained
    """

    spectrum: ImpedanceSpectrum
    used: np.ndarray
    resonances: ResonanceSet
    pairs: tuple[Pair, ...]
    outside: tuple[Resonance, ...]
    impedance: np.ndarray
    residual: np.ndarray
    noise: NoiseUsed | None
    reduced_chi_square: float
    orders: tuple[Candidate, ...]
    findings: tuple[Finding, ...]
    method: Method = "maximum_likelihood"

    @property
    def status(self) -> str:
        """ "ok", or the code of the gravest finding."""
        return self.findings[0].code if self.findings else "ok"

    @property
    def notes(self) -> tuple[str, ...]:
        """The findings as sentences."""
        return tuple(finding.sentence for finding in self.findings)

    def to_json(self) -> dict:
        """The contract of `extract`: poles and zeros, and all that qualifies them, JSON types only."""
        return {
            "poles": [r.to_json() for r in self.resonances.poles],
            "zeros": [r.to_json() for r in self.resonances.zeros],
            "pairs": [
                {
                    "pole_Hz": p.pole.frequency_Hz,
                    "zero_Hz": p.zero.frequency_Hz,
                    "k_eff": None if np.isnan(p.k_eff) else p.k_eff,
                    "std_k_eff": None if np.isnan(p.std_k_eff) else p.std_k_eff,
                    "Q_pole": p.pole.quality_factor,
                    "Q_zero": p.zero.quality_factor,
                }
                for p in self.pairs
            ],
            "covariance": None
            if self.resonances.covariance is None
            else {
                "order": "Re λ, Im λ of the poles, then of the zeros, rad^4/s^4",
                "matrix": self.resonances.covariance.tolist(),
            },
            "outside_sweep": [{"kind": r.kind, **r.to_json()} for r in self.outside],
            "noise": None
            if self.noise is None
            else {
                "relative": self.noise.relative,
                "additive_ohm": self.noise.additive,
                "origin": self.noise.origin,
            },
            "reduced_chi_square": None if np.isnan(self.reduced_chi_square) else self.reduced_chi_square,
            "points": len(self.spectrum),
            "points_used": int(np.count_nonzero(self.used)),
            "method": self.method,
            "status": self.status,
            "notes": list(self.notes),
        }


def extract(
    spectrum: ImpedanceSpectrum, *, max_modes: int | None = None, method: Method = "maximum_likelihood"
) -> Extraction:
    """Poles and zeros of an impedance sweep with uncertainties.

    One rational function of ω² with complex poles, residues and a polynomial background is fitted to the
    sweep in units of its noise; its poles are the poles of Y, its roots the zeros of Y. Because a relative
    error of Z is the same relative error of Y, this single fit is the maximum-likelihood estimate of both.

    Parameters
    ----------
    spectrum : the sweep; its `noise` is used where given, else learned from the residual of the fit
    max_modes : most modes the evidence may ask for (12 where None)
    method : "maximum_likelihood"

    Raises
    ------
    InputError : a sweep with impossible values, an unknown method
    """
    _check(spectrum, method, max_modes)
    n = len(spectrum)
    if n < MIN_POINTS:
        return _nothing(spectrum, too_few_points(spectrum, MIN_POINTS))
    clipped, findings = find_clipping(spectrum)
    used = ~clipped
    sweep = spectrum.select(used)
    result, data, noise, tried = _maximum_likelihood(sweep, MAX_MODES if max_modes is None else max_modes)
    scale = result.scale if noise.origin == "residual" else _inflation(result, findings)
    roots = resonances(result.model, data, scale, (spectrum.frequency[0], spectrum.frequency[-1]))
    findings = findings + find_missing(roots, spectrum)
    model_impedance = 1 / result.model.admittance(spectrum.omega)
    residual = np.full(n, complex("nan+nanj"))
    sigma = sweep.noise if noise.origin == "file" else noise.std(1 / result.model.admittance(sweep.omega))
    residual[used] = (sweep.impedance - model_impedance[used]) / sigma
    return Extraction(
        spectrum=spectrum,
        used=used,
        resonances=replace(roots.inside, notes=tuple(f.sentence for f in findings)),
        pairs=pair(roots.inside),
        outside=roots.outside,
        impedance=model_impedance,
        residual=residual,
        noise=noise,
        reduced_chi_square=float(
            np.sum(np.abs(residual[used]) ** 2) / (np.count_nonzero(used) - result.model.size)
        ),
        orders=tuple(tried),
        findings=tuple(findings),
    )


def _maximum_likelihood(
    sweep: ImpedanceSpectrum, max_modes: int
) -> tuple[Fit, SweepData, NoiseUsed, list[Candidate]]:
    """Order search and final fit; without a noise in the file, again with the noise the residual shows."""
    given = weight_of_file(sweep)
    weight = np.ones(len(sweep)) if given is None else given
    data = SweepData.of(sweep.omega, sweep.admittance, weight, squared=True)
    best, tried = search(data, max_modes)
    if given is not None:
        noise = NoiseUsed(float(np.median(1 / given)), 0.0, "file")
        return _guarded(best, data), data, noise, tried
    noise = _noise_of(best, sweep)
    if noise.additive > 0:
        impedance = 1 / best.model.admittance(sweep.omega)
        weight = np.abs(impedance) / noise.std(impedance)
        data = SweepData.of(sweep.omega, sweep.admittance, weight, squared=True)
        best, again = search(data, max_modes)
        tried = tried + again
        noise = _noise_of(best, sweep)
    final = _guarded(best, data)
    return final, data, _noise_of(final, sweep), tried


def _noise_of(result: Fit, sweep: ImpedanceSpectrum) -> NoiseUsed:
    impedance = 1 / result.model.admittance(sweep.omega)
    return noise_from_residual(sweep.impedance - impedance, impedance, result.model.size)


def _guarded(best: Fit, data: SweepData) -> Fit:
    """The final fit, with `GUARD_DEGREES` more background than the evidence asks for."""
    if not best.model.poles.size or best.model.size + GUARD_DEGREES >= len(data):
        return best
    return fit(widen(best.model, GUARD_DEGREES), data)


def _inflation(result: Fit, findings: list[Finding]) -> float:
    """1 where the file's noise explains the residual; the rms residual where χ² is 5 σ too large."""
    excess = result.scale**2 - 1
    if excess <= 5 * np.sqrt(2 / result.degrees_of_freedom):
        return 1.0
    findings.append(
        Finding(
            "noise_underestimated",
            f"the residual is {result.scale:.2f} times the noise given in the file: standard deviations are "
            "widened by that factor",
        )
    )
    return result.scale


def _check(spectrum: ImpedanceSpectrum, method: str, max_modes: int | None) -> None:
    if method != "maximum_likelihood":
        raise InputError(f"unknown extraction method '{method}': use maximum_likelihood")
    if max_modes is not None and max_modes < 0:
        raise InputError(f"max_modes must be 0 or more, got {max_modes}")
    if not np.all(np.isfinite(spectrum.impedance)) or np.any(spectrum.impedance == 0):
        bad = int(np.argmax(~np.isfinite(spectrum.impedance) | (spectrum.impedance == 0)))
        raise InputError(
            f"{spectrum.source}: impedance at {spectrum.frequency[bad]:.6g} Hz is {spectrum.impedance[bad]}; "
            "leave such points out"
        )


def _nothing(spectrum: ImpedanceSpectrum, finding: Finding) -> Extraction:
    n = len(spectrum)
    missing = np.full(n, complex("nan+nanj"))
    return Extraction(
        spectrum=spectrum,
        used=np.zeros(n, bool),
        resonances=ResonanceSet((), (), None, (finding.sentence,)),
        pairs=(),
        outside=(),
        impedance=missing,
        residual=missing,
        noise=None,
        reduced_chi_square=float("nan"),
        orders=(),
        findings=(finding,),
    )
