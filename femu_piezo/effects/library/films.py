"""Heavy electrodes: a film of mass on both faces, and one that is heavier on one face than on the other.

electrode_mass           −ω² μ ∫ v·u dS over both faces, μ in kg/m² on each face
unequal_electrode_mass   −ω² (d/2) (∫_upper − ∫_lower) v·u dS on top of the mean film; it couples the driven modes
                         to those that are odd about the plane between the electrodes, bending among them
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter, ExtraTerm, LocalTerm
from femu_piezo.effects.local.operators import Places
from femu_piezo.effects.local.round_fields import BENDING, FILM
from femu_piezo.forward.electrodes import electrode_film


def _mass(omega: np.ndarray, p: np.ndarray):
    return np.full(omega.shape, p[0], dtype=complex), np.ones((omega.size, 1), dtype=complex)


def _weight(p: np.ndarray, area: float) -> tuple[float, np.ndarray]:
    return 2 * area * p[0], np.array([2 * area])


def _difference(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
    film = places.of_displacements(places.films[...])
    return [LocalTerm.constant_over(omega, "inertia", film, p[0] / 2, [0.5])]


def _mean_film(context: EffectContext) -> tuple[Effect, ...]:
    """The mean film, on each face at most a fifth of half the body's mass per area."""
    mass = context.density * context.thickness / 2
    return (
        Effect(
            name="electrode_mass",
            sentence="the electrodes are heavy, and their mass loads both faces",
            parameters=(EffectParameter("mass_per_area", "kg/m^2", 0.0, 0.2 * mass, 0.005 * mass, 0.05 * mass),),
            confusable_with=("wrong_length", "s11"),
            advice=(
                "weigh the specimen, and compare its mass with density × volume",
                "measure the thickness of the electrodes",
            ),
            terms=(ExtraTerm("film", "inertia", None, _mass, (0.02 * mass,), on_electrodes=electrode_film),),
            added_mass=_weight,
        ),
    )


def _unequal(context: EffectContext) -> tuple[Effect, ...]:
    """For bodies with a plane of symmetry between their electrodes; the sweep cannot tell which one is heavier."""
    if context.mass is None or context.poling != "thickness":
        return ()
    if context.upper and (2 not in context.upper.mirrors or context.field_axis != 2):
        return ()
    mass = context.density * context.thickness / 2
    return (
        Effect(
            name="unequal_electrode_mass",
            sentence="one electrode is heavier than the other: the body bends as it vibrates",
            parameters=(
                EffectParameter(
                    "difference",
                    "kg/m^2",
                    0.0,
                    0.2 * mass,
                    0.01 * mass,
                    0.03 * mass,
                    starts=(0.003 * mass, 0.01 * mass, 0.04 * mass),
                    law_error=0.03,
                ),
            ),
            confusable_with=("electrode_mass", "point_mass"),
            advice=(
                "measure the thickness of both electrodes",
                "compare the sweep with a simulation without electrode mass",
            ),
            local=_difference,
            sectors=("z", "z film") if context.radii is None else (BENDING, FILM),
        ),
    )


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """The mean film, and the difference of the two where the body has the symmetry that tells it."""
    return (*_mean_film(context), *_unequal(context))
