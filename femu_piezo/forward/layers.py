"""Gradient products of a plane mesh in layers as Kronecker products, applied and looked at cell by cell, never formed.

The map of a cell of `CurvedHexahedra` is a plane map times a height, and its functions are products of plane functions
and functions of height. So every product is one of the plane mesh times one of the layers,

    ∫ ∂_aφ_i ∂_bφ_j dV = P_ab ⊗ Z_ab,

with P_ab among ∫ ∂_sφ ∂_tφ dS, s and t being x, y or no derivative, and Z_ab among ∫ ∂_sφ ∂_tφ dz.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import skfem
from numpy.polynomial import chebyshev, legendre

from femu_piezo.forward.gradient_products import FIELDS, ScalarProducts
from femu_piezo.forward.hex_element import ElementHexP
from femu_piezo.geometry.curved_mesh import CurvedHexahedra
from femu_piezo.threads import made_once

#: Which plane and which height factor a derivative along x, y, z has, and none: place in `plane`, place in `line`.
_FACTORS = ((0, 0), (1, 0), (2, 1), (2, 0))
_NONE = 3


#: Columns of fields are taken so many at a time that their copies by cells stay below this.
_CHUNK_BYTES = 64e6

#: Plane factors (…, m², m²) of an extended tensor, by derivative of both heights (none or z) and both fields.
Joined = dict[tuple[int, int, int, int], np.ndarray]


def _joined(tensor: np.ndarray, plane: np.ndarray) -> Joined:
    """Of an extended tensor (4, 3, 4, 3) and plane products (3, 3, …, m², m²), those that are not zero."""
    found: Joined = {}
    for f, a, g, b in zip(*np.nonzero(tensor), strict=True):
        (s, up), (t, over) = _FACTORS[a], _FACTORS[b]
        part = tensor[f, a, g, b] * plane[s, t]
        found[up, over, f, g] = found[up, over, f, g] + part if (up, over, f, g) in found else part
    return found


@dataclass(frozen=True)
class LayeredProducts(ScalarProducts):
    """Products on the nodes of a plane mesh in layers.

    Attributes
    ----------
    numbers : (N, H) node at each place of the plane mesh and each height
    squares : (cells, m²) plane nodes of each cell of the plane mesh, m = p + 1
    plane : (3, 3, cells, m², m²) ∫ ∂_sφ_i ∂_tφ_j dS over each of them; s and t: x, y, none
    line : (2, 2, layers, m, m) ∫ ∂_sφ_i ∂_tφ_j dz through each layer; s and t: none, z
    """

    numbers: np.ndarray
    squares: np.ndarray
    plane: np.ndarray
    line: np.ndarray

    #: A box's one-dimensional products are those of `TensorGrid`.
    grid = None

    @classmethod
    def of(cls, basis: skfem.Basis) -> LayeredProducts | None:
        """Of a scalar basis on all of an extruded plane mesh; None for every other basis."""
        mesh, element = basis.mesh, basis.elem
        if not (isinstance(mesh, CurvedHexahedra) and isinstance(element, ElementHexP)):
            return None
        other = np.any(mesh.height != mesh.height[0], axis=1)
        cells = int(np.argmax(other)) if other.any() else mesh.nelements
        if basis.nelems != mesh.nelements or mesh.nelements % cells:
            return None
        layers, m = mesh.nelements // cells, element.order + 1
        if not np.array_equal(mesh.plane, np.tile(mesh.plane[:, :cells], (1, layers, 1, 1))):
            return None
        nodes = np.empty((mesh.nelements, m, m, m), dtype=np.int64)
        i, j, k = element.indices(mesh).transpose(2, 0, 1)
        nodes[np.arange(mesh.nelements), i, j, k] = basis.element_dofs
        nodes = nodes.reshape(layers, cells, m * m, m)
        own, squares = np.unique(nodes[0, :, :, 0], return_inverse=True)
        squares = squares.reshape(cells, m * m)
        numbers = np.empty((own.size, element.order * layers + 1), dtype=np.int64)
        for layer in range(layers):
            numbers[squares, element.order * layer : element.order * layer + m] = nodes[layer]
        if numbers.size != basis.N:
            return None
        plane, line = _plane_products(mesh.plane[:, :cells], element), _line_products(mesh.height[::cells], element)
        return cls(numbers, squares, plane, line)

    @property
    def size(self) -> int:
        """n"""
        return self.numbers.size

    @property
    def nodes(self) -> np.ndarray:
        """(n,) all, those through the height one after another."""
        return self.numbers.ravel()

    @property
    def cells(self) -> int:
        """Number of cells, layer after layer."""
        return len(self.squares) * self.line.shape[2]

    def cell_nodes(self, cell: int) -> np.ndarray:
        """(m³,) nodes of a cell, those through the height fastest."""
        layer, square = divmod(cell, len(self.squares))
        m = self.line.shape[3]
        return self.numbers[self.squares[square], layer * (m - 1) : layer * (m - 1) + m].ravel()

    def cell_operator(self, tensor: np.ndarray, inertia: float, cell: int) -> np.ndarray:
        """(4 m³, 4 m³) of an extended tensor (4, 3, 4, 3) less `inertia` (density times ω²), of a cell, by fields."""
        layer, square = divmod(cell, len(self.squares))
        plane, line = self.plane[:, :, square], self.line[:, :, layer]
        squares, m = len(plane[0, 0]), len(line[0, 0])
        joined = np.zeros((2, 2, FIELDS, FIELDS, squares, squares))
        for at, part in _joined(tensor, plane).items():
            joined[at] = part
        for f in range(3):
            joined[0, 0, f, f] -= inertia * plane[2, 2]
        flat = joined.transpose(2, 4, 3, 5, 0, 1).reshape(-1, 4) @ line.reshape(4, -1)
        whole = flat.reshape(FIELDS, squares, FIELDS, squares, m, m).transpose(0, 1, 4, 2, 3, 5)
        return whole.reshape(FIELDS * squares * m, -1)

    def applied(self, tensors: Sequence[np.ndarray], fields: np.ndarray) -> np.ndarray:
        """(n_tensors, 4, n, k): A w of extended tensors, each (4, 3, 4, 3), on fields w (4, n, k), cell by cell."""
        found = np.empty((len(tensors), *fields.shape))
        width = max(1, int(_CHUNK_BYTES / (8 * 16 * self.size)))
        for start in range(0, fields.shape[2], width):
            place = slice(start, start + width)
            self._apply([_joined(tensor, self.plane) for tensor in tensors], fields[:, :, place], found[..., place])
        return found

    def _apply(self, joined: Sequence[Joined], fields: np.ndarray, found: np.ndarray) -> None:
        """Write A w of several operators (n_tensors, 4, n, k) on a few fields w (4, n, k) at once."""
        placed, width = fields[:, self.numbers], fields.shape[2]
        given = np.any(fields, axis=(1, 2))
        pairs = {key for parts in joined for key in parts}
        moved = {
            (up, over, g): (self._lines[up, over] @ placed[g]).reshape(len(self.numbers), -1)[self.squares]
            for up, over, g in {(up, over, g) for up, over, _, g in pairs if given[g]}
        }
        for parts, target in zip(joined, found, strict=True):
            for f in range(FIELDS):
                own = [part @ moved[up, over, g] for (up, over, row, g), part in parts.items() if row == f and given[g]]
                total = self._gather @ sum(own).reshape(self.squares.size, -1) if own else 0.0
                target[f, self.numbers] = np.reshape(total, (*self.numbers.shape, width) if own else ())

    @made_once
    def _gather(self) -> sp.csr_matrix:
        """(N, cells m²) sums over the plane cells around each node."""
        columns = np.arange(self.squares.size)
        return sp.csr_matrix((np.ones(columns.size), (self.squares.ravel(), columns)))

    def times(self, a: int, b: int, vectors: np.ndarray) -> np.ndarray:
        """G_ab times vectors (n, k) on `nodes`."""
        return self._layered(_FACTORS[a], _FACTORS[b], vectors)

    def mass_times(self, vectors: np.ndarray) -> np.ndarray:
        """∫ φ_i φ_j times vectors (n, k) in the order of the basis."""
        found = np.empty_like(vectors)
        found[self.nodes] = self._layered(_FACTORS[_NONE], _FACTORS[_NONE], vectors[self.nodes])
        return found

    def diagonal(self, a: int, b: int) -> np.ndarray:
        """(n,) diagonal of G_ab."""
        (s, up), (t, over) = _FACTORS[a], _FACTORS[b]
        found = np.empty(self.size)
        found[self.numbers] = np.outer(self._plane_matrices[s][t].diagonal(), self._lines[up, over].diagonal())
        return found

    def _layered(self, left: tuple[int, int], right: tuple[int, int], vectors: np.ndarray) -> np.ndarray:
        (s, up), (t, over) = left, right
        image = self._plane_matrices[s][t] @ vectors.reshape(len(self.numbers), -1)
        return (self._lines[up, over] @ image.reshape(*self.numbers.shape, -1)).reshape(self.size, -1)

    @made_once
    def _plane_matrices(self) -> list[list[sp.csr_matrix]]:
        """[s][t] (N, N) over the whole plane."""
        number, shape = len(self.numbers), self.plane.shape[2:]
        rows = np.broadcast_to(self.squares[:, :, None], shape).ravel()
        columns = np.broadcast_to(self.squares[:, None, :], shape).ravel()
        return [
            [sp.csr_matrix((part.ravel(), (rows, columns)), shape=(number, number)) for part in row]
            for row in self.plane
        ]

    @made_once
    def _lines(self) -> np.ndarray:
        """(2, 2, H, H) through the whole height."""
        height, m = self.numbers.shape[1], self.line.shape[3]
        found = np.zeros((2, 2, height, height))
        for layer in range(self.line.shape[2]):
            own = slice(layer * (m - 1), layer * (m - 1) + m)
            found[:, :, own, own] += self.line[:, :, layer]
        return found


def _gauss(element: ElementHexP) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (q,) in −1 … 1, weights (q,) of 0 … 1, as assembled forms have; (2, m, q) values and slopes there."""
    points, weights = legendre.leggauss(element.order + 1)
    return points, weights / 2, element.on_line((points + 1) / 2)


