"""The independent solver of the hidden data against other solvers, formulas for bars, and limits."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar
from scipy.special import j1, y1

from hidden_effects.body import Surface
from hidden_effects.build import Build, Grading
from hidden_effects.draws import DENSITY, PZT5H, draw
from hidden_effects.reduced import Plate
from hidden_effects.ritz import RitzPlate
from hidden_effects.spectral import Axis, joined
from tests.variants import variants

#: A slender plate, nearly a bar, for which 1-D formulas hold to 1 %, and its constants with low losses.
BAR, LOW = np.array([12e-3, 1.0e-3, 0.5e-3]), PZT5H * (1 - 2e-4j)
FUNDAMENTAL = float(1 / (2 * BAR[0] * np.sqrt(DENSITY * PZT5H[0])))
PLATE, LOSSY = np.array([12e-3, 6.9e-3, 1.6e-3]), PZT5H * (1 - 0.015j)
SWEEP = np.concatenate([np.linspace(20e3, 130e3, 12), np.linspace(180e3, 240e3, 25)])


def bar(**changes) -> Build:
    return Build(BAR.copy(), DENSITY, LOW, FUNDAMENTAL, **changes)


def plate(**changes) -> Build:
    return Build(PLATE.copy(), DENSITY, LOSSY, 140e3, **changes)


def resonance(build: Build, near: float, width: float = 0.02) -> tuple[float, float]:
    """Frequency (Hz) and height (S) of the largest conductance within `width` of a frequency near it."""
    model = Plate(build.body(), build.theta, 1.2 * near, build.surfaces)
    grid = near * np.linspace(1 - width, 1 + width, 81)
    top = grid[np.argmax((1 / model.impedance(build.theta, grid)).real)]
    step = grid[1] - grid[0]
    best = minimize_scalar(
        lambda f: -(1 / model.impedance(build.theta, np.array([f])))[0].real,
        bounds=(top - step, top + step),
        method="bounded",
        options={"xatol": 1e-7 * top},
    )
    return float(best.x), float(-best.fun)


def spot(x: float, y: float, side: float, mass: float) -> Surface:
    """A mass on a square patch of the upper face about (x, y)."""
    return Surface((x - side / 2, x + side / 2), (y - side / 2, y + side / 2), (1,), lambda w: -(w**2) * mass / side**2)


def test_ritz_with_global_polynomials_gives_the_same():
    """Against another basis with a full solution at every frequency, with a film of mass on both faces: 5e-5 in Z, a
    tenth of the lowest noise drawn.
    """
    film = Surface(*plate().whole_face, (1, -1), lambda w: -(w**2) * 0.1)
    found = plate(surfaces=[film]).impedance(SWEEP[::3])
    by_ritz = RitzPlate(PLATE, DENSITY, (17, 14, 8), film=0.1).impedance(LOSSY, SWEEP[::3])
    assert np.max(np.abs(found / by_ritz - 1)) < 5e-5


@pytest.mark.parametrize("what", ["law", "gradient", "mass", "film on one face"])
def test_reduced_basis_against_the_full_solution(what):
    """All unknowns of the same body: within 5e-6 in Z."""
    build = plate()
    if what == "gradient":
        build.piezoelectric.append(lambda x: 1 + 0.3 * x / 6e-3)
    if what == "mass":
        build.surfaces.append(spot(2e-3, 1e-3, 2e-3, 2e-6))
    if what == "film on one face":
        build.surfaces.append(Surface(*build.whole_face, (1,), lambda w: -(w**2) * 0.1))
    sweep = np.array([30e3, 95e3, 141e3, 190e3, 228e3])
    theta = (lambda f: LOSSY.real + 1j * LOSSY.imag * (f / 140e3) ** 0.8) if what == "law" else LOSSY
    body = build.body()
    if what in ("mass", "film on one face"):  # of low order, so that the full solution is small
        low = tuple(Axis(axis.breaks, (p,)) for axis, p in zip(body.axes, (8, 5, 3), strict=True))
        body = replace(body, axes=low, potential_axes=low)
    found = Plate(body, LOSSY, 240e3, build.surfaces).impedance(theta, sweep)
    full = Plate(body, LOSSY, 240e3, build.surfaces, cutoff=None)
    if what == "law":  # solved with the constants of each frequency, without interpolation
        other = np.array([full.impedance(theta(f), np.array([f]))[0] for f in sweep])
    else:
        other = full.impedance(theta, sweep)
    assert np.max(np.abs(found / other - 1)) < 5e-6


def test_parity_classes_together_are_the_whole_plate():
    """A spot of mass couples eight classes of a plate with parity in x, or four of one without."""
    masses = [spot(2e-3, 1e-3, 2e-3, 2e-6)]
    sweep = np.array([60e3, 140e3, 215e3])
    body = plate(surfaces=masses).body()
    low = tuple(Axis(axis.breaks, (p,)) for axis, p in zip(body.axes, (9, 6, 4), strict=True))
    models = [
        Plate(replace(body, axes=low, potential_axes=low, symmetric=symmetric), LOSSY, 240e3, masses)
        for symmetric in (True, False)
    ]
    with_parity, without_parity = (model.impedance(LOSSY, sweep) for model in models)
    assert np.max(np.abs(with_parity / without_parity - 1)) < 5e-6
    bare = Plate(replace(body, axes=low, potential_axes=low), LOSSY, 240e3).impedance(LOSSY, sweep)
    assert np.max(np.abs(with_parity / bare - 1)) > 1e-3


@pytest.mark.slow
def test_small_mass_lowers_the_resonance_as_rayleigh_says():
    """δf/f = −(m/M) sin²(πx/L) of the fundamental."""
    plain = resonance(bar(), FUNDAMENTAL)[0]
    mass = 1e-4 * DENSITY * np.prod(BAR)
    for x in (2e-3, 5e-3):
        heavy = resonance(bar(surfaces=[spot(x, 0.1e-3, 0.6e-3, mass)]), FUNDAMENTAL)[0]
        assert heavy / plain - 1 == pytest.approx(-1e-4 * np.sin(np.pi * x / BAR[0]) ** 2, rel=0.03)


@pytest.mark.slow
def test_crack_lowers_the_resonance_by_its_added_length():
    """δf/f = −(a/L) cos²(πx/L), a the added length: the compliance counts where the stress is."""
    plain = resonance(bar(), FUNDAMENTAL)[0]
    width, depth = 0.2e-3, 0.05
    added = width * depth / (1 - depth)
    for x in (0.5e-3, 3e-3):
        slit = bar(elements=[x - width / 2, x + width / 2])
        slit.stiffness.append(lambda s, x=x: 1 - depth * (np.abs(s - x) < width / 2))
        shift = resonance(slit, FUNDAMENTAL)[0] / plain - 1
        assert shift == pytest.approx(-added / BAR[0] * np.cos(np.pi * x / BAR[0]) ** 2, rel=0.03)


def test_gradient_drives_the_second_length_mode():
    """For e (1 + g 2x/L) its charge is g times that of the first mode, so its conductance is g²/2 of that of the
    first.
    """
    g = 0.2
    graded = bar(piezoelectric=[lambda x: 1 + g * 2 * x / BAR[0]])
    first, high = resonance(graded, FUNDAMENTAL)
    second, low = resonance(graded, 2 * first)
    assert second == pytest.approx(2 * first, rel=5e-3)
    assert low / high == pytest.approx(g**2 / 2, rel=0.03)


def test_margin_without_coupling_has_the_capacitance_of_the_conformal_map():
    """C = ε33 w (L − 2m + 2δ)/t, where δ = (ln 2/π) t √(ε11/ε33) is the field beyond the edges of the electrodes.

    Without coupling the error of φ at the edges, 2.3e-4, is not cancelled by that of the displacements (`_GRADING`); it
    vanishes with finer elements of φ.
    """
    build, frequency = bar(margins=(1.5e-3, 1.5e-3)), np.array([1e3])
    build.theta = LOW.copy()
    build.theta[5:8] = 0
    body, (length, width, thickness) = build.body(), BAR
    beyond = np.log(2) / np.pi * thickness * np.sqrt(PZT5H[8] / PZT5H[9])
    exact = PZT5H[9] * width * (length - 3e-3 + 2 * beyond) / thickness
    fine = _graded(build, (0.004e-3, 0.02e-3, 0.1e-3), 4)
    for one, error in ((body, 3e-4), (replace(body, potential_axes=fine), 6e-5)):
        impedance = Plate(one, build.theta, 1e4).impedance(build.theta, frequency)
        assert (1 / impedance / (2j * np.pi * frequency))[0].real == pytest.approx(exact, rel=error, abs=0)


def _graded(build: Build, distances: tuple[float, ...], degree: int) -> tuple[Axis, Axis, Axis]:
    """Elements graded to the edges of the electrodes along x and z, of low order along y, where fields do not vary."""
    along, across, half = build.size / 2
    depth = joined((-half, half), *((d - half, half - d) for d in distances))
    orders = tuple(6 if a < 0 < b else degree for a, b in pairwise(depth))
    ends = build._margined(np.array([-along, along]), Grading(distances, degree, (2, 6)))
    return ends, Axis((-across, across), (2,)), Axis(tuple(depth), orders)


@pytest.mark.slow
def test_margin_converges():
    """Against elements graded down to 0.02 mm (u) and 0.008 mm (φ) in both directions: 2e-4 in Z, so 2e-6 in
    resonances.

    The order along y is low, since the field at the edge does not vary along it.
    """
    build, sweep = plate(margins=(0.4e-3, 0.4e-3)), SWEEP[::4]
    body = build.body()
    standard, potential = (
        (axes[0], Axis((-3.45e-3, 3.45e-3), (2,)), axes[2]) for axes in (body.axes, body.potential_axes)
    )
    fine = _graded(build, (0.02e-3, 0.1e-3, 0.3e-3), 3), _graded(build, (0.008e-3, 0.05e-3, 0.25e-3), 4)
    found, better = (
        Plate(replace(body, axes=a, potential_axes=p), LOSSY, 240e3).impedance(LOSSY, sweep)
        for a, p in ((standard, potential), fine)
    )
    assert np.max(np.abs(found / better - 1)) < 2e-4


def test_margin_vanishes():
    """Margins that go to zero give the whole plate: Z changes by less than 0.1 % for 2 µm and more than 1 % for 0.4
    mm.
    """
    whole = plate().impedance(SWEEP)
    small, large = (np.abs(plate(margins=(m, m)).impedance(SWEEP) / whole - 1).max() for m in (2e-6, 4e-4))
    assert small < 1e-3 < 1e-2 < large


@pytest.mark.slow
@pytest.mark.parametrize("what", ["spot", "slice"])
def test_spot_and_slice_converge(what):
    """Orders below those of the draws change Z by less than 1e-4, for a spot of mass and for a slice of softer
    material.
    """
    build, lower = plate(surfaces=[spot(2.8e-3, 1.7e-3, 2e-3, 2e-6)]), ((14,), (10,), (5,))
    if what == "slice":
        build = plate(elements=[2e-3, 2.2e-3], stiffness=[lambda x: 1 - 0.2 * ((x > 2e-3) & (x < 2.2e-3))])
        lower = (tuple(p - 1 for p in build.body().axes[0].degrees), (9,), (5,))
    body = build.body()
    axes = tuple(Axis(axis.breaks, p) for axis, p in zip(body.axes, lower, strict=True))
    coarse = Plate(replace(body, axes=axes, potential_axes=axes), LOSSY, 240e3, build.surfaces)
    sweep = SWEEP[::4]
    assert np.max(np.abs(coarse.impedance(LOSSY, sweep) / build.impedance(sweep) - 1)) < 1e-4


def test_bar_poled_along_its_length_is_the_k33_bar():
    """Y = jωC (1 − k²)/(1 − k² tan X/X), X = ωL/2 √(ρ s33D), IEEE 176: pole and zero of a slender bar within 3e-3."""
    build = bar(poling=0)
    s33, d33, eps33 = PZT5H[3], PZT5H[6], PZT5H[9]
    coupling = d33**2 / (s33 * eps33)
    velocity = 1 / np.sqrt(DENSITY * s33 * (1 - coupling))
    antiresonance = velocity / (2 * BAR[0])
    ratio = brentq(lambda r: 1 - coupling * np.tan(np.pi * r / 2) / (np.pi * r / 2), 0.5, 0.999)
    assert resonance(build, ratio * antiresonance)[0] == pytest.approx(ratio * antiresonance, rel=3e-3)
    sweep = antiresonance * np.linspace(0.99, 1.01, 201)
    highest = sweep[np.argmax(build.impedance(sweep).real)]
    assert highest == pytest.approx(antiresonance, rel=3e-3)
    low = np.array([2e3])
    capacitance = (1 / build.impedance(low) / (2j * np.pi * low))[0].real
    assert capacitance == pytest.approx(eps33 * BAR[1] * BAR[2] / BAR[0], rel=2e-3, abs=0)


def test_membrane_stiffens_as_a_parallel_spring():
    """δf/f = E h s11/(2t) for a thin layer with the bar's Poisson ratio and without mass."""
    nu = float(-PZT5H[1] / PZT5H[0])
    stiff = 1e-3 * BAR[2] / PZT5H[0] / (1 - nu**2)
    layer = Surface(*bar().whole_face, (-1,), lambda w: stiff * np.ones_like(w), membrane=nu)
    shift = resonance(bar(surfaces=[layer]), FUNDAMENTAL)[0] / resonance(bar(), FUNDAMENTAL)[0] - 1
    assert shift == pytest.approx(5e-4, rel=0.03)


