"""A user's own mesh, in any format that meshio reads, with named electrodes.

Physical surfaces "hot" and "ground" are the electrodes. Planes named "mirror_x", "mirror_y" or "mirror_z" are
mirror planes of the specimen, of which the mesh is a part; coordinates are counted from them, into the part.
Tetrahedra and hexahedra, linear or quadratic.
"""

from __future__ import annotations

import contextlib
import io
from dataclasses import dataclass, replace
from pathlib import Path

import meshio
import numpy as np
import skfem
import skfem.io.meshio
from scipy.spatial import cKDTree

from femu_piezo.errors import InputError
from femu_piezo.files import read_bytes
from femu_piezo.geometry.domain import Domain
from femu_piezo.geometry.memory import memory_limit
from femu_piezo.geometry.quality import boundary_area, check_electrodes, check_elements, mean_normal
from femu_piezo.geometry.shape import MOST_UNKNOWNS, UNKNOWNS, fits, unit_direction
from femu_piezo.geometry.upper_face import UpperFace, facets_at
from femu_piezo.threads import made_once

_LARGEST_FILE = 500_000_000
#: Memory that reading a mesh may take: bytes for any file, and bytes per byte of the file (intact files take about 4).
_LEAST_MEMORY, _MEMORY_PER_BYTE = 256_000_000, 16
_SUPPORTED = ("hexahedron27", "tetra10", "hexahedron", "tetra")
_SURFACE_ONLY = {"triangle", "quad", "triangle6", "quad8", "quad9"}
#: Share of a length below which it is zero but for rounding.
_FLAT = 1e-6
#: Extents in m outside which the unit is probably wrong.
_PLAUSIBLE = (2e-5, 1.0)


@dataclass(frozen=True)
class MeshFile:
    """A body that is given by a mesh file.

    Attributes
    ----------
    file : path of the mesh
    unit : metres per unit of its coordinates
    direction : poling direction
    """

    file: Path
    unit: float = 1.0
    direction: tuple[float, float, float] = (0.0, 0.0, 1.0)

    @property
    def poling(self) -> str:
        return "thickness"

    @property
    def poling_direction(self) -> tuple[float, float, float]:
        """(3,) unit vector of the poling."""
        return unit_direction(self.direction)

    @made_once
    def mesh(self) -> skfem.Mesh:
        """The checked mesh in m, mirror planes at zero and the part above; InputError where it cannot serve."""
        mesh = _from_mirrors(_read(self.file), self.file)
        check_elements(mesh, str(self.file))
        check_electrodes(mesh, "hot", "ground", str(self.file))
        mesh = mesh.scaled(self.unit)
        extent = float(np.ptp(mesh.p, axis=1).max())
        if not _PLAUSIBLE[0] <= extent <= _PLAUSIBLE[1]:
            raise InputError(
                f"{self.file}: the body is {extent:.3g} m long, which no piezoceramic is; give the unit of the "
                'coordinates, such as geometry.unit = "mm"'
            )
        return mesh

    @property
    def extents(self) -> np.ndarray:
        """(3,) size of the whole specimen along x, y, z, m."""
        size = np.ptp(self.mesh.p, axis=1)
        return size * np.array([2 if axis in self.mirrors else 1 for axis in range(3)])

    @property
    def mirrors(self) -> tuple[int, ...]:
        """Axes of the mirror planes that the file names."""
        return tuple(axis for axis in range(3) if f"mirror_{'xyz'[axis]}" in self.mesh.boundaries)

    @property
    def volume(self) -> float:
        """Volume of the whole body, m³."""
        return self.domain_for(order=1).volume

    @property
    def electrode_area(self) -> float:
        """Area of the hot electrode of the whole body, m²."""
        return boundary_area(self.mesh, "hot") * 2 ** len(self.mirrors)

    @property
    def field_direction(self) -> tuple[float, float, float]:
        """(3,) unit vector of the field: the mean normal of the hot electrode.

        Where the electrodes face the same way, as on one face of the body, it is the line between their centres.
        """
        return unit_direction(self._between_electrodes)

    @property
    def electrode_gap(self) -> float:
        """Distance between the centres of the electrodes along the field, m."""
        return float(np.linalg.norm(self._between_electrodes))

    @made_once
    def _between_electrodes(self) -> np.ndarray:
        """(3,) from the centre of the ground electrode to that of the hot one, its part along the field, m.

        Of the whole body: by symmetry nothing points out of a mirror plane.
        """
        bases = [skfem.FacetBasis(self.mesh, self.mesh.elem(), facets=name) for name in ("hot", "ground")]
        hot, ground = (
            np.sum(np.asarray(basis.global_coordinates()) * basis.dx, axis=(1, 2)) / np.sum(basis.dx) for basis in bases
        )
        apart, normal = hot - ground, mean_normal(bases[0])
        apart[[*self.mirrors]] = normal[[*self.mirrors]] = 0.0
        if np.linalg.norm(apart) < _FLAT * np.ptp(self.mesh.p, axis=1).max():
            raise InputError(
                f'{self.file}: the surfaces "hot" and "ground" have the same centre, as inside and outside a tube; '
                "only bodies whose electrodes lie apart can be computed"
            )
        along = (apart @ normal) * normal / max(normal @ normal, _FLAT)
        return along if np.linalg.norm(along) > _FLAT * np.linalg.norm(apart) else apart

    @property
    def upper_face(self) -> UpperFace | None:
        """The face at the largest z, where a mass may stick or a support stand; None where no facet lies there."""
        mesh = self.mesh
        corners = mesh.p[:2, mesh.facets[:, facets_at(mesh, mesh.p[2].max())]]  # (2, corners, n)
        if corners.shape[2] == 0:
            return None
        middles = corners.mean(axis=1)
        reach = np.linalg.norm(corners - middles[:, None], axis=0).max(axis=0)
        tree = cKDTree(middles.T)

        def covers(x: np.ndarray, y: np.ndarray) -> np.ndarray:
            distance, facet = tree.query(np.column_stack([x, y]))
            return distance < reach[facet]

        x, y = corners
        box = [float(value) for axis in (x, y) for value in (axis.min(), axis.max())]
        return UpperFace.within(box, self.mirrors, self.volume, float(self.extents[2]), covers)

    @property
    def element_order(self) -> int:
        """2: elements on the user's mesh are quadratic."""
        return 2

    def domain_for(
        self,
        accuracy: float = 1e-4,
        frequency_Hz: float = 0.0,
        shear_speed: float = 1.0,
        symmetric: bool = True,
        order: int | None = None,
    ) -> Domain:
        """The user's mesh as it is: accuracy, frequency and speed have no influence; order : 2 where None."""
        direction = np.abs(np.array(self.poling_direction))
        for axis in self.mirrors:
            if direction[axis] > 1e-12:
                raise InputError(
                    f'{self.file}: "mirror_{"xyz"[axis]}" cannot be a mirror plane, because the poling has a '
                    "component along its normal; mesh the whole body there"
                )
        cell = "hexahedron" if self.mesh.elem.refdom.nnodes == 8 else "tetra"
        _check_size(cell, self.mesh.nelements, order or 2, self.file)
        return Domain(
            mesh=self.mesh,
            hot=("hot",),
            ground=("ground",),
            symmetry={f"mirror_{'xyz'[axis]}": axis for axis in self.mirrors},
            copies=2 ** len(self.mirrors),
            order=order or 2,
            poling=self.poling_direction,
        )


