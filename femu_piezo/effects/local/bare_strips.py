"""Bare strips at the edges of electrodes: what freeing the potential there does to a reduced body.

A base field x leaves the charge R x on a strip where its potential was held. Let ψ be the static answers of the region
at the edge to the few patterns of such charges. The displacement and the potential of an answer are two separate ψ, and
from each displacement the base fields of its momentum are subtracted, so that inertia does not couple it to them. Then
ψᵗKψ, K the operator, is positive for displacements and negative for potentials, and never singular. In one ψ the two
parts could cancel after the subtraction, as they did on strips a few thicknesses wide. The amplitudes
a = −(ψᵗKψ)^-1 ψᵗK x make

    S(m) = xᵗKψ a + (…)ᵗ + aᵗψᵗKψ a    per base field

stationary, so its parts per unit constant are exact derivatives of S; and since S is homogeneous of degree one in the
constants, it is the sum of constant times derivative. The mesh of the region is graded to the end of the electrode, m
from the edge, where the field is singular; the inertia of ψ itself is left out. S starts as m² and is interpolated in
√m between a few widths, all parts with the same interpolation weights, since they partly cancel at the terminals.
With α the asymmetry of the strips, S is a sum of parts T, each at widths m x_i(α) with weights w_i:

    S(m, α) = Σ_T Σ_i w_i T(m x_i(α)).

The strips lie at both ends of a plate (`femu_piezo.effects.local.end_strips`), or along the rims of a disk or ring
(`femu_piezo.effects.local.rim_strips`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from scipy.interpolate import BarycentricInterpolator

from femu_piezo.effects.local.blocks import Blocks
from femu_piezo.effects.local.sectors import Sectors
from femu_piezo.forward.gradient_products import FIELDS
from femu_piezo.forward.linear_solver import factorize
from femu_piezo.forward.model import POTENTIAL_SCALE
from femu_piezo.material.constants import ElasticForm
from femu_piezo.threads import Once, in_parallel

#: Widest strip, as a mean of both ends, over the length of a plate or the distance between the radii; widths, over the
#: widest, at which S is computed, those above 1 only once the wider of two strips asks for them.
WIDEST = 0.1
NODES = np.array([0.03, 0.08, 0.22, 0.5, 0.75, 1.0, 1.5, 2.0])
#: Reach of the end region beyond the strip, in thicknesses; elements over half the thickness. Across the width each
#: element of the plate is divided so that the elements of the region represent the base fields: where they do not, the
#: sum of constant times derivative is off by 2 % of S at the reference, and by half of S away from it on some meshes.
REACH, _DEEP = 2.5, 4
#: Growth of element lengths away from the electrode's edge, and the smallest length, in half thicknesses.
_GROWTH, _SMALLEST = 1.7, 0.01
#: Order of the elements of the region.
ORDER = 2
#: Singular value, over the largest, below which a pattern of charge on a strip is left out (S is off by about its
#: square over that of a field's own charge, 1e-3 at most), and below which momenta are rounding.
_FAINT, ROUNDING = 1e-4, 1e-9


@dataclass(frozen=True)
class Part:
    """A part of S.

    Attributes
    ----------
    blocks : [n, 10] (r, r) ∂T/∂c of every e-form constant at the reference, at the first n widths
    relative : α → x (q,) and dx/dα (q,);  weights : w (q,)
    """

    blocks: Blocks
    relative: Callable[[float], tuple[np.ndarray, np.ndarray]]
    weights: np.ndarray

    def at(self, widths: np.ndarray, width: float, asymmetry: float) -> np.ndarray:
        """(3, 10, r, r): the part at a width m and an asymmetry, and its slopes in both; widths (w,) of the blocks."""
        relative, slopes = self.relative(asymmetry)
        shares, by_width = between_widths(widths[: len(self.blocks.inner)], width * relative)
        along = [
            self.weights @ shares,
            (self.weights * relative) @ by_width,
            (self.weights * width * slopes) @ by_width,
        ]
        return self.blocks.combined(np.array(along))


@dataclass(frozen=True)
class BareStrips:
    """S of strips, interpolated between several widths.

    Attributes
    ----------
    widths : (w,) m
    with_more_widths : makes these strips with more widths, for one wider than the last width
    """

    widths: np.ndarray
    parts: tuple[Part, ...]
    with_more_widths: Callable[[], BareStrips] | None = None

    def at(self, width: float, asymmetry: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """∂S/∂c (10, r, r) of strips of a width m, the widest m (1 + α) wide, and its slopes in m and in α."""
        if self.with_more_widths is not None and width * (1 + asymmetry) > self.widths[-1]:
            return self.with_more_widths().at(width, asymmetry)
        value, by_width, by_asymmetry = sum(part.at(self.widths, width, asymmetry) for part in self.parts)
        return value, by_width, by_asymmetry

    def embedded(self, numbers: np.ndarray, size: int) -> BareStrips:
        """These strips over `size` unknowns, in which the present unknowns have the given indices."""
        parts = tuple(replace(part, blocks=part.blocks.embedded(numbers, size)) for part in self.parts)
        further = None if self.with_more_widths is None else lambda: self.with_more_widths().embedded(numbers, size)
        return BareStrips(self.widths, parts, further)


def strips_at_nodes(
    widest: float,
    freed: Callable[[float], np.ndarray],
    parts: Callable[[np.ndarray, np.ndarray], tuple[Part, ...]],
    unequal: bool,
) -> BareStrips:
    """Strips computed at the `NODES` up to the widest one, and at the others once one is wider than that.

    Parameters
    ----------
    widest : of equal strips, m;  unequal : whether one of several strips may be wider
    freed : width → (p, 10, k, k) ∂T/∂c of p − 1 single strips, and the rest of ∂S/∂c of all strips together
    parts : of the single strips (p − 1, w, 10, k, k) and of the rest (n, 10, k, k)
    """
    usual, kept = np.count_nonzero(NODES <= 1), Once()

    def matrices(nodes: np.ndarray) -> np.ndarray:
        return np.array(list(in_parallel(freed, (widest * nodes).tolist()))).swapaxes(0, 1)

    def strips(found: np.ndarray) -> BareStrips:
        return BareStrips(widest * NODES[: found.shape[1]], parts(found[:-1], found[-1][:usual]))

    def further() -> BareStrips:
        return strips(np.concatenate([first, matrices(NODES[usual:])], axis=1))

    first = matrices(NODES[:usual])
    return replace(strips(first), with_more_widths=(lambda: kept.get("further", further)) if unequal else None)


def between_widths(widths: np.ndarray, width: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """(…, n) weights of values at widths (n,), (m/m_k)² times Lagrange polynomials of √m, and their slopes in m.

    width : m, () or (…,)
    """
    width = np.asarray(width, dtype=float)[..., None]
    root, lagrange = np.sqrt(width), BarycentricInterpolator(np.sqrt(widths), np.eye(widths.size), rng=0)
    value, slope = lagrange(root[..., 0]), lagrange.derivative(root[..., 0])
    return value * (width / widths) ** 2, (2 * value * width + 0.5 * slope * root**3) / widths**2


class Forms(Protocol):
    """Forms on fields (4n, k) of a region; `mass` (4n, 4n), kg."""

    mass: sp.spmatrix

    def between(self, left: np.ndarray, right: np.ndarray, tensors: Sequence[np.ndarray]) -> np.ndarray:
        """(n_tensors, k, l) forms of extended tensors between fields (4n, k) and (4n, l)."""

    def within(self, fields: np.ndarray, tensors: Sequence[np.ndarray]) -> np.ndarray:
        """(n_tensors, k, k) forms of extended tensors on fields (4n, k)."""


@dataclass(frozen=True)
class Base:
    """Base fields of the body: its displacement unknowns and the hot potential, with the inner potentials condensed.

    The answer of the inner potentials to a strip is left to ψ. No form of the body couples fields of different parity.

    Attributes
    ----------
    kept : (k,) index of each base field among all unknowns
    odd : (k,) whether each is odd about the middle
    fields : (4n, k) on the mesh of the body
    momenta : (k − 1, k − 1) ∫ ρ u·v of the displacements
    bulk : (10, k, k) forms of the unit constants
    constants : (10,) e-form, real;  units : their extended tensors
    """

    kept: np.ndarray
    odd: np.ndarray
    fields: np.ndarray
    momenta: np.ndarray
    bulk: np.ndarray
    constants: np.ndarray
    units: np.ndarray

    @property
    def tensor(self) -> np.ndarray:
        """(4, 3, 4, 3) extended tensor of the constants."""
        return np.tensordot(self.constants, self.units, axes=1)

    @classmethod
    def of(cls, sectors: Sectors, fields: np.ndarray, forms: Forms, constants: ElasticForm, units) -> Base:
        """From the fields (4n, r) of all unknowns: displacements, inner potentials, hot potential."""
        values, size = constants.vector().real, fields.shape[1]
        odd = sectors.member > 0
        of_units = forms.within(fields, units) * (odd[:, None] == odd)
        matrix = np.tensordot(values, of_units, axes=1)
        inner, kept = np.arange(sectors.displacements, size - 1), np.append(np.arange(sectors.displacements), size - 1)
        combined = np.eye(size)[:, kept]
        combined[inner] = -np.linalg.solve(matrix[np.ix_(inner, inner)], matrix[np.ix_(inner, kept)])
        condensed, odd = fields @ combined, odd[kept]
        momenta = condensed[:, :-1].T @ (forms.mass @ condensed[:, :-1]) * (odd[:-1, None] == odd[:-1])
        return cls(kept, odd, condensed, momenta, combined.T @ of_units @ combined, values, units)


def in_region(probe: sp.csr_matrix, fields: np.ndarray) -> np.ndarray:
    """(4n, k) values in a region of fields (4n', k) of the body; probe : (n, n') values of one component."""
    return np.concatenate([probe @ part for part in np.split(fields, FIELDS)])


def answers(
    restricted: Callable[[sp.csr_matrix], sp.csr_matrix], held: np.ndarray, strip: np.ndarray, charges: np.ndarray
) -> np.ndarray:
    """(4n, r) ψ: static answers of a region to the patterns of charges (s, k) on a strip; displacements come first.

    restricted : prolongation P (4n, m) from the free unknowns → PᵗKP of the operator K (4n, 4n)
    held : (4, n) values that are zero while the electrode covers the strip;  strip : (s,) its nodes
    """
    n, free, patterns = held.shape[1], ~held, _patterns(charges)
    free[3, strip] = True
    free = np.flatnonzero(free.ravel())
    scale = np.where(free >= 3 * n, POTENTIAL_SCALE, 1.0)
    prolongation = sp.csr_matrix((scale, (free, np.arange(free.size))), shape=(held.size, free.size))
    loads = np.zeros((held.size, patterns.shape[1]))
    loads[3 * n + strip] = patterns
    found = prolongation @ factorize(restricted(prolongation)).solve(prolongation.T @ loads)
    moved = np.arange(len(found))[:, None] < 3 * n
    apart = np.hstack([np.where(moved, found, 0.0), np.where(moved, 0.0, found)])
    return apart[:, np.any(apart, axis=0)]  # without piezoelectric coupling displacements are zero


@dataclass(frozen=True)
class Answers:
    """Forms of the static answers of a region, over this region alone.

    Attributes
    ----------
    within : (10, r, r) forms of the unit constants on the answers
    between : (10, k, r) forms of the unit constants between base fields and answers
    momentum : (k − 1, r) ∫ ρ u·v between the base fields that are displacements and the answers
    """

    within: np.ndarray
    between: np.ndarray
    momentum: np.ndarray

    @classmethod
    def of(cls, forms: Forms, interpolated: np.ndarray, found: np.ndarray, units: np.ndarray) -> Answers:
        """From base fields (4n, k) and answers (4n, r) on the region."""
        count = interpolated.shape[1]
        joined = forms.between(np.hstack([interpolated, found]), found, units)
        return cls(joined[:, count:], joined[:, :count], interpolated[:, :-1].T @ (forms.mass @ found))

    def condensed(self, base: Base, chosen: np.ndarray, ends: float) -> np.ndarray:
        """∂S/∂c (10, k, k) per part of the body on the chosen base fields (bool (k,)), zero on the others.

        ends : 1 where the answers are at both ends, with the parity of the base fields; ½ where they are at one
        """
        found = np.zeros_like(base.bulk)
        found[(..., *np.ix_(chosen, chosen))] = stationary(*self.without_momentum(base, chosen, ends), base.constants)
        return found

    def without_momentum(self, base: Base, chosen: np.ndarray, ends: float) -> tuple[np.ndarray, np.ndarray]:
        """`within` and `between` for the chosen base fields (bool (k,)), of ψ less those of these with its momentum."""
        moving, bulk = np.flatnonzero(chosen[:-1]), base.bulk[(..., *np.ix_(chosen, chosen))]
        share = np.zeros((bulk.shape[1], self.within.shape[1]))
        momenta = base.momenta[np.ix_(moving, moving)]
        share[: moving.size] = np.linalg.lstsq(momenta, ends * self.momentum[moving], rcond=ROUNDING)[0]
        between = ends * self.between[:, chosen]
        within = ends * self.within - share.T @ between - between.transpose(0, 2, 1) @ share
        return within + share.T @ bulk @ share, between - bulk @ share


def stationary(within: np.ndarray, crossed: np.ndarray, constants: np.ndarray) -> np.ndarray:
    """∂S/∂c (10, k, k) at the stationary amplitudes.

    within, crossed : forms (10, r, r) on the answers and (10, k, r) with the base fields;  constants : (10,)
    """
    whole, joined = (np.tensordot(constants, part, axes=1) for part in (within, crossed))
    amplitudes = -np.linalg.solve(whole, joined.T)
    half = crossed @ amplitudes
    return half + half.transpose(0, 2, 1) + amplitudes.T @ within @ amplitudes


def _patterns(charges: np.ndarray) -> np.ndarray:
    """(s, r) the few orthonormal patterns of the charges (s, k) that smooth fields leave on a strip."""
    patterns, singular, _ = np.linalg.svd(charges, full_matrices=False)
    return patterns[:, singular > _FAINT * singular[0]]


def deep(height: float) -> np.ndarray:
    """(n,) ends of elements along z, m, finest at the face; height : half the thickness."""
    return height * (1 - np.linspace(1.0, 0.0, _DEEP + 1) ** 2)


def graded(start: float, edge: float, end: float, height: float) -> np.ndarray:
    """(n,) ends of elements along x, m, finest at the electrode's edge, at most 0.7 heights apart."""
    steps = [_SMALLEST * height]
    while sum(steps) < max(edge - start, end - edge):
        steps.append(min(steps[-1] * _GROWTH, 0.7 * height))
    away = np.concatenate([[0.0], np.cumsum(steps)])
    left, right = (_fitted(away, reach) for reach in (edge - start, end - edge))
    return np.concatenate([edge - left[:0:-1], edge + right])


def _fitted(away: np.ndarray, reach: float) -> np.ndarray:
    """The first distances, stretched to end at `reach` exactly."""
    count = int(np.searchsorted(away, reach * (1 - 1e-9))) + 1
    return away[:count] * (reach / away[count - 1])
