"""`ElementHexP`: hexahedra of any order p, tensor products of Lagrange polynomials on Gauss-Lobatto nodes.

Cells that share an edge or a face may orient it differently. So every cell numbers the nodes there by the global vertex
numbers: along an edge from its lower to its higher vertex; on a face from its lowest vertex, first towards the lower of
the two neighbours of that vertex. The nodes lie symmetrically, so another orientation only permutes the shape functions
of the cell, and the element is conforming for any numbering of the cells.
"""

from __future__ import annotations

import itertools

import numpy as np
import skfem
from numpy.polynomial import legendre
from skfem.element import DiscreteField, ElementH1
from skfem.mapping import Mapping
from skfem.refdom import RefHex


class ElementHexP(ElementH1):
    """Scalar element of order p on hexahedra, flat or curved.

    Unknowns are values at nodes: those of vertices, edges, facets, interior, as scikit-fem orders them. `gbasis` turns
    edges and facets by the mesh of the mapping; `lbasis` and `doflocs` are those of a cell whose vertices are numbered
    as in the reference cell, so the nodes of a whole mesh are what `node_places` says.

    Parameters
    ----------
    order : p ≥ 1
    """

    nodal_dofs = 1
    refdom = RefHex

    def __init__(self, order: int) -> None:
        if order < 1:
            raise ValueError(f"the order of an element must be at least 1, got {order}")
        inner = order - 1
        self.order, self.maxdeg = order, 3 * order
        self.edge_dofs, self.facet_dofs, self.interior_dofs = inner, inner**2, inner**3
        self.dofnames = ["u"] * (1 + inner + inner**2 + inner**3)
        self.nodes = lobatto_nodes(order)
        self._coefficients = np.linalg.inv(legendre.legvander(2 * self.nodes - 1, order))
        self._reference = node_indices(np.arange(8)[:, None], order)
        self.doflocs = self.nodes[self._reference[:, 0]]
        # latest results, each with its arguments in one tuple that is replaced as a whole: threads share an element
        self._latest_indices = self._latest_points = None

    def indices(self, mesh: skfem.Mesh) -> np.ndarray:
        """(functions, cells, 3) number of the node, 0 … p along each reference axis, of every function of a cell."""
        latest = self._latest_indices
        if latest is None or latest[0] is not mesh:
            self._latest_indices = latest = mesh, node_indices(mesh.t, self.order)
        return latest[1]

    def lbasis(self, X: np.ndarray, i: int) -> tuple[np.ndarray, np.ndarray]:
        """Value (points,) and reference gradient (3, points) at reference points (3, points)."""
        if not 0 <= i < len(self._reference):
            self._index_error()
        value, gradient = _product(self._lines(X), self._reference[i])
        return value[0], gradient[:, 0]

    def gbasis(self, mapping: Mapping, X: np.ndarray, i: int, tind: np.ndarray | None = None) -> tuple[DiscreteField]:
        """Function i of the cells `tind` at reference points (3, points), or (3, cells, points) of each cell."""
        lines, inverse = self._at_points(mapping, X, tind)
        node = self.indices(mapping.mesh)[i]
        node = node if tind is None else node[tind]
        value, gradient = _product(lines, node[:1] if np.all(node == node[:1]) else node)
        shape = inverse.shape[2:]
        gradient = np.einsum("ijkl,ikl->jkl", inverse, np.broadcast_to(gradient, (3, *shape)))
        return (DiscreteField(np.broadcast_to(value, shape), gradient),)

    def all_functions(self, mapping: Mapping, X: np.ndarray, tind: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (functions, cells, points) and gradients (3, functions, cells, points) of all functions at once.

        X : (3, cells, points) reference points of the cells `tind`
        """
        (lines, slopes), nodes = self._lines(X), self.indices(mapping.mesh)[:, tind]
        number, axis, cell = nodes.transpose(2, 0, 1), np.arange(3)[:, None, None], np.arange(len(tind))
        x, y, z = lines[number, axis, cell]
        dx, dy, dz = slopes[number, axis, cell]
        reference = np.array([dx * y * z, x * dy * z, x * y * dz])
        return x * y * z, np.einsum("ijkl,ifkl->jfkl", mapping.invDF(X, tind), reference)

    def _at_points(self, mapping: Mapping, X: np.ndarray, tind: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Polynomials along each axis and inverse Jacobian at points, shared by all functions; the latest are kept."""
        asked, latest = (mapping, X, tind), self._latest_points
        if latest is None or any(old is not new for old, new in zip(latest[0], asked, strict=True)):
            self._latest_points = latest = asked, (self._lines(X), mapping.invDF(X, tind))
        return latest[1]

    def on_line(self, places: np.ndarray) -> np.ndarray:
        """(2, p + 1, …) values and slopes of the Lagrange polynomials at places (…) from 0 to 1."""
        at, slopes = 2 * places - 1, 2 * legendre.legder(self._coefficients)
        return np.array([legendre.legval(at, self._coefficients), legendre.legval(at, slopes)])

    def _lines(self, X: np.ndarray) -> np.ndarray:
        """(2, p + 1, 3, cells or 1, points) values and slopes of the Lagrange polynomials along each axis."""
        return self.on_line(X.reshape(3, -1, X.shape[-1]))


def shapes_at(basis: skfem.CellBasis, at: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values (functions, m) and gradients (3, functions, m) of a scalar basis at one point (3, m) of each cell (m,)."""
    X = at[:, :, None]
    if isinstance(basis.elem, ElementHexP):
        value, gradient = basis.elem.all_functions(basis.mapping, X, cells)
        return value[:, :, 0], gradient[:, :, :, 0]
    shapes = [basis.elem.gbasis(basis.mapping, X, i, tind=cells)[0] for i in range(basis.Nbfun)]
    values = [np.broadcast_to(np.asarray(shape), (cells.size, 1))[:, 0] for shape in shapes]
    return np.array(values), np.stack([shape.grad[:, :, 0] for shape in shapes], axis=1)


def lobatto_nodes(order: int) -> np.ndarray:
    """(n,) growing, n = order + 1: 0, 1 and the extrema between them of the Legendre polynomial of that order."""
    roots = legendre.legroots(legendre.legder(np.eye(order + 1)[order])) if order > 1 else np.zeros(0)
    inner = np.sort(np.real(roots))  # all are real, which numpy may give as complex numbers
    nodes = np.concatenate([[-1.0], inner, [1.0]])
    return (2 + nodes - nodes[::-1]) / 4


def node_indices(vertices: np.ndarray, order: int) -> np.ndarray:
    """(functions, cells, 3) number of the node, 0 … p along each reference axis, of every function of a cell.

    Parameters
    ----------
    vertices : (8, cells) global numbers
    """
    corners = RefHex.p.T.astype(int)
    inner = np.arange(1, order)
    found = [np.broadcast_to(order * corners[:, None], (8, vertices.shape[1], 3))]
    for edge in RefHex.edges:
        start, end = (corners[ends] for ends in np.take(edge, np.argsort(vertices[edge], axis=0)))
        found.append(order * start + inner[:, None, None] * (end - start))
    for facet in RefHex.facets:
        first = np.argmin(vertices[facet], axis=0)
        around = np.take(facet, (first + np.array([[0], [1], [3]])) % 4)
        turned = np.take_along_axis(vertices, around[1:], axis=0)
        around[1:] = np.take_along_axis(around[1:], np.argsort(turned, axis=0), axis=0)
        start, first_end, second_end = corners[around]
        i, j = (grid.reshape(-1, 1, 1) for grid in np.meshgrid(inner, inner, indexing="ij"))
        found.append(order * start + i * (first_end - start) + j * (second_end - start))
    inside = np.array(list(itertools.product(inner, repeat=3)), dtype=int).reshape(-1, 1, 3)
    found.append(np.broadcast_to(inside, (len(inside), vertices.shape[1], 3)))
    return np.concatenate(found)


def node_places(basis: skfem.CellBasis) -> np.ndarray:
    """(3, n) coordinates of the nodes of a basis of `ElementHexP` on all cells of a mesh, m."""
    local = basis.elem.nodes[basis.elem.indices(basis.mesh)].transpose(2, 1, 0)
    found = np.zeros((3, basis.N))
    found[:, basis.element_dofs.T] = basis.mapping.F(local, tind=np.arange(basis.mesh.nelements))
    return found


def _product(lines: np.ndarray, node: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Value (cells, points) and reference gradient (3, cells, points) of the function of a node (cells or 1, 3)."""
    cells = np.arange(lines.shape[3])
    (x, y, z), (dx, dy, dz) = ([part[node[:, axis], axis, cells] for axis in range(3)] for part in lines)
    return x * y * z, np.array([dx * y * z, x * dy * z, x * y * dz])
