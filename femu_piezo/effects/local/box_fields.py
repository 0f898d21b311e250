"""`BoxFields`: the sectors of a plate with three mirror planes.

A sector is named by the axes about whose mirror plane its parity is flipped, "x" to "xyz"
(`femu_piezo.forward.parity`); "slices" and "x slices" hold the local response of the driven and of the x class to a
yielding slice across the plate, "ramp" and "x ramp" theirs to driven fields whose piezoelectric coupling varies along
x, "x taper" that of the x class to driven fields whose width varies along x, "z film" that of the z class to driven
fields with a film on one electrode. The local responses of a class are orthonormal to its modes and to those before
them in the order ramp, taper, film, slices.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from femu_piezo.effects.effect import ExtraTerm
from femu_piezo.effects.local.faces import BoxFace, on_face
from femu_piezo.effects.local.sectors import DRIVEN, MODES_BEYOND, SPOT, Fields, driven_states
from femu_piezo.effects.local.weighted_forms import WeightedProducts
from femu_piezo.forward.box_interpolation import interpolation
from femu_piezo.forward.gradient_products import FIELDS
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.parity import ParityClass
from femu_piezo.forward.reduced_basis import new_directions
from femu_piezo.forward.reduction import ReducedModel
from femu_piezo.geometry.boxes import grid_lines, tensor_box
from femu_piezo.material.constants import ElasticForm, PiezoConstants
from femu_piezo.threads import Once, in_parallel

SLICES, RAMP, TAPER, FILM = "slices", "ramp", "taper", "film"
#: Sectors of local responses, in the order in which they are made.
_LOCAL = (RAMP, TAPER, FILM, SLICES)
#: Local responses smaller than this share of the largest, outside what is known, are dropped.
_KEEP = 1e-3
#: Part of a mode at other constants below which a correction is dropped: its eigenvalue errs by the square.
_FOLLOWED = 1e-3
#: Frequency of the local responses, as a share of the band's ω².
_SHIFT = 0.3

#: Axes about whose mirror plane the parity of a class is flipped.
Flipped = tuple[int, ...]


def flipped_axes(sector: str) -> Flipped:
    """Axes about whose mirror plane the parity is flipped: "xz" → (0, 2), "x slices" → (0,), "driven" → ()."""
    name = sector
    for ending in _LOCAL:
        name = name.removesuffix(ending).strip()
    return () if name in ("", DRIVEN, SPOT) else tuple("xyz".index(letter) for letter in name)


def _letters(flipped: Flipped) -> str:
    return "".join("xyz"[axis] for axis in flipped)


class BoxFields(Fields):
    """Of the part of a plate that its mirror planes cut.

    Parameters
    ----------
    weighted : of the part of a plate;  reduced : its driven class
    training : constants; modes and responses belong to the first of them, lossless, and modes of a class that a ramp or
        a taper drives in first order follow the others too
    wanted : the sectors that effects may ask for

    Attributes
    ----------
    constants : the lossless reference in the e-form
    """

    def __init__(
        self,
        weighted: WeightedProducts,
        reduced: ReducedModel,
        training: Sequence[PiezoConstants],
        wanted: Iterable[str],
    ) -> None:
        self.weighted, self.model, self.reduced = weighted, weighted.model, reduced
        self.reference = training[0].lossless()
        self.constants, *self._others_trained = (one.lossless().to_e_form() for one in training)
        self._top = (2 * np.pi * reduced.band_Hz) ** 2
        self._once = Once()
        wanted = set(wanted) - {DRIVEN, SPOT}
        classes = sorted({flipped_axes(name) for name in wanted}, key=lambda flipped: (len(flipped), flipped))
        self._local = {
            flipped: [name for name in (f"{_letters(flipped)} {one}".strip() for one in _LOCAL) if name in wanted]
            for flipped in classes
        }
        further = [[_letters(flipped)] * bool(flipped) + local for flipped, local in self._local.items()]
        self.names = (DRIVEN, SPOT, *(name for own in further for name in own))

    def prepare(self, names: Iterable[str]) -> None:
        """All sectors of a class at once, and classes on several threads."""
        tuple(in_parallel(self._class, {flipped_axes(name) for name in names}))

    def further(self, name: str) -> int:
        """Number of unknowns of a sector beyond the driven one."""
        return self.of(name).shape[2]

    def class_of(self, name: str) -> Flipped:
        """The axes about whose mirror planes the parity is flipped."""
        return flipped_axes(name)

    def fields(self, names: Iterable[str]) -> np.ndarray:
        """(4, n, k) of the unknowns of some sectors in their order, potentials with the driven one."""
        names = tuple(names)
        parts = [self.of(name) for name in self.names if name in names]
        return np.concatenate([*parts, self._potentials] if DRIVEN in names else parts, axis=2)

    def projected(self, names: tuple[str, ...], tensors: Sequence[np.ndarray]) -> np.ndarray:
        """(n, k, k) forms of extended tensors on the sectors of one class."""
        return self.model.products.within(self.fields(names), tensors)

    def extra(self, names: tuple[str, ...], term: ExtraTerm, matrix: sp.spmatrix) -> np.ndarray:
        """(k, k) a further term on the sectors of one class."""
        fields = self.fields(names)
        flat = fields.reshape(-1, fields.shape[2])
        return flat.T @ (matrix @ flat)

    def film(self, left: tuple[str, ...], right: tuple[str, ...]) -> np.ndarray:
        """(k, l) ∫ v·u over the electrode of the part between the unknowns of sectors."""
        before, after = (self.fields(names) for names in (left, right))
        return before.reshape(-1, before.shape[2]).T @ (self.weighted.film @ after.reshape(-1, after.shape[2]))

    def face(self, names: tuple[str, ...]) -> BoxFace:
        """Displacements on the face z = +t/2 of the part."""
        parts = [self._once.get(("face", name), lambda name=name: on_face(self.model, self.of(name))) for name in names]
        classes = [flipped_axes(name) for name in names]
        group = np.repeat([classes.index(one) for one in classes], [part.shape[3] for part in parts])
        ends = self.model.domain.mesh.p.max(axis=1)
        return BoxFace((float(ends[0]), float(ends[1])), np.concatenate(parts, axis=3), group, self.model.domain.copies)

    def of(self, name: str) -> np.ndarray:
        """(4, n, k) displacement (m) and potential (V) of a sector's unknowns; of "driven" the displacements alone."""
        if name == DRIVEN:
            return self._driven[:, :, : self.reduced.displacements]
        if name == SPOT:
            return np.zeros((FIELDS, self.weighted.model.basis.N, 3))
        return self._class(flipped_axes(name))[name]

    @property
    def _potentials(self) -> np.ndarray:
        """(4, n, k) of the inner potentials, and of the hot potential last."""
        return self._driven[:, :, self.reduced.displacements :]

    @cached_property
    def _driven(self) -> np.ndarray:
        model = self.weighted.model
        return (model.prolongation @ self.reduced.basis).reshape(FIELDS, model.basis.N, -1)

    @cached_property
    def _states(self) -> np.ndarray:
        """(4, n, k) driven states that local responses are made for."""
        return self._driven @ driven_states(self.reduced, self.constants, self._top)

    def _class(self, flipped: Flipped) -> dict[str, np.ndarray]:
        """Sector → its fields (4, n, k), of a parity class: modes, but for the driven one, and local responses."""
        return self._once.get(flipped, lambda: self._new_class(flipped))

    def _new_class(self, flipped: Flipped) -> dict[str, np.ndarray]:
        """All sectors of a class at once: its factor, which is large, is not kept."""
        weighted, local, known = self.weighted, self._local[flipped], self.of(DRIVEN) if not flipped else None
        if flipped:
            others = self._once.get("others", lambda: _OtherClasses(weighted, self.constants, MODES_BEYOND * self._top))
            known = others.modes(flipped)
        if not local:
            return {_letters(flipped): known}
        own = ParityClass(weighted.model, self.constants, flipped)
        factor = own.factor(_SHIFT * self._top)

        def respond(loads: np.ndarray) -> np.ndarray:
            return own.prolongation @ factor.solve(own.prolongation.T @ loads)

        if flipped and self._others_trained and any(name.endswith((RAMP, TAPER)) for name in local):
            loads = _moved_mode_loads(weighted, known, self._others_trained, self._top)
            if loads.shape[1]:
                known = np.concatenate([known, _outside(weighted, respond(loads), known, least=_FOLLOWED)], axis=2)
        found = {_letters(flipped): known} if flipped else {}
        for name in local:
            loads = _loads(name.split()[-1], weighted, self.constants, flipped, self._states)
            found[name] = _outside(weighted, respond(loads), known)
            known = np.concatenate([known, found[name]], axis=2)
        return found


