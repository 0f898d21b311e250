"""Every effect: Z against an independent Ritz solution or a closed formula, the Jacobian against differences, and
limits.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hidden_effects.body import Surface
from hidden_effects.build import Build
from hidden_effects.ritz import RitzPlate

from diagnosis.conftest import BAND, DENSITY, FREQUENCY, FUNDAMENTAL, SIZE
from femu_piezo.effects.effect import Effect, EffectContext
from femu_piezo.effects.extended_model import Needs
from femu_piezo.effects.library import from_table
from femu_piezo.effects.library.losses import partner
from femu_piezo.errors import InputError
from femu_piezo.forward.modal import diagonalise
from femu_piezo.inference import response
from femu_piezo.inference.free_constants import FreeConstants
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.unknowns import MaterialParameters, Unknowns, material_prior
from femu_piezo.material.constants import D_FORM, PiezoConstants

OMEGA = 2 * np.pi * FREQUENCY
ORDERS = (13, 10, 5)
#: Effect → parameters at which it is tested, SI; of a held constant the error of its value, or of value and tangent.
SIZES = {
    "series_resistance": 3.0,
    "series_inductance": (5e-6, 2e-7),
    "stray_capacitance": (20e-12, 0.05),
    "leakage": 2e-5,
    "contact_gap": (1 / 20e-9, 6e3),
    "cable": (1.5, 75.0, 0.3),
    "relaxation": (0.05, 90e3, 0.35),
    "dielectric_dispersion": (0.03, 0.4),
    "frequency_dependent_elastic_loss": (0.7, -0.3),
    "frequency_dependent_elastic_loss/causal": -0.6,
    "wrong_insensitive_parameter:s12": 0.06,
    "wrong_insensitive_parameter:s13": (0.04, 0.03),
    "temperature_drift": 0.004,
    "wrong_density": -0.02,
    "wrong_length": 0.012,
    "wrong_width": -0.012,
    "wrong_thickness": 0.015,
    "electrode_mass": 0.15,
    "film_stiffness": (1.2e6, 0.06, 4e-8),
    "fluid_load": (20.0, 5e4, 0.02),
}
#: Effects that depend on a place in the body → all their parameters, SI.
PLACED = {
    "point_mass": (2.5e-6, 4.1e-3, 1.9e-3, 0.5e-3),
    "local_crack": (0.15e-3, 2.3e-3, 0.2e-3),
    "poling_gradient": (0.25, 0.04),
    "mounting": (1e6, 4.0, 0.8e-3),
    "electrode_margin": (0.25e-3,),
    "tapered_width": (0.03,),
    "wedge": (0.05,),
    "edge_depoling": (0.12e-3,),
    "unequal_electrode_mass": (0.6,),
    "uneven_body": (0.03, 0.02, -0.05, 0.04, 0.1, 0.06),
}
#: Effects that other test files compare with an independent solution → their parameters, SI.
APART = {"electrode_resistance": (3.0, 2e-3), "sweep_too_fast": 2e4, "drive_level": (4e-3, 0.5)}


def evaluate(setup, key: str, size: float | np.ndarray):
    """Z (k,) and ∂Z/∂x with one effect at the given parameters."""
    return setup.evaluation.with_jacobian(*setup.with_effects({key: size}))


def test_circuits_and_effects_of_size_zero_use_the_diagonalised_bare_body(setup, monkeypatch):
    """The bare body is diagonalised once for both, also for their slopes.

    Other constants, and effects on the body of a size other than zero, need a diagonalisation of their own.
    """
    made = []

    def counted(*given):
        made.append(1)
        return diagonalise(*given)

    monkeypatch.setattr(response, "diagonalise", counted)
    plain_unknowns, x = setup.with_effects({})
    x = x * (1 + 1e-7)  # constants that no earlier test has evaluated, so that nothing is kept for them
    plain = setup.evaluation.impedance(plain_unknowns, x)
    assert len(made) == 1
    for key, size in {"series_resistance": 3.0, "electrode_mass": 0.0, "wrong_density": 0.0}.items():
        unknowns, at = setup.with_effects({key: size})
        at[: x.size] = x
        z, slopes = setup.evaluation.with_jacobian(unknowns, at)
        assert len(made) == 1, key
        if not size:
            np.testing.assert_allclose(z, plain, rtol=1e-12)
        moved = at.copy()
        moved[-1] += 1e-3
        change = setup.evaluation.impedance(unknowns, moved) - z
        assert np.max(np.abs(change - 1e-3 * slopes[:, -1])) < 0.02 * np.max(np.abs(change)), key
        made[1:] = []
        setup.evaluation.impedance(plain_unknowns, x)
    for unknowns, at in (setup.with_effects({"electrode_mass": 0.1}), (plain_unknowns, x * (1 + 1e-6))):
        count = len(made)
        setup.evaluation.impedance(unknowns, at)
        assert len(made) == count + 1


@pytest.mark.parametrize(("drift", "error"), [(0.004, 1e-7), (-0.015, 1e-5)])
def test_drift_is_that_of_constants_at_every_frequency(setup, drift, error):
    """Z of a drift, by a few values of d, against a solution with the constants of each frequency."""
    z = setup.evaluation.impedance(*setup.with_effects({"temperature_drift": drift}))
    free = FreeConstants.of(PiezoConstants.from_vector(setup.theta), D_FORM)
    material = MaterialParameters.around(free, free.start)
    unknowns, compliance = Unknowns(material, material_prior(free, {}, {})), np.arange(10) < 5
    for k, f in enumerate(FREQUENCY):
        w = 1 + drift * (f - FUNDAMENTAL) / (BAND[1] - BAND[0])
        here = replace(setup.evaluation, omega=setup.evaluation.omega[[k]])
        x = material.x_of(free.start / np.where(compliance, w**2, 1))
        assert z[k] == pytest.approx(here.impedance(unknowns, x)[0], rel=error)


@pytest.fixture(scope="module")
def bare():
    """A function that gives Z of the plate without further effects by the independent Ritz model."""

    def solve(theta, size=SIZE, film=0.0, density=DENSITY):
        return RitzPlate(size, density, ORDERS, film).impedance(theta, FREQUENCY)

    return solve


def reference(key: str, size: float, theta: np.ndarray, bare) -> np.ndarray:
    """Z with the effect, without any code of femu_piezo."""
    if key.startswith("wrong_"):
        name = key.removeprefix("wrong_")
        if ":" in name:
            error, tangent = np.append(size, 0.0)[:2]
            wave_impedance = np.array(D_FORM) == name.partition(":")[2]
            return bare(np.where(wave_impedance, theta * (1 + error) * (1 - 1j * tangent), theta))
        if name == "density":
            return bare(theta, density=DENSITY * (1 + size))
        grown = np.array(SIZE)
        grown[("length", "width", "thickness").index(name)] *= 1 + size
        return bare(theta, size=grown)
    if key == "temperature_drift":
        low, high = BAND

        def warmed(f):
            return theta / np.where(np.arange(10) < 5, 1 + size * (f - FUNDAMENTAL) / (high - low), 1.0) ** 2

        return bare(warmed)
    if key in ("film_stiffness", "fluid_load"):
        built, faces = Build(np.array(SIZE), DENSITY, theta, FUNDAMENTAL), (1, -1)
        if key == "film_stiffness":
            stiff, loss, square_slowness = size
            built.surfaces = [
                Surface(*built.whole_face, faces, lambda w: stiff * (1 + 1j * loss) + 0 * w, membrane=0.35),
                Surface(*built.whole_face, faces, lambda w: -(w**2) * stiff * square_slowness),
            ]
        else:
            shear, wave, heavy = size
            built.surfaces = [
                Surface(*built.whole_face, faces, lambda w: 1j * w * (1 + 1j) * np.sqrt(w / 2) * shear, (0, 1)),
                Surface(*built.whole_face, faces, lambda w: 1j * w * wave - w**2 * heavy, (2,)),
            ]
        return built.impedance(FREQUENCY)
    if key == "electrode_mass":
        return bare(theta, film=size)
    if key == "dielectric_dispersion":
        fall, change = size

        def fallen(f):
            decades = np.log10(f / FUNDAMENTAL)
            return theta * (1 - fall * decades * (1 + change * decades) * (np.arange(10) == 9))

        return bare(fallen)
    if key.startswith("frequency"):
        elastic = np.arange(10) < 5

        def law(f):
            ratio = f / FUNDAMENTAL
            real = theta.real.copy()
            if key.endswith("causal"):
                shift = (ratio**size - 1) / np.tan(size * np.pi / 2) - 2 / np.pi * np.log(ratio)
                real = real + elastic * theta.imag * shift
                return real + 1j * theta.imag * np.where(elastic, ratio**size, 1.0)
            return real + 1j * theta.imag * np.where(elastic, ratio ** (size[0] + size[1] * np.log(ratio)), 1.0)

        return bare(law)
    if key == "relaxation":
        strength, centre, width = size

        def cole(f):
            return 1 / (1 + (1j * f / centre) ** (1 - width))

        return bare(lambda f: theta * (1 + strength * (cole(f) - cole(FUNDAMENTAL).real) * (np.arange(10) == 9)))
    z = bare(theta)
    if key == "cable":
        length, wave_impedance, resistance = size
        series = resistance + 1j * OMEGA * wave_impedance / (0.66 * 299792458)  # per metre
        shunt = 1j * OMEGA / wave_impedance / (0.66 * 299792458)
        own, turned = np.sqrt(series / shunt), np.tanh(np.sqrt(series * shunt) * length)
        return own * (z + own * turned) / (own + z * turned)
    if key == "contact_gap":
        inverse, corner = size
        capacitance, conductance = 1 / inverse, 2 * np.pi * corner / inverse
        return z + 1 / (1j * OMEGA * capacitance + conductance)
    if key == "series_inductance":
        inductance, time_constant = size
        return z + 1 / (1 / (1j * OMEGA * inductance) + time_constant / inductance)  # parallel to a resistor
    if key == "stray_capacitance":
        capacitance, tangent = size
        return 1 / (1 / z + 1j * OMEGA * capacitance + OMEGA * capacitance * tangent)
    return {"series_resistance": z + size, "leakage": 1 / (1 / z + size)}[key]


@pytest.mark.parametrize("key", SIZES)
def test_impedance_against_independent_solution(setup, bare, key):
    """Z within 1.5e-3 everywhere (the mesh error at the upper resonances), and the change by the effect within 1 %
    in rms.
    """
    z, _ = evaluate(setup, key, SIZES[key])
    rest = setup.evaluation.impedance(setup.unknowns, setup.x)
    exact = reference(key, SIZES[key], setup.theta, bare)
    effect_size = np.abs(np.log(exact / bare(setup.theta)))
    error = np.abs(np.log(z / exact))
    # error of the change of log Z by the effect: the mesh error of the bare plate cancels
    change = np.abs(np.log(z / rest) - np.log(exact / bare(setup.theta)))
    assert np.max(error) < 1.5e-3
    assert np.sqrt(np.mean(change**2)) < 0.01 * np.sqrt(np.mean(effect_size**2))


def test_every_jacobian_against_richardson_differences(setup):
    """Along a random direction in all unknowns, every effect of the library alone: within 1e-5 of the largest slope."""
    rng = np.random.default_rng(5)
    for key, effect in setup.library.items():
        values = np.atleast_1d({**PLACED, **SIZES, **APART}.get(key, 0.05))
        values = np.append(values, 0.8 * effect.scale[values.size :])
        parameters, x = setup.with_effects({key: values})
        x[: setup.x.size] *= 1 + 0.01 * rng.standard_normal(setup.x.size)
        direction = np.append(0.1 * rng.standard_normal(setup.x.size), 0.3 * rng.uniform(0.5, 1.0, values.size))
        z, tangents = setup.evaluation.with_jacobian(parameters, x)

        def along(t, parameters=parameters, x=x, direction=direction):
            return setup.evaluation.impedance(parameters, x + t * direction)

        h = 1e-4
        numeric = (8 * (along(h) - along(-h)) - along(2 * h) + along(-2 * h)) / (12 * h)
        slope = tangents @ direction
        assert np.max(np.abs((slope - numeric) / z)) < 1e-5 * np.max(np.abs(slope / z)), key


def test_effects_vanish_at_rest(setup):
    """Every effect at its rest values leaves Z unchanged."""
    rest = setup.evaluation.impedance(setup.unknowns, setup.x)
    for key, effect in setup.library.items():
        z, _ = evaluate(setup, key, effect.rest)
        # sectors of an effect enlarge the basis, which changes Z within the accuracy of the reduction
        np.testing.assert_allclose(z, rest, rtol=1e-5 if effect.sectors else 2e-7, err_msg=key)


def test_effects_compose(setup):
    """A stretch, a dispersion, a wrong constant and two circuits together: Z and Jacobian."""
    names = ("wrong_width", "dielectric_dispersion", "wrong_insensitive_parameter:s13", "leakage", "series_resistance")
    parameters, x = setup.with_effects({name: 0.5 * setup.library[name].scale for name in names})
    z, tangents = setup.evaluation.with_jacobian(parameters, x)
    inner = replace(parameters, effects=parameters.effects[:3], candidates=parameters.candidates[:3])
    bare = setup.evaluation.impedance(inner, x[:-2])
    g, r = (0.5 * setup.library[name].scale[0] for name in names[3:])
    np.testing.assert_allclose(z, 1 / (1 / bare + g) + r, rtol=1e-10)
    for column in range(x.size):
        step = np.zeros(x.size)
        step[column] = 1e-4
        numeric = (
            setup.evaluation.impedance(parameters, x + step) - setup.evaluation.impedance(parameters, x - step)
        ) / 2e-4
        assert np.max(np.abs((tangents[:, column] - numeric) / z)) < 1e-4 * np.max(np.abs(tangents[:, column] / z))


def test_a_trial_step_may_make_the_mass_indefinite(setup):
    """A film of negative mass: closed forms against a solution at every frequency, which a dispersive effect makes
    necessary.
    """
    film, law = setup.library["electrode_mass"], setup.library["dielectric_dispersion"]
    for size in (-0.3, -3.0, -30.0):
        parameters, x = setup.with_effects({film.key: size})
        z, tangents = setup.evaluation.with_jacobian(parameters, x)
        exact, slopes = setup.evaluation.with_jacobian(parameters.with_candidate(law), np.append(x, [0.0, 0.0]))
        np.testing.assert_allclose(z, exact, rtol=1e-7)
        np.testing.assert_allclose(tangents, slopes[:, :-2], rtol=1e-6, atol=1e-7 * np.abs(slopes).max())


def test_terms_of_one_name_have_one_matrix(setup):
    """A further effect with its own `film` would change that of electrode_mass; with another name it needs a model of
    its own, and so does one whose matrix was changed.
    """
    film, membrane = setup.library["electrode_mass"], setup.library["film_stiffness"]
    assert len(Needs.of([film, membrane]).terms) == 2
    (term,) = film.terms

    def mine(name: str, scale: float) -> Effect:
        own = replace(term, name=name, on_electrodes=None, matrix=lambda model: scale * term.of(model))
        return replace(film, name="mine", terms=(own,))

    with pytest.raises(InputError, match="electrode_mass and mine have different terms of the name 'film'"):
        Needs.of([film, mine("film", 2.0)])
    once, changed = mine("solder", 1.0), mine("solder", 2.0)
    assert Needs.of([film, once]) == Needs.of([film, once]) != Needs.of([film, changed])


def test_strata_sum_to_the_bulk_matrices(setup):
    """Parts of equal exponents under stretching (strata) add up to the matrix of each e-form constant."""
    for q in range(10):
        total = setup.model.strata[setup.model.constant_of_stratum == q].sum(axis=0)
        assert np.max(np.abs(total - setup.model.bulk[q])) < 1e-9 * np.max(np.abs(setup.model.bulk[q]))


def test_partner_of_a_loss_law_is_kramers_kronig():
    """Real and imaginary part of (jω)^n have the ratio cot(nπ/2); near n = 0 the series continues the formula, with
    its slope.
    """
    logs = np.linspace(-2.0, 1.0, 7)
    for n in (0.3, -0.5):
        causal = (1j * np.exp(logs)) ** n
        ratio = causal.real / causal.imag * np.exp(n * logs) - 1 / np.tan(n * np.pi / 2)
        np.testing.assert_allclose(partner(n, logs)[0], ratio - 2 / np.pi * logs, atol=1e-12)
    for n in (9.99e-4, 1.001e-3):
        exact = (np.exp(n * logs) - 1) / np.tan(n * np.pi / 2) - 2 / np.pi * logs
        np.testing.assert_allclose(partner(n, logs)[0], exact, atol=1e-8)
        difference = (partner(n + 1e-6, logs)[0] - partner(n - 1e-6, logs)[0]) / 2e-6
        np.testing.assert_allclose(partner(n, logs)[1], difference, atol=2e-3)


def test_table_of_effects_is_read_with_units_and_refused_in_one_sentence(setup):
    """Names, parameters and units of [effects], and wrong tables."""
    context = EffectContext(
        FUNDAMENTAL, ("s11",), setup.material.constants(setup.x), {"length": (0,)}, DENSITY, SIZE[2], 2e3
    )
    table = {"series_resistance": {"resistance": "2 ohm"}, "wrong_insensitive_parameter": {"s12": 0.02, "s13": -0.01}}
    found = {effect.key: values[0] for effect, values in from_table(table, context, "plate.toml")}
    assert found == {
        "series_resistance": 2.0,
        "wrong_insensitive_parameter:s12": 0.02,
        "wrong_insensitive_parameter:s13": -0.01,
    }
    whole = replace(context, dimensions=SIZE)
    ((effect, values),) = from_table({"point_mass": {"mass": "1 mg", "x": "4 mm", "y": 0.002}}, whole, "plate.toml")
    assert values.tolist() == [1e-6, 4e-3, 2e-3, effect.parameters[3].rest]
    for wrong, words in (
        ({"point_mass": {"x": 0.004, "y": 0.002}}, "point_mass"),
        ({"ghost": {"a": 1.0}}, "ghost"),
        ({"leakage": {"resistance": 1.0}}, "conductance"),
        ({"leakage": {}}, "conductance"),
        ({"wrong_width": {"relative_error": 0.01}}, "wrong_width"),
    ):
        with pytest.raises(InputError, match=words):
            from_table(wrong, replace(context), "plate.toml")


def test_large_systems_are_solved_on_states_at_a_few_frequencies(setup, monkeypatch):
    """Where coefficients depend on ω, against solutions at every frequency (_SAMPLES infinite): Z to 1e-8, slopes to
    1e-5 of their largest.
    """
    parameters, x = setup.with_effects(
        {"frequency_dependent_elastic_loss": 0.5, "point_mass": (2.5e-6, 4.1e-3, 1.9e-3, 0.45e-3)}
    )
    dense = Evaluation(setup.model, 2 * np.pi * np.linspace(20e3, 225e3, 201))
    sampled = dense.with_jacobian(parameters, x)
    monkeypatch.setattr("femu_piezo.inference.response._SAMPLES", np.inf)
    exact = dense.with_jacobian(parameters, x)
    assert 0 < np.max(np.abs(sampled[0] / exact[0] - 1)) < 1e-8
    assert np.max(np.abs(sampled[1] - exact[1]) / np.max(np.abs(exact[1]), axis=0)) < 1e-5
