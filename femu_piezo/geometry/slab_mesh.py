"""Curved hexahedra of high order for slabs: choice of the grid and its fineness, and the expected error of λ.

Rectangles and trapezoids have grids, disks and rings have polar cells. Both have a line at every electrode rim; on both
sides of it and below the faces the cells shrink geometrically towards it. Other bodies (round corners, holes), if they
have no rims, have a plane mesh of gmsh in layers.

The relative error of λ has a part from waves and edges (`shapes.eigenvalue_error`, `round_body.divisions_for`), and a
part from the singularity at a rim. With n graded cells on each side of the rim, at order p, the latter was at most

    0.007 · 2⁻ᵖ · 0.15ⁿ⁻¹ + 0.07 · 8⁻ᵖ

in measurements over plates and disks with partial electrodes (tests/verification/test_slab_meshes.py checks some): the
first term is the singularity in the innermost cell, the second the smooth field in its graded map. An error of 1e-5
takes order 5 or 6 and two or three graded cells, in grids as in polar cells, where the body is small enough for so many
cells. Plates with rims on one face or a tilted poling bend; the shear of bending decays from their free edges within a
third of the thickness: in cells of twice the thickness, the error there is 6 · 12⁻ᵖ. At the holes of a body meshed by
gmsh, with cells that span an eighth of a circle, it is 5 · 20⁻ᵖ.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import meshio
import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.geometry.curved_mesh import CurvedHexahedra
from femu_piezo.geometry.gmsh_session import mesh_drawing
from femu_piezo.geometry.plane_mesh import (
    RATIO,
    PlaneMesh,
    extruded,
    graded_lines,
    grid_plane,
    is_folded,
    least_jacobian,
    pillowed,
    polar_plane,
)
from femu_piezo.geometry.regions import Circle, Rectangle, Trapezoid
from femu_piezo.geometry.round_body import PINHOLE, angles_of, divisions_for
from femu_piezo.geometry.shape import bending_wavenumber, check_unknowns, fits, solution_cost
from femu_piezo.geometry.shapes import Plate, fewest_divisions
from femu_piezo.geometry.slab_cad import DRAWING_UNIT, divide_curves, draw_plane, partial_footprints

if TYPE_CHECKING:
    from femu_piezo.geometry.slab import Slab

#: Element orders to choose from.
_ORDERS = range(3, 8)
#: (c, b) in the error c b⁻ᵖ of λ at a rim from the singularity (`_SINGULAR`) and from the smooth field (`_GRADED`), see
#: above; largest number of graded cells on one side of a rim; share of the accuracy that is for waves and edges where
#: there are rims or holes.
_SINGULAR, _GRADED, _MOST_LAYERS, _SMOOTH = (7e-3, 2.0), (0.07, 8.0), 4, 0.5
#: (c, b) in the error c b⁻ᵖ of λ at the free edges of bodies that bend and are not round.
_FREE_EDGES = (6.0, 12.0)
#: (c, b) in the error c b⁻ᵖ of λ at a hole in cells of gmsh, measured in the same way as at rims.
_HOLES = (5.0, 20.0)
#: Reach of the graded cells on both sides of a rim and below the faces, over the thickness.
_REACH = 0.5
#: Memory of an entry of a cell matrix over that of an assembled operator: most unknowns are eliminated in their cell.
_ENTRY_MEMORY = 0.6
#: Where the cells at rims do not fit into the memory, the accuracy is relaxed as long as it is not above this.
_LEAST_ACCURACY = 1e-3
#: Settings of gmsh that are tried: shares of the edge, cells of a full circle. The search ends at a mesh whose least
#: Jacobian over the mean in a cell exceeds `_GOOD`.
_SHRUNK, _PER_CIRCLE, _GOOD = (1.0, 0.7, 0.5, 0.35), (8, 12, 16), 0.05


@dataclass(frozen=True)
class Fineness:
    """How fine a mesh is.

    Attributes
    ----------
    order : of the elements
    edge : largest edge of the cells along x, y and z, m; in a round body along the radius, m, the angle of one cell,
        rad, and along z, m
    rim_layers : number of graded cells within the reach of a rim
    """

    order: int
    edge: tuple[float, float, float]
    rim_layers: int = 1


class NoQuadrangles(InputError):
    """gmsh cannot divide a plane region into quadrangles of a good shape."""


def is_grid(slab: Slab) -> bool:
    """Whether the outline has four straight sides and no holes."""
    plain = isinstance(slab.outline, Trapezoid) or (
        isinstance(slab.outline, Rectangle) and slab.outline.corner_radius == 0
    )
    return plain and not slab.holes


def is_round(slab: Slab) -> bool:
    """Whether body and electrodes are rings or disks about the origin."""
    regions = (slab.outline, *slab.holes)
    concentric = all(isinstance(region, Circle) and region.center == (0.0, 0.0) for region in regions)
    return concentric and len(slab.holes) <= 1 and slab.electrodes.span is None and slab.electrodes.wrap is None


def mesh_for(
    slab: Slab, accuracy: float, wavenumber: float, mirrors: tuple[int, ...], order: int | None
) -> tuple[CurvedHexahedra, int, float]:
    """The cheapest cells that keep λ within `accuracy`, the order of their elements, and the error of λ at rims.

    Where the cells at electrode rims would not fit into the memory, `accuracy` is doubled until they do or until it
    exceeds 1e-3.

    Parameters
    ----------
    wavenumber : of the slowest shear wave at the highest frequency, 1/m
    order : of the elements; chosen from `_ORDERS` where None

    Raises
    ------
    InputError : the mesh would be too large;  NoQuadrangles : gmsh cannot make it
    """
    rims = bool(partial_footprints(slab))
    while True:
        best = min(
            _candidates(slab, accuracy, wavenumber, mirrors, order), key=lambda candidate: candidate.rank(accuracy)
        )
        if not rims or best.fits or accuracy > _LEAST_ACCURACY:
            break
        accuracy *= 2
    check_unknowns(best.unknowns, best.entries)
    return _in_layers(slab, best.plane, best.fine, mirrors), best.fine.order, best.error if rims else 0.0


@dataclass(frozen=True)
class _Candidate:
    """A plane mesh and its fineness, to choose from.

    Attributes
    ----------
    error : relative, of λ at rims and holes;  unknowns, entries : of the model and of its operator
    seconds : estimated time of a solution
    """

    fine: Fineness
    plane: PlaneMesh
    error: float
    unknowns: int
    entries: float
    seconds: float

    @property
    def fits(self) -> bool:
        """Whether it fits into the memory."""
        return fits(self.unknowns, self.entries)

    def rank(self, accuracy: float) -> tuple[bool, float, float]:
        """Sorting key, the best mesh first: meshes that fit, then by error where it exceeds its share, then by cost."""
        return not self.fits, max(self.error, accuracy * (1 - _SMOOTH)), self.seconds


def _candidates(
    slab: Slab, accuracy: float, wavenumber: float, mirrors: tuple[int, ...], order: int | None
) -> Iterator[_Candidate]:
    """Meshes of every order with the numbers of graded cells that `_choices` gives."""
    for p in _ORDERS if order is None else (order,):
        for fine, error in _choices(slab, p, accuracy, wavenumber, mirrors):
            plane = _plane(slab, fine, mirrors)
            layers, squares = _heights(slab, fine, mirrors).size - 1, plane.quads.shape[1]
            unknowns = int(4 * (p * layers + 1) * (squares * p**2 + 2 * p * np.sqrt(squares)))
            entries, cost = (
                _ENTRY_MEMORY * 16.0 * squares * layers * (p + 1) ** 6,
                solution_cost(p, squares * layers, unknowns),
            )
            yield _Candidate(fine, plane, error, unknowns, entries, cost)


def mesh_of_edge(slab: Slab, edge: float, mirrors: tuple[int, ...]) -> CurvedHexahedra:
    """Cells with one graded cell at electrode rims; edge : the largest, m (along arcs twice as much, at most 90°)."""
    if is_round(slab):
        turn = np.pi / 2 / np.ceil(np.pi / 2 * slab.outline.diameter / 2 / edge / 2)
        return slab_mesh(slab, Fineness(4, (edge, turn, edge)), mirrors)
    return slab_mesh(slab, Fineness(4, (edge, edge, edge)), mirrors)


def _choices(
    slab: Slab, p: int, accuracy: float, wavenumber: float, mirrors: tuple[int, ...]
) -> Iterator[tuple[Fineness, float]]:
    """The coarsest cells of order p that resolve waves within an accuracy, and their error of λ at rims and holes.

    The number of graded cells at rims grows until the error is within its share of the accuracy.
    """
    rims, holes = bool(partial_footprints(slab)), bool(slab.holes) and not is_round(slab)
    share = accuracy * (1 - _SMOOTH) if rims or holes else 0.0
    edge = _edges(slab, p, accuracy - share, wavenumber, mirrors)
    at_holes, at_edges, singular, graded = (c * b**-p for c, b in (_HOLES, _FREE_EDGES, _SINGULAR, _GRADED))
    bends = not is_round(slab) and 2 not in mirrors
    for layers in range(1, _MOST_LAYERS + 1):
        error = at_holes * holes + (singular * RATIO ** (layers - 1) + graded) * rims
        yield Fineness(p, edge, layers), max(error, at_edges * bends)
        if error <= share or not rims:
            break


def _edges(
    slab: Slab, p: int, accuracy: float, wavenumber: float, mirrors: tuple[int, ...]
) -> tuple[float, float, float]:
    """`Fineness.edge` of cells of order p whose error of λ from waves and edges of the body is within an accuracy."""
    if is_round(slab):
        radii, height = _radii(slab), slab.thickness / (2 if 2 in mirrors else 1)
        along = abs(slab.poling_direction[2]) == 1.0
        found = divisions_for(radii, slab.thickness, height, wavenumber, accuracy, along, p)
        return (radii[1] - radii[0]) / found.radial, np.pi / 2 / found.around, height / found.layers
    x_min, x_max, y_min, y_max = slab.outline.extents
    if not is_grid(slab):  # cells of gmsh are no cubes; their error was up to 1.2 times that of cubes
        accuracy /= 2
    box = Plate(x_max - x_min, y_max - y_min, slab.thickness, "thickness", slab.direction)
    size = box.part(tuple(axis for axis in mirrors if axis in box.mirrors))
    bending = 0.0 if 2 in mirrors else bending_wavenumber(wavenumber, slab.thickness)
    phase = size * np.array([max(wavenumber, bending), max(wavenumber, bending), wavenumber])
    return tuple((size / fewest_divisions(p, phase, accuracy)).tolist())


def slab_mesh(slab: Slab, fine: Fineness, mirrors: tuple[int, ...]) -> CurvedHexahedra:
    """The computed part as a grid, in polar cells or in cells of gmsh; its boundaries have no names."""
    return _in_layers(slab, _plane(slab, fine, mirrors), fine, mirrors)


def _plane(slab: Slab, fine: Fineness, mirrors: tuple[int, ...]) -> PlaneMesh:
    if is_grid(slab):
        return grid_plane(_grid(slab, fine, mirrors))
    if is_round(slab):
        return polar_plane(*_polar_lines(slab, fine, mirrors))
    return _drawn_plane(slab, fine, mirrors)


def _in_layers(slab: Slab, plane: PlaneMesh, fine: Fineness, mirrors: tuple[int, ...]) -> CurvedHexahedra:
    return extruded(plane, _heights(slab, fine, mirrors), slab.on_rim, _rims(slab, mirrors))


def _rims(slab: Slab, mirrors: tuple[int, ...]) -> tuple[bool, bool]:
    """Whether the lower and the upper face of the part have electrode rims."""
    partial = bool(partial_footprints(slab))
    return partial and slab.electrodes.margin > 0 and 2 not in mirrors, partial


def _heights(slab: Slab, fine: Fineness, mirrors: tuple[int, ...]) -> np.ndarray:
    """(n,) growing z of the boundaries of the layers, m."""
    stops = np.array([0.0 if 2 in mirrors else -slab.thickness / 2, slab.thickness / 2])
    reach = _REACH * slab.thickness
    return graded_lines(stops, np.array(_rims(slab, mirrors)), fine.edge[2], reach, fine.rim_layers)


def _grid(slab: Slab, fine: Fineness, mirrors: tuple[int, ...]) -> np.ndarray:
    """(2, nx, ny) points of the grid, m: lines of constant x, and lines between the slanted sides."""
    reach, layers = _REACH * slab.thickness, fine.rim_layers
    outer, inner = slab.outline, slab.hot.outline
    half = outer.length / 2
    rims = [x for x in slab.rims_x if -half * (1 - 1e-9) < x < half * (1 - 1e-9)]
    x = _lines(half, rims, 0 in mirrors, fine.edge[0], reach, layers)
    wide, tilt = _half_widths(outer)
    sides, tilts = [wide], [tilt]
    if slab.electrodes.margin:
        sides, tilts = [_half_widths(inner)[0], wide], [_half_widths(inner)[1], tilt]
    if 1 not in mirrors:
        sides, tilts = [-w for w in sides[::-1]] + sides, [-w for w in tilts[::-1]] + tilts
    else:
        sides, tilts = [0.0, *sides], [0.0, *tilts]
    at = half if tilt > 0 else -half  # the lines are spaced at the widest end
    stops = np.array(sides) + np.array(tilts) * at
    flags = np.array([0.0 < abs(w) < wide for w in sides])
    y = graded_lines(stops, flags, fine.edge[1], reach, layers)
    cell = np.clip(np.searchsorted(stops, y, side="right") - 1, 0, stops.size - 2)
    share = (y - stops[cell]) / (stops[cell + 1] - stops[cell])
    lines = np.array([np.array(sides), np.array(tilts)])
    place, slope = lines[:, cell] * (1 - share) + lines[:, cell + 1] * share
    return np.array([np.broadcast_to(x[:, None], (x.size, y.size)), place + slope * x[:, None]])


def _lines(half: float, rims: list[float], mirrored: bool, edge: float, reach: float, layers: int) -> np.ndarray:
    """(n,) lines of constant x from −half, or from the mirror plane at 0, to half, with a line at every rim, m."""
    low = 0.0 if mirrored else -half
    stops = np.array([low, *sorted(x for x in set(rims) if x > low), half])
    flags = np.zeros(stops.size, dtype=bool)
    flags[1:-1] = True
    return graded_lines(stops, flags, edge, reach, layers)


def _half_widths(outline: Rectangle | Trapezoid) -> tuple[float, float]:
    """Half the width at x = 0, m, and its slope along x."""
    if isinstance(outline, Rectangle):
        return outline.width / 2, 0.0
    return (outline.width + outline.width_end) / 4, (outline.width_end - outline.width) / (2 * outline.length)


def _radii(slab: Slab) -> tuple[float, float]:
    """Inner (0 for a disk) and outer radius, m."""
    return (slab.holes[0].diameter / 2 if slab.holes else 0.0), slab.outline.diameter / 2


def _polar_lines(slab: Slab, fine: Fineness, mirrors: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Radii, m, and angles, rad, of the boundaries of polar cells."""
    (inner, outer), margin = _radii(slab), slab.electrodes.margin
    rims = [r for r in (inner + margin if inner else 0.0, outer - margin) if margin and r > 0]
    stops = np.array([inner or PINHOLE * outer, *rims, outer])
    flags = np.isin(np.arange(stops.size), np.arange(1, stops.size - 1))
    lines = graded_lines(stops, flags, fine.edge[0], _REACH * slab.thickness, fine.rim_layers)
    return lines, angles_of(mirrors, round(np.pi / 2 / fine.edge[1]))


