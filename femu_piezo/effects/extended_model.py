"""`ExtendedModel`: a reduced model that also knows the terms of effects and how each term scales with the dimensions.

Scaling the axes by s turns ∂_a into ∂_a/s_a and dV into s_x s_y s_z dV. So a gradient product ∫ ∂_a v ∂_b w takes the
factor Π_i s_i^(1 − k_i), k_i = how many of a, b are the axis i, and the mass takes s_x s_y s_z. Each unit-constant
matrix is the sum of its parts of equal exponents ("strata"); with them any stretch is exact, on one mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from femu_piezo.effects.effect import Effect, ExtraTerm
from femu_piezo.effects.local.box_fields import BoxFields
from femu_piezo.effects.local.mesh_fields import MeshFields
from femu_piezo.effects.local.operators import Places
from femu_piezo.effects.local.round_fields import RoundFields
from femu_piezo.effects.local.sectors import Fields, Sectors
from femu_piezo.errors import InputError
from femu_piezo.forward.mesh_error import MeshError, mesh_error
from femu_piezo.forward.modal import ModalModel, diagonalise
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import ReducedModel, reduce_model
from femu_piezo.material.constants import E_FORM, ElasticForm, PiezoConstants
from femu_piezo.threads import Once, blas_limit

#: Number of selections of sectors whose terms are kept, 100 MB for a large one; the terms by class, a tenth of that,
#: are all kept.
_MODELS = 4
#: Number of closed forms that a model keeps, the latest.
_FORMS = 2
#: Relative stretch of each dimension that the basis is trained for.
_STRETCH = 0.02


class ExtendedModel:
    """Projected terms of some sectors; r unknowns: displacements, inner potentials, hot potential in volts.

    `restricted` gives the model on other sectors; their fields and terms are made when they are first asked for.

    Parameters
    ----------
    source : fields and terms that all selections of sectors share
    selection : the unknowns, and what is kept for them

    Attributes
    ----------
    constant_of_stratum : (n_s,) index of the e-form constant of each stratum
    exponents : (n_s, 3) exponents 1 − k of the factors on the three dimensions
    places : operators that effects at a place need
    closed_forms : the latest, by a hash of their stiffness and mass
    """

    def __init__(self, source: _Source, selection: _Selection) -> None:
        self._source, self._sectors, self._operators = source, selection.sectors, selection.operators
        self.constant_of_stratum, self.exponents = source.constant_of_stratum, source.exponents
        self.places, self.closed_forms = selection.places, selection.closed_forms

    @property
    def sectors(self) -> tuple[str, ...]:
        """Names of the groups of unknowns (`femu_piezo.effects.local.sectors`)."""
        return self._sectors.names

    @property
    def member(self) -> np.ndarray:
        """(r,) index of each unknown's sector."""
        return self._sectors.member

    @property
    def size(self) -> int:
        """Number of reduced unknowns."""
        return self._sectors.size

    @property
    def displacements(self) -> int:
        """Number of displacement unknowns."""
        return self._sectors.displacements

    @property
    def admittance_factor(self) -> float:
        """Y of the specimen / Y of the part."""
        return self._source.reduced.admittance_factor

    @property
    def estimated_error(self) -> float:
        """Relative error of Z by the reduction of the driven class, as estimated."""
        return self._source.reduced.estimated_error

    @property
    def mesh_error(self) -> MeshError | None:
        """Error of the driven eigenvalues by the mesh, from elements one order lower; None where these cannot tell."""
        return self._source.mesh_error

    @property
    def strata(self) -> np.ndarray:
        """(n_s, r, r) parts of equal exponents of the unit-constant matrices; their sum over one constant is `bulk`."""
        return self._operators.get("strata", lambda: self._by_class(self._source.strata))

    @property
    def bulk(self) -> np.ndarray:
        """(10, r, r) the unit-constant matrices of the unstretched body."""
        return self._operators.get("bulk", lambda: self._by_class(self._source.bulk))

    def extra(self, name: str) -> np.ndarray:
        """(r, r) matrix of an extra term of an effect."""
        make = self._source.extra
        return self._operators.get(("extra", name), lambda: self._by_class(lambda names: make(name, names)))

    @property
    def mass(self) -> np.ndarray:
        """(u, u) diagonal mass of the displacement unknowns: 1, and 0 for those of a spot, which have no field."""
        found = np.ones(self.displacements)
        found[self._sectors.spot] = 0.0
        return np.diag(found)

    def modal(self, constants: ElasticForm) -> ModalModel:
        """Closed forms of the body without effects at given e-form constants (complex)."""
        with blas_limit():
            driven = self.restricted(())
            stiffness = np.tensordot(constants.vector(), driven.bulk, axes=1)
            return diagonalise(stiffness, driven.bulk, driven.displacements, driven.admittance_factor)

    def restricted(self, wanted: Iterable[str]) -> ExtendedModel:
        """The model on the driven sector, the wanted ones and those that these need; the latest are kept."""
        return self._source.model(wanted)

    def _by_class(self, block: Callable[[tuple[str, ...]], np.ndarray]) -> np.ndarray:
        """(…, r, r) operator of the symmetry of the body, which couples no two classes, from its blocks.

        block : names of the sectors of one class → (…, k, k)
        """
        found = None
        for names in self._sectors.classes.values():
            values, at = block(names), self._sectors.numbers(names)
            if found is None:
                found = np.zeros((*values.shape[:-2], self.size, self.size))
            found[(..., *np.ix_(at, at))] = values
        return found


