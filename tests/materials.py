"""PZT-5H in which every constant has a loss tangent of its own, so that a mix-up of two constants shows."""

from __future__ import annotations

import numpy as np

from femu_piezo.material.constants import PiezoConstants
from femu_piezo.material.library import library_material

PZT5H = library_material("pzt-5h").constants
#: Loss tangents of the ten constants in the order of D_FORM, with which no field creates energy.
TANGENTS = np.array([15, 13, 12, 16, 20, 13, 12, 14, 18, 17]) * 1e-3
LOSSY = PiezoConstants.from_vector(PZT5H.vector() * (1 - 1j * TANGENTS))
#: Others, for tests of the forward model.
FORWARD_TANGENTS = np.array([14, 12, 13, 15, 20, 16, 17, 18, 19, 20]) * 1e-3
FORWARD_LOSSY = PiezoConstants.from_vector(PZT5H.vector() * (1 - 1j * FORWARD_TANGENTS))
