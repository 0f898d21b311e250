"""The size of an effect in words: a value with a unit that fits it."""

from __future__ import annotations

import math
import re

import numpy as np

from femu_piezo.effects.effect import Effect, EffectParameter
from femu_piezo.specimen.file import CONSTANTS
from femu_piezo.units import number

_SHARES = {"relative_error", "fall_per_decade"}  # pure numbers that are read as per cent
_UNITS = {"ohm": ("Ω", 1.0), "kg": ("g", 1e3), "kg/m^2": ("g/m²", 1e3), "1": ("", 1.0)}
_PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
#: A unit whose first symbol may have a prefix: no kg, which has one, and no power, which a prefix would share.
_WITH_PREFIX = re.compile(r"(?!kg)[A-Za-zΩ]+(?![A-Za-zΩ²³^])")
#: Sizes in any other unit that are written without a power of ten.
_PLAIN = (1e-3, 1e4)
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def quantity(parameter: EffectParameter, value: float, std: float | None = None) -> str:
    """A parameter of an effect with its deviation, in a readable unit."""
    return readable(parameter.name, parameter.unit, value, std)


def readable(name: str, si_unit: str, value: float, std: float | None = None) -> str:
    """The same of a parameter by its name and SI unit."""
    if si_unit == "1" and (name in _SHARES or name in CONSTANTS):
        return f"{number(100 * value, None if std is None else 100 * std)} %"
    unit, factor = _UNITS.get(si_unit, (re.sub(r"\^([23])(?!\d)", _superscript, si_unit), 1.0))
    size = factor * max(abs(value), std or 0.0)
    thousands = 3 * math.floor(math.log10(size) / 3) if size > 0 else 0
    power = ""
    if _WITH_PREFIX.match(unit):
        thousands = min(max(thousands, -12), 9)
        unit = _PREFIXES[thousands] + unit
    elif unit == "1/F":
        thousands = min(max(thousands, -9), 12)
        unit = f"1/{_PREFIXES[-thousands]}F"
    elif not unit or _PLAIN[0] <= size < _PLAIN[1]:
        thousands = 0
    elif thousands:
        power = f"·10{str(thousands).translate(_RAISED)}"
    factor *= 10.0**-thousands
    text = number(factor * value, None if std is None else factor * std)
    return f"({text}){power} {unit}" if unit and "±" in text else f"{text}{power} {unit}".strip()


def sizes(effect: Effect, values: np.ndarray, std: np.ndarray) -> str:
    """All parameters of an effect with their names."""
    found = zip(effect.parameters, values, std, strict=True)
    return ", ".join(f"{p.name.replace('_', ' ')} {quantity(p, float(v), float(s))}" for p, v, s in found)


def usual_size(parameter: EffectParameter) -> str:
    """The usual size of an effect, to two digits."""
    return quantity(parameter, float(f"{parameter.usual:.2g}"))


def _superscript(power: re.Match[str]) -> str:
    return power[1].translate(_RAISED)
