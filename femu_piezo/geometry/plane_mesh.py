"""Plane meshes of quadrangles with straight sides or arcs, graded towards electrode rims, and their extrusion.

Where an electrode ends inside a face, D is singular with the inverse square root of the distance r to its rim.
Polynomials in r converge slowly there, whatever their order. In a cell that touches the rim, r is therefore an
exponential of the reference coordinate, r ~ exp(a s) − 1: the maps of the cells grade the mesh, without more cells than
the smooth field needs. A side has the same map in both of its cells, so the mesh is conforming.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import skfem
from numpy.polynomial import chebyshev

from femu_piezo.geometry.curved_mesh import CurvedHexahedra

#: Order of the Chebyshev polynomials of a side: they approximate a graded quarter turn to 1e-12 of its radius.
GEOMETRY_ORDER = 16
#: Grading of a side towards an electrode rim: slope of its map at the rim over that at the other end is exp(−GRADING).
GRADING = 2.0
#: Ratio of the distances of successive grid lines from an electrode rim, the nearer line over the farther.
RATIO = 0.15
#: Corners at the ends of each side of a quadrangle, whose corners are (0, 0), (1, 0), (1, 1), (0, 1) in this order.
SIDES = ((0, 1), (1, 2), (3, 2), (0, 3))

#: Function of points x, y (n,), m: whether each lies on the rim of an electrode.
OnRim = Callable[[np.ndarray, np.ndarray], np.ndarray]

#: Chebyshev points on [0, 1], and the matrix from values there to Chebyshev coefficients in 2s − 1.
_GRID = (1 - np.cos(np.pi * np.arange(GEOMETRY_ORDER + 1) / GEOMETRY_ORDER)) / 2
_FIT = np.linalg.inv(chebyshev.chebvander(2 * _GRID - 1, GEOMETRY_ORDER))


@dataclass(frozen=True)
class PlaneMesh:
    """Quadrangles of a plane region.

    Attributes
    ----------
    p : (2, n) vertices, m;  quads : (4, cells) numbers of the vertices, counterclockwise
    middles : (2, 4, cells) midpoint of each side, m, in the order of `SIDES`: a side is the arc through its ends and
        this point
    """

    p: np.ndarray
    quads: np.ndarray
    middles: np.ndarray


def _nowhere(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.zeros(x.shape, dtype=bool)


def graded(toward_start: np.ndarray, toward_end: np.ndarray) -> np.ndarray:
    """(…, k) `_GRID` mapped onto [0, 1], finer towards a flagged end (…); unchanged where both or none are flagged."""
    start = np.expm1(GRADING * _GRID) / np.expm1(GRADING)
    a, b = toward_start[..., None], toward_end[..., None]
    return np.where(a & ~b, start, np.where(b & ~a, 1 - start[::-1], _GRID))


def arc(start: np.ndarray, middle: np.ndarray, end: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(2, m, k) points at the shares `at` (m, k) of the lengths of m arcs, each through three points (2, m)."""
    chord, rise = end - start, middle - (start + end) / 2
    length = np.hypot(*chord)
    height = (chord[0] * rise[1] - chord[1] * rise[0]) / length
    half = 2 * np.arctan2(2 * height, length)  # half the angle of the arc, signed by the side on which it lies
    straight = np.abs(half) < 1e-9
    safe = np.where(straight, 1.0, half)
    turn = (2 * at - 1) * safe[:, None]
    along = np.where(straight[:, None], at, (1 + np.sin(turn) / np.sin(safe)[:, None]) / 2)
    across = np.where(straight[:, None], 0.0, (np.cos(turn) - np.cos(safe)[:, None]) / (2 * np.sin(safe)[:, None]))
    normal = np.array([-chord[1], chord[0]])
    return start[:, :, None] + chord[:, :, None] * along + normal[:, :, None] * across


def side_maps(mesh: PlaneMesh, on_rim: OnRim) -> np.ndarray:
    """(2, 4, cells, k) Chebyshev coefficients of the sides, graded towards ends on a rim unless they lie along it."""
    found = []
    vertex = on_rim(*mesh.p)
    for i, (a, b) in enumerate(SIDES):
        start, end, middle = mesh.quads[a], mesh.quads[b], mesh.middles[:, i]
        across = ~on_rim(*middle)
        at = graded(vertex[start] & across, vertex[end] & across)
        found.append(arc(mesh.p[:, start], middle, mesh.p[:, end], at) @ _FIT.T)
    return np.stack(found, axis=1)


