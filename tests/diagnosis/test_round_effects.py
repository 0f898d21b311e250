"""Effects of disks and rings against the independent solver: the change of log Z, which leaves the mesh error out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hidden_effects.reduced import Plate
from hidden_effects.round_body import RoundBody, RoundSurface
from hidden_effects.round_draws import soft_volume

from diagnosis.conftest import DENSITY, ReducedBody
from femu_piezo.diagnosis.comparison import Comparison
from femu_piezo.diagnosis.selection import compare
from femu_piezo.diagnosis.starts import of_either_sign, relocated, starts
from femu_piezo.effects.effect import EffectContext
from femu_piezo.effects.extended_model import extend_model
from femu_piezo.effects.library import library
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.response import full_impedance
from femu_piezo.geometry import catalogue
from femu_piezo.geometry.domain import Domain
from femu_piezo.geometry.plane_mesh import extruded, labelled, polar_plane
from femu_piezo.geometry.round_body import PINHOLE
from femu_piezo.geometry.slab import Electrodes
from femu_piezo.inference.descent import COARSE, RANKED
from femu_piezo.inference.fit import fit
from femu_piezo.inference.laws import law_misses
from femu_piezo.inference.response import Evaluation
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.measurement.sweeps import SweepData, stacked
from tests.noise import noisy

THICKNESS = 1.5e-3
SPOT_RADIUS = 0.5e-3
RADII = {"disk": (0.0, 6e-3), "ring": (2.5e-3, 6e-3)}
#: Sweeps up to the second radial mode of the disk and beyond the second of the ring, finer around the first, Hz.
FREQUENCY = {
    name: np.r_[np.linspace(20e3, low, 20), np.linspace(low + 2e3, high, 41), np.linspace(high + 5e3, top, 50)]
    for name, low, high, top in (("disk", 150e3, 200e3, 450e3), ("ring", 100e3, 150e3, 400e3))
}
AXES = {"diameter": (0, 1), "thickness": (2,)}


class Round(ReducedBody):
    """A disk or ring as an extended reduced model with every effect of the library, and as a body of the independent
    solver.
    """

    def __init__(self, name: str) -> None:
        self.radii, self.frequency = RADII[name], FREQUENCY[name]
        super().__init__("s11", "s12", "d31", "eps33T")
        constants, free = self.constants, self.free
        band = (float(self.frequency[0]), float(self.frequency[-1]))
        self.context = EffectContext(
            165e3, free.names, constants, AXES, DENSITY, THICKNESS, 1e3, radii=self.radii, band_Hz=band
        )
        self.library = {effect.key: effect for effect in library(self.context)}
        outline = catalogue.disk(12e-3, THICKNESS) if name == "disk" else catalogue.ring(12e-3, 5e-3, THICKNESS)
        model = ElectroelasticModel(outline.domain_for(1e-5, band[1], 1900.0), DENSITY)
        training = [constants, *free.training_sets(free.start, 0.04, 3)[1:]]
        self.model = extend_model(model, training, list(self.library.values()), band[1], accuracy=1e-5)
        self.evaluation = Evaluation(self.model, 2 * np.pi * self.frequency)

    def body(self, **changes) -> RoundBody:
        return RoundBody(self.radii, THICKNESS, DENSITY, 14 if self.radii[0] == 0 else 13, **changes)

    def exact(self, body: RoundBody, *surfaces: RoundSurface) -> np.ndarray:
        """Z (k,) of a body with surfaces by the independent solver."""
        return Plate(body, self.theta, self.frequency[-1], surfaces).impedance(self.theta, self.frequency)


@pytest.fixture(scope="module")
def bodies() -> dict[str, Round]:
    return {name: Round(name) for name in RADII}


@pytest.fixture(scope="module")
def bare(bodies) -> dict[str, np.ndarray]:
    return {name: one.exact(one.body()) for name, one in bodies.items()}


def mass(one: Round) -> np.ndarray:
    return one.exact(one.body(), RoundSurface.patch(4.2e-3, 1e-3, (1,), lambda w: -(w**2) * 4e-6))


def mass_at_the_rim(one: Round) -> np.ndarray:
    return one.exact(one.body(), RoundSurface.patch(5e-3, 0.8e-3, (1,), lambda w: -(w**2) * 2e-6))


def support(one: Round) -> np.ndarray:
    return one.exact(one.body(), RoundSurface.circle(5.4e-3, (1, -1), lambda w: 3e6 + 6j * w))


def three_points(one: Round, stiffness: float = 5e5) -> np.ndarray:
    patches = RoundSurface.tripod(4.9e-3, 0.8e-3, (1,), lambda w: stiffness * (1 + 2e-6j * w))
    return one.exact(one.body(), patches)


def stiff_points(one: Round) -> np.ndarray:
    """Three points, each with a fifteenth of the stiffness of the face under it."""
    return three_points(one, 1e7)


def unequal_films(one: Round) -> np.ndarray:
    x, y, weights = one.body().quadrature
    both = [np.concatenate([part, sign * part]) for part, sign in ((x, 1), (y, -1), (weights / 2, 1))]
    sides = [RoundSurface(*both, (side,), lambda w, side=side: -(w**2) * side * 0.3) for side in (1, -1)]
    return one.exact(one.body(), *sides)


def gradient(one: Round) -> np.ndarray:
    inner, outer = one.radii
    middle = (1 + (inner / outer) ** 2) / 2
    profiles = {"e": lambda x, y: 1 + 0.2 * ((x**2 + y**2) / outer**2 - middle)}
    return one.exact(one.body(profiles=profiles))


def depoled(one: Round, reach: float = 0.25e-3) -> np.ndarray:
    def left(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Share of e that is left."""
        rims = [rim for rim in one.radii if rim > 0]
        return np.prod([-np.expm1(-np.abs(np.hypot(x, y) - rim) / reach) for rim in rims], axis=0)

    return one.exact(one.body(profiles={"e": left}))


