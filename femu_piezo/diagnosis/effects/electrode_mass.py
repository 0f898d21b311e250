"""A heavy film on both electroded faces: −ω² μ ∫ v·u dS, μ in kg/m² on each face."""

from __future__ import annotations

import numpy as np

from femu_piezo.diagnosis.effect import Effect, EffectContext, EffectParameter, ExtraTerm
from femu_piezo.forward.electrodes import electrode_film


def _mass(omega: np.ndarray, p: np.ndarray):
    return np.full(omega.shape, p[0], dtype=complex), np.ones((omega.size, 1), dtype=complex)


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """Bounded by a fifth of the specimen's own mass per area and face."""
    own = context.density * context.thickness / 2
    return (
        Effect(
            name="electrode_mass",
            sentence="the electrodes are heavy: a film of mass on both faces",
            parameters=(EffectParameter("mass_per_area", "kg/m^2", -0.02 * own, 0.2 * own, 0.005 * own, 0.05 * own),),
            confusable_with=("wrong_length", "s11"),
            advice=("weigh the specimen and compare with density × volume", "measure the thickness of the electrodes"),
            terms=(ExtraTerm("film", "inertia", electrode_film, _mass, (0.02 * own,)),),
        ),
    )
