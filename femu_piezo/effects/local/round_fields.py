"""`RoundFields`: the sectors of a disk or ring that is poled along its axis.

The driven fields are of Fourier order 0 (`femu_piezo.forward.revolution`). The further sectors are

- "z": modes of order 0 whose parity about the mid-plane is flipped, bending above all, and the local response of that
  class to a film that moves with driven fields;
- "film": the local response of the driven class to films that move with bending modes;
- "order 1", "order 2": modes of these orders with the driven parity;
- "wedge", "oval": the local response of these orders to driven fields in a deformed body
  (`femu_piezo.effects.local.round_deformations`);
- "rims": fields of order 1 by which driven fields near a rim may differ from one side to the other;
- "around": the modes of all other orders and parities, even about the half plane θ = 0, where an effect at a place is
  put.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from numpy.polynomial import legendre

from femu_piezo.effects.effect import ExtraTerm
from femu_piezo.effects.local.faces import RoundFace
from femu_piezo.effects.local.round_deformations import COUPLED, RoundDeformation
from femu_piezo.effects.local.sectors import (
    DRIVEN,
    FACES,
    MIDDLE,
    MODES_BEYOND,
    RESPONSE_SHIFT,
    SPOT,
    Fields,
    driven_states,
)
from femu_piezo.forward.electrodes import electrode_film
from femu_piezo.forward.gradient_products import FIELDS
from femu_piezo.forward.linear_solver import factorize
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import ReducedModel
from femu_piezo.forward.revolution import FourierOrder, Line, Section
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.threads import Once, in_parallel, made_once

BENDING, FILM, AROUND, RIMS = "z", "film", "around", "rims"
#: Order that deformations couple → sector of its modes with the driven parity.
ORDERS = {number: f"order {number}" for number in COUPLED.values()}
#: Sector of further fields that complete the modes of an order → the order.
JOINING = {**COUPLED, RIMS: 1}
#: Sectors that an effect at any place asks for.
AT_A_PLACE = (BENDING, *ORDERS.values(), AROUND)
#: Kinetic energy outside the known fields, over that of a whole response, below which a direction is left out.
_NEW = 1e-6
#: Share of the largest kinetic energy of known fields below which that of a field is rounding: driven unknowns may have
#: no part of order 0.
_ROUNDING = 1e-12
#: Most radial polynomials.
_SAMPLES = 28


@dataclass(frozen=True)
class _Modes:
    """Fields (4n, k) of one Fourier order and one parity."""

    order: int
    flipped: bool
    fields: np.ndarray = field(repr=False)


class RoundFields(Fields):
    """Fields of the sectors of a disk or ring, of the size that they have on an eighth of it.

    Parameters
    ----------
    model : of the eighth;  reduced : its driven class
    constants : those at which further sectors are made, without loss
    wanted : the sectors that effects may ask for

    Attributes
    ----------
    constants : the lossless reference in the e-form
    """

    def __init__(
        self, model: ElectroelasticModel, reduced: ReducedModel, constants: PiezoConstants, wanted: Iterable[str]
    ) -> None:
        self.model, self.reduced, self.reference = model, reduced, constants.lossless()
        self._top, self._once = (2 * np.pi * reduced.band_Hz) ** 2, Once()
        wanted = set(wanted)
        others = (FILM, BENDING, *(name for kind, m in COUPLED.items() for name in (ORDERS[m], kind)), RIMS, AROUND)
        self.names = (DRIVEN, SPOT, *(name for name in others if name in wanted))
        self.constants = self.reference.to_e_form()
        self._tensor = np.tensordot(self.constants.vector().real, model.unit_tensors, axes=1)

    @made_once
    def section(self) -> Section:
        """A section fine enough for shear waves and for bending waves, which are the shortest in thin bodies."""
        thickness = 2 * float(self.model.domain.mesh.p[2].max())
        shear, along = (float(np.sqrt(self._tensor[0, axis, 0, axis] / self.model.density)) for axis in (2, 0))
        omega = np.sqrt(MODES_BEYOND * self._top)
        bending = np.sqrt(omega * np.sqrt(12.0) / (thickness * along))
        return Section.fine_for(self.model.domain.radii, thickness, self.model.density, max(omega / shear, bending))

    def prepare(self, names: Iterable[str]) -> None:
        """Make the fields of some sectors; the parities of an order on several threads."""
        for name in names:
            self._modes(name)

    def needed_by(self, name: str) -> tuple[str, ...]:
        """For a sector that completes an order the modes of that order, for "rims" also responses of the same order."""
        if name not in JOINING:
            return ()
        order = JOINING[name]
        return (ORDERS[order], *(kind for kind, m in COUPLED.items() if name == RIMS and m == order))

    def count_of_further(self, name: str) -> int:
        """Number of displacement unknowns of a sector beyond the driven one."""
        return sum(one.fields.shape[1] for one in self._modes(name))

    def class_of(self, name: str) -> Hashable:
        """Flipped axes for order 0, else a name; "around" is one class, with zero blocks between its orders."""
        return {DRIVEN: (), FILM: (), BENDING: (2,)}.get(name, ORDERS.get(JOINING.get(name, 0), name))

    def projected(self, names: tuple[str, ...], tensors: Sequence[np.ndarray]) -> np.ndarray:
        """(n, k, k) forms of extended tensors on the sectors of one class."""
        if DRIVEN not in names:
            return self._by_order(names, len(tensors), lambda one, order: order.within(one.fields, tensors))
        whole = self._driven.reshape(FIELDS, self.model.basis.N, -1)
        found = self.model.products.within(whole, tensors)
        if FILM not in names:
            return found
        order, (film,) = self.order(0), self._modes(FILM)
        crossed, own = order.between(self.on_section, film.fields, tensors), order.within(film.fields, tensors)
        return self._with_film(found, crossed, own)

    def extra(self, names: tuple[str, ...], term: ExtraTerm, matrix: sp.spmatrix) -> np.ndarray:
        """(k, k) a further term on the sectors of one class; without `on_electrodes` it acts on driven fields only."""

        def between(order: FourierOrder, left: np.ndarray, right: np.ndarray) -> np.ndarray:
            if term.on_electrodes is None:
                return np.zeros((left.shape[1], right.shape[1]))
            return left.T @ (term.on_electrodes(order.electrode_faces) @ right)

        if DRIVEN not in names:
            return self._by_order(names, 1, lambda one, order: between(order, one.fields, one.fields)[None])[0]
        found = self._driven.T @ (matrix @ self._driven)
        if FILM not in names:
            return found
        order, (film,) = self.order(0), self._modes(FILM)
        crossed, own = (between(order, left, film.fields) for left in (self.on_section, film.fields))
        return self._with_film(found[None], crossed[None], own[None])[0]

    def _with_film(self, driven: np.ndarray, crossed: np.ndarray, own: np.ndarray) -> np.ndarray:
        """(n, k, k) in the order driven displacements, film responses, potentials, from blocks of driven and film."""
        u, more = self.reduced.displacements, own.shape[1]
        order = np.r_[np.arange(u), driven.shape[1] + np.arange(more), np.arange(u, driven.shape[1])]
        whole = np.block([[driven, crossed], [crossed.transpose(0, 2, 1), own]])
        return whole[:, order][:, :, order]

    def face(self, names: tuple[str, ...]) -> RoundFace:
        """Displacements on the face z = +t/2."""
        return self._level(names, -1)

    def levels(self, names: tuple[str, ...]) -> list[tuple[float, RoundFace]]:
        """Displacements on face and middle plane, with the shares of the thickness that they stand for."""
        return [(share, self._level(names, at)) for share, at in ((FACES, -1), (MIDDLE, 0))]

    def _level(self, names: tuple[str, ...], at: int) -> RoundFace:
        """Displacements on the nodes of number `at` along z, in the half z > 0."""
        parts, orders, flipped = [], [], []
        for name in names:
            for one in self._displacements(name):
                part = self._on_nodes(one.fields, at)
                parts.append(part)
                orders += [one.order] * part.shape[2]
                flipped += [one.flipped] * part.shape[2]
        order, bends = np.array(orders), np.array(flipped)
        radii, copies = self.model.domain.radii, self.model.domain.copies
        return RoundFace(radii, np.concatenate(parts, axis=2), order, 2 * order + bends, copies, bends)

    def film(self, left: tuple[str, ...], right: tuple[str, ...]) -> np.ndarray:
        """(k, l) ∫ v·u over one electrode between the unknowns of two sets of sectors of order 0."""
        film = electrode_film(self.order(0).electrode_faces)
        before, after = ([one.fields for name in names for one in self._displacements(name)] for names in (left, right))
        found = np.hstack(before).T @ (film @ np.hstack(after))
        added = [(0, sum(map(self.count_of_potentials, names))) for names in (left, right)]
        return np.pad(found, added)

    def _displacements(self, name: str) -> list[_Modes]:
        """Displacement unknowns of any sector."""
        if name == SPOT:
            return [_Modes(0, False, np.zeros((FIELDS * self.section.size, 3)))]
        if name == DRIVEN:
            return [_Modes(0, False, self.on_section[:, : self.reduced.displacements])]
        return self._modes(name)

    @made_once
    def _driven(self) -> np.ndarray:
        """(4n, r) driven unknowns on the mesh of the model."""
        return self.model.prolongation @ self.reduced.basis

    def of_order(self, number: int, names: tuple[str, ...]) -> np.ndarray:
        """(4n, k) modes and responses with the driven parity of those of some sectors that are of one order."""
        of_order = [name for name in names if name == ORDERS[number] or JOINING.get(name) == number]
        return np.hstack([one.fields for name in of_order for one in self._modes(name)])

    def deformation(self, kind: str) -> RoundDeformation:
        """Forms of the deformed body; kind : a key of `COUPLED`."""
        return self._once.get(("deformation", kind), lambda: RoundDeformation.of(kind, self.order))

    def _film_response(self, flipped: bool, moved: np.ndarray, known: np.ndarray) -> np.ndarray:
        """(4n, k) response of one class of order 0 to films that move with fields (4n, j) of the other class."""
        order = self.order(0)
        return self._response(order, flipped, electrode_film(order.electrode_faces) @ moved, known)

    def _deformed_response(self, kind: str) -> np.ndarray:
        """(4n, k) response of the order that a deformation couples to driven states in the deformed body."""
        states = self.on_section @ driven_states(self.reduced, self.constants, self._top)
        (known,) = self._modes(ORDERS[COUPLED[kind]])
        return self._response(
            self.order(known.order), False, self.deformation(kind).loads(states, self._tensor), known.fields
        )

    def _response(self, order: FourierOrder, flipped: bool, loads: np.ndarray, known: np.ndarray) -> np.ndarray:
        """(4n, k) response of a class to loads (4n, j), made new against `known` (4n, i) by `_new_beside`."""
        free, stiffness = order.free(flipped), order.stiffness(self._tensor)
        operator = free.T @ (stiffness - RESPONSE_SHIFT * self._top * order.mass) @ free
        found = free @ factorize(operator.tocsr()).solve(free.T @ loads)
        return self._new_beside(order, flipped, found, known)

    def _driven_across(self) -> np.ndarray:
        """(4n, k) driven displacements times (r/R)² cos θ, the part that order 1 does not have yet.

        With them the body may move near a rim like driven fields on one side, and not on the other.
        """
        order, n = self.order(JOINING[RIMS]), self.section.size
        r, axial = self.section.radial.places, self.section.axial.places.size
        outward = np.tile(np.repeat((r / r[-1]) ** 2, axial), FIELDS)[:, None]
        fields = self.on_section[:, : self.reduced.displacements] * outward
        fields[3 * n :] = 0.0
        known = [name for name in self.names if name in self.needed_by(RIMS)]
        known_fields = np.hstack([one.fields for name in known for one in self._modes(name)])
        return self._new_beside(order, False, fields, known_fields)

    def _new_beside(self, order: FourierOrder, flipped: bool, found: np.ndarray, known: np.ndarray) -> np.ndarray:
        """(4n, k) fields of a class: the displacements in `found` (4n, j), orthonormal and orthogonal to `known`.

        Their potential is that which they cause between short-circuited electrodes.
        """
        free, stiffness = order.free(flipped), order.stiffness(self._tensor)
        size = np.sqrt(np.einsum("ik,ik->k", found, order.mass @ found))
        found = found[:, size > 0] / size[size > 0]
        heavy = order.mass @ known
        for _ in range(2):
            found = found - known @ np.linalg.lstsq(heavy.T @ known, heavy.T @ found, rcond=_ROUNDING)[0]
        size, turned = np.linalg.eigh(found.T @ (order.mass @ found))
        keep = size > _NEW
        found = found @ (turned[:, keep] / np.sqrt(size[keep]))
        found[3 * self.section.size :] = 0.0
        inside = free[:, np.flatnonzero(np.diff(free[3 * self.section.size :].tocsc().indptr))]
        electrostatic = factorize((-inside.T @ stiffness @ inside).tocsr())
        return found + inside @ electrostatic.solve(inside.T @ (stiffness @ found))

    @made_once
    def on_section(self) -> np.ndarray:
        """(4n, r) the part of order 0 of the driven unknowns on the section: their mean over θ."""
        mesh, turn, here = self._polar_nodes
        cosine, sine = np.cos(turn.places), np.sin(turn.places)
        points, weights = turn.gauss
        mean = turn.shapes(points)[0].T @ weights / np.sum(weights)  # over the quarter turn
        fields = self._driven.reshape(FIELDS, self.model.basis.N, -1)[:, here]  # (4, r, z, θ, k)
        outward = np.einsum("rztk,t->rzk", fields[0], mean * cosine) + np.einsum("rztk,t->rzk", fields[1], mean * sine)
        round_parts = [outward, np.zeros_like(outward), *(np.einsum("rztk,t->rzk", fields[f], mean) for f in (2, 3))]
        to = mesh.to_nodes_of(self.section)
        return np.concatenate([to @ part.reshape(to.shape[1], -1) for part in round_parts])

    @made_once
    def _polar_nodes(self) -> tuple[Section, Line, np.ndarray]:
        """Elements over r and z and along θ of the eighth, and the number of the node at each place (r, z, θ)."""
        outer, order = self.model.domain.radii[1], self.model.order

        def polar(x: np.ndarray) -> list[np.ndarray]:
            return [np.round(axis, 9) for axis in (np.hypot(x[0], x[1]) / outer, np.arctan2(x[1], x[0]), x[2] / outer)]

        places = polar(self.model.basis.doflocs)
        number = np.lexsort((places[1], places[2], places[0])).reshape(*(np.unique(places[i]).size for i in (0, 2, 1)))
        ends = [np.unique(axis) for axis in polar(self.model.domain.mesh.p)]
        radial, turn, axial = (Line(axis * unit, order) for axis, unit in zip(ends, (outer, 1.0, outer), strict=True))
        return Section(radial, axial, self.model.density), turn, number

    def _on_nodes(self, fields: np.ndarray, at: int) -> np.ndarray:
        """(j, 3, k) Legendre coefficients along r of displacements in fields (4n, k), on the nodes `at` along z."""
        there = fields.reshape(FIELDS, self.section.radial.places.size, -1, fields.shape[1])[:3, :, at]
        return np.einsum("jr,frk->jfk", self._to_legendre, there)

    @made_once
    def _to_legendre(self) -> np.ndarray:
        """(j, n) from values on the n nodes of a radius to Legendre coefficients along r."""
        radial, (inner, outer) = self.section.radial, self.model.domain.radii
        nodes = legendre.leggauss(min(_SAMPLES, radial.places.size))[0]
        values = radial.shapes(inner + (nodes + 1) / 2 * (outer - inner))[0]
        return np.linalg.solve(legendre.legvander(nodes, nodes.size - 1), values.toarray())

    def order(self, number: int) -> FourierOrder:
        """Forms of one Fourier order on the section."""
        return self._once.get(("order", number), lambda: FourierOrder(self.section, number))

    def _modes(self, name: str) -> list[_Modes]:
        return self._once.get(("modes", name), lambda: self._new_modes(name))

    def _new_modes(self, name: str) -> list[_Modes]:
        if name == AROUND:
            return self._around()
        if name == RIMS:
            return [_Modes(JOINING[RIMS], False, self._driven_across())]
        if name in COUPLED:
            return [_Modes(COUPLED[name], False, self._deformed_response(name))]
        for number, sector in ORDERS.items():
            if name == sector:
                return [self._of_order(number, False)]
        (driven,) = self._displacements(DRIVEN)
        if name == FILM:
            (bending,) = self._modes(BENDING)
            return [_Modes(0, False, self._film_response(False, bending.fields, driven.fields))]
        bending = self._of_order(0, True).fields
        return [_Modes(0, True, np.hstack([bending, self._film_response(True, driven.fields, bending)]))]

    def _around(self) -> list[_Modes]:
        """Modes of the orders from 1 on, without those that have a sector of their own.

        The first order without modes of either parity ends them; order 1 always has some, the rigid shifts and tilts.
        """
        found, number = [], 1
        while some := [one for one in self._both_parities(number) if one.fields.shape[1]]:
            found += [one for one in some if one.flipped or number not in ORDERS]
            number += 1
        return found

    def _both_parities(self, number: int) -> list[_Modes]:
        return list(in_parallel(lambda flipped: self._of_order(number, flipped), [False, True]))

    def _of_order(self, number: int, flipped: bool) -> _Modes:
        def new() -> _Modes:
            return _Modes(number, flipped, self.order(number).modes(self._tensor, flipped, MODES_BEYOND * self._top))

        return self._once.get(("order", number, flipped), new)

    def _by_order(
        self, names: tuple[str, ...], forms: int, block: Callable[[_Modes, FourierOrder], np.ndarray]
    ) -> np.ndarray:
        """(forms, k, k) on the sectors of one class, from the blocks (forms, j, j) of each order and parity."""
        parts = [one for name in names for one in self._modes(name)]
        if len(names) > 1:  # modes and responses of one order
            parts = [_Modes(parts[0].order, parts[0].flipped, np.hstack([one.fields for one in parts]))]
        size, start = sum(one.fields.shape[1] for one in parts), 0
        found = np.zeros((forms, size, size))
        for one in parts:
            at = slice(start, start + one.fields.shape[1])
            found[:, at, at] = block(one, self.order(one.order))
            start = at.stop
        return found
