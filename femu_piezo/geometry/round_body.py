"""Disks and rings as a few curved cells of high order in polar coordinates, without a mesh generator.

The driven field of a body poled along its axis is axisymmetric: u_x = u_r(r, z) cos θ. One cell of order four or more
resolves a quarter turn of such a field, so most cells are needed along the radius. A disk is meshed as a ring with a
pinhole, which changes its eigenvalues by 1e-9 and keeps every cell a hexahedron.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import count

import numpy as np

from femu_piezo.geometry.domain import Domain
from femu_piezo.geometry.plane_mesh import extruded, labelled, polar_plane
from femu_piezo.geometry.shape import bending_wavenumber, check_unknowns, edge_error, solution_cost, wave_error

#: Radius of the pinhole of a disk, relative to that of the disk.
PINHOLE = 1e-5
#: Element orders to choose from.
_ORDERS = range(4, 9)
#: `_RADIAL`: wavenumber of the shortest radial wave over that of shear waves, in a thin body, where only extension
#: propagates, and in a thick body. `_THIN`, `_THICK`: shear wavenumber times half the thickness below which a body
#: counts as thin and above which it counts as thick.
_RADIAL, _THIN, _THICK = (0.7, 1.0), 1.2, 2.5
#: Error along the angle of an axisymmetric field, over `wave_error` of the angle of a cell.
_ANGLE = 6.0
#: Error from the 1/r in the field of a ring, over the geometric decay of `_curvature_error`.
_CURVATURE = 30.0
#: Error from the edges of the rim, over `edge_error` at the inertia k t/2 across half the thickness.
_EDGES = 0.15
#: Largest height of a cell over the width of the ring: fields at the edges of a tall ring decay over its width.
_TALLEST = 0.5


@dataclass(frozen=True)
class Divisions:
    """Elements of a disk or ring.

    Attributes
    ----------
    order : of the elements
    radial, around, layers : cells along the radius, in a quarter turn, and through the computed height
    """

    order: int
    radial: int
    around: int
    layers: int

    def unknowns(self, quarters: int = 1) -> int:
        """Number of displacements and potentials of a part of `quarters` quarter turns."""
        p = self.order
        return 4 * (p * self.radial + 1) * (p * self.around * quarters + 1) * (p * self.layers + 1)

    def cost(self) -> float:
        """Estimated time of a solution, s, for a quarter turn."""
        return solution_cost(self.order, self.radial * self.around * self.layers, self.unknowns())


def divisions_for(
    radii: tuple[float, float],
    thickness: float,
    height: float,
    wavenumber: float,
    accuracy: float,
    axisymmetric: bool = True,
    order: int | None = None,
) -> Divisions:
    """The cheapest elements whose predicted eigenvalue error is within `accuracy`.

    The prediction was measured on random disks and rings; tests/verification/test_round_bodies.py holds some to it.

    Parameters
    ----------
    radii : inner (0 for a disk) and outer radius, m
    height : the thickness, m, or half of it where the part is cut at mid-height
    wavenumber : of the slowest shear wave at the highest frequency, 1/m
    axisymmetric : whether the driven field is axisymmetric
    order : of the elements; chosen from `_ORDERS` where None
    """
    (inner, outer), width = radii, radii[1] - radii[0]
    inertia = wavenumber * thickness / 2
    thick = np.clip((inertia - _THIN) / (_THICK - _THIN), 0.0, 1.0)
    radial_wave = wavenumber * (_RADIAL[0] + (_RADIAL[1] - _RADIAL[0]) * thick)
    turn, weight = np.pi / 2, _ANGLE
    if not axisymmetric:  # the body bends, and its field has waves along the angle
        along_faces = max(wavenumber, bending_wavenumber(wavenumber, thickness))
        radial_wave, turn, weight = max(radial_wave, along_faces), along_faces * outer * np.pi / 2, 1.0

    def edges(p: int, edge: float) -> float:
        return _EDGES * edge_error(p, wavenumber * edge, inertia)

    def along_radius(p: int, edge: float) -> float:
        return wave_error(p, radial_wave * edge) + _curvature_error(p, inner, edge) + edges(p, edge)

    def along_height(p: int, edge: float) -> float:
        return wave_error(p, wavenumber * edge) + edges(p, edge)

    lowest = int(np.ceil(height / (_TALLEST * width)))
    found = []
    for p in _ORDERS if order is None else (order,):
        around = next(n for n in count(1) if weight * wave_error(p, turn / n) < 0.3 * accuracy)
        remaining = accuracy - weight * wave_error(p, turn / around)
        enough = next(n for n in count(lowest) if along_height(p, height / n) < 0.9 * remaining)
        for layers in (enough, enough + 1):
            rest = remaining - along_height(p, height / layers)
            found.append(Divisions(p, next(n for n in count(1) if along_radius(p, width / n) < rest), around, layers))
    return min(found, key=Divisions.cost)


def _curvature_error(order: int, inner: float, edge: float) -> float:
    """Error of the innermost cell of a ring from the 1/r in its field; edge : of the cell along the radius, m.

    `_CURVATURE` · ρ^(−2p), ρ = d + √(d² − 1), with d the distance from the middle of the cell to r = 0 over half its
    edge; 0 for a disk.
    """
    if inner == 0:
        return 0.0
    distance = (2 * inner + edge) / edge
    return _CURVATURE * (distance + np.sqrt(distance**2 - 1)) ** (-2 * order)


def round_domain(
    radii: tuple[float, float],
    thickness: float,
    divisions: Divisions,
    mirrors: Iterable[int],
    poling: tuple[float, float, float],
) -> Domain:
    """The computed part of a disk (inner radius 0) or ring with fully covered faces, cut at its mirror planes, m.

    mirrors : axes at whose mid-planes the part is cut
    """
    mirrors = tuple(sorted(mirrors))
    check_unknowns(divisions.unknowns(quarters_of(mirrors)), 16.0 * _element_entries(divisions, mirrors))
    (inner, outer), half = radii, thickness / 2
    low = 0.0 if 2 in mirrors else -half
    across = np.linspace(inner or PINHOLE * outer, outer, divisions.radial + 1)
    plane = polar_plane(across, angles_of(mirrors, divisions.around))
    mesh = extruded(plane, np.linspace(low, half, divisions.layers + 1))
    ground, near = "mirror_z" if 2 in mirrors else "ground", 1e-9 * outer
    places = {"hot": (2, half), ground: (2, low)} | {f"mirror_{'xyz'[axis]}": (axis, 0.0) for axis in mirrors}

    def on(axis: int, place: float) -> Callable[[np.ndarray], np.ndarray]:
        return lambda x: np.abs(x[axis] - place) < near

    return Domain(
        mesh=labelled(mesh, {name: on(*place) for name, place in places.items()}),
        hot=("hot",),
        ground=(ground,),
        symmetry={f"mirror_{'xyz'[axis]}": axis for axis in mirrors},
        copies=2 ** len(mirrors),
        voltage_factor=2.0 if 2 in mirrors else 1.0,
        poling=poling,
        order=divisions.order,
    )


def _element_entries(divisions: Divisions, mirrors: tuple[int, ...]) -> float:
    """Number of entries of all element matrices of one field."""
    count = quarters_of(mirrors) * divisions.radial * divisions.around * divisions.layers
    return count * (divisions.order + 1.0) ** 6


def quarters_of(mirrors: tuple[int, ...]) -> int:
    """Number of quarter turns of a part that is cut at some mirror planes."""
    return 4 // 2 ** len({0, 1} & set(mirrors))


def angles_of(mirrors: tuple[int, ...], around: int) -> np.ndarray:
    """(n,) growing angles of the cell boundaries of a part, rad, with `around` cells in a quarter turn."""
    start, quarters = (0.0 if 1 in mirrors or 0 not in mirrors else -np.pi / 2), quarters_of(mirrors)
    return start + np.pi / 2 * np.linspace(0, quarters, quarters * around + 1)
