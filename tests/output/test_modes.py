"""Mode shapes: names from displacement fields, mirrored parts against whole bodies, pictures, and files of the
command.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import femu_piezo as fp
from femu_piezo.errors import InputError
from femu_piezo.forward.eigen import solve_eigen
from femu_piezo.forward.modal import ModalModel
from femu_piezo.forward.mode_family import family, motion_of
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.catalogue import disk
from femu_piezo.geometry.shapes import Plate
from femu_piezo.geometry.slab import Electrodes
from femu_piezo.material.library import library_material
from femu_piezo.output.render import _aim, border_of, shapes_of
from femu_piezo.output.surface import GROUND, HOT, surface_of
from femu_piezo.specimen.file import read_specimen
from femu_piezo.study.modes import _driven, _pairs, modes

PIC255 = library_material("pic255")
K31 = """
name = "bar"
[geometry]
shape = "plate"
length = "20 mm"
width = "3 mm"
thickness = "1 mm"
[material]
base = "pic255"
tan_s11 = 0.01
[update]
accuracy = 1e-3
"""


def specimen(folder: Path, text: str = K31):
    path = folder / "specimen.toml"
    path.write_text(text)
    return read_specimen(path)


def vector_of(model: ElectroelasticModel, displacement) -> np.ndarray:
    """Vector of the free unknowns for a displacement field (x, y, z) → (u_x, u_y, u_z), by its nodal values."""
    x = model.basis.doflocs
    nodal = np.concatenate([*(np.broadcast_to(part, x[0].shape) for part in displacement(*x)), np.zeros(x.shape[1])])
    return np.asarray(model.prolongation.T @ nodal) * (np.asarray(model.mass.diagonal()) > 0)


@pytest.mark.parametrize(
    ("words", "field"),
    [
        ("first length extension", lambda x, y, z: (np.sin(np.pi * x / 20e-3), 0, 0)),
        ("length extension, third harmonic", lambda x, y, z: (np.sin(3 * np.pi * x / 20e-3), 0, 0)),
        ("first width extension", lambda x, y, z: (0, np.sin(np.pi * y / 8e-3), 0)),
        ("first thickness extension", lambda x, y, z: (0, 0, np.sin(np.pi * z / 1e-3))),
        (
            "flexure along the length",
            lambda x, y, z: (
                z * 2 * np.pi / 20e-3 * np.sin(2 * np.pi * x / 20e-3),
                0,
                np.cos(2 * np.pi * x / 20e-3),
            ),
        ),
        ("thickness shear", lambda x, y, z: (np.sin(np.pi * z / 1e-3), 0, 0)),
        ("face shear", lambda x, y, z: (y, x, 0)),
    ],
)
def test_family_is_read_from_the_displacement(words: str, field) -> None:
    model = ElectroelasticModel(Plate(20e-3, 8e-3, 1e-3).domain((10, 4, 2), ()), 7800.0)
    assert family(model, vector_of(model, field)) == words


def test_radial_modes_of_a_disk_are_named_in_order() -> None:
    model = ElectroelasticModel(disk(20e-3, 1e-3).domain(2.5e-3), PIC255.density)
    modes = solve_eigen(model, PIC255.constants.to_e_form(), "short", 24)
    driven = np.flatnonzero(modes.participation > 1e-3)
    assert [family(model, modes.vectors[:, i]) for i in driven[:2]] == ["first radial", "second radial"]
    motion = motion_of(model, modes.vectors[:, driven[0]])
    assert motion.radial > 0.999
    others = np.setdiff1d(np.arange(24), driven)
    assert family(model, modes.vectors[:, others[0]]) == "contour mode of a disk (not axisymmetric)"


@pytest.mark.parametrize("circuit", ["short", "open"])
def test_mirrored_part_shows_the_mode_of_the_whole(circuit: str) -> None:
    plate = Plate(10e-3, 4e-3, 2e-3)
    fields = []
    for axes, divisions in (((0, 1, 2), (4, 2, 1)), ((), (8, 4, 2))):
        model = ElectroelasticModel(plate.domain(divisions, axes), PIC255.density)
        modes = solve_eigen(model, PIC255.constants.to_e_form(), circuit, 10, near_Hz=1.6e5)
        index = modes.dominant_index(1.6e5)
        surface = surface_of(model, modes.vectors[:, [index]], subdivisions=2)
        order = np.lexsort(np.round(surface.points.T * 1e7))
        points, first = np.unique(np.round(surface.points[order] * 1e7), axis=0, return_index=True)
        u, phi = surface.displacement[0][order][first].real, surface.potential[0][order][first].real
        sign = np.sign(u[np.argmax(points[:, 0]), 0])
        top = phi[points[:, 2] == points[:, 2].max()].mean()
        bottom = phi[points[:, 2] == points[:, 2].min()].mean()
        scale = np.abs(u).max()
        fields.append((points, sign * u / scale, sign * (phi - (top + bottom) / 2) / scale, surface))
    (points, u, phi, part), (other_points, other_u, other_phi, whole) = fields
    assert np.array_equal(points, other_points)
    assert u == pytest.approx(other_u, abs=2e-4)
    assert phi == pytest.approx(other_phi, abs=2e-3 * np.abs(other_phi).max())
    for label in (HOT, GROUND):
        assert np.sum(part.electrode == label) == np.sum(whole.electrode == label)


def test_names_respect_the_symmetry_of_what_drives_the_body(tmp_path: Path) -> None:
    """Full electrodes drive no face shear and no even number of half waves, and in a disk only axisymmetric modes."""
    square = K31.replace('"plate"', '"square"').replace('length = "20 mm"\nwidth = "3 mm"', 'length = "10 mm"')
    thick = K31.replace('"plate"', '"disk"').replace('length = "20 mm"\nwidth = "3 mm"', 'diameter = "5 mm"')
    thick = thick.replace('thickness = "1 mm"', 'thickness = "5 mm"')
    names = {}
    for name, text, top in (("square", square, 3e5), ("disk", thick, 1.1e6)):
        (tmp_path / name).mkdir()
        names[name] = [one.pole_family for one in modes(specimen(tmp_path / name, text), band=(0.0, top)).modes]
    assert names["square"][0] == "first planar extension (all edges in phase)"
    assert names["square"][1] in ("first length extension, coupled", "first width extension, coupled")
    assert len(names["disk"]) > 3 and not any("not axisymmetric" in one for one in names["disk"])


def test_modes_of_a_bar_are_those_of_the_thin_bar(tmp_path: Path) -> None:
    result = modes(specimen(tmp_path))
    first = result.modes[0]
    s11 = PIC255.constants.s11.real
    assert first.pole.frequency_Hz == pytest.approx(1 / (2 * 20e-3 * np.sqrt(PIC255.density * s11)), rel=0.01)
    assert first.pole_family == first.zero_family == "first length extension"
    k31 = abs(PIC255.constants.coupling["k31"])
    ratio = np.pi / 2 * first.zero.frequency_Hz / first.pole.frequency_Hz  # IEEE 176: k²/(1−k²) = x tan(x − π/2)
    assert np.sqrt(1 / (1 + 1 / (ratio * np.tan(ratio - np.pi / 2)))) == pytest.approx(k31, rel=0.03)
    assert sum(mode.participation for mode in result.modes) == pytest.approx(1.0)


def test_a_pole_goes_with_its_own_zero_where_weak_modes_lie_above_it() -> None:
    """Of two modes far apart, with weak ones between them, k_eff is that without the weak ones."""
    frequency = np.array([503.7, 505.8, 560.0, 577.3, 800.0]) * 1e3
    eigenvalues, strength = (2 * np.pi * frequency) ** 2, np.array([0.02, 1e-5, 1.9e-5, 1e-5, 0.005])

    def pairs(chosen: np.ndarray) -> list[tuple[float, float]]:
        squares, charges = eigenvalues[chosen], np.sqrt(strength * eigenvalues)[chosen]
        modal = ModalModel(squares, charges, 1.0, np.zeros((1, squares.size + 1)), np.zeros((0, 1, 1)), 1.0)
        values, vectors = modal.zeros
        poles = _driven("pole", squares, charges, np.ones((1, squares.size)), 1e6)
        zeros = _driven("zero", values, modal.zero_amplitudes, vectors, 1e6)
        return [(pole[0].frequency_Hz, zero[0].frequency_Hz) for pole, zero in _pairs(poles, zeros)]

    np.testing.assert_allclose(pairs(np.arange(5)), pairs(np.array([0, 4])), rtol=2e-4)


@pytest.mark.parametrize("accuracy", [1e-3, 1e-4])
def test_the_line_around_an_electrode_has_the_length_of_its_rim(accuracy: float) -> None:
    """A bare rim, with cells that shrink towards it; the pinhole in the middle of a disk is not drawn."""
    domain = disk(10e-3, 1e-3, electrodes=Electrodes(margin=0.7e-3)).domain_for(accuracy, 120e3, 1900.0, order=3)
    model = ElectroelasticModel(domain, 7500.0)
    surface = surface_of(model, np.zeros((model.size, 1)))
    for label in (HOT, GROUND):
        ends = surface.points[border_of(surface, label)]
        assert np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum() == pytest.approx(np.pi * 8.6e-3, rel=1e-3)


@pytest.mark.parametrize("size", [(4, 4, 12), (40, 5, 1), (5, 40, 1), (1, 1, 1)])
@pytest.mark.parametrize("above", [True, False])
def test_a_body_of_any_proportions_is_within_the_picture(size: tuple[float, float, float], above: bool) -> None:
    window = (1500, 1000)
    plotter = SimpleNamespace(window_size=window, camera_position=None, camera=SimpleNamespace(view_angle=None))
    corners = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T * size
    _aim(plotter, corners, above, largest=0.3)
    eye, focus, up = (np.array(part) for part in plotter.camera_position)
    assert np.sign(eye).tolist() == ([1, -1, 1] if above else [-1, 1, -1])
    view = (focus - eye) / np.linalg.norm(focus - eye)
    right = np.cross(view, up) / np.linalg.norm(np.cross(view, up))
    seen = corners + 0.3 * np.sign(corners) - eye
    half = np.tan(np.radians(plotter.camera.view_angle / 2))
    assert np.max(np.abs(seen @ np.cross(right, view)) / (seen @ view)) < half
    assert np.max(np.abs(seen @ right) / (seen @ view)) < half * window[0] / window[1]


def test_a_hole_does_not_turn_over_in_the_picture_of_a_mode(tmp_path: Path) -> None:
    """Its rim keeps its sense of rotation, at both ends of the oscillation; at 7 % of the length it did not."""
    text = K31.replace("3 mm", "10 mm") + '[simulation]\nstart = "160 kHz"\nstop = "180 kHz"\n'
    result = modes(specimen(tmp_path, text.replace("[material]", 'hole_diameter = "2 mm"\n[material]', 1)))
    for shape in (shape for mode in result.modes for shape in shapes_of(result, mode)):
        x, y, z = shape.surface.points.T
        rim = np.flatnonzero((np.hypot(x, y) < 1.0001e-3) & (z > z.max() - 1e-9))
        rim = rim[np.argsort(np.arctan2(y[rim], x[rim]))]
        for phase in (0.0, np.pi):
            around, beside = shape.at(phase)[0][rim, :2].T
            assert np.sum(around * np.roll(beside, -1) - beside * np.roll(around, -1)) > 0


def test_the_usual_band_ends_with_the_simulated_sweep(tmp_path: Path) -> None:
    """3.5 times the fundamental of a thin plate may be far beyond the sweep, and too high for any mesh."""
    whole = modes(specimen(tmp_path)).band[1]
    for stop, high in ((100e3, 100e3), (2 * whole, whole), (20e3, whole)):  # no mode lies below 20 kHz
        simulated = modes(specimen(tmp_path, f"{K31}[simulation]\nstop = {stop}\n"))
        assert simulated.band == (0.0, pytest.approx(high)) and len(simulated.modes) == 1 + (high > 200e3)


def test_modes_that_the_terminals_hardly_see_are_counted(tmp_path: Path) -> None:
    """Half an electrode hardly drives bending: `simulate` lists those modes, `modes` says how many it leaves out."""
    text = '[geometry]\nshape = "plate"\nlength = 24e-3\nwidth = 6e-3\nthickness = 1e-3\ndensity = 7600.0\n'
    text += 'electrode_start = 2e-3\nelectrode_length = 12e-3\n[material]\nbase = "pzt-8"\n'
    (tmp_path / "half.toml").write_text(text + '[simulation]\nstop = "200 kHz"\n', encoding="utf-8")
    found, seen = fp.modes(tmp_path / "half.toml"), fp.simulate(tmp_path / "half.toml").poles
    weak = len(seen) - len(found.modes)
    assert weak > 1
    assert f"half: {weak} modes are left out, with less than 0.1 % of the participation" in found.notes[-1]
    assert fp.modes(tmp_path / "half.toml", count=1).notes == ()


def test_band_without_modes_and_wrong_band_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no driven mode lies between 1000 and 2000 Hz"):
        modes(specimen(tmp_path), band=(1e3, 2e3))
    with pytest.raises(InputError, match="is no band"):
        modes(specimen(tmp_path), band=(2e3, 1e3))


def test_command_writes_pictures_animation_scene_and_json_in_silence(tmp_path: Path) -> None:
    specimen(tmp_path)
    environment = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "WAYLAND_DISPLAY")}
    command = [sys.executable, "-m", "femu_piezo.cli", "modes", "specimen.toml", "--out", "out", "--count", "1"]
    done = subprocess.run(
        [*command, "--animate", "--html"], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    out = tmp_path / "out"
    assert {path.name for path in out.iterdir()} == {
        "modes.json",
        "modes.png",
        "modes.html",
        "mode_01.png",
        "mode_01.gif",
    }
    record = json.loads((out / "modes.json").read_text())
    assert record["modes"][0]["pole"]["family"] == "first length extension"
    from PIL import Image

    with Image.open(out / "mode_01.gif") as movie:
        assert movie.n_frames == 24
        frames = []
        for index in (0, 12):
            movie.seek(index)
            frames.append(np.asarray(movie.convert("RGB"), dtype=float))
    assert np.mean(np.abs(frames[0] - frames[1])) > 1.0
    with Image.open(out / "mode_01.png") as picture:
        pixels = np.asarray(picture.convert("RGB"))
    assert picture.size[0] > 2000
    assert np.mean(np.any(pixels < 200, axis=2)) > 0.03
    page = (out / "modes.html").read_text()
    assert "http" not in page.replace("http-equiv", "")
    assert "__DATA__" not in page
