"""What a fit is asked to explain: curves, poles and zeros, priors, passivity; each a block of residuals.

Every block turns the real unknowns x of `MaterialParameters` into whitened residuals (unit variance where the
model is right) with their exact Jacobian. A problem is a list of blocks: several spectra, several geometries of
one material and any prior knowledge are simply more blocks.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg import solve_triangular

from femu_piezo.forward.reduction import ReducedModel
from femu_piezo.inference.matching import match
from femu_piezo.inference.unknowns import MaterialParameters
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.resonances import ResonanceSet


class DataBlock(Protocol):
    """Residuals of one kind of data.

    `measured` tells data, whose noise may be learned from their misfit, from priors and walls.
    """

    name: str
    measured: bool

    def residual(self, parameters: MaterialParameters, x: np.ndarray) -> np.ndarray:
        """(k,) real, whitened."""

    def jacobian(self, parameters: MaterialParameters, x: np.ndarray) -> np.ndarray:
        """(k, 2n) real ∂residual/∂x."""


def _stack(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values.real, values.imag])


class SweepBlock(ABC):
    """A sweep: residual (log Z_model − log Z_measured)/σ, Re and Im parts.

    For relative noise this is the log-likelihood to first order, and it stays well shaped far from the solution.
    What models the sweep gives Z and its slopes.

    Attributes
    ----------
    relative_noise : (k,) standard deviation of the complex relative error, sqrt(E|δZ/Z|²)
    """

    name: str
    spectrum: ImpedanceSpectrum
    relative_noise: np.ndarray
    measured = True

    @abstractmethod
    def impedance(self, parameters: MaterialParameters, x: np.ndarray, omega: np.ndarray) -> np.ndarray:
        """Z (n,) at any ω (n,), ohm."""

    @abstractmethod
    def log_slopes(self, parameters: MaterialParameters, x: np.ndarray) -> np.ndarray:
        """∂log Z/∂x (k, 2n) over the sweep."""

    def residual(self, parameters: MaterialParameters, x: np.ndarray) -> np.ndarray:
        ratio = self.impedance(parameters, x, self.spectrum.omega) / self.spectrum.impedance
        return _stack(np.log(ratio) * self._weight)

    def jacobian(self, parameters: MaterialParameters, x: np.ndarray) -> np.ndarray:
        return _stack(self.log_slopes(parameters, x) * self._weight[:, None])

    @property
    def _weight(self) -> np.ndarray:
        return np.sqrt(2.0) / self.relative_noise


@dataclass(frozen=True)
class CurveData(SweepBlock):
    """A sweep explained by a reduced model: ∂log Z/∂x = −(1/Y) Σ_q ∂Y/∂c_q ∂c_q/∂x."""

    name: str
    reduced: ReducedModel
    spectrum: ImpedanceSpectrum
    relative_noise: np.ndarray

    def impedance(self, parameters: MaterialParameters, x: np.ndarray, omega: np.ndarray) -> np.ndarray:
        return 1 / self.reduced.modal(parameters.constants(x).to_e_form()).admittance(omega)

    def log_slopes(self, parameters: MaterialParameters, x: np.ndarray) -> np.ndarray:
        modal = self.reduced.modal(parameters.constants(x).to_e_form())
        omega = self.spectrum.omega
        directions = np.zeros((len(self.reduced.terms), x.size), dtype=complex)
        directions[:10] = parameters.coefficient_slopes(x)
        return -modal.admittance_jacobian(omega, directions) / modal.admittance(omega)[:, None]


@dataclass(frozen=True)
class PoleZeroData:
    """Measured poles and zeros: residual L^-1 (λ_model − λ_measured), covariance = L Lᵗ (appendix A, weighted).

    Each measured resonance is matched to the model's mode by frequency and by how strongly the terminals drive
    it, anew at every evaluation, so that crossing modes are followed by their character.
    """

    name: str
    reduced: ReducedModel
    resonances: ResonanceSet
    measured = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "_factor", np.linalg.cholesky(self._covariance()))

    def _covariance(self) -> np.ndarray:
        if self.resonances.covariance is not None:
            return self.resonances.covariance
        resonances = (*self.resonances.poles, *self.resonances.zeros)
        spread = np.repeat([1e-4 * abs(resonance.eigenvalue) for resonance in resonances], 2)
        return np.diag(spread**2)

    def _matched(self, parameters: MaterialParameters, x: np.ndarray):
        modal = self.reduced.modal(parameters.constants(x).to_e_form())
        poles = match(self.resonances.poles, modal.eigenvalues, modal.charges)
        zeros = match(self.resonances.zeros, modal.zeros[0], modal.zero_amplitudes)
        return modal, poles, zeros

    def residual(self, parameters: MaterialParameters, x: np.ndarray) -> np.ndarray:
        modal, poles, zeros = self._matched(parameters, x)
        model = np.concatenate([modal.eigenvalues[poles], modal.zeros[0][zeros]])
        data = np.array([r.eigenvalue for r in (*self.resonances.poles, *self.resonances.zeros)])
        difference = np.stack([(model - data).real, (model - data).imag], axis=1).ravel()
        return solve_triangular(self._factor, difference, lower=True)

    def jacobian(self, parameters: MaterialParameters, x: np.ndarray) -> np.ndarray:
        modal, poles, zeros = self._matched(parameters, x)
        rows = [modal.pole_sensitivity(i)[:10] for i in poles] + [modal.zero_sensitivity(i)[:10] for i in zeros]
        slopes = np.array(rows) @ parameters.coefficient_slopes(x)
        stacked = np.stack([slopes.real, slopes.imag], axis=1).reshape(-1, x.size)
        return solve_triangular(self._factor, stacked, lower=True)


@dataclass(frozen=True)
class Prior:
    """Prior knowledge of free constants: (value, standard deviation) of real parts and tangents by unknown's name."""

    values: Mapping[str, tuple[float, float]]
    name: str = "prior"
    measured = False

    def residual(self, parameters: MaterialParameters, x: np.ndarray) -> np.ndarray:
        return np.array([(self._value(parameters, x, name) - m) / s for name, (m, s) in self.values.items()])

    def jacobian(self, parameters: MaterialParameters, x: np.ndarray) -> np.ndarray:
        rows = np.zeros((len(self.values), x.size))
        for row, (name, (_, std)) in enumerate(self.values.items()):
            column = parameters.names.index(name)
            rows[row, column] = (1.0 if column % 2 else parameters.scale[column // 2]) / std
        return rows

    @staticmethod
    def _value(parameters: MaterialParameters, x: np.ndarray, name: str) -> float:
        column = parameters.names.index(name)
        return x[column] if column % 2 else x[column] * parameters.scale[column // 2]


@dataclass(frozen=True)
class Passivity:
    """Holland's condition as a wall: residual = most negative eigenvalue of the loss matrix / tolerance, 0 inside.

    The Jacobian takes the normalisation of the loss matrix as constant, which is enough for a wall.

    The loss matrix is −Im of the d-form matrix scaled to a unit diagonal of its real part; a violation of one
    tolerance costs as much as one standard deviation of the data.
    """

    tolerance: float = 1e-4
    name: str = "passivity"
    measured = False

    def residual(self, parameters: MaterialParameters, x: np.ndarray) -> np.ndarray:
        return np.array([min(0.0, value) / self.tolerance for value, _ in self._lowest(parameters, x)])

    def jacobian(self, parameters: MaterialParameters, x: np.ndarray) -> np.ndarray:
        rows = []
        for block, (value, vector) in enumerate(self._lowest(parameters, x)):
            row = np.zeros(x.size)
            if value < 0:
                slopes = parameters.free.directions @ parameters.slopes(x)
                for column in range(x.size):
                    row[column] = vector @ parameters.constants(x).loss_block(block, slopes[:, column]) @ vector
            rows.append(row / self.tolerance)
        return np.array(rows)

    @staticmethod
    def _lowest(parameters: MaterialParameters, x: np.ndarray) -> list[tuple[float, np.ndarray]]:
        constants = parameters.constants(x)
        result = []
        for block in range(constants.block_count):
            values, vectors = np.linalg.eigh(constants.loss_block(block))
            result.append((float(values[0]), vectors[:, 0]))
        return result


def rms_log_error(model: np.ndarray, data: np.ndarray) -> float:
    """Root mean square of |log Z_model − log Z_data| over a sweep (k,), dimensionless."""
    return float(np.sqrt(np.mean(np.abs(np.log(model / data)) ** 2)))


def weak_prior(parameters: MaterialParameters, start: np.ndarray, real: float = 0.5, tangent: float = 0.05) -> Prior:
    """What is believed of any ceramic before measuring: real parts within ±50 % of the start, tangents 0.02 ± 0.05.

    `start`: (n,) complex θ. It holds constants that the data do not determine, and is far too weak to move the others.
    """
    values = {}
    for name, value in zip(parameters.free.names, start, strict=True):
        values[name] = (float(value.real), real * abs(float(value.real)))
        values[f"tan_{name}"] = (0.02, tangent)
    return Prior(values, name="weak prior")
