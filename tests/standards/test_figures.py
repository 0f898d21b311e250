"""Standard figures of exact solutions whose constants are known, and the errors of the formulas for real plates.

The curves are the closed forms of the literature, written here: bars (IEEE 176-1987, 6.4), the thin disk (Mason 1948),
the thickness plate. Their constants are recovered within 1e-4; a loss of 1e-3 changes fs by 1e-6 at most.
"""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from rich.console import Console
from scipy.optimize import bisect
from scipy.special import jv

import femu_piezo as fp
from femu_piezo.extraction import extract
from femu_piezo.extraction.roots import fundamental
from femu_piezo.geometry.shapes import Plate
from femu_piezo.material.library import library_material
from femu_piezo.measurement.readers import write_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.output.tables import deviation_percent, extraction_table
from femu_piezo.specimen.file import CONSTANTS, Simulation
from femu_piezo.standards.figures import read_curve, standard_figures
from femu_piezo.standards.frequencies import characteristic_frequencies
from femu_piezo.standards.piece import Piece, material_figures
from femu_piezo.study.problem import prepare
from femu_piezo.study.simulate import simulate as study_simulate
from femu_piezo.study.standard_figures import pieces_of
from tests import k31_bar
from tests.commands import invoked
from tests.noise import noisy

TAN = 1 - 1e-3j
RHO = 7600.0
S11, S12, S33, S44 = 16e-12 * TAN, -5e-12 * TAN, 20e-12 * TAN, 43e-12 * TAN
D31, D33, D15 = -270e-12 * TAN, 590e-12 * TAN, 740e-12 * TAN
EPS33, EPS11 = 3e-8 * TAN, 2.7e-8 * TAN
LENGTH, AREA, GAP = 30e-3, 90e-6, 1e-3


def along(f, s, d, eps, size, area):
    """Y of a body driven along its motion (k33, shear): Z = l/(jω A ε^S) (1 − k² tan X/X), X = (ωl/2) sqrt(ρ s^D)."""
    k2 = d**2 / (s * eps)
    x = np.pi * f * size * np.sqrt(RHO * s * (1 - k2))
    return 2j * np.pi * f * area * eps * (1 - k2) / size / (1 - k2 * np.tan(x) / x)


def disk(f, radius=10e-3):
    sigma = -S12 / S11
    kp2 = 2 * D31**2 / ((S11 + S12) * EPS33)
    eta = 2 * np.pi * f * radius * np.sqrt(RHO * S11 * (1 - sigma**2))
    ratio = (1 + sigma) * jv(1, eta) / (eta * jv(0, eta) - (1 - sigma) * jv(1, eta))
    return 2j * np.pi * f * np.pi * radius**2 / GAP * EPS33 * (1 - kp2 + kp2 * ratio)


def ring(f, radius=8e-3):
    k2 = D31**2 / (S11 * EPS33)
    omega = 2 * np.pi * f
    resonance = 1 / (RHO * S11 * radius**2)
    return 1j * omega * AREA / GAP * EPS33 * (1 - k2 + k2 * resonance / (resonance - omega**2))