def test_tapered_bar_resonates_as_bessel_says():
    """(A u')' + k² A u = 0, A ∝ r between r1 and r2 = r1 + L: J1(k r1) Y1(k r2) = J1(k r2) Y1(k r1)."""
    taper, length = 0.5, BAR[0]
    near = length * (1 - taper) / (2 * taper)
    k = brentq(
        lambda k: j1(k * near) * y1(k * (near + length)) - j1(k * (near + length)) * y1(k * near),
        0.9 * np.pi / length,
        1.3 * np.pi / length,
    )
    ratio = resonance(bar(taper=taper), FUNDAMENTAL * k * length / np.pi)[0] / resonance(bar(), FUNDAMENTAL)[0]
    assert ratio == pytest.approx(k * length / np.pi, rel=1e-3)
    assert ratio > 1.005


@pytest.mark.parametrize(
    "effect",
    variants(
        ["mounting", "electrode_margin", "poling_gradient", "leakage"], slow=["electrode_margin", "poling_gradient"]
    ),
)
def test_draws_are_passive_and_keep_their_key(effect):
    """Re Z > 0 over the sweep; the file does not mention the effect; the same seed gives the same draw; the effect
    changes Z by more than the noise.
    """
    hidden = draw(effect, 3, points=41, variant=False)
    assert np.all(hidden.clean.real > 0)
    assert not any(word in hidden.specification for word in (effect, *hidden.key[0].sizes))
    again = draw(effect, 3, points=41, variant=False)
    np.testing.assert_array_equal(hidden.impedance, again.impedance)
    plain = Build(hidden.build.size, DENSITY, hidden.theta, hidden.build.fundamental).impedance(hidden.frequency)
    assert np.max(np.abs(plain / hidden.clean - 1)) > hidden.noise
