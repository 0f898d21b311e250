"""Continuous polynomials of high order on the elements of one axis (spectral elements), with parity where it holds.

Nodes are the Gauss-Lobatto points of each element (Patera, J. Comput. Phys. 54 (1984) 468).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import legendre


def lobatto(degree: int) -> np.ndarray:
    """(degree + 1,) Gauss-Lobatto points in [−1, 1]."""
    inner = legendre.Legendre.basis(degree).deriv().roots().real
    return np.concatenate([[-1.0], np.sort(inner), [1.0]])


@dataclass(frozen=True)
class Axis:
    """Elements of one axis.

    Attributes
    ----------
    breaks : (m + 1,) ends of the elements, m
    degrees : polynomial degree of each element, m of them
    """

    breaks: tuple[float, ...]
    degrees: tuple[int, ...]

    @cached_property
    def nodes(self) -> np.ndarray:
        """(n,) places of the nodes, m."""
        parts = [
            a + (lobatto(p) + 1) / 2 * (b - a)
            for a, b, p in zip(self.breaks[:-1], self.breaks[1:], self.degrees, strict=True)
        ]
        return np.concatenate([parts[0], *(part[1:] for part in parts[1:])])

    def sample(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values and slopes (n, k) of all functions at points (k,), m."""
        element = np.clip(np.searchsorted(self.breaks, points, side="right") - 1, 0, len(self.degrees) - 1)
        values, slopes = np.zeros((2, self.nodes.size, points.size))
        first = 0
        for index, degree in enumerate(self.degrees):
            here = np.flatnonzero(element == index)
            a, b = self.breaks[index], self.breaks[index + 1]
            xi = 2 * (points[here] - a) / (b - a) - 1
            inverse = np.linalg.inv(legendre.legvander(lobatto(degree), degree))
            rows = slice(first, first + degree + 1)
            values[rows, here] = (legendre.legvander(xi, degree) @ inverse).T
            unit = np.eye(degree + 1)
            slope = np.stack([legendre.legval(xi, legendre.legder(row)) for row in unit], axis=1)
            slopes[rows, here] = (slope @ inverse).T * 2 / (b - a)
            first += degree
        return values, slopes


@dataclass(frozen=True)
class Line:
    """The functions of one axis for one field: even (1), odd (−1) or all (0).

    Attributes
    ----------
    fold : (r, n) from the nodes' functions
    positions : (r,) m, of the node that stands for each function
    """

    axis: Axis
    fold: np.ndarray
    positions: np.ndarray

    @classmethod
    def of(cls, axis: Axis, parity: int) -> Line:
        """The functions of one axis with a parity about 0."""
        nodes = axis.nodes
        if parity == 0:
            return cls(axis, np.eye(nodes.size), nodes)
        if not np.allclose(nodes, -nodes[::-1], atol=1e-12 * np.ptp(nodes)):
            raise ValueError("parity asks for elements that are symmetric about 0")
        rows, positions = [], []
        for i in range(nodes.size // 2, nodes.size):
            row = np.zeros(nodes.size)
            row[i] = 1.0
            row[nodes.size - 1 - i] += parity
            if np.any(row):
                rows.append(row / np.abs(row).max())
                positions.append(nodes[i])
        return cls(axis, np.array(rows), np.array(positions))

    def sample(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values and slopes (r, k) of the functions at points (k,), m."""
        values, slopes = self.axis.sample(points)
        return self.fold @ values, self.fold @ slopes


def quadrature(breaks: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss points and weights, `count` in each interval."""
    x, w = legendre.leggauss(count)
    a, b = breaks[:-1, None], breaks[1:, None]
    return ((a + b) / 2 + (b - a) / 2 * x).ravel(), ((b - a) / 2 * w).ravel()


def joined(*breaks) -> np.ndarray:
    """Union of several lists of breakpoints, those closer than 1e-9 m taken as one."""
    every = np.sort(np.concatenate([np.asarray(b, float) for b in breaks]))
    return every[np.concatenate([[True], np.diff(every) > 1e-9])]
