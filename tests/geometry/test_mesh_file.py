"""A user's own mesh: reading, checks, results; every fault gives one sentence."""

from collections.abc import Callable
from pathlib import Path

import meshio
import numpy as np
import pytest
import skfem
import skfem.io.meshio

from femu_piezo.effects.effect import EffectContext
from femu_piezo.effects.library import library
from femu_piezo.effects.local.face_compliance import FaceCompliance
from femu_piezo.errors import InputError
from femu_piezo.forward.eigen import solve_eigen
from femu_piezo.forward.mode_family import family
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry import catalogue
from femu_piezo.geometry.gmsh_session import gmsh_session
from femu_piezo.geometry.mesh_file import MeshFile
from femu_piezo.geometry.quality import check_electrodes, check_elements
from femu_piezo.geometry.shape import is_poled_across_field, is_poled_along_field, poling_along_field
from femu_piezo.geometry.shapes import Plate
from femu_piezo.geometry.slab import Electrodes
from femu_piezo.material.library import library_material
from femu_piezo.specimen.file import read_specimen
from femu_piezo.study.effects import effect_context
from femu_piezo.study.problem import prepare
from femu_piezo.study.shapes import first_mode_Hz

VM175 = library_material("pzt-4-vm175")
ELECTRODES = {"hot": (6,), "ground": (5,)}


def write_box(
    path: Path,
    names: dict[str, tuple[int, ...]],
    order: int = 2,
    size: float | tuple[float, float, float] = 20.0,
    mesh: float = 7.0,
    corner: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> None:
    """Mesh file of a box in mm; faces 1 … 6 of OpenCASCADE are x_min x_max y_min y_max z_min z_max."""
    with gmsh_session():
        import gmsh

        box = gmsh.model.occ.addBox(*corner, *np.broadcast_to(size, 3).tolist())
        gmsh.model.occ.synchronize()
        for name, faces in names.items():
            gmsh.model.addPhysicalGroup(2, list(faces), name=name)
        gmsh.model.addPhysicalGroup(3, [box], name="body")
        gmsh.option.setNumber("Mesh.MeshSizeMax", mesh)
        gmsh.option.setNumber("Mesh.ElementOrder", order)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(path))


@pytest.mark.parametrize("order", [1, 2])
def test_own_mesh_of_the_cube_has_the_modes_of_vm175(tmp_path: Path, order: int) -> None:
    write_box(tmp_path / "cube.msh", {"hot": (6,), "ground": (5,)}, order)
    shape = MeshFile(tmp_path / "cube.msh", unit=1e-3)
    assert shape.volume == pytest.approx(8e-6, rel=1e-9, abs=0)
    assert shape.electrode_area == pytest.approx(4e-4, rel=1e-9, abs=0)
    assert shape.electrode_gap == pytest.approx(0.02, rel=1e-9)
    model = ElectroelasticModel(shape.domain_for(), VM175.density)
    for circuit, hertz in (("short", 65_101), ("open", 79_808)):
        modes = solve_eigen(model, VM175.constants.to_e_form(), circuit, 8, near_Hz=hertz)
        found = np.sqrt(modes.eigenvalues.real[modes.dominant_index(hertz)]) / (2 * np.pi)
        assert found == pytest.approx(hertz, rel=4e-3)