KP2 = (2 * D31**2 / ((S11 + S12) * EPS33)).real
K31, K33, K15 = (np.sqrt(abs(d**2 / (s * e))) for d, s, e in ((D31, S11, EPS33), (D33, S33, EPS33), (D15, S44, EPS11)))
COMMON = {"gap": GAP, "area": AREA, "density": RHO}
#: First root of η J0(η) = (1 − σ) J1(η) for σ = 0.3125, by bisection.
ETA = bisect(lambda eta: eta * jv(0, eta) - 0.6875 * jv(1, eta), 1.5, 2.4)
CASES = {
    "k31 bar": (
        Piece("k31 bar", LENGTH, **COMMON),
        lambda f: 1 / k31_bar.impedance(2 * np.pi * f, (LENGTH, AREA / LENGTH, GAP), RHO, S11, D31, EPS33),
        np.r_[np.linspace(800, 1200, 9), np.linspace(40e3, 60e3, 500)],
        {"k31": K31, "s11": 16e-12, "d31": -270e-12, "eps33T": 3e-8, "N1": 0.5 / np.sqrt(RHO * 16e-12)},
    ),
    "k33 bar": (
        Piece("k33 bar", 12e-3, gap=12e-3, area=4e-6, density=RHO),
        lambda f: along(f, S33, D33, EPS33, 12e-3, 4e-6),
        np.r_[np.linspace(800, 1200, 9), np.linspace(85e3, 190e3, 500)],
        {
            "k33": K33,
            "s33": 20e-12,
            "d33": 590e-12,
            "eps33T": 3e-8,
            "s33D": 20e-12 * (1 - K33**2),
            "N3": 0.5 / np.sqrt(RHO * 20e-12 * (1 - K33**2)),
        },
    ),
    "shear": (
        Piece("shear plate", GAP, **COMMON),
        lambda f: along(f, S44, D15, EPS11, GAP, AREA),
        np.r_[np.linspace(800, 1200, 9), np.linspace(700e3, 1.3e6, 500)],
        {
            "k15": K15,
            "s44": 43e-12,
            "d15": 740e-12,
            "eps11T": 2.7e-8,
            "c44D": 1 / (43e-12 * (1 - K15**2)),
            "N15": 0.5 / np.sqrt(RHO * 43e-12 * (1 - K15**2)),
        },
    ),
    "disk, two modes": (
        Piece("disk", 20e-3, gap=GAP, area=np.pi * 1e-4, density=RHO, poisson=0.2),  # σ is found: 0.3125
        disk,
        np.r_[np.linspace(800, 1200, 9), np.linspace(85e3, 320e3, 1500)],
        {
            "kp": np.sqrt(KP2),
            "s11": 16e-12,
            "d31": -270e-12,
            "eps33T": 3e-8,
            "poisson": 0.3125,
            "k31": K31,
            "Np": ETA / (np.pi * np.sqrt(RHO * 16e-12 * (1 - 0.3125**2))),
        },
    ),
    "ring": (
        Piece("ring", 16e-3, **COMMON),
        ring,
        np.r_[np.linspace(800, 1200, 9), np.linspace(45e3, 75e3, 500)],
        {"k31": K31, "s11": 16e-12, "d31": -270e-12, "eps33T": 3e-8, "N_ring": 1 / (np.pi * np.sqrt(RHO * 16e-12))},
    ),
}


def figures_of(piece, admittance, frequency):
    spectrum = ImpedanceSpectrum(frequency, 1 / admittance(frequency))
    found = extract(spectrum)
    pair = fundamental(found.pairs)
    second = next((one.pole for one in found.pairs if one.pole.frequency_Hz > 2 * pair.pole.frequency_Hz), None)
    points = (spectrum.frequency, spectrum.impedance)
    reading = read_curve(found.model.admittance, points, pair.pole, pair.zero, piece, second)
    return standard_figures(piece, reading, pair.pole, pair.zero)


@pytest.mark.parametrize("name", CASES)
def test_exact_bodies_give_their_constants_back(name):
    piece, admittance, frequency, truth = CASES[name]
    found = figures_of(piece, admittance, frequency)
    for key, value in truth.items():
        assert found[key].value == pytest.approx(value, rel=1e-4, abs=0), key
    assert found["Qm_pole"].value == pytest.approx(1000, rel=1e-4)
    assert found["tan_delta"].value == pytest.approx(1e-3, rel=1e-3)
    assert found.notes == ()