def wedge(one: Round) -> np.ndarray:
    return one.exact(one.body(wedge=0.1))


def oval(one: Round) -> np.ndarray:
    return one.exact(one.body(oval=np.expm1(0.005)))


def long_oval(one: Round) -> np.ndarray:
    return one.exact(one.body(oval=np.expm1(0.01)))


def soft_spot(one: Round, place: float = 4.2e-3) -> np.ndarray:
    return one.exact(
        one.body(profiles={"c": lambda x, y: 1 - 0.4 * np.exp(-((x - place) ** 2 + y**2) / SPOT_RADIUS**2)})
    )


def soft_spot_near_the_rim(one: Round) -> np.ndarray:
    return soft_spot(one, 5.2e-3)


#: Case → parameters of the effect, function that gives Z with it, and the error allowed as a share of the change (rms).
CASES = {
    "point_mass": ((4e-6, 4.2e-3, 1e-3), mass, 0.02),
    "point_mass, rim": ((2e-6, 5e-3, 0.8e-3), mass_at_the_rim, 0.02),
    "poling_gradient": ((0.2,), gradient, 0.02),
    "mounting/circle": ((3e6, 6.0, 5.4e-3), support, 0.02),
    "mounting/three points": ((5e5, 1.0, 4.9e-3, 0.8e-3), three_points, 0.02),
    "mounting/three points, stiff": ((1e7, 20.0, 4.9e-3, 0.8e-3), stiff_points, 0.02),
    "unequal_electrode_mass": ((0.6,), unequal_films, 0.03),
    "local_crack": ((soft_volume(THICKNESS, 0.4, SPOT_RADIUS), 4.2e-3, np.sqrt(2) * SPOT_RADIUS), soft_spot, 0.06),
    "local_crack, rim": (
        (soft_volume(THICKNESS, 0.4, SPOT_RADIUS), 5.2e-3, np.sqrt(2) * SPOT_RADIUS),
        soft_spot_near_the_rim,
        0.1,
    ),
    "edge_depoling": ((0.25e-3,), depoled, 0.03),
    "wedge": ((0.1,), wedge, 0.04),
    "ovality": ((0.005,), oval, 0.02),
    "ovality, long": ((0.01,), long_oval, 0.03),
}


