"""Sensitivity of a sweep to each of the ten constants: the paper's figure 3 for any specimen."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from femu_piezo.material.constants import D_FORM


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
    frequency: np.ndarray = field(repr=False)
    impedance: np.ndarray = field(repr=False)
    values: np.ndarray = field(repr=False)

    def strongest(self) -> list[str]:
        """Names of the constants by their rms sensitivity, strongest first."""
        rms = np.sqrt(np.mean(np.abs(self.values) ** 2, axis=0))
        return [D_FORM[index] for index in np.argsort(-rms)]
