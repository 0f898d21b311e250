"""Operators of a reduced body that effects at a place need: fields on its faces, slices, weights, deformations.

All are over the unknowns of some sectors. A weight w(x) over the whole body couples two parity classes by the part of w
whose parity is the product of theirs; on the computed part, which has 1/copies of the whole energy,

    A_ij = ∫_part w_χ a(v_i, v_j),    w_χ(x) = mean over the reflections R of χ(R) w(R x).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np
from scipy.interpolate import BarycentricInterpolator

from femu_piezo.effects.effect import LocalTerm
from femu_piezo.effects.local.bare_strips import BareStrips, in_region
from femu_piezo.effects.local.blocks import Blocks
from femu_piezo.effects.local.box_fields import SLICES, TAPERED
from femu_piezo.effects.local.end_strips import compute_bare_ends
from femu_piezo.effects.local.faces import Face
from femu_piezo.effects.local.mesh_fields import Flipped
from femu_piezo.effects.local.plane_stress import unstressed
from femu_piezo.effects.local.rim_strips import compute_bare_rims
from femu_piezo.effects.local.round_deformations import COUPLED, OVAL, WEDGE
from femu_piezo.effects.local.round_fields import ORDERS, RIMS, RoundFields
from femu_piezo.effects.local.sectors import DRIVEN, MODES_BEYOND, SPOT, Sectors
from femu_piezo.effects.local.spot import in_plane_stiffness
from femu_piezo.effects.local.weighted_forms import DEEPEST, cut_near
from femu_piezo.forward.gradient_products import FIELDS, reshaped_products
from femu_piezo.forward.revolution import Line, Section
from femu_piezo.geometry.reshaping import Reshaping
from femu_piezo.threads import Once, made_once

Made = TypeVar("Made")

#: Indices in the e-form of the elastic and of the piezoelectric constants.
ELASTIC, PIEZOELECTRIC = range(5), range(5, 8)
#: Number of reaches at which operators near edges are made.
_REACHES = 6
#: Eigenvalue of the elastic stiffness, over the square of the cutoff, below which an eigenvector moves without strain.
_RIGID = 1e-7


@dataclass(frozen=True)
class Slices:
    """Elastic operators of the slices of elements across the plate, on the side x > 0.

    Attributes
    ----------
    centres : (n,) m from the middle of the plate;  width : m
    matrices : [n, 5] (r, r) per unit of c11 c12 c13 c33 c44
    lateral : [n] (r, r) by the part of c^E that remains without stress on planes across x, per unit of c11 with the
        ratios of the reference constants
    """

    centres: np.ndarray
    width: float
    matrices: Blocks
    lateral: Blocks

    def embedded(self, numbers: np.ndarray, size: int) -> Slices:
        """These operators over `size` unknowns, in which the present unknowns have the given indices."""
        return replace(
            self, matrices=self.matrices.embedded(numbers, size), lateral=self.lateral.embedded(numbers, size)
        )


@dataclass(frozen=True)
class Deformation:
    """What a deformation of the body of size ε adds to the operators.

    Attributes
    ----------
    first, second : [10] (r, r) stiffness per unit of every e-form constant, in ε and in ε²
    inertia, inertia_second : [...] (r, r) mass in ε and in ε²; None where the latter is zero
    """

    first: Blocks
    second: Blocks
    inertia: Blocks
    inertia_second: Blocks | None = None

    def embedded(self, numbers: np.ndarray, size: int) -> Deformation:
        """These operators over `size` unknowns, in which the present unknowns have the given indices."""
        parts = (self.first, self.second, self.inertia, self.inertia_second)
        return Deformation(*(part if part is None else part.embedded(numbers, size) for part in parts))

    def terms(self, places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
        """Terms of an effect whose only parameter is ε (`femu_piezo.effects.effect.LocalHook`)."""
        size, found = p[0], []
        powers = ((size, 1.0), (size**2, 2 * size))
        for heavy, (value, slope) in zip((self.inertia, self.inertia_second), powers, strict=True):
            if heavy is not None:
                matrix = places.of_displacements(heavy[...])
                found.append(LocalTerm.constant_over(omega, "inertia", matrix, value, [slope]))
        for matrices, (value, slope) in zip((self.first, self.second), powers, strict=True):
            for constant, matrix in enumerate(matrices[...]):
                found.append(LocalTerm.constant_over(omega, "stiffness", matrix, value, [slope], constant))
        return found


def stiffness_terms(
    constants: Iterable[int], value: np.ndarray, slopes: Sequence[np.ndarray], omega: np.ndarray
) -> list[LocalTerm]:
    """Terms for matrices that depend on the parameters of an effect otherwise than by a factor.

    Parameters
    ----------
    constants : n indices in the e-form
    value : (n, r, r) matrix per unit of each constant;  slopes : (n, r, r) of it in every parameter of the effect
    """
    found, none = [], np.zeros(len(slopes))
    for number, constant in enumerate(constants):
        found.append(LocalTerm.constant_over(omega, "stiffness", value[number], 1.0, none, constant))
        for unit, slope in zip(np.eye(len(slopes)), slopes, strict=True):
            found.append(LocalTerm.constant_over(omega, "stiffness", slope[number], 0.0, unit, constant))
    return found


@dataclass(frozen=True)
class Edges:
    """Piezoelectric operators near the edges of a body, with a weight that falls as e^(−d/ρ).

    Attributes
    ----------
    reaches : (n,) ρ, m
    matrices : [n, 3] (r, r) per unit of e31 e33 e15 and per metre of ρ
    """

    reaches: np.ndarray
    matrices: Blocks

    def at(self, reach: float) -> tuple[np.ndarray, np.ndarray]:
        """Matrices (3, r, r) at a reach ρ, interpolated as ρ times a polynomial of ρ, and their slopes in ρ."""
        lagrange = BarycentricInterpolator(self.reaches, np.eye(self.reaches.size), rng=0)
        value, slope = lagrange(reach), lagrange.derivative(reach)
        return self.matrices.combined(reach * value), self.matrices.combined(value + reach * slope)

    def embedded(self, numbers: np.ndarray, size: int) -> Edges:
        """These operators over `size` unknowns, in which the present unknowns have the given indices."""
        return Edges(self.reaches, self.matrices.embedded(numbers, size))


@dataclass(frozen=True)
class Uneven:
    """Stiffness [2, 5] and inertia [2] that vary along the body (`Places.uneven`)."""

    stiffness: Blocks
    inertia: Blocks

    @property
    def blocks(self) -> tuple[Blocks, Blocks]:
        """Stiffness and inertia."""
        return self.stiffness, self.inertia

    def embedded(self, numbers: np.ndarray, size: int) -> Uneven:
        """These operators over `size` unknowns, in which the present unknowns have the given indices."""
        return Uneven(*(part.embedded(numbers, size) for part in self.blocks))


class Places:
    """Operators on some of the sectors of a reduced body, each made once when it is first asked for.

    Parameters
    ----------
    sectors : the unknowns
    shared : operators that other selections of sectors made, each on those sectors only that it acts on
    """

    def __init__(self, sectors: Sectors, shared: Once) -> None:
        self.sectors, self._shared = sectors, shared

    @property
    def size(self) -> int:
        """Number of unknowns r, u of them displacements."""
        return self.sectors.size

    def of_displacements(self, matrix: np.ndarray) -> np.ndarray:
        """(u, u) of a matrix (r, r)."""
        u = self.sectors.displacements
        return matrix[:u, :u]

    @made_once
    def face(self) -> Face:
        """Displacements on one face."""
        return self.sectors.all_fields.face(self.sectors.names)

    @made_once
    def levels(self) -> list[tuple[float, Face]]:
        """Displacements at some heights, with the shares of the thickness that these stand for."""
        return self.sectors.all_fields.levels(self.sectors.names)

    @property
    def copies(self) -> int:
        """Number of parts of the whole body, on one of which uᵗMu = 1."""
        return self.sectors.all_fields.model.domain.copies

    @property
    def cutoff_omega(self) -> float:
        """Ω, rad/s: modes of other classes than the driven one are kept below it."""
        return 2 * np.pi * self.sectors.all_fields.reduced.band_Hz * np.sqrt(MODES_BEYOND)

    @property
    def spot(self) -> np.ndarray:
        """(3,) indices of the unknowns that are the displacement of an attached body; empty without that sector."""
        return self.sectors.spot

    @made_once
    def elastic_flexibility(self) -> np.ndarray:
        """(u, j) R such that R Rᵗ is the static flexibility of the whole body by c^E alone, without rigid motions."""
        tensor = self._whole.copy()
        tensor[3], tensor[:, :, 3] = 0.0, 0.0
        stiffness = np.zeros((self.size, self.size))
        for names in self.sectors.classes.values():
            at = self.sectors.numbers(names)
            stiffness[np.ix_(at, at)] = self.sectors.all_fields.projected(names, [tensor])[0]
        values, vectors = np.linalg.eigh(self.copies * self.of_displacements(stiffness))
        strained = values > _RIGID * self.copies * self.cutoff_omega**2
        return vectors[:, strained] / np.sqrt(values[strained])

    @made_once
    def in_plane_stiffness(self) -> np.ndarray:
        """(3, 3) c̄ of a spot (`femu_piezo.effects.local.spot`), at the reference constants."""
        return in_plane_stiffness(self._whole)

    @made_once
    def _whole(self) -> np.ndarray:
        """(4, 3, 4, 3) extended tensor of the reference constants."""
        fields = self.sectors.all_fields
        return np.tensordot(fields.constants.vector().real, fields.model.unit_tensors, axes=1)

    @made_once
    def slices(self) -> Slices:
        """Slices across the plate, on the driven class and that of flipped parity about x."""
        return self._made(_slices, lambda flipped, name: flipped in ((), (0,)))

    @made_once
    def ramp(self) -> Blocks:
        """[2, 3] (r, r) per unit of e31 e33 e15 with the weights 2x/L and (2x/L)² − 1/3 over the whole plate."""
        return self._made(_ramp, lambda flipped, name: not name.endswith(SLICES))

    @made_once
    def uneven(self) -> tuple[Blocks, Blocks]:
        """[2, 5] (r, r) per unit of c11 c12 c13 c33 c44, and [2] inertia, with the weights 2x/L and (2x/L)² − 1/3.

        On the driven class and that of flipped parity about x.
        """
        return self._made(_uneven, lambda flipped, name: flipped in ((), (0,)) and not name.endswith(SLICES)).blocks

    @made_once
    def radial_ramp(self) -> Blocks:
        """[3] (r, r) per unit of e31 e33 e15 of a disk or ring, with the weight (r/R)² less its mean over the face."""
        return self._made(_radial_ramp, lambda flipped, name: name == DRIVEN)

    @made_once
    def bare_ends(self) -> BareStrips:
        """Bare strips at both ends of a thickness-poled plate, or along the rims of a disk or ring.

        On the driven class and, where they are selected, the modes that are odd about the middle of a plate, or the
        fields of order 1.
        """
        return self._made(_bare_ends, lambda flipped, name: name in (DRIVEN, "x", ORDERS[1], RIMS))

    @made_once
    def edges(self) -> Edges:
        """Piezoelectric operators near the sides of a plate, or the rims of a disk or ring."""
        return self._made(_edges, lambda flipped, name: name == DRIVEN)

    @made_once
    def taper(self) -> Deformation:
        """Deformation of a plate to the width W (1 + ε ξ), ξ = 2x/L."""
        return self._tapered("taper")

    @made_once
    def wedge(self) -> Deformation:
        """Deformation to the thickness t (1 + ε ξ) of a plate, or t (1 + ε x/R) of a disk or ring."""
        if isinstance(self.sectors.all_fields, RoundFields):
            return self._round_deformation(WEDGE)
        return self._tapered("wedge")

    @made_once
    def oval(self) -> Deformation:
        """Deformation of a disk or ring to the diameters D e^ε and D e^−ε."""
        return self._round_deformation(OVAL)

    def reshaped(self, reshaping: Reshaping) -> Deformation:
        """Deformation by a map that keeps the symmetry of the body, and so acts on the driven class alone."""
        make = self._shared.get(("reshaped", reshaping), lambda: partial(_reshaped, reshaping))
        return self._made(make, lambda flipped, name: name == DRIVEN)

    def _tapered(self, kind: str) -> Deformation:
        return self._made(_TAPERED[kind], lambda flipped, name: flipped in ((), (0,)) and not name.endswith(SLICES))

    def _round_deformation(self, kind: str) -> Deformation:
        order = ORDERS[COUPLED[kind]]
        return self._made(_DEFORMED[kind], lambda flipped, name: flipped == order or name == DRIVEN)

    @made_once
    def films(self) -> Blocks:
        """[...] (r, r) ∫ v·u over one electrode, m² per unit of displacement².

        Between the driven class and that of flipped parity about the plane between the electrodes.
        """
        return self._made(_films, lambda flipped, name: flipped in ((), (2,)) and not name.endswith(SLICES))

    def _made(self, make: Callable[[Sectors], Made], concerns: Callable[[Hashable, str], bool]) -> Made:
        """An operator over all unknowns, made on the sectors that it acts on, without a spot.

        concerns : class and name of a sector → whether the operator acts on it
        """
        class_of = self.sectors.all_fields.class_of
        names = tuple(name for name in self.sectors.names if name != SPOT and concerns(class_of(name), name))
        few = Sectors(names, self.sectors.all_fields)
        found = self._shared.get((make, names), lambda: make(few))
        return found if names == self.sectors.names else found.embedded(self.sectors.numbers(names), self.size)


def _slices(sectors: Sectors) -> Slices:
    """Operators of the slices on all unknowns of the sectors."""
    weighted, constants = sectors.all_fields.weighted, sectors.all_fields.constants
    at, units = np.arange(sectors.size), weighted.model.unit_tensors
    fields = np.empty((FIELDS, weighted.model.basis.N, at.size))
    for names in sectors.classes.values():
        fields[:, :, sectors.numbers(names)] = sectors.all_fields.fields(names)
    whole = np.tensordot(constants.vector().real, units, axes=1)
    tensors = [*units[ELASTIC.start : ELASTIC.stop], unstressed(whole, 0)]
    # a weight on the slice at x > 0 alone is half an even and half an odd one
    inner = np.array([0.5 * products.within(fields, tensors) for products in weighted.slices])
    ends = weighted.slice_ends
    matrices, lateral = Blocks(inner[:, :-1], at, at.size), Blocks(inner[:, -1] / constants.c11.real, at, at.size)
    return Slices((ends[1:] + ends[:-1]) / 2, float(ends[-1] / len(inner)), matrices, lateral)


def _bare_ends(sectors: Sectors) -> BareStrips:
    return (compute_bare_rims if isinstance(sectors.all_fields, RoundFields) else compute_bare_ends)(sectors)


def _ramp(sectors: Sectors) -> Blocks:
    """The odd weight couples classes whose parities differ about x alone, the even one each class with itself.

    Loads that vary slowly hardly drive the local responses of slices: ramps, films and tapers go without these.
    """
    weighted, size = sectors.all_fields.weighted, sectors.size
    found, concerned = np.zeros((2, len(PIEZOELECTRIC), size, size)), []
    units = weighted.model.unit_tensors[PIEZOELECTRIC.start : PIEZOELECTRIC.stop]
    for flipped, names in sectors.classes.items():
        partner = sectors.classes.get(tuple(sorted(set(flipped) ^ {0})))
        if partner is not None:
            at, fields = sectors.numbers(names), sectors.all_fields.fields(names)
            concerned.append(at)
            _put(found[1], weighted.even.within(fields, units), at)
            if 0 not in flipped:
                across = weighted.odd.between(fields, sectors.all_fields.fields(partner), units)
                _put(found[0], across, at, sectors.numbers(partner))
    few = np.sort(np.concatenate([np.zeros(0, dtype=int), *concerned]))
    return Blocks(np.ascontiguousarray(found[(..., *np.ix_(few, few))]), few, size)


def _uneven(sectors: Sectors) -> Uneven:
    """The odd weight couples the driven class to that of flipped parity about x, the even one each with itself."""
    weighted, size, at = sectors.all_fields.weighted, sectors.size, np.arange(sectors.size)
    (rows, columns), (left, right) = _coupled(sectors, (0,))
    units = weighted.model.unit_tensors[ELASTIC.start : ELASTIC.stop]
    stiff, heavy = np.zeros((2, len(units), size, size)), np.zeros((2, size, size))
    _put(stiff[0], weighted.odd.between(left, right, units), rows, columns)
    odd = weighted.mass(weighted.odd_line, right[:3]).reshape(-1, columns.size)
    _put(heavy[0], left[:3].reshape(-1, rows.size).T @ odd, rows, columns)
    for numbers, fields in ((rows, left), (columns, right)):
        _put(stiff[1], weighted.even.within(fields, units), numbers)
        even = weighted.mass(weighted.even_line, fields[:3]).reshape(-1, numbers.size)
        _put(heavy[1], fields[:3].reshape(-1, numbers.size).T @ even, numbers)
    return Uneven(Blocks(stiff, at, size), Blocks(heavy, at, size))


def _radial_ramp(sectors: Sectors) -> Blocks:
    """On the driven fields alone: a weight that varies along the radius keeps the symmetry of revolution."""
    fields: RoundFields = sectors.all_fields
    inner, outer = fields.model.domain.radii
    order, units = fields.order(0), fields.model.unit_tensors[PIEZOELECTRIC.start : PIEZOELECTRIC.stop]
    weight = (order.radii / outer) ** 2 - (1 + (inner / outer) ** 2) / 2
    found = order.within(fields.on_section, units, weight)
    return Blocks(found, np.arange(sectors.size), sectors.size)


def _edges(sectors: Sectors) -> Edges:
    """On the driven fields alone: equal edges keep their symmetry."""
    fields = sectors.all_fields
    units = fields.model.unit_tensors[PIEZOELECTRIC.start : PIEZOELECTRIC.stop]
    nodes = (1 - np.cos(np.pi * (np.arange(_REACHES) + 0.5) / _REACHES)) / 2
    if isinstance(fields, RoundFields):
        reaches = DEEPEST * np.ptp(fields.model.domain.radii) * nodes
        found = _near_rims(fields, units, reaches)
    else:
        reaches = DEEPEST * 2 * min(fields.model.domain.mesh.p.max(axis=1)[:2]) * nodes
        driven = fields.fields([DRIVEN])
        found = np.array([fields.weighted.edges(reach).within(driven, units) for reach in reaches])
    return Edges(reaches, Blocks(found / reaches[:, None, None, None], np.arange(sectors.size), sectors.size))


def _near_rims(fields: RoundFields, units: np.ndarray, reaches: np.ndarray) -> np.ndarray:
    """(n, 3, r, r) forms of unit tensors with the weight 1 − Π (1 − e^(−d/ρ)), d the distances to the rims."""
    whole, (inner, outer) = fields.section, fields.model.domain.radii
    rims = np.array([inner, outer] if inner > 0 else [outer])
    found = []
    for reach in reaches:
        ends = np.unique(np.append(whole.radial.ends, cut_near(rims, reach, inner, outer)))
        fine = Section(Line(ends, whole.radial.order), whole.axial, whole.density)
        order = fine.order(0)
        kept = np.prod(-np.expm1(-np.abs(order.radii[:, None] - rims) / reach), axis=1)
        found.append(order.within(in_region(whole.to_nodes_of(fine), fields.on_section), units, 1 - kept))
    return np.array(found)


def _put(found: np.ndarray, block: np.ndarray, rows: np.ndarray, columns: np.ndarray | None = None) -> None:
    """Write a block (…, k, l) and its transpose into symmetric matrices (…, r, r); columns : as the rows where None."""
    found[(..., *np.ix_(rows, rows if columns is None else columns))] = block
    if columns is not None:
        found[(..., *np.ix_(columns, rows))] = np.swapaxes(block, -1, -2)


def _coupled(sectors: Sectors, flipped: Flipped) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Indices (k,) of the unknowns and fields (4, n, k), each of the driven class and of the class that is flipped."""
    classes = [sectors.classes[key] for key in ((), flipped)]
    return [sectors.numbers(names) for names in classes], [sectors.all_fields.fields(names) for names in classes]


