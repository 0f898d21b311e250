"""The support is not free: springs and dashpots to ground on both faces.

On a plate they stand on a narrow strip across the middle, |x| < w/2, on a disk or ring on a circle of radius r, evenly
and alike in all directions, or on three points of that circle on one face: the total stiffness k and the total damping
d. What is even over a narrow strip is, up to the fourth power of w, what sits at |x| = w/√12:

    A → A + (k + jωd) mean NᵗN  over the line across the face at w/√12, over the circle, or over the points
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter, LocalHook, LocalTerm
from femu_piezo.effects.local.operators import Places
from femu_piezo.effects.local.round_fields import AT_A_PLACE, FILM

#: Radii to look at first, as shares of the way from the inner to the outer one.
_RADII = np.array([0.02, 0.25, 0.5, 0.75, 0.9, 0.99])


_TURNS = 2 * np.pi * np.arange(3) / 3
_TRIPOD = np.column_stack([np.cos(_TURNS), np.sin(_TURNS)])


def _hook(bearing: Callable[[Places, float], tuple[np.ndarray, np.ndarray]], share: float = 1.0) -> LocalHook:
    """bearing : mean of NᵗN where it stands, and its slope; share : place of that over the last parameter."""

    def terms(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
        line, slope = bearing(places, share * p[2])
        u, size = line.shape[0], places.size
        value = p[0] + 1j * omega * p[1]
        zero, one = np.zeros(omega.shape, dtype=complex), np.ones(omega.shape, dtype=complex)
        full = [np.zeros((size, size)) for _ in range(2)]
        full[0][:u, :u], full[1][:u, :u] = line, slope
        return [
            LocalTerm("stiffness", full[0], value, np.stack([one, 1j * omega, zero], axis=1)),
            LocalTerm("stiffness", full[1], zero, np.stack([zero, zero, share * value], axis=1)),
        ]

    return terms


def _line(places: Places, place: float) -> tuple[np.ndarray, np.ndarray]:
    return places.face.mean_on_line(place)


def _tripod(places: Places, radius: float) -> tuple[np.ndarray, np.ndarray]:
    return places.face.mean_at(radius * _TRIPOD, _TRIPOD, np.full(len(_TRIPOD), 1 / len(_TRIPOD)))


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For plates with three mirror planes, disks and rings; sizes against the body's inertia at its fundamental."""
    if context.mass is None:
        return ()
    omega = 2 * np.pi * context.fundamental_Hz
    stiffness, damping = 0.05 * context.mass * omega**2, 0.05 * context.mass * omega
    parameters = (
        EffectParameter("stiffness", "N/m", 0.0, 40 * stiffness, stiffness, 5 * stiffness, law_error=0.03),
        EffectParameter("damping", "N s/m", 0.0, 40 * damping, damping, 5 * damping, law_error=0.03),
    )
    common = Effect(
        name="mounting",
        sentence="the support holds the body: springs and dashpots to ground",
        parameters=parameters,
        confusable_with=("frequency_dependent_elastic_loss", "wrong_insensitive_parameter"),
        advice=("measure again hung on thin wires or lying on foam", "move the support and see what changes"),
        dispersive=True,
    )
    if context.radii is None:
        length = context.dimensions[0]
        width = EffectParameter(
            "width", "m", 0.0, length / 4, length / 20, length / 15, rest=length / 15, optional=True
        )
        sentence = "the support at the middle holds the plate: a spring and a dashpot to ground"
        hook = _hook(_line, 1 / np.sqrt(12.0))
        return (replace(common, sentence=sentence, parameters=(*parameters, width), local=hook),)
    inner, outer = context.radii
    across = outer - inner
    sites = np.array([(0.1 * stiffness, 0.0, inner + one * across) for one in _RADII])

    def at(name: str) -> tuple[EffectParameter, ...]:
        place = EffectParameter(name, "m", inner, outer, across / 20, 10 * across, rest=(inner + outer) / 2)
        return (*parameters, place)

    circle = replace(common, law="circle", parameters=at("radius"), local=_hook(_line), sites=sites)
    points = replace(common, law="three points", parameters=at("points_radius"), local=_hook(_tripod), sites=sites)
    return circle, replace(points, sectors=(FILM, *AT_A_PLACE), onset_hidden=True)