def _plane_products(maps: np.ndarray, element: ElementHexP) -> np.ndarray:
    """(3, 3, cells, m², m²) of plane maps (2, cells, i, j) by Chebyshev coefficients, m."""
    points, weights, (value, slope) = _gauss(element)
    at, q, m = chebyshev.chebvander(points, maps.shape[2] - 1), points.size, len(value)
    along = [2 * chebyshev.chebder(maps, axis=axis) for axis in (2, 3)]  # by coordinates from 0 to 1
    steps = [np.einsum("icab,pa,qb->icpq", d, at[:, : d.shape[2]], at[:, : d.shape[3]]) for d in along]
    (x1, y1), (x2, y2) = steps
    area = x1 * y2 - x2 * y1
    first = np.einsum("ip,jq->ijpq", slope, value).reshape(m * m, 1, q, q)
    second = np.einsum("ip,jq->ijpq", value, slope).reshape(m * m, 1, q, q)
    plain = np.broadcast_to(np.einsum("ip,jq->ijpq", value, value).reshape(m * m, 1, q, q), (m * m, *area.shape))
    shapes = [(y2 * first - y1 * second) / area, (x1 * second - x2 * first) / area, plain]
    shapes = np.array([shape.reshape(m * m, len(area), q * q).transpose(1, 0, 2) for shape in shapes])
    scaled = shapes * (np.abs(area) * np.outer(weights, weights)).reshape(1, len(area), 1, q * q)
    return np.array([[left @ right.transpose(0, 2, 1) for right in shapes] for left in scaled])


def _line_products(heights: np.ndarray, element: ElementHexP) -> np.ndarray:
    """(2, 2, layers, m, m) of heights (layers, k) by Chebyshev coefficients, m."""
    points, weights, (value, slope) = _gauss(element)
    step = 2 * chebyshev.chebval(points, chebyshev.chebder(heights, axis=1).T)  # (layers, q)
    shapes = [np.broadcast_to(value, (len(step), *value.shape)), slope / step[:, None]]
    scaled = [shape * (np.abs(step) * weights)[:, None] for shape in shapes]
    return np.array([[left @ right.transpose(0, 2, 1) for right in shapes] for left in scaled])
