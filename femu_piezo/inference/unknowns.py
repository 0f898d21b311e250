"""Free complex parameters: which constants move, and how the others follow.

The ten d-form constants are an affine function of the free ones,

    constants = fixed + directions · θ,

with a unit direction for each free constant of the full anisotropic model, and for the paper's simplification
the dependent constants moving along (s33 = s13-free copies of s11 and so on). So one class serves both, and the
derivative of every e-form constant is the chain rule through `PiezoConstants.e_form_jacobian`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.material.constants import D_FORM, PiezoConstants
from femu_piezo.material.simplified import Poling, simplify


@dataclass(frozen=True)
class Estimate:
    """One complex constant value·(1 − j tan) with standard deviations (None where unknown)."""

    value: float
    std: float | None
    tan: float
    tan_std: float | None

    def to_json(self) -> dict[str, float | None]:
        """value, std, tan, tan_std as in update.json."""
        return {"value": self.value, "std": self.std, "tan": self.tan, "tan_std": self.tan_std}


def estimates(theta: np.ndarray, covariance: np.ndarray | None) -> list[Estimate]:
    """Estimates of complex θ (n,) from the covariance (2n, 2n) over (Re θ_1, Im θ_1, Re θ_2, …)."""
    result = []
    for index, value in enumerate(theta):
        tan = -value.imag / value.real
        if covariance is None:
            result.append(Estimate(float(value.real), None, float(tan), None))
            continue
        block = covariance[2 * index : 2 * index + 2, 2 * index : 2 * index + 2]
        slope = np.array([-tan / value.real, -1 / value.real])  # ∂tan/∂(Re, Im)
        result.append(
            Estimate(float(value.real), float(np.sqrt(block[0, 0])), float(tan), float(np.sqrt(slope @ block @ slope)))
        )
    return result


@dataclass(frozen=True)
class FreeConstants:
    """Affine map from free complex parameters to the ten constants.

    Attributes
    ----------
    names : free constants, length n
    fixed : (10,) complex part that does not move
    directions : (10, n) real ∂constants/∂θ
    start : (n,) complex values of the free constants in the base set
    """

    names: tuple[str, ...]
    fixed: np.ndarray
    directions: np.ndarray
    start: np.ndarray

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
        """The constants at Re θ, then corners of the box ±spread (relative) around it that are stable materials."""
        rng = np.random.default_rng(2022)
        sets = [self.constants(theta.real).lossless()]
        for _ in range(50 * count):
            if len(sets) == count:
                break
            sample = self.constants(theta.real * (1 + spread * rng.choice([-1.0, 1.0], theta.size))).lossless()
            if not sample.physical_faults():
                sets.append(sample)
        return sets

    def at(self, theta: np.ndarray) -> FreeConstants:
        """The same map, started from other free values."""
        return replace(self, start=np.array(theta, dtype=complex))

    def as_dict(self, theta: np.ndarray) -> dict[str, complex]:
        """Free θ (n,) by name, SI."""
        return {name: complex(value) for name, value in zip(self.names, theta, strict=True)}


#: Range of each real part relative to its start, and of each loss tangent, that a fit may use.
SCALE_RANGE, TANGENT_RANGE = (0.2, 5.0), (-0.2, 1.0)


@dataclass(frozen=True)
class MaterialParameters:
    """The real unknowns of a fit: for each free constant its real part over a scale, and its loss tangent.

    x = (a_1, tan_1, a_2, tan_2, …) with θ_i = scale_i · a_i (1 − j tan_i).

    Attributes
    ----------
    free : the affine map from θ to the ten constants
    scale : (n,) real, not zero; the start values, so that a = 1 at the start
    """

    free: FreeConstants
    scale: np.ndarray

    @classmethod
    def around(cls, free: FreeConstants, theta: np.ndarray) -> MaterialParameters:
        """Unknowns that are 1 at complex θ (n,)."""
        return cls(free, np.array(theta.real, dtype=float))

    @property
    def names(self) -> tuple[str, ...]:
        """("s11", "tan_s11", …), length 2n."""
        return tuple(label for name in self.free.names for label in (name, f"tan_{name}"))

    @property
    def bounds(self) -> np.ndarray:
        """(2n, 2) lower and upper bound of every unknown."""
        return np.tile([SCALE_RANGE, TANGENT_RANGE], (self.scale.size, 1)).astype(float)

    def x_of(self, theta: np.ndarray) -> np.ndarray:
        """(2n,) unknowns of complex θ (n,)."""
        return np.stack([theta.real / self.scale, -theta.imag / theta.real], axis=1).ravel()

    def theta(self, x: np.ndarray) -> np.ndarray:
        """(n,) complex θ."""
        return self.scale * x[0::2] * (1 - 1j * x[1::2])

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """(n, 2n) complex ∂θ/∂x."""
        slopes = np.zeros((self.scale.size, x.size), dtype=complex)
        index = np.arange(self.scale.size)
        slopes[index, 2 * index] = self.scale * (1 - 1j * x[1::2])
        slopes[index, 2 * index + 1] = -1j * self.scale * x[0::2]
        return slopes

    def constants(self, x: np.ndarray) -> PiezoConstants:
        return self.free.constants(self.theta(x))

    def coefficient_slopes(self, x: np.ndarray) -> np.ndarray:
        """(10, 2n) complex ∂(e-form)/∂x."""
        return self.free.e_form_jacobian(self.theta(x)) @ self.slopes(x)

    def theta_covariance(self, x: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """Covariance over (Re θ_1, Im θ_1, …) from that over x."""
        slopes = self.slopes(x)
        real = np.empty((2 * self.scale.size, x.size))
        real[0::2], real[1::2] = slopes.real, slopes.imag
        return real @ covariance @ real.T
