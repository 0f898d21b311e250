"""What the columns of an impedance table mean, from their names: quantity, unit and sign.

Understood are a frequency and one of the pairs |Z| and phase, R and X, |Y| and phase, G and B, or what LCR meters
measure (Cp, Cs, Ls, Lp with D, Q, Rs, Rp or G), with units such as kHz, kOhm, pF, mS, deg or rad in brackets, after a
slash, an underscore or a space.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from femu_piezo.errors import InputError

UNDERSTOOD = (
    "a sweep needs columns of frequency with R and X, |Z| and theta, G and B, |Y| and theta, or Cp and D, each with "
    'its unit, such as "frequency_Hz,resistance_ohm,reactance_ohm" or "Frequency (kHz), |Z| (Ohm), theta (deg)"; '
    'columns = ["Frequency (Hz)", "R (Ohm)", "X (Ohm)"] in [measurement] names them for a file that does not'
)

_LABELS = {
    "frequency": "f freq frequency frequenz",
    "abs_z": "z |z| absz abs(z) zabs magz mag(z) zmag |impedance| impedance impedancemagnitude impedancemag",
    "phase_z": "thetaz phiz phasez phase(z) zphase argz arg(z) anglez angle(z) zangle impedancephase impedanceangle",
    "abs_y": "y |y| absy abs(y) yabs magy mag(y) ymag |admittance| admittance admittancemagnitude admittancemag",
    "phase_y": "thetay phiy phasey phase(y) yphase argy arg(y) angley angle(y) yangle admittancephase admittanceangle",
    "phase": "theta th phi phase angle phaseangle arg",
    "r": "r rs resistance rez re(z) realz real(z) zreal zre zr z' impedancereal reimpedance",
    "x": "x xs reactance imz im(z) imagz imag(z) zimag zim z'' impedanceimag impedanceimaginary imimpedance",
    "g": "g gp conductance rey re(y) realy real(y) yreal yre y' admittancereal",
    "b": "b bp susceptance imy im(y) imagy imag(y) yimag yim y'' admittanceimag admittanceimaginary",
    "magnitude": "magnitude mag abs modulus",
    "real": "real re realpart",
    "imag": "imag im imaginary imagpart imaginarypart",
    "noise": "noise std noisestd",
    "cp": "cp",
    "cs": "cs",
    "ls": "ls",
    "lp": "lp",
    "rp": "rp",
    "d": "d",
    "q": "q",
}
_KINDS = {label: kind for kind, labels in _LABELS.items() for label in labels.split()}
_FAMILY = {"frequency": "hertz", "phase": "angle", "phase_z": "angle", "phase_y": "angle"}
_FAMILY |= dict.fromkeys(("abs_z", "r", "x", "noise"), "ohm") | dict.fromkeys(("abs_y", "g", "b"), "siemens")
_FAMILY |= {"cp": "farad", "cs": "farad", "ls": "henry", "lp": "henry", "rp": "ohm", "d": "number", "q": "number"}
_BY_UNIT = {
    ("magnitude", "ohm"): "abs_z",
    ("magnitude", "siemens"): "abs_y",
    ("real", "ohm"): "r",
    ("real", "siemens"): "g",
    ("imag", "ohm"): "x",
    ("imag", "siemens"): "b",
}
_SIGNED = ("x", "b", "phase", "phase_z", "phase_y")
_PREFIX = {"": 1.0, "p": 1e-12, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "m": 1e-3, "k": 1e3, "K": 1e3, "M": 1e6, "G": 1e9}
_PAIRS = (("r", "x"), ("abs_z", "phase_z"), ("g", "b"), ("abs_y", "phase_y"))
#: Further pairs, which LCR meters measure → Z (n,) from ω (n,) and both columns (n,).
_LCR = {
    ("cp", "d"): lambda w, c, d: 1 / (w * c * (1j + d)),
    ("cp", "q"): lambda w, c, q: 1 / (w * c * (1j + 1 / q)),
    ("cp", "rp"): lambda w, c, r: 1 / (1j * w * c + 1 / r),
    ("cp", "g"): lambda w, c, g: 1 / (1j * w * c + g),
    ("cs", "d"): lambda w, c, d: (d - 1j) / (w * c),
    ("cs", "q"): lambda w, c, q: (1 / q - 1j) / (w * c),
    ("cs", "r"): lambda w, c, r: r - 1j / (w * c),
    ("ls", "d"): lambda w, h, d: w * h * (1j + d),
    ("ls", "q"): lambda w, h, q: w * h * (1j + 1 / q),
    ("ls", "r"): lambda w, h, r: r + 1j * w * h,
    ("lp", "d"): lambda w, h, d: 1 / ((d - 1j) / (w * h)),
    ("lp", "q"): lambda w, h, q: 1 / ((1 / q - 1j) / (w * h)),
    ("lp", "rp"): lambda w, h, r: 1 / (1 / r - 1j / (w * h)),
}


@dataclass(frozen=True)
class Column:
    """Meaning of one column: `kind`, the `scale` to SI (radian for angles), and whether the name gives the unit."""

    kind: str
    scale: float
    has_unit: bool


def parse_column(name: str) -> Column | None:
    """The meaning of a column from its name; None where it is not clear or not needed."""
    text = name.strip().strip('"').strip()
    for old, new in (("Ω", "Ω"), ("μ", "µ"), ("−", "-"), ("′", "'"), ("″", "''"), ('"', "''"), ("’", "'")):
        text = text.replace(old, new)
    if len(text) > 80 or re.search(r"mem(ory)?$", text, re.IGNORECASE):
        return None
    text = re.sub(r"[\s_-]*data$", "", text, flags=re.IGNORECASE)
    text = re.sub(r"^trace\s*\d*\s*:?\s+(?=\S)", "", text, flags=re.IGNORECASE)  # Bode 100, WaveForms
    label, unit = _split_unit(text)
    for greek, word in (("θ", "theta"), ("Θ", "theta"), ("φ", "phi"), ("ϕ", "phi"), ("∠", "angle")):
        label = label.replace(greek, word)
    kind = _kind(label)
    if kind is None:
        return None
    if unit is not None:
        kind = _BY_UNIT.get((kind, unit[0]), kind)
        if unit[0] != _FAMILY.get(kind):
            return None
    sign = -1.0 if label.startswith("-") else 1.0
    if kind not in _FAMILY or (sign < 0 and kind not in _SIGNED):
        return None
    return Column(kind, sign * (unit[1] if unit else 1.0), unit is not None)


def is_lcr(name: str) -> bool:
    """Whether a column holds a capacitance, an inductance, D, Q or a parallel resistance Rp."""
    column = parse_column(name)
    return column is not None and any(column.kind in pair and column.kind not in ("r", "g") for pair in _LCR)


def names_noise(name: str) -> bool:
    """Whether a column is called noise, in whatever unit."""
    return _kind(re.sub(r"[(\[{].*", "", name.strip().strip('"'))) == "noise"


def is_unit(name: str) -> bool:
    """Whether a cell of a header holds a unit and no name, as in a row of units below the names."""
    return _parse_unit(bare_unit(name)) is not None


def is_no_unit(name: str) -> bool:
    """Whether a cell of a row of units says that its column has none."""
    return bare_unit(name) in ("", "-", "–", "1")


def bare_unit(name: str) -> str:
    """A cell of a row of units without quotes and brackets."""
    return name.strip().strip('"').strip("()[] ")


def with_unit(name: str, unit: str, source: str) -> str:
    """The name of a column with its unit in the row of units; as it is where it states that itself, or has none there.

    Raises InputError where it states another unit.
    """
    column, stated = parse_column(name), _parse_unit(unit)
    if stated is None:
        return name
    if column is None or not column.has_unit:
        return f"{name} ({unit})"
    if (_FAMILY[column.kind], abs(column.scale)) != stated:
        raise InputError(f"{source}: the header says {name!r}, and its row of units {unit!r}; correct one")
    return name


def _kind(label: str) -> str | None:
    """The kind of a column from its name without unit; None where it is not known."""
    return _KINDS.get(re.sub(r"[\s_.:\-]", "", label.lower()))


def _split_unit(text: str) -> tuple[str, tuple[str, float] | None]:
    """Name and (family, scale) of a header cell."""
    for pattern in (r"(.*?)[\s_]*[(\[{]([^()\[\]{}]*)[)\]}]", r"(.+?)(?:\s+in\s+|[\s_/,]+)([^\s_/,]+)"):
        found = re.fullmatch(pattern, text)
        unit = _parse_unit(found[2]) if found else None
        if unit is not None:
            return found[1].strip(), unit
    return re.sub(r"\(\s*\)$", "", text).strip(), None


def _parse_unit(text: str) -> tuple[str, float] | None:
    """(family, scale to SI) of a unit; None where it is none."""
    text = text.strip().strip(".").replace("Ω", "Ω").replace("μ", "µ")
    if found := re.fullmatch(r"([kmg]?)(?:hz|hertz)", text, re.IGNORECASE):
        return "hertz", {"": 1.0, "k": 1e3, "m": 1e6, "g": 1e9}[found[1].lower()]  # nobody means millihertz
    if found := re.fullmatch(r"([pnuµmkKMG]?)(?i:ohms?|Ω)", text):
        return "ohm", _PREFIX[found[1]]
    if found := re.fullmatch(r"([pnuµmk]?)(?i:s|siemens|mho)", text):
        return "siemens", _PREFIX[found[1]]
    if found := re.fullmatch(r"([pnuµm]?)(?:F|farad)", text):
        return "farad", _PREFIX[found[1]]
    if found := re.fullmatch(r"([pnuµm]?)(?:H|henry)", text):
        return "henry", _PREFIX[found[1]]
    if re.fullmatch(r"(?i:deg|degs|degrees?|°)", text):
        return "angle", np.pi / 180
    if found := re.fullmatch(r"(m?)(?i:rad|radians?)", text):
        return "angle", _PREFIX[found[1]]
    return None


@dataclass(frozen=True)
class Layout:
    """Indices of the columns of the frequency, of both quantities of `pair`, and of the noise (None without one)."""

    frequency: int
    first: int
    second: int
    pair: tuple[str, str]
    noise: int | None


def choose_columns(names: list[str], columns: list[Column | None], source: str) -> Layout:
    """The columns that hold the sweep; of several complete pairs the first of `_PAIRS`, then of `_LCR`.

    Raises InputError where a frequency or a complete pair is missing, or two columns hold the same quantity.
    """
    shown = ", ".join(name.strip() for name in names)[:120]
    kinds = [column.kind if column else None for column in columns]
    if "frequency" not in kinds:
        raise InputError(f"{source}: none of the columns ({shown}) is recognised as the frequency; {UNDERSTOOD}")
    phase_kind = "phase_z" if "abs_z" in kinds else "phase_y"
    kinds = [phase_kind if kind == "phase" and phase_kind not in kinds else kind for kind in kinds]
    for pair in (*_PAIRS, *_LCR):
        if pair[0] in kinds and pair[1] in kinds:
            break
    else:
        raise InputError(f"{source}: the columns ({shown}) include no complete pair for an impedance; {UNDERSTOOD}")
    for kind in ("frequency", *pair, "noise"):
        if kinds.count(kind) > 1:
            raise InputError(
                f"{source}: {kinds.count(kind)} of the columns ({shown}) could be {kind}; keep one of them"
            )
    noise = kinds.index("noise") if "noise" in kinds else None
    return Layout(kinds.index("frequency"), kinds.index(pair[0]), kinds.index(pair[1]), pair, noise)


def reach_half_pi(phases: np.ndarray) -> bool:
    """Whether phases (n,) reach about π/2 and no more, as those of a capacitor in radians do."""
    return bool(1.2 < np.nanmax(np.abs(phases), initial=0.0) < 1.6)


def angle_scale(values: np.ndarray, column: Column, source: str) -> float:
    """The factor to radian of a phase column, from its unit, or from its values (n,) where it names none.

    Raises InputError where the unit and the values contradict each other.
    """
    largest = float(np.nanmax(np.abs(values), initial=0.0))
    if not column.has_unit:
        if largest > 7:
            return column.scale * np.pi / 180
        if 0.8 < largest < 3.3:
            return column.scale
        raise InputError(f"{source}: the phase column names no unit; write theta (deg) or theta (rad) in its header")
    degrees = abs(column.scale) == np.pi / 180
    if degrees and reach_half_pi(values):
        raise InputError(
            f"{source}: the header says degrees, but the phases reach {largest:.4g} at most, as radians do near π/2 = "
            "1.571; write theta (rad) in the header if they are radians"
        )
    if not degrees and largest * abs(column.scale) > 7:
        raise InputError(
            f"{source}: the header says radians, but the phases reach {largest:.4g}, more than a full turn; "
            "write theta (deg) in the header if they are degrees"
        )
    return column.scale


def to_impedance(
    pair: tuple[str, str], first: np.ndarray, second: np.ndarray, frequency: np.ndarray, source: str
) -> np.ndarray:
    """(n,) complex ohm from a pair of columns (n,) in SI (angles in radian) at frequencies (n,), Hz.

    Raises InputError where a magnitude is negative or an admittance is zero.
    """
    if pair in _LCR:
        with np.errstate(all="ignore"):  # zeros give infinities, which are refused
            values = _LCR[pair](2 * np.pi * frequency, first, second).astype(complex)
        if not np.all(np.isfinite(values)):
            raise InputError(
                f"{source}: {pair[0]} and {pair[1]} give no impedance at {int(np.sum(~np.isfinite(values)))} points, "
                "where one of them is zero; remove these points"
            )
        return values
    if pair[0].startswith("abs"):
        if np.any(first < 0):
            raise InputError(
                f"{source}: {int(np.sum(first < 0))} of {first.size} magnitudes are negative, the first is "
                f"{first[first < 0][0]:.6g}; are the columns of magnitude and phase exchanged?"
            )
        values = first * np.exp(1j * second)
    else:
        values = first + 1j * second
    if pair[0] in ("g", "abs_y"):
        if np.any(values == 0):
            raise InputError(f"{source}: {int(np.sum(values == 0))} admittances are zero; remove these points")
        with np.errstate(over="ignore", invalid="ignore"):  # the check for infinities refuses what overflows
            values = 1.0 / values
    return values
