"""Impedance of a free rectangular k31 plate by Rayleigh-Ritz with global Legendre polynomials.

An independent reference: nothing of femu_piezo is used. One element of high order per direction; displacements and
potential in products P_i(ξ) P_j(η) P_k(ζ), ξ = 2x/L and so on, over the whole plate. The terminal voltage V lies as
±V/2 on the faces z = ±t/2; inner potentials vanish there.

Parity of the driven field without asymmetric effects: u_x odd in x, even in y and z; u_y odd in y, even else; u_z and φ
odd in z, even else.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre

_VOIGT = (((0, 0),), ((1, 1),), ((2, 2),), ((1, 2), (2, 1)), ((0, 2), (2, 0)), ((0, 1), (1, 0)))


def e_form(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """c (6, 6), e (3, 6), ε^S (3,) of the ten constants s11 s12 s13 s33 s44 d31 d33 d15 eps11T eps33T."""
    s11, s12, s13, s33, s44, d31, d33, d15, eps11, eps33 = theta
    s = np.zeros((6, 6), dtype=complex)
    s[:3, :3] = [[s11, s12, s13], [s12, s11, s13], [s13, s13, s33]]
    s[3, 3] = s[4, 4] = s44
    s[5, 5] = 2 * (s11 - s12)
    d = np.zeros((3, 6), dtype=complex)
    d[2, :3] = d31, d31, d33
    d[0, 4] = d[1, 3] = d15
    c = np.linalg.inv(s)
    e = d @ c
    return c, e, np.array([eps11, eps11, eps33]) - np.diag(e @ d.T)


@dataclass(frozen=True)
class Line:
    """Polynomials (k, points) of one direction with their slopes at Gauss points."""

    values: np.ndarray
    slopes: np.ndarray


def _line(degrees: range, half: float, points: np.ndarray, bubble: bool = False) -> Line:
    """Legendre polynomials of the given degrees at points, and their slopes; times 1 − ζ² with `bubble`."""
    values, slopes = [], []
    for degree in degrees:
        c = np.zeros(degree + 1)
        c[degree] = 1.0
        if bubble:  # (1 − ζ²) P
            c = legendre.legsub(c, legendre.legmul(legendre.poly2leg([0, 0, 1]), c))
        values.append(legendre.legval(points, c))
        slopes.append(legendre.legval(points, legendre.legder(c)) / half)
    return Line(np.array(values), np.array(slopes))


class RitzPlate:
    """Energy matrices of one plate; unknowns u_x, u_y, u_z, inner φ, then the voltage.

    Parameters
    ----------
    size : (length, width, thickness), m
    orders : highest degree along x, y, z
    film : kg/m² of a mass on both faces
    """

    def __init__(self, size, density: float, orders=(12, 9, 6), film: float = 0.0) -> None:
        half = np.asarray(size, float) / 2
        gauss = [legendre.leggauss(order + 4) for order in orders]
        self._weights = [w * h for (_, w), h in zip(gauss, half, strict=True)]
        odd = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 1)]
        self._lines = [
            [
                _line(
                    range(odd[f][axis], orders[axis] + 1, 2), half[axis], gauss[axis][0], bubble=(f == 3 and axis == 2)
                )
                for axis in range(3)
            ]
            for f in range(4)
        ]
        ones = [Line(np.ones((1, x.size)), np.zeros((1, x.size))) for x, _ in gauss]
        ones[2] = Line(gauss[2][0][None] / 2, np.full((1, gauss[2][0].size), 0.5 / half[2]))
        self._lines.append(ones)  # one volt between the electrodes
        sizes = [int(np.prod([line.values.shape[0] for line in lines])) for lines in self._lines]
        self._starts = np.concatenate([[0], np.cumsum(sizes)])
        self.size = int(self._starts[-1])
        self.displacements = int(self._starts[3])
        self.mass = np.zeros((self.size, self.size))
        for f in range(3):
            block = density * self._kron(f, f)
            block += film * self._faces(f)
            where = slice(self._starts[f], self._starts[f + 1])
            self.mass[where, where] = block
        self._gradients = {}

    def _pair(self, f: int, g: int, axis: int, left: bool, right: bool, weights: np.ndarray) -> np.ndarray:
        a, b = self._lines[f][axis], self._lines[g][axis]
        return ((a.slopes if left else a.values) * weights) @ (b.slopes if right else b.values).T

    def _kron(self, f: int, g: int, a: int | None = None, b: int | None = None) -> np.ndarray:
        """∫ ∂_a f ∂_b g dV; None: not differentiated."""
        x, y, z = (self._pair(f, g, axis, a == axis, b == axis, self._weights[axis]) for axis in range(3))
        return np.kron(np.kron(x, y), z)

    def _faces(self, f: int) -> np.ndarray:
        """∫ f² over both faces z = ±t/2."""
        x, y = (self._pair(f, f, axis, False, False, self._weights[axis]) for axis in range(2))
        degrees = range(1 if f == 2 else 0, 2 * self._lines[f][2].values.shape[0] + (1 if f == 2 else 0), 2)
        ends = sum(np.outer(e, e) for e in (np.array([float(s) ** d for d in degrees]) for s in (-1, 1)))
        return np.kron(np.kron(x, y), ends)

    def _gradient(self, f: int, a: int, g: int, b: int) -> np.ndarray:
        """∫ ∂_a f ∂_b g dV, computed once."""
        if (f, a, g, b) not in self._gradients:
            self._gradients[f, a, g, b] = self._kron(f, g, a, b)
        return self._gradients[f, a, g, b]

    def stiffness(self, theta: np.ndarray) -> np.ndarray:
        """A = ∫ S c S + 2 S eᵗ ∇φ − ∇φ ε ∇φ (size, size) complex symmetric at d-form constants (10,)."""
        c, e, eps = e_form(theta)
        matrix = np.zeros((self.size, self.size), dtype=complex)
        block = [slice(self._starts[f], self._starts[f + 1]) for f in range(5)]
        for row, first in enumerate(_VOIGT):
            for column, second in enumerate(_VOIGT):
                if c[row, column] != 0:
                    for f, a in first:
                        for g, b in second:
                            matrix[block[f], block[g]] += c[row, column] * self._gradient(f, a, g, b)
            for k in range(3):
                if e[k, row] != 0:
                    for f, a in first:
                        for potential in (3, 4):
                            coupling = e[k, row] * self._gradient(f, a, potential, k)
                            matrix[block[f], block[potential]] += coupling
                            matrix[block[potential], block[f]] += coupling.T
        for k in range(3):
            for left in (3, 4):
                for right in (3, 4):
                    matrix[block[left], block[right]] -= eps[k] * self._gradient(left, k, right, k)
        return matrix

    def impedance(self, theta, frequency: np.ndarray) -> np.ndarray:
        """Z (n,), ohm, by a full solution at every frequency; where the constants do not vary, inner potentials are
        eliminated once.

        theta : (10,) constants, or a function of the frequency in Hz that returns them
        """
        found = np.empty(len(frequency), dtype=complex)
        condensed = None if callable(theta) else self._condensed(np.asarray(theta))
        inertia = self.mass[: self.displacements, : self.displacements]
        for i, f in enumerate(frequency):
            omega = 2 * np.pi * f
            matrix = self.stiffness(theta(f)) if callable(theta) else condensed.copy()
            matrix[: self.displacements, : self.displacements] -= omega**2 * inertia
            inner = np.linalg.solve(matrix[:-1, :-1], matrix[:-1, -1])
            found[i] = 1 / (1j * omega * -(matrix[-1, -1] - matrix[-1, :-1] @ inner))
        return found

    def _condensed(self, theta: np.ndarray) -> np.ndarray:
        """`stiffness` of the displacements and the voltage, inner potentials following them."""
        matrix, moving = self.stiffness(theta), self.displacements
        kept, inner = np.append(np.arange(moving), self.size - 1), np.arange(moving, self.size - 1)
        side = matrix[np.ix_(inner, kept)]
        return matrix[np.ix_(kept, kept)] - side.T @ np.linalg.solve(matrix[np.ix_(inner, inner)], side)