#: Cases for which the inner rim matters: tested on a ring as well, where the others are slow tests.
TWO_RIMS = ("edge_depoling", "unequal_electrode_mass")
#: Further sizes and places of a cause, which are slow tests on both bodies.
FURTHER = ("point_mass, rim", "local_crack, rim", "ovality, long")


@pytest.mark.parametrize(
    ("case", "name"),
    [
        pytest.param(
            case, name, marks=[pytest.mark.slow] * (case in FURTHER or (name == "ring" and case not in TWO_RIMS))
        )
        for case in CASES
        for name in RADII
    ],
)
def test_change_of_impedance_against_independent_solution(bodies, bare, name, case):
    """The change has to be more than 100 times the mesh error."""
    (values, change, share), key, round_body = CASES[case], case.partition(",")[0], bodies[name]
    exact = np.log(change(round_body) / bare[name])
    by_law, mesh = (
        np.log(round_body.impedance(key, values) / round_body.impedance()),
        np.log(round_body.impedance() / bare[name]),
    )
    error, size, floor = (np.sqrt(np.mean(np.abs(part) ** 2)) for part in (by_law - exact, exact, mesh))
    assert size > 100 * floor
    print(f"{name} {case}: {error / size:.4f}")
    assert error < share * size, f"{error / size:.4f}"


@pytest.mark.slow
@pytest.mark.parametrize(("distance", "misled"), [(3.6e-3, True), (5e-3, False)])
def test_stiff_points_are_sought_again_with_the_constants_found(bodies, distance, misled):
    """A fit without the support finds wrong constants, which may mislead the first start.

    Starts at the other sites with the constants of the first fit lead to the right place.
    """
    ring, stiffness = bodies["ring"], 2e7
    z = ring.exact(ring.body(), RoundSurface.tripod(distance, 0.8e-3, (1,), lambda w: stiffness * (1 + 2e-6j * w)))
    noise = 1 + 1e-3 * np.random.default_rng(1).standard_normal(z.size)
    data = SweepData(ring.frequency, z * noise, np.full(z.size, 1e-3), True)
    effect = ring.library["mounting/three points"]
    base = fit(ring.evaluation, data, ring.unknowns, [ring.x * 1.01])
    first = starts(ring.evaluation, base, effect)
    columns, parameters = first[0].columns_of(effect), first[0].linear.parameters
    found = fit(ring.evaluation, data, parameters, [first[0].x], gain=COARSE)
    assert (found.chi_square > 10 * found.residual.size) == misled
    again = [start.x for start in relocated(ring.evaluation, found, effect)]
    better = fit(ring.evaluation, data, parameters, [found.x, *again], gain=RANKED)
    assert better.chi_square < 2 * better.residual.size
    values = better.x[columns] * effect.scale
    np.testing.assert_allclose(values[[0, 2]], (stiffness, distance), rtol=0.03)
    damped = found.x.copy()
    damped[columns.start + 1] = 0.3
    elsewhere = [start.x[columns] for start in relocated(ring.evaluation, replace(found, x=damped), effect)]
    assert all(
        np.array_equal(x[:2], damped[columns][:2]) for x in elsewhere
    )  # sizes as in the first fit, each at another place
    assert len({x[2] for x in elsewhere}) == len(elsewhere)


def test_a_size_of_either_sign_is_fitted_from_both_sides(bodies, bare):
    """Of the starts on either side of zero the nearest one is taken.

    The draw "disk:poling_gradient" 450000 of tests/hidden_effects/test_study.py needs both.
    """
    disk = bodies["disk"]
    data = SweepData(disk.frequency, bare["disk"], np.full(disk.frequency.size, 1e-3), True)
    base = fit(disk.evaluation, data, disk.unknowns, [disk.x], gain=COARSE)
    first = starts(disk.evaluation, base, disk.library["poling_gradient"])
    sides = [start.x[start.columns_of(start.cause)] * start.cause.scale for start in of_either_sign(first)]
    np.testing.assert_allclose(np.ravel(sides), [-0.1, 0.1])
    for key in (
        "edge_depoling",
        "temperature_drift",
        "point_mass",
    ):  # a size of one sign; a single start; an effect at a place
        assert of_either_sign(starts(disk.evaluation, base, disk.library[key])) == []


