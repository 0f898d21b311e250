"""`Slab`: a plane outline of constant thickness with holes, chamfers and any electrodes on its two faces.

Disks, rings, trapezoids and plates with rounded corners or holes are slabs; `femu_piezo.geometry.catalogue` has a
function for each. `femu_piezo.geometry.slab_mesh` meshes them by a few curved hexahedra of high order. Where electrodes
end inside the faces of a body that is neither a grid nor concentric, gmsh meshes it by quadratic hexahedra; slabs with
chamfers, and slabs with elements = "tetrahedron", are meshed by quadratic tetrahedra.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import skfem
import skfem.io.meshio

from femu_piezo.errors import InputError
from femu_piezo.geometry.domain import Domain
from femu_piezo.geometry.gmsh_session import mesh_drawing
from femu_piezo.geometry.plane_mesh import labelled
from femu_piezo.geometry.quality import DEGENERATE, check_electrodes, check_elements, least_jacobian
from femu_piezo.geometry.regions import Circle, Footprint, Region
from femu_piezo.geometry.round_body import divisions_for, round_domain
from femu_piezo.geometry.shape import check_size, driven_mirrors, unit_direction
from femu_piezo.geometry.slab_cad import (
    DRAWING_UNIT,
    divide_curves,
    draw_chamfered,
    draw_extruded,
    grade_to_rims,
    partial_footprints,
)
from femu_piezo.geometry.slab_mesh import NoQuadrangles, is_grid, is_round, mesh_for, mesh_of_edge
from femu_piezo.geometry.upper_face import UpperFace

#: Relative eigenvalue error of quadratic elements of edge h at shear wavenumber k: at most this times (k h)^4
#: (tests/geometry/test_slab.py checks this upper bound).
_ERROR_CONSTANT = 1e-3
#: Least number of quadratic elements on a full circle.
_PER_CIRCLE = 12
#: Ways of gmsh to unfold curved elements (Mesh.HighOrderOptimize: none, elastic, optimisation), in the order in which
#: they are tried, and the least Jacobian over its mean in an element that is enough. The last one succeeds where the
#: second fails, but may end the whole process where that succeeds (gmsh 4.15).
_OPTIMISERS = ((0, 0.1), (3, DEGENERATE), (1, -np.inf))
#: Edge of tetrahedra at electrode rims over that of the others. The relative error of λ from the singularity there is a
#: few 1e-4 with these tetrahedra and up to 1e-3 with quadratic hexahedra, whatever the accuracy asked for.
_AT_RIMS = 0.25

Elements = Literal["hexahedron", "tetrahedron"]


@dataclass(frozen=True)
class Electrodes:
    """Electrodes on the two faces; without arguments both faces are fully covered, up to the edge.

    Attributes
    ----------
    margin : width of the bare rim along every edge of both faces, m
    span : (start, length) of the hot electrode along x from the end x_min, m; the whole length where None
    wrap : (length, gap), m: the ground electrode wraps around the end x_min and covers `length` of the hot face there;
        a bare gap and the hot electrode follow
    """

    margin: float = 0.0
    span: tuple[float, float] | None = None
    wrap: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.margin < 0:
            raise InputError(f"the electrode margin {self.margin:g} m must not be negative")
        if self.wrap is not None and self.margin > 0:
            raise InputError(
                "a wrap-around electrode reaches the edge, so it has no electrode margin; give only one of the two"
            )
        if self.wrap is not None and self.span is not None:
            raise InputError(
                "a hot electrode is either partial in length or leaves room for a wrap-around; give only one of the two"
            )
        if self.wrap is not None and not (self.wrap[0] > 0 and self.wrap[1] > 0):
            raise InputError(f"a wrap-around electrode needs a positive length and gap, got {self.wrap} m")
        if self.span is not None and not (self.span[0] >= 0 and self.span[1] > 0):
            raise InputError(f"a partial electrode needs a start ≥ 0 and a positive length, got {self.span} m")

    def scaled(self, factor: float) -> Electrodes:
        """The same electrodes with every length times `factor`."""

        def times(pair: tuple[float, float] | None) -> tuple[float, float] | None:
            return None if pair is None else (pair[0] * factor, pair[1] * factor)

        return Electrodes(self.margin * factor, times(self.span), times(self.wrap))


@dataclass(frozen=True)
class Slab:
    """A slab about the origin: outline in x, y, faces at z = ±thickness/2, the hot electrode on top (m).

    Attributes
    ----------
    holes : circular through-holes
    chamfer : width of the 45° bevel along the outer edges of both faces, m; it has no electrode
    direction : poling direction; +z (through the thickness, along the field) where None
    elements : "hexahedron", "tetrahedron", or None for hexahedra where the shape has them (no chamfer)
    """

    outline: Region
    thickness: float
    holes: tuple[Circle, ...] = ()
    electrodes: Electrodes = field(default_factory=Electrodes)
    chamfer: float = 0.0
    direction: tuple[float, float, float] | None = None
    elements: Elements | None = None

    def __post_init__(self) -> None:
        if not self.thickness > 0:
            raise InputError(f"the thickness {self.thickness:g} m must be positive")
        if not 0 <= self.chamfer < self.thickness / 2:
            raise InputError(
                f"the chamfer {self.chamfer:g} m must be at least 0 and below half the thickness, "
                f"{self.thickness / 2:g} m"
            )
        if self.chamfer and self.elements == "hexahedron":
            raise InputError("a chamfered slab is meshed by tetrahedra; remove the key elements")
        self._check_holes()
        if self.direction is not None:
            unit_direction(self.direction)
        _ = (self.hot, self.ground_top)  # raises where an electrode does not fit

    def _check_holes(self) -> None:
        for index, hole in enumerate(self.holes):
            x, y = hole.center
            room = float(self.outline.depth(np.array([x]), np.array([y]))[0]) - self.chamfer
            if room <= hole.diameter / 2:
                raise InputError(
                    f"the hole of diameter {hole.diameter:g} m at ({x:g}, {y:g}) m does not lie inside the plate: "
                    f"there the edge is {max(room, 0):g} m away"
                )
            for other in self.holes[:index]:
                if np.hypot(x - other.center[0], y - other.center[1]) <= (hole.diameter + other.diameter) / 2:
                    raise InputError(f"the holes at {other.center} and {hole.center} m overlap")

    @property
    def poling(self) -> str:
        """ "thickness": the field between the electrodes is along z."""
        return "thickness"

    @property
    def length(self) -> float:
        """Extent along x, m."""
        return self.outline.extents[1] - self.outline.extents[0]

    @property
    def poling_direction(self) -> tuple[float, float, float]:
        """(3,) unit vector of the poling."""
        return (0.0, 0.0, 1.0) if self.direction is None else unit_direction(self.direction)

    @property
    def field_direction(self) -> tuple[float, float, float]:
        """(3,) unit vector of the field between the electrodes."""
        return (0.0, 0.0, 1.0)

    @property
    def hot(self) -> Footprint:
        """The electrode on the upper face."""
        x_min, x_max = self.outline.extents[:2]
        x_range = None
        if self.electrodes.wrap is not None:
            x_range = (x_min + sum(self.electrodes.wrap), x_max)
        if self.electrodes.span is not None:
            start, length = self.electrodes.span
            if start + length > (x_max - x_min) * (1 + 1e-9):
                raise InputError(
                    f"the partial electrode from {start:g} m, {length:g} m long, ends beyond the plate, which is "
                    f"{x_max - x_min:g} m long"
                )
            x_range = (x_min + start, x_min + start + length)
        if x_range is not None and not x_range[0] < x_range[1]:
            raise InputError(
                f"the wrap-around of {sum(self.electrodes.wrap):g} m (length and gap) leaves no room for the hot "
                f"electrode on a plate {x_max - x_min:g} m long"
            )
        return self._face(x_range)

    @property
    def ground(self) -> Footprint:
        """The electrode on the lower face."""
        return self._face(None)

    @property
    def ground_top(self) -> Footprint | None:
        """The wrapped part of the ground electrode on the upper face, None where there is none."""
        if self.electrodes.wrap is None:
            return None
        x_min = self.outline.extents[0]
        return self._face((x_min, x_min + self.electrodes.wrap[0]))

    def _face(self, x_range: tuple[float, float] | None) -> Footprint:
        rim = max(self.electrodes.margin, self.chamfer)
        margin = self.electrodes.margin
        outline = self.outline.inset(rim) if rim else self.outline
        holes = tuple(hole.inset(-margin) for hole in self.holes)
        return Footprint(outline, holes, x_range)

    @property
    def volume(self) -> float:
        """Volume of the body, m³; a chamfer takes ∫ (A − A(inset z)) dz over its depth off each face."""
        area = self.outline.area - sum(hole.area for hole in self.holes)
        if not self.chamfer:
            return area * self.thickness
        depth, weight = np.polynomial.legendre.leggauss(8)
        insets = [self.outline.inset(self.chamfer * (1 + point) / 2).area for point in depth]
        lost = np.sum(weight * (self.outline.area - np.array(insets))) * self.chamfer / 2
        return area * self.thickness - 2 * float(lost)

    @property
    def electrode_area(self) -> float:
        """Area of the hot electrode, m²; exact, or from 1200 × 1200 points where it covers only a range of x.

        So it is where the bare rims of holes meet each other or the bare rim of the edge.
        """
        hot = self.hot
        if hot.x_range is None and hot.holes_apart:
            return hot.outline.area - sum(hole.area for hole in hot.holes)
        x_min, x_max, y_min, y_max = hot.outline.extents
        low, high = (x_min, x_max) if hot.x_range is None else (max(x_min, hot.x_range[0]), min(x_max, hot.x_range[1]))
        x = low + (high - low) * (np.arange(1200) + 0.5) / 1200
        y = y_min + (y_max - y_min) * (np.arange(1200) + 0.5) / 1200
        share = np.mean(hot.covers(*(grid.ravel() for grid in np.meshgrid(x, y))))
        return float(share * (high - low) * (y_max - y_min))

    @property
    def electrode_gap(self) -> float:
        """Distance between the electrodes, m."""
        return self.thickness

    @property
    def mirrors(self) -> tuple[int, ...]:
        """Axes about whose mid-plane the driven field is symmetric."""
        axes = set(self.hot.mirrors & self.outline.mirrors)
        for hole in self.holes:
            axes &= hole.mirrors
        if self.electrodes.span is None and self.electrodes.wrap is None:
            axes.add(2)
        if self.electrodes.wrap is not None:
            axes -= {0}
        return driven_mirrors(axes, self.poling_direction, field_axis=2)

    @property
    def is_plain(self) -> bool:
        """Whether electrodes cover both faces fully, without a chamfer, and tetrahedra are not asked for."""
        return self.electrodes == Electrodes() and not self.chamfer and self.elements != "tetrahedron"

    @property
    def radii(self) -> tuple[float, float] | None:
        """Inner (0 for a disk) and outer radius, m, of a plain disk or concentric ring; None for other slabs."""
        if not (self.is_plain and is_round(self)):
            return None
        return (self.holes[0].diameter / 2 if self.holes else 0.0), self.outline.diameter / 2

    @property
    def revolved(self) -> tuple[float, float] | None:
        """`radii` where the driven field is axisymmetric, as the poling is along +z; None for other slabs."""
        return self.radii if self.mirrors == (0, 1, 2) and self.poling_direction == (0.0, 0.0, 1.0) else None

    @property
    def upper_face(self) -> UpperFace | None:
        """The face where a mass may stick or a support stand; None for a body of revolution (`revolved`)."""
        if self.revolved is not None:
            return None
        outline = self.outline.inset(self.chamfer) if self.chamfer else self.outline
        covers = Footprint(outline, self.holes).covers
        return UpperFace.within(outline.extents, self.mirrors, self.volume, self.thickness, covers)

    @property
    def element_order(self) -> int:
        """5, about the order that is chosen for curved hexahedra; 2 for other elements."""
        return 5 if self.is_curved else 2

    @property
    def element_shape(self) -> Elements:
        """ "hexahedron" or "tetrahedron", as asked for or as the shape allows."""
        return self.elements or ("tetrahedron" if self.chamfer else "hexahedron")

    @property
    def is_curved(self) -> bool:
        """Whether the slab is meshed by curved hexahedra of high order, graded towards electrode rims."""
        regular = is_grid(self) or is_round(self)
        return self.element_shape == "hexahedron" and (regular or not partial_footprints(self))

    @property
    def rims_x(self) -> tuple[float, ...]:
        """Coordinates x, m, inside the plate at which an electrode ends: limits of its range of x, ends at a margin."""
        x_min, x_max = self.outline.extents[:2]
        margin = self.electrodes.margin
        found = [x_min + margin, x_max - margin] if margin else []
        for footprint in (self.hot, self.ground_top):
            found += list(footprint.x_range) if footprint is not None and footprint.x_range is not None else []
        return tuple(x for x in found if x_min < x < x_max)

    def on_rim(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(n,) which points x, y (n,), m, lie on a rim, where an electrode ends inside a face, or at its ends."""
        near = 1e-6 * self.thickness
        found, (x_min, x_max) = np.zeros(x.shape, dtype=bool), self.outline.extents[:2]
        for footprint in partial_footprints(self):
            depth, edge = footprint.outline.depth(x, y), np.zeros(x.shape, dtype=bool)
            depth = np.min([depth, *(-hole.depth(x, y) for hole in footprint.holes)], axis=0)
            if self.electrodes.margin:
                edge |= np.abs(depth) < near
            inside = depth > -near
            for place in footprint.x_range or ():
                edge |= (np.abs(x - place) < near) & (x_min + near < place < x_max - near)
            if footprint.x_range is not None:
                inside &= (x > footprint.x_range[0] - near) & (x < footprint.x_range[1] + near)
            found |= edge & inside
        return found

    def edge_length(self, accuracy: float, frequency_Hz: float, shear_speed: float) -> float:
        """Edge of quadratic elements, m, with a relative eigenvalue error of at most `accuracy` at `frequency_Hz`."""
        return (accuracy / _ERROR_CONSTANT) ** 0.25 * shear_speed / (2 * np.pi * frequency_Hz)

    def domain_for(
        self,
        accuracy: float,
        frequency_Hz: float,
        shear_speed: float,
        symmetric: bool = True,
        order: int | None = None,
    ) -> Domain:
        """The computed part with elements fine enough; see `femu_piezo.geometry.shape.Shape`.

        Elements are a few curved hexahedra of high order (`is_curved`), else quadratic.
        """
        mirrors, wavenumber = self.mirrors if symmetric else (), 2 * np.pi * frequency_Hz / shear_speed
        if self.radii is not None:
            height = self.thickness / 2 if 2 in mirrors else self.thickness
            along = abs(self.poling_direction[2]) == 1.0
            found = divisions_for(self.radii, self.thickness, height, wavenumber, accuracy, along, order)
            domain = round_domain(self.radii, self.thickness, found, mirrors, self.poling_direction)
            return replace(domain, radii=self.revolved if symmetric else None)
        if self.is_curved:
            with contextlib.suppress(NoQuadrangles):
                mesh, order, at_rims = mesh_for(self, accuracy, wavenumber, mirrors, order)
                return replace(self._domain(mesh, order, mirrors), rim_error=at_rims)
        edge = self.edge_length(accuracy, frequency_Hz, shear_speed)
        check_size(self.volume / 2 ** len(mirrors) / edge**3, self.element_shape)
        return self._domain(self._quadratic(edge, mirrors), order or 2, mirrors)

    def domain(self, edge: float, symmetric: bool = True, order: int = 2) -> Domain:
        """The computed part with elements of a largest edge (m), cut at its mirror planes where `symmetric`.

        edge : in round bodies that along radius and height; arcs may be twice as long
        order : of the elements; at most 2 where they are not curved hexahedra
        """
        mirrors = self.mirrors if symmetric else ()
        if self.is_curved:
            with contextlib.suppress(NoQuadrangles):
                return self._domain(mesh_of_edge(self, edge, mirrors), order, mirrors)
        return self._domain(self._quadratic(edge, mirrors), order, mirrors)

    def _domain(self, mesh: skfem.Mesh, order: int, mirrors: tuple[int, ...]) -> Domain:
        """The domain of a mesh of the part, after its boundaries are named and checked."""
        mesh = labelled(mesh, self._places(mirrors))
        check_elements(mesh, "the mesh of the slab")
        ground = "mirror_z" if 2 in mirrors else "ground"
        check_electrodes(mesh, "hot", ground, "the slab")
        return Domain(
            mesh=mesh,
            hot=("hot",),
            ground=(ground,),
            symmetry={f"mirror_{'xyz'[axis]}": axis for axis in mirrors},
            copies=2 ** len(mirrors),
            voltage_factor=2.0 if 2 in mirrors else 1.0,
            poling=self.poling_direction,
            order=order,
            rim_error=1e-3 if partial_footprints(self) else 0.0,
        )

    def scaled(self, factor: float) -> Slab:
        """The same slab with every length times `factor`."""
        return replace(
            self,
            outline=self.outline.scaled(factor),
            thickness=self.thickness * factor,
            holes=tuple(hole.scaled(factor) for hole in self.holes),
            electrodes=self.electrodes.scaled(factor),
            chamfer=self.chamfer * factor,
        )

    def _quadratic(self, edge: float, mirrors: tuple[int, ...]) -> skfem.Mesh:
        """Mesh of gmsh with quadratic elements of a largest edge, m."""
        drawn = self.scaled(DRAWING_UNIT)
        make = drawn._hexahedra if self.element_shape == "hexahedron" else drawn._tetrahedra
        return make(edge * DRAWING_UNIT, mirrors).scaled(1 / DRAWING_UNIT)

    def _tetrahedra(self, edge: float, mirrors: tuple[int, ...]) -> skfem.Mesh:
        """Quadratic tetrahedra, four times finer at electrode rims."""
        edge = min(edge, self.thickness if 2 in mirrors else 2 * self.thickness)
        draw = draw_chamfered if self.chamfer else draw_extruded

        def build(gmsh) -> None:
            draw(gmsh, self, mirrors, None)
            grade_to_rims(gmsh, self, mirrors, edge, edge * _AT_RIMS, self.thickness / 2)

        return _from_gmsh(build, edge, "tetra10", {})

    def _hexahedra(self, edge: float, mirrors: tuple[int, ...]) -> skfem.Mesh:
        """Layers of quadratic hexahedra; at least two where a part that is not cut at mid-height has electrode rims."""
        height, rims = self.thickness / (2 if 2 in mirrors else 1), bool(partial_footprints(self))
        edge = min(edge, 2 * height) if rims else edge  # flat hexahedra follow smooth fields well
        layers = max(2 if rims and 2 not in mirrors else 1, int(np.ceil(height / edge - 1e-9)))

        def build(gmsh) -> None:
            draw_extruded(gmsh, self, mirrors, layers)
            divide_curves(gmsh, edge, _PER_CIRCLE)

        options = {"Mesh.RecombineAll": 1, "Mesh.RecombinationAlgorithm": 3, "Mesh.Algorithm": 8}
        return _from_gmsh(build, edge, "hexahedron27", options)

    def _places(self, mirrors: tuple[int, ...]) -> dict[str, Callable[[np.ndarray], np.ndarray]]:
        """Name (hot, ground, mirror_x, mirror_y, mirror_z) → test of the centres of facets (3, n), m."""
        near = 1e-6 * min(self.thickness, self.outline.extents[1])
        half = self.thickness / 2
        tests = {f"mirror_{'xyz'[axis]}": (lambda x, axis=axis: np.abs(x[axis]) < near) for axis in mirrors}
        tests["hot"] = lambda x: (np.abs(x[2] - half) < near) & self.hot.covers(x[0], x[1])
        if 2 not in mirrors:
            tests["ground"] = lambda x: self._is_ground(x, near)
        return tests

    def _is_ground(self, x: np.ndarray, near: float) -> np.ndarray:
        half = self.thickness / 2
        on = (np.abs(x[2] + half) < near) & self.ground.covers(x[0], x[1])
        if self.ground_top is None:
            return on
        on |= (np.abs(x[2] - half) < near) & self.ground_top.covers(x[0], x[1])
        return on | self._on_wrapped_end(x)

    def _on_wrapped_end(self, x: np.ndarray) -> np.ndarray:
        """Facets of the side that the wrap-around covers: the end x_min; of a disk, where x is in the covered strip."""
        x_min, x_max = self.outline.extents[:2]
        side = np.abs(x[2]) < (self.thickness / 2 - self.chamfer) * (1 - 1e-6)
        if isinstance(self.outline, Circle):
            in_hole = np.zeros(x.shape[1], dtype=bool)
            for hole in self.holes:
                in_hole |= hole.depth(x[0], x[1]) > -1e-3 * hole.diameter
            return side & (x[0] < x_min + self.electrodes.wrap[0]) & ~in_hole
        return side & (np.abs(x[0] - x_min) < 1e-6 * (x_max - x_min))


def _from_gmsh(build: Callable[[object], None], edge: float, kind: str, more: dict[str, float]) -> skfem.Mesh:
    """A drawing meshed by quadratic elements of one kind; `edge` and the mesh are in units of the drawing."""
    options = {
        "Mesh.MeshSizeMax": edge,
        "Mesh.MeshSizeFromCurvature": _PER_CIRCLE,
        "Mesh.ElementOrder": 2,
        "Mesh.SecondOrderIncomplete": 0,
    }
    for optimiser, enough in _OPTIMISERS:
        raw = mesh_drawing(build, options | more | {"Mesh.HighOrderOptimize": optimiser}, "the slab")
        if {cell.type for cell in raw.cells} & {"wedge18", "hexahedron27", "tetra10"} != {kind}:
            raise InputError(
                "gmsh left elements of another kind than hexahedra in the slab; "
                'set elements = "tetrahedron" in [geometry]'
            )
        mesh = skfem.io.meshio.from_meshio(raw, force_meshio_type=kind, ignore_orientation=True)
        if least_jacobian(mesh) > enough:
            break
    return mesh
