"""Updating by many poles and zeros (Cong et al. 2022, appendix A, eq 84): any free constants, modes and specimens.

    Σ_n (∂λ_i/∂θ_n) δθ_n = λ_i' − λ_i,

solved by least squares in the metric of the measured λ, whose joint covariance an extraction gives, and of the errors
of the mesh, beside what is known before: of every unknown of a fit of curves (`femu_piezo.inference.unknowns`), so that
dimensions, density, held constants and fixture are found with the constants within their tolerances. Poles and zeros
are those at the terminals; a smooth error of |Z| and phase moves none. ε33T from the low end of a sweep joins them.
Of one mode poles and zeros tell d²/ε, and d and ε apart only by how far the modes between them are from those of a bar.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag, qr, solve_triangular

from femu_piezo.errors import ConvergenceError
from femu_piezo.inference.budget import SOURCES, groups
from femu_piezo.inference.ensemble import Share
from femu_piezo.inference.matching import match
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.terminal_roots import root_slopes, terminal_roots
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.resonances import Kind, Resonance, ResonanceSet
from femu_piezo.threads import made_once

#: Steps at most, largest relative change of a constant in one, change in its deviations that is settled, and how many
#: steps below that are made: where tolerances are wide these still square what is left of the poles and zeros.
_STEPS, _LARGEST, _SETTLED, _LAST = 40, 0.2, 1e-3, 2
#: Relative deviation that nothing measured falls below: the rounding of the model's eigenvalues.
_ROUNDING = 1e-10
#: |log λ_model/λ_measured| beyond which a measured resonance is taken for none of the model's at the start.
_FAR = 0.1


@dataclass(frozen=True)
class LowEnd:
    """ε33T as the low end of a sweep gives it, with the dimensions of the file (eqs 41, 42).

    Attributes
    ----------
    permittivity : complex, F/m;  covariance : (2, 2) over (Re, Im)
    omega : (k,) rad/s, the points it is the mean of
    """

    permittivity: complex
    covariance: np.ndarray
    omega: np.ndarray


@dataclass(frozen=True)
class MeasuredModes:
    """Poles and zeros of one sweep.

    Attributes
    ----------
    resonances : with their joint covariance
    evaluation : the model of its specimen;  share : which unknowns concern it
    model_error : (m,) relative errors of the model's λ, of the poles, then of the zeros: those of its mesh
    low_end : None where the sweep has none
    only : those that are to be followed; where None, all that are near one of the model's at the start
    """

    resonances: ResonanceSet
    evaluation: Evaluation
    share: Share
    model_error: np.ndarray
    low_end: LowEnd | None = None
    only: tuple[Resonance, ...] | None = None

    @property
    def every(self) -> tuple[Resonance, ...]:
        """Poles, then zeros."""
        return (*self.resonances.poles, *self.resonances.zeros)


@dataclass(frozen=True)
class ManyModes:
    """The most probable unknowns, and the model linearised there.

    Attributes
    ----------
    x : (n_x,) solution
    measured : poles and zeros of every sweep;  used : those that it followed
    residual, jacobian : (m,), (m, n_x) of what was measured, whitened by its noise and the errors of the mesh
    mesh : (m, n) the errors of the mesh, whitened, each column one standard deviation
    read : (n, n_x) slopes of the readings of other instruments
    """

    parameters: Unknowns
    x: np.ndarray
    measured: tuple[tuple[Resonance, ...], ...]
    used: tuple[tuple[Resonance, ...], ...]
    residual: np.ndarray
    jacobian: np.ndarray
    mesh: np.ndarray
    read: np.ndarray

    @property
    def constants(self) -> PiezoConstants:
        """The ten constants as found."""
        return self.parameters.material.constants(self.x[: self.parameters.of_material])

    @property
    def left(self) -> float:
        """rms of what is left of what was measured, over its deviation."""
        return float(np.sqrt(np.mean(self.residual**2)))

    @made_once
    def gain(self) -> np.ndarray:
        """(n_x, m + n_x + n): how x moves with the residuals of what was measured, of the priors and of readings.

        By QR with sorted rows and pivoted columns, which is stable row by row (Cox and Higham, BIT 38 (1998) 34): what
        was measured may be a million times as exact as what is known before.
        """
        std = self.parameters.prior_std
        rows = np.concatenate([self.jacobian * std, np.eye(std.size), self.read * std])
        order = np.argsort(-np.max(np.abs(rows), axis=1))
        span, triangle, columns = qr(rows[order], mode="economic", pivoting=True)
        found = np.empty(rows.T.shape)
        found[np.ix_(columns, order)] = solve_triangular(triangle, span.T)
        return std[:, None] * found

    @made_once
    def budget(self) -> dict[str, np.ndarray]:
        """Source → (n_x,) its part of every standard deviation, as `femu_piezo.inference.budget`.

        All of them are widened by what is left beyond the deviations of what was measured.
        """
        data, prior, read = np.split(self.gain, np.cumsum([self.residual.size, self.x.size]), axis=1)
        mesh = np.sum((data @ self.mesh) ** 2, axis=1)
        parts = {"noise": np.maximum(np.sum(data**2, axis=1) - mesh, 0.0), "mesh": mesh}
        if read.size:
            parts["readings"] = np.sum(read**2, axis=1)
        for source, columns in groups(self.parameters).items():
            parts[source] = np.sum(prior[:, columns] ** 2, axis=1)
        return {source: max(1.0, self.left) * np.sqrt(parts[source]) for source in SOURCES if source in parts}

    @property
    def std(self) -> np.ndarray:
        """(n_x,) standard deviations of the unknowns."""
        return np.sqrt(sum(part**2 for part in self.budget.values()))


def update_many(measured: Sequence[MeasuredModes], parameters: Unknowns, start: np.ndarray) -> ManyModes:
    """Unknowns that give the measured poles and zeros best, by Gauss and Newton from a start (n_x,).

    Raises
    ------
    ConvergenceError : the constants leave the physical range, or do not settle, or nothing was measured near a mode
    """
    kept = [_followed(one, parameters, start) for one in measured]
    if not any(np.any(own) for own in kept):
        raise ConvergenceError(
            "no measured pole or zero lies near one of the model; start from a closer base material or check dimensions"
        )
    x, count, settled = start, parameters.of_material, 0
    for _ in range(_STEPS):
        found = _linearised(measured, kept, parameters, x)
        prior = (x - parameters.prior_mean) / parameters.prior_std
        step = -found.gain @ np.concatenate([found.residual, prior, _readings(parameters, x)[0]])
        x = x + step * min(1.0, _LARGEST / float(np.max(np.abs(step[:count]))))
        _check(parameters.material.constants(x[:count]))
        settled += bool(np.max(np.abs(step) / found.std) < _SETTLED)
        if settled == _LAST:
            return _linearised(measured, kept, parameters, x)
    raise ConvergenceError(
        "the update by many poles and zeros does not settle; free fewer constants or start from a closer base material"
    )


def _followed(one: MeasuredModes, parameters: Unknowns, x: np.ndarray) -> np.ndarray:
    """(m,) bool: which of the poles, then zeros, the update follows."""
    if one.only is not None:
        return np.array([any(resonance is other for other in one.only) for resonance in one.every], dtype=bool)
    own, columns = one.share.of(parameters)
    modal = one.evaluation.modal(own, x[columns])
    found = []
    for data, values in ((one.resonances.poles, modal.eigenvalues), (one.resonances.zeros, modal.zeros[0])):
        for resonance in data:
            distance = np.abs(np.log(np.abs(values.real) / resonance.eigenvalue.real))
            found.append(bool(distance.min() < _FAR))
    return np.array(found, dtype=bool)


def _linearised(
    measured: Sequence[MeasuredModes], kept: Sequence[np.ndarray], parameters: Unknowns, x: np.ndarray
) -> ManyModes:
    """What is left at x (n_x,) of everything measured, and its slopes."""
    rows, slopes, mesh = [], [], []
    for one, use in zip(measured, kept, strict=True):
        own, columns = one.share.of(parameters)
        parts = [_modes_left(one, use, own, x[columns])] if np.any(use) else []
        if one.low_end is not None and "eps33T" in own.material.free.names:
            parts.append(_low_end_left(one.low_end, one.evaluation, own, x[columns]))
        for residual, jacobian, errors in parts:
            rows.append(residual)
            slopes.append(np.zeros((residual.size, x.size)))
            slopes[-1][:, columns] = jacobian
            mesh.append(errors)
    return ManyModes(
        parameters=parameters,
        x=x,
        measured=tuple(one.every for one in measured),
        used=tuple(
            tuple(resonance for resonance, wanted in zip(one.every, use, strict=True) if wanted)
            for one, use in zip(measured, kept, strict=True)
        ),
        residual=np.concatenate(rows),
        jacobian=np.concatenate(slopes),
        mesh=block_diag(*mesh),
        read=_readings(parameters, x)[1],
    )


def _readings(parameters: Unknowns, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows (n,) and slopes (n, n_x) of the readings of other instruments."""
    read = [one.row(parameters, x) for one in parameters.readings]
    return np.array([row for row, _ in read]), np.reshape([slope for _, slope in read], (-1, x.size))


