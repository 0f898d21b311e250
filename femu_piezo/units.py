"""Quantities as people write them ("40 mm", "3400 eps0") to plain SI numbers, and numbers as tables show them.

Only units that occur in specimen files are known. Their registry has no offset units, and is loaded only when a string
has a unit that is not in `USUAL`.
"""

from __future__ import annotations

import difflib
import math
import re
from decimal import Decimal
from functools import cache, lru_cache
from numbers import Integral, Real
from typing import TYPE_CHECKING

from femu_piezo.errors import InputError

if TYPE_CHECKING:
    from pint import UnitRegistry

EPS0 = 8.854187817e-12
"""Electric constant, F/m, with the digits used by Cong et al. (2022)."""

_LONGEST_QUANTITY = 80
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_FACTOR = r"[A-Za-zµΩ°%]+0?(?:\^[+-]?\d)?"
_UNIT = re.compile(rf"(?:1?\s*/\s*)?{_FACTOR}(?:\s*[*/ ]\s*{_FACTOR})*")

_PREFIXES = "pico- = 1e-12 = p-|nano- = 1e-9 = n-|micro- = 1e-6 = µ- = u-|milli- = 1e-3 = m-|centi- = 1e-2 = c-|"
_PREFIXES += "kilo- = 1e3 = k-|mega- = 1e6 = M-|giga- = 1e9 = G-|tera- = 1e12 = T-|femto- = 1e-15 = f-"
_UNITS = (
    "meter = [length] = m = metre",
    "gram = [mass] = g",
    "second = [time] = s",
    "minute = 60 * second = min",
    "ampere = [current] = A",
    "inch = 0.0254 * meter = in",
    "tonne = 1000 * kilogram = t",
    "litre = 1e-3 * meter ** 3 = L = liter",
    "hertz = 1 / second = Hz",
    "newton = kilogram * meter / second ** 2 = N",
    "pascal = newton / meter ** 2 = Pa",
    "coulomb = ampere * second = C",
    "volt = newton * meter / coulomb = V",
    "farad = coulomb / volt = F",
    "ohm = volt / ampere = Ω = Ohm",
    "siemens = ampere / volt = S",
    "henry = volt * second / ampere = H",
    f"vacuum_permittivity = {EPS0!r} * farad / meter = eps0",
    "percent = 0.01 = %",
    "radian = [] = rad",
    "kelvin = [temperature] = K",
    "degree = 0.017453292519943295 * radian = deg = °",
)
_NAMES = (
    "mm",
    "cm",
    "m",
    "µm",
    "um",
    "kg",
    "g",
    "Hz",
    "kHz",
    "MHz",
    "Pa",
    "GPa",
    "N",
    "pC",
    "C",
    "F",
    "eps0",
    "Ohm",
    "mrad",
    "deg",
)

_EXAMPLES = {
    "m": '"40 mm"',
    "kg/m^3": '"7900 kg/m^3"',
    "Hz": '"90 kHz"',
    "m^2/N": '"16.5e-12 m^2/N"',
    "C/N": '"-255 pC/N"',
    "F/m": '"3400 eps0"',
    "ohm": '"20 mohm"',
    "H": '"10 nH"',
    "F": '"0.1 pF"',
    "rad": '"0.8 mrad"',
    "kg": '"1.580 g"',
    "V": '"0.5 V"',
    "s": '"5 min"',
    "1": '0.01 or "1 %"',
}


#: Units of most files: (unit, SI unit) → factor; the registry gives the same ones (tests/units/test_units.py).
USUAL = {
    ("m", "m"): Decimal("1"),
    ("cm", "m"): Decimal("1e-2"),
    ("mm", "m"): Decimal("1e-3"),
    ("µm", "m"): Decimal("1e-6"),
    ("um", "m"): Decimal("1e-6"),
    ("kg/m^3", "kg/m^3"): Decimal("1"),
    ("g/cm^3", "kg/m^3"): Decimal("1e3"),
    ("kg", "kg"): Decimal("1"),
    ("g", "kg"): Decimal("1e-3"),
    ("mg", "kg"): Decimal("1e-6"),
    ("Hz", "Hz"): Decimal("1"),
    ("kHz", "Hz"): Decimal("1e3"),
    ("MHz", "Hz"): Decimal("1e6"),
    ("pC/N", "C/N"): Decimal("1e-12"),
    ("eps0", "F/m"): Decimal(repr(EPS0)),
    ("pF", "F"): Decimal("1e-12"),
    ("nH", "H"): Decimal("1e-9"),
    ("ohm", "ohm"): Decimal("1"),
    ("V", "V"): Decimal("1"),
    ("%", "1"): Decimal("1e-2"),
}