def test_thickness_mode_gives_stiffness_and_coupling():
    """Z = (1 − kt² tan X/X)/(jωC^S), X = (ωt/2) sqrt(ρ/c33D); the free capacitance lies below other modes."""
    kt2, c33_open, size = 0.26, 16e10 * (1 + 1e-3j), 1e-3

    def admittance(f):
        x = np.pi * f * size * np.sqrt(RHO / c33_open)
        return 2j * np.pi * f * 2e-9 / (1 - kt2 * np.tan(x) / x)

    piece = Piece("thickness plate", size, gap=size, area=1e-4, density=RHO)
    found = figures_of(piece, admittance, np.linspace(1.7e6, 2.9e6, 800))
    assert found["kt"].value == pytest.approx(np.sqrt(kt2), rel=1e-4)
    assert found["c33D"].value == pytest.approx(16e10, rel=1e-4)
    assert found["c33"].value == pytest.approx(16e10 * (1 - kt2), rel=1e-4)
    assert found["Nt"].value == pytest.approx(0.5 * np.sqrt(16e10 / RHO), rel=1e-4)
    with pytest.raises(KeyError):
        found["C_T"]
    assert found.notes == (
        "other modes lie below this one, and the sweep does not begin below them, so it gives no capacitance",
    )


@pytest.mark.parametrize("name", ["k31 bar", "k33 bar", "shear", "disk, two modes", "ring"])
def test_capacitance_from_frequencies_near_the_resonance(name):
    """Without low frequencies C^T follows from the formula of the body, which is exact here; a note says so."""
    piece, admittance, frequency, truth = CASES[name]
    found = figures_of(piece, admittance, frequency[9:])
    eps = "eps11T" if name == "shear" else "eps33T"
    assert found[eps].value == pytest.approx(truth[eps], rel=1e-4)
    assert "does not include 1 kHz" in found.notes[0]
    at_1kHz = admittance(np.array([1e3]))[0].imag / (2e3 * np.pi)
    assert found["C_T"].value == pytest.approx(at_1kHz, rel=1e-4, abs=0)


@pytest.mark.parametrize("sizes", [(24e-3, 3e-3, 0.5e-3), (24e-3, 10e-3, 1e-3), (3e-3, 3e-3, 15e-3)])
def test_a_body_has_one_kind_whichever_of_its_sizes_is_called_length(sizes):
    """Poled along the last of its sizes, be that called thickness or length."""
    long, wide, along = sizes
    constants = library_material("pzt-5h").constants
    first, second = (
        pieces_of(plate, constants, 7500.0) for plate in (Plate(long, wide, along), Plate(along, wide, long, "length"))
    )
    assert [piece.kind for piece, _ in first] == [piece.kind for piece, _ in second]
    for (one, expected), (other, frequency) in zip(first, second, strict=True):
        assert other.extent == pytest.approx(one.extent) and frequency == pytest.approx(expected)
        assert other.aspect == (one.aspect[0], pytest.approx(one.aspect[1]))


RING = """\
name = "ring"
[geometry]
shape = "ring"
diameter = "40 mm"
inner_diameter = "{inner} mm"
thickness = "1.5 mm"
density = "7600 kg/m^3"
[material]
base = "pzt-5h"
"""


def test_the_width_of_a_ring_is_that_of_its_wall(tmp_path):
    """Bent straight, a ring is a bar as wide as its wall: only a wall far wider than thick has a thickness mode."""
    kinds = {}
    for inner in (36, 14):
        (tmp_path / "ring.toml").write_text(RING.format(inner=inner), encoding="utf-8")
        problem = prepare(fp.read_specimen(tmp_path / "ring.toml"))
        pieces = [piece for piece, _ in pieces_of(problem.plate, problem.constants, problem.density)]
        kinds[inner] = {piece.kind: piece.aspect for piece in pieces}
    assert set(kinds[36]) == {"ring"}  # a wall of 2 x 1.5 mm
    assert kinds[14]["thickness plate"] == ("width/thickness", pytest.approx(13 / 1.5))


def circuit(f, c0=1e-9, c1=1e-10, resistance=40.0, fs=100e3):
    inductance = 1 / ((2 * np.pi * fs) ** 2 * c1)
    omega = 2 * np.pi * f
    return 1j * omega * c0 + 1 / (resistance + 1j * omega * inductance + 1 / (1j * omega * c1))


