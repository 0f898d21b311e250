"""The body is not the same all along: its density, its stiffness and its poling vary smoothly along the length.

With ξ = 2x/L, each of ρ, c^E and e is multiplied by

    1 + a ξ + b (ξ² − 1/3).

Films, soft stretches and unevenly pressed or poled ceramics that no cause of the library describes act like this on
modes that vary slowly along the body. So this is no cause: it stands for what none describes, and tells what varies.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter, LocalTerm
from femu_piezo.effects.local.operators import ELASTIC, PIEZOELECTRIC, Places


def _terms(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
    stiffness, inertia = places.uneven
    found, unit_vectors = [], np.eye(6)
    for number in range(2):
        heavy = places.of_displacements(inertia[number])
        found.append(LocalTerm.constant_over(omega, "inertia", heavy, p[number], unit_vectors[number]))
        for first, constants, matrices in ((2, ELASTIC, stiffness), (4, PIEZOELECTRIC, places.ramp)):
            value, unit = p[first + number], unit_vectors[first + number]
            for constant, matrix in zip(constants, matrices[number], strict=True):
                found.append(LocalTerm.constant_over(omega, "stiffness", matrix, value, unit, constant))
    return found


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For plates with three mirror planes; the sweep cannot tell the two ends apart."""
    if context.dimensions is None:
        return ()

    def parameter(name: str, reach: float, spread: float, starts: tuple[float, ...] = ()) -> EffectParameter:
        return EffectParameter(name, "1", -reach, reach, spread, spread, starts=starts)

    return (
        Effect(
            name="uneven_body",
            sentence="density, stiffness or poling changes along the length as no other effect describes",
            parameters=(
                parameter("density_gradient", 0.5, 0.03, (0.01, 0.04)),
                parameter("density_curvature", 0.5, 0.03),
                parameter("stiffness_gradient", 0.5, 0.05, (0.02, 0.1)),
                parameter("stiffness_curvature", 0.5, 0.05),
                parameter("poling_gradient", 0.95, 0.2, (0.05, 0.2, 0.5)),
                parameter("poling_curvature", 0.95, 0.2),
            ),
            confusable_with=("poling_gradient", "tapered_width", "point_mass", "local_crack"),
            advice=("cut the specimen in two and measure each half", "turn the specimen and look at both faces"),
            local=_terms,
            sectors=("ramp", "x", "x ramp", "x taper"),
            of_unknown=True,
        ),
    )