@pytest.mark.parametrize("poling", [(0, 0, 1), (1, 0, 0), (1, 0, 1), (0, 0.1, -1)])
def test_the_gap_between_electrodes_is_that_along_the_field_however_a_body_is_poled(tmp_path: Path, poling) -> None:
    write_box(tmp_path / "bar.msh", {"hot": (6,), "ground": (5,)}, 1, (20.0, 3.0, 1.0), 3.0)
    shape, plate = MeshFile(tmp_path / "bar.msh", 1e-3, poling), Plate(20e-3, 3e-3, 1e-3, direction=poling)
    assert shape.electrode_gap == pytest.approx(1e-3, rel=1e-9)
    assert poling_along_field(shape) == pytest.approx(poling_along_field(plate), abs=1e-9)
    assert is_poled_across_field(shape) == is_poled_across_field(plate)
    assert first_mode_Hz(shape, VM175.constants, 7500.0) == pytest.approx(
        first_mode_Hz(plate, VM175.constants, 7500.0), rel=1e-9
    )


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("length", [1.0, 20.0])
def test_a_body_is_the_same_along_any_axis(tmp_path: Path, axis: int, length: float) -> None:
    """A plate poled across its thickness, or a bar poled along its length, with the poling along x, y or z."""
    size = np.roll([4.0, 6.0, length], axis + 1)
    write_box(tmp_path / "body.msh", {"hot": (2 * axis + 2,), "ground": (2 * axis + 1,)}, 1, tuple(size), 6.0)
    shape = MeshFile(tmp_path / "body.msh", 1e-3, tuple(np.eye(3)[axis]))
    assert is_poled_along_field(shape)
    assert shape.electrode_gap == pytest.approx(1e-3 * length, rel=1e-9)
    constants = VM175.constants
    compliance, longest = (constants.s11, 6e-3) if length < 6 else (constants.s33, 1e-3 * length)
    expected = 1 / (2 * longest * np.sqrt(7500.0 * compliance.real))
    assert first_mode_Hz(shape, constants, 7500.0) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("plate", "constant", "length"),
    [
        (Plate(12e-3, 5e-3, 1e-3), "s11", 12e-3),
        (Plate(5e-3, 12e-3, 1e-3), "s11", 12e-3),
        (catalogue.plate(5e-3, 12e-3, 1e-3, electrodes=Electrodes(margin=0.2e-3)), "s11", 12e-3),
        (Plate(3e-3, 3e-3, 12e-3), "s33", 12e-3),
        (Plate(15e-3, 3e-3, 3e-3, "length"), "s33", 15e-3),
        (Plate(1e-3, 3e-3, 12e-3, "length"), "s11", 12e-3),
    ],
)
def test_the_first_mode_of_a_plate_is_along_its_longest_size(plate, constant, length) -> None:
    """Whichever of its sizes is called length: a bar poled along it, or across it."""
    constants = VM175.constants
    expected = 1 / (2 * length * np.sqrt(7500.0 * getattr(constants, constant).real))
    assert first_mode_Hz(plate, constants, 7500.0) == pytest.approx(expected, rel=1e-9)


def test_electrodes_around_each_other_are_refused(tmp_path: Path) -> None:
    with gmsh_session():
        import gmsh

        occ = gmsh.model.occ
        occ.cut([(3, occ.addBox(-9, -9, 0, 18, 18, 5))], [(3, occ.addBox(-3, -3, 0, 6, 6, 5))])
        occ.synchronize()
        reach = {face: max(gmsh.model.getBoundingBox(2, face)[3:5]) for _, face in gmsh.model.getEntities(2)}
        low = {face: min(gmsh.model.getBoundingBox(2, face)[:2]) for face in reach}
        upright = [face for face in reach if np.ptp(np.take(gmsh.model.getBoundingBox(2, face), (2, 5))) > 4]
        for name, inside in (("hot", False), ("ground", True)):
            faces = [face for face in upright if (max(reach[face], -low[face]) < 4) == inside]
            gmsh.model.addPhysicalGroup(2, faces, name=name)
        gmsh.model.addPhysicalGroup(3, [1], name="body")
        gmsh.option.setNumber("Mesh.MeshSizeMax", 6.0)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(tmp_path / "tube.msh"))
    with pytest.raises(InputError, match="have the same centre"):
        _ = MeshFile(tmp_path / "tube.msh", 1e-3).electrode_gap


def test_named_mirror_planes_make_the_whole(tmp_path: Path) -> None:
    names = {"hot": (6,), "ground": (5,), "mirror_x": (1,), "mirror_y": (3,)}
    write_box(tmp_path / "quarter.msh", names, size=10.0, mesh=5.0)
    shape = MeshFile(tmp_path / "quarter.msh", unit=1e-3)
    assert shape.domain_for().copies == 4
    assert shape.extents == pytest.approx([0.02, 0.02, 0.01])
    part = ElectroelasticModel(shape.domain_for(), VM175.density)
    whole = ElectroelasticModel(Plate(0.02, 0.02, 0.01).domain((4, 4, 2)), VM175.density)
    constants = VM175.constants.to_e_form()
    modes = solve_eigen(whole, constants, "short", 4)
    expected = np.sqrt(modes.eigenvalues.real[modes.dominant_index()]) / (2 * np.pi)
    modes = solve_eigen(part, constants, "short", 8, near_Hz=expected)
    hertz = np.sqrt(np.abs(modes.eigenvalues.real)) / (2 * np.pi)
    nearest = int(np.argmin(np.abs(hertz - expected)))
    assert hertz[nearest] == pytest.approx(expected, rel=1e-3)
    assert modes.participation[nearest] > 0.5