@pytest.mark.parametrize(("share", "place"), [(1e-3, 5.3e-3), (5e-4, 2.5e-3)])
def test_predicted_gain_of_a_small_mass_is_that_of_a_fit(bodies, share, place):
    """To 80 %. Constants absorb most of what a mass changes, so the size at which it is linearised matters.

    At four times the mass of the first case linearisation predicts only 29 of the 1429 that χ² falls.
    """
    disk = bodies["disk"]
    added = share * disk.context.mass
    z = disk.exact(disk.body(), RoundSurface.patch(place, 0.5e-3, (1,), lambda w: -(w**2) * added))
    noise = 1 + 3e-4 * np.random.default_rng(2).standard_normal(z.size)
    data = SweepData(disk.frequency, z * noise, np.full(z.size, 3e-4), True)
    effect = disk.library["point_mass"]
    base = fit(disk.evaluation, data, disk.unknowns, [disk.x])
    first = starts(disk.evaluation, base, effect)[0]
    true = np.append(base.x, (added, place, 0.5e-3) / effect.scale)
    gained = base.chi_square - fit(disk.evaluation, data, first.linear.parameters, [true]).chi_square
    assert gained > 500
    assert base.chi_square - first.promised_chi_square > 0.8 * gained


@pytest.mark.parametrize("key", ["wedge", "ovality"])
def test_slopes_of_a_deformation_against_differences(bodies, key):
    disk, step = bodies["disk"], 1e-3
    effect = disk.library[key]
    unknowns, size = disk.unknowns.with_candidate(effect), 2.0  # in units of the effect's scale
    near = [disk.evaluation.impedance(unknowns, np.append(disk.x, size + way * step)) for way in (-1, 1)]
    slopes = disk.evaluation.with_jacobian(unknowns, np.append(disk.x, size))[1][:, -1]
    difference = (near[1] - near[0]) / (2 * step)
    assert np.max(np.abs(slopes - difference)) < 1e-5 * np.max(np.abs(difference))


@pytest.mark.parametrize("name", ["disk", pytest.param("ring", marks=pytest.mark.slow)])
def test_bare_rims_against_a_full_solution(bodies, name):
    """The law, which frees the potential on a strip of the reduced body, against elements graded to the electrode's
    end.
    """
    round_body, margin = bodies[name], 0.3e-3
    frequency = round_body.frequency[::12]
    make = (
        (lambda **o: catalogue.disk(12e-3, THICKNESS, **o))
        if name == "disk"
        else (lambda **o: catalogue.ring(12e-3, 5e-3, THICKNESS, **o))
    )
    solved = []
    for electrodes, accuracy in ((Electrodes(margin=margin), 1e-4), (Electrodes(), 1e-6)):
        model = ElectroelasticModel(make(electrodes=electrodes).domain_for(accuracy, frequency[-1], 1900.0), DENSITY)
        solved.append(full_impedance(model, PiezoConstants.from_vector(round_body.theta).to_e_form(), frequency))
    exact = np.log(solved[0] / solved[1])
    by_law = np.log(round_body.impedance("electrode_margin", (margin,)) / round_body.impedance())[::12]
    error, size = (np.sqrt(np.mean(np.abs(part) ** 2)) for part in (by_law - exact, exact))
    print(f"{name}: {error / size:.4f}")
    assert error < 0.02 * size


