"""Effects at a place on bodies that are neither plates with three mirror planes nor round, against the spectral solver.

A trapezoid with two mirror planes, a plate with rounded corners, and a plate in a user's mesh without mirror planes.
"""

from __future__ import annotations

import numpy as np
import pytest
import skfem
from hidden_effects.body import Surface
from hidden_effects.build import Build
from hidden_effects.round_draws import soft_volume

from diagnosis.conftest import AXES, BAND, DENSITY, FREQUENCY, FUNDAMENTAL, SIZE, ReducedBody, unequal_films
from femu_piezo.effects.effect import EffectContext
from femu_piezo.effects.extended_model import extend_model
from femu_piezo.effects.library import library
from femu_piezo.effects.local.face_on_mesh import LevelOfMesh
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry import catalogue
from femu_piezo.geometry.domain import Domain
from femu_piezo.geometry.gmsh_session import gmsh_session
from femu_piezo.geometry.mesh_file import MeshFile
from femu_piezo.geometry.slab import Slab
from femu_piezo.geometry.upper_face import UpperFace
from femu_piezo.inference.response import Evaluation
from femu_piezo.material.constants import D_FORM
from femu_piezo.measurement.readers import write_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.specimen.file import read_specimen
from femu_piezo.study.diagnose import diagnose
from tests.materials import LOSSY
from tests.noise import noisy
from tests.specimens import material
from tests.variants import variants

THETA = LOSSY.vector()
TAPER = 0.25


def trapezoid(folder) -> Slab:
    length, width, thickness = SIZE
    return catalogue.trapezoid(length, width * (1 - TAPER), width * (1 + TAPER), thickness)


def rounded(folder) -> Slab:
    """A plate with corners rounded so little that the sharp plate of the spectral solver is nearly the same."""
    return catalogue.plate(*SIZE, corner_radius=0.1e-3)


def meshed(folder) -> MeshFile:
    """The whole plate in a mesh file, so that all of its modes are in one parity class."""
    divisions, half = (14, 8, 2), np.array(SIZE) / 2
    with gmsh_session():
        import gmsh

        box = gmsh.model.occ.addBox(*(-half), *SIZE)
        gmsh.model.occ.synchronize()
        for _, line in gmsh.model.getEntities(1):
            low, high = np.array(gmsh.model.getBoundingBox(1, line)).reshape(2, 3)
            gmsh.model.mesh.setTransfiniteCurve(line, divisions[int(np.argmax(high - low))] + 1)
        for dimension, entity in (*gmsh.model.getEntities(2), (3, box)):
            if dimension == 2:
                gmsh.model.mesh.setTransfiniteSurface(entity)
                gmsh.model.mesh.setRecombine(2, entity)
        gmsh.model.mesh.setTransfiniteVolume(box)
        for _, face in gmsh.model.getEntities(2):
            z = gmsh.model.occ.getCenterOfMass(2, face)[2]
            if abs(z) > 0.4 * SIZE[2]:
                gmsh.model.addPhysicalGroup(2, [face], name="hot" if z > 0 else "ground")
        gmsh.model.addPhysicalGroup(3, [box], name="body")
        gmsh.model.mesh.generate(3)
        gmsh.write(str(folder / "plate.msh"))
    return MeshFile(folder / "plate.msh")


class Body(ReducedBody):
    """A body as a reduced model, with its library of effects."""

    def __init__(self, shape) -> None:
        super().__init__("s11", "d31", "eps33T")
        self.shape, constants = shape, self.constants
        context = EffectContext(
            FUNDAMENTAL, self.free.names, constants, AXES, DENSITY, SIZE[2], 2e3, band_Hz=BAND, upper=shape.upper_face
        )
        self.library = {effect.key: effect for effect in library(context)}
        full = ElectroelasticModel(shape.domain_for(1e-4, FREQUENCY[-1], 1900.0), DENSITY)
        self.model = extend_model(full, [constants], [*self.library.values()], FREQUENCY[-1], accuracy=1e-5)
        self.evaluation = Evaluation(self.model, 2 * np.pi * FREQUENCY)


