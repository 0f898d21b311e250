"""`BoxFields`: fields of every sector of a plate with three mirror planes.

Besides the sectors of any body (`femu_piezo.effects.local.mesh_fields`) there are local responses of the driven class
and of class "x":

- "slices", "x slices": to a yielding slice across the plate;
- "ramp", "x ramp": to driven fields while the piezoelectric coupling varies along x;
- "x taper", "x wedge": to driven fields while the width or the thickness varies along x.

The local responses of a class are orthonormal to its modes and to the responses before them in the order ramp, taper,
wedge, film, slices.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from femu_piezo.effects.local.faces import BoxFace, on_face
from femu_piezo.effects.local.mesh_fields import FILM, Flipped, MeshFields, Response
from femu_piezo.effects.local.sectors import MODES_BEYOND
from femu_piezo.effects.local.weighted_forms import WeightedProducts
from femu_piezo.forward.box_interpolation import interpolation
from femu_piezo.forward.gradient_products import FIELDS
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.parity import ParityClass
from femu_piezo.forward.reduction import ReducedModel
from femu_piezo.geometry.boxes import grid_lines, tensor_box
from femu_piezo.material.constants import ElasticForm, PiezoConstants

SLICES, RAMP = "slices", "ramp"
#: Local response to sides that are not parallel → the axis of the extent that varies along x.
TAPERED = {"taper": 1, "wedge": 2}
#: Size below which the change of a mode with the constants is left out: its eigenvalue errs by the square.
_FOLLOWED = 1e-3


class BoxFields(MeshFields):
    """Fields of the sectors of a plate, on the part that its mirror planes cut.

    Parameters
    ----------
    model : of the part;  reduced : its driven class
    training : constants. Modes and responses are made at the first, without loss; where a ramp or a taper drives a
        class in first order, its modes are completed for the others
    wanted : the sectors that effects may ask for

    Attributes
    ----------
    weighted : weighted forms on the part
    """

    kinds = (RAMP, *TAPERED, FILM, SLICES)

    def __init__(
        self,
        model: ElectroelasticModel,
        reduced: ReducedModel,
        training: Sequence[PiezoConstants],
        wanted: Iterable[str],
    ) -> None:
        super().__init__(model, reduced, training[0], wanted)
        self.weighted = WeightedProducts(model)
        self._others_trained = [constants.lossless().to_e_form() for constants in training[1:]]

    def face(self, names: tuple[str, ...]) -> BoxFace:
        """Displacements on the face z = +t/2 of the part."""
        parts = [self._once.get(("face", name), lambda name=name: on_face(self.model, self.of(name))) for name in names]
        group, flipped = self._groups(names, [part.shape[3] for part in parts])
        half = tuple(self.model.domain.mesh.p.max(axis=1)[:2].tolist())
        return BoxFace(half, np.concatenate(parts, axis=3), flipped, group, self.model.domain.copies)

    def _modes(self, flipped: Flipped, respond: Response | None) -> np.ndarray:
        others = self._once.get("others", lambda: _OtherClasses(self, MODES_BEYOND * self._top))
        known = others.modes(flipped)
        if not (self._others_trained and any(name.endswith((RAMP, *TAPERED)) for name in self._local[flipped])):
            return known
        loads = self._moved_mode_loads(known)
        if not loads.shape[1]:
            return known
        return np.concatenate([known, self._outside(respond(loads), known, least=_FOLLOWED)], axis=2)

    def _moved_mode_loads(self, modes: np.ndarray) -> np.ndarray:
        """(4n, k) residuals of a class at the other training constants, of the modes in the band that (4, n, j) span.

        K^-1 times a residual is the first correction of a mode: with it eigenvalues err in fourth order of the change.
        """
        model, flat, found = self.model, modes.reshape(-1, modes.shape[2]), []
        units = model.products.applied(model.unit_tensors, modes).reshape(len(model.unit_tensors), *flat.shape)
        n, heavy = self.mass.shape[0], np.zeros_like(flat)
        heavy[:n] = self.mass @ flat[:n]
        for constants in self._others_trained:
            image = np.tensordot(constants.vector().real, units, axes=1)
            values, vectors = np.linalg.eigh(flat.T @ image)
            inside = values < self._top
            found.append(image @ vectors[:, inside] - heavy @ vectors[:, inside] * values[inside])
        return np.hstack(found)

    def _loads(self, kind: str, flipped: Flipped) -> np.ndarray:
        """(4n, k) loads on a class for one of `kinds` of local responses."""
        if kind == RAMP:
            return _ramp_loads(self.weighted, self.constants, self._states, 0 in flipped)
        if kind in TAPERED:
            return _taper_loads(self.weighted, TAPERED[kind], self.constants, self._states)
        return super()._loads(kind, flipped) if kind == FILM else _slice_loads(self.weighted, self.constants)


class _OtherClasses:
    """Modes of the classes that the terminals do not drive, found on a box with half as many elements along each axis.

    They enter at second order of an effect; their error enters squared.
    """

    def __init__(self, fields: BoxFields, top: float) -> None:
        fine, self._mass, self._top = fields.model, fields.mass, top
        lines = [np.linspace(line[0], line[-1], line.size // 2 + 1) for line in grid_lines(fine.domain.mesh)]
        self._rough = ElectroelasticModel(replace(fine.domain, mesh=tensor_box(lines)), fine.density)
        self._constants = fields.constants
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
    """(4n, k) forces and charges of states (4, n, k) by a piezoelectric coupling with an odd or even weight along x."""
    coupling = np.tensordot(constants.vector().real, weighted.model.unit_tensors, axes=1)
    coupling[:3, :, :3], coupling[3, :, 3] = 0.0, 0.0
    products = weighted.odd if odd else weighted.even
    loads = products.applied([coupling], states).reshape(-1, states.shape[2])
    return loads / np.linalg.norm(loads, axis=0)


def _taper_loads(weighted: WeightedProducts, side: int, constants: ElasticForm, states: np.ndarray) -> np.ndarray:
    """(4n, k) forces, charges and inertia of states (4, n, k) while the extent along axis `side` varies along x."""
    first, whole = weighted.tapered(side)[0], np.tensordot(constants.vector().real, weighted.model.unit_tensors, axes=1)
    flat = states.reshape(-1, states.shape[2])
    stiff, heavy = first.applied([whole], states).reshape(flat.shape), np.zeros_like(states)
    heavy[:3] = weighted.mass(weighted.odd_line, states[:3])
    loads = np.hstack([stiff, heavy.reshape(flat.shape)[:, 1:]])
    return loads / np.linalg.norm(loads, axis=0)
