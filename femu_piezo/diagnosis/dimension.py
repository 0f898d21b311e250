"""A relative error of one dimension: the body is (1 + p) times as long along one axis as the file says."""

from __future__ import annotations

import numpy as np

from femu_piezo.diagnosis.effect import Effect, EffectContext, EffectParameter

_CONFUSABLE = {
    "length": ("s11", "s33"),
    "width": ("eps33T", "wrong_insensitive_parameter"),
    "thickness": ("eps33T", "d31"),
}


def dimension_effect(name: str, context: EffectContext) -> tuple[Effect, ...]:
    """The effect wrong_NAME for a specimen that has such a dimension, else nothing."""
    if name not in context.axes:
        return ()
    axis = context.axes[name]

    def stretch(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 1 + p[0] * np.eye(3)[axis], np.eye(3)[:, axis : axis + 1]

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
