"""The support is not free: springs and dashpots to ground.

The support has the total stiffness k and the total damping d, and stands

- on a plate on a narrow strip across the middle of both faces, |x| < w/2;
- on a disk or ring on a circle of radius r of both faces, uniform and equal in all directions, or on three patches of
  one face, 120° apart;
- on any other body on one patch of its upper face.

A uniform strip acts like a line at |x| = w/√12, up to the fourth power of w:

    A → A + s mean NᵗN,  s = k + jωd,    over the line across the face at w/√12, or over the circle

Under the uniform pressure of its spring a patch of radius a yields by the local compliance C(a) of the face, which the
modes lack (`femu_piezo.effects.local.face_compliance`); ⟨N⟩ is the mean over the patch, i stands for x, y, z:

    A → A + Σ_patches Σ_i s/n / (1 + C_i s/n) ⟨N_i⟩ᵗ⟨N_i⟩,    n the number of patches
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter, LocalHook, LocalTerm
from femu_piezo.effects.local.face_compliance import FaceCompliance
from femu_piezo.effects.local.operators import Places
from femu_piezo.effects.local.patch import Patch
from femu_piezo.effects.local.placement import Placement, patch_radius
from femu_piezo.effects.local.round_fields import AT_A_PLACE, FILM

#: Radii at which fits start, as shares of the way from the inner to the outer radius.
_RADII = np.array([0.02, 0.25, 0.5, 0.75, 0.9, 0.99])

#: Directions of the three patches under a disk or ring.
_TURNS = 2 * np.pi * np.arange(3) / 3
_TRIPOD = np.column_stack([np.cos(_TURNS), np.sin(_TURNS)])


def _hook(bearing: Callable[[Places, float], tuple[np.ndarray, np.ndarray]], share: float = 1.0) -> LocalHook:
    """Terms of a support on a line or circle.

    bearing : place → mean of NᵗN there (u, u), and its slope;  share : the place over the last parameter
    """

    def terms(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
        mean, slope = bearing(places, share * p[2])
        u, size = mean.shape[0], places.size
        value = p[0] + 1j * omega * p[1]
        zeros, ones = np.zeros(omega.shape, dtype=complex), np.ones(omega.shape, dtype=complex)
        full = [np.zeros((size, size)) for _ in range(2)]
        full[0][:u, :u], full[1][:u, :u] = mean, slope
        return [
            LocalTerm("stiffness", full[0], value, np.stack([ones, 1j * omega, zeros], axis=1)),
            LocalTerm("stiffness", full[1], zeros, np.stack([zeros, zeros, share * value], axis=1)),
        ]

    return terms


def _line(places: Places, place: float) -> tuple[np.ndarray, np.ndarray]:
    return places.face.mean_on_line(place)


def _patches(context: EffectContext, radii: tuple[float, float], directions: np.ndarray) -> LocalHook:
    """Terms of a support on patches whose places (x, y) are linear in the parameters of the place.

    radii : of the smallest and the largest patch;  directions : (patches, parameters, 2) slopes of the places
    """

    def terms(places: Places, omega: np.ndarray, p: np.ndarray) -> list[LocalTerm]:
        (stiffness, damping), place, radius = p[:2], p[2:-1], p[-1]
        patches = [Patch(places.face, *(place @ ways), radius) for ways in directions]
        u, size, count, found = patches[0].mean.shape[1], places.size, len(patches), []
        springs, softer = FaceCompliance.of(context, places.cutoff_omega, radii).stiffness(radius)
        zeros, ones = np.zeros(omega.shape, dtype=complex), np.ones(omega.shape, dtype=complex)
        per_patch = (stiffness + 1j * omega * damping) / count  # s/n

        def term(matrix: np.ndarray, value: np.ndarray, slopes: dict[int, np.ndarray]) -> LocalTerm:
            full = np.zeros((size, size))
            full[:u, :u] = matrix / places.face.copies
            columns = [slopes.get(number, zeros) for number in range(p.size)]
            return LocalTerm("stiffness", full, value, np.stack(columns, axis=1))

        alike = springs[0] == springs[1]  # C is the same along x and y unless the body is poled along one of them
        for axes in ([0, 1], [2]) if alike else ([0], [1], [2]):
            spring, slope = springs[axes[0]], softer[axes[0]]
            value, ratio = per_patch / (1 + per_patch / spring), 1 / (1 + per_patch / spring)
            by_s = ratio**2 / count
            matrix, halves = 0.0, [0.0] * (place.size + 1)  # slopes by the place and by the radius, half of each
            for patch, ways in zip(patches, directions, strict=True):
                n = patch.mean[axes]
                matrix = matrix + n.T @ n
                changes = [*np.tensordot(ways, patch.mean_slopes[:2], axes=1), patch.mean_slopes[2]]
                halves = [half + change[axes].T @ n for half, change in zip(halves, changes, strict=True)]
            by_size = {0: by_s, 1: 1j * omega * by_s, p.size - 1: (value / spring) ** 2 * slope}
            found.append(term(matrix, value, by_size))
            found += [term(half + half.T, zeros, {2 + i: value * ones}) for i, half in enumerate(halves)]
        return found

    return terms


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For every body with an upper face; sizes as shares of the body's inertia at its fundamental."""
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
        sentence="the support restrains the body, like springs and dashpots to ground",
        parameters=parameters,
        confusable_with=("frequency_dependent_elastic_loss", "wrong_insensitive_parameter"),
        advice=(
            "measure again with the specimen hung on thin wires or lying on foam",
            "move the support, and compare the sweeps",
        ),
        dispersive=True,
    )
    if context.upper is not None:
        return (_on_a_patch(context, common, 0.1 * stiffness),)
    if context.radii is None:
        length = context.dimensions[0]
        width = EffectParameter(
            "width", "m", 0.0, length / 4, length / 20, length / 15, rest=length / 15, optional=True
        )
        sentence = "the support restrains the plate at its middle, like a spring and a dashpot to ground"
        hook = _hook(_line, 1 / np.sqrt(12.0))
        return (replace(common, sentence=sentence, parameters=(*parameters, width), local=hook),)
    inner, outer = context.radii
    across = outer - inner
    sites = np.array([(0.1 * stiffness, 0.0, inner + share * across) for share in _RADII])

    def at(name: str) -> tuple[EffectParameter, ...]:
        place = EffectParameter(name, "m", inner, outer, across / 20, 10 * across, rest=(inner + outer) / 2)
        return (*parameters, place)

    contact = patch_radius("contact", 2 * outer)
    points = replace(
        common,
        law="three points",
        parameters=(*at("points_radius"), contact),
        local=_patches(context, (contact.low, contact.high), _TRIPOD[:, None]),
        sites=np.column_stack([sites, np.full(len(sites), contact.rest)]),
        sectors=(FILM, *AT_A_PLACE),
        start_sizes=(1.0,),
    )
    return replace(common, law="circle", parameters=at("radius"), local=_hook(_line), sites=sites), points


def _on_a_patch(context: EffectContext, common: Effect, stiffness: float) -> Effect:
    """A support on one patch of the upper face; stiffness : at which fits start, N/m."""
    contact, place = patch_radius("contact", context.upper.size), Placement.on(context)
    return replace(
        common,
        law="one patch",
        parameters=(*common.parameters, *place.parameters, contact),
        local=_patches(context, (contact.low, contact.high), np.eye(2)[None]),
        sites=np.insert(place.sites_with(stiffness, contact.rest), 1, 0.0, axis=1),
        sectors=place.sectors,
    )
