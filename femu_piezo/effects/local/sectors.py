"""`Sectors`: the unknowns of a reduced body in groups, so that each effect brings only the groups it needs.

The driven class alone serves every effect that keeps the symmetry of the body; a further sector holds modes of other
classes, or the local response of a class to what an effect does. No operator of the body itself couples two classes.
A vector of a further sector is a displacement together with its potential at the reference constants; it changes Z in
second order only. Where a local response is a field rather than a movement, its sector has potentials by themselves
too. "spot" has three unknowns without field or inertia, the displacement of a body that is attached at a place.
`Fields` says which sectors a kind of body has; plates: `box_fields`, disks and rings: `round_fields`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from femu_piezo.effects.effect import ExtraTerm
from femu_piezo.effects.local.faces import Face
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import ReducedModel
from femu_piezo.material.constants import ElasticForm, PiezoConstants
from femu_piezo.threads import made_once

DRIVEN, SPOT = "driven", "spot"
#: Modes of classes that the terminals do not drive are kept up to this multiple of the band's ω².
MODES_BEYOND = 2.5
#: ω² of the responses to loads at a place, as a share of the band's.
RESPONSE_SHIFT = 0.3
#: Shares of the thickness that both faces together and the middle plane stand for, by Simpson's rule.
FACES, MIDDLE = 1 / 3, 2 / 3


class Fields(ABC):
    """Fields of every sector of one body, each made when it is first asked for.

    Attributes
    ----------
    names : of all sectors in the order of their unknowns, "driven" first
    model : the full model of the part;  reduced : its driven class, reduced
    reference : lossless constants at which the further sectors are made
    """

    names: tuple[str, ...]
    model: ElectroelasticModel
    reduced: ReducedModel
    reference: PiezoConstants

    def count_of_potentials(self, name: str) -> int:
        """Number of potential unknowns of a sector; of the driven one the inner potentials and the hot one."""
        return self.reduced.size - self.reduced.displacements if name == DRIVEN else 0

    def chosen(self, wanted: Iterable[str]) -> tuple[str, ...]:
        """Names of the driven sector, the wanted ones and those `needed_by` these, in the order of `names`."""
        wanted = {DRIVEN, *wanted}
        wanted |= {other for name in wanted for other in self.needed_by(name)}
        return tuple(name for name in self.names if name in wanted)

    def select(self, names: tuple[str, ...]) -> Sectors:
        """The unknowns of `chosen` sectors."""
        self.prepare(name for name in names if name not in (DRIVEN, SPOT))
        return Sectors(names, self)

    @abstractmethod
    def needed_by(self, name: str) -> tuple[str, ...]:
        """Sectors of the same class to which a sector is orthogonal: without them it lacks a part of its response."""

    @abstractmethod
    def prepare(self, names: Iterable[str]) -> None:
        """Make the fields of some sectors, together where that is faster."""

    def count(self, name: str) -> int:
        """Number of displacement unknowns of a sector."""
        if name == DRIVEN:
            return self.reduced.displacements
        return 3 if name == SPOT else self.count_of_further(name)

    @abstractmethod
    def count_of_further(self, name: str) -> int:
        """Number of displacement unknowns of a sector beyond the driven one."""

    @abstractmethod
    def class_of(self, name: str) -> Hashable:
        """The class of a sector, equal for sectors that operators of the body may couple.

        The driven class is (), the one whose parity about the plane between the electrodes is flipped (2,).
        """

    @abstractmethod
    def projected(self, names: tuple[str, ...], tensors: Sequence[np.ndarray]) -> np.ndarray:
        """(n, k, k) forms of extended tensors on the sectors of one class."""

    @abstractmethod
    def extra(self, names: tuple[str, ...], term: ExtraTerm, matrix: sp.spmatrix) -> np.ndarray:
        """(k, k) a further term, given with its matrix (4n, 4n) on the mesh, on the sectors of one class."""

    @abstractmethod
    def film(self, left: tuple[str, ...], right: tuple[str, ...]) -> np.ndarray:
        """(k, l) ∫ v·u over one electrode between the unknowns of two sets of sectors, m² per unit of displacement²."""

    @abstractmethod
    def face(self, names: tuple[str, ...]) -> Face:
        """Displacements on one face, of the displacement unknowns of some sectors."""

    @abstractmethod
    def levels(self, names: tuple[str, ...]) -> list[tuple[float, Face]]:
        """Displacements as `face` on faces and the middle plane, with the shares of the thickness they stand for.

        For a body with a mirror plane between its faces, on one face and the middle plane.
        """


@dataclass(frozen=True)
class Sectors:
    """Some sectors and their r unknowns: displacements, then potentials from the last sector to the driven one.

    The very last is the hot potential.

    Attributes
    ----------
    names : of the sectors, "driven" first
    all_fields : fields of all sectors of the body
    """

    names: tuple[str, ...]
    all_fields: Fields = field(repr=False)

    @made_once
    def member(self) -> np.ndarray:
        """(r,) index of each unknown's sector."""
        numbers = np.arange(len(self.names))
        potentials = [self.all_fields.count_of_potentials(name) for name in self.names]
        return np.concatenate([np.repeat(numbers, self._moved), np.repeat(numbers[::-1], potentials[::-1])])

    @property
    def size(self) -> int:
        """r"""
        return self.member.size

    @property
    def displacements(self) -> int:
        """Number of displacement unknowns, in which uᵗMu = 1 (0 for those of a spot)."""
        return sum(self._moved)

    @made_once
    def _moved(self) -> list[int]:
        """Number of displacement unknowns of every sector."""
        return [self.all_fields.count(name) for name in self.names]

    @property
    def spot(self) -> np.ndarray:
        """Indices of the unknowns of a spot; none where there is no spot."""
        return np.flatnonzero(np.array(self.names)[self.member] == SPOT)

    @made_once
    def classes(self) -> dict[Hashable, tuple[str, ...]]:
        """Class → its sectors that have fields."""
        found: dict[Hashable, tuple[str, ...]] = {}
        for name in self.names:
            if name != SPOT:
                key = self.all_fields.class_of(name)
                found[key] = (*found.get(key, ()), name)
        return found

    def numbers(self, names: Iterable[str]) -> np.ndarray:
        """Indices of the unknowns of some of the sectors, displacements and potentials."""
        return np.flatnonzero(np.isin(self.member, [self.names.index(name) for name in names]))

    def of_other_classes(self, names: Iterable[str]) -> np.ndarray:
        """Indices of the unknowns of those of some sectors that are of another class than the driven one; no spot's."""
        same_class = (SPOT, *self.classes[()])
        return self.numbers(name for name in names if name not in same_class)


def driven_states(reduced: ReducedModel, constants: ElasticForm, top: float) -> np.ndarray:
    """(r, k) states of the driven body under a volt, clamped and static; then its modes up to `MODES_BEYOND` · top.

    top : ω² of the band
    """
    modal = reduced.modal(ElasticForm.from_vector(constants.vector().real))
    clamped, modes = modal.states[:, :1], modal.states[:, 1:]
    static = clamped - modes @ (modal.charges / modal.eigenvalues)[:, None]
    return np.hstack([clamped, static, modes[:, modal.eigenvalues < MODES_BEYOND * top]])
