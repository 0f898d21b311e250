"""The library of effects: every module here has `candidates(context)`; a new effect is a new file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module
from pkgutil import iter_modules

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter
from femu_piezo.errors import InputError
from femu_piezo.units import parse_quantity


def library(context: EffectContext) -> tuple[Effect, ...]:
    """Every candidate effect that makes sense for a specimen."""
    names = sorted(module.name for module in iter_modules(__path__))
    modules = [import_module(f"{__name__}.{name}") for name in names]
    return tuple(effect for module in modules for effect in module.candidates(context))


#: Frequencies of any sweep, Hz.
_ANY_BAND = (1.0, 1e9)
#: Key of an [effects.NAME] table: where a law over frequency is anchored.
REFERENCE = "reference_frequency"


def from_table(
    table: Mapping[str, Mapping[str, float | str]], context: EffectContext, where: str
) -> tuple[tuple[Effect, np.ndarray], ...]:
    """The effects of an [effects] table with their values: effect name → parameter name → SI number or "1 ohm".

    Raises InputError for an unknown effect or parameter, and for a missing one.
    """
    found: list[tuple[Effect, np.ndarray]] = []
    for name, values in table.items():
        left = dict(values)
        anchor = left.pop(REFERENCE, context.fundamental_Hz)
        at = replace(context, fundamental_Hz=parse_quantity(anchor, "Hz", f"{where}: effects.{name}.{REFERENCE}"))
        # a constant that is free now may have had an error before, and another sweep another band
        known = library(replace(at, free=(), band_Hz=_ANY_BAND))
        variants = [effect for effect in known if effect.name == name]
        if not variants:
            names = ", ".join(sorted({effect.name for effect in known}))
            raise InputError(f"{where}: effects.{name} is no effect that this specimen can have; known are {names}")
        for effect in variants:
            if {parameter.name for parameter in effect.parameters if not parameter.optional} <= set(left):
                given = [_value(p, left.pop(p.name, p.rest), where, name) for p in effect.parameters]
                found.append((effect, np.array(given)))
        if left or not values:
            words = "; or ".join(", ".join(f"{p.name} ({p.unit})" for p in effect.parameters) for effect in variants)
            raise InputError(f"{where}: effects.{name} has {sorted(left) or 'nothing'}; give {words}")
    return tuple(found)


def _value(parameter: EffectParameter, value: float | str, where: str, name: str) -> float:
    key = f"{where}: effects.{name}.{parameter.name}"
    number = parse_quantity(value, parameter.unit, key)
    if not parameter.low <= number <= parameter.high:
        reach = f"{parameter.low:g} … {parameter.high:g}{parameter.after_number}"
        raise InputError(f"{key} = {number:g} is outside {reach}")
    return number
