"""`extract`: every pole and zero of a sweep, with uncertainties, from the sweep alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.extraction.covariance import (
    correlated_spread,
    errors_about,
    fisher_spread,
    systematic_error,
    systematic_spread,
)
from femu_piezo.extraction.fit import ROUNDING, Fit, NormalisedSweep, refit, solve_linear
from femu_piezo.extraction.likelihood import maximum_likelihood, noise_of
from femu_piezo.extraction.limitations import (
    Finding,
    find_clipping,
    find_doubtful,
    find_lossless,
    find_missing,
    find_reversed,
    find_systematic,
    gravest_first,
    too_few_points,
)
from femu_piezo.extraction.model import RationalModel
from femu_piezo.extraction.order import MAX_BACKGROUND, Candidate, is_passive, without
from femu_piezo.extraction.prony_ss import prony_ss
from femu_piezo.extraction.result import Extraction, Method
from femu_piezo.extraction.roots import Roots, interlaced, pair, resonances, unsettled_modes
from femu_piezo.measurement.discrepancy import Discrepancy
from femu_piezo.measurement.noise import noise_at_points
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.measurement.sweeps import SweepData
from femu_piezo.resonances import Resonance, ResonanceSet
from femu_piezo.threads import blas_limit

MAX_MODES = 40
MIN_POINTS = 8
CLOSE = 10.0  # times the rms misfit of the closest fit, up to which other fits are compared with it


def extract(
    spectrum: ImpedanceSpectrum,
    *,
    max_modes: int | None = None,
    method: Method = "maximum_likelihood",
    start: RationalModel | None = None,
) -> Extraction:
    """Poles and zeros of an impedance sweep with uncertainties.

    One rational function of ω² with complex poles, residues and a polynomial background is fitted to the
    sweep in units of its noise; its poles are the poles of Y, its roots the zeros of Y. Because a relative
    error of Z is the same relative error of Y, this single fit is the maximum-likelihood estimate of both.

    Parameters
    ----------
    spectrum : the sweep; its `noise` is used where given, else learned from the residual of the fit
    max_modes : largest number of modes of the fit (40 where None)
    method : "maximum_likelihood", or "prony_ss" for the paper's time-domain method (uniform grid): no
        covariance; the curve is the best one with those poles
    start : fitted function of a similar sweep, with whose modes the search begins; only for maximum likelihood

    Raises
    ------
    InputError : a sweep with impossible values, an unknown method
    """
    _check(spectrum, method, max_modes)
    with blas_limit():
        return _extract(spectrum, max_modes, method, start)


def _extract(
    spectrum: ImpedanceSpectrum, max_modes: int | None, method: Method, start: RationalModel | None
) -> Extraction:
    n = len(spectrum)
    clipped, findings = find_clipping(spectrum)
    used = ~clipped
    if np.count_nonzero(used) < MIN_POINTS:
        return _nothing(spectrum, [too_few_points(spectrum, int(np.count_nonzero(used)), MIN_POINTS), *findings])
    if lossless := find_lossless(spectrum):
        return _nothing(spectrum, lossless)
    sweep = spectrum.select(used)
    band = (float(spectrum.frequency[0]), float(spectrum.frequency[-1]))
    tried: tuple[Candidate, ...] = ()
    if method == "prony_ss":
        roots, result = _prony_ss(sweep)
        noise, spread = noise_of(result, sweep), None
    else:
        estimate = maximum_likelihood(sweep, MAX_MODES if max_modes is None else max_modes, start)
        result, noise, tried, data = estimate.fit, estimate.noise, estimate.orders, estimate.fit.data
        scale = _inflation(result, findings) if noise.origin == "file" else result.scale
        spread = fisher_spread(result.model, data, scale)
        systematic = result.is_correlated
        if systematic:
            points = _points(sweep)
            result, discrepancy = _most_probable((*estimate.intermediate_fits, result), data, points)
            alone = correlated_spread(result.model, data, points)
            spread = systematic_spread(result.model, data, points, discrepancy) if alone is None else alone
            noise = noise if noise.of_spectrum else replace(noise, relative=result.scale)
            findings += find_systematic(discrepancy, result.residual / data.weight, result.degrees_of_freedom, points)
        roots = resonances(result.model, spread, band, systematic=systematic)
    ordered = gravest_first(
        findings + find_reversed(result.data) + find_missing(roots, spectrum) + find_doubtful(roots)
    )
    impedance = 1 / result.model.admittance(spectrum.omega)
    residual = np.full(n, complex("nan+nanj"))
    sigma = sweep.noise if noise.of_spectrum else noise.std(impedance[used])
    residual[used] = (sweep.impedance - impedance[used]) / sigma
    freedom = np.count_nonzero(used) - result.model.size
    return Extraction(
        spectrum=spectrum,
        used=used,
        resonances=replace(roots.inside, notes=tuple(f.sentence for f in ordered)),
        pairs=pair(roots),
        outside=roots.outside,
        doubtful=roots.doubtful,
        impedance=impedance,
        residual=residual,
        noise=noise,
        reduced_chi_square=float(np.sum(np.abs(residual[used]) ** 2) / freedom),
        model=result.model,
        orders=tried,
        findings=ordered,
        method=method,
        spread=spread,
    )


def _most_probable(fits: Sequence[Fit], data: NormalisedSweep, points: SweepData) -> tuple[Fit, Discrepancy]:
    """The most probable fit of a sweep with a systematic error, and this error.

    Passive fits compete whose rms misfit is at most `CLOSE` times the least, of each order the one of least misfit. The
    one of most evidence gives the number of modes and, by its discrepancy, the error. Of the fits with that number of
    modes the one of least misfit is taken, since an omitted degree of the background biases and an idle one costs
    little; its own discrepancy would be too small, as it follows a part of the error. At last unsettled modes are
    removed while that raises the evidence, since the error explains them as well.
    """

    passive = sorted((one for one in fits if is_passive(one.model)), key=lambda one: one.misfit)
    errors = errors_about(passive[0].model, data, points)

    def judged(one: Fit) -> tuple[Fit, Discrepancy, float]:
        return one, *systematic_error(one.model, data, points, errors)

    near = [one for one in passive if one.misfit < CLOSE**2 * passive[0].misfit]
    orders = {(one.model.poles.size, one.model.background.size): one for one in near[::-1]}
    each = [judged(one) for one in orders.values()]
    likely, error, _ = min(each, key=lambda one: one[2])
    alike = [one for one in each if one[0].model.poles.size == likely.model.poles.size]
    best, _, level = min(alike, key=lambda one: one[0].misfit)
    while True:
        spread = systematic_spread(best.model, data, points, error)
        fewer = [without(best.model, mode) for mode in unsettled_modes(best.model, spread)]
        rival = min((judged(refit(model, data)) for model in fewer), key=lambda one: one[2], default=None)
        if rival is None or rival[2] >= level:
            return best, error
        best, _, level = rival


def _points(sweep: ImpedanceSpectrum) -> SweepData:
    """The sweep with its relative noise, from its file or estimated from neighbouring points."""
    noise = noise_at_points(sweep) / np.abs(sweep.impedance)
    return SweepData(sweep.frequency, sweep.impedance, np.maximum(noise, ROUNDING), sweep.noise_known)


def _prony_ss(sweep: ImpedanceSpectrum) -> tuple[Roots, Fit]:
    """Poles and zeros of the stable columns of Prony-SS, and the fit of most evidence with those poles held fixed."""
    every = []
    for kind in ("pole", "zero"):
        found = prony_ss(sweep, kind)
        pairs = zip(found.diagram.columns, found.residues, strict=True)
        every += [Resonance(kind, column.eigenvalue, residue=complex(residue)) for column, residue in pairs]
    alternating = interlaced(every, lambda one: one.frequency_Hz)
    poles, zeros = (
        tuple(Resonance(kind, one.eigenvalue) for one in alternating if one.kind == kind) for kind in ("pole", "zero")
    )
    data = NormalisedSweep.of(sweep.omega, sweep.admittance, np.ones(len(sweep)))
    at = np.array([(r.eigenvalue - data.axis.center) / data.axis.half_width for r in poles], complex)
    fits = [
        solve_linear(RationalModel(data.axis, data.scale, at, np.zeros_like(at), np.zeros(d, complex)), data)
        for d in range(1, MAX_BACKGROUND + 2)
        if 2 * at.size + d < len(data)
    ]
    best = min(fits, key=lambda f: f.evidence)
    return Roots(ResonanceSet(poles, zeros, None), ()), best


def _inflation(result: Fit, findings: list[Finding]) -> float:
    """Factor on standard deviations: 1 where the file's noise explains the residual, else its rms, with a finding.

    The noise does not explain a χ² that is more than 5 σ too large. A correlated residual is more than such noise, and
    deviations that allow for it take the place of those with the factor.
    """
    excess = result.scale**2 - 1
    if excess <= 5 * np.sqrt(2 / result.degrees_of_freedom):
        return 1.0
    findings.append(
        Finding(
            "noise_underestimated",
            f"the rms residual is {result.scale:.2f} times the noise given in the file: the standard deviations "
            + ("allow for it" if result.is_correlated else "are multiplied by this factor"),
        )
    )
    return result.scale


def _check(spectrum: ImpedanceSpectrum, method: str, max_modes: int | None) -> None:
    if method not in ("maximum_likelihood", "prony_ss"):
        raise InputError(f"unknown extraction method '{method}': use maximum_likelihood or prony_ss")
    if max_modes is not None and max_modes < 0:
        raise InputError(f"max_modes must be 0 or more, got {max_modes}")
    if not np.all(np.isfinite(spectrum.impedance)) or np.any(spectrum.impedance == 0):
        bad = int(np.argmax(~np.isfinite(spectrum.impedance) | (spectrum.impedance == 0)))
        raise InputError(
            f"{spectrum.source}: impedance at {spectrum.frequency[bad]:.6g} Hz is {spectrum.impedance[bad]}; "
            "leave such points out"
        )


def _nothing(spectrum: ImpedanceSpectrum, findings: list[Finding]) -> Extraction:
    n = len(spectrum)
    missing = np.full(n, complex("nan+nanj"))
    return Extraction(
        spectrum=spectrum,
        used=np.zeros(n, bool),
        resonances=ResonanceSet((), (), None, tuple(f.sentence for f in findings)),
        pairs=(),
        outside=(),
        impedance=missing,
        residual=missing,
        noise=None,
        reduced_chi_square=float("nan"),
        model=None,
        orders=(),
        findings=tuple(findings),
    )