def parse_quantity(value: object, unit: str, where: str) -> float:
    """The SI value of a quantity with the dimension of `unit`.

    Parameters
    ----------
    value : a plain number (SI), or a string: a number, or a number with a unit such as "40 mm"
    unit : the SI unit the result is in, e.g. "m", "kg/m^3", "F/m"; "1" for a pure number
    where : file and key, for the error message

    Returns
    -------
    float, in `unit`

    Raises
    ------
    InputError : not a number, not finite, an unknown unit, or a unit of another dimension

    >>> parse_quantity("40 mm", "m", "plate.toml: geometry.length")
    0.04
    """
    right = f"give a number in {unit}" if unit != "1" else "give a pure number"
    if unit in _EXAMPLES:
        right += f" or a string such as {_EXAMPLES[unit]}" if unit != "1" else f" such as {_EXAMPLES[unit]}"
    if isinstance(value, bool) or not isinstance(value, (Real, str)):
        raise InputError(f"{where}: {shown(value)} is not a quantity; {right}")
    if not isinstance(value, str):
        return _finite(value, value, where, right)
    text = value.strip().replace("μ", "µ").replace("Ω", "Ω")  # the other two code points of micro and ohm
    number = _NUMBER.match(text) if len(text) <= _LONGEST_QUANTITY else None
    if number is None:
        raise InputError(f"{where}: {shown(value)} does not begin with a number; {right}")
    unit_text = text[number.end() :].strip()
    factor = _factor(unit_text, value, unit, where, right) if unit_text else 1
    _finite(number.group(), value, where, right)
    magnitude = Decimal(number.group())
    result = _finite(magnitude * factor, value, where, right)
    if result == 0 and magnitude != 0:
        raise InputError(f"{where}: {shown(value)} is too small to be represented; {right}")
    return result


def _finite(number: float | str | Decimal, value: object, where: str, right: str) -> float:
    """`number` as a finite float."""
    try:
        result = float(number)
    except OverflowError:
        result = math.inf
    if not math.isfinite(result):
        raise InputError(f"{where}: {shown(value)} is not a finite number; {right}")
    return result


def _factor(unit_text: str, value: object, unit: str, where: str, right: str) -> Decimal:
    """The number of SI `unit` in one `unit_text`."""
    if unit_text.startswith((",", "_")):
        raise InputError(f"{where}: {shown(value)} is not a number; write a decimal point and no separators")
    plain = unit_text.replace("**", "^").replace("²", "^2").replace("³", "^3").replace("·", "*")
    plain = re.sub(r"(?<![A-Za-zµ])([munpckfµ]?m)([23])(?!\d)", r"\1^\2", plain)  # m2, mm3 as many people write them
    if not _UNIT.fullmatch(plain):
        raise InputError(f"{where}: {shown(value)} has no unit that can be read; {right}")
    if plain.startswith("/"):
        plain = "1" + plain
    if (plain, unit) in USUAL:
        return USUAL[plain, unit]
    import pint

    try:
        factor = _converted(plain, unit)
    except pint.UndefinedUnitError:
        registry = _registry()
        unknown = [name for name in re.findall(r"[A-Za-zµΩ°%]+0?", plain) if name not in registry]
        names = [name for name in _NAMES if [plain] != unknown or _converted(name, unit) is not None]
        near = [name for name in names if unknown and name.lower() == unknown[0].lower()]
        close = difflib.get_close_matches(unknown[0], names, len(_NAMES), 0.3) if unknown else []
        near = near or [name for name in names if name in close][:3]
        hint = f"did you mean {' or '.join(map(repr, near))}?" if near else right
        raise InputError(f"{where}: the unit of {shown(value)} is not known; {hint}") from None
    if factor is None:
        raise InputError(f"{where}: {shown(value)} has the wrong dimension; {right}")
    return factor


@lru_cache(maxsize=256)
def _converted(plain: str, unit: str) -> Decimal | None:
    """The number of SI `unit` in one `plain`, None where their dimensions differ; cached, as files repeat units.

    Raises pint.UndefinedUnitError.
    """
    registry = _registry()
    given = registry.parse_units(plain)
    target = registry.parse_units(unit) if unit != "1" else registry.dimensionless
    if given.dimensionality != target.dimensionality:
        return None
    return Decimal(registry.Quantity(Decimal(1), given).to(target).magnitude)


