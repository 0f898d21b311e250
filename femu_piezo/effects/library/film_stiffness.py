"""An elastic layer with loss on both faces: solder, glue, a thick electrode, a film of polymer.

A layer that is thin against the wavelength is a membrane in plane stress (Poisson's ratio 0.35):

    A + D (1 + jη) ∫ ε_xx² + ε_yy² + 2ν ε_xx ε_yy + (1 − ν)/2 γ_xy² dS,    D = E h/(1 − ν²),

over both faces, D in N/m of each. Time is e^(+jωt), so a loss has η > 0. A layer that is stiff is heavy as well: it has
the mass per area D q, q = (1 − ν²) ρ/E the square of the slowness of waves in it, 4e-8 s²/m² for aluminium, 1e-7 for
silver, 4e-7 for epoxy. Along the plate stiffness raises resonances and mass lowers them, so that without its mass a
layer would be taken for one much less stiff. A layer on one face alone also bends the plate; this is left out.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter, ExtraTerm
from femu_piezo.forward.electrodes import electrode_film, electrode_membrane

_PLANE_STRESS = partial(electrode_membrane, poisson=0.35)


def _membrane(omega: np.ndarray, p: np.ndarray):
    ones = np.ones(omega.shape, dtype=complex)
    slopes = np.array([1 + 1j * p[1], 1j * p[0], 0.0])
    return p[0] * (1 + 1j * p[1]) * ones, ones[:, None] * slopes


def _mass(omega: np.ndarray, p: np.ndarray):
    ones = np.ones(omega.shape, dtype=complex)
    return p[0] * p[2] * ones, ones[:, None] * np.array([p[2], 0.0, p[0]])


def _weight(p: np.ndarray, area: float) -> tuple[float, np.ndarray]:
    return 2 * area * p[0] * p[2], 2 * area * np.array([p[2], 0.0, p[0]])


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For bodies with electrodes on faces normal to z; sizes as shares of the body's stiffness and mass per face."""
    if context.poling != "thickness":
        return ()
    stiffness, mass = context.thickness / 2 / context.constants.s11.real, context.density * context.thickness / 2
    return (
        Effect(
            name="film_stiffness",
            sentence="a stiff layer with loss lies on both faces: solder, glue or a thick electrode",
            parameters=(
                EffectParameter(
                    "membrane_stiffness",
                    "N/m",
                    0.0,
                    0.5 * stiffness,
                    5e-3 * stiffness,
                    0.03 * stiffness,
                    law_error=0.05,
                ),
                EffectParameter("loss", "1", 0.0, 1.0, 0.02, 0.05, rest=0.02, optional=True),
                EffectParameter(
                    "square_slowness", "s^2/m^2", 0.0, 5e-7, 2e-8, 7e-8, starts=(2e-8, 3e-7), rest=1e-7, optional=True
                ),
            ),
            confusable_with=("s11", "electrode_mass", "wrong_thickness"),
            advice=(
                "look at a section of the edge under a microscope, and measure the thickness of the layers",
                "dissolve the layer and sweep the bare body again",
            ),
            terms=(
                ExtraTerm("membrane", "stiffness", None, _membrane, on_electrodes=_PLANE_STRESS),
                ExtraTerm("film", "inertia", None, _mass, (0.02 * mass,), on_electrodes=electrode_film),
            ),
            added_mass=_weight,
        ),
    )
