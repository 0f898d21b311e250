"""Make sweep.csv: twelve plates whose true values differ from their specimen file within ordinary tolerances.

The method is not finite elements but spectral elements of high degree (tests/hidden_effects/build.py). Every piece has
its own dimensions, density, held constants, residual elements of the fixture and errors of the instrument, drawn from
the default standard deviations of docs/explanation/budget.md. s11, d31 and eps33T are the same in all. pieces.toml
holds the dimensions and density of each. Takes a few seconds: python tutorials/stated_uncertainty/make_sweep.py
"""

import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1] / "tests"))

from hidden_effects.build import Build  # noqa: E402
from hidden_effects.draws import _passive  # noqa: E402

EPS0 = 8.8541878128e-12
PIECES, POINTS, NOISE, SEED = 12, 201, 1e-3, 20
#: Readings of calliper and balance and handbook values, the same for every piece: dimensions (m), kg/m³, constants.
SIZE, DENSITY = np.array([12e-3, 3e-3, 1e-3]), 7500.0
CONSTANTS = ("s11", "s12", "s13", "s33", "s44", "d31", "d33", "d15", "eps11T", "eps33T")
HANDBOOK = np.array(
    [16.5e-12, -4.78e-12, -8.45e-12, 20.7e-12, 43.5e-12, -274e-12, 593e-12, 741e-12, 3130 * EPS0, 3400 * EPS0]
)
TANGENT = 0.018
#: The true free constants, the same in all pieces: value and loss tangent.
FREE = {"s11": (17.0e-12, 0.0150), "d31": (-265e-12, 0.0140), "eps33T": (3500 * EPS0, 0.0190)}
#: Standard deviations: of dimensions (m), density, held constants and their tangents, |Z|, phase (rad), fixture.
STD_SIZE, STD_DENSITY, STD_HELD, STD_TANGENT = np.array([20e-6, 20e-6, 5e-6]), 0.005, 0.03, 0.005
STD_GAIN, STD_PHASE, STD_RESIDUE = 8e-4, 8e-4, np.array([0.02, 10e-9, 0.1e-12])


def constants(rng: np.random.Generator) -> np.ndarray:
    """(10,) complex constants of a piece: the held ones with errors within tolerances, drawn again until passive."""
    while True:
        tangents = TANGENT + STD_TANGENT * rng.standard_normal(10)
        theta = HANDBOOK * (1 + STD_HELD * rng.standard_normal(10)) * (1 - 1j * tangents)
        for name, (value, tangent) in FREE.items():
            theta[CONSTANTS.index(name)] = value * (1 - 1j * tangent)
        if _passive(theta):
            return theta


def instrument(rng: np.random.Generator, frequency: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Z (k,) with the residual elements of the fixture and instrument errors that are linear in log frequency."""
    resistance, inductance, capacitance = STD_RESIDUE * rng.standard_normal(3)
    omega, along = 2 * np.pi * frequency, np.log10(frequency / frequency.mean())
    z = 1 / (1 / z + 1j * omega * capacitance) + resistance + 1j * omega * inductance
    gain, phase = np.array([STD_GAIN, STD_PHASE])[:, None] * rng.standard_normal((2, 2)) / np.sqrt(2)
    return z * np.exp(gain[0] + gain[1] * along + 1j * (phase[0] + phase[1] * along))


def piece(rng: np.random.Generator, frequency: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """The sweep Z (k,) of a piece, its true dimensions (3,) and density."""
    size = SIZE + STD_SIZE * rng.standard_normal(3)
    density = DENSITY * (1 + STD_DENSITY * rng.standard_normal())
    theta = constants(rng)
    z = Build(size, density, theta, 0.0).impedance(frequency)
    real, imag = rng.standard_normal((2, frequency.size))
    return instrument(rng, frequency, z) * (1 + NOISE * (real + 1j * imag) / np.sqrt(2)), size, density


if __name__ == "__main__":
    frequency, rng = np.linspace(20e3, 200e3, POINTS), np.random.default_rng(SEED)
    columns, names, drawn = [frequency], ["frequency_Hz"], []
    for number in range(1, PIECES + 1):
        z, size, density = piece(rng, frequency)
        columns += [z.real, z.imag]
        names += [f"resistance_{number}_ohm", f"reactance_{number}_ohm"]
        drawn.append(f"[[piece]]\nsize = {[float(f'{x:.8g}') for x in size]}\ndensity = {density:.8g}\n")
    rows = [",".join(f"{value:.7g}" for value in row) + "\n" for row in np.transpose(columns)]
    (HERE / "sweep.csv").write_text(",".join(names) + "\n" + "".join(rows), encoding="utf-8")
    (HERE / "pieces.toml").write_text(
        "# True dimensions and densities of the pieces (m, kg/m^3): make_sweep.py\n" + "\n".join(drawn)
    )
