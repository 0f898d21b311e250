"""`simulate`: poles and zeros of a specimen with effects are those of its own curve."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from femu_piezo.errors import InputError
from femu_piezo.forward.reduction import reduce_model
from femu_piezo.measurement.rational_curve import RationalCurve
from femu_piezo.specimen.file import read_specimen
from femu_piezo.study.effects import body_as_simulated, effects_as_simulated
from femu_piezo.study.modes import modes
from femu_piezo.study.problem import prepare
from femu_piezo.study.simulate import simulate
from tests.commands import invoked, succeeded

PLATE = """
[geometry]
shape = "plate"
length = "40 mm"
width = "5 mm"
thickness = "1 mm"
density = "7900 kg/m^3"
poling = "thickness"
[material]
base = "pzt-5h"
tan_s11 = 0.015
tan_eps33T = 0.016
[simulation]
start = "1 kHz"
stop = "{stop}"
points = 101
[update]
accuracy = 1e-3
"""


def specimen(folder: Path, tail: str = "", stop: str = "120 kHz"):
    (folder / "plate.toml").write_text(PLATE.format(stop=stop) + tail, encoding="utf-8")
    return read_specimen(folder / "plate.toml")


def eigenvalues(resonances) -> np.ndarray:
    return np.array([resonance.eigenvalue for resonance in resonances])


@pytest.fixture(scope="module")
def body(tmp_path_factory):
    """The modal model of the plate without effects on the mesh of `simulate`, and the result of `simulate`."""
    one = specimen(tmp_path_factory.mktemp("bare"))
    problem = prepare(one)
    model = problem.model(problem.equivalent_frequency(120e3, 1e-3), 1e-3)
    reduced = reduce_model(model, [problem.constants], 120e3, accuracy=1e-6)
    return reduced.modal(problem.constants.to_e_form()), simulate(one)


def test_a_curve_shows_the_poles_and_zeros_behind_it(body):
    """Poles and zeros found from a curve are those of the modal model to 1e-10."""
    modal, result = body
    frequency = np.linspace(1e3, 130e3, 801)
    curve = RationalCurve(frequency, modal.impedance(2 * np.pi * frequency))
    poles, zeros = curve.resonances("pole", 120e3), curve.resonances("zero", 120e3)
    assert len(poles) == len(zeros) == 2
    assert eigenvalues(poles) == pytest.approx(eigenvalues(result.poles), rel=1e-10)
    assert eigenvalues(zeros) == pytest.approx(eigenvalues(result.zeros), rel=1e-10)


def test_residues_are_those_of_the_modes(body):
    """Those of the sums over modes, and limits of Y (s − p) and Z (s − p)."""
    modal, result = body
    frequency = np.linspace(1e3, 130e3, 801)
    curve = RationalCurve(frequency, modal.impedance(2 * np.pi * frequency))
    for kind, of_modes in (("pole", result.poles), ("zero", result.zeros)):
        for one, known in zip(curve.resonances(kind, 120e3), of_modes, strict=True):
            assert one.residue == pytest.approx(known.residue, rel=1e-6)
            at = np.sqrt(one.eigenvalue)
            near = at * (1 + 1e-6)
            value = (modal.admittance if kind == "pole" else modal.impedance)(np.array([near]))[0]
            assert value * 1j * (near - at) == pytest.approx(one.residue, rel=1e-3)


def test_a_leakage_has_no_resonance(body):
    """It is no function of ω²: what follows it has poles below the curve, which do not count."""
    modal, result = body
    frequency = np.linspace(1e3, 130e3, 801)
    admittance = 1 / modal.impedance(2 * np.pi * frequency) + 1e-6
    poles = RationalCurve(frequency, 1 / admittance).resonances("pole", 120e3)
    assert eigenvalues(poles) == pytest.approx(eigenvalues(result.poles), rel=1e-7)


def test_a_series_resistance_moves_the_poles_alone(body, tmp_path):
    """At the poles of Y = 1/(Z + R) the plate has Z = −R; the zeros stay."""
    modal, bare = body
    result = simulate(specimen(tmp_path, '[effects.series_resistance]\nresistance = "100 ohm"\n'))
    at = np.sqrt(eigenvalues(result.poles))
    assert modal.impedance(at) == pytest.approx(-100, rel=1e-4)
    assert np.all(np.abs(at**2 / eigenvalues(bare.poles) - 1) > 1e-3)
    assert eigenvalues(result.zeros) == pytest.approx(eigenvalues(bare.zeros), rel=1e-6)


def test_a_stray_capacitance_moves_the_zeros_alone(body, tmp_path):
    """At the zeros the plate has Y = −jωC; the poles stay."""
    modal, bare = body
    result = simulate(specimen(tmp_path, '[effects.stray_capacitance]\ncapacitance = "500 pF"\n'))
    at = np.sqrt(eigenvalues(result.zeros))
    assert 1 / modal.impedance(at) == pytest.approx(-1j * at * 500e-12, rel=1e-4)
    assert np.all(np.abs(at**2 / eigenvalues(bare.zeros) - 1) > 1e-3)
    assert eigenvalues(result.poles) == pytest.approx(eigenvalues(bare.poles), rel=1e-6)


def test_a_leakage_moves_the_zeros_alone(body, tmp_path):
    """At the zeros the plate has Y = −G; the poles stay."""
    modal, bare = body
    result = simulate(specimen(tmp_path, '[effects.leakage]\nconductance = "1 uS"\n'))
    assert eigenvalues(result.poles) == pytest.approx(eigenvalues(bare.poles), rel=1e-6)
    at = np.sqrt(eigenvalues(result.zeros))
    assert 1 / modal.impedance(at) == pytest.approx(-1e-6, rel=1e-3)


def test_a_longer_plate_has_the_poles_of_a_longer_plate(tmp_path):
    """wrong_length of 2 % against a plate meshed 2 % longer."""
    stretched = simulate(specimen(tmp_path, "[effects.wrong_length]\nrelative_error = 0.02\n"))
    longer = specimen(tmp_path)
    longer = longer.model_copy(update={"geometry": longer.geometry.model_copy(update={"length": 40.8e-3})})
    meshed = simulate(longer)
    assert eigenvalues(stretched.poles) == pytest.approx(eigenvalues(meshed.poles), rel=1e-4)
    assert eigenvalues(stretched.zeros) == pytest.approx(eigenvalues(meshed.zeros), rel=1e-4)


@pytest.mark.parametrize(
    "table", ["drive_level]\nsoftening = 0.003", "sweep_too_fast]\nrate = 1e4", "temperature_drift]\ndrift = 0.003"]
)
def test_poles_and_zeros_are_those_without_effects_of_how_the_sweep_was_taken(body, tmp_path, table):
    """Under them the curve is no rational function: it had a dozen poles about one, half of them with negative loss."""
    _, bare = body
    result = simulate(specimen(tmp_path, f"[effects.{table}\n"))
    assert eigenvalues(result.poles) == pytest.approx(eigenvalues(bare.poles), rel=1e-7)
    assert eigenvalues(result.zeros) == pytest.approx(eigenvalues(bare.zeros), rel=1e-7)
    assert np.max(np.abs(result.spectrum.impedance / bare.spectrum.impedance - 1)) > 1e-5
    name = table.partition("]")[0]
    assert result.effects == result.of_sweep_alone == (name,)
    assert f"the sweep includes {name};" in " ".join(result.notes)


def test_the_command_says_whose_poles_it_prints(tmp_path):
    specimen(tmp_path, '[effects.series_resistance]\nresistance = "100 ohm"\n')
    answer = succeeded("simulate", tmp_path / "plate.toml", "--out", tmp_path / "out")
    assert "with its effects (series_resistance)" in answer.output
    record = json.loads((tmp_path / "out/simulation.json").read_text(encoding="utf-8"))
    assert record["effects"] == ["series_resistance"] and len(record["poles"]) == 2


def test_the_fitted_body_is_simulated(tmp_path):
    """[fitted] without [effects]: a length 2 % off and another s11, against a file with these values."""
    tables = "[fitted.wrong_length]\nrelative_error = 0.02\n[fitted.material]\ns11 = 17e-12\n"
    fitted = simulate(specimen(tmp_path, tables))
    meshed = simulate(with_fitted_values(specimen(tmp_path)))
    assert eigenvalues(fitted.poles) == pytest.approx(eigenvalues(meshed.poles), rel=1e-4)
    assert eigenvalues(fitted.zeros) == pytest.approx(eigenvalues(meshed.zeros), rel=1e-4)
    assert fitted.effects == ()


def with_fitted_values(one):
    """The specimen with a length of 40.8 mm and s11 of 17e-12 in its file."""
    geometry = one.geometry.model_copy(update={"length": 40.8e-3})
    return one.model_copy(update={"geometry": geometry, "material": one.material.model_copy(update={"s11": 17e-12})})


@pytest.mark.parametrize("kind", ["effects", "fitted"])
def test_modes_are_those_of_the_body_as_it_is(tmp_path, kind):
    """Length, density, a held and a free constant move the modes; a lead does not, which a note says."""
    tail = f"[{kind}.wrong_length]\nrelative_error = 0.02\n[{kind}.wrong_density]\nrelative_error = 0.01\n"
    tail += f"[{kind}.wrong_insensitive_parameter]\ns12 = 0.05\n[fitted.material]\ns11 = 17e-12\n"
    one = specimen(tmp_path, tail + '[effects.series_resistance]\nresistance = "100 ohm"\n')
    found, other = modes(one, band=(0, 120e3)), with_fitted_values(one)
    geometry = other.geometry.model_copy(update={"density": 7979.0})
    s12 = 1.05 * prepare(one).constants.s12.real
    material = other.material.model_copy(update={"s12": s12})
    bare = {"geometry": geometry, "material": material, "effects": None, "fitted": None}
    wanted = modes(other.model_copy(update=bare), band=(0, 120e3))
    assert len(found.modes) == len(wanted.modes) == 2
    for a, b in zip(found.modes, wanted.modes, strict=True):
        assert a.pole.eigenvalue == pytest.approx(b.pole.eigenvalue, rel=1e-9)
        assert a.zero.eigenvalue == pytest.approx(b.zero.eigenvalue, rel=1e-9)
    assert found.notes == ("plate: the modes are those of the body without series_resistance",)
    assert wanted.notes == ()


def test_a_larger_disk_of_a_given_mass_is_lighter(tmp_path):
    """Both radii of a ring scale with its diameter, and so does the density of a weighed one: it has the volume and
    density of the larger ring.
    """
    (tmp_path / "ring.toml").write_text(
        '[geometry]\nshape = "ring"\ndiameter = "20 mm"\ninner_diameter = "8 mm"\nthickness = "1 mm"\nmass = "2 g"\n'
        '[material]\nbase = "pzt-5h"\n[fitted.wrong_diameter]\nrelative_error = 0.02\n'
    )
    one = read_specimen(tmp_path / "ring.toml")
    problem = prepare(one)
    body, _ = body_as_simulated(problem, effects_as_simulated(problem, np.array([1e3, 1e5])))
    sizes = {"diameter": 20.4e-3, "inner_diameter": 8.16e-3}
    larger = prepare(one.model_copy(update={"geometry": one.geometry.model_copy(update=sizes)}))
    assert body.plate.volume == pytest.approx(larger.plate.volume, rel=1e-12, abs=0)
    assert body.density == pytest.approx(larger.density, rel=1e-12)


@pytest.mark.parametrize("dimension", ["length", "width", "thickness"])
def test_a_trapezoid_has_wrong_dimensions_as_well(tmp_path, dimension):
    """Stretched by 2 %: curve and modes of a trapezoid meshed with that dimension; both widths scale together."""
    sizes = {"length": 20e-3, "width": 6e-3, "width_end": 4e-3, "thickness": 2e-3}

    def simulated(sizes, tail=""):
        geometry = "".join(f"{name} = {size!r}\n" for name, size in sizes.items())
        text = f'[geometry]\nshape = "trapezoid"\n{geometry}[material]\nbase = "pzt-5h"\n'
        (tmp_path / "body.toml").write_text(text + '[simulation]\nstop = "120 kHz"\npoints = 301\n' + tail)
        return simulate(read_specimen(tmp_path / "body.toml"))

    larger = {name: size * (1.02 if name.startswith(dimension) else 1) for name, size in sizes.items()}
    meshed, before = simulated(larger), simulated(sizes)
    stretched = simulated(sizes, f"[effects.wrong_{dimension}]\nrelative_error = 0.02\n")
    low = before.spectrum.frequency < 60e3  # the first pole is at 71 kHz
    wanted, start, found = (one.spectrum.impedance[low] for one in (meshed, before, stretched))
    assert np.max(np.abs(wanted / start - 1)) > 0.015
    np.testing.assert_allclose(found, wanted, rtol=1e-4)
    for one, other in ((meshed.poles, stretched.poles), (meshed.zeros, stretched.zeros)):
        assert len(one) > 0
        np.testing.assert_allclose(eigenvalues(one), eigenvalues(other), rtol=1e-4)
    body, _ = body_as_simulated(
        prepare(stretched.specimen), effects_as_simulated(prepare(stretched.specimen), np.array([1e3, 1e5]))
    )
    assert body.plate.volume == pytest.approx(prepare(meshed.specimen).plate.volume, rel=1e-12, abs=0)


@pytest.mark.parametrize(
    ("tail", "told"),
    [
        ("[fitted.material]\ns66 = 1e-12\n", "fitted.material.s66 is not a constant; known are s11"),
        ('[fitted.material]\ns11 = "17e-12"\n', 'fitted.material.s11 = "17e-12" is not a number'),
        ("[fitted.material]\ns11 = -17e-12\n", "fitted.material: s11 = -1.7e-11 must be positive"),
        ("[fitted.ghost]\nsize = 1\n", "fitted.ghost is no effect"),
        ("[fitted.wrong_length]\nrelative_error = 0.2\n", "fitted.wrong_length.relative_error = 0.2 is outside"),
        (
            "[effects.leakage]\nconductance = 1e-6\nfree = ['resistance']\n",
            '.free = ["resistance"] is no list of parameters of its table, such as ["conductance"]',
        ),
        ("[effects.leakage]\nconductance = 1e-6\nfree = 'conductance'\n", "is no list of parameters of its table"),
        ("[effects.leakage]\nconductance = 1e-6\nfree = 1.0\n", "is no list of parameters of its table"),
        ("[effects.leakage]\nconductance = 1e-6\nfree = true\n", "effects.leakage.free = True cannot be used"),
        ("[effects.leakage]\nfree = ['conductance']\n", "is no list of parameters of its table"),
    ],
)
def test_wrong_tables_of_a_fit_are_told_in_one_sentence(tmp_path, tail, told):
    (tmp_path / "plate.toml").write_text(PLATE.format(stop="120 kHz") + tail, encoding="utf-8")
    for command in ("simulate", "modes"):
        answer = invoked(command, tmp_path / "plate.toml", "--out", tmp_path / "out")
        assert answer.exit_code == 2 and told in answer.output, answer.output
        assert answer.output.strip().count("\n") == 0


def test_full_order_knows_no_fit(tmp_path):
    with pytest.raises(InputError, match=r"cannot include \[effects\] or \[fitted\]"):
        simulate(specimen(tmp_path, "[fitted.wrong_length]\nrelative_error = 0.02\n"), full_order=True)
