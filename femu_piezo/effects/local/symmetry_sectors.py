"""`Sectors`: the unknowns of a reduced plate in groups, so that each effect brings only the groups it needs.

The driven parity class alone serves every effect that keeps the mirror planes. A sector is named by the axes about
whose mirror plane its parity is flipped, "x" to "xyz" (`femu_piezo.forward.parity`); "slices" and "x slices" hold the
local response of the driven and of the x class to a yielding slice across the plate, "ramp" and "x ramp" theirs
to driven fields whose piezoelectric coupling varies along x, "x taper" that of the x class to driven fields whose
width varies along x, "z film" that of the z class to driven fields with a film on one electrode; "spot" has three
unknowns without field or inertia, the displacement of a body that is attached at a place. Vectors of further sectors
tie a potential to each displacement: they are modes at the reference constants, and enter at second order only. A taper
is orthonormal to the ramp of its class, slices are so to all, and an effect that asks for one asks for those before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from femu_piezo.effects.local.weighted_forms import WeightedProducts
from femu_piezo.forward.box_interpolation import interpolation
from femu_piezo.forward.gradient_products import FIELDS
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.parity import ParityClass, full_operators
from femu_piezo.forward.reduced_basis import new_directions
from femu_piezo.forward.reduction import ReducedModel
from femu_piezo.geometry.boxes import grid_lines, tensor_box
from femu_piezo.material.constants import ElasticForm, PiezoConstants
from femu_piezo.threads import in_parallel

DRIVEN, SLICES, RAMP, TAPER, FILM, SPOT = "driven", "slices", "ramp", "taper", "film", "spot"
#: Sectors of local responses.
_LOCAL = (RAMP, TAPER, FILM, SLICES)
#: Modes of the other classes are kept up to this multiple of the band's ω².
_BEYOND = 2.5
#: Local responses smaller than this share of the largest, outside what is known, are dropped.
_KEEP = 1e-3
#: Part of a mode at other constants below which a correction is dropped: its eigenvalue errs by the square.
_FOLLOWED = 1e-3
#: Frequency of the local responses, as a share of the band's ω².
_SHIFT = 0.3


def flipped_axes(sector: str) -> tuple[int, ...]:
    """Axes about whose mirror plane the parity is flipped: "xz" → (0, 2), "x slices" → (0,), "driven" → ()."""
    name = sector
    for ending in _LOCAL:
        name = name.removesuffix(ending).strip()
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


    def select(self, wanted: Sequence[str]) -> tuple[Sectors, np.ndarray]:
        """Some of the sectors, and the unknowns (indices) that they have, the electric ones among them."""
        keep, member = unknowns_of(self.names, self.member, wanted)
        moving = int(np.count_nonzero(keep < self.displacements))
        return Sectors(tuple(wanted), member, self.fields[:, :, keep], moving), keep


def unknowns_of(names: Sequence[str], member: np.ndarray, wanted: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """The unknowns (indices) of some of the sectors, in the order of `names`, and their sectors by number there.

    member : (r,) index of each unknown's sector among `names`
    """
    chosen = np.array([names.index(name) for name in wanted])
    keep = np.flatnonzero(np.isin(member, chosen))
    return keep, np.searchsorted(chosen, member[keep])


@dataclass(frozen=True)
class ClassBasis:
    """What of one parity class depends on no driven state.

    Attributes
    ----------
    modes : (4, n, k); none of the driven class
    respond : sets of loads (4n, j) → the response (4n, j) to each; None where no local responses are wanted
    """

    modes: np.ndarray = field(repr=False)
    respond: Callable[[list[np.ndarray]], list[np.ndarray]] | None = field(repr=False)


#: Flipped axes → what is known of that parity class.
Classes = dict[tuple[int, ...], ClassBasis]


def prepare_classes(
    weighted: WeightedProducts, wanted: Sequence[str], training: Sequence[PiezoConstants], band_Hz: float
) -> Classes:
    """Modes and factors of all classes that the wanted sectors name, at the first of the training constants, lossless.

    Modes of a class that a ramp or a taper drives in first order follow the other training constants too.
    """
    model, top = weighted.model, (2 * np.pi * band_Hz) ** 2
    constants, *others_trained = (one.lossless().to_e_form() for one in training)
    flips = list(dict.fromkeys(flipped_axes(name) for name in wanted if name != SPOT))
    local = {flipped_axes(name) for name in wanted if name.endswith(_LOCAL)}
    followed = {flipped_axes(name) for name in wanted if name.endswith((RAMP, TAPER))} - {()}
    others = _OtherClasses(weighted, constants, _BEYOND * top) if any(flips) else None
    operators = full_operators(model, constants) if local else ()

    def one(flipped: tuple[int, ...]) -> ClassBasis:
        modes = others.modes(flipped) if flipped else np.zeros((FIELDS, model.basis.N, 0))
        if flipped not in local:
            return ClassBasis(modes, None)
        own = ParityClass(model, *operators, flipped)
        factor = own.factor(_SHIFT * top)

        def respond(loads: list[np.ndarray]) -> list[np.ndarray]:
            return [own.prolongation @ factor.solve(own.prolongation.T @ load) for load in loads]

        if flipped in followed and others_trained:
            loads = _moved_mode_loads(weighted, modes, others_trained, top)
            if loads.shape[1]:
                modes = np.concatenate([modes, _outside(weighted, *respond([loads]), modes, least=_FOLLOWED)], axis=2)
        return ClassBasis(modes, respond)

    return dict(zip(flips, in_parallel(one, flips), strict=True))


def _moved_mode_loads(
    weighted: WeightedProducts, modes: np.ndarray, training: Sequence[ElasticForm], top: float
) -> np.ndarray:
    """(4n, k) what modes (4, n, j) of a class leave unbalanced at other constants, those in the band.

    K^-1 times it is the first correction of a mode: with it the eigenvalues err in fourth order of the change.
    """
    model, flat, found = weighted.model, modes.reshape(-1, modes.shape[2]), []
    units = model.products.applied(model.unit_tensors, modes).reshape(len(model.unit_tensors), *flat.shape)
    heavy = np.zeros_like(modes)
    heavy[:3] = [model.density * model.products.mass_times(one) for one in modes[:3]]
    heavy = heavy.reshape(flat.shape)
    for constants in training:
        image = np.tensordot(constants.vector().real, units, axes=1)
        values, vectors = np.linalg.eigh(flat.T @ image)
        inside = values < top
        found.append(image @ vectors[:, inside] - heavy @ vectors[:, inside] * values[inside])
    return np.hstack(found)


def build_sectors(
    weighted: WeightedProducts, reduced: ReducedModel, wanted: Sequence[str], constants: ElasticForm, classes: Classes
) -> Sectors:
    """The driven class of a reduced model and the further sectors that are wanted, at lossless constants.

    classes : as `prepare_classes` gives them
    """
    model = weighted.model
    driven = (model.prolongation @ reduced.basis).reshape(FIELDS, model.basis.N, -1)
    u = reduced.displacements
    states = driven @ _driven_states(reduced, constants, (2 * np.pi * reduced.band_Hz) ** 2)

    def local(flipped: tuple[int, ...]) -> list[tuple[str, np.ndarray]]:
        own = classes[flipped]
        if own.respond is None:
            return []
        known = own.modes if flipped else driven[:, :, :u]
        loads = _local_loads(weighted, constants, wanted, flipped, states)
        found = []
        for name, response in zip(loads, own.respond(list(loads.values())), strict=True):
            found.append((name, _outside(weighted, response, known)))
            known = np.concatenate([known, found[-1][1]], axis=2)
        return found

    parts = [(DRIVEN, driven[:, :, :u])]
    if SPOT in wanted:
        parts.append((SPOT, np.zeros((FIELDS, model.basis.N, 3))))
    for flipped, further in zip(classes, in_parallel(local, classes), strict=True):
        parts += [(_letters(flipped), classes[flipped].modes)] if flipped else []
        parts += further
    counts = [part.shape[2] for _, part in parts]
    member = np.concatenate([np.repeat(np.arange(len(parts)), counts), np.zeros(driven.shape[2] - u, dtype=int)])
    fields = np.concatenate([*(part for _, part in parts), driven[:, :, u:]], axis=2)
    return Sectors(tuple(name for name, _ in parts), member, fields, int(sum(counts)))


def _letters(flipped: tuple[int, ...]) -> str:
    return "".join("xyz"[axis] for axis in flipped)


def _local_loads(
    weighted: WeightedProducts, constants: ElasticForm, wanted: Sequence[str], flipped: tuple[int, ...], states
) -> dict[str, np.ndarray]:
    """Sector → loads (4n, k) on a class, of the local responses that are wanted, in the order of `_LOCAL`."""
    loads, (ramp, taper, film, slices) = {}, (f"{_letters(flipped)} {ending}".strip() for ending in _LOCAL)
    if ramp in wanted:
        loads[ramp] = _ramp_loads(weighted, constants, states, 0 in flipped)
    if taper in wanted:
        loads[taper] = _taper_loads(weighted, constants, states)
    if film in wanted:
        loads[film] = _film_loads(weighted, states)
    if slices in wanted:
        loads[slices] = _slice_loads(weighted, constants)
    return loads


class _OtherClasses:
    """Modes of the classes that the terminals do not drive, found on a box with half as many elements along each axis.

    They enter at second order of an effect; their error enters squared.
    """

    def __init__(self, weighted: WeightedProducts, constants: ElasticForm, top: float) -> None:
        fine, self._mass, self._top = weighted.model, weighted.mass, top
        lines = [np.linspace(line[0], line[-1], line.size // 2 + 1) for line in grid_lines(fine.domain.mesh)]
        self._rough = ElectroelasticModel(replace(fine.domain, mesh=tensor_box(lines)), fine.density)
        self._operators = full_operators(self._rough, constants)
        self._probe = interpolation(self._rough, fine.basis.doflocs)

    def modes(self, flipped: tuple[int, ...]) -> np.ndarray:
        """(4, n, k) modes with ω² below the top, uᵗMu = 1 on the fine mesh."""
        fields = ParityClass(self._rough, *self._operators, flipped).modes(self._top)
        fine = np.stack([self._probe @ part for part in np.split(fields, FIELDS)])
        u = fine[:3].reshape(self._mass.shape[0], -1)
        lower = np.linalg.cholesky(u.T @ (self._mass @ u))
        return np.linalg.solve(lower, fine.reshape(-1, u.shape[1]).T).T.reshape(fine.shape)


def _driven_states(reduced: ReducedModel, constants: ElasticForm, top: float) -> np.ndarray:
    """(r, k) plate under a volt, clamped and free to yield slowly; then the driven modes in the band."""
    modal = reduced.modal(ElasticForm.from_vector(constants.vector().real))
    clamped, modes = modal.states[:, :1], modal.states[:, 1:]
    yielding = clamped - modes @ (modal.charges / modal.eigenvalues)[:, None]
    return np.hstack([clamped, yielding, modes[:, modal.eigenvalues < _BEYOND * top]])


def _slice_loads(weighted: WeightedProducts, constants: ElasticForm) -> np.ndarray:
    """(4n, k) elastic forces of slices of elements under uniform S_xx, under uniform S_yy, and under u_y ∝ x y."""
    x, y, _ = weighted.model.basis.doflocs
    strained = np.zeros((FIELDS, x.size, 3))
    strained[0, :, 0], strained[1, :, 1], strained[1, :, 2] = x, y, x * y
    elastic = np.tensordot(constants.vector().real, weighted.model.unit_tensors, axes=1)
    elastic[3], elastic[:, :, 3] = 0.0, 0.0
    loads = np.hstack([products.applied([elastic], strained).reshape(-1, 3) for products in weighted.slices])
    return loads / np.linalg.norm(loads, axis=0)


def _ramp_loads(weighted: WeightedProducts, constants: ElasticForm, states: np.ndarray, odd: bool) -> np.ndarray:
    """(4n, k) forces and charges of the piezoelectric coupling with an odd or even weight on states (4, n, k)."""
    coupling = np.tensordot(constants.vector().real, weighted.model.unit_tensors, axes=1)
    coupling[:3, :, :3], coupling[3, :, 3] = 0.0, 0.0
    products = weighted.odd if odd else weighted.even
    loads = products.applied([coupling], states).reshape(-1, states.shape[2])
    return loads / np.linalg.norm(loads, axis=0)


def _taper_loads(weighted: WeightedProducts, constants: ElasticForm, states: np.ndarray) -> np.ndarray:
    """(4n, k) forces, charges and inertia of a width that varies, on states (4, n, k)."""
    first, whole = weighted.tapered[0], np.tensordot(constants.vector().real, weighted.model.unit_tensors, axes=1)
    flat = states.reshape(-1, states.shape[2])
    stiff = first.applied([whole], states).reshape(flat.shape)
    loads = np.hstack([stiff, (first.mass_matrix(weighted.model.density) @ flat)[:, 1:]])
    return loads / np.linalg.norm(loads, axis=0)


def _film_loads(weighted: WeightedProducts, states: np.ndarray) -> np.ndarray:
    """(4n, k) inertia of a film on the electrode of the part, on states (4, n, k) that move it."""
    loads = weighted.film @ states.reshape(-1, states.shape[2])
    norm = np.linalg.norm(loads, axis=0)
    return loads[:, norm > 0] / norm[norm > 0]


def _outside(
    weighted: WeightedProducts, responses: np.ndarray, known: np.ndarray, least: float | None = None
) -> np.ndarray:
    """Combinations (4, n, k) of responses (4n, j), their displacements orthonormal and new beside `known` (4, n, i).

    least : size below which a direction is dropped; a share of the largest response where None
    """
    weight = weighted.mass
    n = weight.shape[0]
    known = known.reshape(-1, known.shape[2])
    old = known[:n]
    outside = responses - known @ (old.T @ (weight @ responses[:n]))
    largest = np.sqrt(np.max(np.sum(outside[:n] * (weight @ outside[:n]), axis=0)))
    fresh = new_directions(old, outside[:n], _KEEP if least is None else least / largest, weight)
    # the potentials follow the same combinations
    mix = np.linalg.lstsq(fresh.T @ (weight @ outside[:n]), np.eye(fresh.shape[1]), rcond=1e-10)[0]
    return np.concatenate([fresh, outside[n:] @ mix]).reshape(FIELDS, n // 3, fresh.shape[1])
