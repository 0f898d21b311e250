"""Draws of specimens with hidden effects: the data go to a file, the key stays with the caller.

The data come from an independent discretisation (`build`); the code under test gets a specimen file and a CSV only.
Every thousand seeds form a lot with several set-ups, each with a size of plate, a material as its supplier states it,
and an instrument. The free constants, the hidden effects and the noise itself are drawn for each draw.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from hidden_effects.build import Build
from hidden_effects.catalogue import EFFECTS as EFFECTS
from hidden_effects.catalogue import NAMES, Hidden
from hidden_effects.undescribed import UNDESCRIBED

EPS0 = 8.8541878128e-12
#: PZT-5H (public handbook values), SI
PZT5H = np.array(
    [16.5e-12, -4.78e-12, -8.45e-12, 20.7e-12, 43.5e-12, -274e-12, 593e-12, 741e-12, 3130 * EPS0, 3400 * EPS0]
)
#: Free constants of k31 plates (poled along z) and of k33 bars (along x).
FREE = {2: ("s11", "d31", "eps33T"), 0: ("s33", "d33", "eps33T")}
#: Effects for which every sixth draw is a k33 bar: its sweep shows them as well as that of a plate.
ALSO_ON_BARS = ("none", "leakage", "frequency_dependent_elastic_loss", "wrong_insensitive_parameter", "wrong_length")
#: Effects on a bar that a sweep over two of its modes shows; a drift is drawn over the sweep of a plate.
BAR_EFFECTS = (
    *("poling_gradient", "point_mass", "local_crack", "mounting", "tapered_width", "wedge", "wrong_width"),
    *("series_resistance", "stray_capacitance", "leakage", "contact_gap", "cable"),
    *("frequency_dependent_elastic_loss", "dielectric_dispersion", "relaxation", "wrong_insensitive_parameter"),
)
DENSITY = 7500.0
#: Most attempts to draw a specimen whose sweep is passive.
_ATTEMPTS = 60
#: Set-ups in a lot, and range of the relative noise, of which each set-up has its own sixth.
_SETUPS, _NOISE = 6, (5e-4, 3e-3)
#: Prefix of the name of a draw whose specimen and instrument are off by their tolerances.
LABORATORY = "laboratory:"
#: Prefix of the name of a draw of a bar in a laboratory that is swept over two of its modes.
BAR = "bar:"
#: End of the sweep of a plate, and of such a bar, Hz.
_TOP, _TOP_OF_BAR = 240e3, 480e3
#: Standard deviations in a laboratory: of length, width, thickness (m), of the density, of held constants (relative)
#: and of their tangents; of the instrument's magnitude and phase (rad); of the residue of the fixture (ohm, H, F).
STD_SIZE, STD_DENSITY, STD_HELD, STD_TANGENT = np.array([20e-6, 20e-6, 5e-6]), 3e-3, 0.03, 0.005
STD_GAIN, STD_PHASE, STD_RESIDUE = 8e-4, 8e-4, (0.02, 5e-9, 5e-14)
_RESIDUE = ("resistance", "inductance", "capacitance")
#: Share of the draws in a laboratory whose noise is correlated, and over how many points it is averaged.
CORRELATED, NEIGHBOURS = 0.25, 3
#: Share of the effects that follow another law than the library's, and of the draws that hold out a band.
VARIANTS, HELD_OUT = 0.35, 0.2


@dataclass(frozen=True)
class Draw:
    """One drawn specimen.

    Attributes
    ----------
    name : what was asked for: an effect, two with "+", "none", "undescribed", each also in a laboratory
    specification : what the code under test may see: the text of the specimen file
    frequency, impedance : the sweep, Hz and ohm;  clean : without noise
    key : the hidden effects; none for a null
    undescribed : kind of an effect that the library does not have
    build : the truth
    noise : true relative noise of Z
    """

    name: str
    seed: int
    specification: str
    frequency: np.ndarray = field(repr=False)
    impedance: np.ndarray = field(repr=False)
    clean: np.ndarray = field(repr=False)
    key: tuple[Hidden, ...]
    undescribed: str
    build: Build = field(repr=False)
    noise: float

    @property
    def theta(self) -> np.ndarray:
        """(10,) complex true constants at the reference frequency of laws over frequency, without the loss of a
        relaxation.
        """
        return self.build.theta

    @property
    def size(self) -> float:
        """First size of the first effect, 0 for a null."""
        return next(iter(self.key[0].sizes.values())) if self.key else 0.0

    def write(self, folder: Path) -> Path:
        """Write specimen file and sweep, neither of which mentions the key."""
        folder.mkdir(parents=True, exist_ok=True)
        rows = [
            f"{f!r},{z.real!r},{z.imag!r}"
            for f, z in zip(self.frequency.tolist(), self.impedance.tolist(), strict=True)
        ]
        (folder / "sweep.csv").write_text("frequency_Hz,resistance_ohm,reactance_ohm\n" + "\n".join(rows) + "\n")
        (folder / "plate.toml").write_text(self.specification)
        return folder / "plate.toml"


@dataclass(frozen=True)
class Setup:
    """The properties that several draws share.

    Attributes
    ----------
    nominal : length, width, thickness of the file, m
    poling : axis
    held : (10,) true constants, of those that are free real published values
    noise : relative, of Z
    """

    nominal: np.ndarray
    poling: int
    held: np.ndarray
    noise: float

    @property
    def assumed(self) -> np.ndarray:
        """(10,) constants of the file."""
        found = self.held.copy()
        for free in FREE[self.poling]:
            found[NAMES.index(free)] *= 1 - 0.015j
        return found


def place_of(name: str, seed: int) -> tuple[int, int, bool]:
    """Lot, number of the set-up in it, and whether the draw is a bar."""
    lot, number = divmod(seed, 1000)
    number %= _SETUPS
    bar = name.removeprefix(LABORATORY) in ALSO_ON_BARS and number == _SETUPS - 1
    return lot, number, bar or name.startswith(BAR)


def setup_of(name: str, seed: int) -> Setup:
    """The set-up of a draw, the same for all draws of that place in the lot."""
    lot, number, bar = place_of(name, seed)
    rng = np.random.default_rng([2028, lot, number, int(bar)])
    share = np.random.default_rng([2028, lot]).permutation(_SETUPS)[number] + rng.random()
    noise = float(np.exp(np.interp(share / _SETUPS, (0, 1), np.log(_NOISE))))
    if bar:
        nominal = np.array([12e-3, rng.uniform(3e-3, 3.6e-3), rng.uniform(2.2e-3, 2.8e-3)])
    else:
        nominal = np.array([12e-3, 12e-3 * rng.uniform(0.52, 0.6), rng.uniform(1.4e-3, 1.8e-3)])
    poling = 0 if bar else 2
    for _ in range(_ATTEMPTS):
        held = PZT5H * rng.uniform(0.96, 1.04, 10) * (1 - 1j * rng.uniform(0.012, 0.02, 10))
        for free in FREE[poling]:
            held[NAMES.index(free)] = PZT5H[NAMES.index(free)]
        setup = Setup(nominal, poling, held, noise)
        if passive(setup.assumed):
            return setup
    raise RuntimeError(f"lot {lot}: no passive material in {_ATTEMPTS} draws")


def passive(theta: np.ndarray) -> bool:
    """Whether no combination of stress and field gains energy: the loss part of s, d and ε together is positive
    definite.
    """
    s11, s12, s13, s33, s44, d31, d33, d15, eps11, eps33 = -theta.imag
    along = [[s11, s12, s13, -d31], [s12, s11, s13, -d31], [s13, s13, s33, -d33], [-d31, -d31, -d33, eps33]]
    return all(np.linalg.eigvalsh(part)[0] > 0 for part in (np.array(along), np.array([[s44, -d15], [-d15, eps11]])))


def draw(name: str, seed: int, *, points: int = 301, variant: bool | None = None) -> Draw:
    """A specimen of its set-up with random free constants and noise, and what `name` says of random size.

    Parameters
    ----------
    name : an effect, two effects with "+" between, "none", "undescribed", or "undescribed:KIND", after "laboratory:"
        where everything else is off by its tolerance as well, or after "bar:" likewise for a bar
    variant : whether effects follow other laws than the library's; drawn where None

    Losses are drawn one by one, so that a strongly coupled material may come out active, by itself (Holland 1967) or in
    its sweep; then all is drawn again.
    """
    for attempt in range(_ATTEMPTS):
        found = _drawn(name, seed, points, variant, [attempt] if attempt else [])
        if np.all(found.clean.real > 0) and passive(found.theta):
            return found
    raise RuntimeError(f"{name}:{seed}: no passive specimen in {_ATTEMPTS} draws")


def _drawn(name: str, seed: int, points: int, variant: bool | None, attempt: list[int]) -> Draw:
    rng = np.random.default_rng([2026, seed, zlib.crc32(name.encode()), *attempt])
    setup = setup_of(name, seed)
    nominal, poling, noise, theta = setup.nominal, setup.poling, setup.noise, setup.held.copy()
    whole, name = name, name.removeprefix(LABORATORY).removeprefix(BAR)
    laboratory, size, density = name != whole, nominal.copy(), DENSITY
    off = np.random.default_rng([2029, seed, zlib.crc32(name.encode()), *attempt])
    if laboratory:
        tangents = -theta.imag / theta.real + STD_TANGENT * off.standard_normal(10)
        theta = theta.real * (1 + STD_HELD * off.standard_normal(10)) * (1 - 1j * tangents)
        for free in FREE[poling]:
            theta[NAMES.index(free)] = PZT5H[NAMES.index(free)]
        size, density = size + STD_SIZE * off.standard_normal(3), density * (1 + STD_DENSITY * off.standard_normal())
    for free in FREE[poling]:
        theta[NAMES.index(free)] *= rng.uniform(0.96, 1.04) * (1 - 1j * rng.uniform(0.012, 0.02))
    known, held_out = bool(rng.integers(2)), rng.random() < HELD_OUT
    top = _TOP_OF_BAR if whole.startswith(BAR) else _TOP
    frequency = np.linspace(20e3, top, points)
    compliance = theta[0] if poling == 2 else theta[3] - theta[6] ** 2 / theta[9]  # s11E, s33D
    near = float(1 / (2 * nominal[0] * np.sqrt(DENSITY * compliance.real)))
    build = Build(size, density, theta, near, poling=poling)
    build.fundamental = build.pole(near)
    if poling == 0:
        build.admittance = 1 / 80
    key, kind = [], ""
    if name.startswith("undescribed"):
        kind = name.partition(":")[2] or str(rng.choice(list(UNDESCRIBED)))
        UNDESCRIBED[kind](build, rng)
    elif name != "none":
        for effect in name.split("+"):
            other = bool(rng.random() < VARIANTS) if variant is None else variant
            key.append(EFFECTS[effect](build, rng, other))
    if laboratory:
        build.circuits.append(instrument(off))
        key = [_in_all(hidden, build, setup) for hidden in key]
    clean = build.impedance(frequency)
    normal = rng.standard_normal((2, points))
    if laboratory and off.random() < CORRELATED:
        more = off.standard_normal((2, points + NEIGHBOURS - 1))
        normal = np.lib.stride_tricks.sliding_window_view(more, NEIGHBOURS, 1).sum(axis=2) / np.sqrt(NEIGHBOURS)
    z = clean * (1 + noise * (normal[0] + 1j * normal[1]) / np.sqrt(2))
    low = float(rng.uniform(40e3, 200e3)) * top / _TOP
    text = _specification(setup, noise if known else None, (low, low + 25e3) if held_out else None, laboratory)
    return Draw(whole, seed, text, frequency, z, clean, tuple(key), kind, build, noise)


def instrument(off: np.random.Generator):
    """A circuit that adds the residue of a fixture and the gain error of an instrument, linear in the logarithm of
    frequency.
    """
    resistance, inductance, capacitance = np.array(STD_RESIDUE) * off.standard_normal(3)
    gain = np.array([STD_GAIN, STD_PHASE]) * off.standard_normal((2, 2)) / np.sqrt(2)

    def circuit(w: np.ndarray, z: np.ndarray) -> np.ndarray:
        z = 1 / (1 / z + 1j * w * capacitance) + resistance + 1j * w * inductance
        along = np.log10(w / (2 * np.pi * 70e3))
        magnitude, phase = gain[:, :1] + gain[:, 1:] * along
        return z * np.exp(magnitude + 1j * phase)

    return circuit


def _in_all(hidden: Hidden, build: Build, setup: Setup) -> Hidden:
    """The key of a wrong dimension or constant with the tolerance included, since a sweep shows the total difference
    from the file.
    """
    if hidden.effect == "wrong_insensitive_parameter":
        number = NAMES.index(hidden.detail)
        return replace(hidden, sizes={"relative_error": build.theta[number].real / setup.held[number].real - 1})
    axes = {"wrong_length": 0, "wrong_width": 1, "wrong_thickness": 2}
    if hidden.effect in axes:
        axis = axes[hidden.effect]
        return replace(hidden, sizes={"relative_error": build.size[axis] / setup.nominal[axis] - 1})
    return hidden


def pair_of(number: int) -> str:
    """Name of the pair with a running number: two different effects, all equally likely."""
    rng = np.random.default_rng([2027, number])
    return "+".join(str(effect) for effect in rng.choice(list(EFFECTS), 2, replace=False))


def _specification(
    setup: Setup, noise: float | None, held_out: tuple[float, float] | None, laboratory: bool = False
) -> str:
    poling, assumed = setup.poling, setup.assumed
    along = "thickness" if poling == 2 else "length"
    lines = ['name = "hidden"', "[geometry]", 'shape = "plate"', f'poling = "{along}"', f"density = {DENSITY}"]
    for name, value in zip(("length", "width", "thickness"), setup.nominal.tolist(), strict=True):
        lines.append(f"{name} = {value!r}")
    if laboratory:
        lines += [f"std_{n} = {v!r}" for n, v in zip(("length", "width", "thickness"), STD_SIZE.tolist(), strict=True)]
        lines.append(f"std_density = {STD_DENSITY!r}")
    lines += [*material_lines(FREE[poling], assumed, laboratory), *measurement_lines(noise, laboratory)]
    if held_out is not None:
        lines.append(f"held_out = [{held_out[0]!r}, {held_out[1]!r}]")
    if not laboratory:
        lines += ["[update]", "noise_only = true"]  # everything but the effects is exactly as stated in the file
    return "\n".join(lines) + "\n"


def material_lines(free: Sequence[str], assumed: np.ndarray, laboratory: bool) -> list[str]:
    """The [material] table."""
    lines = ["[material]", f"free = {list(free)}"]
    for name, value in zip(NAMES, assumed.tolist(), strict=True):
        lines += [f"{name} = {value.real!r}", f"tan_{name} = {-value.imag / value.real!r}"]
        if laboratory and name not in free:
            lines += [f'std_{name} = "{100 * STD_HELD} %"', f"std_tan_{name} = {STD_TANGENT!r}"]
    return lines


def measurement_lines(noise: float | None, laboratory: bool) -> list[str]:
    """The [measurement] table, last in the file, so that keys may be appended."""
    lines = ["[measurement]", 'file = "sweep.csv"']
    if laboratory:
        residue = ", ".join(f"{n} = {v!r}" for n, v in zip(_RESIDUE, STD_RESIDUE, strict=True))
        lines += [f"accuracy = {STD_GAIN!r}", f"phase_accuracy = {STD_PHASE!r}", f"residue = {{ {residue} }}"]
    if noise is not None:
        lines.append(f"noise = {noise!r}")
    return lines