def _drawn_plane(slab: Slab, fine: Fineness, mirrors: tuple[int, ...]) -> PlaneMesh:
    """Quadrangles of gmsh with a layer along curves (`pillowed`): the try with the largest least Jacobian."""
    best, quality = None, 0.0
    for shrunk, per_circle, subdivided in itertools.product(_SHRUNK, _PER_CIRCLE, (False, True)):
        raw = _drawing(slab, min(fine.edge[:2]) * shrunk, mirrors, per_circle, subdivided)
        if {block.type for block in raw.cells} & {"triangle", "triangle6"}:
            continue
        drawn = _plane_mesh(raw)
        if is_folded(drawn):
            continue
        mesh = pillowed(drawn)
        jacobian = least_jacobian(mesh)
        if jacobian > quality:
            best, quality = mesh, jacobian
        if quality > _GOOD:
            break
    if best is None:
        raise NoQuadrangles("gmsh cannot divide the slab into quadrangles of a good shape")
    return best


def _drawing(slab: Slab, edge: float, mirrors: tuple[int, ...], per_circle: int, subdivided: bool) -> meshio.Mesh:
    """Quadrangles with edges of about `edge`, m, drawn in mm; directly from gmsh, or by subdivision of its cells."""
    options = {
        "Mesh.MeshSizeMax": edge * DRAWING_UNIT * (2 if subdivided else 1),
        "Mesh.ElementOrder": 2,
        "Mesh.RecombineAll": 1,
        "Mesh.RecombinationAlgorithm": 1 if subdivided else 3,
        "Mesh.SubdivisionAlgorithm": int(subdivided),
        "Mesh.Algorithm": 6 if subdivided else 8,
    }
    drawn = slab.scaled(DRAWING_UNIT)

    def build(gmsh) -> None:
        draw_plane(gmsh, drawn, mirrors)
        divide_curves(gmsh, options["Mesh.MeshSizeMax"], per_circle // (2 if subdivided else 1))

    return mesh_drawing(build, options, "the slab", dimension=2)


def _plane_mesh(raw: meshio.Mesh) -> PlaneMesh:
    """The quadrangles of second order of a drawing in mm, counterclockwise, in m; their sides are lines and arcs."""
    cells, points = raw.cells_dict["quad9"].T, raw.points[:, :2].T / DRAWING_UNIT
    corners, vertex = np.unique(cells[:4], return_inverse=True)
    quads, middles = vertex.reshape(4, -1), points[:, cells[4:8]]
    turned = _signed_area(points[:, cells[:4]]) < 0
    quads[:, turned] = quads[[0, 3, 2, 1]][:, turned]
    middles[:, :, turned] = middles[:, [3, 2, 1, 0]][:, :, turned]
    return PlaneMesh(points[:, corners], quads, middles)


def _signed_area(corners: np.ndarray) -> np.ndarray:
    """(cells,) signed area of quadrangles (2, 4, cells), from their diagonals."""
    a, b = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
    return (a[0] * b[1] - a[1] * b[0]) / 2
