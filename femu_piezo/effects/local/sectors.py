"""`Sectors`: the unknowns of a reduced body in groups, so that each effect brings only the groups it needs.

The driven class alone serves every effect that keeps the symmetry of the body; a further sector holds modes of other
classes, or the local response of a class to what an effect does. No operator of the body itself couples two classes.
Vectors of further sectors tie a potential to each displacement: they belong to the reference constants, and enter at
second order only. "spot" has three unknowns without field or inertia, the displacement of a body that is attached at a
place. `Fields` says what a kind of body has; plates: `box_fields`, disks and rings: `round_fields`.
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
#: Modes of the classes that the terminals do not drive are kept up to this multiple of the band's ω².
MODES_BEYOND = 2.5
#: Shares of the thickness that both faces and the middle plane stand for: Simpson's rule.
FACES, MIDDLE = 1 / 3, 2 / 3


class Fields(ABC):
    """Fields of every sector of one body, each made when it is first asked for.

    Attributes
    ----------
    names : all of them in the order of their unknowns, "driven" first
    model : whose driven class is reduced;  reduced : that
    reference : lossless constants that further sectors belong to
    """

    names: tuple[str, ...]
    model: ElectroelasticModel
    reduced: ReducedModel
    reference: PiezoConstants

    @property
    def potentials(self) -> int:
        """Number of inner potentials, and the hot one."""
        return self.reduced.size - self.reduced.displacements

    def chosen(self, wanted: Iterable[str]) -> tuple[str, ...]:
        """The driven sector, those that are wanted, and those `beside` which these hold only what is new, in order."""
        wanted = {DRIVEN, *wanted}
        wanted |= {other for name in wanted for other in self.beside(name)}
        return tuple(name for name in self.names if name in wanted)

    def select(self, names: tuple[str, ...]) -> Sectors:
        """The unknowns of `chosen` sectors."""
        self.prepare(name for name in names if name not in (DRIVEN, SPOT))
        return Sectors(names, self)

    @abstractmethod
    def beside(self, name: str) -> tuple[str, ...]:
        """Sectors of the same class to which a sector is orthonormal: without them it is a part of the response."""

    @abstractmethod
    def prepare(self, names: Iterable[str]) -> None:
        """Make the fields of some sectors, together where that is faster."""

    def count(self, name: str) -> int:
        """Number of displacement unknowns of a sector."""
        if name == DRIVEN:
            return self.reduced.displacements
        return 3 if name == SPOT else self.further(name)

    @abstractmethod
    def further(self, name: str) -> int:
        """Number of unknowns of a sector beyond the driven one."""

    @abstractmethod
    def class_of(self, name: str) -> Hashable:
        """The class of a sector, equal for those that operators of the body may couple.

        The driven one is (), that whose parity about the plane between the electrodes differs (2,).
        """

    @abstractmethod
    def projected(self, names: tuple[str, ...], tensors: Sequence[np.ndarray]) -> np.ndarray:
        """(n, k, k) forms of extended tensors on the sectors of one class; potentials come with the driven one."""

    @abstractmethod
    def extra(self, names: tuple[str, ...], term: ExtraTerm, matrix: sp.spmatrix) -> np.ndarray:
        """(k, k) a further term, of which the matrix on the mesh is given, on the sectors of one class."""

    @abstractmethod
    def film(self, left: tuple[str, ...], right: tuple[str, ...]) -> np.ndarray:
        """(k, l) ∫ v·u over one electrode between the unknowns of sectors, m² per unit of displacement²."""

    @abstractmethod
    def face(self, names: tuple[str, ...]) -> Face:
        """Displacements on one face, of the displacement unknowns of some sectors."""

    @abstractmethod
    def levels(self, names: tuple[str, ...]) -> list[tuple[float, Face]]:
        """The same on faces and the middle plane, with the shares of the thickness that they stand for.

        Of a body with a mirror plane between its faces those of the half z > 0.
        """


@dataclass(frozen=True)
class Sectors:
    """Some sectors and their r unknowns: displacements, inner potentials, the hot potential.

    Attributes
    ----------
    names : of the sectors, "driven" first
    """

    names: tuple[str, ...]
    all_fields: Fields = field(repr=False)

    @made_once
    def member(self) -> np.ndarray:
        """(r,) index of each unknown's sector."""
        counts = [self.all_fields.count(name) for name in self.names]
        potentials = np.zeros(self.all_fields.potentials, dtype=int)
        return np.concatenate([np.repeat(np.arange(len(self.names)), counts), potentials])

    @property
    def size(self) -> int:
        """r"""
        return self.member.size

    @property
    def displacements(self) -> int:
        """Number of displacement unknowns, in which uᵗMu = 1 (0 for those of a spot)."""
        return self.size - self.all_fields.potentials

    @property
    def spot(self) -> np.ndarray:
        """The unknowns (indices) of a spot; none where there is none."""
        return np.flatnonzero(np.array(self.names)[self.member] == SPOT)

    @made_once
    def classes(self) -> dict[Hashable, tuple[str, ...]]:
        """Class → its sectors that have fields."""
        found: dict[Hashable, tuple[str, ...]] = {}
        for name in self.names:
            if name != SPOT:
                own = self.all_fields.class_of(name)
                found[own] = (*found.get(own, ()), name)
        return found

    def numbers(self, names: Iterable[str]) -> np.ndarray:
        """The unknowns (indices) of some of the sectors; the potentials come with the driven one."""
        return np.flatnonzero(np.isin(self.member, [self.names.index(name) for name in names]))

    def of_other_classes(self, names: Iterable[str]) -> np.ndarray:
        """The unknowns (indices) of those of some of the sectors whose class is not the driven one; a spot has none."""
        alike = (SPOT, *self.classes[()])
        return self.numbers(name for name in names if name not in alike)


def driven_states(reduced: ReducedModel, constants: ElasticForm, top: float) -> np.ndarray:
    """(r, k) plate under a volt, clamped and free to yield slowly; then the driven modes in the band."""
    modal = reduced.modal(ElasticForm.from_vector(constants.vector().real))
    clamped, modes = modal.states[:, :1], modal.states[:, 1:]
    yielding = clamped - modes @ (modal.charges / modal.eigenvalues)[:, None]
    return np.hstack([clamped, yielding, modes[:, modal.eigenvalues < MODES_BEYOND * top]])
