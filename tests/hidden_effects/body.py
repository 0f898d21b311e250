"""Energy matrices of one parity class of a piezoelectric body by spectral elements in products of three axes.

Fields: u_x, u_y, u_z, the inner potential φ (zero where an electrode is), and one volt between the electrodes as
±1/2 on two opposite faces. A class has a sign for every symmetric axis; the driven class (1, 1, 1) has u_a odd along
a and even else, φ odd along the poling and even else. Nothing of femu_piezo is used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product

import numpy as np

from hidden_effects.crystal_forms import CrystalForms
from hidden_effects.spectral import Axis, Line, joined, quadrature

#: A factor (k,) over places (k,), m.
Profile = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Body:
    """A plate with its deviations from a simple homogeneous plate.

    Attributes
    ----------
    size : (length, width, thickness), m;  density : kg/m³
    axes : of the displacements along x, y, z;  potential_axes : of φ
    poling : 2 electrodes on z = ±t/2, 0 on x = ±L/2
    margins : bare strips at x = −L/2 and +L/2 of both faces, m (poling 2)
    profiles : "c", "e" and "rho" → factor over x (k,) → (k,) on the stiffness, the piezoelectric constants, the density
    soft : (p over x, q over y, even), by whose product the stiffness is less, relative
    across : factor over y (k,) → (k,) on the piezoelectric constants beside that over x
    taper, wedge : the width is w (1 + taper 2x/L), the thickness t (1 + wedge 2x/L)
    symmetric : whether the body has parity in x
    """

    size: tuple[float, float, float]
    density: float
    axes: tuple[Axis, Axis, Axis]
    potential_axes: tuple[Axis, Axis, Axis]
    poling: int = 2
    margins: tuple[float, float] = (0.0, 0.0)
    profiles: Mapping[str, Profile] = field(default_factory=dict)
    soft: tuple[Profile, Profile] | None = None
    across: Profile = np.ones_like
    taper: float = 0.0
    wedge: float = 0.0
    symmetric: bool = True

    def classes(self, surfaces: Sequence[Surface]) -> list[tuple[int, int, int]]:
        """Signs of the parity classes that surfaces couple, the driven class first; 0 where the body itself has no
        parity.
        """
        signs = []
        for axis in range(3):
            if axis == 0 and not self.symmetric:
                signs.append((0,))
            else:
                signs.append((1,) if all(surface.keeps()[axis] for surface in surfaces) else (1, -1))
        return list(product(*signs))

    def part(self, signs: tuple[int, int, int]) -> ParityClass:
        """The matrices of one parity class."""
        return ParityClass(self, signs)

    @cached_property
    def gauss(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Gauss points and weights along x, y, z that integrate all products of functions exactly."""
        found = []
        for a, b in zip(self.axes, self.potential_axes, strict=True):
            found.append(quadrature(joined(a.breaks, b.breaks), max(*a.degrees, *b.degrees) + 3))
        return found

    def extent(self, a: int, x: np.ndarray) -> np.ndarray:
        """Width (a = 1) or thickness (2) at x over the nominal one."""
        return 1 + (self.taper, self.wedge)[a - 1] * 2 * x / self.size[0]

    def volumes(self, x: np.ndarray) -> np.ndarray:
        """Volume element at x over that of the nominal plate."""
        return self.extent(1, x) * self.extent(2, x)

    def electroded(self, x: np.ndarray) -> np.ndarray:
        """Whether the faces at x carry electrodes; their edges belong to them."""
        half, edge = self.size[0] / 2, 1e-9
        return (x > -half + self.margins[0] - edge) & (x < half - self.margins[1] + edge)

    def derivative(self, a: int) -> list[tuple[int, np.ndarray, tuple[int, int]]]:
        """∂_a in the coordinates of the nominal plate: [(axis, factor over the points of x, powers of y and z)]."""
        x = self.gauss[0][0]
        if a > 0:
            return [(a, 1 / self.extent(a, x), (0, 0))]
        found = [(0, np.ones_like(x), (0, 0))]
        for side, size, powers in ((1, self.taper, (1, 0)), (2, self.wedge, (0, 1))):
            if size:
                found.append((side, -size * 2 / self.size[0] / self.extent(side, x), powers))
        return found


