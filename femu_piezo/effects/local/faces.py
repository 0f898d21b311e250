"""Displacements of a reduced body on one of its faces, at any point: polynomials along x and y, or along r.

For bodies on any other mesh see `femu_piezo.effects.local.face_on_mesh`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.polynomial import legendre

from femu_piezo.forward.box_interpolation import interpolation
from femu_piezo.forward.model import ElectroelasticModel

#: Points along length and width at which the fields of a face are sampled for interpolation by polynomials.
_SAMPLES = (18, 14)
#: Gauss points across half the width.
_ACROSS = 10
#: Smallest distance from the axis, over the outer radius; points nearer to it are moved out to that.
_AXIS = 1e-6


class Face(ABC):
    """Displacements on the face z = +t/2 as functions of the displacement unknowns.

    Attributes
    ----------
    group : (u,) number of the class of every displacement unknown
    copies : number of parts of the whole body, on one of which uᵗMu = 1
    bends : (u,) whether the in-plane displacement of an unknown is odd in z, else even; None where this is not known
    """

    group: np.ndarray
    copies: int
    bends: np.ndarray | None = None

    @property
    def same_class(self) -> np.ndarray:
        """(u, u) which pairs of unknowns an operator with the symmetry of the body may couple."""
        return self.group[:, None] == self.group

    @abstractmethod
    def at(self, x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
        """N (3, u) and its slopes ∂N/∂x, ∂N/∂y (2, 3, u) at a point, m."""

    def at_all(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """N (m, 3, u) and its slopes ∂N/∂x, ∂N/∂y (m, 2, 3, u) at points (m, 2), m."""
        values, slopes = zip(*(self.at(*point) for point in points.tolist()), strict=True)
        return np.array(values), np.array(slopes)


def mirrored(points: np.ndarray, axes: Iterable[int], flipped: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (m, 2) of a face moved onto the part that mirror lines cut, where displacements times their parity are
    those at the points.

    Also that parity (m, 3, u), and the signs (m, 2) of x and y at the points.

    axes : 0 and 1 that are normal to a mirror line
    flipped : (3, u) whether the parity of each unknown about the plane normal to an axis is not the driven one
    """
    folded, sign = points.copy(), np.ones(points.shape)
    parity = np.ones((len(points), 3, flipped.shape[1]))
    for axis in axes:
        sign[:, axis], folded[:, axis] = np.where(points[:, axis] < 0, -1.0, 1.0), np.abs(points[:, axis])
        # in the driven class the displacement along the axis is odd, the others are even
        odd = (np.arange(3) == axis)[:, None] != flipped[axis]
        parity[(sign[:, axis] < 0)[:, None, None] & odd] *= -1
    return folded, parity, sign


