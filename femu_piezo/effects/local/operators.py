"""What effects at a place need of the reduced plate: fields at points of its faces, slices, and slopes along it.

All are stacked over the sectors. A weight w(x) over the whole plate couples two parity classes by the part of w that
has the product of their parities; on the part, with its share 1/copies of the whole energy,

    A_ij = ∫_part w_χ a(v_i, v_j),    w_χ(x) = mean over the reflections R of χ(R) w(R x).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.polynomial import legendre

from femu_piezo.effects.local.blocks import Blocks
from femu_piezo.effects.local.end_strips import BareEnds, measure_bare_ends
from femu_piezo.effects.local.symmetry_sectors import SLICES, SPOT, Sectors, flipped_axes
from femu_piezo.effects.local.weighted_forms import WeightedProducts
from femu_piezo.forward.box_interpolation import interpolation
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.material.constants import ElasticForm

Made = TypeVar("Made")

#: Points along length and width at which the fields of a face are sampled for interpolation by polynomials.
_SAMPLES = (18, 14)
#: Constants (numbers in the e-form) of the elastic and of the piezoelectric terms.
ELASTIC, PIEZOELECTRIC = range(5), range(5, 8)


@dataclass(frozen=True)
class Face:
    """Displacements on the face z = +t/2 of the positive octant as polynomials in ξ = 4x/L − 1, η = 4y/W − 1.

    Attributes
    ----------
    half : (L/2, W/2), m
    coefficients : (nx, ny, 3, u) Legendre coefficients of every displacement unknown
    group : (u,) number of the parity class of every displacement unknown
    copies : parts of the whole
    """

    half: tuple[float, float]
    coefficients: np.ndarray = field(repr=False)
    group: np.ndarray = field(repr=False)
    copies: int

    @property
    def same_class(self) -> np.ndarray:
        """(u, u) which unknowns a symmetric operator may couple."""
        return self.group[:, None] == self.group

    def at(self, x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
        """N (3, u) and its slopes ∂N/∂x, ∂N/∂y (2, 3, u) at a point 0 ≤ x ≤ L/2, 0 ≤ y ≤ W/2."""
        lines = [
            _line(value, half, self.coefficients.shape[i])
            for i, (value, half) in enumerate(zip((x, y), self.half, strict=True))
        ]
        (px, sx), (py, sy) = lines
        along = np.tensordot(px, self.coefficients, axes=1)
        n = np.tensordot(py, along, axes=1)
        slopes = [
            np.tensordot(py, np.tensordot(sx, self.coefficients, axes=1), axes=1),
            np.tensordot(sy, along, axes=1),
        ]
        return n, np.array(slopes)


def _line(value: float, half: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(count,) Legendre polynomials at 2·value/half − 1, and their slopes by value."""
    at = 2 * value / half - 1
    slopes = legendre.legval(at, legendre.legder(np.eye(count)))
    return legendre.legvander(np.array([at]), count - 1)[0], slopes * 2 / half


@dataclass(frozen=True)
class Slices:
    """Elastic operators of the slices of elements across the plate, on the side x > 0.

    Attributes
    ----------
    centres : (n,) m from the middle of the plate;  width : m
    matrices : [n, 5] (r, r) per unit of c11 c12 c13 c33 c44
    lateral : [n] (r, r) of what of c^E is left where a slice is free of stress along x, per unit of c11 and with the
        ratios of the reference constants
    """

    centres: np.ndarray
    width: float
    matrices: Blocks
    lateral: Blocks

    def select(self, keep: np.ndarray) -> Slices:
        """The same for some of the unknowns (indices)."""
        return replace(self, matrices=self.matrices.select(keep), lateral=self.lateral.select(keep))


@dataclass(frozen=True)
class Taper:
    """What a width W (1 + t ξ), ξ = 2x/L, adds to the operators.

    Attributes
    ----------
    first, second : [10] (r, r) per unit of every e-form constant, of t and of t²
    inertia : [...] (r, r) of t
    """

    first: Blocks
    second: Blocks
    inertia: Blocks

    def select(self, keep: np.ndarray) -> Taper:
        """The same for some of the unknowns (indices)."""
        return Taper(*(blocks.select(keep) for blocks in (self.first, self.second, self.inertia)))


