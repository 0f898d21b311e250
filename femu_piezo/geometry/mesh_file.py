"""A user's own mesh, in any format that meshio reads, with named electrodes.

Physical surfaces "hot" and "ground" are the electrodes. Planes named "mirror_x", "mirror_y" or "mirror_z" are
mirror planes of the specimen, of which the mesh is a part. Tetrahedra and hexahedra, linear or quadratic.
"""

from __future__ import annotations

import contextlib
import io
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import meshio
import numpy as np
import skfem
import skfem.io.meshio

from femu_piezo.errors import InputError
from femu_piezo.files import read_bytes
from femu_piezo.geometry.domain import Domain
from femu_piezo.geometry.quality import boundary_area, check_electrodes, check_elements
from femu_piezo.geometry.shape import unit_direction

_LARGEST_FILE = 500_000_000
_SUPPORTED = ("hexahedron27", "tetra10", "hexahedron", "tetra")
_SURFACE_ONLY = {"triangle", "quad", "triangle6", "quad9"}
#: Extents in m outside which the unit is probably wrong.
_PLAUSIBLE = (2e-5, 1.0)


@dataclass(frozen=True)
class MeshFile:
    """The body in a mesh file.

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
        return unit_direction(self.direction)

    @cached_property
    def mesh(self) -> skfem.Mesh:
        """The checked mesh in m; InputError where it cannot serve."""
        mesh = _read(self.file)
        check_elements(mesh, str(self.file))
        check_electrodes(mesh, "hot", "ground", str(self.file))
        mesh = mesh.scaled(self.unit)
        extent = float(np.ptp(mesh.p, axis=1).max())
        if not _PLAUSIBLE[0] <= extent <= _PLAUSIBLE[1]:
            raise InputError(
                f"{self.file}: the body is {extent:.3g} m long, which is no piezoceramic; say the unit of the "
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
        return self.domain_for().volume

    @property
    def electrode_area(self) -> float:
        return boundary_area(self.mesh, "hot") * 2 ** len(self.mirrors)

    @property
    def electrode_gap(self) -> float:
        """Distance between the centres of the electrodes along the poling, m; their distance where that vanishes."""
        centers = [skfem.FacetBasis(self.mesh, self.mesh.elem(), facets=name) for name in ("hot", "ground")]
        means = [
            np.sum(np.asarray(basis.global_coordinates()) * basis.dx, axis=(1, 2)) / np.sum(basis.dx)
            for basis in centers
        ]
        apart = means[0] - means[1]
        along = abs(float(apart @ np.array(self.poling_direction)))
        return along or float(np.linalg.norm(apart))

    def domain_for(
        self, accuracy: float = 1e-4, frequency_Hz: float = 0.0, shear_speed: float = 1.0, symmetric: bool = True
    ) -> Domain:
        """The mesh as it is: its elements are the user's, whatever the accuracy asked for."""
        direction = np.abs(np.array(self.poling_direction))
        for axis in self.mirrors:
            if direction[axis] > 1e-12:
                raise InputError(
                    f'{self.file}: "mirror_{"xyz"[axis]}" cannot be a mirror plane, because the poling has a '
                    "component along its normal; mesh the whole body there"
                )
        return Domain(
            mesh=self.mesh,
            hot=("hot",),
            ground=("ground",),
            symmetry={f"mirror_{'xyz'[axis]}": axis for axis in self.mirrors},
            copies=2 ** len(self.mirrors),
            poling=self.poling_direction,
        )


def _read(path: Path) -> skfem.Mesh:
    read_bytes(path, _LARGEST_FILE)  # tells a missing, unreadable or huge file in one sentence
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            raw = meshio.read(path)
    except (
        meshio.ReadError,
        ValueError,
        KeyError,
        IndexError,
        AssertionError,
        UnicodeDecodeError,
        SystemExit,
    ) as error:
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
    raw = _one_block_per_kind(raw)
    return skfem.io.meshio.from_meshio(raw, force_meshio_type=solid[0], ignore_orientation=True)


def _one_block_per_kind(raw: meshio.Mesh) -> meshio.Mesh:
    """Keep cells and their named sets; unnamed sets and point data of other programs are of no use here."""
    names = [name for name in raw.cell_sets if not name.startswith("gmsh:")]
    for name in names:
        raw.cell_sets[name] = [np.zeros(0, dtype=int) if part is None else part for part in raw.cell_sets[name]]
    return raw
