"""`ExtendedModel`: a reduced model that also knows the terms of effects and how each term scales with the dimensions.

Scaling the axes by s turns ∂_a into ∂_a/s_a and dV into s_x s_y s_z dV. So a gradient product ∫ ∂_a v ∂_b w takes the
factor Π_i s_i^(1 − k_i), k_i = how many of a, b are the axis i, and the mass takes s_x s_y s_z. Each unit-constant
matrix is the sum of its parts of equal exponents ("strata"); with them any stretch is exact, on one mesh.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp

from femu_piezo.effects.effect import Effect, ExtraTerm
from femu_piezo.effects.local.operators import Places
from femu_piezo.effects.local.symmetry_sectors import (
    DRIVEN,
    SPOT,
    Sectors,
    build_sectors,
    prepare_classes,
    unknowns_of,
)
from femu_piezo.effects.local.weighted_forms import WeightedProducts
from femu_piezo.forward.modal import ModalModel, diagonalise
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import ReducedModel, reduce_model
from femu_piezo.material.constants import E_FORM, ElasticForm, PiezoConstants
from femu_piezo.threads import blas_limit, in_parallel

#: Relative stretch of each dimension that the basis is trained for.
_STRETCH = 0.02


@dataclass(frozen=True)
class ExtendedModel:
    """Projected terms; r unknowns: displacements, inner potentials, hot potential in volts.

    Attributes
    ----------
    bulk : (10, r, r) the unit-constant matrices of the unstretched body
    strata : (n_s, r, r) their parts of equal exponents; strata of one constant sum to its bulk matrix
    owner : (n_s,) index of the e-form constant of each stratum
    exponents : (n_s, 3) exponents 1 − k of the factors on the three dimensions
    stiffness, inertia : name of an extra term → (r, r)
    displacements : number of displacement unknowns
    sectors : names of the groups of unknowns (`femu_piezo.effects.local.symmetry_sectors`)
    member : (r,) index of each unknown's sector
    places : what effects at a place need; None where no such effect is among those of the model
    driven : the reduced model of the driven class that it is built on, and the terms it was trained for
    """

    bulk: np.ndarray = field(repr=False)
    strata: np.ndarray = field(repr=False)
    owner: np.ndarray = field(repr=False)
    exponents: np.ndarray = field(repr=False)
    stiffness: dict[str, np.ndarray] = field(repr=False)
    inertia: dict[str, np.ndarray] = field(repr=False)
    displacements: int
    admittance_factor: float
    estimated_error: float
    sectors: tuple[str, ...] = (DRIVEN,)
    member: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int), repr=False)
    places: Places | None = field(default=None, repr=False)
    driven: tuple[ReducedModel, Needs] | None = field(default=None, repr=False)
    _restricted: dict[tuple[str, ...], ExtendedModel] = field(default_factory=dict, repr=False, compare=False)

    @property
    def size(self) -> int:
        """Number of reduced unknowns."""
        return self.bulk.shape[1]

    @property
    def mass(self) -> np.ndarray:
        """(u, u) diagonal mass of the displacement unknowns: 1, and 0 where a spot has no field."""
        spot = self.sectors.index(SPOT) if SPOT in self.sectors else -1
        return np.diag((self.member[: self.displacements] != spot).astype(float))

    def modal(self, constants: ElasticForm) -> ModalModel:
        """Closed forms of the body without effects at given e-form constants (complex)."""
        with blas_limit():
            driven = self.restricted(())
            stiffness = np.tensordot(constants.vector(), driven.bulk, axes=1)
            return diagonalise(stiffness, driven.bulk, driven.displacements, driven.admittance_factor)

    def restricted(self, wanted: Sequence[str]) -> ExtendedModel:
        """The model with the driven sector and those that are wanted alone; kept for the next call."""
        names = tuple(name for name in self.sectors if name == DRIVEN or name in wanted)
        if names == self.sectors:
            return self
        if names not in self._restricted:
            self._restricted[names] = self._select(names)
        return self._restricted[names]

    def _select(self, names: tuple[str, ...]) -> ExtendedModel:
        keep, member = unknowns_of(self.sectors, self.member, names)
        square = np.ix_(keep, keep)
        return replace(
            self,
            bulk=np.ascontiguousarray(self.bulk[:, square[0], square[1]]),
            strata=np.ascontiguousarray(self.strata[:, square[0], square[1]]),
            stiffness={name: matrix[square] for name, matrix in self.stiffness.items()},
            inertia={name: matrix[square] for name, matrix in self.inertia.items()},
            displacements=int(np.count_nonzero(keep < self.displacements)),
            sectors=names,
            member=member,
            places=None if self.places is None else self.places.select(names),
            _restricted={},
        )


@dataclass(frozen=True)
class Needs:
    """What a model must have for a list of effects; equal for lists that one model serves.

    Attributes
    ----------
    trained : name, kind and training values of every term
    terms : the terms themselves, told apart by their names
    sectors : names
    stretching, placed : whether an effect changes dimensions, or sits at a place
    """

    trained: tuple[tuple[str, str, tuple[float, ...]], ...]
    terms: tuple[ExtraTerm, ...] = field(compare=False)
    sectors: tuple[str, ...]
    stretching: bool
    placed: bool

    @classmethod
    def of(cls, effects: Sequence[Effect]) -> Needs:
        """Of all effects of a list."""
        terms = tuple({term.name: term for effect in effects for term in effect.terms}.values())
        return cls(
            trained=tuple((term.name, term.kind, term.training) for term in terms),
            terms=terms,
            sectors=tuple(dict.fromkeys(name for effect in effects for name in effect.sectors)),
            stretching=any(effect.stretch is not None for effect in effects),
            placed=any(effect.local is not None for effect in effects),
        )

    def driven_alike(self, other: Needs) -> bool:
        """Whether the driven class needs the same."""
        return (self.trained, self.stretching) == (other.trained, other.stretching)


def extend_model(
    model: ElectroelasticModel,
    training: Sequence[PiezoConstants],
    effects: Sequence[Effect],
    band_Hz: float,
    *,
    accuracy: float = 1e-5,
    smaller: ExtendedModel | None = None,
) -> ExtendedModel:
    """Reduce a model so that it serves all effects of a list within their training ranges.

    Parameters
    ----------
    training : constants the basis is trained at, the reference first
    accuracy : of Z, as `reduce_model`
    smaller : the same for fewer effects; its driven basis is kept where the further ones need no other
    """
    needs = Needs.of(effects)
    matrices = {term.name: term.matrix(model) for term in needs.terms}
    lossless = training[0].lossless()
    reference = lossless.to_e_form()
    weighted = WeightedProducts(model)

    def driven() -> ReducedModel:
        if smaller is not None and smaller.driven is not None and needs.driven_alike(smaller.driven[1]):
            return smaller.driven[0]
        return _driven(model, training, needs, matrices, band_Hz, accuracy)

    pieces = (driven, lambda: prepare_classes(weighted, needs.sectors, training, band_Hz))
    reduced, classes = in_parallel(operator.call, pieces)
    sectors = build_sectors(weighted, reduced, needs.sectors, reference, classes)
    strata, owner, exponents = _strata(model, sectors)
    bulk = np.array([strata[owner == q].sum(axis=0) for q in range(len(E_FORM))])
    extra = {term.name: _by_class(sectors, lambda f, t=term: _product(matrices[t.name], f)) for term in needs.terms}
    return ExtendedModel(
        bulk=bulk,
        strata=strata if needs.stretching else bulk,
        owner=owner if needs.stretching else np.arange(len(E_FORM)),
        exponents=exponents if needs.stretching else np.zeros((len(E_FORM), 3)),
        stiffness={term.name: extra[term.name] for term in needs.terms if term.kind == "stiffness"},
        inertia={term.name: extra[term.name] for term in needs.terms if term.kind == "inertia"},
        displacements=sectors.displacements,
        admittance_factor=reduced.admittance_factor,
        estimated_error=reduced.estimated_error,
        sectors=sectors.names,
        member=sectors.member,
        places=Places(weighted, sectors, reference) if needs.placed else None,
        driven=(reduced, needs),
    )


def _driven(
    model: ElectroelasticModel,
    training: Sequence[PiezoConstants],
    needs: Needs,
    matrices: dict[str, sp.spmatrix],
    band_Hz: float,
    accuracy: float,
) -> ReducedModel:
    """The driven class, trained at the constants, with every term and stretched along every axis."""
    lossless = training[0].lossless()
    parts = _stretch_parts(model, lossless.to_e_form().vector().real) if needs.stretching else {}
    trained = model.with_terms(parts, matrices)
    top = (2 * np.pi * band_Hz) ** 2
    points: list = [*training]
    for term in needs.terms:
        for value in term.training:
            # a mass leads along the same states as a spring, which makes no mode of negative stiffness
            points.append((lossless, {term.name: 0.3 * top * value if term.kind == "inertia" else value}))
    for axis in range(3) if needs.stretching else ():
        s = 1 + _STRETCH
        points.append((lossless, {f"stretch_{axis}_0": s - 1, f"stretch_{axis}_2": 1 / s - 1}))
    return reduce_model(trained, points, band_Hz, accuracy=accuracy)


def _product(matrix: sp.spmatrix, fields: np.ndarray) -> np.ndarray:
    """(k, k) of a (4n, 4n) matrix on fields (4, n, k)."""
    flat = fields.reshape(-1, fields.shape[2])
    return flat.T @ (matrix @ flat)


def _by_class(sectors: Sectors, project) -> np.ndarray:
    """(…, r, r) of a symmetric operator, which couples no two parity classes; project: fields → (…, k, k)."""
    found = None
    for own in sectors.classes.values():
        block = project(sectors.fields[:, :, own])
        if found is None:
            found = np.zeros((*block.shape[:-2], sectors.member.size, sectors.member.size))
        found[(..., *np.ix_(own, own))] = block
    return found


def _stretch_parts(model: ElectroelasticModel, coefficients: np.ndarray) -> dict[str, np.ndarray]:
    """The parts of Σ c_q H_q (4, 3, 4, 3) with no derivative and with two derivatives along each axis."""
    tensor = np.tensordot(coefficients, model.unit_tensors, axes=1)
    parts = {}
    for axis in range(3):
        along = (np.arange(3) == axis).astype(int)
        count = along[:, None] + along[None, :]  # derivatives along the axis in H[f, a, g, b]
        for k in (0, 2):
            parts[f"stretch_{axis}_{k}"] = tensor * (count == k)[None, :, None, :]
    return parts


def _strata(model: ElectroelasticModel, sectors: Sectors) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parts of equal constant and exponents: matrices (n_s, r, r), constants (n_s,), exponents (n_s, 3)."""
    parts: dict[tuple[int, tuple[int, ...]], np.ndarray] = {}
    for q, tensor in enumerate(model.unit_tensors):
        for f, a, g, b in zip(*np.nonzero(tensor), strict=True):
            powers = tuple(1 - int(a == axis) - int(b == axis) for axis in range(3))
            parts.setdefault((q, powers), np.zeros_like(tensor))[f, a, g, b] = tensor[f, a, g, b]
    matrices = _by_class(sectors, lambda fields: model.products.within(fields, list(parts.values())))
    return matrices, np.array([q for q, _ in parts]), np.array([powers for _, powers in parts], dtype=float)