def _loads(
    kind: str, weighted: WeightedProducts, constants: ElasticForm, flipped: Flipped, states: np.ndarray
) -> np.ndarray:
    """(4n, k) loads on a class, of one kind of local responses to driven states (4, n, j)."""
    if kind == RAMP:
        return _ramp_loads(weighted, constants, states, 0 in flipped)
    if kind == TAPER:
        return _taper_loads(weighted, constants, states)
    return _film_loads(weighted, states) if kind == FILM else _slice_loads(weighted, constants)


def _moved_mode_loads(
    weighted: WeightedProducts, modes: np.ndarray, training: Sequence[ElasticForm], top: float
) -> np.ndarray:
    """(4n, k) what modes (4, n, j) of a class leave unbalanced at other constants, those in the band.

    K^-1 times it is the first correction of a mode: with it the eigenvalues err in fourth order of the change.
    """
    model, flat, found = weighted.model, modes.reshape(-1, modes.shape[2]), []
    units = model.products.applied(model.unit_tensors, modes).reshape(len(model.unit_tensors), *flat.shape)
    heavy = np.zeros_like(flat)
    heavy[: weighted.mass.shape[0]] = weighted.mass @ flat[: weighted.mass.shape[0]]
    for constants in training:
        image = np.tensordot(constants.vector().real, units, axes=1)
        values, vectors = np.linalg.eigh(flat.T @ image)
        inside = values < top
        found.append(image @ vectors[:, inside] - heavy @ vectors[:, inside] * values[inside])
    return np.hstack(found)


