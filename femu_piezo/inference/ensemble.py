"""Several sweeps as one: of specimens of one material, or of one specimen under several conditions.

One fit explains all sweeps, whose whitened residuals stand one below another. A wrong constant moves every sweep as the
body asks, a stray capacitance is the same farads beside each that was taken in its fixture, a wrong length is that of
one specimen, and a warming during the sweep goes the other way in one that went down.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from femu_piezo.effects.effect import Effect
from femu_piezo.inference.response import Evaluation, placed
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.threads import made_once


def is_common(effect: Effect) -> bool:
    """Whether all specimens share it with one size: laws of the material, and what the fixture adds.

    Circuits that are nearer to the body than any fixture, such as a gap under an electrode, are a specimen's own.
    """
    return (effect.circuit is not None and effect.outward >= 1) or effect.constants is not None


def belonging_to(effect: Effect, specimen: str) -> Effect:
    """The effect as that of one specimen."""
    return replace(effect, specimen=specimen)


def owned_by(effect: Effect, specimen: str) -> Effect:
    """The effect as that of a specimen, unless all share it or it is of another."""
    return effect if effect.specimen or is_common(effect) else belonging_to(effect, specimen)


@dataclass(frozen=True)
class Share:
    """Which unknowns of a fit concern one sweep.

    Attributes
    ----------
    owners : the specimen and the fixture whose effects it has, beside those of "", which all share
    forms : key → the form that an effect has under the conditions of this sweep, where these differ
    """

    owners: tuple[str, ...] = ()
    forms: Mapping[str, Effect] = field(default_factory=dict)

    def has(self, effect: Effect) -> bool:
        """Whether the sweep has an effect."""
        return effect.specimen in ("", *self.owners)

    def of(self, parameters: Unknowns) -> tuple[Unknowns, np.ndarray]:
        """The unknowns that the sweep has, and where they stand in x (n_x,)."""
        kept = [index for index, effect in enumerate(parameters.effects) if self.has(effect)]
        columns = [np.arange(*parameters.columns(index).indices(parameters.count)) for index in kept]
        effects = tuple(self._form(parameters.effects[index]) for index in kept)
        own = replace(
            parameters,
            effects=effects,
            candidates=tuple(effect.key for effect in effects if effect.key in parameters.candidates),
            fixed=tuple((self._form(effect), values) for effect, values in parameters.fixed if self.has(effect)),
        )
        return own, np.concatenate([np.arange(parameters.of_material), *columns])

    def _form(self, effect: Effect) -> Effect:
        return self.forms.get(effect.key, effect)


@dataclass(frozen=True)
class Ensemble:
    """Z of several sweeps one after another, as `Evaluation` for one.

    Attributes
    ----------
    parts : (share, evaluation) of each sweep
    """

    parts: tuple[tuple[Share, Evaluation], ...]

    @made_once
    def omega(self) -> np.ndarray:
        """(k,) rad/s of all sweeps."""
        return np.concatenate([part.omega for _, part in self.parts])

    def at(self, factor: float) -> Ensemble:
        """The same at frequencies larger by a factor."""
        return Ensemble(tuple((share, part.at(factor)) for share, part in self.parts))

    def impedance(self, parameters: Unknowns, x: np.ndarray) -> np.ndarray:
        """Z (k,), ohm."""
        owned = [(part, *share.of(parameters)) for share, part in self.parts]
        return np.concatenate([part.impedance(own, x[columns]) for part, own, columns in owned])

    def with_jacobian(self, parameters: Unknowns, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Z (k,) and ∂Z/∂x (k, n_x), ohm."""
        values, slopes = [], []
        for share, part in self.parts:
            own, columns = share.of(parameters)
            z, tangents = part.with_jacobian(own, x[columns])
            values.append(z)
            slopes.append(np.zeros((z.size, x.size), dtype=complex))
            slopes[-1][:, columns] = tangents
        return np.concatenate(values), np.concatenate(slopes)

    def slopes_at_sites(self, parameters: Unknowns, x: np.ndarray, effect: Effect) -> np.ndarray:
        """∂Z/∂(sizes) (k, m, s) at size zero at each of an effect's m sites; zero for other specimens than its own."""
        found = []
        for share, part in self.parts:
            own, columns = share.of(parameters)
            if share.has(effect):
                found.append(part.slopes_at_sites(own, x[columns], effect))
            else:
                found.append(np.zeros((part.omega.size, len(placed(effect)[0]), effect.sizes.size), dtype=complex))
        return np.concatenate(found)


def together(parts: Sequence[tuple[Share, Evaluation]]) -> Evaluation | Ensemble:
    """Z of one sweep, or of several; one alone has every unknown."""
    return Ensemble(tuple(parts)) if len(parts) > 1 else parts[0][1]