def mesh_file(mesh: skfem.Mesh, path: Path, **surfaces: Callable[[np.ndarray], np.ndarray]) -> MeshFile:
    """A .msh of linear elements; surfaces : name → which middles of facets (3, n) belong to it."""
    faces = [mesh.facets[:, mesh.facets_satisfying(test, boundaries_only=True)].T for test in surfaces.values()]
    body, flat = skfem.io.meshio.to_meshio(mesh).cells[0], "quad" if isinstance(mesh, skfem.MeshHex) else "triangle"
    tags = [np.full(len(some), tag) for tag, some in enumerate((body.data, *faces))]
    names = {name: np.array([tag, 2]) for tag, name in enumerate(surfaces, 1)}
    blocks = [(body.type, body.data), *((flat, face) for face in faces)]
    data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    meshio.write(path, meshio.Mesh(mesh.p.T, blocks, cell_data=data, field_data=names), file_format="gmsh22")
    return MeshFile(path)


def cube_of(kind: type, cells: int, path: Path) -> MeshFile:
    """A .msh of a cube of 1 mm with so many hexahedra, or six times as many tetrahedra, along each edge."""
    mesh = kind.init_tensor(*3 * [np.linspace(0.0, 1e-3, cells + 1)])
    return mesh_file(mesh, path, hot=lambda x: np.isclose(x[2], 0.0), ground=lambda x: np.isclose(x[2], 1e-3))


def test_the_field_of_a_half_is_that_of_the_whole(tmp_path: Path) -> None:
    """Electrodes of different width on one face: their centres on a half do not lie on its mirror plane."""

    def body(path: Path, start: float, **mirror: Callable[[np.ndarray], np.ndarray]) -> MeshFile:
        lines = np.linspace(-5e-3, 5e-3, 11), np.arange(start, 3.5e-3, 1e-3), np.array([0.0, 1e-3])
        electrodes = {
            "hot": lambda x: (x[2] > 0.99e-3) & (x[0] < -1e-3) & (np.abs(x[1]) < 1e-3),
            "ground": lambda x: (x[2] > 0.99e-3) & (x[0] > 1e-3),
        }
        return mesh_file(skfem.MeshHex.init_tensor(*lines), path, **electrodes, **mirror)

    whole = body(tmp_path / "whole.msh", -3e-3)
    half = body(tmp_path / "half.msh", 0.0, mirror_y=lambda x: x[1] < 1e-9)
    for shape in (whole, half):
        np.testing.assert_allclose(shape.field_direction, (-1, 0, 0), atol=1e-9)
        assert shape.electrode_gap == pytest.approx(6e-3, rel=1e-9)


def context_of(path: Path, text: str) -> EffectContext:
    """What effects know of the body of a [geometry] table."""
    path.write_text(f'name = "body"\n[geometry]\n{text}\n[material]\nbase = "pzt-5h"\n', encoding="utf-8")
    return effect_context(prepare(read_specimen(path)), 1.2e5, 1e3, (5e4, 3e5))


def test_unequal_electrodes_need_a_mirror_plane_between_them(tmp_path: Path) -> None:
    """On a bar with electrodes on its ends the difference has no part that is odd about mid-height."""
    names = {"hot": (2,), "ground": (1,), "mirror_z": (5,)}
    write_box(tmp_path / "half.msh", names, 1, (12.0, 3.0, 1.0), 3.0, (-6.0, -1.5, 0.0))
    half = 'shape = "mesh"\nfile = "half.msh"\nunit = "1 mm"\npoling = [1, 0, 0]'
    plate = 'shape = "trapezoid"\nlength = "12 mm"\nwidth = "3 mm"\nwidth_end = "2 mm"\nthickness = "1 mm"'
    for text, has_one in ((half, False), (plate, True)):
        context = context_of(tmp_path / "body.toml", text)
        assert 2 in context.upper.mirrors
        assert any(effect.name == "unequal_electrode_mass" for effect in library(context)) == has_one


