"""How many modes lie below a frequency, by Sylvester's law of inertia: proof that none was missed.

The factors of K − ω²M have as many negative pivots as there are eigenvalues below ω², plus one for every potential
unknown (the dielectric block is negative definite).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from femu_piezo.errors import ConvergenceError
from femu_piezo.forward.eigen import Circuit
from femu_piezo.forward.linear_solver import factorize
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.material.constants import ElasticForm


def count_modes_below(
    model: ElectroelasticModel,
    constants: ElasticForm,
    frequency_Hz: float,
    circuit: Circuit,
    extra: Mapping[str, complex] | None = None,
) -> int:
    """Number of lossless modes below a frequency, rigid-body motions and modes that are not driven included.

    Parameters
    ----------
    constants : their real parts count
    circuit : "short" (poles) or "open" (zeros)

    Raises
    ------
    ConvergenceError : the frequency lies on an eigenvalue, or the solver at hand (SuperLU) reports no inertia
    """
    size = model.size - (circuit == "short")
    real = {name: complex(value).real for name, value in (extra or {}).items()}
    operator = model.stiffness(constants.lossless(), real) - (2 * np.pi * frequency_Hz) ** 2 * model.mass
    inertia = factorize(operator[:size, :size]).inertia
    if inertia is None:
        raise ConvergenceError("counting modes needs rslab, which reports the inertia of a factorisation")
    if inertia[2]:
        raise ConvergenceError(f"{frequency_Hz:.9g} Hz lies on an eigenvalue: count at a frequency beside it")
    return inertia[1] - int(np.count_nonzero(model.mass.diagonal()[:size] == 0.0))
