"""Forms on a part of a plate with weights along its length and width, as Kronecker products of one-dimensional forms.

A weight that is a product of functions of x and of y changes the factors along these axes only, so no weighted operator
is assembled or kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from femu_piezo.forward.gradient_products import ScalarProducts
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.tensor_grid import kronecker_times, line_products
from femu_piezo.geometry.boxes import divided
from femu_piezo.threads import made_once

#: Least number of slices across the part along its length.
_SLICES = 16
#: Largest reach of effects at edges, over the shortest side of a face or the distance between rims.
DEEPEST = 0.1
#: Distances from an edge, over the reach, between which e^−(distance / reach) is nearly a polynomial of element order.
_CUTS = np.array([0.0, 1.0, 2.0, 4.0, 7.0, 11.0, 16.0])
#: Coefficient and the factors along x, y, z of one Kronecker product.
Kronecker = tuple[float, tuple[np.ndarray, np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class SeparableProducts(ScalarProducts):
    """Gradient products G_ab that are sums of Kronecker products on some planes of nodes across x.

    Attributes
    ----------
    size : number n of nodes of the whole part;  nodes : (m,) those on the planes, the last axis fastest
    terms : (a, b) → Kronecker products whose sum is G_ab; none where it is zero
    """

    size: int
    nodes: np.ndarray
    terms: Mapping[tuple[int, int], Sequence[Kronecker]]

    def times(self, a: int, b: int, vectors: np.ndarray) -> np.ndarray:
        """G_ab times vectors (m, k)."""
        found = np.zeros_like(vectors)
        for coefficient, factors in self.terms.get((a, b), ()):
            found += coefficient * kronecker_times(factors, vectors)
        return found


def cut_near(edges: np.ndarray, reach: float, left: float, right: float) -> np.ndarray:
    """(n,) places from left to right that cut e^(−d/ρ), d the distance to the nearest edge, ρ the reach, at `_CUTS`."""
    cuts = (edges[:, None] + reach * np.concatenate([-_CUTS, _CUTS])).ravel()
    return np.concatenate([[left], np.unique(cuts[(cuts > left) & (cuts < right)]), [right]])


class WeightedProducts:
    """Weighted gradient products and masses of a box of hexahedra, one part of a plate that is cut at x = 0.

    Parameters
    ----------
    model : the part with its scalar basis of n degrees of freedom
    """

    def __init__(self, model: ElectroelasticModel) -> None:
        self.model = model

    @property
    def _grid(self):
        return self.model.products.grid

    @made_once
    def slices(self) -> list[SeparableProducts]:
        """Products over each slice across the part, by growing x; a long element has several slices."""
        grid, found = self._grid, []
        planes = grid.order.reshape(grid.places[0].size, -1)
        order = (grid.places[0].size - 1) // (grid.lines[0].size - 1)
        for left, right in pairwise(self.slice_ends):
            element = int(np.searchsorted(grid.lines[0], (left + right) / 2)) - 1
            nodes = slice(element * order, element * order + order + 1)
            along = line_products(grid.places[0][nodes], left, right)
            found.append(SeparableProducts(self.model.basis.N, planes[nodes].ravel(), self._along_x(along)))
        return found

    @property
    def slice_ends(self) -> np.ndarray:
        """(slices + 1,) places along x where the slices meet, m."""
        line = self._grid.lines[0]
        return divided(line, -(-_SLICES // (line.size - 1)))

    @made_once
    def odd(self) -> SeparableProducts:
        """Products with the weight 2x/L."""
        return self._all(self._along_x(self.odd_line))

    @made_once
    def even(self) -> SeparableProducts:
        """Products with the weight (2x/L)² − 1/3, whose mean is zero."""
        return self._all(self._along_x(self.even_line))

    @made_once
    def odd_line(self) -> np.ndarray:
        """(2, 2, n, n) one-dimensional products with the weight 2x/L."""
        return self._power(0, 1)

    @made_once
    def even_line(self) -> np.ndarray:
        """(2, 2, n, n) one-dimensional products with the weight (2x/L)² − 1/3."""
        return self._grid.weighted(0, lambda x: (x / self._half) ** 2 - 1 / 3)

    def tapered(self, side: int) -> tuple[SeparableProducts, SeparableProducts]:
        """Parts of first and second order in t, of an extent along axis `side`, 1 or 2, of (1 + t ξ) times the box's.

        With ξ = 2x/L the map y → y (1 + t ξ), of the width, turns ∂_x into ∂_x − t η/(1 + tξ) ∂_y with η = 2y/L, ∂_y
        into ∂_y/(1 + tξ), and dV into (1 + tξ) dV; that of the thickness does the same with z.
        """
        xi, other = self._power(0, 1), 3 - side

        def along(a: int, b: int, sign: float = 1.0) -> Kronecker:
            return self._term(a, b, sign, {0: xi})

        def across(a: int, b: int) -> Kronecker:
            return self._term(a, b, -1.0, {side: self._power(side, 1)})

        first = {
            (0, 0): [along(0, 0), across(0, side), across(side, 0)],
            (side, side): [along(side, side, -1.0)],
            (other, other): [along(other, other)],
            (0, side): [across(side, side)],
            (side, 0): [across(side, side)],
            (0, other): [along(0, other), across(side, other)],
            (other, 0): [along(other, 0), across(other, side)],
        }
        mixed = [self._term(side, side, 1.0, {0: xi, side: self._power(side, 1)})]
        second = {
            (0, 0): [self._term(side, side, 1.0, {side: self._power(side, 2)})],
            (side, side): [self._term(side, side, 1.0, {0: self._power(0, 2)})],
            (0, side): mixed,
            (side, 0): mixed,
        }
        return self._all(first), self._all(second)

    def edges(self, reach: float) -> SeparableProducts:
        """Products with the weight 1 − (1 − e^(−d_x/ρ)) (1 − e^(−d_y/ρ)), d the distances to the nearest sides."""
        x, y = (self._near_end(axis, reach) for axis in (0, 1))
        parts = ((1.0, {0: x}), (1.0, {1: y}), (-1.0, {0: x, 1: y}))
        return self._all({(a, b): [self._term(a, b, *part) for part in parts] for a in range(3) for b in range(3)})

    def _near_end(self, axis: int, reach: float) -> np.ndarray:
        """(2, 2, n, n) one-dimensional products with the weight e^(−d/ρ), d the distance to the end of the part."""
        line, places = self._grid.lines[axis], self._grid.places[axis]
        order, found = (places.size - 1) // (line.size - 1), np.zeros((2, 2, places.size, places.size))
        for element, (left, right) in enumerate(pairwise(line)):
            at = slice(element * order, element * order + order + 1)
            for low, high in pairwise(cut_near(line[-1:], reach, left, right)):
                found[:, :, at, at] += line_products(places[at], low, high, lambda x: np.exp((x - line[-1]) / reach))
        return found

    def mass(self, line: np.ndarray, displacements: np.ndarray) -> np.ndarray:
        """The mass matrix ∫ ρ w v·u times displacements (3, n, k): (3, n, k), kg.

        line : (2, 2, n, n) one-dimensional products along x with the weight w; with w = ξ the mass is the part of first
            order in t of either taper
        """
        grid, found = self._grid, np.empty_like(displacements)
        factors = (line[0, 0], *(axis[0, 0] for axis in grid.axes[1:]))
        for part, image in zip(displacements, found, strict=True):
            image[grid.order] = self.model.density * kronecker_times(factors, part[grid.order])
        return found

    @property
    def _half(self) -> float:
        """L/2, m."""
        return float(self._grid.lines[0][-1])

    def _power(self, axis: int, power: int) -> np.ndarray:
        """(2, 2, n, n) one-dimensional products along an axis with the weight (2x/L)^power, likewise of y or z."""
        return self._grid.weighted(axis, lambda place: (place / self._half) ** power)

    def _term(self, a: int, b: int, coefficient: float, weighted: Mapping[int, np.ndarray]) -> Kronecker:
        """coefficient · ∫ w ∂_aφ_i ∂_bφ_j; weighted : one-dimensional products with a weight along some axes."""
        lines = [weighted.get(i, plain) for i, plain in enumerate(self._grid.axes)]
        return coefficient, tuple(line[int(a == i), int(b == i)] for i, line in enumerate(lines))

    def _along_x(self, weighted: np.ndarray) -> dict[tuple[int, int], list[Kronecker]]:
        """Terms of every G_ab with a weight along x, given its one-dimensional products."""
        return {(a, b): [self._term(a, b, 1.0, {0: weighted})] for a in range(3) for b in range(3)}

    def _all(self, terms: Mapping[tuple[int, int], Sequence[Kronecker]]) -> SeparableProducts:
        return SeparableProducts(self.model.basis.N, self._grid.order, terms)