@pytest.mark.parametrize("axis", [0, 1])
def test_a_face_yields_as_that_of_the_same_bar(tmp_path: Path, axis: int) -> None:
    """A bar of 12 mm poled along its length, as a plate and as a mesh that lies along x or y."""
    size, poling = ((12.0, 3.0, 2.0), (3.0, 12.0, 2.0))[axis], np.eye(3, dtype=int)[axis].tolist()
    write_box(tmp_path / "bar.msh", {"hot": (2 * axis + 2,), "ground": (2 * axis + 1,)}, 1, size, 3.0)
    bar = 'shape = "plate"\nlength = "12 mm"\nwidth = "3 mm"\nthickness = "2 mm"\npoling = "length"'
    mesh = f'shape = "mesh"\nfile = "bar.msh"\nunit = "1 mm"\npoling = {poling}'
    drawn, meshed = (
        FaceCompliance.of(context_of(tmp_path / "body.toml", text), 2e6, (1e-4, 2e-3)).stiffness(5e-4)[0]
        for text in (bar, mesh)
    )
    np.testing.assert_allclose(meshed, drawn if axis == 0 else drawn[[1, 0, 2]], rtol=1e-6)


@pytest.mark.parametrize(("start", "face"), [(0.0, 1), (5.0, 1), (-10.0, 2), (-25.0, 2)])
def test_a_half_is_the_same_wherever_its_mirror_plane_lies(tmp_path: Path, start: float, face: int) -> None:
    write_box(tmp_path / "half.msh", {**ELECTRODES, "mirror_x": (face,)}, 1, (10.0, 4.0, 1.0), 2.0, (start, -2.0, 0.0))
    shape = MeshFile(tmp_path / "half.msh", 1e-3)
    assert shape.extents == pytest.approx([0.02, 0.004, 0.001])
    np.testing.assert_allclose(shape.upper_face.extents, [(0, 0.01), (-0.002, 0.002)], atol=1e-12)
    assert shape.upper_face.size == pytest.approx(0.02)
    plate = ElectroelasticModel(Plate(0.02, 0.004, 0.001).domain((4, 2, 1), order=4), 7500.0)
    part, constants = ElectroelasticModel(shape.domain_for(), 7500.0), VM175.constants.to_e_form()
    first = [
        np.sqrt(modes.eigenvalues.real[modes.dominant_index(80e3)]) / (2 * np.pi)
        for modes in (solve_eigen(model, constants, "short", 8, near_Hz=80e3) for model in (part, plate))
    ]
    assert first[0] == pytest.approx(first[1], rel=1e-3)
    modes = solve_eigen(part, constants, "short", 8, near_Hz=80e3)
    assert family(part, modes.vectors[:, modes.dominant_index(80e3)]) == "first length extension"


@pytest.mark.parametrize(("name", "face"), [("mirror_y", 2), ("mirror_x", 3)])
def test_a_surface_that_is_no_mirror_plane_is_refused(tmp_path: Path, name: str, face: int) -> None:
    write_box(tmp_path / "half.msh", {**ELECTRODES, name: (face,)}, 1, (10.0, 4.0, 1.0), 4.0)
    with pytest.raises(InputError, match=f'the surface "{name}" is no mirror plane: it reaches from'):
        _ = MeshFile(tmp_path / "half.msh", 1e-3).mesh


@pytest.mark.parametrize(("kind", "most"), [(skfem.MeshHex, 62500), (skfem.MeshTet, 333333)])
def test_a_mesh_too_large_to_be_solved_is_refused(kind: type, most: int, tmp_path: Path) -> None:
    """As soon as it is read where linear elements are too many already, else for the elements that are asked for."""
    shape = cube_of(kind, 21, tmp_path / "fine.msh")
    assert shape.domain_for(order=1).order == 1 and shape.volume == pytest.approx(1e-9, rel=1e-6, abs=0)
    with pytest.raises(InputError, match=rf"order 2 the mesh has about 3\.?\d?e\+05 unknowns.*at most {most // 8}$"):
        shape.domain_for()
    with pytest.raises(InputError, match=rf"order 1 the mesh has about .* unknowns.*at most {most}$"):
        _ = cube_of(kind, 40, tmp_path / "finest.msh").mesh