def test_six_frequencies_by_their_definitions():
    """For C0 with one branch: G is largest at 1/(2π sqrt(L1 C1)) exactly, the others are compared with a fine grid."""
    fs = 100e3
    inductance = 1 / ((2 * np.pi * fs) ** 2 * 1e-10)
    quality = 2 * np.pi * fs * inductance / 40.0
    pole = (2 * np.pi * fs) ** 2 * (1 + 1j / quality)
    zero = 1.1 * pole
    found = characteristic_frequencies(lambda w: circuit(w / (2 * np.pi)), pole, zero, (80e3, 130e3))
    assert found.fs == pytest.approx(fs, rel=1e-13)
    assert found.Q_series == pytest.approx(quality, rel=1e-5)
    assert found.Z_series == pytest.approx(np.abs(1 / circuit(np.array([found.fm]))[0]), rel=1e-12)
    grid = np.linspace(98e3, 108e3, 2_000_001)
    y = circuit(grid)
    low, high = grid < 102e3, grid > 102e3
    tops = {"fm": (low, np.abs(y)), "fp": (high, (1 / y).real), "fn": (high, np.abs(1 / y))}
    for name, (part, curve) in tops.items():
        assert getattr(found, name) == pytest.approx(grid[part][np.argmax(curve[part])], abs=0.02), name
    crossings = grid[:-1][np.diff(np.sign((1 / y).imag)) != 0]
    assert [found.fr, found.fa] == pytest.approx(crossings, abs=0.02)
    assert found.fm < found.fs < found.fr < found.fa < found.fp < found.fn


def test_quality_by_the_impedance_at_resonance_is_that_of_the_branch():
    """EN 50324-2: of C0 with a branch C1, R1, where fp²/fs² = 1 + C1/C0, the formula is 1/(2π fs R1 C1)."""
    frequency = np.r_[np.linspace(800, 1200, 9), np.linspace(90e3, 115e3, 400)]
    found = figures_of(Piece("other", 1.0, None, None, 1.0), circuit, frequency)
    assert found["Qm_Z"].value == pytest.approx(1 / (2e5 * np.pi * 40.0 * 1e-10), rel=1e-3)
    assert found["C_T"].value == pytest.approx(1.1e-9, rel=1e-4, abs=0)
    assert found["k_eff"].value == pytest.approx(np.sqrt(1 / 11), rel=1e-4)


def test_a_curve_that_never_crosses_zero_reactance_has_no_fr():
    """A figure of merit below 2: the capacitance outweighs the branch."""
    found = characteristic_frequencies(
        lambda w: circuit(w / (2 * np.pi), resistance=2e4),
        (2e5 * np.pi) ** 2 * (1 + 1.3j),
        4.4e11 * (1 + 1.3j),
        (8e4, 2e5),
    )
    assert found.fr is None and found.fa is None


def test_material_figures_are_those_of_ieee_176():
    """k33, kt, kp, c33D and c44D of a set of constants by the relations of IEEE 176-1987, section 3, from full
    matrices.
    """
    from femu_piezo.material.library import library_material

    pzt = library_material("pzt-5h").constants
    found = material_figures(pzt)
    s, d, eps = pzt.compliance().real, pzt.piezoelectric().real, pzt.permittivity().real
    open_stiffness = np.linalg.inv(s - d.T @ np.linalg.inv(eps) @ d)
    clamped = eps - d @ np.linalg.inv(s) @ d.T
    stiffness = np.linalg.inv(s)
    assert found["c33D"] == pytest.approx(open_stiffness[2, 2], rel=1e-9)
    assert found["kt"] == pytest.approx(np.sqrt(1 - stiffness[2, 2] / open_stiffness[2, 2]), rel=1e-9)
    assert found["k33"] == pytest.approx(d[2, 2] / np.sqrt(s[2, 2] * eps[2, 2]), rel=1e-9)
    assert found["kp"] == pytest.approx(np.sqrt(2 / (1 - found["poisson"])) * found["k31"], rel=1e-9)
    assert clamped[2, 2] > 0
    assert found["c44D"] == pytest.approx(open_stiffness[3, 3], rel=1e-9)


PLATE = """\
name = "plate"
[geometry]
shape = "plate"
length = "24 mm"
width = "{width}"
thickness = "0.5 mm"
density = "7600 kg/m^3"
poling = "thickness"
[material]
base = "pzt-5h"
""" + "".join(f"tan_{name} = 0.002\n" for name in CONSTANTS)


