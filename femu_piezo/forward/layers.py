"""Gradient products of an extruded plane mesh as Kronecker products, applied cell by cell without being formed.

The map of a cell of `CurvedHexahedra` is a plane map of x, y and a map of the height z, and its shape functions are
products of plane functions and functions of z. So every gradient product is a product of the plane mesh times a
product of the layers,

    ∫ ∂_aφ_i ∂_bφ_j dV = P_ab ⊗ Z_ab,

where P_ab is ∫ ∂_sφ ∂_tφ dS with s and t = x, y or no derivative, and Z_ab is ∫ ∂_sφ ∂_tφ dz with s and t = z or none.
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

#: For a derivative along x, along y, along z and for none: the index of its plane factor in `LayeredProducts.plane` and
#: of its height factor in `LayeredProducts.line`.
_FACTORS = ((0, 0), (1, 0), (2, 1), (2, 0))
_NONE = 3

#: Fields are processed in chunks of columns whose copies, cell by cell, take less memory than this.
_CHUNK_BYTES = 64e6

#: (z derivative of the test function, that of the trial function, each 0 or 1; test field, trial field) → plane factor
#: (…, m², m²) of an extended tensor.
PlaneFactors = dict[tuple[int, int, int, int], np.ndarray]


def _plane_factors(tensor: np.ndarray, plane: np.ndarray) -> PlaneFactors:
    """The nonzero plane factors of an extended tensor (4, 3, 4, 3), from plane products (3, 3, …, m², m²)."""
    found: PlaneFactors = {}
    for f, a, g, b in zip(*np.nonzero(tensor), strict=True):
        (s, z_test), (t, z_trial) = _FACTORS[a], _FACTORS[b]
        key, part = (z_test, z_trial, f, g), tensor[f, a, g, b] * plane[s, t]
        found[key] = found[key] + part if key in found else part
    return found


@dataclass(frozen=True)
class LayeredProducts(ScalarProducts):
    """Gradient products on the nodes of an extruded plane mesh.

    Attributes
    ----------
    numbers : (N, H) number of the node at each of N plane nodes and each of H heights
    squares : (cells, m²) plane nodes of each cell of the plane mesh, m = p + 1
    plane : (3, 3, cells, m², m²) ∫ ∂_sφ_i ∂_tφ_j dS over each plane cell; s and t: x, y, none
    line : (2, 2, layers, m, m) ∫ ∂_sφ_i ∂_tφ_j dz through each layer; s and t: none, z
    """

    numbers: np.ndarray
    squares: np.ndarray
    plane: np.ndarray
    line: np.ndarray

    #: Only `GradientProducts` of a box have a `TensorGrid`.
    grid = None

    @classmethod
    def of(cls, basis: skfem.Basis) -> LayeredProducts | None:
        """The products of a scalar basis on the whole of an extruded plane mesh; None for every other basis."""
        mesh, element = basis.mesh, basis.elem
        if not (isinstance(mesh, CurvedHexahedra) and isinstance(element, ElementHexP)):
            return None
        above = np.any(mesh.height != mesh.height[0], axis=1)  # cells that are not in the lowest layer
        cells = int(np.argmax(above)) if above.any() else mesh.nelements
        if basis.nelems != mesh.nelements or mesh.nelements % cells:
            return None
        layers, m = mesh.nelements // cells, element.order + 1
        if not np.array_equal(mesh.plane, np.tile(mesh.plane[:, :cells], (1, layers, 1, 1))):
            return None
        nodes = np.empty((mesh.nelements, m, m, m), dtype=np.int64)
        i, j, k = element.indices(mesh).transpose(2, 0, 1)
        nodes[np.arange(mesh.nelements), i, j, k] = basis.element_dofs
        nodes = nodes.reshape(layers, cells, m * m, m)
        plane_nodes, squares = np.unique(nodes[0, :, :, 0], return_inverse=True)
        squares = squares.reshape(cells, m * m)
        numbers = np.empty((plane_nodes.size, element.order * layers + 1), dtype=np.int64)
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
        """(n,) all nodes; the H nodes above one plane node follow each other."""
        return self.numbers.ravel()

    @property
    def cells(self) -> int:
        """Number of cells, layer after layer."""
        return len(self.squares) * self.line.shape[2]

    def cell_nodes(self, cell: int) -> np.ndarray:
        """(m³,) nodes of a cell, the index through the height varying fastest."""
        layer, square = divmod(cell, len(self.squares))
        m = self.line.shape[3]
        return self.numbers[self.squares[square], layer * (m - 1) : layer * (m - 1) + m].ravel()

    def cell_operator(self, tensor: np.ndarray, inertia: float, cell: int) -> np.ndarray:
        """(4 m³, 4 m³) matrix of a cell, field by field: stiffness of an extended tensor (4, 3, 4, 3) − inertia · mass.

        inertia : density times ω²
        """
        layer, square = divmod(cell, len(self.squares))
        plane, line = self.plane[:, :, square], self.line[:, :, layer]
        squares, m = len(plane[0, 0]), len(line[0, 0])
        factors = np.zeros((2, 2, FIELDS, FIELDS, squares, squares))
        for key, part in _plane_factors(tensor, plane).items():
            factors[key] = part
        for f in range(3):
            factors[0, 0, f, f] -= inertia * plane[2, 2]
        flat = factors.transpose(2, 4, 3, 5, 0, 1).reshape(-1, 4) @ line.reshape(4, -1)
        whole = flat.reshape(FIELDS, squares, FIELDS, squares, m, m).transpose(0, 1, 4, 2, 3, 5)
        return whole.reshape(FIELDS * squares * m, -1)

    def applied(self, tensors: Sequence[np.ndarray], fields: np.ndarray) -> np.ndarray:
        """(n_tensors, 4, n, k): A w of extended tensors, each (4, 3, 4, 3), on fields w (4, n, k), cell by cell."""
        found = np.empty((len(tensors), *fields.shape))
        width = max(1, int(_CHUNK_BYTES / (8 * 16 * self.size)))
        for start in range(0, fields.shape[2], width):
            place = slice(start, start + width)
            self._apply(
                [_plane_factors(tensor, self.plane) for tensor in tensors], fields[:, :, place], found[..., place]
            )
        return found

    def _apply(self, factors: Sequence[PlaneFactors], fields: np.ndarray, found: np.ndarray) -> None:
        """Write A w (n_tensors, 4, n, k) of several operators on a few fields w (4, n, k) into `found`."""
        placed, width = fields[:, self.numbers], fields.shape[2]
        nonzero = np.any(fields, axis=(1, 2))
        through_height = {
            (z, g): (self._lines[z] @ placed[g]).reshape(len(self.numbers), -1)[self.squares]
            for z, g in {(key[:2], key[3]) for parts in factors for key in parts if nonzero[key[3]]}
        }
        for parts, target in zip(factors, found, strict=True):
            for f in range(FIELDS):
                images = [
                    part @ through_height[(z_test, z_trial), g]
                    for (z_test, z_trial, row, g), part in parts.items()
                    if row == f and nonzero[g]
                ]
                total = self._gather @ sum(images).reshape(self.squares.size, -1) if images else 0.0
                target[f, self.numbers] = np.reshape(total, (*self.numbers.shape, width) if images else ())

    @made_once
    def _gather(self) -> sp.csr_matrix:
        """(N, cells m²) matrix that sums values of plane cells into the plane nodes that they share."""
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
        (s, z_test), (t, z_trial) = _FACTORS[a], _FACTORS[b]
        found = np.empty(self.size)
        found[self.numbers] = np.outer(self._plane_matrices[s][t].diagonal(), self._lines[z_test, z_trial].diagonal())
        return found

    def _layered(self, left: tuple[int, int], right: tuple[int, int], vectors: np.ndarray) -> np.ndarray:
        """P ⊗ Z times vectors (n, k) on `nodes`; left, right : entries of `_FACTORS` for test and trial function."""
        (s, z_test), (t, z_trial) = left, right
        image = self._plane_matrices[s][t] @ vectors.reshape(len(self.numbers), -1)
        return (self._lines[z_test, z_trial] @ image.reshape(*self.numbers.shape, -1)).reshape(self.size, -1)

    @made_once
    def _plane_matrices(self) -> list[list[sp.csr_matrix]]:
        """[s][t] → (N, N) ∫ ∂_sφ_i ∂_tφ_j dS over the whole plane mesh."""
        number, shape = len(self.numbers), self.plane.shape[2:]
        rows = np.broadcast_to(self.squares[:, :, None], shape).ravel()
        columns = np.broadcast_to(self.squares[:, None, :], shape).ravel()
        return [
            [sp.csr_matrix((part.ravel(), (rows, columns)), shape=(number, number)) for part in row]
            for row in self.plane
        ]

    @made_once
    def _lines(self) -> np.ndarray:
        """(2, 2, H, H) ∫ ∂_sφ_i ∂_tφ_j dz through the whole height."""
        height, m = self.numbers.shape[1], self.line.shape[3]
        found = np.zeros((2, 2, height, height))
        for layer in range(self.line.shape[2]):
            place = slice(layer * (m - 1), layer * (m - 1) + m)
            found[:, :, place, place] += self.line[:, :, layer]
        return found


def _gauss(element: ElementHexP) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (q,) on [−1, 1], weights (q,) of [0, 1], values and slopes (2, m, q) of the polynomials at the points.

    The rule is that of the assembled forms.
    """
    points, weights = legendre.leggauss(element.order + 1)
    return points, weights / 2, element.on_line((points + 1) / 2)


def _plane_products(maps: np.ndarray, element: ElementHexP) -> np.ndarray:
    """`LayeredProducts.plane` (3, 3, cells, m², m²) of plane maps (2, cells, i, j) in Chebyshev coefficients, m."""
    points, weights, (value, slope) = _gauss(element)
    at, q, m = chebyshev.chebvander(points, maps.shape[2] - 1), points.size, len(value)
    along = [2 * chebyshev.chebder(maps, axis=axis) for axis in (2, 3)]  # slopes along reference coordinates on [0, 1]
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
    """`LayeredProducts.line` (2, 2, layers, m, m) of heights (layers, k) in Chebyshev coefficients, m."""
    points, weights, (value, slope) = _gauss(element)
    step = 2 * chebyshev.chebval(points, chebyshev.chebder(heights, axis=1).T)  # (layers, q)
    shapes = [np.broadcast_to(value, (len(step), *value.shape)), slope / step[:, None]]
    scaled = [shape * (np.abs(step) * weights)[:, None] for shape in shapes]
    return np.array([[left @ right.transpose(0, 2, 1) for right in shapes] for left in scaled])
