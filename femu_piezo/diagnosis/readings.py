"""Direct readings of what an effect changes: what to do, and slopes of the reading in the effect's parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext
from femu_piezo.inference.coefficients import Active
from femu_piezo.inference.readings import Reading as FittedReading

#: Effect of the fixture → what to read, how exactly, and the σ of such a reading in SI.
_FIXTURE = {
    "stray_capacitance": ("measure the open fixture without the specimen", "0.05 pF", 5e-14),
    "series_resistance": ("measure the shorted fixture", "0.02 ohm", 0.02),
    "series_inductance": ("measure the shorted fixture", "10 nH", 1e-8),
    "leakage": ("measure the insulation resistance at dc", "10 nS", 1e-8),
}
#: Relative σ of a length by micrometer, and of a mass by balance.
_MICROMETER, _BALANCE = 1e-3, 1e-3

#: What to do, and (effect name, its owner) → (n,) slope of the reading over its σ.
Reading = tuple[str, dict[tuple[str, str], np.ndarray]]


def readings(effects: Sequence[Effect], contexts: dict[str, EffectContext]) -> list[Reading]:
    """Every direct reading that tells about one of the effects.

    contexts : name of a specimen, as in `Effect.owner` → what is known of it
    """
    found: list[Reading] = []
    for effect in effects:
        key = (effect.name, effect.owner)
        if effect.name in _FIXTURE:
            words, exactly, std = _FIXTURE[effect.name]
            fixture = f" ({effect.owner})" if effect.owner else ""
            found.append((f"{words}{fixture}, to {exactly}", {key: np.eye(1, len(effect.parameters))[0] / std}))
        elif effect.resizes:
            dimension = effect.name.removeprefix("wrong_").replace("_", " ")
            words = f"measure the {dimension}{_whose(effect)} with a micrometer, to 0.1 %"
            found.append((words, {key: np.array([1 / _MICROMETER])}))
    for name, context in contexts.items():
        if context.density_from_mass:  # it was weighed, and what it weighs says nothing of its dimensions
            continue
        of_specimen = [effect for effect in effects if effect.owner == name]
        slopes = {(effect.name, name): slope for effect in of_specimen if (slope := _mass(effect, context)) is not None}
        if slopes:
            found.append((f"weigh the specimen{f' {name}' if name else ''}, to 0.1 %", slopes))
    unique = dict.fromkeys(words for words, _ in found)
    return [next(reading for reading in found if reading[0] == words) for words in unique]


def _whose(effect: Effect) -> str:
    return f" of {effect.owner}" if effect.owner else ""


def _mass(effect: Effect, context: EffectContext) -> np.ndarray | None:
    """(n,) relative change of the specimen's mass per SI unit of each parameter, over the σ of a weighing.

    None where the effect does not change the mass.
    """
    mass = context.mass or context.density  # shares of the mass of films and dimensions are the same for any volume
    volume, count = mass / context.density, len(effect.parameters)
    weighed = FittedReading("mass", mass, _BALANCE * mass, "", context.density, volume, volume / context.thickness)
    _, slopes = weighed.mass([Active(effect, effect.rest, slice(0, count))], count)
    return slopes / effect.scale / weighed.std if np.any(slopes) else None
