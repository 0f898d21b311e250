"""Discretisation error of eigenvalues, estimated from a model with elements of one order less.

With h fixed, errors of eigenvalues fall with the order p: fast for waves, as p^-9.6 at edges and corners (measured,
`femu_piezo.geometry.shape.edge_error`). With ρ = ((p − 1)/p)^9.6, where the step from p − 1 to p changes λ by a
relative d, the remaining relative error is therefore at most

    ε = d ρ/(1 − ρ).

Where the field is singular at the rim of an electrode, errors fall as 2^-p in graded cells (`geometry.slab_mesh`), so
that ρ = 1/2 and ε = d. The same is taken where the poling is not along the field: the field is then singular also where
an electrode ends at the edge of a face, and λ alternates with p, by up to d about its limit (plates poled along their
length or tilted, tests/forward/test_mesh_error.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femu_piezo.forward.modal import ModalModel
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import driven_modal
from femu_piezo.geometry.shape import ALONG, EDGE_RATE
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.threads import in_parallel

#: Ratio ρ of errors where the field is singular from one order to the next.
_SINGULAR = 0.5
#: The change d of a mode is taken as at least this share of the largest change of the modes below it, because the
#: change of a single mode may vanish by chance.
_SHARED = 0.03
#: Coupling g²/(λ C) below which a mode counts as not driven: it has no influence on Z.
_DRIVEN = 1e-5
#: Modes are computed up to this multiple of the band, so that modes at its end are found at both orders.
_BEYOND = 1.05
#: Lowest order that is compared with the order below: linear elements are too stiff for an estimate.
LOWEST = 3


@dataclass(frozen=True)
class MeshError:
    """Estimated relative discretisation error of the driven eigenvalues.

    Attributes
    ----------
    frequency : (n,) of the driven modes, growing, Hz;  error : (n,) relative error of each eigenvalue
    """

    frequency: np.ndarray
    error: np.ndarray

    def at(self, frequency: np.ndarray) -> np.ndarray:
        """(k,) relative error of the mode nearest to each frequency (k,), Hz."""
        between = (self.frequency[1:] + self.frequency[:-1]) / 2
        return self.error[np.searchsorted(between, frequency)]


def mesh_error(model: ElectroelasticModel, constants: PiezoConstants, band_Hz: float) -> MeshError | None:
    """Discretisation error of a model at given constants, from the same mesh with elements of one order less.

    None where those elements would be linear, or where no mode of the band is driven.
    """
    if model.order < LOWEST:
        return None
    coarse = ElectroelasticModel(model.domain, model.density, order=model.order - 1)

    def squares(of_order: ElectroelasticModel) -> np.ndarray:
        return _driven_squares(driven_modal(of_order, constants, _BEYOND * band_Hz), _BEYOND * band_Hz)

    fine, rough = in_parallel(squares, (model, coarse))
    fine = fine[fine < (2 * np.pi * band_Hz) ** 2]
    if fine.size == 0 or rough.size == 0:
        return None
    nearest = np.abs(rough[:, None] / fine - 1).min(axis=0)
    least = _SHARED * np.maximum.accumulate(nearest)
    singular = model.domain.rim_error or model.domain.poling_along_field < 1 - ALONG
    ratio = _SINGULAR if singular else (1 - 1 / model.order) ** EDGE_RATE
    return MeshError(np.sqrt(fine) / (2 * np.pi), ratio / (1 - ratio) * np.maximum(nearest, least))


def _driven_squares(modal: ModalModel, band_Hz: float) -> np.ndarray:
    """(n,) ω² of the driven modes of a lossless body in a band, growing."""
    squares = modal.eigenvalues.real
    coupling = np.abs(modal.charges) ** 2 / np.abs(squares * modal.clamped_capacitance)
    return np.sort(squares[(squares > 0) & (squares < (2 * np.pi * band_Hz) ** 2) & (coupling > _DRIVEN)])
