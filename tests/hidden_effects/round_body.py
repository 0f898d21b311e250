"""Energy matrices of disks and rings poled along their axis, by global polynomials for Cartesian components.

The symmetry of revolution is not used, only the outline: a disk has products of Legendre polynomials in x and y, a ring
Legendre polynomials in r times cos nθ and sin nθ, both up to a total degree and times Legendre polynomials in z. Bodies
and surfaces are symmetric about y = 0. Nothing of femu_piezo is used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.linalg as sl
from numpy.polynomial import legendre

from hidden_effects.crystal_forms import VOLT, CrystalForms

#: Share of the largest eigenvalue of the Gram matrix of the plane functions below which a combination is dropped.
_SAME = 1e-11


@dataclass(frozen=True)
class RoundSurface:
    """Something on points of one face or both: coefficient(ω) × Σ weight |u|².

    Attributes
    ----------
    x, y, weights : (g,) quadrature over the area, m and m² (or shares of points), even about y = 0
    faces : 1 for z = +t/2, −1 for z = −t/2
    coefficient : ω (k,) → (k,) on the energy ½ coefficient Σ weight |u|²
    directions : components of u that take part
    parts : so many equal parts of the points follow one another, of each of which |mean of u|² counts; 0: |u|² of all
    """

    x: np.ndarray
    y: np.ndarray
    weights: np.ndarray
    faces: tuple[int, ...]
    coefficient: Callable[[np.ndarray], np.ndarray]
    directions: tuple[int, ...] = (0, 1, 2)
    parts: int = 0

    @classmethod
    def patch(cls, place: float, radius: float, faces, coefficient) -> RoundSurface:
        """A round patch about (place, 0) m; the coefficient is that of the whole patch."""
        (s, ws), turns = legendre.leggauss(6), 2 * np.pi * (np.arange(12) + 0.5) / 12
        rho = radius * (s + 1) / 2
        x = place + np.outer(rho, np.cos(turns)).ravel()
        y = np.outer(rho, np.sin(turns)).ravel()
        weights = np.outer(rho * ws, np.ones(12)).ravel()
        return cls(x, y, weights / weights.sum(), faces, coefficient)

    @classmethod
    def tripod(cls, place: float, radius: float, faces, coefficient) -> RoundSurface:
        """Three round patches 120° apart, the first about (place, 0) m, each of which acts on its mean displacement;
        the coefficient is of all three.
        """
        one, turns = cls.patch(place, radius, faces, coefficient), 2 * np.pi * np.arange(3) / 3
        c, s = np.cos(turns)[:, None], np.sin(turns)[:, None]
        x, y = (c * one.x - s * one.y).ravel(), (s * one.x + c * one.y).ravel()
        return cls(x, y, np.tile(one.weights / 3, 3), faces, coefficient, parts=3)

    @classmethod
    def circle(cls, radius: float, faces, coefficient, points: int = 48) -> RoundSurface:
        """Equally spaced points on a circle, the first at θ = 0; the coefficient is of all points."""
        turns = 2 * np.pi * np.arange(points) / points
        weights = np.full(points, 1 / points / len(faces))
        return cls(radius * np.cos(turns), radius * np.sin(turns), weights, faces, coefficient)


@dataclass(frozen=True)
class RoundBody:
    """A disk (inner radius 0) or ring with electrodes all over both faces.

    Attributes
    ----------
    radii : inner and outer, m;  thickness : m;  density : kg/m³
    degree : in the plane;  layers : degree through the thickness
    profiles : "c" and "e" → factor over x, y (k,) → (k,) on the stiffness and on the piezoelectric constants
    wedge : the thickness is t (1 + wedge x/R) at every x, y
    oval : the outline is stretched by (1 + oval) along x and shrunk by the same along y
    """

    radii: tuple[float, float]
    thickness: float
    density: float
    degree: int = 16
    layers: int = 5
    profiles: Mapping[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = field(default_factory=dict)
    wedge: float = 0.0
    oval: float = 0.0

    def heights(self, x: np.ndarray) -> np.ndarray:
        """Thickness at x over the nominal one."""
        return 1 + self.wedge * x / self.radii[1]

    def classes(self, surfaces: Sequence[RoundSurface]) -> list[tuple[int, ...]]:
        """Sign of the parity in z of the classes that surfaces couple, the driven one first."""
        return [(1,)] if all(len(surface.faces) == 2 for surface in surfaces) else [(1,), (-1,)]

    def part(self, signs: tuple[int, ...]) -> RoundClass:
        """The matrices of one parity class."""
        return RoundClass(self, signs[0])

    @cached_property
    def quadrature(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points x, y and weights over the half y > 0 of the outline, doubled."""
        inner, outer = self.radii
        nodes, weights = legendre.leggauss(self.degree + 6)
        r, turns = inner + (outer - inner) * (nodes + 1) / 2, 2 * self.degree + 8
        angle = np.pi * (np.arange(turns) + 0.5) / turns
        area = np.outer(r * weights * (outer - inner) / 2, np.full(turns, 2 * np.pi / turns))
        longer = 1 + self.oval
        return longer * np.outer(r, np.cos(angle)).ravel(), np.outer(r, np.sin(angle)).ravel() / longer, area.ravel()

    def plane(self, x: np.ndarray, y: np.ndarray, parity: int) -> np.ndarray:
        """(3, k, points) values and slopes by x, y of the functions even (1) or odd (−1) in y."""
        raw = self._stretched(x, y, parity)
        return raw if raw.shape[1] == 0 else np.einsum("kf,dfp->dkp", self._orthonormal[parity], raw)

    @cached_property
    def _orthonormal(self) -> dict[int, np.ndarray]:
        """Parity → combinations (k, functions) that are orthonormal over the outline."""
        x, y, weights = self.quadrature
        found = {}
        for parity in (1, -1):
            raw = self._stretched(x, y, parity)[0]
            size, turned = np.linalg.eigh((raw * weights) @ raw.T)
            keep = size > _SAME * size[-1]
            found[parity] = (turned[:, keep] / np.sqrt(size[keep])).T
        return found

    def _stretched(self, x: np.ndarray, y: np.ndarray, parity: int) -> np.ndarray:
        """Polynomials of the places in the round body before it was made oval, and their slopes in the oval body."""
        longer = 1 + self.oval
        return self._raw(x / longer, y * longer, parity) / np.array([1.0, longer, 1 / longer])[:, None, None]

    def _raw(self, x: np.ndarray, y: np.ndarray, parity: int) -> np.ndarray:
        """(3, functions, points) values and slopes by x, y of the plane polynomials, not yet orthonormal."""
        inner, outer = self.radii
        if inner == 0:
            lines = [_polynomials(place / outer, self.degree, outer) for place in (x, y)]
            pairs = [
                (i, j) for i in range(self.degree + 1) for j in range(self.degree + 1 - i) if j % 2 == (parity < 0)
            ]
            left, right = (np.array(numbers) for numbers in zip(*pairs, strict=True))
            (px, sx), (py, sy) = lines
            return np.array([px[left] * py[right], sx[left] * py[right], px[left] * sy[right]])
        r, angle = np.hypot(x, y), np.arctan2(y, x)
        value, slope = _polynomials(2 * (r - inner) / (outer - inner) - 1, self.degree, (outer - inner) / 2)
        orders = np.arange(parity < 0, self.degree + 1)
        cosine, sine = np.cos(np.outer(orders, angle)), np.sin(np.outer(orders, angle))
        around, turned = (cosine, -orders[:, None] * sine) if parity > 0 else (sine, orders[:, None] * cosine)
        pairs = [(i, j) for i in range(self.degree + 1) for j, n in enumerate(orders) if i + n <= self.degree]
        i, j = (np.array(numbers) for numbers in zip(*pairs, strict=True))
        along_r, along_angle = slope[i] * around[j], value[i] * turned[j] / r
        return np.array(
            [
                value[i] * around[j],
                along_r * np.cos(angle) - along_angle * np.sin(angle),
                along_r * np.sin(angle) + along_angle * np.cos(angle),
            ]
        )


