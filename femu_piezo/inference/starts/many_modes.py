"""Updating by many poles and zeros (Cong et al. 2022, appendix A, eq 84): any free constants, modes and specimens.

    Σ_n (∂λ_i/∂θ_n) δθ_n = λ_i' − λ_i,

solved by least squares, weighted by the joint covariance of the measured λ, which an extraction gives, and by the
errors of the mesh. The priors are those of a fit of curves (`femu_piezo.inference.unknowns`), so that dimensions,
density, held constants and fixture are found with the constants, within their tolerances. Poles and zeros are those at
the terminals; a smooth error of |Z| and phase shifts none. ε33T from the low end of a sweep is a further datum: the
poles and zeros of one mode determine d²/ε, and separate d from ε only as far as the modes differ from those of a bar.
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
from femu_piezo.inference.walls import readings
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.resonances import Kind, Resonance, ResonanceSet
from femu_piezo.threads import made_once

#: Most steps; largest change of an unknown of the material in one; change, in standard deviations, below which a step
#: counts as settled; number of settled steps that are made: with wide tolerances these still reduce the residual of
#: poles and zeros quadratically.
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
    omega : (k,) rad/s, the points over which it is averaged
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
    model_error : (m,) relative errors by the mesh of the model's λ, of the poles, then of the zeros
    low_end : None where the sweep has none
    selected : resonances that the update uses; where None, all that are near one of the model at the start
    """

    resonances: ResonanceSet
    evaluation: Evaluation
    share: Share
    model_error: np.ndarray
    low_end: LowEnd | None = None
    selected: tuple[Resonance, ...] | None = None

    @property
    def poles_and_zeros(self) -> tuple[Resonance, ...]:
        """Poles, then zeros."""
        return (*self.resonances.poles, *self.resonances.zeros)


@dataclass(frozen=True)
class ManyModes:
    """The most probable unknowns, and the model linearised there.

    Attributes
    ----------
    x : (n_x,) solution
    measured : poles and zeros of every sweep;  used : those that the update used
    residual, jacobian : (m,), (m, n_x) of what was measured, whitened by its noise and the errors of the mesh
    mesh : (m, n) the errors of the mesh, whitened, each column one standard deviation
    reading_slopes : (n, n_x) slopes of the readings of other instruments
    """

    parameters: Unknowns
    x: np.ndarray
    measured: tuple[tuple[Resonance, ...], ...]
    used: tuple[tuple[Resonance, ...], ...]
    residual: np.ndarray
    jacobian: np.ndarray
    mesh: np.ndarray
    reading_slopes: np.ndarray

    @property
    def constants(self) -> PiezoConstants:
        """The ten constants as found."""
        return self.parameters.material.constants(self.x[: self.parameters.of_material])

    @property
    def rms_residual(self) -> float:
        """rms of the whitened residual of what was measured, per number that the unknowns do not follow."""
        count = self.residual.size
        determined = float(np.sum(self.jacobian * self.gain[:, :count].T))  # Σ (1 − posterior/prior variance)
        return float(np.sqrt(np.sum(self.residual**2) / max(round(count - determined), 1)))

    @made_once
    def gain(self) -> np.ndarray:
        """(n_x, m + n_x + n): how x moves with the residuals of what was measured, of the priors and of readings.

        By QR with sorted rows and pivoted columns, which is stable row by row (Cox and Higham, BIT 38 (1998) 34): what
        was measured may be a million times as exact as what is known before.
        """
        std = self.parameters.prior_std
        rows = np.concatenate([self.jacobian * std, np.eye(std.size), self.reading_slopes * std])
        order = np.argsort(-np.max(np.abs(rows), axis=1))
        span, triangle, columns = qr(rows[order], mode="economic", pivoting=True)
        found = np.empty(rows.T.shape)
        found[np.ix_(columns, order)] = solve_triangular(triangle, span.T)
        return std[:, None] * found

    @made_once
    def budget(self) -> dict[str, np.ndarray]:
        """Source → (n_x,) its part of every standard deviation, as `femu_piezo.inference.budget`.

        All of them are multiplied by `rms_residual` where that is above 1.
        """
        data, prior, read = np.split(self.gain, np.cumsum([self.residual.size, self.x.size]), axis=1)
        mesh = np.sum((data @ self.mesh) ** 2, axis=1)
        parts = {"noise": np.maximum(np.sum(data**2, axis=1) - mesh, 0.0), "mesh": mesh}
        if read.size:
            parts["readings"] = np.sum(read**2, axis=1)
        for source, columns in groups(self.parameters).items():
            parts[source] = np.sum(prior[:, columns] ** 2, axis=1)
        return {source: max(1.0, self.rms_residual) * np.sqrt(parts[source]) for source in SOURCES if source in parts}

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
    kept = [_used(sweep, parameters, start) for sweep in measured]
    if not any(np.any(used) for used in kept):
        raise ConvergenceError(
            "no measured pole or zero lies near one of the model; start from a closer base material or check dimensions"
        )
    x, count, settled = start, parameters.of_material, 0
    for _ in range(_STEPS):
        found = _linearised(measured, kept, parameters, x)
        prior = (x - parameters.prior_mean) / parameters.prior_std
        step = -found.gain @ np.concatenate([found.residual, prior, readings(parameters, x)[0]])
        x = x + step * min(1.0, _LARGEST / float(np.max(np.abs(step[:count]))))
        _check(parameters.material.constants(x[:count]))
        settled += bool(np.max(np.abs(step) / found.std) < _SETTLED)
        if settled == _LAST:
            return _linearised(measured, kept, parameters, x)
    raise ConvergenceError(
        "the update by many poles and zeros does not settle; free fewer constants or start from a closer base material"
    )


