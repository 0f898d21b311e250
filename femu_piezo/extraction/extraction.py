"""`extract`: every pole and zero of a sweep, with uncertainties, from the sweep alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.extraction.findings import Finding, find_clipping, find_missing, too_few_points
from femu_piezo.extraction.fit import Fit, SweepData, correlation
from femu_piezo.extraction.likelihood import is_correlated, maximum_likelihood
from femu_piezo.extraction.result import Extraction, Method
from femu_piezo.extraction.roots import pair, resonances
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.resonances import ResonanceSet

MAX_MODES = 12
MIN_POINTS = 8


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
    result, data, noise, tried = maximum_likelihood(sweep, MAX_MODES if max_modes is None else max_modes)
    scale = result.scale if noise.origin == "residual" else _inflation(result, findings)
    phi = _systematic(result, data, findings)
    roots = resonances(result.model, data, scale, phi, (spectrum.frequency[0], spectrum.frequency[-1]))
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
        reduced_chi_square=float(np.sum(np.abs(residual[used]) ** 2) / (np.count_nonzero(used) - result.model.size)),
        orders=tuple(tried),
        findings=tuple(findings),
    )


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


def _systematic(result: Fit, data: SweepData, findings: list[Finding]) -> complex:
    """φ of the residual where it is correlated beyond chance (1 % of white residuals), else 0."""
    phi, _ = correlation(result.residual)
    if not is_correlated(result, data):
        return 0j
    findings.append(
        Finding(
            "correlated_residual",
            f"neighbouring residuals are correlated ({abs(phi):.2f}): instrument or model err systematically "
            "beyond the noise; standard deviations are widened for it",
        )
    )
    return phi


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