BODIES = {"trapezoid": (trapezoid, TAPER), "rounded plate": (rounded, 0.0), "mesh of a user": (meshed, 0.0)}
SIDE = 0.8e-3
RADIUS = SIDE / np.sqrt(np.pi)
PLACE = (4.1e-3, 1.4e-3)


def patch(built: Build) -> tuple[tuple[float, float], tuple[float, float]]:
    """Ends along x and y of the square patch, in the coordinates of the straight plate that the taper stretches
    along y.
    """
    half = SIDE / 2
    x, y = PLACE
    stretch = 1 + built.taper * 2 * x / SIZE[0]
    return (x - half, x + half), ((y - half) / stretch, (y + half) / stretch)


def mass(built: Build) -> None:
    built.surfaces.append(Surface(*patch(built), (1,), lambda w: -(w**2) * 2.5e-6 / SIDE**2))


def support(built: Build) -> None:
    built.surfaces.append(Surface(*patch(built), (1,), lambda w: (3e5 + 2j * w) / SIDE**2))


#: Depth k, radius a and place of a soft spot 1 − k exp(−r²/a²) on the middle line.
SOFT, SPOT_RADIUS, SPOT_X = 0.4, 0.7e-3, 3.1e-3


def soft_spot(built: Build) -> None:
    built.soft = (
        lambda x: SOFT * np.exp(-(((x - SPOT_X) / SPOT_RADIUS) ** 2)),
        lambda y: np.exp(-((y / SPOT_RADIUS) ** 2)),
    )


#: Effect → its parameters, function that builds it, and the error allowed as a share of the change (rms over sweep).
CASES = {
    "point_mass": ((2.5e-6, *PLACE, RADIUS), mass, 0.02),
    "mounting/one patch": ((3e5, 2.0, *PLACE, RADIUS), support, 0.03),
    "unequal_electrode_mass": ((0.6,), unequal_films, 0.03),
    "local_crack": ((soft_volume(SIZE[2], SOFT, SPOT_RADIUS), SPOT_X, 0.0, RADIUS), soft_spot, 0.11),
}
#: Cases that take longest, marked slow.
LONG = ("point_mass", "mounting/one patch", "unequal_electrode_mass")


@pytest.fixture(scope="module", params=variants(BODIES, slow=["rounded plate", "mesh of a user"]))
def body_and_solver(request, tmp_path_factory):
    """A body as a reduced model, and a function that gives its build for the spectral solver."""
    make, taper = BODIES[request.param]
    body = Body(make(tmp_path_factory.mktemp("mesh")))
    return body, lambda: Build(np.array(SIZE), DENSITY, THETA, FUNDAMENTAL, taper=taper)


@pytest.fixture(scope="module")
def bare(body_and_solver):
    """Z (k,) of the body without effects by the spectral solver."""
    return body_and_solver[1]().impedance(FREQUENCY)


@pytest.mark.parametrize("key", variants(CASES, slow=LONG))
def test_change_of_impedance_against_independent_solution(body_and_solver, bare, key):
    body, make = body_and_solver
    values, change, share = CASES[key]
    if (
        key not in body.library
    ):  # a body without a mirror plane in z bends anyway: the library has no such effect for it
        assert 2 not in body.shape.mirrors and key == "unequal_electrode_mass"
        return
    built = make()
    change(built)
    exact = np.log(built.impedance(FREQUENCY) / bare)
    by_law = np.log(body.impedance(key, values) / body.impedance())
    error, size = (np.sqrt(np.mean(np.abs(part) ** 2)) for part in (by_law - exact, exact))
    print(f"{key}: changes {size:.3g}, error {error / size:.3g} of it")
    assert size > 0.005
    assert error < share * size


