"""Several specimens of one material as one sweep: constants and fixture are common, the rest is a specimen's own.

One fit explains all sweeps, whose whitened residuals stand one below another. A wrong constant moves every sweep as the
body asks, a stray capacitance is the same farads beside each, a wrong length is that of one specimen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from femu_piezo.effects.effect import Effect
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.unknowns import Unknowns


def is_common(effect: Effect) -> bool:
    """Whether all specimens share it with one size: laws of the material, and what the fixture adds.

    Circuits that are nearer to the body than any fixture, such as a gap under an electrode, are a specimen's own.
    """
    return (effect.circuit is not None and effect.outward >= 1) or effect.constants is not None


def belonging_to(effect: Effect, specimen: str) -> Effect:
    """The effect as that of one specimen."""
    return replace(effect, specimen=specimen)


@dataclass(frozen=True)
class Ensemble:
    """Z of several specimens one after another, as `Evaluation` for one.

    Attributes
    ----------
    parts : (name, evaluation) of each specimen
    """

    parts: tuple[tuple[str, Evaluation], ...]

    @cached_property
    def omega(self) -> np.ndarray:
        """(k,) rad/s of all sweeps."""
        return np.concatenate([part.omega for _, part in self.parts])

    def at(self, factor: float) -> Ensemble:
        """The same at frequencies larger by a factor."""
        return Ensemble(tuple((name, part.at(factor)) for name, part in self.parts))

    def impedance(self, parameters: Unknowns, x: np.ndarray) -> np.ndarray:
        """Z (k,), ohm."""
        return self.with_jacobian(parameters, x)[0]

    def with_jacobian(self, parameters: Unknowns, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Z (k,) and ∂Z/∂x (k, n_x), ohm."""
        values, slopes = [], []
        for name, part in self.parts:
            own, columns = own_parameters(parameters, name)
            z, tangents = part.with_jacobian(own, x[columns])
            values.append(z)
            slopes.append(np.zeros((z.size, x.size), dtype=complex))
            slopes[-1][:, columns] = tangents
        return np.concatenate(values), np.concatenate(slopes)

    def slopes_at_sites(self, parameters: Unknowns, x: np.ndarray, effect: Effect) -> np.ndarray:
        """∂Z/∂(size) (k, m) at size zero for each of an effect's m sites; zero for other specimens than its own."""
        found = []
        for name, part in self.parts:
            own, columns = own_parameters(parameters, name)
            if effect.specimen in ("", name):
                found.append(part.slopes_at_sites(own, x[columns], effect))
            else:
                found.append(np.zeros((part.omega.size, len(effect.sites)), dtype=complex))
        return np.concatenate(found)


def own_parameters(parameters: Unknowns, specimen: str) -> tuple[Unknowns, np.ndarray]:
    """The unknowns that one specimen has, and where they stand in x (n_x,)."""

    def has(effect: Effect) -> bool:
        return effect.specimen in ("", specimen)

    kept = [index for index, effect in enumerate(parameters.effects) if has(effect)]
    columns = [np.arange(*parameters.columns(index).indices(parameters.count)) for index in kept]
    effects = tuple(parameters.effects[index] for index in kept)
    own = replace(
        parameters,
        effects=effects,
        candidates=tuple(effect.key for effect in effects if effect.key in parameters.candidates),
        fixed=tuple(item for item in parameters.fixed if has(item[0])),
    )
    return own, np.concatenate([np.arange(parameters.of_material), *columns])
