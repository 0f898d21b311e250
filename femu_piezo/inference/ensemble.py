"""Several sweeps in one fit: of specimens of one material, or of one specimen under several conditions.

One fit explains all sweeps; their whitened residuals are stacked. A wrong constant changes every sweep as its body
requires, a stray capacitance has the same size in all sweeps taken in its fixture, a wrong length concerns one
specimen, and a warming during the sweep acts in reverse where the frequency fell.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from femu_piezo.effects.effect import Effect
from femu_piezo.errors import InputError
from femu_piezo.inference.response import Evaluation, placed
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.threads import made_once


def is_of_fixture(effect: Effect) -> bool:
    """Whether an effect is a circuit of the fixture; those nearer to the body belong to the specimen."""
    return effect.circuit is not None and effect.outward >= 1


def is_common(effect: Effect) -> bool:
    """Whether all specimens share the effect with one size: effects on the constants, and circuits of the fixture.

    Circuits nearer to the body than any fixture, such as a gap under an electrode, belong to one specimen, and so do
    changes from sweep to sweep.
    """
    return is_of_fixture(effect) or (effect.constants is not None and not effect.of_specimen)


def with_owner(effect: Effect, owner: str) -> Effect:
    """The effect, assigned to a specimen or fixture by its name."""
    return replace(effect, owner=owner)


def with_default_owner(effect: Effect, owner: str) -> Effect:
    """The effect, assigned to a specimen unless all share it or it is assigned already."""
    return effect if effect.owner or is_common(effect) else with_owner(effect, owner)


@dataclass(frozen=True)
class Share:
    """Which unknowns of a fit concern one sweep.

    Attributes
    ----------
    owners : names of the specimen and the fixture whose effects concern it, as do those of "", which all share
    forms : key → the form that an effect has under the conditions of this sweep, where these differ
    """

    owners: tuple[str, ...] = ()
    forms: Mapping[str, Effect] = field(default_factory=dict)

    def has(self, effect: Effect) -> bool:
        """Whether an effect concerns the sweep."""
        return effect.owner in ("", *self.owners)

    def of(self, parameters: Unknowns) -> tuple[Unknowns, np.ndarray]:
        """The unknowns that concern the sweep, and their places (m,) in x (n_x,)."""
        kept = [index for index, effect in enumerate(parameters.effects) if self.has(effect)]
        columns = [np.arange(*parameters.columns(index).indices(parameters.count)) for index in kept]
        effects = tuple(self._form(parameters.effects[index]) for index in kept)
        concerned = replace(
            parameters,
            effects=effects,
            candidates=tuple(effect.key for effect in effects if effect.key in parameters.candidates),
            fixed=tuple((self._form(effect), values) for effect, values in parameters.fixed if self.has(effect)),
        )
        return concerned, np.concatenate([np.arange(parameters.of_material), *columns])

    def _form(self, effect: Effect) -> Effect:
        form = self.forms.get(effect.key, effect)
        if (names := [p.name for p in form.parameters]) != [p.name for p in effect.parameters]:
            raise InputError(
                f"effect {effect.key} has the parameters {', '.join(names)} in one sweep and others in another; "
                "give it the same in all"
            )
        return form


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
        """These sweeps at frequencies multiplied by a factor."""
        return Ensemble(tuple((share, part.at(factor)) for share, part in self.parts))

    def impedance(self, parameters: Unknowns, x: np.ndarray) -> np.ndarray:
        """Z (k,), ohm."""
        owned = [(part, *share.of(parameters)) for share, part in self.parts]
        return np.concatenate([part.impedance(unknowns, x[columns]) for part, unknowns, columns in owned])

    def with_jacobian(self, parameters: Unknowns, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Z (k,) and ∂Z/∂x (k, n_x), ohm."""
        values, slopes = [], []
        for share, part in self.parts:
            unknowns, columns = share.of(parameters)
            z, tangents = part.with_jacobian(unknowns, x[columns])
            values.append(z)
            slopes.append(np.zeros((z.size, x.size), dtype=complex))
            slopes[-1][:, columns] = tangents
        return np.concatenate(values), np.concatenate(slopes)

    def slopes_at_sites(self, parameters: Unknowns, x: np.ndarray, effect: Effect) -> np.ndarray:
        """∂Z/∂(sizes) (k, m, s) at size zero at each of an effect's m sites; 0 in sweeps it does not concern."""
        found = []
        for share, part in self.parts:
            unknowns, columns = share.of(parameters)
            if share.has(effect):
                found.append(part.slopes_at_sites(unknowns, x[columns], effect))
            else:
                found.append(np.zeros((part.omega.size, len(placed(effect)[0]), effect.sizes.size), dtype=complex))
        return np.concatenate(found)


def together(parts: Sequence[tuple[Share, Evaluation]]) -> Evaluation | Ensemble:
    """The evaluation of a single sweep, which has every unknown, or the ensemble of several."""
    return Ensemble(tuple(parts)) if len(parts) > 1 else parts[0][1]
