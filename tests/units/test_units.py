"""Quantities with units: exact values, properties, and one sentence for everything that is no quantity."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from femu_piezo import units
from femu_piezo.errors import InputError
from femu_piezo.units import EPS0, number, parse_quantity, signed

NUMBERS = st.floats(min_value=-1e12, max_value=1e12, allow_nan=False).filter(lambda x: x == 0 or abs(x) > 1e-12)


@pytest.mark.parametrize(
    ("value", "unit", "si"),
    [
        ("40 mm", "m", 0.04),
        ("40mm", "m", 0.04),
        ("0.5 in", "m", 0.0127),
        ("35 µm", "m", 35e-6),
        ("35 μm", "m", 35e-6),
        ("7900 kg/m^3", "kg/m^3", 7900.0),
        ("7900 kg/m3", "kg/m^3", 7900.0),
        ("7.9 g/cm³", "kg/m^3", 7900.0),
        ("3400 eps0", "F/m", 3400 * EPS0),
        ("30 nF/m", "F/m", 30e-9),
        ("16.5e-12", "m^2/N", 16.5e-12),
        ("16.5e-12 m^2/N", "m^2/N", 16.5e-12),
        ("16.5 1/TPa", "m^2/N", 16.5e-12),
        ("-255 pC/N", "C/N", -255e-12),
        ("-255 pm/V", "C/N", -255e-12),
        ("90 kHz", "Hz", 9e4),
        ("0.1 %", "1", 1e-3),
        ("5 min", "s", 300.0),
        ("300 s", "s", 300.0),
        (40, "m", 40.0),
        (0.04, "m", 0.04),
        (np.float32(0.5), "m", 0.5),
        (np.int64(40), "m", 40.0),
    ],
)
def test_known_quantities(value: object, unit: str, si: float) -> None:
    assert parse_quantity(value, unit, "here") == pytest.approx(si, rel=1e-15, abs=0)


@pytest.mark.parametrize(
    ("value", "unit", "told"),
    [
        ("40 kg", "m", "dimension"),
        ("3 mm^-1", "m", "dimension"),
        ("40 min", "m", "dimension"),
        ("40 MM", "m", "did you mean 'mm'?"),
        ("30 mn", "m", "did you mean 'mm' or 'cm' or 'm'?"),
        ("8 kk/m^3", "kg/m^3", "did you mean 'kg'"),
        ("7800 foo", "kg/m^3", 'give a number in kg/m^3 or a string such as "7900 kg/m^3"'),
        ("3 foo", "C/N", "give a number in C/N"),
        ("20 degC", "m", "not known"),
        ("40,5 mm", "m", "decimal point"),
        ("1_000 mm", "m", "separators"),
        ("1e400 mm", "m", "finite"),
        ("1e999999999 mm", "m", "finite"),
        ("1e308 Tm", "m", "finite"),
        (math.inf, "m", "finite"),
        (10**4000, "m", "finite"),
        ("nan", "m", "number"),
        ("1e-400 mm", "m", "too small"),
        ("1e-320 fm", "m", "too small"),
        ("mm", "m", "number"),
        ("", "m", "number"),
        ("9" * 1000, "m", "number"),
        ("1 mm*__import__('os').system('true')", "m", "unit"),
        ("2 m^9^9^9", "m", "unit"),
        (True, "m", "quantity"),
        (None, "m", "quantity"),
        ([1, 2], "m", "quantity"),
    ],
)
def test_wrong_quantities_are_refused_in_one_sentence(value: object, unit: str, told: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_quantity(value, unit, "plate.toml: geometry.length")
    message = str(caught.value)
    assert message.startswith("plate.toml: geometry.length: ")
    assert told in message
    assert "\n" not in message
    assert len(message) < 220


@given(NUMBERS)
def test_a_string_without_a_unit_is_the_number_itself(number: float) -> None:
    assert parse_quantity(repr(number), "m", "here") == number
    assert parse_quantity(number, "m", "here") == number


@given(NUMBERS, st.sampled_from([("mm", 1e3), ("cm", 1e2), ("um", 1e6), ("km", 1e-3)]))
def test_prefixes_scale(number: float, prefix: tuple[str, float]) -> None:
    in_metres = parse_quantity(f"{number!r} {prefix[0]}", "m", "here")
    assert in_metres * prefix[1] == pytest.approx(number, rel=1e-15, abs=0)


@given(st.one_of(st.text(max_size=100), st.text(alphabet="0123456789.eE+-*/^ mkgNeps0()", max_size=30)))
def test_any_text_is_a_finite_number_or_an_input_error(text: str) -> None:
    for unit in ("m", "F/m", "1"):
        try:
            assert math.isfinite(parse_quantity(text, unit, "here"))
        except InputError as error:
            assert "here: " in str(error)


@pytest.mark.parametrize("usual", units.USUAL)
def test_usual_units_are_those_of_the_registry(usual: tuple[str, str]) -> None:
    assert units.USUAL[usual] == units._converted(*usual)


def test_plain_numbers_and_usual_units_do_not_load_the_units_library() -> None:
    code = (
        "import sys; from femu_piezo.units import parse_quantity; parse_quantity('16.5e-12', 'm^2/N', '');"
        "parse_quantity('40 mm', 'm', '');"
        "assert 'pint' not in sys.modules; parse_quantity('2 in', 'm', ''); assert 'pint' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (-0.004, 12.0, "0 ± 12"),
        (-1e-9, 0.005, "0.0000 ± 0.0050"),
        (-0.0, None, "0"),
        (-0.0123, 0.0004, "-0.01230 ± 0.00040"),
        (3400.0, None, "3400"),
    ],
)
def test_a_number_that_is_rounded_to_zero_has_no_sign(value, std, text):
    assert number(value, std) == text


def test_a_difference_has_a_sign_unless_it_is_rounded_to_zero():
    assert [signed(x, ".0f") for x in (-0.3, 0.0, 0.3, 0.6, -2.0)] == ["0", "0", "0", "+1", "-2"]
    assert signed(-0.004, ".2f") == "0.00" and signed(2.2e-5, ".2g") == "+2.2e-05"
