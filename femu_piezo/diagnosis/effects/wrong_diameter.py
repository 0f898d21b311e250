"""The diameter in the specimen file is wrong by a relative error; all radii go with it."""

from __future__ import annotations

from femu_piezo.diagnosis.dimension import dimension_effect
from femu_piezo.diagnosis.effect import Effect, EffectContext


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """The dimension `diameter`, where the specimen has one of that name."""
    return dimension_effect("diameter", context)