def blended(sides: np.ndarray) -> np.ndarray:
    """(2, cells, i, j) Chebyshev coefficients of the maps of cells, by transfinite interpolation of their sides."""
    bottom, right, top, left = sides.transpose(1, 0, 2, 3)
    low, high = np.array([0.5, -0.5]), np.array([0.5, 0.5])  # 1 − X and X in Chebyshev polynomials of 2X − 1
    size = sides.shape[-1]
    found = np.zeros((*bottom.shape[:2], size, size))
    found[..., :2] += bottom[..., None] * low + top[..., None] * high
    found[..., :2, :] += left[..., None, :] * low[:, None] + right[..., None, :] * high[:, None]
    signs = (-1.0) ** np.arange(size)
    corners = (bottom @ signs, bottom.sum(axis=-1), top @ signs, top.sum(axis=-1))
    for value, x, y in zip(corners, (low, high, low, high), (low, low, high, high), strict=True):
        found[..., :2, :2] -= value[..., None, None] * x[:, None] * y
    return found


def least_jacobian(mesh: PlaneMesh) -> float:
    """The least Jacobian determinant in a cell over its mean in that cell; negative where a cell is folded."""
    maps = blended(side_maps(mesh, _nowhere))
    at = chebyshev.chebvander(np.linspace(-1, 1, 9), GEOMETRY_ORDER)
    slopes = [chebyshev.chebder(maps, axis=axis) for axis in (2, 3)]
    dx, dy = (np.einsum("icab,pa,qb->icpq", d, at[:, : d.shape[2]], at[:, : d.shape[3]]) for d in slopes)
    found = (dx[0] * dy[1] - dx[1] * dy[0]).reshape(maps.shape[1], -1)
    return float(np.min(found.min(axis=1) / found.mean(axis=1)))


def is_folded(mesh: PlaneMesh) -> bool:
    """Whether two cells run along a side in one direction: one of them lies over the other."""
    ends, _ = _sides(mesh)
    return np.unique(ends, axis=1).shape[1] < ends.shape[1]


def extruded(
    mesh: PlaneMesh,
    heights: np.ndarray,
    on_rim: OnRim = _nowhere,
    rims: tuple[bool, bool] = (False, False),
) -> CurvedHexahedra:
    """Hexahedra over a plane mesh, in layers between growing heights (m).

    Parameters
    ----------
    on_rim : which points x, y (n,), m, lie on the rim of an electrode
    rims : whether the lower and the upper face have such rims, towards which the outer layers are graded
    """
    plane = blended(side_maps(mesh, on_rim))
    layers, cells, n = heights.size - 1, mesh.quads.shape[1], mesh.p.shape[1]
    flags = np.zeros((2, layers), dtype=bool)
    flags[0, 0], flags[1, -1] = rims
    rise = heights[:-1, None] + np.diff(heights)[:, None] * graded(*flags)
    level, around = n * np.arange(layers)[:, None], {(0, 0): 0, (1, 0): 1, (1, 1): 2, (0, 1): 3}
    corners = CurvedHexahedra.elem.refdom.p.T.astype(int)
    t = np.array([(mesh.quads[around[x, y]] + level + n * z).ravel() for x, y, z in corners])
    p = np.vstack([np.tile(mesh.p, heights.size), np.repeat(heights, n)])
    return CurvedHexahedra(
        p, t, plane=np.tile(plane, (1, layers, 1, 1)), height=np.repeat(rise @ _FIT.T, cells, axis=0)
    )


def labelled(mesh: skfem.Mesh, tests: Mapping[str, Callable[[np.ndarray], np.ndarray]]) -> skfem.Mesh:
    """The mesh with named boundaries: the facets of the surface whose centres (3, n), m, pass the test of the name."""
    surface = mesh.boundary_facets()
    centre = np.mean(mesh.bndelem.refdom.p, axis=1, keepdims=True)
    centres = mesh.mapping().G(centre, find=surface)[..., 0]
    return mesh.with_boundaries({name: surface[test(centres)] for name, test in tests.items()})