@pytest.mark.parametrize(
    ("names", "told"),
    [
        ({"hot": (6,)}, 'no surface named "ground"; it has hot'),
        ({}, "it has no named surface"),
        ({"hot": (6,), "ground": (4,)}, 'electrodes "hot" and "ground" touch at'),
    ],
)
def test_wrong_electrodes_are_refused(tmp_path: Path, names: dict, told: str) -> None:
    write_box(tmp_path / "cube.msh", names, order=1)
    with pytest.raises(InputError, match=told) as caught:
        MeshFile(tmp_path / "cube.msh", unit=1e-3).domain_for()
    assert str(tmp_path / "cube.msh") in str(caught.value)


def test_wrong_unit_wrong_poling_and_no_mesh_are_refused(tmp_path: Path) -> None:
    write_box(tmp_path / "cube.msh", {"hot": (6,), "ground": (5,), "mirror_z": (5,)}, order=1)
    with pytest.raises(InputError, match=r"geometry\.unit"):
        MeshFile(tmp_path / "cube.msh").domain_for()
    with pytest.raises(InputError, match='"mirror_z" cannot be a mirror plane'):
        MeshFile(tmp_path / "cube.msh", unit=1e-3).domain_for()
    (tmp_path / "text.msh").write_text("no mesh")
    with pytest.raises(InputError, match="cannot read this as a mesh"):
        MeshFile(tmp_path / "text.msh").domain_for()
    with pytest.raises(InputError, match="no such file"):
        MeshFile(tmp_path / "absent.msh").domain_for()
    flat = meshio.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [("triangle", [[0, 1, 2]])])
    flat.write(tmp_path / "flat.vtk")
    with pytest.raises(InputError, match="no volume elements"):
        MeshFile(tmp_path / "flat.vtk").domain_for()


def test_inverted_and_loose_elements_are_refused() -> None:
    mesh = skfem.MeshHex.init_tensor(*[np.linspace(0, 1, 3)] * 3)
    check_elements(mesh)
    points = mesh.p.copy()
    middle = np.flatnonzero(np.all(np.isclose(points, 0.5), axis=0))[0]
    points[:, middle] = 1.3
    with pytest.raises(InputError, match=r"inverted or degenerate elements? of 8, the first at"):
        check_elements(skfem.MeshHex(points, mesh.t))
    both = skfem.MeshHex(np.hstack([mesh.p, mesh.p + 3.0]), np.hstack([mesh.t, mesh.t + mesh.p.shape[1]]))
    with pytest.raises(InputError, match="2 parts that share no points"):
        check_elements(both)


def test_electrode_inside_the_body_is_refused() -> None:
    mesh = skfem.MeshHex.init_tensor(*[np.linspace(0, 1, 3)] * 3)
    mesh = mesh.with_boundaries(
        {"hot": lambda x: np.isclose(x[2], 0.5), "ground": lambda x: np.isclose(x[2], 0)}, False
    )
    with pytest.raises(InputError, match='facets of "hot" lie inside the body'):
        check_electrodes(mesh, "hot", "ground")


def test_meshing_is_silent_and_leaves_ctrl_c_alone(capfd: pytest.CaptureFixture[str]) -> None:
    import signal

    from femu_piezo.geometry.catalogue import disk

    before = signal.getsignal(signal.SIGINT)
    disk(10e-3, 1e-3).domain(2e-3)
    assert signal.getsignal(signal.SIGINT) is before
    captured = capfd.readouterr()
    assert captured.out == captured.err == ""


def test_missing_gmsh_is_one_sentence_and_boxes_do_without(monkeypatch: pytest.MonkeyPatch) -> None:
    import builtins

    from femu_piezo.geometry.catalogue import disk, plate

    real = builtins.__import__

    def without_gmsh(name, *args, **kwargs):
        if name == "gmsh":
            raise OSError("libGLU.so.1: cannot open shared object file: No such file or directory")
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without_gmsh)
    with pytest.raises(InputError, match=r"libGLU\.so\.1.*apt-get install libglu1-mesa"):
        plate(10e-3, 6e-3, 1e-3, corner_radius=1e-3).domain(2e-3)
    assert disk(10e-3, 1e-3).domain(2e-3).mesh.nelements > 0
    assert Plate(40e-3, 5e-3, 1e-3).domain((5, 1, 1)).volume == pytest.approx(200e-9, rel=1e-6, abs=0)
