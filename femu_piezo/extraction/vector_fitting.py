"""All poles of a crowded sweep at once: vector fitting (Gustavsen, Semlyen, IEEE Trans. Power Deliv. 14 (1999) 1052).

With poles a_k held, σ(x) = 1 + Σ c̃_k/(a_k − x) and σ·charge = Σ c_k/(a_k − x) + B(x) are linear in c̃, c and the
background B. The zeros of σ, which are the eigenvalues of diag(a) + 1 c̃ᵗ, are better poles. Repeated from poles spread
over the sweep, this finds modes that overlap so closely that a search for one after another does not see them.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import chebyshev
from scipy.linalg import lstsq

from femu_piezo.extraction.fit import NormalisedSweep

STEPS = 12
DEGREE = 8  # of the background while poles move
REACH = 3.0  # in half-widths of the sweep: poles beyond are background
SHARPEST = 1e-7  # least half-width of a pole, in half-widths of the sweep


def relocated_poles(data: NormalisedSweep, count: int) -> np.ndarray:
    """(count,) poles in x, upper half plane, that follow the sweep; some of them soak up background or noise."""
    x, weight, charge = data.x, data.weight.astype(complex), data.charge
    row = (weight / charge)[:, None]
    fixed = row * chebyshev.chebvander(x, DEGREE)
    poles = np.interp(np.linspace(0, x.size - 1, count), np.arange(x.size), x) + 0.6j / count
    for _ in range(STEPS):
        atoms = 1 / (poles - x[:, None])
        columns = np.hstack([row * atoms, fixed, -weight[:, None] * atoms])
        size = np.linalg.norm(columns, axis=0)
        found = lstsq(columns / size, weight, cond=1e-13, lapack_driver="gelsy")[0] / size
        moved = np.linalg.eigvals(np.diag(poles) + found[-count:])
        poles = np.clip(moved.real, -REACH, REACH) + 1j * np.clip(np.abs(moved.imag), SHARPEST, REACH)
    return poles