def grid_plane(points: np.ndarray) -> PlaneMesh:
    """Quadrangles with straight sides on a grid of points (2, nx, ny), m."""
    quads, p = _grid_quads(*points.shape[1:]), points.reshape(2, -1)
    return PlaneMesh(p, quads, np.stack([(p[:, quads[a]] + p[:, quads[b]]) / 2 for a, b in SIDES], axis=1))


def polar_plane(radii: np.ndarray, angles: np.ndarray) -> PlaneMesh:
    """Cells between growing radii (m, above 0) and angles (rad, a full turn at most)."""
    closed = angles[-1] - angles[0] > 2 * np.pi - 1e-9
    r, turn = np.meshgrid(radii, angles[: angles.size - closed], indexing="ij")
    quads = _grid_quads(radii.size, angles.size, closed)
    r_mid, turn_mid = (radii[1:] + radii[:-1]) / 2, (angles[1:] + angles[:-1]) / 2
    sides = ((r_mid, angles[:-1]), (radii[1:], turn_mid), (r_mid, angles[1:]), (radii[:-1], turn_mid))
    middles = [np.meshgrid(a, b, indexing="ij") for a, b in sides]
    p, *at_sides = [np.array([a * np.cos(b), a * np.sin(b)]).reshape(2, -1) for a, b in [(r, turn), *middles]]
    return PlaneMesh(p, quads, np.stack(at_sides, axis=1))


def _grid_quads(nx: int, ny: int, closed: bool = False) -> np.ndarray:
    """(4, cells) vertices of the cells of nx × ny points; the last column of points is the first where it is closed."""
    number = np.arange(nx * (ny - closed)).reshape(nx, ny - closed)
    number = np.hstack([number, number[:, :1]]) if closed else number
    return np.array([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]]).reshape(4, -1)


def graded_lines(stops: np.ndarray, rims: np.ndarray, edge: float, near: float, layers: int) -> np.ndarray:
    """(k,) growing coordinates of grid lines, m: at all stops, at most `edge` apart, geometrically closer towards rims.

    Parameters
    ----------
    stops : (n,) growing coordinates that must be lines, the first and the last being the ends
    rims : (n,) which stops are rims of electrodes
    near : reach of the geometric lines from a rim; where little more than that is there, up to 1.5 times as much
    layers : number of cells within the reach on each side of a rim
    """
    lines = [stops[:1]]
    for (a, b), (rim_a, rim_b) in zip(pairwise(stops), pairwise(rims), strict=True):
        count = int(rim_a) + int(rim_b)
        reach = (b - a) / max(count, 1) if b - a < (count + 0.5) * near else near
        steps = reach * RATIO ** np.arange(layers)[::-1]
        low, high = (a + reach if rim_a else a), (b - reach if rim_b else b)
        rest = np.linspace(low, high, 1 + max(int(np.ceil((high - low) / edge - 1e-9)), 1)) if high > low else []
        lines += [a + steps[: layers * rim_a], rest, (b - steps[: layers * rim_b])[::-1], [b]]
    found = np.sort(np.concatenate(lines))
    return found[np.append(True, np.diff(found) > 1e-9 * (stops[-1] - stops[0]))]


