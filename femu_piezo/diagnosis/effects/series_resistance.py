"""Leads and contacts: Z' = Z + R."""

from __future__ import annotations

import numpy as np

from femu_piezo.diagnosis.effect import Effect, EffectContext, EffectParameter


def _circuit(omega: np.ndarray, z: np.ndarray, p: np.ndarray):
    return z + p[0], np.ones_like(z), np.ones((z.size, 1), dtype=complex)


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """Either sign: a fixture compensation can take away too much."""
    return (
        Effect(
            name="series_resistance",
            sentence="the leads or contacts have a series resistance that was not compensated",
            parameters=(EffectParameter("resistance", "ohm", -1e5, 1e5, 1.0, 20.0),),
            confusable_with=("tan_s11", "tan_eps33T"),
            advice=("measure with a four-wire fixture after a short-circuit compensation",),
            circuit=_circuit,
        ),
    )