@dataclass(frozen=True)
class Places:
    """Everything, each made once when it is first asked for.

    Parameters
    ----------
    weighted : of a part of a plate with all three mirror planes
    sectors : the unknowns
    constants : lossless reference
    whole, keep : where these are some of the unknowns of others, those and the indices there
    """

    weighted: WeightedProducts = field(repr=False)
    sectors: Sectors = field(repr=False)
    constants: ElasticForm
    whole: Places | None = None
    keep: np.ndarray | None = field(default=None, repr=False)

    @property
    def size(self) -> int:
        """Number of unknowns r, u of them displacements."""
        return self.sectors.member.size

    def select(self, names: Sequence[str]) -> Places:
        """The same on some of the sectors."""
        sectors, keep = self.sectors.select(names)
        whole, keep = (self, keep) if self.whole is None else (self.whole, self.keep[keep])
        return Places(self.weighted, sectors, self.constants, whole, keep)

    def of_displacements(self, matrix: np.ndarray) -> np.ndarray:
        """(u, u) of a matrix (r, r)."""
        u = self.sectors.displacements
        return matrix[:u, :u]

    @cached_property
    def face(self) -> Face:
        """Displacements on one face."""
        return _face(self.weighted.model, self.sectors)

    @cached_property
    def spot(self) -> np.ndarray:
        """(3,) unknowns that are the displacement of an attached body; empty where the sector is not there."""
        return np.flatnonzero(np.array(self.sectors.names)[self.sectors.member] == SPOT)

    @cached_property
    def slices(self) -> Slices:
        """Slices across the plate."""
        return self._made("slices", lambda: _slices(self.weighted, self.sectors, self.constants))

    @cached_property
    def ramp(self) -> Blocks:
        """[2, 3] (r, r) per unit of e31 e33 e15, weighted by 2x/L and by (2x/L)² − 1/3 over the whole plate."""
        return self._made("ramp", lambda: _ramp(self.weighted, self.sectors))

    @cached_property
    def bare_ends(self) -> BareEnds:
        """Bare strips at both ends of a thickness-poled plate."""
        return self._made("bare_ends", lambda: measure_bare_ends(self.weighted.model, self.sectors, self.constants))

    @cached_property
    def taper(self) -> Taper:
        """A width that varies along the plate."""
        return self._made("taper", lambda: _taper(self.weighted, self.sectors))

    @cached_property
    def films(self) -> Blocks:
        """[...] (r, r) ∫ v·u over one electrode, m² per unit of displacement².

        Between the driven class and that whose parity differs about the plane between the electrodes.
        """
        return self._made("films", lambda: _films(self.weighted, self.sectors))

    def _made(self, name: str, make: Callable[[], Made]) -> Made:
        return make() if self.whole is None else getattr(self.whole, name).select(self.keep)


def _face(model: ElectroelasticModel, sectors: Sectors) -> Face:
    ends = model.domain.mesh.p.max(axis=1)
    half = (float(ends[0]), float(ends[1]))
    nodes = [legendre.leggauss(count)[0] for count in _SAMPLES]
    x, y = ((node + 1) / 2 * length for node, length in zip(nodes, half, strict=True))
    grid = np.array([*(axis.ravel() for axis in np.meshgrid(x, y, indexing="ij")), np.full(x.size * y.size, ends[2])])
    probe = interpolation(model, grid)
    u = sectors.displacements
    values = np.stack([probe @ sectors.fields[axis][:, :u] for axis in range(3)])
    values = values.reshape(3, x.size, y.size, u)
    left, right = (np.linalg.inv(legendre.legvander(node, node.size - 1)) for node in nodes)
    coefficients = np.einsum("ia,jb,cabu->ijcu", left, right, values, optimize=True)
    group = np.zeros(u, dtype=int)
    for number, own in enumerate(sectors.classes.values()):
        group[own[own < u]] = number
    return Face(half, coefficients, group, model.domain.copies)


def _slices(weighted: WeightedProducts, sectors: Sectors, constants: ElasticForm) -> Slices:
    axes = [flipped_axes(name) for name in sectors.names]
    own = np.flatnonzero(np.isin(sectors.member, [i for i, a in enumerate(axes) if a in ((), (0,))]))
    fields, size = sectors.fields[:, :, own], sectors.member.size
    units = weighted.model.unit_tensors
    whole = np.tensordot(constants.vector().real, units, axes=1)
    tensors = [*units[ELASTIC.start : ELASTIC.stop], lateral_tensor(whole)]
    # the slice at x > 0 alone is half an even and half an odd weight
    inner = np.array([0.5 * products.within(fields, tensors) for products in weighted.slices])
    ends = weighted.slice_ends
    matrices, lateral = Blocks(inner[:, :-1], own, size), Blocks(inner[:, -1] / constants.c11.real, own, size)
    return Slices((ends[1:] + ends[:-1]) / 2, float(ends[-1] / len(inner)), matrices, lateral)