@pytest.mark.parametrize("place", [PLACE, (-2.3e-3, 0.2e-3), (5.95e-3, 1.0e-3)], ids=["inside", "middle line", "end"])
@pytest.mark.parametrize("key", ["point_mass", "mounting/one patch"])
def test_slopes_are_those_of_differences(body_and_solver, key, place):
    """Also where the patch lies across a mirror line or partly outside the body."""
    body, _ = body_and_solver
    values = (*CASES[key][0][:-3], *place, RADIUS)
    parameters, x = body.with_effects({key: values})
    slopes = body.evaluation.with_jacobian(parameters, x)[1][:, -len(values) :]
    steps = 1e-5 * np.eye(x.size)[-len(values) :]
    ahead, behind = (np.array([body.evaluation.impedance(parameters, x + way * h) for h in steps]) for way in (1, -1))
    differences = ((ahead - behind) / 2e-5).T
    np.testing.assert_allclose(slopes, differences, atol=1e-4 * np.abs(differences).max(axis=0).min(), rtol=1e-3)


@pytest.mark.parametrize("place", [PLACE, (-2.3e-3, 0.2e-3), (5.95e-3, 1.0e-3)], ids=["inside", "middle line", "end"])
def test_slopes_of_the_terms_of_a_soft_spot(body_and_solver, place):
    """Slopes of the matrices themselves, since across a mirror line Z hardly changes with the place."""
    body, _ = body_and_solver
    effect, omega, values = body.library["local_crack"], np.ones(1), np.array([3e-9, *place, 0.5e-3])
    places = body.model.restricted(effect.sectors).places

    def total(p, slope=None):
        terms = effect.local(places, omega, p)
        return sum(term.matrix * (term.value[0] if slope is None else term.slopes[0, slope]) for term in terms)

    for number, step in enumerate(np.diag([1e-13, 1e-8, 1e-8, 1e-8])):
        difference = (total(values + step) - total(values - step)) / (2 * step[number])
        slope = total(values, number)
        assert np.max(np.abs(slope - difference)) < 1e-7 * np.max(np.abs(difference))


@pytest.mark.parametrize("height", [0.0, 0.3, 0.5, 1.0])
def test_displacements_at_a_height_are_those_of_a_polynomial(height):
    """Displacements and slopes of a quadratic field, also at heights inside the elements."""
    shape = catalogue.plate(*SIZE, corner_radius=0.5e-3)
    model = ElectroelasticModel(shape.domain(2e-3, symmetric=False, order=4), DENSITY)
    assert_displacements_are_those_of_a_polynomial(model, height, SIZE[2])


@pytest.mark.parametrize("kind", [skfem.MeshHex, skfem.MeshTet])
def test_displacements_at_a_height_where_some_facets_lie_there(kind):
    """Two layers of elements that meet at mid-height at one end of a plate only."""
    mesh = kind.init_tensor(np.linspace(-5e-3, 5e-3, 11), np.linspace(-2.5e-3, 2.5e-3, 5), np.linspace(-5e-4, 5e-4, 3))
    points = mesh.p.copy()
    points[2, (np.abs(points[2]) < 1e-9) & (points[0] > -3.5e-3)] += 0.2e-3
    mesh = kind(points, mesh.t).with_boundaries({"hot": lambda x: x[2] > 4.9e-4, "ground": lambda x: x[2] < -4.9e-4})
    model = ElectroelasticModel(Domain(mesh, ("hot",), ("ground",)), DENSITY)
    assert_displacements_are_those_of_a_polynomial(model, 0.5, 1e-3)