def _modes_left(
    one: MeasuredModes, use: np.ndarray, own: Unknowns, x: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whitened λ − λ' of the poles and zeros that are used, its slopes in x, and the errors of the mesh."""
    modal, impedance, count = one.evaluation.modal(own, x), one.evaluation.terminals(own, x), len(one.resonances.poles)
    kinds: tuple[tuple[Kind, tuple[Resonance, ...], np.ndarray, np.ndarray, np.ndarray], ...] = (
        ("pole", one.resonances.poles, use[:count], modal.eigenvalues, modal.charges),
        ("zero", one.resonances.zeros, use[count:], modal.zeros[0], modal.zero_amplitudes),
    )
    left, slopes = [], []
    for kind, data, wanted, values, amplitudes in kinds:
        chosen = [resonance for resonance, used in zip(data, wanted, strict=True) if used]
        roots = terminal_roots(impedance, kind, np.sqrt(values[match(chosen, values, amplitudes)] + 0j))
        left.append(roots**2 - [resonance.eigenvalue for resonance in chosen])
        slopes.append(2 * roots[:, None] * root_slopes(one.evaluation, own, x, kind, roots))
    where = np.repeat(use, 2)
    size = np.array([abs(resonance.eigenvalue) for resonance in one.every])[use]
    mesh = np.zeros((2 * size.size, size.size))
    mesh[2 * np.arange(size.size), np.arange(size.size)] = one.model_error[use] * size
    if one.resonances.covariance is None:
        raise ValueError("these poles and zeros have no covariance")
    covariance = one.resonances.covariance[np.ix_(where, where)] + mesh @ mesh.T
    rounding = np.diag((_ROUNDING * np.repeat(size, 2)) ** 2)
    return _whitened(covariance + rounding, np.concatenate(left), np.concatenate(slopes), mesh)


def _low_end_left(
    low_end: LowEnd, whole: Evaluation, own: Unknowns, x: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same of ε33T from the low end, which goes with 1/Z from that of the constants, all else at rest."""
    evaluation = replace(whole, omega=low_end.omega)
    rest = own.prior_mean.copy()
    count, material = own.of_material, own.material
    rest[:count] = x[:count]
    (z, slopes), (at_rest, rest_slopes) = (evaluation.with_jacobian(own, point) for point in (x, rest))
    ratio = at_rest / z
    moved = -ratio[:, None] * slopes / z[:, None]
    moved[:, :count] += (rest_slopes / z[:, None])[:, :count]
    index = material.free.names.index("eps33T")
    theta = material.theta(x[:count])[index]
    jacobian = theta * moved.mean(axis=0)
    jacobian[:count] += ratio.mean() * material.slopes(x[:count])[index]
    left = np.array([theta * ratio.mean() - low_end.permittivity])
    rounding = (_ROUNDING * abs(low_end.permittivity)) ** 2 * np.eye(2)
    return _whitened(low_end.covariance + rounding, left, jacobian[None], np.zeros((2, 0)))


def _whitened(
    covariance: np.ndarray, left: np.ndarray, slopes: np.ndarray, mesh: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Complex left (m,) and slopes (m, n) as real pairs, and real mesh (2m, k), over the factor of a covariance."""
    both = np.column_stack([left, slopes])
    parts = np.stack([both.real, both.imag], axis=1).reshape(2 * left.size, -1)
    white = solve_triangular(np.linalg.cholesky(covariance), np.hstack([parts, mesh]), lower=True)
    return white[:, 0], white[:, 1 : slopes.shape[1] + 1], white[:, slopes.shape[1] + 1 :]


def _check(constants: PiezoConstants) -> None:
    faults = constants.physical_faults(passive=False)
    if faults:
        raise ConvergenceError(
            f"update by many poles and zeros: {'; '.join(map(str, faults))}; the data do not determine all free "
            "constants, free fewer of them or state what is known (std_s33, …)"
        )