def off_the_middle(name: str, margin: float, asymmetry: float) -> Domain:
    """A quarter of a disk or ring with its electrode shifted along x, with elements graded to the ends of the
    electrode.

    margin : bare strip at each rim, m; asymmetry : shift of the electrode over the margin
    """
    inner, outer = RADII[name]

    def towards(end: float, edge: float) -> np.ndarray:
        """Radii (6,) from the edge of the electrode to `end`, finer at the edge."""
        return edge + (end - edge) * np.array([0.0, 0.03, 0.1, 0.3, 0.6, 1.0])

    middle = (inner + outer) / 2 if inner else 0.0
    ends = np.concatenate([towards(outer, outer - margin), towards(middle, outer - margin)])
    if inner:
        ends = np.concatenate([ends, towards(inner, inner + margin), towards(middle, inner + margin)])
    else:
        ends = np.append(ends[ends > 0], PINHOLE * outer)
    across = np.unique(np.round(ends, 12))
    edges = np.array([inner + margin, outer - margin]) if inner else np.array([0.0, outer - margin])
    plane = polar_plane(across, np.linspace(0, np.pi, 7))
    near = 1e-9 * outer

    def hot(x: np.ndarray) -> np.ndarray:
        r = np.hypot(x[0], x[1])
        return (np.abs(x[2] - THICKNESS / 2) < near) & (r > edges[0] - near) & (r < edges[1] + near)

    labels = {"hot": hot, "mirror_z": lambda x: np.abs(x[2]) < near, "mirror_y": lambda x: np.abs(x[1]) < near}

    def moved(points: np.ndarray) -> np.ndarray:
        """Points shifted with the electrode inside its ends, and less and less towards the rims, which stay."""
        r = np.hypot(*points)
        share = np.minimum((outer - r) / margin, 1.0)
        if inner:
            share = np.minimum(share, (r - inner) / margin)
        return points + np.array([asymmetry * margin * share, 0 * r])

    shifted = replace(plane, p=moved(plane.p), middles=moved(plane.middles.reshape(2, -1)).reshape(plane.middles.shape))
    heights = THICKNESS / 2 * np.array([0.0, 0.6, 0.92, 1.0])
    names = labelled(extruded(plane, heights), labels).boundaries
    return Domain(
        mesh=extruded(shifted, heights).with_boundaries(names),
        hot=("hot",),
        ground=("mirror_z",),
        symmetry={"mirror_z": 2, "mirror_y": 1},
        copies=4,
        voltage_factor=2.0,
        order=3,
    )


