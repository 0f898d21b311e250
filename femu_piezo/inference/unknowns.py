"""The unknowns of a fit: free constants, tolerances and effects, each with bounds and a Gaussian prior.

The numbers of the model are not equally well known beforehand: a free constant hardly at all, a held constant, a
dimension, the density and the instrument within a tolerance, a candidate effect within its usual size. All are unknowns
with priors in one vector x (`Unknowns`). The free constants themselves are in `femu_piezo.inference.free_constants`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import accumulate
from typing import Protocol

import numpy as np

from femu_piezo.effects.effect import Effect
from femu_piezo.inference.free_constants import FreeConstants
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.threads import made_once


@dataclass(frozen=True)
class Estimate:
    """One complex constant value·(1 − j tan) with standard deviations (None where unknown).

    Attributes
    ----------
    budget, tan_budget : source of uncertainty → its part of the standard deviation; the squares of all parts add up to
        the variance; empty where the parts are not known
    interval, tan_interval : ends between which value and tangent are with a probability of 95 %, averaged over causes
        of a misfit by their probabilities; None where no causes were compared
    """

    value: float
    std: float | None
    tan: float
    tan_std: float | None
    budget: Mapping[str, float] = field(default_factory=dict)
    tan_budget: Mapping[str, float] = field(default_factory=dict)
    interval: tuple[float, float] | None = None
    tan_interval: tuple[float, float] | None = None

    @property
    def largest_part(self) -> str:
        """The source that contributes most to the standard deviation of the value; "" where that is unknown."""
        return max(self.budget, key=self.budget.__getitem__) if self.budget else ""

    def to_json(self) -> dict:
        """value, std, tan, tan_std, budgets and intervals as in update.json and diagnosis.json."""
        record: dict = {"value": self.value, "std": self.std, "tan": self.tan, "tan_std": self.tan_std}
        if self.budget:
            record |= {"budget": dict(self.budget), "tan_budget": dict(self.tan_budget)}
        if self.interval is not None and self.tan_interval is not None:
            record |= {"interval": list(self.interval), "tan_interval": list(self.tan_interval)}
        return record


#: Range of each real part relative to its start and to its value in the file, and of each loss tangent, of a fit.
SCALE_RANGE, TANGENT_RANGE = (0.2, 5.0), (-0.2, 1.0)


@dataclass(frozen=True)
class MaterialParameters:
    """The real unknowns of a fit: for each free constant its real part over a scale, and its loss tangent.

    x = (a_1, tan_1, a_2, tan_2, …) with θ_i = scale_i · a_i (1 − j tan_i).

    Attributes
    ----------
    free : the affine map from θ to the ten constants
    scale : (n,) real, not zero; the start values, so that a = 1 at the start
    of_file : (n,) real parts that the specimen file gives, or the start values
    """

    free: FreeConstants
    scale: np.ndarray = field(repr=False)
    of_file: np.ndarray = field(repr=False)

    @classmethod
    def around(cls, free: FreeConstants, theta: np.ndarray, of_file: np.ndarray | None = None) -> MaterialParameters:
        """Unknowns whose real parts a are 1 at complex θ (n,); of_file : (n,) complex θ of the specimen file."""
        start = np.array(theta.real, dtype=float)
        return cls(free, start, start if of_file is None else of_file.real)

    @property
    def names(self) -> tuple[str, ...]:
        """("s11", "tan_s11", …), length 2n."""
        return tuple(label for name in self.free.names for label in (name, f"tan_{name}"))

    @property
    def units(self) -> np.ndarray:
        """(2n,) SI value of each unknown at 1: the scale for a real part, 1 for a tangent."""
        return np.stack([self.scale, np.ones(self.scale.size)], axis=1).ravel()

    @property
    def bounds(self) -> np.ndarray:
        """(2n, 2) lower and upper bound of every unknown.

        A start that a sweep suggests may be far off, as where a cable has ten times the capacitance of the body: what
        the file gives is within the bounds as well.
        """
        found = np.tile([SCALE_RANGE, TANGENT_RANGE], (self.scale.size, 1)).astype(float)
        ratio = self.of_file / self.scale
        found[0::2, 0] *= np.where(ratio > 0, np.minimum(ratio, 1.0), 1.0)
        found[0::2, 1] *= np.maximum(ratio, 1.0)
        return found

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

    def vector(self, x: np.ndarray) -> np.ndarray:
        """(10,) complex constants in the order of `D_FORM`."""
        return self.free.fixed + self.free.directions @ self.theta(x)

    def constants(self, x: np.ndarray) -> PiezoConstants:
        return PiezoConstants.from_vector(self.vector(x))


#: Prior of any ceramic where the file states no deviation: real parts ±50 % of the file's, tangents 0.02 ± 0.05.
_REAL_STD, TANGENT, _TANGENT_STD = 0.5, 0.02, 0.05
#: Prior standard deviation, over its scale, of a parameter that is exactly known.
_HELD = 1e-6
#: Least distance of a start from a bound, relative to the range of the unknown.
_MARGIN = 1e-6


def material_prior(
    free: FreeConstants, real_std: Mapping[str, float], tangent_std: Mapping[str, float]
) -> dict[str, tuple[float, float]]:
    """Name → mean and standard deviation of each real part (SI) and tangent.

    Real parts, and tangents with a stated deviation, are centred on the values of the file; other tangents on 0.02.

    Parameters
    ----------
    free : the free constants around the values of the specimen file
    real_std : name → relative standard deviation that the file states;  tangent_std : absolute one of a tangent
    """
    prior = {}
    for name, value in zip(free.names, free.start, strict=True):
        prior[name] = (value.real, real_std.get(name, _REAL_STD) * abs(value.real))
        known = name in tangent_std
        tangent = -value.imag / value.real if known else TANGENT
        prior[f"tan_{name}"] = (tangent, tangent_std[name] if known else _TANGENT_STD)
    return prior


class Read(Protocol):
    """One number that another instrument has read (`femu_piezo.inference.readings`).

    name : its key in `[readings]`;  specimen : name of the specimen as in `Effect.owner`;  value, std : SI
    """

    @property
    def name(self) -> str: ...

    @property
    def specimen(self) -> str: ...

    @property
    def value(self) -> float: ...

    @property
    def std(self) -> float: ...

    def row(self, parameters: Unknowns, x: np.ndarray) -> tuple[float, np.ndarray]:
        """(predicted − value)/std at x (n_x,), and its slopes (n_x,)."""


#: An effect with its known values (n,), SI, or with the columns of x that are its parameters.
Acting = tuple[Effect, np.ndarray | slice]


@dataclass(frozen=True)
class Unknowns:
    """The real unknowns x of a fit: those of the material, then each effect's parameters over their scales.

    Attributes
    ----------
    material : the free constants
    prior : label of `material` → mean and standard deviation, SI
    effects : tolerances and candidates, whose parameters are unknowns
    candidates : keys of those effects whose prior is that of a cause (`Effect.spread`); the prior of the others is
        their tolerance
    fixed : effects and their known values (n,), SI, which are part of the model and no unknowns
    readings : readings of other instruments, which are data of every fit
    """

    material: MaterialParameters
    prior: Mapping[str, tuple[float, float]]
    effects: tuple[Effect, ...] = ()
    candidates: tuple[str, ...] = ()
    fixed: tuple[tuple[Effect, np.ndarray], ...] = ()
    readings: tuple[Read, ...] = ()

    @classmethod
    def of_constants(
        cls, free: FreeConstants, fixed: tuple[tuple[Effect, np.ndarray], ...] = ()
    ) -> tuple[Unknowns, np.ndarray]:
        """Free constants as the only unknowns, beside effects of known values; and x (n_x,) at their start."""
        material = MaterialParameters.around(free, free.start)
        return cls(material, material_prior(free, {}, {}), fixed=fixed), material.x_of(free.start)

    @made_once
    def names(self) -> tuple[str, ...]:
        """Names of all unknowns, of the material first."""
        of_effects = tuple(f"{effect.key}.{p.name}" for effect in self.effects for p in effect.parameters)
        return self.material.names + of_effects

    @property
    def of_material(self) -> int:
        """Number of the unknowns of the material, which come first."""
        return 2 * self.material.scale.size

    @made_once
    def scale(self) -> np.ndarray:
        """(n_p,) units of the effects' parameters."""
        return np.concatenate([effect.scale for effect in self.effects]) if self.effects else np.zeros(0)

    @made_once
    def prior_mean(self) -> np.ndarray:
        """(n_x,) mean of the Gaussian prior."""
        material = [self.prior[name][0] for name in self.material.names] / self.material.units
        return np.concatenate([material, *(effect.rest / effect.scale for effect in self.effects)])

    @made_once
    def prior_std(self) -> np.ndarray:
        """(n_x,) standard deviation of the Gaussian prior."""
        material = np.abs([self.prior[name][1] for name in self.material.names] / self.material.units)
        of_effects = [
            np.maximum((e.spread if e.key in self.candidates else e.tolerance) / e.scale, _HELD) for e in self.effects
        ]
        return np.concatenate([material, *of_effects])

    @made_once
    def bounds(self) -> np.ndarray:
        """(n_x, 2) lower and upper bound of every unknown."""
        of_effects = [effect.bounds / effect.scale[:, None] for effect in self.effects]
        return np.concatenate([self.material.bounds, *of_effects])

    @property
    def margin(self) -> np.ndarray:
        """(n_x,) least distance of a start from a bound; an unknown that ends within it counts as on the bound."""
        return _MARGIN * np.ptp(self.bounds, axis=1)

    def on_bound(self, x: np.ndarray) -> np.ndarray:
        """(n_x,) bool: which unknowns are on a bound."""
        low, high = self.bounds.T
        return (x <= low + self.margin) | (x >= high - self.margin)

    @property
    def count(self) -> int:
        """Number of unknowns."""
        return self.of_material + self.scale.size

    @property
    def causes(self) -> tuple[Effect, ...]:
        """The effects that are tried as causes, in the order they were added."""
        return tuple(self.effects[self.index(key)] for key in self.candidates)

    def index(self, key: str) -> int:
        """Number of the effect of that key; ValueError where there is none."""
        if key not in self._numbers:
            raise ValueError(f"no effect {key} among {sorted(self._numbers)}")
        return self._numbers[key]

    @made_once
    def acting(self) -> tuple[Acting, ...]:
        """The fixed and the fitted effects in the order in which they act."""
        fitted = ((effect, self.columns(number)) for number, effect in enumerate(self.effects))
        return tuple(sorted((*self.fixed, *fitted), key=lambda item: item[0].place))

    @made_once
    def acting_on_constants(self) -> tuple[Acting, ...]:
        """Those of `acting` that change the constants alike at all frequencies and in all sweeps."""
        return tuple(item for item in self.acting if item[0].on_constants)

    @made_once
    def _numbers(self) -> dict[str, int]:
        """Key → number of the effect."""
        return {effect.key: number for number, effect in enumerate(self.effects)}

    @made_once
    def _ends(self) -> tuple[int, ...]:
        """Place in x of the first unknown of each effect, then the number of all unknowns."""
        return tuple(accumulate((len(effect.parameters) for effect in self.effects), initial=self.of_material))

    def has(self, effect: Effect) -> bool:
        """Whether the effect is among the unknowns, as a tolerance or as a cause."""
        return effect.key in self._numbers

    def with_candidate(self, effect: Effect) -> Unknowns:
        """These unknowns with one more cause: an effect that had the prior of its tolerance, or a new one."""
        effects = self.effects if self.has(effect) else (*self.effects, effect)
        return replace(self, effects=effects, candidates=(*self.candidates, effect.key))

    def alone(self, effect: Effect, x: np.ndarray) -> Unknowns:
        """The parameters of one effect as the only unknowns; material and all other effects are fixed at x (n_x,)."""
        constants = FreeConstants.of(self.material.constants(x[: self.of_material]), ())
        others = [(other, v) for other, v in zip(self.effects, self.values(x), strict=True) if other.key != effect.key]
        return Unknowns(
            MaterialParameters.around(constants, constants.start), {}, (effect,), fixed=(*self.fixed, *others)
        )

    def without_candidate(self, key: str) -> Unknowns:
        """These unknowns with one cause less: an effect that has a tolerance stays, with that as its prior."""
        kept = tuple(effect for effect in self.effects if effect.key != key or effect.has_tolerance)
        return replace(self, effects=kept, candidates=tuple(other for other in self.candidates if other != key))

    def carried(self, other: Unknowns, x: np.ndarray) -> np.ndarray:
        """(n_x,) these unknowns at the values x of another list; effects that the other list lacks are at rest."""
        start = self.prior_mean.copy()
        start[: self.of_material] = x[: other.of_material]
        for number, effect in enumerate(self.effects):
            if other.has(effect):
                start[self.columns(number)] = x[other.columns(other.index(effect.key))]
        return start

    def values(self, x: np.ndarray) -> list[np.ndarray]:
        """Parameters (n,) of each effect in SI units at x (n_x,)."""
        return [x[self.columns(number)] * effect.scale for number, effect in enumerate(self.effects)]

    def columns(self, index: int) -> slice:
        """Slice of x that holds the unknowns of the effect number `index`."""
        return slice(self._ends[index], self._ends[index + 1])
