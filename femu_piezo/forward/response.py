"""Full-order driven response: one sparse complex solve per frequency.

With a charge on the hot electrode of the part, A(ω) x = −Q e_h, so that −(A^-1)_hh is its inverse capacitance
and

    Z = V/(jωQ) = −(A^-1)_hh / (jω)  for the part;   Y of the specimen = admittance_factor · Y of the part.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp

from femu_piezo.forward.linear_solver import Analysis
from femu_piezo.forward.model import POTENTIAL_SCALE, ElectroelasticModel
from femu_piezo.material.constants import ElasticForm


def driven_state(
    model: ElectroelasticModel, constants: ElasticForm, frequency_Hz: float, extra: Mapping[str, complex] | None = None
) -> np.ndarray:
    """(m,) complex unknowns for unit charge drawn from the hot electrode: the column −A^-1 e_h (scaled unknowns)."""
    return _driven(model, model.stiffness(constants, extra), frequency_Hz, model.analysis)


def _driven(model: ElectroelasticModel, stiffness: sp.spmatrix, frequency_Hz: float, analysis: Analysis) -> np.ndarray:
    load = np.zeros(model.size)
    load[-1] = -1.0
    return analysis.factorize(stiffness - (2 * np.pi * frequency_Hz) ** 2 * model.mass).solve(load)


def full_impedance(
    model: ElectroelasticModel,
    constants: ElasticForm,
    frequency_Hz: np.ndarray,
    extra: Mapping[str, complex] | None = None,
) -> np.ndarray:
    """Z of the specimen at frequencies (n,), by direct solves that share one symbolic analysis; (n,) complex ohm."""
    stiffness, analysis = model.stiffness(constants, extra), model.analysis
    inverse_capacitance = np.array([_driven(model, stiffness, f, analysis)[-1] for f in frequency_Hz])
    part = inverse_capacitance * POTENTIAL_SCALE**2 / (2j * np.pi * np.asarray(frequency_Hz))
    return part / model.domain.admittance_factor
