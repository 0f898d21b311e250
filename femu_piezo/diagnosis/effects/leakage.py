"""Surface conduction or a dirty fixture: Y' = Y + G."""

from __future__ import annotations

import numpy as np

from femu_piezo.diagnosis.effect import Effect, EffectContext, EffectParameter


def _circuit(omega: np.ndarray, z: np.ndarray, p: np.ndarray):
    ratio = 1 / (1 + p[0] * z)  # Z'/Z, and ∂Z'/∂Z = ratio²
    return z * ratio, ratio**2, (-((z * ratio) ** 2))[:, None]


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """Bounded by the admittance of the sweep itself; slightly negative values are faults of a compensation."""
    typical = 1 / context.impedance
    return (
        Effect(
            name="leakage",
            sentence="a conductance leaks parallel to the specimen (surface, moisture, fixture)",
            parameters=(EffectParameter("conductance", "S", -0.1 * typical, typical, 1e-3 * typical, 0.05 * typical),),
            confusable_with=("tan_eps33T", "dielectric_dispersion"),
            advice=(
                "measure at 100 Hz to 1 kHz, where a conductance outweighs the capacitance",
                "clean and dry the rim",
            ),
            circuit=_circuit,
        ),
    )