@pytest.fixture(scope="module")
def plates(tmp_path_factory):
    """Simulated plates of 24 mm length, 3 and 6 mm wide, and the figures of their sweeps."""
    found = {}
    for width in (3, 6):
        folder = tmp_path_factory.mktemp(f"plate{width}")
        (folder / "plate.toml").write_text(PLATE.format(width=f"{width} mm"), encoding="utf-8")
        specimen = fp.read_specimen(folder / "plate.toml")
        sweep = fp.simulate(specimen).spectrum
        write_spectrum(sweep, folder / "sweep.csv")
        found[width] = folder, fp.standard_figures(sweep, specimen)
    return found


def test_a_width_that_is_off_is_no_error_of_a_formula(tmp_path):
    """The fit of an exact bar 3 % wider than its file moves the width; ε33T by the formula is still right."""
    losses = "".join(f"tan_{name} = {0.015}\n" for name in ("s11", "d31", "eps33T"))
    sizes = 'length = "40 mm"\nwidth = "1 mm"\nstd_width = "0.03 mm"\nthickness = "0.5 mm"\ndensity = 7500.0\n'
    (tmp_path / "bar.toml").write_text(
        f'name = "bar"\n[geometry]\nshape = "plate"\npoling = "thickness"\n{sizes}[material]\nbase = "pzt-5h"\n{losses}'
        'free = ["s11", "d31"]\n[measurement]\nfile = "sweep.csv"\n',
        encoding="utf-8",
    )
    given = prepare(fp.read_specimen(tmp_path / "bar.toml"), check=False).constants
    frequency, rng = np.linspace(5e3, 60e3, 401), np.random.default_rng(5)
    size = (40e-3, 1.03 * 1e-3, 0.5e-3)
    z = k31_bar.impedance(2 * np.pi * frequency, size, 7500.0, given.s11, given.d31, given.eps33T)
    z = z * (1 + 1e-3 * (rng.normal(size=z.size) + 1j * rng.normal(size=z.size)) / np.sqrt(2))
    write_spectrum(ImpedanceSpectrum.from_impedance(frequency, z), tmp_path / "sweep.csv")
    result = fp.update(tmp_path / "bar.toml")
    effects = zip(result.fit.parameters.effects, result.fit.parameters.values(result.fit.x), strict=True)
    width = next(float(values[0]) for effect, values in effects if effect.name == "wrong_width")
    figure = result.figures[0][0]["eps33T"]
    assert width > 0.005 and abs(figure.formula_error) < 1e-4 < abs(figure.deviation)


def test_errors_of_formulas_are_those_of_the_formulas_used(tmp_path):
    """A disk, its sweep up to below its second radial mode: the Poisson ratio is that of the material, and no error of
    a reading from two modes is told.
    """
    text = PLATE.format(width="").replace('"plate"', '"disk"').replace('poling = "thickness"\n', "")
    text = text.replace('length = "24 mm"\nwidth = ""\n', 'diameter = "25 mm"\n')
    (tmp_path / "disk.toml").write_text(text + 'free = ["s11", "d31", "eps33T"]\n', encoding="utf-8")
    specimen, errors = fp.read_specimen(tmp_path / "disk.toml"), []
    for stop in (130e3, 250e3):
        wish = Simulation(start=2e3, stop=stop, points=801, noise=1e-4)
        sweep = fp.simulate(specimen.model_copy(update={"simulation": wish})).spectrum
        ((mode, *_),) = fp.update(specimen, sweep).figures
        errors.append(mode["poisson"].formula_error)
    assert abs(errors[0] or 0.0) < 1e-9 < 1e-4 < abs(errors[1])


