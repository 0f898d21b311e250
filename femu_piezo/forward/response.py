"""Full-order driven response: one sparse complex solve per frequency.

With a charge on the hot electrode of the part, A(ω) x = −Q e_h, so that −(A^-1)_hh is its inverse capacitance
and

    Z = V/(jωQ) = −(A^-1)_hh / (jω)  for the part;   Y of the specimen = admittance_factor · Y of the part.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from femu_piezo.forward.linear_solver import factorize
from femu_piezo.forward.model import POTENTIAL_SCALE, ElectroelasticModel
from femu_piezo.material.constants import ElasticForm


def driven_state(
    model: ElectroelasticModel,
    constants: ElasticForm,
    frequency_Hz: float,
    extra: Mapping[str, complex] | None = None,
) -> np.ndarray:
    """(m,) complex unknowns for unit charge drawn from the hot electrode: the column −A^-1 e_h (scaled unknowns)."""
    omega = 2 * np.pi * frequency_Hz
    matrix = model.stiffness(constants, extra) - omega**2 * model.mass
    load = np.zeros(model.size)
    load[-1] = -1.0
    return factorize(matrix).solve(load)


def full_impedance(
    model: ElectroelasticModel,
    constants: ElasticForm,
    frequency_Hz: np.ndarray,
    extra: Mapping[str, complex] | None = None,
) -> np.ndarray:
    """Z of the specimen at each frequency by direct solves, (n,) complex ohm."""
    result = np.empty(len(frequency_Hz), dtype=complex)
    for index, frequency in enumerate(frequency_Hz):
        state = driven_state(model, constants, frequency, extra)
        part = state[-1] * POTENTIAL_SCALE**2 / (2j * np.pi * frequency)
        result[index] = part / model.domain.admittance_factor
    return result
