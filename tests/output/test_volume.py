"""VTU files of modes and meshes for other programs: read back, with the right volume and, by our own solver, the
same pole.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import meshio
import numpy as np
import pytest

import femu_piezo as fp
from femu_piezo.geometry.mesh_file import MeshFile
from tests.commands import succeeded
from tests.variants import variants

SHAPES = {
    "plate": (
        'shape = "plate"\nlength = "12 mm"\nwidth = "3 mm"\nthickness = "1 mm"\npoling = "thickness"\n',
        36e-9,
        36e-6,
    ),
    "disk": ('shape = "disk"\ndiameter = "20 mm"\nthickness = "2 mm"\n', np.pi * 1e-4 * 2e-3, np.pi * 1e-4),
    "tetrahedra": (
        'shape = "plate"\nlength = "12 mm"\nwidth = "4 mm"\nthickness = "2 mm"\n'
        'electrode_margin = "0.5 mm"\nelements = "tetrahedron"\n',
        96e-9,
        33e-6,
    ),
}


def volume_of(mesh: meshio.Mesh) -> float:
    """Volume by tetrahedra with straight edges into which all cells are split."""
    splits = {
        "tetra10": [(0, 1, 2, 3)],
        "hexahedron": [(0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6)],
    }
    total = 0.0
    for block in mesh.cells:
        for corners in splits.get(block.type, ()):
            p = mesh.points[block.data[:, list(corners)]]
            volumes = np.linalg.det(p[:, 1:] - p[:, :1]) / 6
            assert np.all(volumes > 0)  # no cell is inverted
            total += volumes.sum()
    return total


def share_of_circle(mesh: meshio.Mesh, shape: str) -> float:
    """Area of the polygon through the points on the rim over that of the circle; 1 for plates.

    Cells in the files have straight edges.
    """
    if shape != "disk":
        return 1.0
    rim = (np.hypot(*mesh.points[:, :2].T) > 10e-3 * (1 - 1e-6)) & (mesh.points[:, 2] > 1e-3 * (1 - 1e-6))
    corners = int(rim.sum())
    assert corners >= 32
    return corners / (2 * np.pi) * np.sin(2 * np.pi / corners)


@pytest.fixture(scope="module", params=variants(SHAPES, slow=["plate", "tetrahedra"]))
def folder(request, tmp_path_factory):
    """The output folder of `modes --vtu --mesh`, and the name of the body."""
    out = tmp_path_factory.mktemp(request.param)
    text = "[geometry]\n" + SHAPES[request.param][0] + '[material]\nbase = "pzt-5h"\n'
    (out / "piece.toml").write_text(text, encoding="utf-8")
    succeeded("modes", out / "piece.toml", "--out", out / "out", "--count", "1", "--vtu", "--mesh")
    return out / "out", request.param


def read_mesh(path: Path) -> meshio.Mesh:
    """A mesh file as read by meshio, which knows Abaqus' elements only without a potential."""
    if path.suffix != ".inp":
        return meshio.read(path)
    text = path.read_text()
    kinds = set(re.findall(r"TYPE=(\w+)", text))
    assert kinds <= {"C3D8E", "C3D10E"} and kinds
    plain = path.with_name("plain.inp")
    for kind in kinds:
        text = text.replace(f"TYPE={kind}", f"TYPE={kind[:-1]}")
    plain.write_text(text)
    return meshio.read(plain)


@pytest.mark.parametrize("name", ["mode_01.vtu", "mesh.msh", "mesh.inp"])
def test_the_whole_body_is_in_the_file(folder, name):
    out, shape = folder
    mesh = read_mesh(out / name)
    assert volume_of(mesh) == pytest.approx(SHAPES[shape][1] * share_of_circle(mesh, shape), rel=1e-9, abs=0)


def test_a_mode_of_extension_is_odd_along_its_length_and_alike_at_pole_and_zero(folder):
    out, _ = folder
    mesh = meshio.read(out / "mode_01.vtu")
    u = mesh.point_data["displacement_pole_re"]
    assert np.max(np.linalg.norm(u + 1j * mesh.point_data["displacement_pole_im"], axis=1)) == pytest.approx(1.0)
    x = mesh.points[:, 0]
    assert abs(np.corrcoef(u[:, 0], x)[0, 1]) > 0.8
    far, near = u[x > 0.49 * np.ptp(x), 0], u[x < -0.49 * np.ptp(x), 0]
    assert np.mean(far) == pytest.approx(-np.mean(near), rel=1e-3)
    zero = mesh.point_data["displacement_zero_re"]
    assert abs(np.sum(u * zero)) > 0.9 * np.linalg.norm(u) * np.linalg.norm(zero)
    assert set(mesh.point_data) >= {"potential_pole_re", "potential_zero_re"}


def test_the_electrodes_are_named_and_opposite(folder):
    out, shape = folder
    mesh = read_mesh(out / "mesh.inp")
    hot, ground = (mesh.points[mesh.point_sets[name]] for name in ("hot", "ground"))
    thickness = np.ptp(mesh.points[:, 2])
    np.testing.assert_allclose(hot[:, 2].min() - ground[:, 2].max(), thickness, rtol=1e-9)
    assert len(hot) == len(ground) or shape == "tetrahedra"


def test_our_own_reader_of_meshes_finds_the_same_pole(folder, tmp_path):
    """The .msh as a specimen of shape "mesh": electrode area, and the pole of the plate."""
    out, shape = folder
    area = SHAPES[shape][2] * share_of_circle(meshio.read(out / "mesh.msh"), shape)
    assert MeshFile(Path(out / "mesh.msh")).electrode_area == pytest.approx(area, rel=1e-6)
    if shape == "plate":
        text = f'[geometry]\nshape = "mesh"\nfile = "{out / "mesh.msh"}"\nunit = 1.0\n[material]\nbase = "pzt-5h"\n'
        text += "[simulation]\norder = 1\n"  # 1e-3 too stiff, but much faster than order 2
        (tmp_path / "mesh.toml").write_text(text, encoding="utf-8")
        first = json.loads((out / "modes.json").read_text(encoding="utf-8"))["modes"][0]["pole"]["frequency_Hz"]
        again = fp.modes(tmp_path / "mesh.toml", count=1, band=(0.5 * first, 1.5 * first)).modes[0].pole.frequency_Hz
        assert again == pytest.approx(first, rel=2e-3)


def test_the_electrodes_have_their_area(folder):
    out, shape = folder
    mesh = meshio.read(out / "mesh.msh")
    area = 0.0
    for block, tags in zip(mesh.cells, mesh.cell_data["gmsh:physical"], strict=True):
        if block.type in ("quad", "triangle", "triangle6"):
            p = mesh.points[block.data[tags == 1]]
            for corners in ((0, 1, 2), (0, 2, 3))[: 2 if block.type == "quad" else 1]:
                a, b, c = (p[:, corner] for corner in corners)
                area += np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    assert area == pytest.approx(SHAPES[shape][2] * share_of_circle(mesh, shape), rel=1e-9, abs=0)
