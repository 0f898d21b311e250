"""Discretisation error of eigenvalues and capacitance, estimated from a model with elements of one order less.

With h fixed, errors of eigenvalues fall with the order p: fast for waves, as p^-9.6 at edges and corners (measured,
`femu_piezo.geometry.shape.edge_error`). With ρ = ((p − 1)/p)^9.6, where the step from p − 1 to p changes λ by a
relative d, the remaining relative error is therefore at most

    ε = d ρ/(1 − ρ),

and likewise that of the static capacitance.

Where the field is singular at the rim of an electrode, errors fall as 2^-p in graded cells (`geometry.slab_mesh`), so
that ρ = 1/2 and ε = d. The same is taken where the poling is not along the field: the field is then singular also where
an electrode ends at the edge of a face, and λ alternates with p, by up to d about its limit (plates poled along their
length or tilted, tests/forward/test_mesh_error.py). The static capacitance is an energy of that field, whose potential
grows as √r from the rim: its error falls as p^-2 in given cells, so that ρ = ((p − 1)/p)².
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
#: Rate at which the error of the capacitance falls with the order there.
_SINGULAR_RATE = 2.0
#: The change d of a mode is taken as at least this share of the largest change of the modes below it, because the
#: change of a single mode may vanish by chance.
_SHARED = 0.03
#: Coupling g²/(λ C) below which a mode counts as not driven: it has no influence on Z.
_DRIVEN = 1e-5
#: Width of a resonance over its frequency, within which a mode counts as at it.
_WIDTH = 0.01
#: Modes are computed up to this multiple of the band, so that modes at its end are found at both orders.
_BEYOND = 1.05
#: Lowest order that is compared with the order below: linear elements are too stiff for an estimate.
LOWEST = 3


@dataclass(frozen=True)
class MeshError:
    """Estimated discretisation error of a lossless body.

    Attributes
    ----------
    frequency : (n,) of the driven modes, growing, Hz;  error : (n,) relative error ε of each eigenvalue λ
    charge : (n,) g² of each mode in C = C∞ + Σ g²/(λ − ω²)
    capacitance : error of the static capacitance of the whole body, F
    """

    frequency: np.ndarray
    error: np.ndarray
    charge: np.ndarray
    capacitance: float

    def at(self, frequency: np.ndarray) -> np.ndarray:
        """(k,) relative error of all eigenvalues alike that changes Z at frequencies (k,), Hz, as those of the modes.

        An error ε changes C by −ε g² λ/(λ − ω²)², so each mode counts by the size of that: a weak mode, as one of
        bending beside one of extension, counts near itself alone.
        """
        squares, away = self.frequency**2, self.frequency**2 - frequency[:, None] ** 2
        counts = self.charge * squares / (away**2 + (_WIDTH * squares) ** 2)
        return counts @ self.error / np.sum(counts, axis=1)


def mesh_error(model: ElectroelasticModel, constants: PiezoConstants, band_Hz: float) -> MeshError | None:
    """Discretisation error of a model at given constants, from the same mesh with elements of one order less.

    None where those elements would be linear, or where no mode of the band is driven.
    """
    if model.order < LOWEST:
        return None
    coarse = ElectroelasticModel(model.domain, model.density, order=model.order - 1)

    def solved(of_order: ElectroelasticModel) -> tuple[np.ndarray, np.ndarray, float]:
        modal = driven_modal(of_order, constants, _BEYOND * band_Hz)
        whole = model.domain.admittance_factor * _static_capacitance(modal)
        return *_driven_squares(modal, _BEYOND * band_Hz), whole

    (fine, charge, capacitance), (rough, _, rough_capacitance) = in_parallel(solved, (model, coarse))
    inside = fine < (2 * np.pi * band_Hz) ** 2
    fine, charge = fine[inside], charge[inside]
    if fine.size == 0 or rough.size == 0:
        return None
    nearest = np.abs(rough[:, None] / fine - 1).min(axis=0)
    least = _SHARED * np.maximum.accumulate(nearest)
    singular = model.domain.rim_error or model.domain.poling_along_field < 1 - ALONG
    fall = 1 - 1 / model.order
    ratio, ratio_of_capacitance = (_SINGULAR, fall**_SINGULAR_RATE) if singular else [fall**EDGE_RATE] * 2
    return MeshError(
        frequency=np.sqrt(fine) / (2 * np.pi),
        error=ratio / (1 - ratio) * np.maximum(nearest, least),
        charge=charge,
        capacitance=ratio_of_capacitance / (1 - ratio_of_capacitance) * abs(capacitance - rough_capacitance),
    )


def _static_capacitance(modal: ModalModel) -> float:
    """C∞ + Σ g²/λ of the computed part of a lossless body, F."""
    return float((modal.clamped_capacitance + np.sum(modal.charges**2 / modal.eigenvalues)).real)


def _driven_squares(modal: ModalModel, band_Hz: float) -> tuple[np.ndarray, np.ndarray]:
    """(n,) ω² of the driven modes of a lossless body in a band, growing, and their g² (n,)."""
    squares, charge = modal.eigenvalues.real, np.abs(modal.charges) ** 2
    coupling = charge / np.abs(squares * modal.clamped_capacitance)
    found = np.flatnonzero((squares > 0) & (squares < (2 * np.pi * band_Hz) ** 2) & (coupling > _DRIVEN))
    found = found[np.argsort(squares[found])]
    return squares[found], charge[found]
