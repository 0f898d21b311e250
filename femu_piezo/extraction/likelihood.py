"""The maximum-likelihood estimate of a sweep: model order, parameters and noise together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from femu_piezo.extraction.fit import Fit, NormalisedSweep, fit
from femu_piezo.extraction.model import RationalModel
from femu_piezo.extraction.noise_level import NoiseUsed, noise_from_residual, weight_of_file
from femu_piezo.extraction.order import Candidate, search, widen
from femu_piezo.measurement.spectrum import ImpedanceSpectrum

GUARD_DEGREES = 2  # added to the background of most evidence: an omitted degree biases, an idle one costs 3 % of σ
FAR_BELOW = 0.1  # share of a given noise below which a residual, as of a computed curve, is no evidence for modes
FEW_POINTS = 200  # below, a sweep hardly tells relative from additive noise: both are tried as a start


@dataclass(frozen=True)
class Estimate:
    """The final fit, the noise used, every order tried, and the `Search.intermediate_fits` of the first search."""

    fit: Fit
    noise: NoiseUsed
    orders: tuple[Candidate, ...]
    intermediate_fits: tuple[Fit, ...]


def maximum_likelihood(sweep: ImpedanceSpectrum, max_modes: int, start: RationalModel | None = None) -> Estimate:
    """Order search and final fit; without a noise in the file the noise is searched along with the order.

    The search begins with the modes of `start`, else with none.

    Where the residual stays correlated, instrument or model err systematically. A noise learned from such a residual
    would give little weight to the regions where the error is largest, so all points then have equal relative weight,
    and the standard deviations allow for the error (`femu_piezo.extraction.covariance.systematic_spread`).
    """
    given = weight_of_file(sweep)
    weight = np.ones(len(sweep)) if given is None else given
    data = NormalisedSweep.of(sweep.omega, sweep.admittance, weight, 0.0 if given is None else FAR_BELOW)
    first = search(data, max_modes, None if start is None else start.normalised(data.axis, data.scale))
    best, tried = first.best, first.tried
    if given is None:
        noisy, again = _learn_noise(sweep, max_modes, best)
        tried, best = tried + again, best if noisy.is_correlated else noisy
    final = _guarded(best)
    if given is not None:
        noise = NoiseUsed(float(np.median(1 / given)), 0.0, "file" if sweep.noise_known else "readings")
    elif final.is_correlated:
        noise = NoiseUsed(final.scale, 0.0, "misfit")
    else:
        noise = noise_of(final, sweep)
    return Estimate(final, noise, tried, first.intermediate_fits)


def _learn_noise(sweep: ImpedanceSpectrum, max_modes: int, best: Fit) -> tuple[Fit, tuple[Candidate, ...]]:
    """The best fit with the noise that its residual shows, and the orders tried.

    A second search starts from purely additive noise where points are few, the noise found is not purely relative, or
    the residual is correlated.
    """
    best, tried = _reweighted(sweep, max_modes, best)
    if len(sweep) < FEW_POINTS or np.ptp(best.data.weight) > 0 or best.is_correlated:
        size = np.abs(sweep.impedance)
        additive = replace(best.data, weight=size / np.median(size))
        again = search(additive, max_modes, None if len(sweep) < FEW_POINTS else best.model)
        other, more = _reweighted(sweep, max_modes, again.best)
        tried = (*tried, *again.tried, *more)
        if other.evidence < best.evidence:
            best = other
    return best, tried


def _reweighted(sweep: ImpedanceSpectrum, max_modes: int, best: Fit) -> tuple[Fit, tuple[Candidate, ...]]:
    """The fit, and orders tried, of a search continued with the noise that the residual shows, if its shape differs."""
    noise = noise_of(best, sweep)
    if noise.additive == 0 and np.ptp(best.data.weight) == 0:
        return best, ()
    impedance = 1 / best.model.admittance(sweep.omega)
    found = search(replace(best.data, weight=np.abs(impedance) / noise.std(impedance)), max_modes, best.model)
    return found.best, found.tried


def noise_of(result: Fit, sweep: ImpedanceSpectrum) -> NoiseUsed:
    """The noise of the sweep as the residual of a fit shows it."""
    impedance = 1 / result.model.admittance(sweep.omega)
    return noise_from_residual(sweep.impedance - impedance, impedance, result.model.size)


def _guarded(best: Fit) -> Fit:
    """The final fit, with `GUARD_DEGREES` more background than the evidence asks for."""
    if not best.model.poles.size or best.model.size + GUARD_DEGREES >= len(best.data):
        return best
    return fit(widen(best.model, GUARD_DEGREES), best.data, tolerance=1e-12)
