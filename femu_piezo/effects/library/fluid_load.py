"""Both faces are in air or in a liquid, which they shear and press.

    tangential   + jω (1 + j) κ √(ω/2) ∫ v_t·u_t dS,    κ = √(ρη): a shear wave that dies out within √(2η/(ρω))
    normal       + (jω R − ω² μ) ∫ v_n u_n dS

R in kg/(m² s) stands for radiated pressure waves: ρc (air 413, water 1.5e6) where the whole face moves in phase, less
where waves along the face are slower than those in the fluid, which then adds a mass μ (kg/m²) to each face. √(ρη) is
0.0047 in air, 1.0 in water, 5 to 30 in oils (Martin, Granstaff, Frye, Anal. Chem. 63 (1991) 2272, for shear waves).
"""

from __future__ import annotations

from functools import partial

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter, ExtraTerm
from femu_piezo.forward.electrodes import electrode_film

_TANGENTIAL, _NORMAL = (partial(electrode_film, directions=axes) for axes in ((0, 1), (2,)))


def _shear(omega: np.ndarray, p: np.ndarray):
    by_p = 1j * omega * (1 + 1j) * np.sqrt(omega / 2)
    return p[0] * by_p, by_p[:, None] * np.array([1.0, 0.0, 0.0])


def _pressure(omega: np.ndarray, p: np.ndarray):
    parts = np.stack([0 * omega, 1j * omega, -(omega**2)], axis=1)
    return parts @ p, parts


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For bodies with their electrodes on faces normal to z."""
    if context.poling != "thickness":
        return ()
    mass = context.density * context.thickness / 2
    return (
        Effect(
            name="fluid_load",
            sentence="a liquid or gas loads the faces: they shear and compress it as they vibrate",
            parameters=(
                EffectParameter("shear_load", "kg/(m^2 s^0.5)", 0.0, 1e3, 1.0, 10.0, law_error=0.05),
                EffectParameter("radiation", "kg/(m^2 s)", 0.0, 5e6, 1e4, 1e5, optional=True),
                EffectParameter("added_mass", "kg/m^2", 0.0, 0.2 * mass, 5e-3 * mass, 0.02 * mass, optional=True),
            ),
            confusable_with=("electrode_mass", "frequency_dependent_elastic_loss", "tan_s11"),
            advice=(
                "clean and dry the specimen, and sweep it again",
                "sweep it once more in vacuum: the load by the air disappears, the losses of the material remain",
            ),
            terms=(
                ExtraTerm("tangential film", "stiffness", None, _shear, on_electrodes=_TANGENTIAL),
                ExtraTerm("normal film", "stiffness", None, _pressure, on_electrodes=_NORMAL),
            ),
            dispersive=True,
        ),
    )
