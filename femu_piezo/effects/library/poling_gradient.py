"""The piezoelectric constants vary over the body about an unchanged mean, e → e [1 + …].

    plate          g ξ + h (ξ² − 1/3), ξ = 2x/L
    disk or ring   g (ρ² − ⟨ρ²⟩), ρ = r/R, the mean over the face

Along a plate the gradient g couples the driven modes to those that are odd about the middle, which a uniform plate
cannot show. A real change of poling is curved as well: h, kept small by its prior, does not change the mean. Along a
radius g changes how strongly the radial modes are driven, in first order and with its sign.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter, LocalTerm
from femu_piezo.effects.local.operators import PIEZOELECTRIC, Places


def _along(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
    return [
        LocalTerm.constant_over(omega, "stiffness", matrix, value, unit, constant)
        for value, unit, profile in zip(p, np.eye(2), places.ramp[...], strict=True)
        for constant, matrix in zip(PIEZOELECTRIC, profile, strict=True)
    ]


def _radial(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
    profile = zip(PIEZOELECTRIC, places.radial_ramp[...], strict=True)
    return [LocalTerm.constant_over(omega, "stiffness", matrix, p[0], [1.0], constant) for constant, matrix in profile]


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For disks, rings, and plates with three mirror planes, where g is taken as positive: no sweep tells its sign."""
    if not context.is_regular:
        return ()
    if context.radii is None:
        along, low, local, sectors = "the length", 0.0, _along, ("ramp", "x", "x ramp")
        starts = (0.05, 0.2, 0.5)
        curved = (EffectParameter("curvature", "1", -0.5, 0.5, 0.02, 0.05, optional=True),)
        advice = (
            "measure d33 at both ends with a d33 meter",
            "divide one electrode into halves along the length, and compare the sweeps of the two",
        )
    else:
        along, low, local, sectors, curved = "the radius", -0.95, _radial, (), ()
        starts = (-0.3, -0.1, 0.1, 0.3)
        advice = ("measure d33 at the middle and near the rim with a d33 meter",)
    return (
        Effect(
            name="poling_gradient",
            sentence=f"the poling changes along {along}: modes are driven more or less strongly than in a uniform body",
            parameters=(
                EffectParameter("gradient", "1", low, 0.95, 0.1, 0.3, starts=starts),
                *curved,
            ),
            confusable_with=("local_crack", "point_mass"),
            advice=advice,
            local=local,
            sectors=sectors,
        ),
    )
