"""Updating by many poles and zeros (Cong et al. 2022, appendix A, eq 84): any free constants, modes and specimens.

    Σ_n (∂λ_i/∂θ_n) δθ_n = λ_i' − λ_i,

solved by least squares in the metric of the measured λ, whose joint covariance an extraction gives, and of the errors
of the mesh, beside what is known of the constants before: a permittivity from the low end of a sweep, and the weak
prior of every fit, which holds what poles and zeros do not tell. Of one mode these tell d²/ε, and d and ε apart only
by how far the modes between them are from those of a bar.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from femu_piezo.errors import ConvergenceError
from femu_piezo.forward.modal import ModalModel
from femu_piezo.inference.matching import match
from femu_piezo.inference.unknowns import FreeConstants, MaterialParameters
from femu_piezo.material.constants import E_FORM, PiezoConstants
from femu_piezo.resonances import Resonance, ResonanceSet

#: Steps at most, largest relative change of a constant in one, and change in its deviations that is settled.
_STEPS, _LARGEST, _SETTLED = 40, 0.2, 1e-3
#: |log λ_model/λ_measured| beyond which a measured resonance is taken for none of the model's at the start.
_FAR = 0.1


@dataclass(frozen=True)
class MeasuredModes:
    """Poles and zeros of one specimen.

    Attributes
    ----------
    resonances : with their joint covariance
    modal : constants → the modes of its model
    model_error : (m,) relative errors of the model's λ, of the poles, then of the zeros: those of its mesh
    permittivity : ε33T and its (2, 2) covariance over (Re, Im), where the sweep reaches low frequency; else None
    """

    resonances: ResonanceSet
    modal: Callable[[PiezoConstants], ModalModel]
    model_error: np.ndarray
    permittivity: tuple[complex, np.ndarray] | None = None


@dataclass(frozen=True)
class ManyModes:
    """Outcome of an update.

    Attributes
    ----------
    constants : the ten;  theta : (n,) complex, the free ones;  covariance : (2n, 2n) over (Re θ_1, Im θ_1, …)
    used : poles and zeros of every specimen that it followed
    left : rms of what is left of the measured λ, over its deviation
    """

    constants: PiezoConstants
    theta: np.ndarray
    covariance: np.ndarray
    used: tuple[tuple[Resonance, ...], ...]
    left: float


def update_many(
    measured: Sequence[MeasuredModes], free: FreeConstants, prior: Mapping[str, tuple[float, float]]
) -> ManyModes:
    """Constants that give the measured poles and zeros best, by Gauss and Newton from the free constants' start.

    Parameters
    ----------
    prior : as of `femu_piezo.inference.unknowns.Unknowns`

    Raises
    ------
    ConvergenceError : the constants leave the physical range, or do not settle, or nothing was measured near a mode
    """
    material = MaterialParameters.around(free, free.start)
    x, means = material.x_of(free.start), np.array([prior[name] for name in material.names])
    mean, std = means[:, 0] / material.units, means[:, 1] / np.abs(material.units)
    kept = [_near(one, free.constants(free.start)) for one in measured]
    if not any(np.any(own) for own in kept):
        raise ConvergenceError(
            "no measured pole or zero lies near one of the model; start from a closer base material or check dimensions"
        )
    for _ in range(_STEPS):
        rows, slopes = _rows(measured, kept, material, x)
        count = rows.size
        rows, slopes = np.concatenate([rows, (mean - x) / std]), np.concatenate([slopes, np.diag(1 / std)])
        q, r = np.linalg.qr(slopes * std)
        step, covariance = std * np.linalg.solve(r, q.T @ rows), np.linalg.inv(r.T @ r) * np.outer(std, std)
        largest = float(np.max(np.abs(step)))
        x = x + step * min(1.0, _LARGEST / largest)
        _check(material.constants(x))
        if np.max(np.abs(step) / np.sqrt(np.diag(covariance))) < _SETTLED:
            left = float(np.sqrt(np.mean(rows[:count] ** 2)))
            covariance = covariance * max(1.0, left) ** 2
            return ManyModes(
                constants=material.constants(x),
                theta=material.theta(x),
                covariance=material.theta_covariance(x, covariance),
                used=tuple(_chosen(one, own) for one, own in zip(measured, kept, strict=True)),
                left=left,
            )
    raise ConvergenceError(
        "the update by many poles and zeros does not settle; free fewer constants or start from a closer base material"
    )


def _every(one: MeasuredModes) -> tuple[Resonance, ...]:
    return (*one.resonances.poles, *one.resonances.zeros)


def _chosen(one: MeasuredModes, kept: np.ndarray) -> tuple[Resonance, ...]:
    return tuple(resonance for resonance, use in zip(_every(one), kept, strict=True) if use)


def _near(one: MeasuredModes, constants: PiezoConstants) -> np.ndarray:
    """(m,) bool: the measured poles, then zeros, near one of the model."""
    modal = one.modal(constants)
    found = []
    for data, values in ((one.resonances.poles, modal.eigenvalues), (one.resonances.zeros, modal.zeros[0])):
        for resonance in data:
            distance = np.abs(np.log(np.abs(values.real) / resonance.eigenvalue.real))
            found.append(bool(distance.min() < _FAR))
    return np.array(found, dtype=bool)


def _rows(
    measured: Sequence[MeasuredModes], kept: Sequence[np.ndarray], material: MaterialParameters, x: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Whitened misfit λ' − λ of everything measured, and its slopes in x; (m,), (m, n_x)."""
    constants = material.constants(x)
    into_e_form, rows, slopes = material.coefficient_slopes(x), [], []
    for one, own in zip(measured, kept, strict=True):
        if np.any(own):
            values, sensitivities = _model(one.modal(constants), one, own)
            data = np.array([resonance.eigenvalue for resonance in _chosen(one, own)])
            misfit, moved = data - values, sensitivities @ into_e_form
            factor = np.linalg.cholesky(_covariance(one, own))
            both = np.column_stack([misfit, moved])
            parts = np.stack([both.real, both.imag], axis=1).reshape(2 * len(data), -1)
            white = np.linalg.solve(factor, parts)
            rows.append(white[:, 0])
            slopes.append(white[:, 1:])
        if one.permittivity is not None and "eps33T" in material.free.names:
            value, covariance = one.permittivity
            index = material.free.names.index("eps33T")
            both = np.append(value - material.theta(x)[index], material.slopes(x)[index])
            white = np.linalg.solve(np.linalg.cholesky(covariance), np.stack([both.real, both.imag]))
            rows.append(white[:, 0])
            slopes.append(white[:, 1:])
    return np.concatenate(rows), np.concatenate(slopes)


