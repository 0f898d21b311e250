"""`Sectors`: the unknowns of a reduced plate in groups, so that each effect brings only the groups it needs.

The driven parity class alone serves every effect that keeps the mirror planes. A sector is named by the axes about
whose mirror plane its parity is flipped, "x" to "xyz" (`femu_piezo.forward.parity`); "slices" and "x slices" hold the
local response of the driven and of the x class to a yielding slice across the plate, "ramp" and "x ramp" theirs
to driven fields whose piezoelectric coupling varies along x; "spot" has three unknowns
without field or inertia, the displacement of a body that is attached at a place. Vectors of further sectors tie a
potential to each displacement: they are modes at the reference constants, and enter at second order only. Slices are
orthonormal to the ramps too, so an effect that asks for them asks for both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import skfem

from femu_piezo.diagnosis.box_interpolation import interpolation
from femu_piezo.forward.gradient_products import FIELDS, assemble_gradient_products
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.parity import ParityClass
from femu_piezo.forward.reduced_basis import new_directions
from femu_piezo.forward.reduction import ReducedModel
from femu_piezo.geometry.boxes import tensor_box
from femu_piezo.material.constants import ElasticForm

DRIVEN, SLICES, RAMP, SPOT = "driven", "slices", "ramp", "spot"
#: Modes of the other classes are kept up to this multiple of the band's ω².
_BEYOND = 2.5
#: Local responses smaller than this share of the largest, outside what is known, are dropped.
_KEEP = 1e-3
#: Frequency of the local responses, as a share of the band's ω².
_SHIFT = 0.3


def even(share: np.ndarray) -> np.ndarray:
    """Profile (2x/L)² − 1/3 of a constant along the length; its mean is zero."""
    return share**2 - 1 / 3


def odd(share: np.ndarray) -> np.ndarray:
    """Profile 2x/L of a constant along the length."""
    return share


#: Which of them couples the driven class to a class that is flipped about x (True) or not (False).
_PROFILES = {False: even, True: odd}


def flipped_axes(sector: str) -> tuple[int, ...]:
    """Axes about whose mirror plane the parity is flipped: "xz" → (0, 2), "x slices" → (0,), "driven" → ()."""
    name = sector.removesuffix(SLICES).removesuffix(RAMP).strip()
    return () if name in ("", DRIVEN, SPOT) else tuple("xyz".index(letter) for letter in name)


@dataclass(frozen=True)
class Sectors:
    """Fields of all reduced unknowns on the part: displacement unknowns, inner potentials, the hot potential.

    Attributes
    ----------
    names : of the sectors, "driven" first
    member : (r,) index of each unknown's sector
    fields : (4, n, r) displacement (m) and potential (V) at the degrees of freedom of the scalar basis
    displacements : number of displacement unknowns, in which uᵗMu = 1 (0 for those of a spot)
    """

    names: tuple[str, ...]
    member: np.ndarray = field(repr=False)
    fields: np.ndarray = field(repr=False)
    displacements: int

    @property
    def classes(self) -> dict[tuple[int, ...], np.ndarray]:
        """Flipped axes → the unknowns (indices) of that parity class."""
        axes = [flipped_axes(name) for name in self.names]
        groups = dict.fromkeys(axes)
        return {
            group: np.flatnonzero(np.isin(self.member, [i for i, own in enumerate(axes) if own == group]))
            for group in groups
        }


def build_sectors(
    model: ElectroelasticModel, reduced: ReducedModel, wanted: Sequence[str], constants: ElasticForm
) -> Sectors:
    """The driven class of a reduced model and the further sectors that are wanted, at lossless constants."""
    driven = (model.prolongation @ reduced.basis).reshape(FIELDS, model.basis.N, -1)
    u = reduced.displacements
    parts, names = [driven[:, :, :u]], [DRIVEN]
    top = (2 * np.pi * reduced.band_Hz) ** 2
    rough = _rougher(model) if any(flipped_axes(name) for name in wanted) else None
    static, states = _driven_states(reduced, constants, top)
    if SPOT in wanted:
        parts.append(np.zeros((FIELDS, model.basis.N, 3)))
        names.append(SPOT)
    for flipped in dict.fromkeys(flipped_axes(name) for name in wanted if name != SPOT):
        letters = "".join("xyz"[axis] for axis in flipped)
        known = driven[:, :, :u]
        if flipped:
            known = _class_modes(model, rough, constants, flipped, _BEYOND * top)
            parts.append(known)
            names.append(letters)
        loads, slices, ramp = {}, f"{letters} {SLICES}".strip(), f"{letters} {RAMP}".strip()
        if ramp in wanted:
            loads[ramp] = _ramp_loads(model, constants, driven @ states, _PROFILES[0 in flipped])
        if slices in wanted:
            loads[slices] = _slice_loads(model, constants, driven @ static)
        responses = _responses(model, constants, flipped, list(loads.values()), _SHIFT * top) if loads else []
        for name, response in zip(loads, responses, strict=True):
            parts.append(_outside(model, response, known))
            names.append(name)
            known = np.concatenate([known, parts[-1]], axis=2)
    counts = [part.shape[2] for part in parts]
    member = np.concatenate([np.repeat(np.arange(len(parts)), counts), np.zeros(driven.shape[2] - u, dtype=int)])
    fields = np.concatenate([*parts, driven[:, :, u:]], axis=2)
    return Sectors(tuple(names), member, fields, int(sum(counts)))


def _rougher(model: ElectroelasticModel) -> ElectroelasticModel:
    """The same box with half as many elements along each axis."""
    domain = model.domain
    counts = [np.unique(np.round(axis / np.ptp(axis), 9)).size - 1 for axis in domain.mesh.p]
    lines = [np.linspace(x.min(), x.max(), (n + 1) // 2 + 1) for x, n in zip(domain.mesh.p, counts, strict=True)]
    return ElectroelasticModel(replace(domain, mesh=tensor_box(lines)), model.density)


def _class_modes(
    model: ElectroelasticModel, rough: ElectroelasticModel, constants: ElasticForm, flipped: tuple[int, ...], top: float
) -> np.ndarray:
    """(4, n, k) modes of a class with ω² below `top`, found on a rougher mesh, uᵗMu = 1 on the fine one.

    They enter at second order of an effect; their error enters squared.
    """
    fields = ParityClass(rough, constants, flipped).modes(top).reshape(FIELDS, rough.basis.N, -1)
    probe = interpolation(rough, model.basis.doflocs)
    fine = np.concatenate([probe @ part for part in fields])
    n = 3 * model.basis.N
    gram = fine[:n].T @ (model.products.mass_matrix(model.density)[:n, :n] @ fine[:n])
    return np.linalg.solve(np.linalg.cholesky(gram), fine.T).T.reshape(FIELDS, model.basis.N, -1)


def _responses(
    model: ElectroelasticModel, constants: ElasticForm, flipped: tuple[int, ...], loads: list[np.ndarray], shift: float
) -> list[np.ndarray]:
    """(4n, k) response of a class to each set of loads (4n, k) at ω² = shift."""
    own = ParityClass(model, constants, flipped)
    factor = own.factor(shift)
    return [own.prolongation @ factor.solve(own.prolongation.T @ load) for load in loads]


def _driven_states(reduced: ReducedModel, constants: ElasticForm, top: float) -> tuple[np.ndarray, np.ndarray]:
    """(r,) plate under a constant volt; (r, k) clamped plate under a volt, then the driven modes in the band."""
    modal = reduced.modal(ElasticForm.from_vector(constants.vector().real))
    static = modal.states[:, 0] - modal.states[:, 1:] @ (modal.charges / modal.eigenvalues)
    return static, modal.states[:, np.append(True, modal.eigenvalues < _BEYOND * top)]


def _slice_loads(model: ElectroelasticModel, constants: ElasticForm, static: np.ndarray) -> np.ndarray:
    """(4n, k) elastic forces of single columns of elements under uniform strain S_xx and under a volt (4, n)."""
    uniform = np.zeros_like(static)
    uniform[0] = model.basis.doflocs[0]
    strained = np.column_stack([uniform.ravel(), static.ravel()])
    elastic = np.tensordot(constants.vector().real, model.unit_tensors, axes=1)
    elastic[3], elastic[:, :, 3] = 0.0, 0.0
    loads = []
    for slab in columns(model):
        part = skfem.Basis(model.domain.mesh, model.basis.elem, elements=slab, intorder=4)
        loads.append(assemble_gradient_products(part).stiffness(elastic) @ strained)
    loads = np.hstack(loads)
    return loads / np.linalg.norm(loads, axis=0)


def _ramp_loads(model: ElectroelasticModel, constants: ElasticForm, states: np.ndarray, profile) -> np.ndarray:
    """(4n, k) forces and charges of the piezoelectric coupling times profile(2x/L) on states (4, n, k)."""
    coupling = np.tensordot(constants.vector().real, model.unit_tensors, axes=1)
    coupling[:3, :, :3], coupling[3, :, 3] = 0.0, 0.0
    weight = profile(np.asarray(model.basis.global_coordinates())[0] / model.domain.mesh.p[0].max())
    loads = assemble_gradient_products(model.basis, weight).stiffness(coupling) @ states.reshape(-1, states.shape[2])
    return loads / np.linalg.norm(loads, axis=0)


def _outside(model: ElectroelasticModel, responses: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Combinations (4, n, k) of responses (4n, j), their displacements orthonormal and new beside `known` (4, n, i)."""
    n = 3 * model.basis.N
    old = known[:3].reshape(n, -1)
    weight = model.products.mass_matrix(model.density)[:n, :n]
    outside = responses[:n] - old @ (old.T @ (weight @ responses[:n]))
    fresh = new_directions(old, outside, _KEEP, weight)
    # the potentials follow the same combinations
    mix = np.linalg.lstsq(fresh.T @ (weight @ outside), np.eye(fresh.shape[1]), rcond=1e-10)[0]
    return np.concatenate([fresh, responses[n:] @ mix]).reshape(FIELDS, model.basis.N, -1)


def columns(model: ElectroelasticModel) -> list[np.ndarray]:
    """Element numbers of every slice of elements across the part, by growing x; for boxes of hexahedra."""
    centres = model.domain.mesh.p[0][model.domain.mesh.t].mean(axis=0)
    places = np.unique(np.round(centres / np.ptp(model.domain.mesh.p[0]), 9))
    which = np.argmin(np.abs(centres[:, None] / np.ptp(model.domain.mesh.p[0]) - places), axis=1)
    return [np.flatnonzero(which == i) for i in range(places.size)]
