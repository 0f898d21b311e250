"""The free constants of a material: an affine map to all ten, and the constants that reduced bases are trained at.

The ten d-form constants of the material are an affine function of the free ones,

    constants = fixed + directions · θ,

with a unit direction for each free constant of the full anisotropic model. In the paper's simplification the dependent
constants move with the free ones (s33 = s11, s44 = 2 (s11 − s12)). So one class serves both models, and the derivatives
of the e-form constants follow by the chain rule through `PiezoConstants.e_form_jacobian`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.material.constants import D_FORM, PiezoConstants
from femu_piezo.material.simplified import Poling, simplify
from femu_piezo.threads import Once

#: Relative range of the held constants that a basis for effects is trained for.
_HELD_SPREAD = 0.1
#: The latest sets for effects.
_latest_training = Once(latest=8)


@dataclass(frozen=True)
class FreeConstants:
    """Affine map from free complex parameters to the ten constants.

    Attributes
    ----------
    names : free constants, length n
    fixed : (10,) complex part that does not move
    directions : (10, n) real ∂constants/∂θ
    start : (n,) complex values of the free constants where a fit starts
    """

    names: tuple[str, ...]
    fixed: np.ndarray = field(repr=False)
    directions: np.ndarray = field(repr=False)
    start: np.ndarray = field(repr=False)

    @classmethod
    def of(
        cls,
        base: PiezoConstants,
        names: tuple[str, ...],
        *,
        simplified: bool = False,
        poling: Poling = "thickness",
    ) -> FreeConstants:
        """Free the named constants of a base set.

        Raises InputError where the simplification has no such free constant, or a free constant is zero.
        """
        if simplified:
            return cls._simplified(base, names, poling)
        directions = np.zeros((10, len(names)))
        for column, name in enumerate(names):
            directions[D_FORM.index(name), column] = 1.0
        start = np.array([getattr(base, name) for name in names], dtype=complex)
        cls._check_nonzero(names, start)
        return cls(names, base.vector() - directions @ start, directions, start)

    @classmethod
    def _simplified(cls, base: PiezoConstants, names: tuple[str, ...], poling: Poling) -> FreeConstants:
        simple = simplify(base, poling)
        strangers = [name for name in names if name not in simple.free]
        if strangers:
            raise InputError(
                f"material.free names {', '.join(strangers)}, but the simplified model of this poling has only "
                f"{', '.join(simple.free)}; set simplified = false or free these"
            )
        elastic, charge, eps = simple.free
        moves = {
            elastic: {"s11": 1.0, "s33": 1.0, "s44": 2.0},
            charge: {charge: 1.0},
            eps: {eps: 1.0},
        }
        directions = np.zeros((10, len(names)))
        for column, name in enumerate(names):
            for moved, rate in moves[name].items():
                directions[D_FORM.index(moved), column] = rate
        start = np.array([getattr(simple, name) for name in names], dtype=complex)
        cls._check_nonzero(names, start)
        return cls(names, simple.full().vector() - directions @ start, directions, start)

    @staticmethod
    def _check_nonzero(names: tuple[str, ...], start: np.ndarray) -> None:
        for name, value in zip(names, start, strict=True):
            if value == 0:
                raise InputError(
                    f"material.free names {name}, which is zero in the base material: give it a starting value"
                )

    def constants(self, theta: np.ndarray) -> PiezoConstants:
        """The ten constants at free values θ (n,) complex."""
        return PiezoConstants.from_vector(self.fixed + self.directions @ theta)

    def e_form_jacobian(self, theta: np.ndarray) -> np.ndarray:
        """∂(e-form)/∂θ, (10, n) complex."""
        return self.constants(theta).e_form_jacobian() @ self.directions

    def training_sets(self, theta: np.ndarray, spread: float, count: int = 7) -> list[PiezoConstants]:
        """Up to `count` lossless sets: at Re θ, then at random corners of the box Re θ (1 ± spread) that are stable."""
        rng = np.random.default_rng(2022)
        sets = [self.constants(theta.real).lossless()]
        for _ in range(50 * count):
            if len(sets) == count:
                break
            sample = self.constants(theta.real * (1 + spread * rng.choice([-1.0, 1.0], theta.size))).lossless()
            if not sample.physical_faults():
                sets.append(sample)
        return sets

    def training_for_effects(self, constants: PiezoConstants, spread: float = 0.05) -> tuple[PiezoConstants, ...]:
        """Sets at which a basis learns to follow effects: they deform the fields in ways of their own.

        `constants` with their losses, corners of the range ± spread of the free ones, and each held constant moved one
        way. The reduction also watches the error at every set mirrored at the first. Kept for the latest constants, as
        those of a lot are mostly the same.
        """
        key = constants, spread, self.names, *(one.tobytes() for one in (self.fixed, self.directions, self.start))
        return _latest_training.get(key, lambda: self._training_for_effects(constants, spread))

    def _training_for_effects(self, constants: PiezoConstants, spread: float) -> tuple[PiezoConstants, ...]:
        lossless = constants.lossless()
        sets = [constants, *self.training_sets(self.start, spread, 4)[1:]]
        for name, value in lossless.as_dict().items():
            if name not in self.names and value != 0:
                moved = (lossless.with_values(**{name: value * (1 + sign * _HELD_SPREAD)}) for sign in (1, -1))
                sets += islice((item for item in moved if not item.physical_faults()), 1)
        return tuple(sets)

    def at(self, theta: np.ndarray) -> FreeConstants:
        """This map with other start values θ (n,)."""
        return replace(self, start=np.array(theta, dtype=complex))

    def as_dict(self, theta: np.ndarray) -> dict[str, complex]:
        """Name → value of the free constants θ (n,), SI."""
        return {name: complex(value) for name, value in zip(self.names, theta, strict=True)}