class RuledFace(Face):
    """A face with lines across it, or circles on it, each of which one number names."""

    @abstractmethod
    def line(self, place: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points (m, 2) of the line across the face at x = place, or of the circle of that radius, m.

        Also the directions (m, 2) in which they move with the place, and their shares (m,) of the line.
        """

    def mean_at(self, points: np.ndarray, directions: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean of NᵗN (u, u) over points (m, 2) of one face, divided by the number of parts, and its slope.

        directions : (m, 2) in which the points move;  weights : (m,) their shares of the mean
        """
        total, slope = 0.0, 0.0
        for (x, y), direction, weight in zip(points, directions, weights, strict=True):
            n, slopes = self.at(x, y)
            total = total + weight * (n.T @ n)
            moved = np.tensordot(direction, slopes, axes=1).T @ n
            slope = slope + weight * (moved + moved.T)
        return total / self.copies, slope / self.copies

    def mean_on_line(self, place: float) -> tuple[np.ndarray, np.ndarray]:
        """Mean of NᵗN as `mean_at`, over a line on both faces, which couples unknowns of one class only; its slope."""
        total, slope = self.mean_at(*self.line(place))
        return total * self.same_class, slope * self.same_class


@dataclass(frozen=True)
class BoxFace(RuledFace):
    """Displacements on the face z = +t/2 of the positive octant as polynomials in ξ = 4x/L − 1, η = 4y/W − 1.

    On the rest of the face they are those at the mirror images, with the parity of each unknown.

    Attributes
    ----------
    half : (L/2, W/2), m
    coefficients : (nx, ny, 3, u) Legendre coefficients of every displacement unknown
    flipped : (3, u) whether the parity of each unknown about the plane normal to an axis is not the driven one
    """

    half: tuple[float, float]
    coefficients: np.ndarray = field(repr=False)
    flipped: np.ndarray = field(repr=False)
    group: np.ndarray = field(repr=False)
    copies: int

    def at(self, x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
        """N (3, u) and its slopes ∂N/∂x, ∂N/∂y (2, 3, u) at a point, m; beyond an edge N continues straight."""
        (folded,), (parity,), (sign,) = mirrored(np.array([[x, y]]), (0, 1), self.flipped)
        lines = [
            _line(value, half, self.coefficients.shape[i])
            for i, (value, half) in enumerate(zip(folded.tolist(), self.half, strict=True))
        ]
        (px, sx), (py, sy) = lines
        along = np.tensordot(px, self.coefficients, axes=1)
        n = np.tensordot(py, along, axes=1)
        slopes = [
            np.tensordot(py, np.tensordot(sx, self.coefficients, axes=1), axes=1),
            np.tensordot(sy, along, axes=1),
        ]
        return n * parity, np.array(slopes) * parity * sign[:, None, None]

    def line(self, place: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points of the half y > 0 of the line x = place."""
        nodes, weights = legendre.leggauss(_ACROSS)
        points = np.column_stack([np.full(_ACROSS, place), (nodes + 1) / 2 * self.half[1]])
        return points, np.tile([1.0, 0.0], (_ACROSS, 1)), weights / 2


def _line(value: float, half: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(count,) Legendre polynomials at 2·value/half − 1, and their slopes by value.

    Below 0 and above `half`, where they would grow fast, they continue straight.
    """
    inside = min(max(value, 0.0), half)
    at = 2 * inside / half - 1
    slopes = legendre.legval(at, legendre.legder(np.eye(count))) * 2 / half
    return legendre.legvander(np.array([at]), count - 1)[0] + (value - inside) * slopes, slopes


def on_face(model: ElectroelasticModel, fields: np.ndarray) -> np.ndarray:
    """(nx, ny, 3, k) coefficients of a `BoxFace`, of the displacements in fields (4, n, k)."""
    ends = model.domain.mesh.p.max(axis=1)
    nodes = [legendre.leggauss(count)[0] for count in _SAMPLES]
    x, y = ((node + 1) / 2 * length for node, length in zip(nodes, ends, strict=False))
    grid = np.array([*(axis.ravel() for axis in np.meshgrid(x, y, indexing="ij")), np.full(x.size * y.size, ends[2])])
    probe = interpolation(model, grid)
    values = np.stack([probe @ fields[axis] for axis in range(3)]).reshape(3, x.size, y.size, -1)
    to_x, to_y = (np.linalg.inv(legendre.legvander(node, node.size - 1)) for node in nodes)
    return np.einsum("ia,jb,cabu->ijcu", to_x, to_y, values, optimize=True)


@dataclass(frozen=True)
class RoundFace(RuledFace):
    """Displacements on the face of a disk or ring: u_r, u_z ∝ cos nθ and u_θ ∝ sin nθ, polynomials of r.

    Beyond a rim they continue straight.

    Attributes
    ----------
    radii : inner and outer, m
    coefficients : (j, 3, u) Legendre coefficients of u_r, u_θ, u_z of every displacement unknown between the radii
    order : (u,) Fourier order n of every displacement unknown
    """

    radii: tuple[float, float]
    coefficients: np.ndarray = field(repr=False)
    order: np.ndarray = field(repr=False)
    group: np.ndarray = field(repr=False)
    copies: int
    bends: np.ndarray | None = field(default=None, repr=False)

    def line(self, place: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points of the half y > 0 of the circle r = place."""
        count = 2 * int(self.order.max()) + 2
        turns = np.pi * (np.arange(count) + 0.5) / count
        directions = np.column_stack([np.cos(turns), np.sin(turns)])
        return place * directions, directions, np.full(count, 1 / count)

    def at(self, x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
        """N (3, u) and its slopes ∂N/∂x, ∂N/∂y (2, 3, u) at a point, m."""
        (inner, outer), n = self.radii, self.order
        r, turn = max(float(np.hypot(x, y)), _AXIS * outer), float(np.arctan2(y, x))
        value, slope = _line(r - inner, outer - inner, self.coefficients.shape[0])
        value, slope = (np.tensordot(line, self.coefficients, axes=1) for line in (value, slope))
        cosine, sine = np.cos(n * turn), np.sin(n * turn)
        shares = np.array([cosine, sine, cosine])
        frame = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
        moved = np.array([[0, -1.0, 0], [1.0, 0, 0], [0, 0, 0]])  # ∂/∂θ of the directions of r and θ
        around = value * np.array([-n * sine, n * cosine, -n * sine]) + moved @ (value * shares)
        along = frame @ (slope * shares), frame @ around / r
        c, s = np.cos(turn), np.sin(turn)
        return frame @ (value * shares), np.array([c * along[0] - s * along[1], s * along[0] + c * along[1]])
