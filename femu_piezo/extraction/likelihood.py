"""The maximum-likelihood estimate of a sweep: model order, parameters and noise together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from femu_piezo.extraction.fit import Fit, NormalisedSweep, fit, is_correlated
from femu_piezo.extraction.model import RationalModel
from femu_piezo.extraction.noise_level import NoiseUsed, noise_from_residual, weight_of_file
from femu_piezo.extraction.order import Candidate, evidence, search, widen
from femu_piezo.measurement.spectrum import ImpedanceSpectrum

GUARD_DEGREES = 2  # background beyond the evidence: an omitted degree biases, an idle one costs 3 % of σ
FAR_BELOW = 0.1  # of a noise that is given: a smaller residual, of a computed curve, is no evidence for modes
FEW_POINTS = 200  # below, one sweep hardly tells relative from additive noise: both are tried as a start


@dataclass(frozen=True)
class Estimate:
    """The fit, the data as it saw them, the noise used, and every order tried.

    `is_systematic`: neighbouring residuals are correlated beyond chance; `way`: the fits on the way to this one.
    """

    fit: Fit
    data: NormalisedSweep
    noise: NoiseUsed
    orders: tuple[Candidate, ...]
    is_systematic: bool
    way: tuple[Fit, ...]


def maximum_likelihood(sweep: ImpedanceSpectrum, max_modes: int, start: RationalModel | None = None) -> Estimate:
    """Order search and final fit; without a noise in the file the noise is searched along with the order.

    The search begins with the modes of `start`, else with none.

    Where the residual stays correlated, instrument or model err systematically. A noise learned from such a
    residual would give away the regions where the error is largest, so every point then counts alike (relative
    weights), and the deviations allow for it (`femu_piezo.extraction.covariance.systematic_spread`).
    """
    given = weight_of_file(sweep)
    weight = np.ones(len(sweep)) if given is None else given
    data = NormalisedSweep.of(sweep.omega, sweep.admittance, weight, 0.0 if given is None else FAR_BELOW)
    first = search(data, max_modes, None if start is None else start.normalised(data.axis, data.scale))
    best, tried, way = first.best, first.tried, first.way
    if given is None:
        plain, plain_data = best, data
        best, data, again = _learn_noise(sweep, max_modes, best, data)
        tried = tried + again
        if is_correlated(best, data):
            best, data = plain, plain_data
    final = _guarded(best, data)
    systematic = is_correlated(final, data)
    if given is not None:
        noise = NoiseUsed(float(np.median(1 / given)), 0.0, "file")
    elif systematic:
        noise = NoiseUsed(final.scale, 0.0, "misfit")
    else:
        noise = noise_of(final, sweep)
    return Estimate(final, data, noise, tried, systematic, way)


def _learn_noise(
    sweep: ImpedanceSpectrum, max_modes: int, best: Fit, data: NormalisedSweep
) -> tuple[Fit, NormalisedSweep, tuple[Candidate, ...]]:
    """The noise shape the residual shows, and the orders it supports; a second start from purely additive noise."""
    best, data, tried = _reweighted(sweep, max_modes, best, data)
    if len(sweep) < FEW_POINTS or np.ptp(data.weight) > 0 or is_correlated(best, data):
        size = np.abs(sweep.impedance)
        additive = replace(data, weight=size / np.median(size))
        again = search(additive, max_modes, None if len(sweep) < FEW_POINTS else best.model)
        other, other_data, more = _reweighted(sweep, max_modes, again.best, additive)
        tried = (*tried, *again.tried, *more)
        if evidence(other, other_data) < evidence(best, data):
            best, data = other, other_data
    return best, data, tried


def _reweighted(
    sweep: ImpedanceSpectrum, max_modes: int, best: Fit, data: NormalisedSweep
) -> tuple[Fit, NormalisedSweep, tuple[Candidate, ...]]:
    """The search continued with the noise that the residual shows, if that differs in shape."""
    noise = noise_of(best, sweep)
    if noise.additive == 0 and np.ptp(data.weight) == 0:
        return best, data, ()
    impedance = 1 / best.model.admittance(sweep.omega)
    data = replace(data, weight=np.abs(impedance) / noise.std(impedance))
    found = search(data, max_modes, best.model)
    return found.best, data, found.tried


def noise_of(result: Fit, sweep: ImpedanceSpectrum) -> NoiseUsed:
    """The noise of the sweep as the residual of a fit shows it."""
    impedance = 1 / result.model.admittance(sweep.omega)
    return noise_from_residual(sweep.impedance - impedance, impedance, result.model.size)


def _guarded(best: Fit, data: NormalisedSweep) -> Fit:
    """The final fit, with `GUARD_DEGREES` more background than the evidence asks for."""
    if not best.model.poles.size or best.model.size + GUARD_DEGREES >= len(data):
        return best
    return fit(widen(best.model, GUARD_DEGREES), data, tolerance=1e-15)