@dataclass(frozen=True)
class _Selection:
    """What is kept for a selection of sectors; no model, which would refer to the source that keeps it."""

    sectors: Sectors
    places: Places
    operators: Once = field(default_factory=Once)
    closed_forms: Once = field(default_factory=lambda: Once(_FORMS))


class _Source:
    """Fields of all sectors, and the terms on each class, each made when it is first asked for."""

    def __init__(self, fields: Fields, needs: Needs, matrices: Mapping[str, sp.spmatrix]) -> None:
        """matrices : (4n, 4n) on the mesh of every further term of `needs`, by its name"""
        self._fields, self._matrices = fields, matrices
        self._terms = {term.name: term for term in needs.terms}
        self.reduced, self.shared, self._selections = fields.reduced, Once(), Once(_MODELS)
        tensors = fields.model.unit_tensors
        self._parts, self.constant_of_stratum, self.exponents = (
            _strata(tensors) if needs.stretching else _whole(tensors)
        )

    @property
    def mesh_error(self) -> MeshError | None:
        """Error of the driven eigenvalues by the mesh, measured when it is first asked for."""
        fields, band = self._fields, self.reduced.band_Hz
        return self.shared.get("mesh error", lambda: mesh_error(fields.model, fields.reference, band))

    def model(self, wanted: Iterable[str]) -> ExtendedModel:
        """The model on the driven sector, the wanted ones and those that these need."""
        names = self._fields.chosen(wanted)

        def made() -> _Selection:
            sectors = self._fields.select(names)
            return _Selection(sectors, Places(sectors, self.shared))

        return ExtendedModel(self, self._selections.get(names, made))

    def strata(self, names: tuple[str, ...]) -> np.ndarray:
        """(n_s, k, k) strata on the sectors of one class."""
        return self.shared.get(("strata", names), lambda: self._fields.projected(names, self._parts))

    def bulk(self, names: tuple[str, ...]) -> np.ndarray:
        """(10, k, k) unit-constant matrices on the sectors of one class."""
        strata = self.strata(names)
        return np.array([strata[self.constant_of_stratum == q].sum(axis=0) for q in range(len(E_FORM))])

    def extra(self, name: str, names: tuple[str, ...]) -> np.ndarray:
        """(k, k) matrix of an extra term on the sectors of one class."""
        return self.shared.get(
            ("extra", name, names), lambda: self._fields.extra(names, self._terms[name], self._matrices[name])
        )


@dataclass(frozen=True)
class Needs:
    """What a model must have for a list of effects; equal for lists that one model serves.

    Attributes
    ----------
    trained : name, kind and matrix (the function that builds it), and training values, of every term
    terms : the terms themselves, one of each name
    sectors : names of the sectors that the effects couple
    stretching : whether an effect changes dimensions
    """

    trained: tuple[tuple[Hashable, ...], ...]
    terms: tuple[ExtraTerm, ...] = field(compare=False)
    sectors: tuple[str, ...]
    stretching: bool

    @classmethod
    def of(cls, effects: Sequence[Effect]) -> Needs:
        """What all effects of a list need together; InputError where two have different terms of one name."""
        found: dict[str, tuple[str, ExtraTerm]] = {}
        for effect in effects:
            for term in effect.terms:
                other, same = found.setdefault(term.name, (effect.name, term))
                if other != effect.name and same.built != term.built:
                    raise InputError(
                        f"effects: {other} and {effect.name} have different terms of the name {term.name!r}; give that "
                        "of one of them another name"
                    )
        terms = tuple(term for _, term in found.values())
        return cls(
            trained=tuple((*term.built, term.training) for term in terms),
            terms=terms,
            sectors=tuple(dict.fromkeys(name for effect in effects for name in effect.sectors)),
            stretching=any(effect.stretch is not None for effect in effects),
        )


