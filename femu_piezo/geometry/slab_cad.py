"""Drawings of a slab by gmsh's OpenCASCADE kernel: partition of the faces by electrode edges, extrusion, chamfers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from femu_piezo.errors import InputError

if TYPE_CHECKING:
    from femu_piezo.geometry.regions import Footprint
    from femu_piezo.geometry.slab import Slab

#: Drawing units per metre: the tolerances of OpenCASCADE are made for drawings in mm.
DRAWING_UNIT = 1e3


def draw_plane(gmsh, slab: Slab, mirrors: tuple[int, ...]) -> list[tuple[int, int]]:
    """(dim, tag) of the surfaces of the computed part in the plane z = 0, cut along every electrode edge."""
    occ = gmsh.model.occ
    outline = [(2, slab.outline.add(occ))]
    if slab.holes:
        outline, _ = occ.cut(outline, [(2, hole.add(occ)) for hole in slab.holes])
    outline = _quadrant(occ, outline, slab, mirrors)
    tools: list[tuple[int, int]] = []
    for footprint in partial_footprints(slab):
        inside, _ = occ.intersect(outline, footprint.add(occ), removeObject=False)
        tools += inside
    pieces = occ.fragment(outline, tools)[0] if tools else outline
    occ.synchronize()
    return pieces


def draw_extruded(gmsh, slab: Slab, mirrors: tuple[int, ...], layers: int | None) -> None:
    """The computed part as a prism over its plane; layers : number of layers of hexahedra, None for tetrahedra."""
    pieces = draw_plane(gmsh, slab, mirrors)
    low, height = (0.0, slab.thickness / 2) if 2 in mirrors else (-slab.thickness / 2, slab.thickness)
    gmsh.model.occ.translate(pieces, 0, 0, low)
    division = {} if layers is None else {"numElements": [layers], "recombine": True}
    gmsh.model.occ.extrude(pieces, 0, 0, height, **division)
    gmsh.model.occ.synchronize()


def draw_chamfered(gmsh, slab: Slab, mirrors: tuple[int, ...], layers: int | None = None) -> None:
    """The computed part with 45° bevels along the outer edges of its faces, cut along electrode edges.

    layers : not used; the parameter is that of `draw_extruded`
    """
    occ = gmsh.model.occ
    outline = [(2, slab.outline.add(occ))]
    occ.translate(outline, 0, 0, -slab.thickness / 2)
    solid = [entity for entity in occ.extrude(outline, 0, 0, slab.thickness) if entity[0] == 3]
    occ.synchronize()
    solid = _bevel(gmsh, solid[0][1], slab)
    if slab.holes:
        depth = 2 * slab.thickness
        holes = [(3, occ.addCylinder(*hole.center, -depth / 2, 0, 0, depth, hole.diameter / 2)) for hole in slab.holes]
        solid, _ = occ.cut(solid, holes)
    if mirrors:
        size = 4 * max(np.abs(slab.outline.extents))
        corner = [0.0 if axis in mirrors else -size / 2 for axis in range(3)]
        solid, _ = occ.intersect(solid, [(3, occ.addBox(*corner, size, size, size))])
    faces: list[tuple[int, int]] = []
    for footprint in partial_footprints(slab):
        top = _quadrant(occ, footprint.add(occ), slab, mirrors)
        copies = [] if 2 in mirrors else occ.copy(top)
        occ.translate(top, 0, 0, slab.thickness / 2)
        occ.translate(copies, 0, 0, -slab.thickness / 2)
        faces += top + copies
    if faces:
        occ.fragment(solid, faces)
    occ.synchronize()


def partial_footprints(slab: Slab) -> list[Footprint]:
    """The electrodes whose edges lie inside a face, without repetition."""
    rim = slab.electrodes.margin > slab.chamfer or (slab.electrodes.margin > 0 and slab.holes)
    every = [footprint for footprint in (slab.hot, slab.ground, slab.ground_top) if footprint is not None]
    return list(dict.fromkeys(footprint for footprint in every if rim or footprint.x_range is not None))


def _quadrant(occ, surfaces: list[tuple[int, int]], slab: Slab, mirrors: tuple[int, ...]) -> list[tuple[int, int]]:
    """The part of plane surfaces at x ≥ 0 where axis 0 is mirrored, and at y ≥ 0 where axis 1 is."""
    if not set(mirrors) & {0, 1}:
        return surfaces
    size = 4 * max(np.abs(slab.outline.extents))
    corner = [0.0 if axis in mirrors else -size / 2 for axis in (0, 1)]
    return occ.intersect(surfaces, [(2, occ.addRectangle(*corner, 0.0, size, size))])[0]


def _bevel(gmsh, volume: int, slab: Slab) -> list[tuple[int, int]]:
    """Chamfer every edge of the two faces of a solid without holes."""
    near = 1e-3 * slab.thickness
    curves, faces = [], []
    for side in (-1, 1):
        for _, face in gmsh.model.getBoundary([(3, volume)], oriented=False):
            box = gmsh.model.getBoundingBox(2, face)
            if abs(box[2] - side * slab.thickness / 2) < near and abs(box[5] - side * slab.thickness / 2) < near:
                edges = [abs(tag) for _, tag in gmsh.model.getBoundary([(2, face)], oriented=False)]
                curves += edges
                faces += [face] * len(edges)
    if not curves:
        raise InputError("the faces of the slab were not found for chamfering; report this with the specimen file")
    return gmsh.model.occ.chamfer([volume], curves, faces, [slab.chamfer])


def grade_to_rims(gmsh, slab: Slab, mirrors: tuple[int, ...], edge: float, edge_at_rims: float, z: float) -> None:
    """Set element sizes: `edge`, falling to `edge_at_rims` at electrode rims that lie inside a face at heights ±z (m).

    D has an inverse square-root singularity at rims, which limits the accuracy of elements of any order.
    """
    curves = _rim_curves(gmsh, slab, mirrors, z)
    if not curves:
        return
    field = gmsh.model.mesh.field
    distance, size = field.add("Distance"), field.add("Threshold")
    field.setNumbers(distance, "CurvesList", curves)
    field.setNumber(distance, "Sampling", 100)
    for name, value in {
        "InField": distance,
        "SizeMin": edge_at_rims,
        "SizeMax": edge,
        "DistMin": edge_at_rims,
        "DistMax": edge_at_rims + 2.0 * (edge - edge_at_rims),
    }.items():
        field.setNumber(size, name, value)
    field.setAsBackgroundMesh(size)


def _rim_curves(gmsh, slab: Slab, mirrors: tuple[int, ...], z: float) -> list[int]:
    """Tags of the curves at heights ±z that are electrode rims and do not lie in a mirror plane."""
    near = 1e-3 * slab.thickness
    found = []
    for _, tag in gmsh.model.getEntities(1):
        x_min, y_min, z_min, x_max, y_max, z_max = gmsh.model.getBoundingBox(1, tag)
        flat = z_max - z_min < near and abs(abs(z_max) - z) < near
        on_plane = (max(abs(x_min), abs(x_max)) < near, max(abs(y_min), abs(y_max)) < near)
        mirror = any(on_plane[axis] for axis in mirrors if axis < 2)
        if not flat or mirror:
            continue
        low, high = gmsh.model.getParametrizationBounds(1, tag)
        x, y, _ = gmsh.model.getValue(1, tag, [(low[0] + high[0]) / 2])
        if slab.on_rim(np.array([x]), np.array([y]))[0]:
            found.append(tag)
    return found


def divide_curves(gmsh, edge: float, per_circle: int) -> None:
    """Divide every curve into segments of at most `edge` (m), at least `per_circle` in a full turn.

    Their number is even, which the recombination into quadrangles needs.
    """
    for _, tag in gmsh.model.getEntities(1):
        length = gmsh.model.occ.getMass(1, tag)
        low, high = gmsh.model.getParametrizationBounds(1, tag)
        tangents = [
            np.array(gmsh.model.getDerivative(1, tag, [low[0] + part * (high[0] - low[0])])) for part in (0.0, 0.5, 1.0)
        ]
        turn = _angle(tangents[0], tangents[1]) + _angle(tangents[1], tangents[2])
        by_length, by_turn = length / edge, turn / (2 * np.pi) * per_circle
        count = 2 * max(1, int(np.ceil(max(by_length, by_turn) / 2 - 1e-6)))
        gmsh.model.mesh.setTransfiniteCurve(tag, count + 1)


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.arccos(np.clip(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)), -1.0, 1.0)))
