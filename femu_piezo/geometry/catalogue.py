"""Shapes by name, each one line: disk, ring, square, trapezoid, plate with round corners, holes or chamfers.

    disk(10e-3, 1e-3)                                             # diameter, thickness, m
    trapezoid(20e-3, 6e-3, 3e-3, 1e-3, electrodes=Electrodes(span=(0.0, 10e-3)))
    plate(20e-3, 6e-3, 1e-3, corner_radius=1e-3, holes=(Circle(2e-3, (5e-3, 0.0)),))

All are `Slab`s about the origin, with faces normal to z; keyword arguments: holes, electrodes, chamfer, direction,
elements (see `Slab`). For a rectangular plate without any of these, `shapes.Plate` is the better choice.
"""

from __future__ import annotations

from typing import Any

from femu_piezo.errors import InputError
from femu_piezo.geometry.regions import Circle, Rectangle, Trapezoid
from femu_piezo.geometry.slab import Slab


def disk(diameter: float, thickness: float, **options: Any) -> Slab:
    """Disk of a diameter and thickness, m."""
    return Slab(Circle(diameter), thickness, **options)


def ring(diameter: float, inner_diameter: float, thickness: float, **options: Any) -> Slab:
    """Ring between two diameters, m."""
    if not 0 < inner_diameter < diameter:
        raise InputError(
            f"the inner diameter {inner_diameter:g} m must lie between 0 and the outer one, {diameter:g} m"
        )
    holes = (Circle(inner_diameter), *options.pop("holes", ()))
    return Slab(Circle(diameter), thickness, holes=holes, **options)


def plate(length: float, width: float, thickness: float, corner_radius: float = 0.0, **options: Any) -> Slab:
    """Rectangular plate, m, with rounded corners where a radius is given."""
    return Slab(Rectangle(length, width, corner_radius), thickness, **options)


def square(side: float, thickness: float, **options: Any) -> Slab:
    """Square plate, m."""
    return plate(side, side, thickness, **options)


def trapezoid(length: float, width: float, width_end: float, thickness: float, **options: Any) -> Slab:
    """Symmetric trapezoidal plate: `width` at x = −length/2, `width_end` at x = +length/2, m."""
    return Slab(Trapezoid(length, width, width_end), thickness, **options)