def extend_model(
    model: ElectroelasticModel,
    training: Sequence[PiezoConstants],
    effects: Sequence[Effect],
    band_Hz: float,
    *,
    accuracy: float = 1e-5,
) -> ExtendedModel:
    """The model on its driven sector, reduced to serve all effects of a list within their training ranges.

    Parameters
    ----------
    training : constants at which the basis is trained, the reference first
    accuracy : aimed-for relative error of Z, as in `reduce_model`
    """
    needs = Needs.of(effects)
    matrices = {term.name: term.of(model) for term in needs.terms}
    reduced = _driven(model, training, needs, matrices, band_Hz, accuracy)
    if model.domain.radii is not None:
        fields = RoundFields(model, reduced, training[0], needs.sectors)
    elif model.products.grid is not None and len(model.domain.symmetry) == 3:
        fields = BoxFields(model, reduced, training, needs.sectors)
    else:
        fields = MeshFields(model, reduced, training[0], needs.sectors)
    return _Source(fields, needs, matrices).model(())


def _driven(
    model: ElectroelasticModel,
    training: Sequence[PiezoConstants],
    needs: Needs,
    matrices: dict[str, sp.spmatrix],
    band_Hz: float,
    accuracy: float,
) -> ReducedModel:
    """The driven class, trained at the constants, with every further term, and with a stretch along every axis."""
    lossless = training[0].lossless()
    parts = _stretches(model, lossless.to_e_form().vector().real) if needs.stretching else {}
    trained = model.with_terms(parts, matrices)
    top = (2 * np.pi * band_Hz) ** 2
    points: list = [*training]
    for term in needs.terms:
        for value in term.training:
            # a spring leads to the same states as a mass; with its sign positive no mode has a negative eigenvalue
            points.append((lossless, {term.name: 0.3 * top * value if term.kind == "inertia" else value}))
    points += [(lossless, {name: 1.0}) for name in parts]
    return reduce_model(trained, points, band_Hz, accuracy=accuracy)


def _stretches(model: ElectroelasticModel, coefficients: np.ndarray) -> dict[str, np.ndarray]:
    """By name what a stretch s adds to Σ c_q H_q (4, 3, 4, 3): along each axis, or x and y together of a round body.

    To a part with k derivatives along the m stretched axes it adds s^(m − k) − 1 times that part.
    """
    tensor, s = np.tensordot(coefficients, model.unit_tensors, axes=1), 1 + _STRETCH
    added = {}
    for axes in ((0,), (1,), (2,)) if model.domain.radii is None else ((0, 1), (2,)):
        along = np.isin(np.arange(3), axes).astype(int)
        share = s ** (len(axes) - along[:, None] - along[None, :].astype(float)) - 1  # of H[f, a, g, b] by a, b
        added[f"stretch_{axes}"] = tensor * share[None, :, None, :]
    return added


def _strata(units: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parts of one constant and equal exponents: tensors (n_s, 4, 3, 4, 3), constants (n_s,), exponents (n_s, 3)."""
    parts: dict[tuple[int, tuple[int, ...]], np.ndarray] = {}
    for q, tensor in enumerate(units):
        for f, a, g, b in zip(*np.nonzero(tensor), strict=True):
            powers = tuple(1 - int(a == axis) - int(b == axis) for axis in range(3))
            parts.setdefault((q, powers), np.zeros_like(tensor))[f, a, g, b] = tensor[f, a, g, b]
    return np.array([*parts.values()]), np.array([q for q, _ in parts]), np.array([p for _, p in parts], dtype=float)


def _whole(units: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `_strata` with one stratum of each constant, for bodies that no effect stretches."""
    return units, np.arange(len(units)), np.zeros((len(units), 3))
