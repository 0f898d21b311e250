"""The whole body as small cells with displacement and potential: VTU files of modes, meshes for other programs."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np
import skfem
from scipy.spatial import cKDTree

from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.curved_mesh import CurvedHexahedra
from femu_piezo.output.surface import fields_at_points

#: Corners of a cube in the order of VTK, Abaqus and gmsh.
_CORNERS = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
#: Middles of the edges of a tetrahedron in the order of VTK, Abaqus and meshio.
_EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))
#: Opposite sides of a cube, corner above corner.
_SIDES = (((0, 1, 2, 3), (4, 5, 6, 7)), ((0, 3, 7, 4), (1, 2, 6, 5)), ((0, 4, 5, 1), (3, 7, 6, 2)))
#: Kind in meshio and nodes of the faces of a cell, outwards.
_FACES = {
    "hexahedron": ("quad", [side for bottom, top in _SIDES for side in (bottom, top[::-1])]),
    "tetra10": ("triangle6", [(0, 2, 1, 6, 5, 4), (0, 1, 3, 4, 8, 7), (1, 2, 3, 5, 9, 8), (0, 3, 2, 7, 9, 6)]),
}
#: Order of the nodes of a mirrored cell in which its volume is positive.
_MIRRORED = {"hexahedron": (4, 5, 6, 7, 0, 1, 2, 3), "tetra10": (0, 2, 1, 3, 6, 5, 4, 7, 9, 8)}
#: Distance over the longest side within which nodes are merged.
_SAME = 1e-7

#: Element that meshio writes for Abaqus → piezoelectric element of the same nodes.
_ABAQUS = {"C3D8RH": "C3D8E", "C3D10MH": "C3D10E"}


@dataclass(frozen=True)
class Volume:
    """Cells of the whole body.

    Attributes
    ----------
    points : (p, 3) m;  kind : "hexahedron" or "tetra10" of meshio;  cells : (c, 8) or (c, 10) indices of points
    fields : (k, p, 4) complex of k modes: displacement, m, and potential, V
    hot, ground : indices of the points on the electrodes
    """

    points: np.ndarray
    kind: str
    cells: np.ndarray
    fields: np.ndarray
    hot: np.ndarray
    ground: np.ndarray


def volume_of(model: ElectroelasticModel, vectors: np.ndarray) -> Volume:
    """The whole body with the modes `vectors` (m, k) of the model's free unknowns; coincident nodes are merged.

    Hexahedra are cut into as many linear ones along each edge as their order (twice that where curved), tetrahedra
    keep their ten nodes.
    """
    mesh, domain = model.domain.mesh, model.domain
    reference, pattern, kind = _pattern(model)
    weights = np.full(reference.shape[1], 1.0)
    basis = skfem.Basis(mesh, model.basis.elem, quadrature=(reference, weights))
    points = np.asarray(basis.global_coordinates()).reshape(3, -1).T
    fields = np.stack([fields_at_points(basis, model, vector).T for vector in vectors.T]) if vectors.size else None
    fields = np.zeros((0, len(points), 4), complex) if fields is None else fields
    per_cell = reference.shape[1]
    cells = (pattern[None] + per_cell * np.arange(mesh.nelements)[:, None, None]).reshape(-1, pattern.shape[1])
    hot = _near_facets(points, mesh, model, domain.hot)
    ground = _near_facets(points, mesh, model, [name for name in domain.ground if name not in domain.symmetry])
    cells = _right_way_round(points, cells, kind)
    for name, axis in domain.symmetry.items():
        plane = float(mesh.p[axis, mesh.facets[0, mesh.boundaries[name][0]]])
        sign = -1.0 if name in domain.ground else 1.0
        flip = np.ones(3)
        flip[axis] = -1.0
        image = points * flip
        image[:, axis] += 2 * plane
        cells = np.vstack([cells, cells[:, _MIRRORED[kind]] + len(points)])
        fields = np.concatenate([fields, fields * np.array([*flip * 1.0, sign])], axis=1)
        hot, ground = (
            (np.r_[hot, np.zeros_like(hot)], np.r_[ground, hot])
            if sign < 0
            else (np.r_[hot, hot], np.r_[ground, ground])
        )
        points = np.vstack([points, image])
    return _merged(points, kind, cells, fields, hot, ground)


def _pattern(model: ElectroelasticModel) -> tuple[np.ndarray, np.ndarray, str]:
    """Reference points (3, p), the small cells (c, 8 or 10) between them, their kind."""
    mesh = model.domain.mesh
    if mesh.elem.refdom.nnodes == 8:
        n = max(1, model.order) * (2 if isinstance(mesh, CurvedHexahedra) else 1)
        grid = np.stack(np.meshgrid(*[np.arange(n + 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        number = np.arange((n + 1) ** 3).reshape((n + 1,) * 3)
        starts = np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), axis=-1).reshape(-1, 1, 3)
        return grid.T / n, number[tuple(np.moveaxis(starts + _CORNERS, -1, 0))], "hexahedron"
    corners = mesh.elem.refdom.p.T.astype(float)
    middles = [(corners[i] + corners[j]) / 2 for i, j in _EDGES]
    return np.vstack([corners, middles]).T, np.arange(10)[None], "tetra10"


def _near_facets(points: np.ndarray, mesh: skfem.Mesh, model: ElectroelasticModel, names) -> np.ndarray:
    """(p,) bool: points that coincide with a sampled point of a facet of the named boundaries."""
    on = np.zeros(len(points), bool)
    facets = np.unique(np.concatenate([mesh.boundaries[name] for name in names])) if names else []
    if not len(facets):
        return on
    n = max(1, model.order) * (2 if isinstance(mesh, CurvedHexahedra) else 1)
    if mesh.elem.refdom.nnodes == 8:
        at = np.stack(np.meshgrid(*[np.arange(n + 1)] * 2), axis=-1).reshape(-1, 2).T / n
    else:
        at = np.array([(0, 0), (1, 0), (0, 1), (0.5, 0), (0.5, 0.5), (0, 0.5)]).T
    basis = skfem.FacetBasis(mesh, mesh.elem(), facets=facets, quadrature=(at, np.ones(at.shape[1])))
    places = np.asarray(basis.global_coordinates()).reshape(3, -1).T
    distance, _ = cKDTree(places).query(points)
    return distance < 1e-9 * np.ptp(points)


def _right_way_round(points: np.ndarray, cells: np.ndarray, kind: str) -> np.ndarray:
    """The cells, the nodes of those of negative volume reordered."""
    corner = points[cells[:, [0, 1, 3, 4] if kind == "hexahedron" else [0, 1, 2, 3]]]
    edges = corner[:, 1:] - corner[:, :1]
    wrong = np.linalg.det(edges) < 0
    return np.where(wrong[:, None], cells[:, _MIRRORED[kind]], cells)


def _merged(points, kind: str, cells, fields, hot, ground) -> Volume:
    """The volume with coincident nodes merged."""
    step = _SAME * float(np.ptp(points, axis=0).max())
    _, first, where = np.unique(
        np.round((points - points.min(axis=0)) / step), axis=0, return_index=True, return_inverse=True
    )
    where = where.ravel()

    def nodes(on: np.ndarray) -> np.ndarray:
        return np.unique(where[np.flatnonzero(on)])

    return Volume(points[first], kind, where[cells], fields[:, first], nodes(hot), nodes(ground))


def vtu_of_mode(volume: Volume, named: dict[str, np.ndarray]) -> bytes:
    """A VTU file of the body with fields: name → (p, 4) complex; displacements and potentials, Re and Im apart.

    Each is scaled to a largest displacement of 1.
    """
    data = {}
    for name, values in named.items():
        scaled = values / np.max(np.linalg.norm(values[:, :3], axis=1))
        for part, numbers in (("re", scaled.real), ("im", scaled.imag)):
            data[f"displacement_{name}_{part}"] = np.ascontiguousarray(numbers[:, :3])
            data[f"potential_{name}_{part}"] = np.ascontiguousarray(numbers[:, 3])
    return _written(meshio.Mesh(volume.points, [(volume.kind, volume.cells)], point_data=data), "vtu")


def mesh_msh(volume: Volume) -> bytes:
    """A gmsh 2.2 file, coordinates in m, with the physical surfaces "hot" and "ground" and the volume "body"."""
    tagged = [(3, (volume.kind, volume.cells))]
    tagged += [(tag, face) for tag, on in ((1, volume.hot), (2, volume.ground)) for face in _faces(volume, on)]
    blocks = [block for _, block in tagged]
    tags = [np.full(len(cells), tag) for tag, (_, cells) in tagged]
    mesh = meshio.Mesh(
        volume.points,
        blocks,
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={"hot": np.array([1, 2]), "ground": np.array([2, 2]), "body": np.array([3, 3])},
    )
    return _written(mesh, "gmsh22", binary=False)


def mesh_inp(volume: Volume) -> bytes:
    """An Abaqus file, coordinates in m, with the node sets "hot" and "ground" and the element set "body".

    The elements are Abaqus' piezoelectric ones, whose nodes have an electric potential.
    """
    mesh = meshio.Mesh(
        volume.points,
        [(volume.kind, volume.cells)],
        point_sets={"hot": volume.hot, "ground": volume.ground},
        cell_sets={"body": [np.arange(len(volume.cells))]},
    )
    text = _written(mesh, "abaqus")
    for other, piezoelectric in _ABAQUS.items():
        text = text.replace(f"TYPE={other}\n".encode(), f"TYPE={piezoelectric}\n".encode())
    return text


def _faces(volume: Volume, nodes: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """The kind in meshio, and the faces, of the surface whose nodes are all among those given."""
    flat, sides = _FACES[volume.kind]
    faces = np.vstack([volume.cells[:, list(side)] for side in sides])
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    outer = np.zeros(len(faces), bool)
    outer[first[count == 1]] = True
    chosen = faces[outer & np.isin(faces, nodes).all(axis=1)]
    return [(flat, chosen)] if len(chosen) else []


def _written(mesh: meshio.Mesh, form: str, **options) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "file"
        meshio.write(path, mesh, file_format=form, **options)
        return path.read_bytes()
