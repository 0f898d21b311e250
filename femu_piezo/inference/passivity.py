"""Holland's condition (1967) as a wall: no constants of a fit may create energy.

The loss matrix is −Im of the d-form matrix scaled to a unit diagonal of its real part; its lowest eigenvalue must not
be negative. A violation of `TOLERANCE` costs as much as one standard deviation of the data.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.inference.coefficients import active_effects, d_form_constants
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.material.constants import PiezoConstants

TOLERANCE = 1e-5
#: Share of the tolerance below which a violation is rounding: a lossless constant stands at the wall.
_NOTICED = 1e-3


def passivity_wall(parameters: Unknowns, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (b,) = min(0, lowest eigenvalue)/TOLERANCE of every block of the loss matrix, and slopes (b, n_x).

    Of free and held constants at x (n_x,) without laws over frequency. The Jacobian takes the normalisation of the loss
    matrix as constant, which is enough for a wall.
    """
    plain = [item for item in active_effects(parameters, x) if not item.effect.dispersive]
    theta, tangents = (part[0] for part in d_form_constants(parameters, x, plain, np.ones(1)))
    constants = PiezoConstants.from_vector(theta)
    residual, slopes = np.zeros(constants.block_count), np.zeros((constants.block_count, x.size))
    for block in range(constants.block_count):
        values, vectors = np.linalg.eigh(constants.loss_block(block))
        if values[0] < -_NOTICED * TOLERANCE:
            residual[block], vector = values[0] / TOLERANCE, vectors[:, 0]
            for column in np.flatnonzero(np.any(tangents != 0, axis=0)):
                slope = constants.loss_block(block, tangents[:, column])
                slopes[block, column] = vector @ slope @ vector / TOLERANCE
    return residual, slopes