class _OtherClasses:
    """Modes of the classes that the terminals do not drive, found on a box with half as many elements along each axis.

    They enter at second order of an effect; their error enters squared.
    """

    def __init__(self, weighted: WeightedProducts, constants: ElasticForm, top: float) -> None:
        fine, self._mass, self._top = weighted.model, weighted.mass, top
        lines = [np.linspace(line[0], line[-1], line.size // 2 + 1) for line in grid_lines(fine.domain.mesh)]
        self._rough = ElectroelasticModel(replace(fine.domain, mesh=tensor_box(lines)), fine.density)
        self._constants = constants
        self._probe = interpolation(self._rough, fine.basis.doflocs)

    def modes(self, flipped: tuple[int, ...]) -> np.ndarray:
        """(4, n, k) modes with ω² below the top, uᵗMu = 1 on the fine mesh."""
        fields = ParityClass(self._rough, self._constants, flipped).modes(self._top)
        fine = np.stack([self._probe @ part for part in np.split(fields, FIELDS)])
        u = fine[:3].reshape(self._mass.shape[0], -1)
        lower = np.linalg.cholesky(u.T @ (self._mass @ u))
        return np.linalg.solve(lower, fine.reshape(-1, u.shape[1]).T).T.reshape(fine.shape)


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
    stiff, heavy = first.applied([whole], states).reshape(flat.shape), np.zeros_like(states)
    heavy[:3] = weighted.tapered_mass(states[:3])
    loads = np.hstack([stiff, heavy.reshape(flat.shape)[:, 1:]])
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
