"""The library of effects: a list of functions of an `EffectContext`, the `candidates` of every module here.

    for make in library: ...        diagnose(specimen, effects=[*library, mine])

A new effect is a new file, or from outside one more function in such a list.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from importlib import import_module
from inspect import signature
from pkgutil import iter_modules
from types import ModuleType

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter
from femu_piezo.errors import InputError
from femu_piezo.units import parse_quantity, parse_temperature, shown

#: Entry of a list of effects: an effect, or a function that makes those that a specimen may have (one, several, none).
Maker = Effect | Callable[[EffectContext], Effect | Iterable[Effect] | None]

#: `candidates` of every module of this package, in the order of their names.
makers: tuple[Maker, ...] = tuple(
    import_module(f"{__name__}.{name}").candidates for name in sorted(module.name for module in iter_modules(__path__))
)


class _Library(ModuleType):
    """This package, which can be used as the list of its makers."""

    def __iter__(self) -> Iterator[Maker]:
        return iter(makers)

    def __len__(self) -> int:
        return len(makers)

    def __getitem__(self, index: int) -> Maker:
        return makers[index]


sys.modules[__name__].__class__ = _Library


def library(context: EffectContext) -> tuple[Effect, ...]:
    """Every effect of the library that a specimen may have."""
    return effects_of(context, makers)


def effects_of(context: EffectContext, offered: Iterable[Maker]) -> tuple[Effect, ...]:
    """The effects of a list that a specimen may have.

    Raises InputError where an entry is neither an `Effect` nor a function of an `EffectContext` that returns some.
    """
    found: list[Effect] = []
    for maker in offered:
        if not (isinstance(maker, Effect) or callable(maker)):
            raise InputError(
                f"effects: {maker!r} is no effect; give an Effect, or a function of an EffectContext that returns some"
            )
        made = maker if isinstance(maker, Effect) else _made(maker, context)
        several = (made,) if isinstance(made, Effect) or not isinstance(made, Iterable) else tuple(made)
        if strange := [one for one in several if not isinstance(one, Effect)]:
            raise InputError(f"effects: {_named(maker)} returns {strange[0]!r}, which is no Effect")
        found += several
    return tuple(found)


def _made(maker: Callable[[EffectContext], Effect | Iterable[Effect] | None], context: EffectContext):
    """What a function makes of a context; InputError where it does not take one."""
    try:
        return maker(context) or ()
    except TypeError:
        try:
            signature(maker).bind(context)
        except TypeError:
            raise InputError(f"effects: {_named(maker)} must take one argument, an EffectContext") from None
        raise


def _named(maker: Maker) -> str:
    return getattr(maker, "__name__", repr(maker))


def listed(offered: Iterable[Maker] | Maker) -> tuple[Maker, ...]:
    """The entries of a list of effects, or a single entry; InputError where it is neither."""
    if not (callable(offered) or isinstance(offered, Iterable | Effect)):
        raise InputError(f"effects: {offered!r} is no list of effects; give one, such as [*femu_piezo.effects.library]")
    return (offered,) if isinstance(offered, Effect) or callable(offered) else tuple(offered)


def with_library(offered: Iterable[Maker] | Maker | None) -> tuple[Maker, ...]:
    """A list of effects, then those of the library that it lacks; the library alone where the list is None."""
    return makers if offered is None else tuple(dict.fromkeys((*listed(offered), *makers)))


#: Most characters of a list in a message.
_LONGEST = 60
#: Frequencies of any sweep, Hz.
_ANY_BAND = (1.0, 1e9)
#: Title of a table about an effect of one of several fixtures: NAME (FIXTURE).
_OF_FIXTURE = re.compile(r"(?P<name>[^ ]+) \((?P<fixture>.+)\)")
#: Keys of an [effects.NAME] table: the frequency at which a law is anchored, the temperature, °C, from which one over
#: temperature counts (the mean of the sweeps where there is none), and the parameters that every fit estimates.
REFERENCE, TEMPERATURE, FREE = "reference_frequency", "reference_temperature", "free"


def from_table(
    table: Mapping[str, Mapping[str, float | str]],
    context: EffectContext,
    where: str,
    offered: Iterable[Maker] = makers,
    kind: str = "effects",
) -> tuple[tuple[Effect, np.ndarray], ...]:
    """The effects of an [effects] table with their values: effect name → parameter name → SI number or "1 ohm".

    Those with a parameter that `free` names are unknowns of every fit (`Effect.within_spread`). Tables of fixtures that
    the sweep did not use are skipped.

    offered : the effects that are known by name;  kind : name of the table in messages

    Raises InputError for an unknown effect or parameter, and for a missing one.
    """
    found: list[tuple[Effect, np.ndarray]] = []
    for title, values in table.items():
        split = _OF_FIXTURE.fullmatch(title)
        name, fixture = (split["name"], split["fixture"]) if split else (title, "")
        if fixture not in ("", context.conditions.fixture):
            continue
        unread = dict(values)
        free = unread.pop(FREE, ())
        anchor = unread.pop(REFERENCE, context.fundamental_Hz)
        at = replace(context, fundamental_Hz=parse_quantity(anchor, "Hz", f"{where}: {kind}.{name}.{REFERENCE}"))
        if TEMPERATURE in unread:
            reference = parse_temperature(unread.pop(TEMPERATURE), f"{where}: {kind}.{name}.{TEMPERATURE}")
            at = replace(at, conditions=context.conditions.above(reference))
        # the file may state an error of a constant that is free now, or an effect of a sweep over another band
        known = effects_of(replace(at, free=(), band_Hz=_ANY_BAND), offered)
        variants = [effect for effect in known if effect.name == name]
        if not variants:
            names = ", ".join(sorted({effect.name for effect in known}))
            raise InputError(f"{where}: {kind}.{name} is no effect that this specimen can have; use one of {names}")
        if not isinstance(free, tuple) or not set(free) <= set(values):
            raise InputError(
                f"{where}: {kind}.{name}.{FREE} = {_as_written(free)} is no list of parameters of its table, such as "
                f"{_as_written([key for key in values if key not in (FREE, REFERENCE, TEMPERATURE)])}"
            )
        for effect in variants:
            if {parameter.name for parameter in effect.parameters if not parameter.optional} <= set(unread):
                key = f"{where}: {kind}.{name}"
                given = [_value(p, unread.pop(p.name, p.rest), f"{key}.{p.name}") for p in effect.parameters]
                asked = any(parameter.name in free for parameter in effect.parameters)
                effect = replace(effect, owner=fixture)
                found.append((effect.within_spread if asked else effect, np.array(given)))
        if unread or not values:
            words = "; or ".join(", ".join(f"{p.name} ({p.unit})" for p in effect.parameters) for effect in variants)
            keys = ", ".join(sorted(unread)) or "no parameters"
            raise InputError(f"{where}: {kind}.{name} cannot be made from {keys}; give {words}")
    return tuple(found)


def _as_written(value: object) -> str:
    """A value for a message, a list as the specimen file has it: ["resistance"]."""
    if not isinstance(value, (list, tuple)):
        return shown(value)
    text = f"[{', '.join(map(shown, value))}]"
    return text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"


def _value(parameter: EffectParameter, value: float | str, key: str) -> float:
    number = parse_quantity(value, parameter.unit, key)
    if not parameter.low <= number <= parameter.high:
        reach = f"{parameter.low:g} … {parameter.high:g}{parameter.after_number}"
        raise InputError(f"{key} = {number:g} is outside {reach}")
    return number
