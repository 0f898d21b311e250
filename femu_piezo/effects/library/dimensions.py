"""Dimensions and density other than the specimen file says: the body is (1 + p) times as long, or as dense.

Where the piece was weighed (`mass`), its density follows from its dimensions, and only the mass has its own deviation.
The deviation of calliper and balance (`std_length`, `std_density`) is the tolerance of p; beyond it the entry is wrong.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter
from femu_piezo.geometry.reshaping import Reshaping

_CONFUSABLE = {
    "length": ("s11", "s33"),
    "width": ("eps33T", "wrong_insensitive_parameter"),
    "thickness": ("eps33T", "d31"),
    "diameter": ("s11", "s12", "wrong_thickness"),
    "inner_diameter": ("s12", "s11", "wrong_diameter"),
    "width_end": ("s11", "wrong_length", "wrong_width"),
}


def _error(context: EffectContext, name: str) -> tuple[EffectParameter, ...]:
    tolerance = context.tolerances.get(name, 0.0)
    return (EffectParameter("relative_error", "1", -0.1, 0.1, 0.005, max(0.02, 3 * tolerance), tolerance=tolerance),)


def _stretch(along: np.ndarray):
    def stretch(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 1 + p[0] * along, along[:, None]

    return stretch


def _lighter(axes: int):
    """Factor on the density, at a given mass, of a body that is (1 + p) times as large along so many axes."""

    def density(p: np.ndarray) -> tuple[float, np.ndarray]:
        return (1 + p[0]) ** -axes, np.array([-axes * (1 + p[0]) ** (-axes - 1)])

    return density


def _thinner(reshaping: Reshaping):
    """Factor on the density, at a given mass, of a body that is reshaped."""

    def density(p: np.ndarray) -> tuple[float, np.ndarray]:
        volume, slope = reshaping.volume(p[0])
        return 1 / volume, np.array([-slope / volume**2])

    return density


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """One effect for each named dimension of the specimen, and one for the density.

    A ring grows as a whole with its diameter, a trapezoid with its width; errors of the inner diameter and of the other
    width come on top of that.
    """

    def dimension(name: str, **hooks) -> Effect:
        words = name.replace("_", " ")
        return Effect(
            name=f"wrong_{name}",
            sentence=f"the {words} in the specimen file is not that of the specimen",
            parameters=_error(context, name),
            confusable_with=_CONFUSABLE[name],
            advice=(
                f"measure the {words} with a micrometer",
                "sweep a wider band, which holds modes that depend on the other dimensions",
                "measure a second specimen of the same material and another size: both have the same constants",
            ),
            **hooks,
        )

    from_mass = context.density_from_mass
    stretched = (
        dimension(
            name,
            stretch=_stretch(np.isin(np.arange(3), axes).astype(float)),
            density=_lighter(len(axes)) if from_mass else None,
        )
        for name, axes in context.axes.items()
    )
    reshaped = (
        dimension(name, reshaping=reshaping, density=_thinner(reshaping) if from_mass else None)
        for name, reshaping in context.reshapings.items()
    )
    density = Effect(
        name="wrong_density",
        sentence="the density in the specimen file is not that of the specimen",
        parameters=_error(context, "density"),
        confusable_with=("s11", "s33", "wrong_length"),
        advice=("weigh the specimen and divide by its volume",),
        density=lambda p: (1 + p[0], np.ones(1)),
    )
    return (*stretched, *reshaped, density)
