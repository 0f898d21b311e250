"""`JointParameters`: the unknowns of a fit of material and effects together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from femu_piezo.effects.effect import Effect
from femu_piezo.inference.unknowns import MaterialParameters


@dataclass(frozen=True)
class JointParameters:
    """The real unknowns of a fit: those of the material, then each effect's parameters over their scales.

    Attributes
    ----------
    material : the free constants
    effects : the effects to be fitted
    fixed : effects with known values, which the model has in any case
    """

    material: MaterialParameters
    effects: tuple[Effect, ...] = ()
    fixed: tuple[tuple[Effect, np.ndarray], ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all unknowns, of the material first."""
        own = tuple(f"{effect.key}.{p.name}" for effect in self.effects for p in effect.parameters)
        return self.material.names + own

    @property
    def scale(self) -> np.ndarray:
        """(n_p,) units of the effects' parameters."""
        return np.concatenate([effect.scale for effect in self.effects]) if self.effects else np.zeros(0)

    def prior(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n_p,) residuals (p − rest)/spread of the effects' weak priors, and their Jacobian (n_p, n_x)."""
        if not self.effects:
            return np.zeros(0), np.zeros((0, x.size))
        rest, spread = (np.concatenate([getattr(e, part) for e in self.effects]) for part in ("rest", "spread"))
        start = 2 * self.material.scale.size
        slopes = np.zeros((rest.size, x.size))
        slopes[:, start:] = np.diag(self.scale / spread)
        return (x[start:] * self.scale - rest) / spread, slopes

    @property
    def bounds(self) -> np.ndarray:
        """(n_x, 2)"""
        own = [effect.bounds / effect.scale[:, None] for effect in self.effects]
        return np.concatenate([self.material.bounds, *own])

    @property
    def count(self) -> int:
        """Number of unknowns."""
        return 2 * self.material.scale.size + self.scale.size

    def with_effect(self, effect: Effect) -> JointParameters:
        """The same unknowns and those of one more effect."""
        return replace(self, effects=(*self.effects, effect))

    def without_effect(self, index: int) -> JointParameters:
        """The same unknowns without those of the effect number `index`."""
        return replace(self, effects=(*self.effects[:index], *self.effects[index + 1 :]))

    def values(self, x: np.ndarray) -> list[np.ndarray]:
        """Parameters of each fitted effect in SI units."""
        flat, start, found = x[2 * self.material.scale.size :] * self.scale, 0, []
        for effect in self.effects:
            found.append(flat[start : start + len(effect.parameters)])
            start += len(effect.parameters)
        return found

    def columns(self, index: int) -> slice:
        """Where the unknowns of the effect number `index` stand in x."""
        start = 2 * self.material.scale.size + sum(len(effect.parameters) for effect in self.effects[:index])
        return slice(start, start + len(self.effects[index].parameters))