@pytest.fixture(scope="module", params=RADII)
def shifted(request, bodies) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Relative error that the law states for an asymmetry, and three changes of log Z (k,).

    The change that the asymmetry adds by the law, and by a full solution with graded elements; and the change by the
    whole margin.
    """
    round_body, margin, asymmetry = bodies[request.param], 0.3e-3, 0.6
    frequency, constants = round_body.frequency[::12], PiezoConstants.from_vector(round_body.theta).to_e_form()
    solved = [
        full_impedance(ElectroelasticModel(off_the_middle(request.param, margin, a), DENSITY), constants, frequency)
        for a in (asymmetry, 0.0)
    ]
    bare, even, uneven = (
        round_body.impedance(*key)[::12]
        for key in ((), ("electrode_margin", (margin,)), ("electrode_margin", (margin, asymmetry)))
    )
    misses = round_body.library["electrode_margin"].parameters[1].law_error
    return misses, np.log(uneven / even), np.log(solved[0] / solved[1]), np.log(even / bare)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.abs(values) ** 2)))


@pytest.mark.slow
def test_an_electrode_off_the_middle_has_the_right_shape(shifted):
    """The change is proportional to a²: the asymmetry a that fits best is right within the law's stated error, and
    10 % of the change remain.
    """
    misses, found, exact, whole = shifted
    share = np.sqrt(np.vdot(found, exact).real / np.vdot(found, found).real)
    print(f"a times {share:.4f} leaves {rms(share**2 * found - exact) / rms(exact):.4f}")
    assert rms(exact) > 0.1 * rms(whole)
    assert abs(share - 1) < misses
    assert rms(share**2 * found - exact) < 0.1 * rms(exact)


@pytest.mark.slow
def test_an_electrode_off_the_middle_against_a_full_solution(shifted, request):
    """The error stays below 5 % of the change by the whole margin.

    Relative to the change by the asymmetry, 40 % are allowed for a disk and 10 % for a ring.
    """
    _, found, exact, whole = shifted
    error, size, of_margin = rms(found - exact), rms(exact), rms(whole)
    print(f"{error / size:.4f}, {error / of_margin:.4f}")
    assert size > 0.1 * of_margin
    assert error < {"disk": 0.4, "ring": 0.1}[request.node.callspec.params["shifted"]] * size
    assert error < 0.05 * of_margin


def test_modes_of_another_order_may_be_off_by_the_square_of_a_wedge(bodies):
    """The stated error of log Z by detuned modes, against differences of a dense system.

    There the inertia of the modes of the other Fourier order is divided by (1 + δ)²; each band has an error of its own.
    """
    disk, noise, size, omega = bodies["disk"], 1e-3, 0.1, 2 * np.pi * FREQUENCY["disk"]
    effect = disk.library["wedge"]
    data = SweepData(disk.frequency, disk.impedance("wedge", (size,)), np.full(omega.size, noise), True)
    unknowns, x = disk.unknowns.with_candidate(effect), np.append(disk.x, size / effect.scale)
    model = disk.evaluation.model.restricted(effect.sectors)
    terms = effect.local(model.places, omega, np.array([size]))
    e_form, u = PiezoConstants.from_vector(disk.theta).to_e_form().vector(), model.displacements
    body = np.tensordot(e_form, model.bulk, axes=1)
    joined = sum(e_form[term.constant] * term.value[0] * term.matrix for term in terms if term.kind == "stiffness")
    mass = model.mass + sum(term.value[0] * term.matrix for term in terms if term.kind == "inertia")
    across = np.isin(model.member, [model.sectors.index(name) for name in effect.sectors])[:u]

    def log_z(off: float) -> np.ndarray:
        inertia = mass / np.where(np.outer(across, across), (1 + off) ** 2, 1.0)
        system = body + joined - omega[:, None, None] ** 2 * np.pad(inertia, (0, len(body) - u))
        charge = 1 / np.linalg.inv(system)[:, -1, -1]
        return -np.log(charge)

    at_x = data.whitened(*disk.evaluation.with_jacobian(unknowns, x))[1]
    step, missed = 1e-4, law_misses(disk.evaluation, data, unknowns, x, at_x)
    slope = (log_z(step) - log_z(-step)) / (2 * step)
    expected = effect.parameters[0].law_detuning * size**2 * stacked(data.over_noise(slope))
    assert np.max(np.abs(expected)) > 0.1
    detuned = missed[:, -len(data.bands()) :]
    np.testing.assert_allclose(detuned.sum(axis=1), expected, atol=1e-3 * np.max(np.abs(expected)))
    assert np.all(np.count_nonzero(detuned, axis=1) <= 1)


@pytest.mark.slow
def test_errors_of_the_law_of_a_wedge_are_no_further_cause(bodies):
    """Modes of order 1 lie slightly off their frequencies, which leaves a misfit above the noise.

    With the law's stated errors no other cause is named for it; with a law taken as exact, another cause has a
    probability above 0.5.
    """
    disk, noise, size = bodies["disk"], 1e-3, 0.185
    z = noisy(disk.exact(disk.body(wedge=size)), noise, 5)
    data = SweepData(disk.frequency, z, np.full(z.size, noise), True)
    offered = [disk.library[key] for key in ("wedge", "mounting/circle", "point_mass")]
    found = compare(disk.evaluation, data, disk.unknowns, disk.x, offered)
    assert [item.effect.key for item in found.causes] == ["wedge"]
    final = found.final
    assert final.residual @ final.residual > 1.5 * final.residual.size
    assert final.marginal.residual @ final.marginal.residual < 1.2 * final.residual.size
    assert abs(final.parameters.values(final.x)[0][0] - size) < 3 * final.std_of_effects[0][0]
    sure = {"law_error": 0.0, "law_detuning": 0.0}
    trusted = [replace(e, parameters=tuple(replace(p, **sure) for p in e.parameters)) for e in offered]
    believed = compare(disk.evaluation, data, disk.unknowns, disk.x, trusted)

    def beside(which: Comparison) -> float:
        """Probability of the most probable candidate other than the wedge."""
        return max(chance for title, chance in which.probabilities.items() if title != "wedge")

    assert beside(found) < 0.1 and beside(believed) > 0.5