def pillowed(mesh: PlaneMesh) -> PlaneMesh:
    """The mesh with a layer of cells added along boundary sides that are arcs or continue arcs (a "pillow").

    Two sides of a quadrangle on one arc enclose an angle of 180°, so that its map is singular at their corner. The
    layer separates the cells of a mesh generator from arcs. Its height is 0.35 of the shortest side of the cells there.
    """
    ends, middles = _boundary(mesh)
    padded = _sides_to_pad(mesh.p, ends, middles)
    if not padded.any():
        return mesh
    step = _steps(mesh, ends, padded)
    moved = np.array(sorted(step))
    copy = np.arange(mesh.p.shape[1])
    copy[moved] = mesh.p.shape[1] + np.arange(moved.size)
    p = np.hstack([mesh.p, np.array([mesh.p[:, v] + step[v] for v in moved]).T])
    quads, places = copy[mesh.quads], mesh.middles.copy()
    start, end = ends[:, padded]
    added = np.array([start, end, copy[end], copy[start]])
    sides = np.stack([(p[:, added[a]] + p[:, added[b]]) / 2 for a, b in SIDES], axis=1)
    sides[:, 2] += (middles[:, padded] - sides[:, 0]) / 2  # inner side: half the rise of the arc
    sides[:, 0] = middles[:, padded]
    bent = {frozenset(pair): sides[:, 2, i] for i, pair in enumerate(added[2:].T.tolist())}
    for i, (a, b) in enumerate(SIDES):
        shifted = np.any(quads[[a, b]] != mesh.quads[[a, b]], axis=0)
        places[:, i, shifted] = (p[:, quads[a, shifted]] + p[:, quads[b, shifted]]) / 2
        for cell, pair in enumerate(quads[[a, b]].T.tolist()):
            places[:, i, cell] = bent.get(frozenset(pair), places[:, i, cell])
    return PlaneMesh(p, np.hstack([quads, added]), np.concatenate([places, sides], axis=2))


def _boundary(mesh: PlaneMesh) -> tuple[np.ndarray, np.ndarray]:
    """Sides of one cell only: their ends (2, m), the region to the left of each, and their midpoints (2, m)."""
    ends, middles = _sides(mesh)
    _, number, count = np.unique(np.sort(ends, axis=0), axis=1, return_inverse=True, return_counts=True)
    once = count[number.ravel()] == 1
    return ends[:, once], middles[:, once]


def _sides(mesh: PlaneMesh) -> tuple[np.ndarray, np.ndarray]:
    """Sides of all cells: their ends (2, 4 cells), the cell to the left of each, and their midpoints (2, 4 cells)."""
    loop = ((0, 1), (1, 2), (2, 3), (3, 0))
    ends = np.concatenate([mesh.quads[list(pair)] for pair in loop], axis=1)
    return ends, np.concatenate([mesh.middles[:, i] for i in range(4)], axis=1)


def _sides_to_pad(p: np.ndarray, ends: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """(m,) which boundary sides get a layer: arcs, and sides that continue them nearly straight."""
    chord = p[:, ends[1]] - p[:, ends[0]]
    rise = np.linalg.norm(middles - (p[:, ends[0]] + p[:, ends[1]]) / 2, axis=0)
    padded = rise > 1e-6 * np.linalg.norm(chord, axis=0)
    unit = chord / np.linalg.norm(chord, axis=0)
    after = {v: i for i, v in enumerate(ends[0])}
    following = np.array([after[v] for v in ends[1]])
    smooth = np.sum(unit * unit[:, following], axis=0) > 0.7
    while True:
        more = padded.copy()
        more[following[padded & smooth]] = True
        more |= padded[following] & smooth
        if np.array_equal(more, padded):
            return padded
        padded = more


def _steps(mesh: PlaneMesh, ends: np.ndarray, padded: np.ndarray) -> dict[int, np.ndarray]:
    """Vertex of the sides that get a layer → vector (2,) to its copy on the inner side of the layer, m."""
    p, room = mesh.p, np.full(mesh.p.shape[1], np.inf)
    for a, b in SIDES:
        length = np.linalg.norm(p[:, mesh.quads[a]] - p[:, mesh.quads[b]], axis=0)
        for vertices in (mesh.quads[a], mesh.quads[b]):
            np.minimum.at(room, vertices, 0.35 * length)
    chord = p[:, ends[1]] - p[:, ends[0]]
    unit = chord / np.linalg.norm(chord, axis=0)
    normal = np.array([-unit[1], unit[0]])
    before, after = ({v: i for i, v in enumerate(ends[k])} for k in (1, 0))
    found = {}
    for v in np.unique(ends[:, padded]):
        i, j, size = before[v], after[v], room[v]
        if padded[i] and padded[j]:
            found[v] = size * (normal[:, i] + normal[:, j]) / (1 + normal[:, i] @ normal[:, j])
        else:
            found[v] = -size * unit[:, i] if padded[j] else size * unit[:, j]
    return found