def assert_displacements_are_those_of_a_polynomial(model: ElectroelasticModel, height: float, thickness: float) -> None:
    x, y, z = model.basis.doflocs / 1e-3
    fields = np.zeros((4, model.basis.N, 1))
    fields[:3, :, 0] = x + 2 * z, y * z, z**2
    level = LevelOfMesh(model, height)
    points, at = np.array([[1.0, 0.5], [-4.0, -1.2], [3.3, 2.0]]), (height - 0.5) * thickness / 1e-3
    value, along_x, along_y = (
        (one @ level.of(fields).reshape(-1, 3)).reshape(-1, 3) for one in level.probe(points * 1e-3)
    )
    np.testing.assert_allclose(
        value, np.column_stack([points[:, 0] + 2 * at, points[:, 1] * at, np.full(3, at**2)]), atol=1e-9
    )
    np.testing.assert_allclose(along_x * 1e-3, np.tile([1.0, 0, 0], (3, 1)), atol=1e-8)
    np.testing.assert_allclose(along_y * 1e-3, np.tile([0, at, 0], (3, 1)), atol=1e-8)


@pytest.mark.slow
def test_a_support_of_a_trapezoid_is_found(tmp_path):
    """With dimensions off by their tolerances, held constants by 1 %, free ones by 3 % in the file, and noise of
    1e-3.
    """
    length, width, thickness = SIZE
    built = Build(np.array(SIZE) * (1.0002, 0.9995, 1.001), DENSITY, THETA, FUNDAMENTAL, taper=TAPER)
    support(built)
    frequency = np.linspace(20e3, 240e3, 401)
    sweep = ImpedanceSpectrum(frequency, noisy(built.impedance(frequency), 1e-3, 5))
    write_spectrum(sweep, tmp_path / "sweep.csv")
    free = ("s11", "s12", "d31", "eps33T")
    given = material(LOSSY, free, {name: 1.03 if name in free else 1.01 for name in D_FORM})
    text = f"""
name = "trapezoid"
[geometry]
shape = "trapezoid"
poling = "thickness"
length = {length}
width = {width * (1 - TAPER)}
width_end = {width * (1 + TAPER)}
thickness = {thickness}
density = {DENSITY}
{given}
[measurement]
file = "sweep.csv"
"""
    (tmp_path / "trapezoid.toml").write_text(text, encoding="utf-8")
    result = diagnose(read_specimen(tmp_path / "trapezoid.toml"))
    (cause,) = result.verdict.causes
    assert cause.effect.key == "mounting/one patch" and cause.probability > 0.9
    place = dict(zip((parameter.name for parameter in cause.effect.parameters), cause.values, strict=True))
    assert np.hypot(place["x"] - PLACE[0], place["y"] - PLACE[1]) < 0.3e-3
    final = result.after
    for name in free:
        assert abs(final[name].value - THETA[D_FORM.index(name)].real) < 3 * final[name].std.real, name


def test_places_lie_on_the_face_and_mirror_lines_halve_it(body_and_solver):
    """Extents, volume and number of candidate places of the upper face."""
    body, _ = body_and_solver
    face, half = body.shape.upper_face, np.array(SIZE[:2]) / 2
    low, high = np.array(face.extents).T
    assert np.all(low == [0.0 if axis in face.mirrors else -half[axis] for axis in range(2)])
    assert np.all((face.places > low) & (face.places < high))
    assert face.volume == pytest.approx(np.prod(SIZE), rel=2e-3)
    assert len(face.places) > 30 * 4 / 2 ** len({0, 1} & set(face.mirrors))


@pytest.mark.parametrize("width", [0.3e-3, 1e-3])
def test_places_on_a_narrow_frame(width):
    """Between sides of 60 mm all places of a coarse grid are in the opening, which left effects without a start."""
    frame = UpperFace.within(
        (-0.03, 0.03, -0.03, 0.03), (0, 1), 1e-7, 1e-3, lambda x, y: np.maximum(np.abs(x), np.abs(y)) > 0.03 - width
    )
    assert len(frame.places) >= 15 and np.all(frame.places.max(axis=1) > 0.03 - width)
    context = EffectContext(5e4, (), LOSSY, {}, DENSITY, 1e-3, upper=frame)
    sizes = {effect.key: effect.sizes.tolist() for effect in library(context) if effect.sites is not None}
    assert sizes == {"local_crack": [0], "point_mass": [0], "mounting/one patch": [0, 1]}
