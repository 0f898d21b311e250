"""Draws of specimens with one hidden effect: the data go to a file, the key stays with the caller.

The data come from `ritz`, an independent discretisation; the code under test gets a specimen file and a CSV only.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hidden_effects.ritz import RitzPlate

NAMES = ("s11", "s12", "s13", "s33", "s44", "d31", "d33", "d15", "eps11T", "eps33T")
EPS0 = 8.8541878128e-12
#: PZT-5H (public handbook values), SI
PZT5H = np.array(
    [16.5e-12, -4.78e-12, -8.45e-12, 20.7e-12, 43.5e-12, -274e-12, 593e-12, 741e-12, 3130 * EPS0, 3400 * EPS0]
)
FREE = ("s11", "d31", "eps33T")
DENSITY = 7500.0

#: effect → smallest and largest size, with a random sign where the second entry says so; in SI, relative to the
#: specimen where named so below.
SIZES = {
    "series_resistance": (1.0, 8.0, False),
    "series_inductance": (2e-6, 12e-6, False),
    "stray_capacitance": (5e-12, 40e-12, False),
    "leakage": (3e-6, 3e-5, False),
    "frequency_dependent_elastic_loss": (0.3, 0.9, True),
    "dielectric_dispersion": (0.01, 0.05, False),
    "wrong_insensitive_parameter": (0.03, 0.12, True),
    "wrong_length": (0.003, 0.015, True),
    "wrong_width": (0.003, 0.015, True),
    "wrong_thickness": (0.01, 0.04, True),
    "electrode_mass": (0.02, 0.2, False),
}
#: Held constants that a wrong value is drawn for: those a k31 sweep can show.
WRONG = ("s12", "s13", "s33", "d33")


@dataclass(frozen=True)
class Draw:
    """One drawn specimen.

    Attributes
    ----------
    specification : what the code under test may see: the text of the specimen file
    effect, size : the key; "none" for a null
    theta : (10,) complex true constants
    """

    specification: str
    frequency: np.ndarray
    impedance: np.ndarray
    effect: str
    detail: str
    size: float
    theta: np.ndarray = field(repr=False)
    noise: float = 1e-3

    def write(self, folder: Path) -> Path:
        """Specimen file and sweep, without a word of the key."""
        folder.mkdir(parents=True, exist_ok=True)
        rows = [
            f"{f!r},{z.real!r},{z.imag!r}"
            for f, z in zip(self.frequency.tolist(), self.impedance.tolist(), strict=True)
        ]
        (folder / "sweep.csv").write_text("frequency_Hz,resistance_ohm,reactance_ohm\n" + "\n".join(rows) + "\n")
        (folder / "plate.toml").write_text(self.specification)
        return folder / "plate.toml"


def draw(effect: str, seed: int, *, points: int = 301) -> Draw:
    """A specimen with random constants, losses and dimensions, and one effect of random size ("none": without)."""
    rng = np.random.default_rng([2026, seed, sum(map(ord, effect))])
    nominal = np.array([12e-3, 12e-3 * rng.uniform(0.52, 0.6), rng.uniform(1.4e-3, 1.8e-3)])
    theta = PZT5H * rng.uniform(0.96, 1.04, 10) * (1 - 1j * rng.uniform(0.012, 0.02, 10))
    assumed = theta.copy()
    for name in FREE:
        assumed[NAMES.index(name)] = PZT5H[NAMES.index(name)] * (1 - 0.015j)
    size, detail = 0.0, ""
    if effect != "none":
        low, high, signed = SIZES[effect]
        size = float(np.exp(rng.uniform(np.log(low), np.log(high)))) * (rng.choice([-1, 1]) if signed else 1)
    noise = float(np.exp(rng.uniform(np.log(5e-4), np.log(3e-3))))
    known = bool(rng.integers(2))
    frequency = np.linspace(20e3, 240e3, points)
    dimensions, film, law, fundamental = nominal.copy(), 0.0, None, 1 / (2 * 12e-3 * np.sqrt(DENSITY * theta[0].real))
    if effect in ("wrong_length", "wrong_width", "wrong_thickness"):
        dimensions[("wrong_length", "wrong_width", "wrong_thickness").index(effect)] *= 1 + size
    if effect == "electrode_mass":
        film = size
    if effect == "wrong_insensitive_parameter":
        detail = str(rng.choice(WRONG))
        assumed[NAMES.index(detail)] /= 1 + size
    if effect == "frequency_dependent_elastic_loss":

        def law(f):
            other = theta.copy()
            other[:5] = theta[:5].real + 1j * theta[:5].imag * (f / fundamental) ** size
            return other

    if effect == "dielectric_dispersion":

        def law(f):
            other = theta.copy()
            other[9] *= 1 - size * np.log10(f / fundamental)
            return other

    plate = RitzPlate(dimensions, DENSITY, (12, 9, 5), film)
    z = plate.impedance(law or theta, frequency)
    omega = 2 * np.pi * frequency
    if effect == "series_resistance":
        z = z + size
    if effect == "series_inductance":
        z = z + 1j * omega * size
    if effect == "stray_capacitance":
        z = 1 / (1 / z + 1j * omega * size)
    if effect == "leakage":
        z = 1 / (1 / z + size)
    normal = rng.standard_normal((2, points))
    z = z * (1 + noise * (normal[0] + 1j * normal[1]) / np.sqrt(2))
    return Draw(
        _specification(nominal, assumed, noise if known else None), frequency, z, effect, detail, size, theta, noise
    )


def _specification(dimensions: np.ndarray, assumed: np.ndarray, noise: float | None) -> str:
    lines = ['name = "hidden"', "[geometry]", 'shape = "plate"', 'poling = "thickness"', f"density = {DENSITY}"]
    for name, value in zip(("length", "width", "thickness"), dimensions.tolist(), strict=True):
        lines.append(f"{name} = {value!r}")
    lines += ["[material]", f"free = {list(FREE)}"]
    for name, value in zip(NAMES, assumed.tolist(), strict=True):
        lines += [f"{name} = {value.real!r}", f"tan_{name} = {-value.imag / value.real!r}"]
    lines += ["[measurement]", 'file = "sweep.csv"']
    if noise is not None:
        lines.append(f"noise = {noise!r}")
    return "\n".join(lines) + "\n"