def _films(sectors: Sectors) -> Blocks:
    classes = [sectors.classes[key] for key in ((), (2,))]
    found = np.zeros((sectors.size, sectors.size))
    _put(found, sectors.all_fields.film(*classes), *(sectors.numbers(names) for names in classes))
    return Blocks(found, np.arange(sectors.size), sectors.size)


def _tapered(side: int, sectors: Sectors) -> Deformation:
    """The first order couples the driven class to that of flipped parity about x, the second each with itself."""
    model, (first, second) = sectors.all_fields.weighted.model, sectors.all_fields.weighted.tapered(side)
    (rows, columns), (left, right) = _coupled(sectors, (0,))
    size, units = sectors.size, model.unit_tensors
    found, inertia = np.zeros((2, len(units), size, size)), np.zeros((size, size))
    _put(found[0], first.between(left, right, units), rows, columns)
    _put(found[1], second.within(left, units), rows)
    _put(found[1], second.within(right, units), columns)
    weighted = sectors.all_fields.weighted
    heavy = weighted.mass(weighted.odd_line, right[:3])
    _put(inertia, left[:3].reshape(-1, rows.size).T @ heavy.reshape(-1, columns.size), rows, columns)
    return Deformation(*(Blocks(matrices, np.arange(size), size) for matrices in (*found, inertia)))


