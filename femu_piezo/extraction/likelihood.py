"""The maximum-likelihood estimate of a sweep: model order, parameters and noise together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from femu_piezo.extraction.fit import ROUNDING, Fit, SweepData, correlation, fit, residual
from femu_piezo.extraction.order import Candidate, evidence, search, widen
from femu_piezo.extraction.weighting import NoiseUsed, noise_from_residual, weight_of_file
from femu_piezo.measurement.spectrum import ImpedanceSpectrum

GUARD_DEGREES = 2  # background beyond the evidence: an omitted degree biases, an idle one costs 3 % of σ
WHITENING_ROUNDS = 2
FEW_POINTS = 200  # below, one sweep hardly tells relative from additive noise: both are tried as a start


def maximum_likelihood(sweep: ImpedanceSpectrum, max_modes: int) -> tuple[Fit, SweepData, NoiseUsed, list[Candidate]]:
    """Order search and final fit; without a noise in the file the noise is searched along with the order."""
    given = weight_of_file(sweep)
    if given is not None:
        data = SweepData.of(sweep.omega, sweep.admittance, given)
        best, tried = search(data, max_modes)
    else:
        size = np.abs(sweep.impedance)
        best, data, tried = _learn_noise(sweep, max_modes, np.ones(len(sweep)))
        if len(sweep) < FEW_POINTS or np.ptp(data.weight) > 0 or is_correlated(best, data):
            other, other_data, other_tried = _learn_noise(sweep, max_modes, size / np.median(size))
            tried = tried + other_tried
            if evidence(other, other_data) < evidence(best, data):
                best, data = other, other_data
    for _ in range(WHITENING_ROUNDS if is_correlated(best, data) else 0):
        if given is None:
            data = replace(data, weight=_innovation_weight(best, data, sweep))
        data = replace(data, phi=correlation(residual(best.model, data))[0])
        best, again = search(data, max_modes, best.model)
        tried = tried + again
    final = _guarded(best, data)
    if given is not None:
        return final, data, NoiseUsed(float(np.median(1 / given)), 0.0, "file"), tried
    return final, data, noise_of(final, sweep), tried


def _learn_noise(
    sweep: ImpedanceSpectrum, max_modes: int, weight: np.ndarray
) -> tuple[Fit, SweepData, list[Candidate]]:
    """Search with a first guess of the noise shape, then again with the one the residual shows."""
    data = SweepData.of(sweep.omega, sweep.admittance, weight)
    best, tried = search(data, max_modes)
    noise = noise_of(best, sweep)
    if noise.additive == 0 and np.ptp(weight) == 0:
        return best, data, tried
    impedance = 1 / best.model.admittance(sweep.omega)
    data = replace(data, weight=np.abs(impedance) / noise.std(impedance))
    best, again = search(data, max_modes, best.model)
    return best, data, tried + again


def _innovation_weight(result: Fit, data: SweepData, sweep: ImpedanceSpectrum) -> np.ndarray:
    """(n,) |Z|/σ with the relative and additive parts of the innovation: what neighbours do not share."""
    impedance = 1 / result.model.admittance(sweep.omega)
    phi, _ = correlation(result.residual)
    innovation = replace(data, phi=phi).whiten(result.residual) / data.weight
    noise = noise_from_residual(innovation * impedance, impedance, result.model.size)
    return np.abs(impedance) / noise.std(impedance)


def noise_of(result: Fit, sweep: ImpedanceSpectrum) -> NoiseUsed:
    """The noise of the sweep as the residual of a fit shows it."""
    impedance = 1 / result.model.admittance(sweep.omega)
    return noise_from_residual(sweep.impedance - impedance, impedance, result.model.size)


def _guarded(best: Fit, data: SweepData) -> Fit:
    """The final fit, with `GUARD_DEGREES` more background than the evidence asks for."""
    if not best.model.poles.size or best.model.size + GUARD_DEGREES >= len(data):
        return best
    return fit(widen(best.model, GUARD_DEGREES), data, tolerance=1e-15)


def is_correlated(result: Fit, data: SweepData) -> bool:
    """Whether neighbouring residuals are correlated beyond chance (1 % of white residuals) and rounding."""
    phi, _ = correlation(result.residual)
    relative = np.linalg.norm(result.residual) / np.linalg.norm(data.weight)
    return bool(relative > 10 * ROUNDING and abs(phi) ** 2 * result.residual.size > np.log(100))
