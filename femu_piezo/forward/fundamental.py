"""The fundamental pole and zero of a plate at given constants, with their exact e-form sensitivities.

Two interchangeable sources: the full model (sparse eigenpairs) and the reduced model (closed forms).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from femu_piezo.errors import ConvergenceError
from femu_piezo.forward.eigen import solve_eigen
from femu_piezo.forward.modal import ModalModel
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.material.constants import E_FORM, ElasticForm, PiezoConstants


@dataclass(frozen=True)
class PoleZeroPair:
    """Simulated pole and zero of one mode.

    Attributes
    ----------
    eigenvalues : (2,) complex λ_pole, λ_zero, rad²/s²
    sensitivities : (2, 10) complex ∂λ/∂(e-form constant)
    """

    eigenvalues: np.ndarray
    sensitivities: np.ndarray


#: (constants, expected frequency of the pole in Hz) → the pair near it
PairSource = Callable[[PiezoConstants, float], PoleZeroPair]


def full_source(model: ElectroelasticModel, count: int = 8) -> PairSource:
    """Pairs from sparse eigenpairs of the full model: the mode near the expected frequency that is driven most."""

    def pair(constants: PiezoConstants, near_Hz: float) -> PoleZeroPair:
        e_form = constants.to_e_form()
        values, slopes = [], []
        for circuit in ("short", "open"):
            modes = solve_eigen(model, e_form, circuit, count, near_Hz=0.97 * near_Hz)
            index = modes.dominant_index(near_Hz)
            values.append(modes.eigenvalues[index])
            slopes.append(modes.sensitivity(model, index, E_FORM))
        return PoleZeroPair(np.array(values), np.array(slopes))

    return pair


class HasModal(Protocol):
    """A reduced model."""

    def modal(self, constants: ElasticForm) -> ModalModel:
        """Closed forms at given e-form constants."""


def reduced_source(reduced: HasModal) -> PairSource:
    """Pairs from closed forms of a reduced model, in milliseconds each."""

    def pair(constants: PiezoConstants, near_Hz: float) -> PoleZeroPair:
        modal = reduced.modal(constants.to_e_form())
        pole = dominant_index(modal.eigenvalues, modal.charges, near_Hz)
        zero = dominant_index(modal.zeros[0], modal.zero_amplitudes, near_Hz)
        return PoleZeroPair(
            np.array([modal.eigenvalues[pole], modal.zeros[0][zero]]),
            np.array([modal.pole_sensitivity(pole)[:10], modal.zero_sensitivity(zero)[:10]]),
        )

    return pair


def dominant_index(eigenvalues: np.ndarray, amplitudes: np.ndarray, near_Hz: float) -> int:
    """Index of the eigenvalue with the largest |a²/λ| within a factor two of a frequency; λ and a (m,) complex."""
    frequency = np.sqrt(np.abs(eigenvalues.real)) / (2 * np.pi)
    weight = np.where((frequency > near_Hz / 2) & (frequency < near_Hz * 2), np.abs(amplitudes**2 / eigenvalues), 0.0)
    if not weight.max() > 0:
        raise ConvergenceError(f"the model has no driven mode within a factor two of {near_Hz:.6g} Hz")
    return int(np.argmax(weight))
