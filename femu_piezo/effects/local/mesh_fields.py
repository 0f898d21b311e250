"""`MeshFields`: fields of every sector of a body on its own mesh, or on the part that its mirror planes cut.

The sectors, besides "driven" and "spot", are

- "x" to "xyz": the modes of the parity class that is flipped about these axes (`femu_piezo.forward.parity`), as far as
  the body has mirror planes normal to them;
- "undriven": modes of the driven class that the driven unknowns lack; on a body without mirror planes these are all
  modes that the terminals hardly drive;
- "film", "z film": the local response of the driven class and of class "z" to films on the electrodes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import combinations

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from femu_piezo.effects.effect import ExtraTerm
from femu_piezo.effects.local.face_on_mesh import LevelOfMesh, MeshFace
from femu_piezo.effects.local.faces import Face
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
from femu_piezo.forward.electrodes import electrode_faces, electrode_film
from femu_piezo.forward.gradient_products import FIELDS
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.parity import ParityClass
from femu_piezo.forward.reduced_basis import largest_norm, new_directions
from femu_piezo.forward.reduction import ReducedModel
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.threads import Once, in_parallel, made_once

UNDRIVEN, FILM = "undriven", "film"
#: Share of the largest local response, outside the known fields, below which a direction is dropped.
_KEEP = 1e-3
#: Size of the part of a mode outside the driven unknowns below which these represent the mode.
_OUTSIDE_DRIVEN = 1e-2

#: Axes normal to the mirror planes about which the parity of a class is flipped.
Flipped = tuple[int, ...]
#: How a class responds to loads (4n, k): (4n, k).
Response = Callable[[np.ndarray], np.ndarray]


def flipped_axes(sector: str) -> Flipped:
    """Axes normal to the mirror planes of flipped parity: "xz" → (0, 2), "x slices" → (0,), "driven" → ()."""
    letters = sector.split()[0]
    return tuple("xyz".index(letter) for letter in letters) if set(letters) <= set("xyz") else ()


def letters(flipped: Flipped) -> str:
    """The name of the modes of a class: (0, 2) → "xz"."""
    return "".join("xyz"[axis] for axis in flipped)


def at_a_place(mirrors: Iterable[int]) -> tuple[str, ...]:
    """Names of the sectors that an effect at any place of a body asks for; mirrors : axes of its mirror planes."""
    axes = [axis for axis in range(3) if axis in set(mirrors)]
    return tuple(letters(flipped) for count in range(1, 4) for flipped in combinations(axes, count))


class MeshFields(Fields):
    """Fields of the sectors of a body, on the part that its mirror planes cut where it has some.

    Parameters
    ----------
    model : of the part;  reduced : its driven class
    constants : those at which modes and responses are made, without loss
    wanted : the sectors that effects may ask for

    Attributes
    ----------
    constants : the lossless reference in the e-form
    """

    #: Kinds of local responses, in the order in which they are made.
    kinds: tuple[str, ...] = (FILM,)

    def __init__(
        self, model: ElectroelasticModel, reduced: ReducedModel, constants: PiezoConstants, wanted: Iterable[str]
    ) -> None:
        self.model, self.reduced, self.reference = model, reduced, constants.lossless()
        self.constants = self.reference.to_e_form()
        self._top, self._once = (2 * np.pi * reduced.band_Hz) ** 2, Once()
        wanted = set(wanted) - {DRIVEN, SPOT}
        classes = sorted({flipped_axes(name) for name in wanted}, key=lambda flipped: (len(flipped), flipped))
        self._local = {
            flipped: [name for name in (f"{letters(flipped)} {kind}".strip() for kind in self.kinds) if name in wanted]
            for flipped in classes
        }
        modes = {flipped: letters(flipped) or UNDRIVEN for flipped in classes}
        further = [[modes[key]] * (bool(key) or UNDRIVEN in wanted) + local for key, local in self._local.items()]
        self.names = (DRIVEN, SPOT, *(name for names in further for name in names))

    def prepare(self, names: Iterable[str]) -> None:
        """Make the fields of some sectors, all those of a class at once, and the classes on several threads."""
        tuple(in_parallel(self._class, {flipped_axes(name) for name in names}))

    def needed_by(self, name: str) -> tuple[str, ...]:
        """For a local response the modes of its class and the local responses made before it; else no sectors."""
        flipped = flipped_axes(name)
        local = self._local.get(flipped, [])
        if name not in local:
            return ()
        return (letters(flipped) or UNDRIVEN, *local[: local.index(name)])

    def count_of_further(self, name: str) -> int:
        """Number of displacement unknowns of a sector beyond the driven one."""
        return self.of(name).shape[2]

    def count_of_potentials(self, name: str) -> int:
        """Number of potential unknowns of a sector."""
        return super().count_of_potentials(name) if name in (DRIVEN, SPOT) else self._potentials(name).shape[2]

    def class_of(self, name: str) -> Flipped:
        """`flipped_axes` of the sector."""
        return flipped_axes(name)

    def fields(self, names: Iterable[str]) -> np.ndarray:
        """(4, n, k) of the unknowns of some sectors, displacements first, in the order of `Sectors`."""
        names = set(names)
        chosen = [name for name in self.names if name in names]
        return np.concatenate([*map(self.of, chosen), *map(self._potentials, reversed(chosen))], axis=2)

    def projected(self, names: tuple[str, ...], tensors: Sequence[np.ndarray]) -> np.ndarray:
        """(n, k, k) forms of extended tensors on the sectors of one class."""
        return self.model.products.within(self.fields(names), tensors)

    def extra(self, names: tuple[str, ...], term: ExtraTerm, matrix: sp.spmatrix) -> np.ndarray:
        """(k, k) a further term on the sectors of one class."""
        fields = self.fields(names)
        flat = fields.reshape(-1, fields.shape[2])
        return flat.T @ (matrix @ flat)

    def film(self, left: tuple[str, ...], right: tuple[str, ...]) -> np.ndarray:
        """(k, l) ∫ v·u over the electrode of the part between the unknowns of two sets of sectors."""
        before, after = (self.fields(names) for names in (left, right))
        return before.reshape(-1, before.shape[2]).T @ (self.electrode @ after.reshape(-1, after.shape[2]))

    def face(self, names: tuple[str, ...]) -> Face:
        """Displacements on the face of the part whose z is largest."""
        return self._level(names, 1.0)

    def levels(self, names: tuple[str, ...]) -> list[tuple[float, Face]]:
        """Displacements at some heights of the part, with the shares of the thickness that they stand for."""
        mirrored = 2 in self.model.domain.symmetry.values()
        shares = {1.0: FACES, 0.0: MIDDLE} if mirrored else {1.0: FACES / 2, 0.5: MIDDLE, 0.0: FACES / 2}
        return [(share, self._level(names, height)) for height, share in shares.items()]

    def _level(self, names: tuple[str, ...], height: float) -> MeshFace:
        """Displacements at a height of the part, 0 the lowest and 1 the highest."""
        level = self._once.get(("level", height), lambda: LevelOfMesh(self.model, height))
        parts = [self._once.get(("level", height, name), lambda name=name: level.of(self.of(name))) for name in names]
        group, flipped = self._groups(names, [part.shape[2] for part in parts])
        return MeshFace(level, np.concatenate(parts, axis=2), flipped, group, self.model.domain.copies)

    def _groups(self, names: tuple[str, ...], counts: list[int]) -> tuple[np.ndarray, np.ndarray]:
        """(u,) number of the class of every displacement unknown, and (3, u) about which axes that class is flipped."""
        classes = [flipped_axes(name) for name in names]
        group = np.repeat([classes.index(flipped) for flipped in classes], counts)
        return group, np.repeat([[axis in flipped for flipped in classes] for axis in range(3)], counts, axis=1)

    def of(self, name: str) -> np.ndarray:
        """(4, n, k) displacement (m) and potential (V) of a sector's unknowns; of "driven" the displacements alone."""
        if name == DRIVEN:
            return self._driven[:, :, : self.reduced.displacements]
        if name == SPOT:
            return np.zeros((FIELDS, self.model.basis.N, 3))
        return self._class(flipped_axes(name))[name][0]

    def _potentials(self, name: str) -> np.ndarray:
        """(4, n, k) of a sector's potential unknowns, without displacement; of the driven one the hot one last."""
        if name == DRIVEN:
            return self._driven[:, :, self.reduced.displacements :]
        return self._class(flipped_axes(name))[name][1]

    @made_once
    def _driven(self) -> np.ndarray:
        return (self.model.prolongation @ self.reduced.basis).reshape(FIELDS, self.model.basis.N, -1)

    @made_once
    def _states(self) -> np.ndarray:
        """(4, n, k) driven states whose loads the local responses answer."""
        return self._driven @ driven_states(self.reduced, self.constants, self._top)

    @made_once
    def electrode(self) -> sp.csr_matrix:
        """(4n, 4n) ∫ v·u over the electrode of the part, m² per unit of displacement²."""
        return electrode_film(electrode_faces(self.model))

    @made_once
    def mass(self) -> spla.LinearOperator:
        """(3n, 3n) mass of all displacements, kg, those held on symmetry planes included."""
        model = self.model

        def times(displacements: np.ndarray) -> np.ndarray:
            parts = displacements.reshape(3, model.basis.N, -1)
            return model.density * np.concatenate([model.products.mass_times(part) for part in parts])

        return spla.LinearOperator((3 * model.basis.N,) * 2, matvec=times, matmat=times, dtype=float)

    def _class(self, flipped: Flipped) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Name → displacement and potential unknowns (4, n, k) of every sector of a parity class."""
        return self._once.get(flipped, lambda: self._new_class(flipped))

    def _new_class(self, flipped: Flipped) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """As `_class`, made: all sectors at once, as the factor of the class is too large to keep."""
        local, moved, alone = self._local[flipped], self.of(DRIVEN), self._potentials(DRIVEN)
        respond = self._responding(flipped) if local else None
        none, found = alone[:, :, :0], {}
        if flipped:
            moved, alone = self._modes(flipped, respond), none
            found[letters(flipped)] = moved, none
        elif UNDRIVEN in self.names:
            fresh = self._outside(self._modes(flipped, respond), moved, _OUTSIDE_DRIVEN)
            found[UNDRIVEN], moved = (fresh, none), np.concatenate([moved, fresh], axis=2)
        for name in local:
            responses = respond(self._loads(name.split()[-1], flipped))
            fresh = self._outside(responses, moved)
            moved = np.concatenate([moved, fresh], axis=2)
            charged = self._charged(responses, moved, alone)
            found[name], alone = (fresh, charged), np.concatenate([alone, charged], axis=2)
        return found

    def _modes(self, flipped: Flipped, respond: Response | None) -> np.ndarray:
        """(4, n, k) short-circuited modes of a class, up to `MODES_BEYOND` times the band's ω²."""
        found = ParityClass(self.model, self.constants, flipped).modes(MODES_BEYOND * self._top)
        return found.reshape(FIELDS, self.model.basis.N, -1)

    def _responding(self, flipped: Flipped) -> Response:
        parity = ParityClass(self.model, self.constants, flipped)
        factor = parity.factor(RESPONSE_SHIFT * self._top)
        return lambda loads: parity.prolongation @ factor.solve(parity.prolongation.T @ loads)

    def _loads(self, kind: str, flipped: Flipped) -> np.ndarray:
        """(4n, k) loads on a class, for one kind of local responses: the inertia of a film that driven states move."""
        loads = self.electrode @ self._states.reshape(-1, self._states.shape[2])
        norm = np.linalg.norm(loads, axis=0)
        return loads[:, norm > 0] / norm[norm > 0]

    def _outside(self, responses: np.ndarray, known: np.ndarray, least: float | None = None) -> np.ndarray:
        """(4, n, k) combinations of responses (…, j), displacements orthonormal and orthogonal to `known` (4, n, i).

        least : size below which a direction is dropped; the share `_KEEP` of the largest where None
        """
        n = self.mass.shape[0]
        known, responses = known.reshape(-1, known.shape[2]), responses.reshape(-1, responses.shape[-1])
        old = known[:n]
        outside = responses - known @ (old.T @ (self.mass @ responses[:n]))
        least = _KEEP * largest_norm(outside[:n], self.mass) if least is None else least
        fresh = new_directions(old, outside[:n], least, self.mass)
        # the potentials follow the same combinations
        mix = np.linalg.lstsq(fresh.T @ (self.mass @ outside[:n]), np.eye(fresh.shape[1]), rcond=1e-10)[0]
        return np.concatenate([fresh, outside[n:] @ mix]).reshape(FIELDS, n // 3, fresh.shape[1])

    def _charged(self, responses: np.ndarray, moved: np.ndarray, alone: np.ndarray) -> np.ndarray:
        """(4, n, k) potentials of responses (4n, j) that come neither with displacements nor alone yet.

        A field along the poling that a varying coupling makes moves next to nothing. Potentials whose energy is below
        `_KEEP`² of the largest of a response are left out.

        Parameters
        ----------
        moved : (4, n, i) displacement unknowns of the class;  alone : (4, n, l) its potential unknowns
        """
        n, (flat, old) = self.mass.shape[0], (one.reshape(len(responses), one.shape[2]) for one in (moved, alone))
        rest = responses - flat @ (flat[:n].T @ (self.mass @ responses[:n]))
        rest[:n] = 0.0
        old = np.linalg.solve(np.linalg.cholesky(old.T @ (self._uncoupled @ old)), old.T).T
        fresh = new_directions(old, rest, _KEEP * largest_norm(responses, self._uncoupled), self._uncoupled)
        return fresh.reshape(FIELDS, n // 3, fresh.shape[1])

    @made_once
    def _uncoupled(self) -> spla.LinearOperator:
        """(4n, 4n) twice the elastic and dielectric energy without piezoelectric coupling, positive semidefinite."""
        tensor = np.tensordot(self.constants.vector().real, self.model.unit_tensors, axes=1)
        tensor[:3, :, 3], tensor[3, :, :3], tensor[3, :, 3] = 0.0, 0.0, -tensor[3, :, 3]

        def times(fields: np.ndarray) -> np.ndarray:
            parts = fields.reshape(FIELDS, self.model.basis.N, -1)
            return self.model.products.applied([tensor], parts)[0].reshape(fields.shape)

        return spla.LinearOperator((FIELDS * self.model.basis.N,) * 2, matvec=times, matmat=times, dtype=float)