def test_the_simulated_figures_are_those_of_the_order_of_the_file(plates, monkeypatch):
    """[simulation] order = 3 holds for the sweep that is simulated beside a measured one."""
    folder, _ = plates[3]
    specimen, seen = fp.read_specimen(folder / "plate.toml"), []

    def watched(one):
        seen.append(one.simulation)
        return study_simulate(one)

    monkeypatch.setattr("femu_piezo.study.standard_figures.simulate", watched)
    wish = Simulation(order=3, noise=0.1, spacing="log")
    fp.standard_figures(folder / "sweep.csv", specimen.model_copy(update={"simulation": wish}))
    assert seen and {(one.order, one.noise, one.spacing) for one in seen} == {(3, 0.0, "linear")}


def test_a_sweep_above_the_fundamental_has_no_figures_of_a_bar(tmp_path):
    """Its lowest mode is the third one, whose frequencies are known and of which the formulas of a bar say nothing."""
    (tmp_path / "plate.toml").write_text(PLATE.format(width="3 mm"), encoding="utf-8")
    specimen = fp.read_specimen(tmp_path / "plate.toml")
    found = {}
    for start in (30e3, 80e3):
        wish = Simulation(start=start, stop=250e3, points=801)
        sweep = fp.simulate(specimen.model_copy(update={"simulation": wish})).spectrum
        found[start] = fp.standard_figures(sweep, specimen).modes[0]
    whole, above = found.values()
    assert whole["s11"].value == pytest.approx(16.5e-12, rel=0.01, abs=0)
    assert above["fs"].value == pytest.approx(3 * whole["fs"].value, rel=0.01)
    assert not {"k31", "s11", "d31", "C_T", "Qm_Z"} & {one.name for one in above.figures}
    assert "other modes lie below" in above.notes[0] and "above the fundamental" in above.title


def test_the_capacitance_of_the_model_is_that_at_1_khz(tmp_path):
    """A shear plate from 200 kHz: read off the sweep it is a formula's value; the model gives ε11T A/t to 1e-3."""
    (tmp_path / "shear.toml").write_text(
        'name = "shear"\n[geometry]\nshape = "plate"\nlength = "4 mm"\nwidth = "2 mm"\nthickness = "1 mm"\n'
        'poling = [1, 0, 0]\ndensity = 7500.0\n[material]\nbase = "pzt-5h"\n'
        "tan_s44 = 0.015\ntan_d15 = 0.015\ntan_eps11T = 0.015\n",
        encoding="utf-8",
    )
    specimen = fp.read_specimen(tmp_path / "shear.toml")
    wish = Simulation(start=200e3, stop=1.1e6, points=401)
    sweep = fp.simulate(specimen.model_copy(update={"simulation": wish})).spectrum
    mode = fp.standard_figures(sweep, specimen).modes[0]
    assert any(
        "so none is used" in note for note in mode.notes
    )  # a plate twice as wide as thick has no pure shear mode
    figure = mode["C_T"]
    exact = library_material("pzt-5h").constants.eps11T.real * 8e-6 / 1e-3
    assert figure.model == pytest.approx(exact, rel=1e-3) and abs(figure.deviation) > 5e-3


@pytest.mark.slow
def test_error_of_the_bar_formula_follows_lateral_inertia(plates):
    """Rayleigh and Love: lateral motion lowers fs by π² (σ12² w² + σ13² t²)/(24 l²), and s11 is found too large by
    twice that.

    σ12 and σ13 of PZT-5H are −s12/s11 and −s13/s11. The next terms are smaller by about (w/l)²: 3 % are allowed at w/l
    = 1/8, 10 % at 1/4.
    """
    for width, allowed in ((3, 0.03), (6, 0.10)):
        figures = plates[width][1]
        lateral = (4.78 / 16.5 * width) ** 2 + (8.45 / 16.5 * 0.5) ** 2
        love = 2 * np.pi**2 * lateral / (24 * 24**2)
        assert figures["s11"].formula_error == pytest.approx(love, rel=allowed)
        assert f"length/width = {24 / width:g}" in figures.modes[0].formula_words
    assert abs(plates[6][1]["k31"].formula_error) > abs(plates[3][1]["k31"].formula_error) > 1e-4