def _used(sweep: MeasuredModes, parameters: Unknowns, x: np.ndarray) -> np.ndarray:
    """(m,) bool: which of the poles, then zeros, the update uses."""
    if sweep.selected is not None:
        return np.array([any(one is other for other in sweep.selected) for one in sweep.poles_and_zeros], dtype=bool)
    unknowns, columns = sweep.share.of(parameters)
    modal = sweep.evaluation.modal(unknowns, x[columns])
    found = []
    for data, values in ((sweep.resonances.poles, modal.eigenvalues), (sweep.resonances.zeros, modal.zeros[0])):
        for resonance in data:
            distance = np.abs(np.log(np.abs(values.real) / resonance.eigenvalue.real))
            found.append(bool(distance.min() < _FAR))
    return np.array(found, dtype=bool)


def _linearised(
    measured: Sequence[MeasuredModes], kept: Sequence[np.ndarray], parameters: Unknowns, x: np.ndarray
) -> ManyModes:
    """The model linearised at x (n_x,): residual of all that was measured and is used, and its slopes."""
    rows, slopes, mesh = [], [], []
    for sweep, use in zip(measured, kept, strict=True):
        unknowns, columns = sweep.share.of(parameters)
        parts = [_mode_residuals(sweep, use, unknowns, x[columns])] if np.any(use) else []
        if sweep.low_end is not None and "eps33T" in unknowns.material.free.names:
            parts.append(_low_end_residual(sweep.low_end, sweep.evaluation, unknowns, x[columns]))
        for residual, jacobian, errors in parts:
            rows.append(residual)
            slopes.append(np.zeros((residual.size, x.size)))
            slopes[-1][:, columns] = jacobian
            mesh.append(errors)
    return ManyModes(
        parameters=parameters,
        x=x,
        measured=tuple(sweep.poles_and_zeros for sweep in measured),
        used=tuple(
            tuple(resonance for resonance, wanted in zip(sweep.poles_and_zeros, use, strict=True) if wanted)
            for sweep, use in zip(measured, kept, strict=True)
        ),
        residual=np.concatenate(rows),
        jacobian=np.concatenate(slopes),
        mesh=block_diag(*mesh),
        reading_slopes=readings(parameters, x)[1],
    )


