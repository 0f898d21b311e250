"""Errors of the approximate laws of causes, of known size, which a fit counts beside the noise.

The law of a cause is an approximation, wrong by a share e of what it describes (`EffectParameter.law_error`). It may be
wrong as a whole: the best-fitting parameter is off by e of its value. It may also be wrong in shape: of the change
p ∂log Z/∂p by its size p, less what other unknowns can do as well, it misses a share e, independently in each band. (A
film that stiffens a plate acts much as s11 does; that part has the shape of s11, hence no error of shape.) A law that
ends with the square of p may also place the modes of other classes, which the terminals drive only through the cause,
at frequencies that are off by φ p² (`EffectParameter.law_detuning`), independently in each band; no fit corrects these.
All these errors shift the other unknowns as errors of the data do, and might be taken for a further cause.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from femu_piezo.effects.effect import Effect, EffectParameter, LocalTerm
from femu_piezo.effects.local.operators import Places
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.measurement.sweeps import SweepData

if TYPE_CHECKING:
    from femu_piezo.inference.descent import Response

#: Relative frequency by which modes of other classes are off.
_DETUNING = EffectParameter("detuning", "1", 0.0, 0.0, 1.0, 0.0)
#: Relative step of the frequency for ∂log Z/∂log f, whose relative error is about this times half of Q.
_STEP = 1e-7


def log_slope(response: Response, parameters: Unknowns, x: np.ndarray, impedance: np.ndarray) -> np.ndarray:
    """(k,) ∂log Z/∂log f at x (n_x,), where Z is `impedance` (k,), ohm."""
    return np.log(response.at(1 + _STEP).impedance(parameters, x) / impedance) / _STEP


def law_misses(
    response: Response,
    data: SweepData,
    parameters: Unknowns,
    x: np.ndarray,
    at_x: np.ndarray,
) -> np.ndarray:
    """(2k, m) whitened errors of log Z, independent and of one standard deviation each, of all laws at x (n_x,).

    For every parameter p: e p ∂log Z/∂p. For the first one, the size, in each band: e p ∂log Z/∂p less what the other
    unknowns can do within their priors, and φ p² ∂log Z/∂δ, δ the relative frequency by which modes of other classes
    are off. Laws of known effects count as those of fitted ones do.

    at_x : whitened Jacobian (2k, n_x) at x
    """
    known = [item for item in parameters.fixed if _approximate(item[0])]
    whole = replace(
        parameters,
        effects=(*parameters.effects, *(effect for effect, _ in known)),
        fixed=tuple(item for item in parameters.fixed if not _approximate(item[0])),
    )
    numbers = [number for number, effect in enumerate(whole.effects) if _approximate(effect)]
    if not numbers:
        return np.zeros((2 * data.impedance.size, 0))
    at = np.concatenate([x, *(values / effect.scale for effect, values in known)])
    jacobian = data.whitened(*response.with_jacobian(whole, at))[1] if known else at_x
    found, prior_std = [], parameters.prior_std
    for number in numbers:
        effect, columns = whole.effects[number], whole.columns(number)
        errors = np.array([parameter.law_error for parameter in effect.parameters])
        size = at[columns.start] - effect.rest[0] / effect.scale[0]
        found.append(jacobian[:, columns] * (errors * at[columns]))
        others = np.delete(np.arange(x.size), np.arange(columns.start, min(columns.stop, x.size)))
        span = np.linalg.qr(np.concatenate([jacobian[:, others] * prior_std[others], np.eye(others.size)]))[0]
        span, miss = span[: len(jacobian)], errors[0] * size * jacobian[:, columns.start]
        found.append(_in_bands(data, miss - span @ (span.T @ miss)))
        if detuning := effect.parameters[0].law_detuning:
            detuned = _detuned(effect)
            moved = replace(whole, effects=(*whole.effects[:number], detuned, *whole.effects[number + 1 :]))
            there = np.insert(at, columns.stop, 0.0)
            alone = moved.alone(detuned, there), there[columns.start : columns.stop + 1]
            slope = data.whitened(*response.with_jacobian(*alone))[1][:, -1]
            found.append(_in_bands(data, detuning * (size * effect.scale[0]) ** 2 * slope))
    return np.hstack(found)


def _in_bands(data: SweepData, miss: np.ndarray) -> np.ndarray:
    """(2k, m) a whitened error (2k,) in each band alone, 0 elsewhere."""
    found = []
    for band in data.bands():
        rows = np.concatenate([band, band + data.impedance.size])
        part = np.zeros(miss.size)
        part[rows] = miss[rows]
        found.append(part)
    return np.stack(found, axis=1)


def _approximate(effect: Effect) -> bool:
    return any(parameter.law_error > 0 for parameter in effect.parameters)


def _detuned(effect: Effect) -> Effect:
    """The effect with a further last parameter δ, which multiplies the frequencies of its other classes by 1 + δ."""
    law = effect.local
    assert law is not None

    def terms(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
        found = [replace(term, slopes=np.pad(term.slopes, [(0, 0), (0, 1)])) for term in law(places, omega, p[:-1])]
        lighter, unit = np.zeros(places.size), np.ones(omega.shape, dtype=complex)
        lighter[places.sectors.of_other_classes(effect.sectors)] = -2.0
        matrix, slopes = places.of_displacements(np.diag(lighter)), unit[:, None] * np.eye(p.size)[-1]
        return [*found, LocalTerm("inertia", matrix, p[-1] * unit, slopes)]

    return replace(effect, parameters=(*effect.parameters, _DETUNING), local=terms)
