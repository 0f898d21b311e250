"""A relative error of one dimension: the body is (1 + p) times as large along its axes as the file says."""

from __future__ import annotations

import numpy as np

from femu_piezo.diagnosis.effect import Effect, EffectContext, EffectParameter

_CONFUSABLE = {
    "length": ("s11", "s33"),
    "width": ("eps33T", "wrong_insensitive_parameter"),
    "thickness": ("eps33T", "d31"),
    "diameter": ("s11", "s12", "wrong_thickness"),
}


def dimension_effect(name: str, context: EffectContext) -> tuple[Effect, ...]:
    """The effect wrong_NAME for a specimen that has such a dimension, else nothing."""
    if name not in context.axes:
        return ()
    along = np.isin(np.arange(3), context.axes[name]).astype(float)

    def stretch(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 1 + p[0] * along, along[:, None]

    return (
        Effect(
            name=f"wrong_{name}",
            sentence=f"the {name} in the specimen file is not that of the specimen",
            parameters=(EffectParameter("relative_error", "1", -0.1, 0.1, 0.005, 0.02),),
            confusable_with=_CONFUSABLE[name],
            advice=(
                f"measure the {name} with a micrometer",
                "widen the band to the modes of the other dimensions",
                "measure a second specimen of the same material and other size: a constant is common to both",
            ),
            stretch=stretch,
        ),
    )