def _model(modal: ModalModel, one: MeasuredModes, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """λ (m,) of the model for the poles and zeros that are used, and ∂λ/∂(e-form) (m, 10)."""
    count, found, slopes = len(one.resonances.poles), [], []
    kinds = (
        (one.resonances.poles, own[:count], modal.eigenvalues, modal.charges, modal.pole_sensitivity),
        (one.resonances.zeros, own[count:], modal.zeros[0], modal.zero_amplitudes, modal.zero_sensitivity),
    )
    for data, use, values, amplitudes, sensitivity in kinds:
        numbers = match([item for item, wanted in zip(data, use, strict=True) if wanted], values, amplitudes)
        found += [values[number] for number in numbers]
        slopes += [sensitivity(number)[: len(E_FORM)] for number in numbers]
    return np.array(found), np.array(slopes)


def _covariance(one: MeasuredModes, own: np.ndarray) -> np.ndarray:
    """(2m, 2m) over (Re λ, Im λ) of the poles and zeros that are used; errors of the model are independent."""
    where = np.repeat(own, 2)
    size = np.array([abs(resonance.eigenvalue) for resonance in _every(one)])
    return one.resonances.covariance[np.ix_(where, where)] + np.diag(
        np.repeat((one.model_error * size)[own] ** 2, 2) * np.tile([1.0, 0.0], np.count_nonzero(own))
    )


def _check(constants: PiezoConstants) -> None:
    faults = constants.physical_faults(passive=False)
    if faults:
        raise ConvergenceError(
            f"update by many poles and zeros: {'; '.join(map(str, faults))}; the data do not determine all free "
            "constants, free fewer of them or state what is known (std_s33, …)"
        )
