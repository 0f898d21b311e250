"""Plane regions: outlines of plates, holes and electrodes, each with its exact area, depth and mirror planes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from femu_piezo.errors import InputError


class Region(Protocol):
    """A plane region that contains its centre of reference, coordinates in m.

    `extents`: (x_min, x_max, y_min, y_max); `mirrors`: axes (0: x, 1: y) normal to a mirror line through the origin;
    `depth(x, y)`: distance to the edge, positive inside; `inset(distance)`: the region less a rim of that width;
    `area`: m²; `scaled(factor)`: every length times `factor`; `add(occ)`: tag of the surface in the gmsh OpenCASCADE
    model `occ`.
    """

    @property
    def area(self) -> float: ...

    @property
    def extents(self) -> tuple[float, float, float, float]: ...

    @property
    def mirrors(self) -> frozenset[int]: ...

    def depth(self, x: np.ndarray, y: np.ndarray) -> np.ndarray: ...

    def inset(self, distance: float) -> Region: ...

    def scaled(self, factor: float) -> Region: ...

    def add(self, occ) -> int: ...


@dataclass(frozen=True)
class Rectangle:
    """length × width along x, y, centred at the origin, with rounded corners of `corner_radius`."""

    length: float
    width: float
    corner_radius: float = 0.0

    def __post_init__(self) -> None:
        if not (self.length > 0 and self.width > 0):
            raise InputError(
                f"a rectangle of {self.length:g} × {self.width:g} m has no area; is a margin larger than the plate?"
            )
        largest = min(self.length, self.width) / 2
        if not 0 <= self.corner_radius < largest:
            raise InputError(
                f"the corner radius {self.corner_radius:g} m must be at least 0 and below half the shorter side, "
                f"{largest:g} m"
            )

    @property
    def area(self) -> float:
        """Area within the rounded outline, m²."""
        return self.length * self.width - (4 - np.pi) * self.corner_radius**2

    @property
    def extents(self) -> tuple[float, float, float, float]:
        return (-self.length / 2, self.length / 2, -self.width / 2, self.width / 2)

    @property
    def mirrors(self) -> frozenset[int]:
        return frozenset({0, 1})

    def depth(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        radius = self.corner_radius
        a = np.abs(x) - (self.length / 2 - radius)
        b = np.abs(y) - (self.width / 2 - radius)
        outside = np.hypot(np.maximum(a, 0.0), np.maximum(b, 0.0))
        return radius - outside - np.minimum(np.maximum(a, b), 0.0)

    def inset(self, distance: float) -> Rectangle:
        radius = max(self.corner_radius - distance, 0.0)
        return Rectangle(self.length - 2 * distance, self.width - 2 * distance, radius)

    def scaled(self, factor: float) -> Rectangle:
        """Every length times `factor`."""
        return Rectangle(self.length * factor, self.width * factor, self.corner_radius * factor)

    def add(self, occ) -> int:
        return occ.addRectangle(
            -self.length / 2, -self.width / 2, 0.0, self.length, self.width, roundedRadius=self.corner_radius
        )


@dataclass(frozen=True)
class Trapezoid:
    """Symmetric about the x axis: `width` at x = −length/2 tapers to `width_end` at x = +length/2."""

    length: float
    width: float
    width_end: float

    def __post_init__(self) -> None:
        if not (self.length > 0 and self.width > 0 and self.width_end > 0):
            raise InputError(
                f"a trapezoid of length {self.length:g} m and widths {self.width:g} and {self.width_end:g} m has no "
                "area; is a margin larger than the plate?"
            )

    @property
    def area(self) -> float:
        """Enclosed area, m²."""
        return self.length * (self.width + self.width_end) / 2

    @property
    def extents(self) -> tuple[float, float, float, float]:
        half = max(self.width, self.width_end) / 2
        return (-self.length / 2, self.length / 2, -half, half)

    @property
    def mirrors(self) -> frozenset[int]:
        return frozenset({0, 1}) if self.width == self.width_end else frozenset({1})

    @property
    def _slope(self) -> float:
        """Decrease of half the width per length along x."""
        return (self.width - self.width_end) / (2 * self.length)

    def depth(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Distance to the nearest of the four lines: exact inside, a lower bound of the distance outside."""
        half = (self.width + self.width_end) / 4 - self._slope * x
        to_side = (half - np.abs(y)) / np.hypot(1.0, self._slope)
        return np.minimum(self.length / 2 - np.abs(x), to_side)

    def inset(self, distance: float) -> Trapezoid:
        inward = distance * np.hypot(1.0, self._slope)
        ends = [
            width / 2 - inward - sign * self._slope * distance
            for width, sign in ((self.width, 1), (self.width_end, -1))
        ]
        return Trapezoid(self.length - 2 * distance, 2 * ends[0], 2 * ends[1])

    def scaled(self, factor: float) -> Trapezoid:
        """Every length times `factor`."""
        return Trapezoid(self.length * factor, self.width * factor, self.width_end * factor)

    def add(self, occ) -> int:
        a, b, c = self.length / 2, self.width / 2, self.width_end / 2
        points = [occ.addPoint(x, y, 0.0) for x, y in ((-a, -b), (a, -c), (a, c), (-a, b))]
        lines = [occ.addLine(points[i], points[(i + 1) % 4]) for i in range(4)]
        return occ.addPlaneSurface([occ.addCurveLoop(lines)])


