"""Sensitivity of a sweep to each of the ten constants: the paper's figure 3 for any specimen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femu_piezo.forward.reduction import ReducedModel
from femu_piezo.material.constants import D_FORM, PiezoConstants


@dataclass(frozen=True)
class Sensitivity:
    """Relative sensitivity of Z over a sweep.

    Attributes
    ----------
    title : whose sweep
    frequency : (k,) Hz
    impedance : (k,) complex ohm
    values : (k, 10) complex ∂log Z/∂log θ for the d-form constants in the order of `D_FORM`
    """

    title: str
    frequency: np.ndarray
    impedance: np.ndarray
    values: np.ndarray

    def strongest(self) -> list[str]:
        """Names of the constants by their rms sensitivity, strongest first."""
        rms = np.sqrt(np.mean(np.abs(self.values) ** 2, axis=0))
        return [D_FORM[index] for index in np.argsort(-rms)]


def sensitivity(title: str, reduced: ReducedModel, constants: PiezoConstants, frequency_Hz: np.ndarray) -> Sensitivity:
    """∂log Z/∂log θ = −(θ/Y) Σ_q ∂Y/∂c_q ∂c_q/∂θ at given constants and frequencies (k,), Hz."""
    omega = 2 * np.pi * np.asarray(frequency_Hz)
    modal = reduced.modal(constants.to_e_form())
    admittance = modal.admittance(omega)
    slopes = modal.admittance_jacobian(omega)[:, :10] @ (constants.e_form_jacobian() * constants.vector())
    return Sensitivity(title, np.asarray(frequency_Hz), 1 / admittance, -slopes / admittance[:, None])