def _mode_residuals(
    sweep: MeasuredModes, use: np.ndarray, unknowns: Unknowns, x: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whitened λ − λ' of the poles and zeros that are used, its slopes in x, and the errors of the mesh."""
    modal = sweep.evaluation.modal(unknowns, x)
    impedance = sweep.evaluation.terminals(unknowns, x, modal)
    count = len(sweep.resonances.poles)
    kinds: tuple[tuple[Kind, tuple[Resonance, ...], np.ndarray, np.ndarray, np.ndarray], ...] = (
        ("pole", sweep.resonances.poles, use[:count], modal.eigenvalues, modal.charges),
        ("zero", sweep.resonances.zeros, use[count:], modal.zeros[0], modal.zero_amplitudes),
    )
    residuals, slopes = [], []
    for kind, data, wanted, values, amplitudes in kinds:
        chosen = [resonance for resonance, used in zip(data, wanted, strict=True) if used]
        roots = terminal_roots(impedance, kind, np.sqrt(values[match(chosen, values, amplitudes)] + 0j), chosen)
        residuals.append(roots**2 - [resonance.eigenvalue for resonance in chosen])
        slopes.append(2 * roots[:, None] * root_slopes(sweep.evaluation, unknowns, x, kind, roots))
    where = np.repeat(use, 2)
    size = np.array([abs(resonance.eigenvalue) for resonance in sweep.poles_and_zeros])[use]
    mesh = np.zeros((2 * size.size, size.size))
    mesh[2 * np.arange(size.size), np.arange(size.size)] = sweep.model_error[use] * size
    if sweep.resonances.covariance is None:
        raise ValueError("these poles and zeros have no covariance")
    covariance = sweep.resonances.covariance[np.ix_(where, where)] + mesh @ mesh.T
    rounding = np.diag((_ROUNDING * np.repeat(size, 2)) ** 2)
    return _whitened(covariance + rounding, np.concatenate(residuals), np.concatenate(slopes), mesh)


def _low_end_residual(
    low_end: LowEnd, whole: Evaluation, unknowns: Unknowns, x: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whitened residual of ε33T from the low end, its slopes in x, and no errors of the mesh.

    The model has ε33T of its constants, times the mean of Z(x_0)/Z(x) over the low end: x_0 is x with all but the
    constants at their prior means.
    """
    evaluation = replace(whole, omega=low_end.omega)
    rest = unknowns.prior_mean.copy()
    count, material = unknowns.of_material, unknowns.material
    rest[:count] = x[:count]
    (z, slopes), (at_rest, rest_slopes) = (evaluation.with_jacobian(unknowns, point) for point in (x, rest))
    ratio = at_rest / z
    moved = -ratio[:, None] * slopes / z[:, None]
    moved[:, :count] += (rest_slopes / z[:, None])[:, :count]
    index = material.free.names.index("eps33T")
    theta = material.theta(x[:count])[index]
    jacobian = theta * moved.mean(axis=0)
    jacobian[:count] += ratio.mean() * material.slopes(x[:count])[index]
    residual = np.array([theta * ratio.mean() - low_end.permittivity])
    rounding = (_ROUNDING * abs(low_end.permittivity)) ** 2 * np.eye(2)
    return _whitened(low_end.covariance + rounding, residual, jacobian[None], np.zeros((2, 0)))


def _whitened(
    covariance: np.ndarray, residual: np.ndarray, slopes: np.ndarray, mesh: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Complex residual (m,) and slopes (m, n) as pairs Re, Im, and mesh (2m, k), whitened by a covariance (2m, 2m)."""
    columns = np.column_stack([residual, slopes])
    parts = np.stack([columns.real, columns.imag], axis=1).reshape(2 * residual.size, -1)
    white = solve_triangular(np.linalg.cholesky(covariance), np.hstack([parts, mesh]), lower=True)
    return white[:, 0], white[:, 1 : slopes.shape[1] + 1], white[:, slopes.shape[1] + 1 :]


def _check(constants: PiezoConstants) -> None:
    faults = constants.physical_faults(passive=False)
    if faults:
        raise ConvergenceError(
            f"update by many poles and zeros: {'; '.join(map(str, faults))}; the data do not determine all free "
            "constants, free fewer of them or state what is known (std_s33, …)"
        )