def test_the_sweep_of_the_model_deviates_from_it_by_the_error_of_the_formula_alone(plates):
    figures = plates[6][1]
    for name in ("fs", "fp", "fm", "fn", "fr", "fa", "Qm_3dB", "C_T"):
        assert abs(figures[name].deviation) < 1e-5, name
    for name in ("k31", "s11", "d31", "eps33T"):
        assert figures[name].deviation == pytest.approx(figures[name].formula_error, abs=1e-5), name


def test_commands_write_the_figures(plates, tmp_path):
    folder = plates[3][0]
    answer = invoked("extract", folder / "sweep.csv", "--out", tmp_path / "e")
    assert answer.exit_code == 0 and "series resonance, largest conductance" in answer.output
    record = json.loads((tmp_path / "e" / "extraction.json").read_text(encoding="utf-8"))
    assert record["standard_figures"]["figures"]["fs"]["value"] == pytest.approx(plates[3][1]["fs"].value)
    answer = invoked("update", folder / "plate.toml", "--data", folder / "sweep.csv", "--out", tmp_path / "u")
    assert answer.exit_code == 0 and "what the handbook formulas get wrong for this piece" in answer.output
    record = json.loads((tmp_path / "u" / "update.json").read_text(encoding="utf-8"))
    k31 = record["specimens"][0]["standard_figures"][0]["figures"]["k31"]
    assert k31["deviation"] == pytest.approx(k31["value"] / k31["model"] - 1)


