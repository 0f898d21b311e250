"""Structured hexahedral boxes: made by gmsh through pygmsh, read through meshio into scikit-fem.

Every rectangular plate is the unit box scaled to its size, so a handful of ready files under `meshes/` serves
plates of all dimensions. Other boxes are the same tensor-product grids, built in place: plates need no gmsh.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import skfem
import skfem.io.meshio

from femu_piezo.geometry.gmsh_session import gmsh_session

#: The six faces of the unit box, in the order of axes, lower face first.
FACES = ("x_min", "x_max", "y_min", "y_max", "z_min", "z_max")

_PACKAGE = Path(__file__).resolve().parent.parent
#: Where ready meshes lie: inside an installed wheel, or at the top of a checkout.
MESH_FOLDERS = (_PACKAGE / "meshes", _PACKAGE.parent / "meshes")


def write_unit_box(divisions: tuple[int, int, int], path: Path) -> None:
    """Write the unit box with nx × ny × nz hexahedra and physical surfaces named as `FACES` (gmsh 4.1).

    Needs gmsh and its system libraries (InputError where these are missing).
    """
    nx, ny, nz = divisions
    with gmsh_session("geo") as geometry:
        import gmsh
        import pygmsh

        corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
        points = [geometry.add_point((x, y, 0.0)) for x, y in corners]
        lines = [geometry.add_line(points[i], points[(i + 1) % 4]) for i in range(4)]
        for line, count in zip(lines, (nx, ny, nx, ny), strict=True):
            geometry.set_transfinite_curve(line, count + 1, "Progression", 1.0)
        base = geometry.add_plane_surface(geometry.add_curve_loop(lines))
        geometry.set_transfinite_surface(base, "Left", points)
        geometry.set_recombined_surfaces([base])
        top, volume, sides = geometry.extrude(base, (0.0, 0.0, 1.0), num_layers=nz, recombine=True)
        named = (sides[3], sides[1], sides[0], sides[2], base, top)
        for name, surface in zip(FACES, named, strict=True):
            geometry.add_physical(surface, name)
        geometry.add_physical(volume, "plate")
        geometry.generate_mesh(dim=3)
        gmsh.option.setNumber("Mesh.Binary", 1)
        pygmsh.write(str(path))


def unit_box(divisions: tuple[int, int, int]) -> skfem.MeshHex:
    """The unit box [0, 1]³ with nx × ny × nz hexahedra and boundaries named as `FACES`.

    Taken from a ready file, else built as the same tensor-product grid by scikit-fem; they agree node for node.
    """
    name = f"box_{'x'.join(str(count) for count in divisions)}.msh"
    for folder in MESH_FOLDERS:
        if (folder / name).is_file():
            return read_hexahedra(folder / name)
    return tensor_box([np.linspace(0.0, 1.0, count + 1) for count in divisions])


def read_hexahedra(path: Path) -> skfem.MeshHex:
    """A hexahedral gmsh file as a scikit-fem mesh; physical surfaces become named boundaries."""
    mesh = skfem.io.meshio.from_meshio(meshio.read(path, file_format="gmsh"), ignore_orientation=True)
    return replace(mesh, _subdomains=None)


def grid_lines(mesh: skfem.MeshHex) -> list[np.ndarray]:
    """Coordinates of the grid lines of a box along x, y and z, growing, m."""
    found = []
    for axis in mesh.p:
        places = np.sort(axis)
        found.append(places[np.append(True, np.diff(places) > 1e-9 * np.ptp(axis))])
    return found


def divided(line: np.ndarray, parts: int) -> np.ndarray:
    """(m,) grid lines (n,) of an axis after division of each interval into equal parts: m = (n − 1) parts + 1."""
    return np.interp(np.arange((line.size - 1) * parts + 1) / parts, np.arange(line.size), line)


def elements_of(mesh: skfem.MeshHex) -> np.ndarray:
    """(nx, ny, nz) number of the element in each cell of the grid of a box."""
    lines, centres = grid_lines(mesh), mesh.p[:, mesh.t].mean(axis=1)
    cells = tuple(np.searchsorted(line, centre) - 1 for line, centre in zip(lines, centres, strict=True))
    found = np.empty([line.size - 1 for line in lines], dtype=int)
    found[cells] = np.arange(mesh.t.shape[1])
    return found


def tensor_box(lines: Sequence[np.ndarray]) -> skfem.MeshHex:
    """The box with grid lines at given x, y, z (m), and boundaries named as `FACES`."""
    mesh = skfem.MeshHex.init_tensor(*lines)

    def on(axis: int, place: float) -> Callable[[np.ndarray], np.ndarray]:
        return lambda x: np.abs(x[axis] - place) < 1e-9 * (lines[axis][-1] - lines[axis][0])

    return mesh.with_boundaries({name: on(i // 2, lines[i // 2][-(i % 2)]) for i, name in enumerate(FACES)})