def _deformed(kind: str, sectors: Sectors) -> Deformation:
    """The first order couples the driven fields to those of Fourier order m, the second couples them to themselves."""
    fields: RoundFields = sectors.all_fields
    deformation, units, size = fields.deformation(kind), fields.model.unit_tensors, sectors.size
    rows, columns = sectors.numbers([DRIVEN]), sectors.numbers(name for name in sectors.names if name != DRIVEN)
    driven, others = fields.on_section, fields.of_order(COUPLED[kind], sectors.names)
    found, inertia = np.zeros((2, len(units), size, size)), np.zeros((size, size))
    _put(found[0], deformation.first_order_forms(driven, others, units), rows, columns)
    _put(found[1], deformation.second_order_forms(driven, units), rows)
    _put(inertia, deformation.inertia(driven, others), rows, columns)
    return Deformation(*(Blocks(matrices, np.arange(size), size) for matrices in (*found, inertia)))


def _reshaped(reshaping: Reshaping, sectors: Sectors) -> Deformation:
    """On the driven fields alone."""
    model, reduced = sectors.all_fields.model, sectors.all_fields.reduced
    fields = (model.prolongation @ reduced.basis).reshape(FIELDS, model.basis.N, -1)
    moved, at = fields[:3, :, : reduced.displacements], np.arange(sectors.size)
    stiff, heavy = [], []
    for products in reshaped_products(model.basis, reshaping.gradient):
        stiff.append(Blocks(products.within(fields, model.unit_tensors), at, sectors.size))
        mass = sum(along.T @ products.mass_times(along) for along in moved) * model.density
        heavy.append(Blocks(mass, at[: moved.shape[2]], sectors.size))
    return Deformation(*stiff, *heavy)


#: Kind of a deformation of a round body, and of a plate → the function that makes it. Each function exists once, as
#: what it makes is kept under the function as key.
_DEFORMED = {kind: partial(_deformed, kind) for kind in COUPLED}
_TAPERED = {kind: partial(_tapered, side) for kind, side in TAPERED.items()}