@dataclass(frozen=True)
class Surface:
    """Something on a rectangle of one face or both: coefficient(ω) × the surface's form.

    Attributes
    ----------
    x, y : ends of the rectangle, m
    faces : 1 for z = +t/2, −1 for z = −t/2
    coefficient : ω (k,) → (k,), N/m³ (for a membrane N/m) on the energy ½ coefficient ∫ |u|² dS
    directions : components of u that take part
    membrane : Poisson's ratio of a layer whose plane stress counts instead of u
    """

    x: tuple[float, float]
    y: tuple[float, float]
    faces: tuple[int, ...]
    coefficient: Callable[[np.ndarray], np.ndarray]
    directions: tuple[int, ...] = (0, 1, 2)
    membrane: float | None = None

    def keeps(self) -> tuple[bool, bool, bool]:
        """Whether the surface preserves the parity in x, y and z."""
        middle = [abs(sum(ends)) < 1e-12 for ends in (self.x, self.y)]
        return middle[0], middle[1], len(self.faces) == 2


class ParityClass(CrystalForms):
    """Matrices of one class; functions of a field in the order x, y, z, the last fastest.

    Attributes
    ----------
    elastic : (5, n, n);  coupling : (3, n, m + 1);  dielectric : (2, m + 1, m + 1), of the constants in the order
        of ELASTIC, COUPLING, DIELECTRIC; the last potential is the volt (zero where the class is not driven)
    mass : (n, n)
    """

    def __init__(self, body: Body, signs: tuple[int, int, int]) -> None:
        self._body, self.poling = body, body.poling
        self.driven = all(sign != -1 for sign in signs)
        self.lines: list[list[Line]] = []
        for f in range(4):
            odd = body.poling if f == 3 else f
            axes = body.potential_axes if f == 3 else body.axes
            self.lines.append([Line.of(axes[a], signs[a] * (-1 if a == odd else 1)) for a in range(3)])
        self._samples = [[line.sample(body.gauss[a][0]) for a, line in enumerate(self.lines[f])] for f in range(4)] + [
            self._volt()
        ]
        self._kept = self._free_potentials()
        self._products: dict[tuple, np.ndarray] = {}
        sizes = [int(np.prod([line.positions.size for line in self.lines[f]])) for f in range(3)]
        self.starts = np.concatenate([[0], np.cumsum(sizes)])
        self.displacements, self.potentials = int(self.starts[-1]), self._kept.size
        self.mass = self._mass()
        self.elastic, self.coupling, self.dielectric = (
            self.elastic_forms(),
            self.coupling_forms(),
            self.dielectric_forms(),
        )
        self._products.clear()

    def _volt(self):
        """Values and slopes along x, y, z of the potential of one volt between the electrodes."""
        found = []
        for a, (points, _) in enumerate(self._body.gauss):
            if a == self._body.poling:
                length = self._body.size[a]
                found.append((points[None] / length, np.full((1, points.size), 1 / length)))
            else:
                found.append((np.ones((1, points.size)), np.zeros((1, points.size))))
        return found

    def _free_potentials(self) -> np.ndarray:
        """Indices of the functions of φ that are free, not on an electrode."""
        body, (x, y, z) = self._body, [line.positions for line in self.lines[3]]
        shape = (x.size, y.size, z.size)
        if body.poling == 2:
            end = np.abs(np.abs(z) - body.size[2] / 2) < 1e-12
            held = body.electroded(x)[:, None, None] & end[None, None, :]
        else:
            held = (np.abs(np.abs(x) - body.size[0] / 2) < 1e-12)[:, None, None]
        return np.flatnonzero(~np.broadcast_to(held, shape).ravel())

    def _tensor(self, f: int, g: int, left: int, right: int, *factors: np.ndarray | float) -> np.ndarray:
        """∫ f g dV with factors over x, y, z; f is differentiated along the axis `left` and g along `right` (−1: not
        differentiated).
        """
        parts = []
        for a, ((_, weights), factor) in enumerate(zip(self._body.gauss, factors, strict=True)):
            first, second = self._samples[f][a][int(a == left)], self._samples[g][a][int(a == right)]
            parts.append((first * weights * factor) @ second.T)
        return np.kron(np.kron(parts[0], parts[1]), parts[2])

    def product(self, f: int, a: int, g: int, b: int, profile: str) -> np.ndarray:
        """∫ profile ∂_a f ∂_b g dV."""
        if (f, a, g, b) not in self._products:
            x, y, z = (points for points, _ in self._body.gauss)
            base = self._body.volumes(x) * self._body.profiles.get(profile, np.ones_like)(x)
            weights = [(base, self._body.across(y) if profile == "e" else np.ones_like(y))]
            if profile == "c" and self._body.soft is not None:
                weights.append((-base * self._body.soft[0](x), self._body.soft[1](y)))
            total = 0.0
            for along, across in weights:
                for left, u, p in self._body.derivative(a):
                    for right, v, q in self._body.derivative(b):
                        factors = along * u * v, across * y ** (p[0] + q[0]), z ** (p[1] + q[1])
                        total = total + self._tensor(f, g, left, right, *factors)
            total = total[self._kept] if f == 3 else total
            self._products[f, a, g, b] = total[:, self._kept] if g == 3 else total
        return self._products[f, a, g, b]

    def _mass(self) -> np.ndarray:
        found = np.zeros((self.displacements, self.displacements))
        x = self._body.gauss[0][0]
        volumes = self._body.volumes(x) * self._body.profiles.get("rho", np.ones_like)(x)
        for f in range(3):
            found[self.block(f), self.block(f)] = self._body.density * self._tensor(f, f, -1, -1, volumes, 1.0, 1.0)
        return found

    def factor(self, surface: Surface) -> np.ndarray:
        """B (n, g) with ∫ |u|² dS = |Bᵗ u|² over the surface (or its membrane energy); the classes share columns."""
        sides = []
        counts = [max(axis.degrees) + 3 for axis in self._body.axes[:2]]
        for ends, axis, count in zip((surface.x, surface.y), self._body.axes[:2], counts, strict=True):
            inner = [b for b in axis.breaks if ends[0] < b < ends[1]]
            sides.append(quadrature(joined(ends, inner), count))
        (x, wx), (y, wy) = sides
        root_x, root_y = np.sqrt(wx * self._body.extent(1, x)), np.sqrt(wy)
        columns = []
        for side in surface.faces:
            end = np.array([side * self._body.size[2] / 2])
            faces = []  # value, ∂_x, ∂_y of each field
            for f in range(3):
                ends = zip(self.lines[f], (x, y, end), strict=True)
                (vx, sx), (vy, sy), (vz, _) = (line.sample(points) for line, points in ends)
                vx, sx, vy, sy = vx * root_x, sx * root_x, vy * root_y, sy * root_y
                faces.append([np.kron(np.kron(p, q), vz) for p, q in ((vx, vy), (sx, vy), (vx, sy))])
            columns += (
                self._membrane(faces, surface.membrane)
                if surface.membrane is not None
                else [self._placed({f: faces[f][0]}) for f in surface.directions]
            )
        return np.concatenate(columns, axis=1)

    def _placed(self, blocks: Mapping[int, np.ndarray]) -> np.ndarray:
        """The given blocks of u_x, u_y, u_z as rows among all displacements; zero elsewhere."""
        width = next(iter(blocks.values())).shape[1]
        found = np.zeros((self.displacements, width))
        for f, block in blocks.items():
            found[self.block(f)] = block
        return found

    def _membrane(self, faces, nu: float) -> list[np.ndarray]:
        """Three square roots B of the membrane energy: |Bᵗ u|² add up to S_xx² + S_yy² + 2ν S_xx S_yy + (1 − ν)/2
        γ².
        """
        (_, xx, uy), (_, vx, yy) = faces[0], faces[1]
        plus, minus = np.sqrt((1 + nu) / 2), np.sqrt((1 - nu) / 2)
        return [
            self._placed({0: plus * xx, 1: plus * yy}),
            self._placed({0: minus * xx, 1: -minus * yy}),
            self._placed({0: minus * uy, 1: minus * vx}),
        ]
