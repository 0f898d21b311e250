"""The error that the elements leave, measured by a step of their order.

With h fixed, errors of eigenvalues fall with the order p: fast for waves, as p^-9.6 at edges and corners (measured,
`femu_piezo.geometry.shape.edge_error`). With ρ = ((p − 1)/p)^9.6 a step from p − 1 to p that changes λ by a
relative d therefore leaves no more than

    ε = d ρ/(1 − ρ).

Where the field is singular at the rim of an electrode, errors fall as 2^-p in graded cells (`geometry.slab_mesh`), so
that ε = d.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femu_piezo.forward.modal import ModalModel
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import driven_modal
from femu_piezo.geometry.shape import EDGE_RATE
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.threads import in_parallel

#: Ratio of errors at electrode rims from one order to the next.
_AT_RIMS = 0.5
#: Share of the largest step of the modes below that each mode has at least: single steps may vanish by chance.
_SHARED = 0.03
#: Coupling g²/(λ C) below which a mode is not driven, so that it says nothing of Z.
_DRIVEN = 1e-5
#: How far beyond the band modes are computed, so that those at its end are found at both orders.
_BEYOND = 1.05
#: Lowest order that is compared with the one below: linear elements are too stiff to say anything.
LOWEST = 3


@dataclass(frozen=True)
class MeshError:
    """Relative error of the driven eigenvalues.

    Attributes
    ----------
    frequency : (n,) of the modes, growing, Hz;  error : (n,) of each of them
    """

    frequency: np.ndarray
    error: np.ndarray

    def at(self, frequency: np.ndarray) -> np.ndarray:
        """(k,) that of the mode nearest to each frequency, Hz."""
        between = (self.frequency[1:] + self.frequency[:-1]) / 2
        return self.error[np.searchsorted(between, frequency)]


def mesh_error(model: ElectroelasticModel, constants: PiezoConstants, band_Hz: float) -> MeshError | None:
    """The error of a model's mesh at given constants, by the same mesh with elements of one order less.

    None where these are linear, or where no mode of the band is driven.
    """
    if model.order < LOWEST:
        return None
    coarse = ElectroelasticModel(model.domain, model.density, order=model.order - 1)

    def squares(one: ElectroelasticModel) -> np.ndarray:
        return _driven_squares(driven_modal(one, constants, _BEYOND * band_Hz), _BEYOND * band_Hz)

    fine, rough = in_parallel(squares, (model, coarse))
    fine = fine[fine < (2 * np.pi * band_Hz) ** 2]
    if fine.size == 0 or rough.size == 0:
        return None
    nearest = np.abs(rough[:, None] / fine - 1).min(axis=0)
    by_others = _SHARED * np.maximum.accumulate(nearest)
    ratio = _AT_RIMS if model.domain.rim_error else (1 - 1 / model.order) ** EDGE_RATE
    return MeshError(np.sqrt(fine) / (2 * np.pi), ratio / (1 - ratio) * np.maximum(nearest, by_others))


def _driven_squares(modal: ModalModel, band_Hz: float) -> np.ndarray:
    """(n,) ω² of the driven modes of a lossless body in a band, growing."""
    squares = modal.eigenvalues.real
    coupling = np.abs(modal.charges) ** 2 / np.abs(squares * modal.clamped_capacitance)
    return np.sort(squares[(squares > 0) & (squares < (2 * np.pi * band_Hz) ** 2) & (coupling > _DRIVEN)])