def _read(path: Path) -> skfem.Mesh:
    """The mesh of a file in its own unit, with named boundaries; InputError where it cannot be read."""
    size = len(read_bytes(path, _LARGEST_FILE))  # InputError for a missing, unreadable or huge file
    most = _LEAST_MEMORY + _MEMORY_PER_BYTE * size
    try:
        silence = contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO())
        with silence[0], silence[1], memory_limit(most):
            raw = meshio.read(path)
    except MemoryError:
        raise InputError(
            f"{path}: by its counts of points and elements this mesh takes more than {most / 1e6:.0f} MB, which a "
            f"file of {size / 1e6:.3g} MB cannot hold; save the mesh again"
        ) from None
    except (Exception, SystemExit) as error:  # the readers of meshio raise anything for a damaged file
        reason = str(error).strip().splitlines()
        raise InputError(
            f"{path}: meshio cannot read this as a mesh{' (' + reason[0] + ')' if reason else ''}; save it by gmsh "
            "as version 4.1 .msh"
        ) from None
    kinds = {cell.type for cell in raw.cells}
    solid = [kind for kind in _SUPPORTED if kind in kinds]
    other = kinds - set(_SUPPORTED) - _SURFACE_ONLY - {"vertex", "line", "line3"}
    if other or len(solid) > 1:
        found = ", ".join(sorted(other | set(solid)))
        raise InputError(
            f"{path}: elements of kind {found} cannot be computed together; mesh with tetrahedra (tetra, tetra10) or "
            "hexahedra (hexahedron, hexahedron27; in gmsh Mesh.SecondOrderIncomplete = 0) only"
        )
    if not solid:
        raise InputError(f"{path}: there are no volume elements; mesh in three dimensions and name a physical volume")
    _check_size(solid[0], sum(len(cell.data) for cell in raw.cells if cell.type == solid[0]), 1, path)
    if not np.all(np.isfinite(raw.points)):
        raise InputError(f"{path}: a coordinate of a point is not a finite number; save the mesh again")
    corners = [cell.data for cell in raw.cells if cell.data.size]
    if min(data.min() for data in corners) < 0 or max(data.max() for data in corners) >= len(raw.points):
        raise InputError(f"{path}: an element names a point that the file does not have; save the mesh again")
    body = meshio.Mesh(raw.points, [(cell.type, cell.data) for cell in raw.cells if cell.type == solid[0]])
    try:
        mesh = skfem.io.meshio.from_meshio(body, force_meshio_type=solid[0], ignore_orientation=True)
    except Exception as error:  # blocks of elements with too few points, or of none
        raise InputError(
            f"{path}: the elements of kind {solid[0]} are damaged ({error}); save the mesh again"
        ) from None
    return replace(mesh, _boundaries=_named_facets(raw, mesh, path) or None)


