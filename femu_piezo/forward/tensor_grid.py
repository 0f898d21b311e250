"""Gradient products on a box as Kronecker products of one-dimensional matrices, applied without being formed.

On a tensor-product grid of Lagrange nodes every product is separable,

    ∫ ∂_aφ_i ∂_bφ_j dV = X_ab ⊗ Y_ab ⊗ Z_ab,

with each factor one of ∫φφ, ∫φ'φ', ∫φ'φ, ∫φφ' along one axis. A product with a vector takes n_x + n_y + n_z operations
per node, where the assembled matrix of order p has up to (2p + 1)³ entries per row.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import skfem
from numpy.polynomial import legendre
from scipy.interpolate import BarycentricInterpolator

from femu_piezo.forward.hex_element import ElementHexP, lobatto_nodes, node_places

#: Distance along an axis, relative to the box, below which two coordinates count as equal.
_SAME = 1e-9


@dataclass(frozen=True)
class TensorGrid:
    """Nodes of a box as a grid, and the one-dimensional matrices of every axis.

    Attributes
    ----------
    order : (n,) number of the node at each place of the grid, the last axis fastest
    lines, places : for x, y, z: coordinates of element boundaries and of nodes, growing, m
    axes : for x, y, z: (2, 2, n_i, n_i) [s, t] ∫ ∂^s φ_i ∂^t φ_j
    """

    order: np.ndarray
    lines: tuple[np.ndarray, ...]
    places: tuple[np.ndarray, ...]
    axes: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, basis: skfem.Basis) -> TensorGrid | None:
        """The grid of a scalar basis of Lagrange hexahedra on a whole box; None for every other basis."""
        if not isinstance(basis.elem, ElementHexP) or basis.nelems != basis.mesh.nelements:
            return None
        places, numbers = zip(*(_places(axis) for axis in node_places(basis)), strict=True)
        shape = tuple(place.size for place in places)
        if np.prod(shape) != basis.N:
            return None
        flat = np.ravel_multi_index(numbers, shape)
        if np.unique(flat).size != basis.N:
            return None
        lines = tuple(_places(axis)[0] for axis in basis.mesh.p)
        if not all(_is_straight(line, place) for line, place in zip(lines, places, strict=True)):
            return None
        axes = tuple(_matrices(line, place) for line, place in zip(lines, places, strict=True))
        return cls(np.argsort(flat), lines, places, axes)

    def weighted(self, axis: int, weight: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """(2, 2, n_i, n_i) ∫ w ∂^s φ_i ∂^t φ_j along one axis, with a polynomial w of the coordinate, m."""
        return _matrices(self.lines[axis], self.places[axis], weight)

    def times(self, a: int, b: int, vectors: np.ndarray) -> np.ndarray:
        """∫ ∂_aφ_i ∂_bφ_j times vectors (n, k) in the order of the grid."""
        return kronecker_times([matrices[int(a == i), int(b == i)] for i, matrices in enumerate(self.axes)], vectors)

    def mass(self, vectors: np.ndarray) -> np.ndarray:
        """∫ φ_i φ_j times vectors (n, k) in the order of the basis."""
        found = np.empty_like(vectors, dtype=np.result_type(self.axes[0], vectors))
        found[self.order] = kronecker_times([matrices[0, 0] for matrices in self.axes], vectors[self.order])
        return found


def kronecker_times(factors: Sequence[np.ndarray], vectors: np.ndarray) -> np.ndarray:
    """X ⊗ Y ⊗ Z, each (n_i, n_i), times vectors (n_x n_y n_z, k)."""
    x, y, z = factors
    width = vectors.shape[1]
    grid = (x @ vectors.reshape(len(x), -1)).reshape(len(x), len(y), -1)
    grid = (y @ grid).reshape(len(x) * len(y), len(z), width)
    return (z @ grid).reshape(-1, width)


def _places(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct coordinates along an axis, growing, and the index (n,) of each of the values (n,) among them."""
    order = np.argsort(values, kind="stable")
    new = np.append(True, np.diff(values[order]) > _SAME * np.ptp(values))
    number = np.empty(values.size, dtype=int)
    number[order] = np.cumsum(new) - 1
    return values[order][new], number


def _is_straight(line: np.ndarray, places: np.ndarray) -> bool:
    """Whether the nodes lie where affine maps put them between the element boundaries `line`.

    With other maps the shape functions are no Lagrange polynomials of the coordinate.
    """
    order, start = (places.size - 1) // (line.size - 1), line[:-1, None]
    affine = start + np.diff(line)[:, None] * lobatto_nodes(order)[:-1]
    return affine.size == places.size - 1 and np.allclose(
        places[:-1], affine.ravel(), rtol=0, atol=_SAME * np.ptp(line)
    )


def _matrices(
    line: np.ndarray, places: np.ndarray, weight: Callable[[np.ndarray], np.ndarray] = np.ones_like
) -> np.ndarray:
    """(2, 2, n, n) ∫ w ∂^s φ_i ∂^t φ_j of Lagrange elements with boundaries at `line` and nodes at `places`."""
    count = (places.size - 1) // (line.size - 1)
    found = np.zeros((2, 2, places.size, places.size))
    for element, (left, right) in enumerate(pairwise(line)):
        nodes = slice(element * count, element * count + count + 1)
        found[:, :, nodes, nodes] += line_products(places[nodes], left, right, weight)
    return found


def line_products(
    nodes: np.ndarray, left: float, right: float, weight: Callable[[np.ndarray], np.ndarray] = np.ones_like
) -> np.ndarray:
    """(2, 2, n, n) ∫ w ∂^s φ_i ∂^t φ_j from left to right of the Lagrange polynomials on n nodes.

    weight : w of the coordinate; the integral is exact for polynomials w up to degree 5
    """
    points, weights = legendre.leggauss(nodes.size + 2)
    lagrange = BarycentricInterpolator(nodes, np.eye(nodes.size), rng=0)
    at = (left + right) / 2 + (right - left) / 2 * points
    shapes = np.array([lagrange(at), lagrange.derivative(at)])
    scaled = shapes * (weights * weight(at) * (right - left) / 2)[:, None]
    return np.einsum("sqi,tqj->stij", scaled, shapes)