@cache
def _registry() -> UnitRegistry:
    """The units of specimen files, nothing else (pint is imported here, at first use)."""
    import pint

    registry = pint.UnitRegistry(None, non_int_type=Decimal)  # exact: 7.9 g/cm^3 is 7900 kg/m^3 to the last bit
    for definition in (*_PREFIXES.split("|"), *_UNITS):
        registry.define(definition)
    return registry


def hertz(frequency: float) -> str:
    """A frequency in Hz to six digits, without a power of ten.

    >>> hertz(70934.787), hertz(1011990.6)
    ('70934.8', '1011991')
    """
    return f"{frequency:.6g}" if abs(frequency) < 999999.5 else f"{frequency:.0f}"


def two_hertz(band: object, where: str) -> tuple[float, float]:
    """Both ends of a band given in Python, Hz; InputError where they are not two numbers."""
    try:
        low, high = map(float, band)  # type: ignore[call-overload]
    except (TypeError, ValueError):
        raise InputError(f"{where}: {shown(band)} is no band; give bands as (low, high) in Hz") from None
    return low, high


def real_number(value: object, name: str) -> float:
    """A number given in Python; InputError where it is none."""
    if not isinstance(value, Real):
        raise InputError(f"{name} = {shown(value)} is not a number; give one without a unit")
    return float(value)


def whole_number(value: object, name: str) -> int:
    """A count given in Python; InputError where it is no integer."""
    if not isinstance(value, Integral):
        raise InputError(f"{name} = {shown(value)} is not a whole number; give one such as 50")
    return int(value)


def shown(value: object) -> str:
    """`value` for a message, cut to a readable length."""
    if isinstance(value, int) and value.bit_length() > 1000:
        return f"an integer of {value.bit_length()} bits"
    text = f'"{value}"' if isinstance(value, str) and value.isprintable() else repr(value)
    return text if len(text) <= 60 else text[:57] + "…"


def number(value: float, std: float | None) -> str:
    """Value ± standard deviation, to the second digit of the deviation; the value alone, to eight digits, where the
    deviation is below 1e-7 of it, and to six where there is none. A value that is rounded to zero has no sign."""
    if std is None or not std > 0:
        return f"{value:z.6g}"
    if std < 1e-7 * abs(value):
        return f"{value:.8g}"
    digits = decimals(std)
    return f"{value:z.{digits}f} ± {std:.{digits}f}"


def decimals(std: float) -> int:
    """Decimals of a value down to the second digit of its deviation."""
    return max(0, -int(f"{std:.1e}".split("e")[1]) + 1)


def signed(value: float, form: str) -> str:
    """A difference with its sign, in a format such as ".2f"; without one where it is rounded to zero.

    >>> signed(0.0123, ".2f"), signed(-0.004, ".2f")
    ('+0.01', '0.00')
    """
    text = f"{value:z{form}}"
    return text if text.startswith("-") or not float(text) else f"+{text}"


#: °C that a specimen may have, and 0 °C in K.
_TEMPERATURES, _ZERO_CELSIUS = (-273.0, 1000.0), 273.15
_TEMPERATURE = re.compile(rf"({_NUMBER.pattern})\s*(°C|degC|C|K)")


def parse_temperature(value: object, where: str) -> float:
    """A temperature, °C: a plain number in °C, or a string such as "25 °C", "25 degC" or "298 K".

    where : file and key, for the error message

    Raises
    ------
    InputError : no number, another unit, or a temperature that no specimen can have

    >>> parse_temperature("300 K", "plate.toml: sweep.temperature")
    26.85
    """
    right = 'give a number in °C or a string such as "25 °C"'
    number, unit = value, "°C"
    if isinstance(value, str):
        found = _TEMPERATURE.fullmatch(value.strip())
        if found is None:
            raise InputError(f"{where}: {shown(value)} is not a temperature; {right}")
        number, unit = float(found[1]), found[2]
    if isinstance(number, bool) or not isinstance(number, (int, float)):
        raise InputError(f"{where}: {shown(value)} is not a temperature; {right}")
    celsius = round(number - _ZERO_CELSIUS, 9) if unit == "K" else number
    if not _TEMPERATURES[0] <= celsius <= _TEMPERATURES[1]:
        low, high = _TEMPERATURES
        raise InputError(f"{where}: {shown(value)} is outside {low:g} … {high:g} °C; {right}")
    return float(celsius)
