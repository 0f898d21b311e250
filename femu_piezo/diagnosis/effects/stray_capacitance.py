"""Cable and fixture across the terminals: Y' = Y + jωC."""

from __future__ import annotations

import numpy as np

from femu_piezo.diagnosis.effect import Effect, EffectContext, EffectParameter


def _circuit(omega: np.ndarray, z: np.ndarray, p: np.ndarray):
    ratio = 1 / (1 + 1j * omega * p[0] * z)  # Z'/Z, and ∂Z'/∂Z = ratio²
    return z * ratio, ratio**2, (-1j * omega * (z * ratio) ** 2)[:, None]


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """Bounded by three times the admittance of the sweep itself."""
    typical = 1 / (2 * np.pi * context.fundamental_Hz * context.impedance)
    return (
        Effect(
            name="stray_capacitance",
            sentence="cable or fixture add a capacitance parallel to the specimen",
            parameters=(
                EffectParameter("capacitance", "F", -0.5 * typical, 3 * typical, 0.01 * typical, 0.1 * typical),
            ),
            confusable_with=("eps33T",),
            advice=(
                "measure the open fixture without the specimen and compensate it",
                "measure a second specimen of the same material and other size: ε33T scales with it, a stray "
                "capacitance does not",
            ),
            circuit=_circuit,
        ),
    )