def _from_mirrors(mesh: skfem.Mesh, path: Path) -> skfem.Mesh:
    """The mesh moved and, if need be, reflected so that it extends from mirror planes at zero to positive coordinates.

    InputError where a surface that is named as a mirror plane is none.
    """
    near = _FLAT * float(np.ptp(mesh.p, axis=1).max())
    for axis, letter in enumerate("xyz"):
        facets = (mesh.boundaries or {}).get(f"mirror_{letter}")
        if facets is None:
            continue
        at, ends = mesh.p[axis][mesh.facets[:, facets]], (float(mesh.p[axis].min()), float(mesh.p[axis].max()))
        side = [float(np.abs(at - end).max()) < near for end in ends]
        if not any(side):
            raise InputError(
                f'{path}: the surface "mirror_{letter}" is no mirror plane: it reaches from {letter} = {at.min():.4g} '
                f"to {at.max():.4g}, and the body from {ends[0]:.4g} to {ends[1]:.4g}; a mirror plane lies at one end "
                "of the body and has the name of the axis normal to it"
            )
        shift, turn = np.zeros(3), np.ones(3)
        shift[axis], turn[axis] = -ends[side.index(True)], 1.0 if side[0] else -1.0
        mesh = mesh.translated(tuple(shift)).scaled(tuple(turn))
    return mesh


def _check_size(cell: str, count: int, order: int, path: Path) -> None:
    """InputError where `count` elements of an order on cells of a kind of meshio are too many to be solved."""
    each = UNKNOWNS["hexahedron" if cell.startswith("hexa") else "tetrahedron"] * (order / 2) ** 3
    if not fits(each * count):
        raise InputError(
            f"{path}: with elements of order {order} the mesh has about {each * count:.2g} unknowns, too many to be "
            f"solved; mesh with larger elements, at most {int(MOST_UNKNOWNS / each)}"
        )


def _named_facets(raw: meshio.Mesh, mesh: skfem.Mesh, path: Path) -> dict[str, np.ndarray]:
    """Name of a surface → numbers of the facets of the mesh at the centres of its cells."""
    corners = {"triangle": 3, "triangle6": 3, "quad": 4, "quad8": 4, "quad9": 4}
    tree = cKDTree(mesh.p[:, mesh.facets].mean(axis=1).T)
    near = 1e-6 * float(np.ptp(mesh.p, axis=1).max())
    found: dict[str, np.ndarray] = {}
    for name, parts in _surface_sets(raw).items():
        centers = [
            raw.points[block.data[part][:, : corners[block.type]]].mean(axis=1)
            for block, part in zip(raw.cells, parts, strict=True)
            if block.type in corners and part is not None and len(part)
        ]
        if not centers:
            continue
        distance, facets = tree.query(np.concatenate(centers))
        if distance.max() > near:
            raise InputError(
                f'{path}: {int(np.sum(distance > near))} cells of the surface "{name}" are no faces of volume '
                "elements; mesh body and surface together"
            )
        found[name] = np.unique(facets).astype(np.int32)
    return found


def _surface_sets(raw: meshio.Mesh) -> dict[str, list]:
    """Name of a surface → its cells in each block; from named sets (.msh 4.1), else from physical tags (.msh 2.2)."""
    sets = {name: list(parts) for name, parts in raw.cell_sets.items() if not name.startswith("gmsh:")}
    if sets or "gmsh:physical" not in raw.cell_data:
        return sets
    tags = raw.cell_data["gmsh:physical"]
    return {
        name: [np.flatnonzero(part == number) for part in tags]
        for name, (number, dimension) in raw.field_data.items()
        if dimension == 2
    }