def lateral_tensor(whole: np.ndarray) -> np.ndarray:
    """c_abcd − c_abkx (c_kxlx)^-1 c_lxcd (4, 4, 4, 4) of a coupled tensor: c^E at T_xx = T_xy = T_xz = 0, no field."""
    c = whole[:3, :, :3]
    found = np.zeros_like(whole)
    normal = np.linalg.inv(c[:, 0, :, 0])
    found[:3, :, :3] = c - np.einsum("iak,kl,ljb->iajb", c[:, :, :, 0], normal, c[:, 0])
    return found


def _smooth_classes(sectors: Sectors) -> dict[tuple[int, ...], np.ndarray]:
    """The unknowns of each parity class but those of spots and slices, which what varies slowly hardly moves."""
    rough = [i for i, name in enumerate(sectors.names) if name.endswith((SPOT, SLICES))]
    return {group: own[~np.isin(sectors.member[own], rough)] for group, own in sectors.classes.items()}


def _ramp(weighted: WeightedProducts, sectors: Sectors) -> Blocks:
    """The odd weight couples classes whose parities differ about x alone, the even one each class with itself."""
    size = sectors.member.size
    found = np.zeros((2, len(PIEZOELECTRIC), size, size))
    groups, units = _smooth_classes(sectors), weighted.model.unit_tensors[PIEZOELECTRIC.start : PIEZOELECTRIC.stop]
    for flipped, own in groups.items():
        partner = tuple(sorted(set(flipped) ^ {0}))
        if partner in groups:
            _put(found[1], weighted.even.within(sectors.fields[:, :, own], units), own)
            if 0 not in flipped:
                left, right = (sectors.fields[:, :, one] for one in (own, groups[partner]))
                _put(found[0], weighted.odd.between(left, right, units), own, groups[partner])
    return Blocks.of(found, np.flatnonzero(np.any(found, axis=(0, 1, 2))))


def _put(found: np.ndarray, block: np.ndarray, rows: np.ndarray, columns: np.ndarray | None = None) -> None:
    """Write blocks (…, k, l) to rows and columns of symmetric (…, r, r); a block of rows with themselves without."""
    found[(..., *np.ix_(rows, rows if columns is None else columns))] = block
    if columns is not None:
        found[(..., *np.ix_(columns, rows))] = np.swapaxes(block, -1, -2)


def _films(weighted: WeightedProducts, sectors: Sectors) -> Blocks:
    groups = _smooth_classes(sectors)
    left, right = (sectors.fields[:, :, own].reshape(-1, own.size) for own in (groups[()], groups[2,]))
    found = np.zeros((sectors.member.size, sectors.member.size))
    _put(found, left.T @ (weighted.film @ right), groups[()], groups[2,])
    return Blocks.of(found, np.sort(np.concatenate([groups[()], groups[2,]])))


def _taper(weighted: WeightedProducts, sectors: Sectors) -> Taper:
    """The first order couples the driven class to that whose parity differs about x, the second each with itself."""
    groups, size = _smooth_classes(sectors), sectors.member.size
    units, (first, second) = weighted.model.unit_tensors, weighted.tapered
    rows, columns = groups[()], groups[0,]
    found, inertia = np.zeros((2, len(units), size, size)), np.zeros((size, size))
    left, right = (sectors.fields[:, :, own] for own in (rows, columns))
    _put(found[0], first.between(left, right, units), rows, columns)
    _put(found[1], second.within(left, units), rows)
    _put(found[1], second.within(right, units), columns)
    left, right = (fields.reshape(-1, fields.shape[2]) for fields in (left, right))
    _put(inertia, left.T @ (first.mass_matrix(weighted.model.density) @ right), rows, columns)
    both = np.sort(np.concatenate([rows, columns]))
    return Taper(*(Blocks.of(matrices, both) for matrices in (*found, inertia)))