def _polynomials(at: np.ndarray, degree: int, unit: float) -> tuple[np.ndarray, np.ndarray]:
    """(degree + 1, points) Legendre polynomials and their slopes over `unit`."""
    slopes = [legendre.legval(at, legendre.legder(row)) if row.size > 1 else 0 * at for row in np.eye(degree + 1)]
    return legendre.legvander(at, degree).T, np.array(slopes) / unit


class RoundClass(CrystalForms):
    """Matrices of one parity in z (1: u_z and φ odd, the driven class), with the attributes of
    `hidden_effects.body.ParityClass`.
    """

    def __init__(self, body: RoundBody, sign: int) -> None:
        self.driven, self.poling = sign == 1, 2
        self._body, x_y = body, body.quadrature
        self._plane = {parity: body.plane(x_y[0], x_y[1], parity) for parity in (1, -1)}
        #: parity in y of u_x, u_y, u_z, φ
        self._parity = (1, -1, 1, 1)
        self._nodes, self._weights = legendre.leggauss(body.layers + 4)
        self._lines = [self._line(f, sign, self._nodes) for f in range(4)]
        sizes = [self._plane[self._parity[f]].shape[1] * len(self._lines[f][0]) for f in range(4)]
        self.starts = np.concatenate([[0], np.cumsum(sizes[:3])])
        self.displacements, self.potentials = int(self.starts[-1]), sizes[3]
        self.mass = sl.block_diag(*(body.density * self.product(f, -1, f, -1) for f in range(3)))
        self.elastic, self.coupling, self.dielectric = (
            self.elastic_forms(),
            self.coupling_forms(),
            self.dielectric_forms(),
        )

    def _line(self, f: int, sign: int, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values and slopes (n, points) along z of one field at 2z/t; and of the volt."""
        half = self._body.thickness / 2
        if f == VOLT:
            return at[None] / 2, np.full((1, at.size), 0.5 / half)
        odd = (f >= 2) == (sign > 0)
        value, slope = _polynomials(at, self._body.layers + (f == 3), half)
        if f == 3:  # (1 − ζ²) P vanishes on both electrodes
            value, slope = (1 - at**2) * value, (1 - at**2) * slope - 2 * at / half * value
        return value[int(odd) :: 2], slope[int(odd) :: 2]

    def _functions(self, f: int) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """Plane functions (3, k, points) and lines along z of a field or of the volt."""
        if f == VOLT:
            points = self._body.quadrature[0].size
            flat = np.concatenate([np.ones((1, 1, points)), np.zeros((2, 1, points))])
            return flat, self._line(VOLT, 1, self._nodes)
        return self._plane[self._parity[f]], self._lines[f]

    def product(self, f: int, a: int, g: int, b: int, profile: str = "") -> np.ndarray:
        """∫ profile ∂_a f ∂_b g dV; −1: not differentiated."""
        x, y, weights = self._body.quadrature
        weights = weights * self._body.profiles.get(profile, lambda x, y: np.ones_like(x))(x, y)
        total = 0.0
        for left, left_z in self._slope(f, a):
            for right, right_z in self._slope(g, b):
                plane = (left * weights * self._body.heights(x)) @ right.T
                along = (left_z * self._weights * self._body.thickness / 2) @ right_z.T
                total = total + np.kron(plane, along)
        return total

    def _slope(self, f: int, a: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """∂_a of a field (−1: the field) as products of functions of x, y and of ζ = z/height, each (k, points)."""
        plane, line = self._functions(f)
        x, half = self._body.quadrature[0], self._body.thickness / 2
        height, rise = self._body.heights(x), self._body.wedge / self._body.radii[1]
        if a == -1:
            return [(plane[0], line[0])]
        if a == 2:
            return [(plane[0] / height, line[1])]
        found = [(plane[a + 1], line[0])]
        if a == 0 and rise:
            found.append((-plane[0] * rise / height, half * self._nodes * line[1]))
        return found

    def factor(self, surface: RoundSurface) -> np.ndarray:
        """B (n, g) with Σ weight |u|² = |Bᵗ u|² over the surface; the classes share columns."""
        sign, columns = (1 if self.driven else -1), []
        plane = {p: _on_surface(self._body.plane(surface.x, surface.y, p)[0], surface) for p in (1, -1)}
        for side in surface.faces:
            for f in surface.directions:
                line = self._line(f, sign, np.array([float(side)]))[0]
                plane_of_field = plane[self._parity[f]]
                block = np.zeros((self.displacements, plane_of_field.shape[1]))
                block[self.block(f)] = np.einsum("kp,zq->kzp", plane_of_field, line).reshape(
                    -1, plane_of_field.shape[1]
                )
                columns.append(block)
        return np.concatenate(columns, axis=1)


def _on_surface(plane: np.ndarray, surface: RoundSurface) -> np.ndarray:
    """B (k, g) with Σ weight |u|², or Σ |mean of u|² over the parts, = |Bᵗ u|² for functions (k, points)."""
    if not surface.parts:
        return _few(plane * np.sqrt(surface.weights))
    shares = surface.weights.reshape(surface.parts, -1)
    whole = np.einsum("kpg,pg->kp", plane.reshape(-1, *shares.shape), shares)
    return whole / np.sqrt(shares.sum(axis=1))


def _few(plane: np.ndarray) -> np.ndarray:
    """B (k, g) with the same B Bᵗ and no more columns than rows."""
    return plane if plane.shape[1] <= plane.shape[0] else np.linalg.qr(plane.T, mode="r").T
