"""Leads as an inductance: Z' = Z + jωL."""

from __future__ import annotations

import numpy as np

from femu_piezo.diagnosis.effect import Effect, EffectContext, EffectParameter


def _circuit(omega: np.ndarray, z: np.ndarray, p: np.ndarray):
    return z + 1j * omega * p[0], np.ones_like(z), 1j * omega[:, None]


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """Either sign: a fixture compensation can take away too much."""
    return (
        Effect(
            name="series_inductance",
            sentence="the leads have a series inductance that was not compensated",
            parameters=(EffectParameter("inductance", "H", -1e-2, 1e-2, 1e-6, 2e-5),),
            confusable_with=("series_resistance", "dielectric_dispersion"),
            advice=("measure with a four-wire fixture after a short-circuit compensation",),
            circuit=_circuit,
        ),
    )