def test_results_show_tabulate_and_save(plates, tmp_path):
    figures = plates[3][1]
    assert "k31" in repr(figures) and "<pre" in figures._repr_html_()
    assert figures.to_dataframe().loc["s11", "unit"] == "m^2/N"
    figures.save(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["figures.json", "figures.png"]


def test_a_sweep_without_resonance_is_told():
    frequency = np.linspace(1e3, 2e3, 50)
    noise = np.random.default_rng(0).normal(size=50)
    flat = ImpedanceSpectrum.from_impedance(
        frequency, (1 + 1e-4 * noise) * (1 - 0.02j) / (2j * np.pi * frequency * 1e-9)
    )
    with pytest.raises(fp.InputError, match="no pole with its zero"):
        fp.standard_figures(flat)


def test_deviations_of_capacitance_and_loss_cover_the_truth():
    """40 sweeps of a bar with 0.2 % of noise: errors over deviations have an rms of 0.8 to 1.2."""
    frequency = np.r_[np.linspace(800, 1200, 9), np.linspace(40e3, 60e3, 300)]
    bar = (LENGTH, AREA / LENGTH, GAP), RHO, S11, D31, EPS33
    clean = k31_bar.impedance(2 * np.pi * frequency, *bar)
    exact = extract(ImpedanceSpectrum(frequency, clean)).figures
    away = []
    for seed in range(40):
        found = extract(ImpedanceSpectrum(frequency, noisy(clean, 2e-3, seed))).figures
        for name in ("C_T", "tan_delta"):
            one, truth = (next(f for f in figures.figures if f.name == name) for figures in (found, exact))
            away.append((one.value - truth.value) / one.std)
    assert 0.8 < np.sqrt(np.mean(np.square(away))) < 1.2


BAR = (LENGTH, AREA / LENGTH, GAP), RHO, S11, D31, EPS33


def test_deviations_of_a_reading_between_two_points():
    """1 kHz lies midway between two points, whose mean has 1/√2 of the deviation of one."""
    frequency = np.r_[np.arange(650.0, 1400.0, 100.0), np.linspace(40e3, 60e3, 300)]
    clean = k31_bar.impedance(2 * np.pi * frequency, *BAR)
    truth = extract(ImpedanceSpectrum(frequency, clean)).figures
    away = []
    for seed in range(60):
        found = extract(ImpedanceSpectrum(frequency, noisy(clean, 2e-3, seed))).figures
        away += [(found[name].value - truth[name].value) / found[name].std for name in ("C_T", "tan_delta")]
    assert 0.85 < np.sqrt(np.mean(np.square(away))) < 1.2


@pytest.mark.parametrize("name", ["k31 bar", "shear"])
def test_permittivity_is_as_uncertain_as_the_capacitance(name):
    """Along and across the poling."""
    piece, admittance, frequency, _ = CASES[name]
    found = extract(ImpedanceSpectrum(frequency, 1 / admittance(frequency)))
    pair, points = fundamental(found.pairs), (frequency, 1 / admittance(frequency))
    noise = np.full(frequency.size, 2e-3)
    read = read_curve(found.model.admittance, points, pair.pole, pair.zero, piece, noise=noise)
    of_permittivity = "eps11T" if name == "shear" else "eps33T"
    assert read.std[of_permittivity] / read.values[of_permittivity] == pytest.approx(2e-3 / np.sqrt(2), rel=1e-6)


def test_clipped_readings_give_no_capacitance():
    """The instrument shows no more than 20 kohm, which the piece has up to 10 kHz."""
    frequency = np.geomspace(100, 60e3, 800)
    clean = k31_bar.impedance(2 * np.pi * frequency, *BAR)
    z = noisy(clean, 1e-3, 1)
    below = frequency < 10e3
    ceiling = np.abs(z[below]).min()
    clipped = np.where(np.abs(z) > ceiling, z / np.abs(z) * ceiling, z)
    found, whole = (extract(ImpedanceSpectrum(frequency, one)) for one in (clipped, z))
    assert found.status == "clipped"
    for name in ("C_T", "Qm_Z"):
        assert found.figures[name].value == pytest.approx(whole.figures[name].value, rel=0.02), name
    assert "the capacitance at" in found.figures.notes[0]


def test_a_sweep_from_between_pole_and_zero_of_a_lower_mode_gives_no_capacitance():
    """The bar is an inductor where the sweep begins; the figures are those of its next mode."""
    fundamental_Hz = CASES["k31 bar"][3]["N1"] / LENGTH
    frequency = np.linspace(1.01, 3.5, 800) * fundamental_Hz
    z = noisy(k31_bar.impedance(2 * np.pi * frequency, *BAR), 1e-3, 1)
    assert z[0].imag > 0
    figures = extract(ImpedanceSpectrum(frequency, z)).figures
    assert figures["fs"].value == pytest.approx(3 * fundamental_Hz, rel=1e-3)
    assert not {"C_T", "Qm_Z", "tan_delta"} & {one.name for one in figures.figures}
    assert "starts at a resonance" in figures.notes[0]


def test_a_resonance_not_far_above_1_kHz_is_told():
    """The capacitance is read at the lowest frequency, and not because 1 kHz is missing."""
    frequency = np.linspace(100, 8e3, 800)
    found = figures_of(Piece("other", 1.0, None, None, 1.0), lambda f: circuit(f, fs=5e3), frequency)
    assert found["C_T"].value == pytest.approx(
        (circuit(np.array([1e3]), fs=5e3)[0]).imag / (2e3 * np.pi), rel=1e-4, abs=0
    )
    assert found.notes[0].startswith("1 kHz is not far below the resonance: the capacitance at 100 Hz")


def test_numbers_have_no_powers_of_ten_and_the_digits_of_their_deviation():
    assert [deviation_percent(share) for share in (None, 8.8e-8, -0.0112)] == ["", "0 %", "-1.1 %"]
    frequency = np.linspace(26e9, 46e9, 121)  # MHz taken for Hz
    z = k31_bar.impedance(
        2e-6 * np.pi * frequency, (40e-3, 3e-3, 0.5e-3), 7500.0, 16.5e-12 - 2.5e-13j, -274e-12 + 3.6e-12j, 3e-8 - 4e-10j
    )
    found = extract(ImpedanceSpectrum(frequency, noisy(z, 1e-3, np.random.default_rng(1))))
    console = Console(width=200)
    with console.capture() as printed:
        console.print(extraction_table(found))
    pole = printed.get().splitlines()[0]
    assert re.fullmatch(r"pole +3\d{10} ± \d{5} Hz   loss 0\.0\d+ ± 0\.0+\d\d +Q \d+\.\d+ *", pole), pole