@dataclass(frozen=True)
class Circle:
    """Disk of `diameter` about `center` (x, y)."""

    diameter: float
    center: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if not self.diameter > 0:
            raise InputError(f"a circle of diameter {self.diameter:g} m has no area; is a margin larger than the disk?")

    @property
    def area(self) -> float:
        """Enclosed area, m²."""
        return np.pi * self.diameter**2 / 4

    @property
    def extents(self) -> tuple[float, float, float, float]:
        (x, y), r = self.center, self.diameter / 2
        return (x - r, x + r, y - r, y + r)

    @property
    def mirrors(self) -> frozenset[int]:
        return frozenset(axis for axis in (0, 1) if self.center[axis] == 0)

    def depth(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return self.diameter / 2 - np.hypot(x - self.center[0], y - self.center[1])

    def inset(self, distance: float) -> Circle:
        return replace(self, diameter=self.diameter - 2 * distance)

    def scaled(self, factor: float) -> Circle:
        """Every length times `factor`."""
        x, y = self.center
        return Circle(self.diameter * factor, (x * factor, y * factor))

    def add(self, occ) -> int:
        return occ.addDisk(*self.center, 0.0, self.diameter / 2, self.diameter / 2)


@dataclass(frozen=True)
class Footprint:
    """The region of a face that an electrode covers: `outline` without `holes`, between two values of x.

    Attributes
    ----------
    holes : circular openings in it
    x_range : (low, high), m; None for the whole outline
    """

    outline: Region
    holes: tuple[Circle, ...] = ()
    x_range: tuple[float, float] | None = None

    def covers(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(n,) which points x, y (n,), m, lie inside."""
        inside = self.outline.depth(x, y) > 0
        for hole in self.holes:
            inside &= hole.depth(x, y) < 0
        if self.x_range is not None:
            inside &= (x > self.x_range[0]) & (x < self.x_range[1])
        return inside

    @property
    def holes_apart(self) -> bool:
        """Whether every hole lies inside the outline and outside of the others, so that their areas are subtracted."""
        for index, hole in enumerate(self.holes):
            radius, (x, y) = hole.diameter / 2, np.array(hole.center)[:, None]
            room = [self.outline.depth(x, y), *(-other.depth(x, y) for other in self.holes[:index])]
            if np.min(room) < radius:
                return False
        return True

    @property
    def mirrors(self) -> frozenset[int]:
        """Axes (0: x, 1: y) normal to a mirror line of the footprint through the origin."""
        axes = self.outline.mirrors
        for hole in self.holes:
            axes &= hole.mirrors
        if self.x_range is not None and not np.isclose(self.x_range[0], -self.x_range[1], rtol=1e-9):
            axes -= {0}
        return axes

    def add(self, occ) -> list[tuple[int, int]]:
        """(dim, tag) of the surfaces of the footprint in the OpenCASCADE model `occ`."""
        surfaces = [(2, self.outline.add(occ))]
        if self.holes:
            surfaces, _ = occ.cut(surfaces, [(2, hole.add(occ)) for hole in self.holes])
        if self.x_range is not None:
            x_min, x_max, y_min, y_max = self.outline.extents
            low, high = max(self.x_range[0], x_min), min(self.x_range[1], x_max)
            band = occ.addRectangle(low, y_min, 0.0, high - low, y_max - y_min)
            surfaces, _ = occ.intersect(surfaces, [(2, band)])
        return surfaces
