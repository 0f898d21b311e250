"""`Effect`: what a real specimen has and the base model leaves out, as data.

An effect changes the affine model A = Σ c_q A_q − ω² M at one or more of these places, each with exact slopes:

    constants   the ten d-form constants, over frequency or not         θ → θ'(ω, p)
    stretch     the dimensions along the axes                           s_a(p): ∂_a → ∂_a/s_a, dV → s_x s_y s_z dV
    density     the density                                             ρ → m(p) ρ
    reshaping   the body, by a smooth map                               x → x + p g(x)
    terms       further stiffness or inertia terms on the mesh          + c(ω, p) A_extra, − ω² m(p) M_extra
    local       terms on the reduced body whose matrices depend on p    + c(ω, p) A(p)
    circuit     a two-port around the terminals                         Z → Z'(ω, p)
    acquisition how the sweep was taken                                 Z(·) → Z'(ω, p)

Effects act in the order of `Effect.place`, whatever their order in a list. Each file of `femu_piezo.effects.library`
holds one cause; no other file has to change for it.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np
import scipy.sparse as sp

from femu_piezo.errors import InputError
from femu_piezo.forward.electrodes import Faces, electrode_faces
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.threads import made_once

if TYPE_CHECKING:
    from femu_piezo.effects.local.operators import Places
    from femu_piezo.geometry.reshaping import Reshaping
    from femu_piezo.geometry.upper_face import UpperFace

#: (θ (k, 10), tangents (k, 10, n_x) = ∂θ/∂x, ω (k,), p (n,)) → (θ', its tangents, ∂θ'/∂p (k, 10, n)). The derivative
#: of the map need only be linear over the reals (it may treat Re and Im differently); x and p are real. n_x is 0 where
#: no tangents are wanted.
ConstantsHook = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
#: p (n,) → factors s (3,) on the dimensions along x, y, z, and ∂s/∂p (3, n)
StretchHook = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
#: p (n,) → factor on the density, and its slopes ∂/∂p (n,)
DensityHook = Callable[[np.ndarray], tuple[float, np.ndarray]]
#: (ω (k,), p (n,)) → coefficient (k,) complex, and ∂/∂p (k, n)
CoefficientHook = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
#: (p (n,), area of an electrode, m²) → mass, kg, and ∂/∂p (n,)
MassHook = Callable[[np.ndarray, float], tuple[float, np.ndarray]]
#: (ω (k,), Z (k,), p (n,)) → Z' (k,), ∂Z'/∂Z (k,), ∂Z'/∂p (k, n)
CircuitHook = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]


class Reached(Protocol):
    """What an acquisition acts on: Z of the body with all effects that act before it, at any frequencies."""

    def __call__(
        self, omega: np.ndarray, *beside: tuple[Effect, np.ndarray], slopes: int | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Z (k,), ohm, and ∂Z/∂x (slopes, n_x) at frequencies (k,) rad/s.

        Each call for another body is costly, so many frequencies go into one call.

        beside : further effects that act as well, with the values of their parameters
        slopes : number of frequencies, counted from the first, at which ∂Z/∂x is wanted; all where None
        """


#: (Z before the acquisition, ω (k,), p (n,)) → Z' (k,), ∂Z'/∂x (k, n_x), ∂Z'/∂p (k, n)
AcquisitionHook = Callable[[Reached, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class LocalTerm:
    """One term of the reduced body at given parameters: value · matrix, and its slopes in the parameters.

    Attributes
    ----------
    kind : "stiffness" adds value · matrix to the operator, "inertia" −ω² value · matrix (value must not depend on ω)
    matrix : (r, r) real for stiffness, (u, u) on the displacement unknowns for inertia
    value : (k,) over frequency;  slopes : (k, n) ∂value/∂p
    constant : index of the e-form constant that multiplies the term too; None where none does
    """

    kind: Literal["stiffness", "inertia"]
    matrix: np.ndarray
    value: np.ndarray
    slopes: np.ndarray
    constant: int | None = None

    @classmethod
    def constant_over(
        cls,
        omega: np.ndarray,
        kind: Literal["stiffness", "inertia"],
        matrix: np.ndarray,
        value: complex,
        slopes: Sequence[complex] | np.ndarray,
        constant: int | None = None,
    ) -> LocalTerm:
        """A term whose value, and slopes (n,), are the same at all frequencies ω (k,)."""
        ones = np.ones(omega.size, dtype=complex)
        return cls(kind, matrix, value * ones, ones[:, None] * np.asarray(slopes), constant)


#: (operators of the reduced body, ω (k,), p (n,)) → the terms that the effect adds
LocalHook = Callable[["Places", np.ndarray, np.ndarray], list[LocalTerm]]


@dataclass(frozen=True)
class EffectParameter:
    """One real parameter of an effect.

    Attributes
    ----------
    unit : in words of SI, "1" for a pure number
    low, high : bounds of a fit, with `rest` between them
    scale : a usual size, the unit of the fit
    spread : usual distance from `rest` where the effect is present: the standard deviation of the prior of a candidate.
        For the parameters in `Effect.of_any_scale` the prior is a mixture (`femu_piezo.inference.priors`), and this its
        widest
    tolerance : usual distance from `rest` where the effect is no cause (a calliper's deviation, the residue of a
        fixture): the standard deviation of the prior in every fit; 0 where the parameter is exactly at rest
    starts : further values to start a fit from, besides the one that linearisation at `rest` gives
    rest : the value at which the effect vanishes
    optional : whether a specimen file may leave the parameter out, which puts it at `rest`
    often_small : for an optional one, whether it may be smaller than `spread` by orders of magnitude, as a size may
    law_error : standard deviation, relative to the value, of the error that the approximations of the law make in the
        parameter. For the first parameter, the size, also the share of the effect's change of log Z that the law
        misses, independently in each band
    law_detuning : for the first parameter, where the law stops at its square: relative standard deviation of the
        frequencies of modes of other classes than the driven one, over that square (in SI units), independently in each
        band
    """

    name: str
    unit: str
    low: float
    high: float
    scale: float
    spread: float
    starts: tuple[float, ...] = ()
    rest: float = 0.0
    optional: bool = False
    often_small: bool = False
    law_error: float = 0.0
    law_detuning: float = 0.0
    tolerance: float = 0.0

    def __post_init__(self) -> None:
        if not self.low <= self.rest <= self.high:
            raise InputError(
                f"parameter {self.name} of an effect: rest = {self.rest:g} is not between low = {self.low:g} and "
                f"high = {self.high:g}"
            )
        if not self.scale > 0:
            raise InputError(f"parameter {self.name} of an effect: scale = {self.scale:g} is not above zero")

    @property
    def usual(self) -> float:
        """Usual distance from `rest` where the effect is present, within the bounds."""
        return min(self.spread, self.high - self.rest)

    @property
    def after_number(self) -> str:
        """The unit as it follows a number: " kg", and nothing for a pure number."""
        return "" if self.unit == "1" else f" {self.unit}"


@dataclass(frozen=True)
class ExtraTerm:
    """A further term c A of the affine model; A (4n, 4n) is sparse over all degrees of freedom, field by field.

    Attributes
    ----------
    kind : "stiffness" adds c A to the operator, "inertia" adds −ω² c A (c must not depend on ω then)
    matrix : builds A on a mesh; in the Fourier orders of a body of revolution, which have no mesh, A is zero then
    coefficient : c(ω, p) with slopes
    training : values of c that the reduced basis must serve
    on_electrodes : builds A of what lies on the electrodes, from their faces, instead of `matrix`
    """

    name: str
    kind: Literal["stiffness", "inertia"]
    matrix: Callable[[ElectroelasticModel], sp.spmatrix] | None
    coefficient: CoefficientHook
    training: tuple[float, ...] = ()
    on_electrodes: Callable[[Faces], sp.spmatrix] | None = None

    @property
    def built(self) -> tuple[Hashable, ...]:
        """Name, kind and the function that builds A: equal for terms that one matrix serves."""
        return self.name, self.kind, self.matrix, self.on_electrodes

    def of(self, model: ElectroelasticModel) -> sp.spmatrix:
        """A (4n, 4n) on the mesh of a model."""
        return self.matrix(model) if self.on_electrodes is None else self.on_electrodes(electrode_faces(model))


def title_of(key: str) -> str:
    """The `title` of the effect with a `key`."""
    return key.partition("/")[0]


@dataclass(frozen=True, eq=False, repr=False)
class Effect:
    """A candidate cause of a misfit.

    Attributes
    ----------
    name : as in results and in the [effects] table of a specimen file
    sentence : what it is, in physical words
    variant : the constant that the candidate is about, where several candidates have one name
    law : name of the formula, where the cause has several; "" for its plain one
    owner : name of the specimen or fixture that has it, of several diagnosed together; "" where all share it
    confusable_with : names of effects and constants it may be hard to tell from
    advice : further measurements that separate it from those
    reshaping : map of the body, its size the first parameter, for a dimension that no stretch along an axis changes
    added_mass : mass that it puts on the body, which a balance sees; the hook of `terms` or `local` with inertia
    dispersive : whether `constants` or a coefficient depends on ω
    sectors : groups of unknowns beyond the driven ones that the terms couple
        (`femu_piezo.effects.local.sectors`)
    sites : (m, n) values of the parameters to start a fit from, sizes first, then the place. The slope of Z in a small
        size tells how promising a site is and which size to start from
    start_sizes : factors on the size in `sites` to start from too, for an effect whose small sizes the constants make
        up for, so that it shows in second order only; a linearisation at a size holds up to a few times that size
    onset : terms to take at size zero, where the slopes of those of `local` in the size do not hold
    outward : place of the circuit or acquisition on the way from the body to the instrument, the lowest first
    freed : whether its parameters are unknowns of every fit with the prior of a cause, as the specimen file asks
    of_unknown : whether it stands for what no cause of the library describes: it competes with the causes, and where it
        is needed the verdict is unknown
    of_specimen : whether every specimen has its own, although it changes constants
    of_conditions : whether its law depends on the conditions of a sweep (`EffectContext.conditions`), so that each of
        several sweeps of a specimen has a hook of its own, with the same parameters
    """

    name: str
    sentence: str
    parameters: tuple[EffectParameter, ...]
    variant: str = ""
    law: str = ""
    owner: str = ""
    confusable_with: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()
    constants: ConstantsHook | None = None
    stretch: StretchHook | None = None
    density: DensityHook | None = None
    reshaping: Reshaping | None = None
    terms: tuple[ExtraTerm, ...] = ()
    local: LocalHook | None = None
    added_mass: MassHook | None = None
    circuit: CircuitHook | None = None
    acquisition: AcquisitionHook | None = None
    dispersive: bool = False
    sectors: tuple[str, ...] = ()
    sites: np.ndarray | None = None
    onset: LocalHook | None = None
    start_sizes: tuple[float, ...] = ()
    outward: float = 0.0
    freed: bool = False
    of_unknown: bool = False
    of_specimen: bool = False
    of_conditions: bool = False

    def __repr__(self) -> str:
        return f"Effect({self.key!r}: {', '.join(parameter.name for parameter in self.parameters)})"

    def through(self, omega: np.ndarray, z: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What its circuit makes of Z (k,) at ω (k,): Z' (k,), ∂Z'/∂Z (k,), ∂Z'/∂p (k, n); InputError for others."""
        found = self.circuit(omega, z, p)
        several = isinstance(found, tuple | list)
        shapes = [np.shape(one) for one in found] if several else np.shape(found)
        needed = [z.shape, z.shape, (*z.shape, p.size)]
        if shapes != needed:
            raise InputError(
                f"effect {self.name}: its circuit returns shapes {shapes}; needed are Z', ∂Z'/∂Z and ∂Z'/∂p of the "
                f"shapes {needed}"
            )
        if np.isrealobj(omega) and np.all(np.isfinite(z)):  # at a pole or zero, which is complex, Z' may be infinite
            for words, one in zip(("Z'", "∂Z'/∂Z", "∂Z'/∂p"), map(np.asarray, found), strict=True):
                if one.dtype.kind not in "fci" or not np.all(np.isfinite(one)):
                    values = zip(self.parameters, p, strict=True)
                    at = ", ".join(f"{known.name} = {value:g}{known.after_number}" for known, value in values)
                    raise InputError(
                        f"effect {self.name}: {words} of its circuit is not a finite number at {at}; it has to be one "
                        "at every frequency, for all values between the bounds"
                    )
        return tuple(found)

    @property
    def within_tolerance(self) -> Effect:
        """This effect with no spread: never a candidate, its parameters within their tolerances."""
        return replace(self, parameters=tuple(replace(parameter, spread=0.0) for parameter in self.parameters))

    @property
    def within_spread(self) -> Effect:
        """This effect as an unknown of every fit, with the prior of a cause as its tolerance."""
        wide = zip(self.parameters, self.spread, strict=True)
        return replace(
            self,
            parameters=tuple(replace(parameter, spread=0.0, tolerance=float(spread)) for parameter, spread in wide),
            freed=True,
        )

    @property
    def resizes(self) -> bool:
        """Whether it changes a dimension of the body."""
        return self.stretch is not None or self.reshaping is not None

    @made_once
    def sizes(self) -> np.ndarray:
        """Indices of the parameters that say how large it is: not optional, and the same at all `sites`."""
        optional = np.array([parameter.optional for parameter in self.parameters])
        placed = optional if self.sites is None else optional | (np.ptp(self.sites, axis=0) > 0)
        return np.flatnonzero(~placed)

    @made_once
    def of_any_scale(self) -> np.ndarray:
        """Indices of the parameters that may be smaller than their `spread` by orders of magnitude."""
        return np.union1d(self.sizes, np.flatnonzero([parameter.often_small for parameter in self.parameters]))

    @property
    def on_constants(self) -> bool:
        """Whether it changes the constants, and equally at all frequencies and in all sweeps."""
        return self.constants is not None and not self.dispersive and not self.of_conditions

    @made_once
    def place(self) -> tuple[float, bool]:
        """Sort key of the order in which effects act: changes of constants, laws over frequency on the result, then
        circuits and acquisitions from the body outward, the instrument last."""
        return self.outward, self.dispersive

    @made_once
    def key(self) -> str:
        """Name, variant, owner and law, unique in the library."""
        return f"{self.title}/{self.law}" if self.law else self.title

    @made_once
    def title(self) -> str:
        """The cause in words of the library: its name, with the constant it is about and its owner."""
        name = f"{self.name}:{self.variant}" if self.variant else self.name
        return f"{name} ({self.owner})" if self.owner else name

    @property
    def rest(self) -> np.ndarray:
        """(n,) parameters at which the effect vanishes."""
        return np.array([parameter.rest for parameter in self.parameters])

    @made_once
    def scale(self) -> np.ndarray:
        """(n,) unit of each parameter in a fit."""
        found = np.array([parameter.scale for parameter in self.parameters])
        found.flags.writeable = False
        return found

    @property
    def spread(self) -> np.ndarray:
        """(n,) prior standard deviation of each parameter where the effect is tried as a cause."""
        return np.array([max(parameter.spread, parameter.tolerance) for parameter in self.parameters])

    @property
    def tolerance(self) -> np.ndarray:
        """(n,) prior standard deviation of each parameter where the effect is not tried as a cause."""
        return np.array([parameter.tolerance for parameter in self.parameters])

    @property
    def has_tolerance(self) -> bool:
        """Whether a parameter has a tolerance, so that every fit includes the effect."""
        return any(parameter.tolerance > 0 for parameter in self.parameters)

    @property
    def is_candidate(self) -> bool:
        """Whether a parameter may exceed its tolerance, so that the effect may be a cause."""
        return any(parameter.spread > parameter.tolerance for parameter in self.parameters)

    @property
    def bounds(self) -> np.ndarray:
        """(n, 2) lower and upper bounds."""
        return np.array([[parameter.low, parameter.high] for parameter in self.parameters])


@dataclass(frozen=True)
class SweepConditions:
    """How one of the sweeps of a specimen was taken.

    Attributes
    ----------
    number, count : index of the sweep, and how many the specimen has
    rising : whether its frequency rose in time
    drive : its voltage over the largest of all sweeps
    fixture : name of what held the specimen; "" where that is not said
    celsius : stated temperature, °C; None where there is none
    warmer_K : temperature above the mean of all sweeps, of all specimens that are fitted together; 0 where unknown
    span_K : half the range of all temperatures
    """

    number: int = 0
    count: int = 1
    rising: bool = True
    drive: float = 1.0
    fixture: str = ""
    celsius: float | None = None
    warmer_K: float = 0.0
    span_K: float = 0.0

    def above(self, reference: float) -> SweepConditions:
        """These conditions with the temperature counted from a reference, °C, in place of the mean."""
        warmer = 0.0 if self.celsius is None else self.celsius - reference
        return replace(self, warmer_K=warmer, span_K=max(self.span_K, abs(warmer)))


@dataclass(frozen=True)
class EffectContext:
    """What the library must know of a specimen to make its candidates.

    Attributes
    ----------
    fundamental_Hz : pole of the fundamental, where laws over frequency are anchored
    free : names of the free constants; all others are held
    constants : the ten constants of the base model
    axes : dimensions by name → the axes (0, 1, 2) along which they lie
    reshapings : dimensions that lie along no axis, by name → the map of the body that changes them
    density : kg/m³
    thickness : extent along the electrodes' normal, m
    impedance : typical |Z| of the sweep, ohm
    tolerances : standard deviations by name: relative of dimensions, of the density and of held constants ("s12"),
        absolute of their tangents ("tan_s12"), SI of the fixture's "resistance", "inductance" and "capacitance";
        relative "accuracy" and "phase_accuracy" (rad) of the instrument. What has none is known exactly.
    density_from_mass : whether the density follows from a mass, so that a larger body is a lighter material
    band_Hz : lowest and highest frequency of all sweeps that are fitted together
    pace_Hz : frequencies that the sweep reached after equal shares of its time, rising; empty where it went evenly
        through `band_Hz`
    dimensions : length, width, thickness of a plate with three mirror planes, m; None for other bodies
    radii : inner and outer radius of a disk or ring with covered faces, poled along its axis, m; None for others
    upper : the upper face of any other body, where a mass may stick or a support stand; None where there is none
    poling : "thickness" (k31) or "length" (k33)
    poling_axis, field_axis : the axes (0, 1, 2) nearest to the poling and to the field between the electrodes
    conditions : how the sweep was taken
    """

    fundamental_Hz: float
    free: tuple[str, ...]
    constants: PiezoConstants
    axes: Mapping[str, tuple[int, ...]]
    density: float
    thickness: float
    impedance: float = field(default=1e3)
    dimensions: tuple[float, float, float] | None = None
    radii: tuple[float, float] | None = None
    poling: str = "thickness"
    tolerances: Mapping[str, float] = field(default_factory=dict)
    band_Hz: tuple[float, float] = (100.0, 1e6)
    reshapings: Mapping[str, Reshaping] = field(default_factory=dict)
    density_from_mass: bool = False
    pace_Hz: tuple[float, ...] = ()
    conditions: SweepConditions = field(default_factory=SweepConditions)
    upper: UpperFace | None = None
    poling_axis: int = 2
    field_axis: int = 2

    @property
    def is_regular(self) -> bool:
        """Whether it is a plate with three mirror planes, a disk or a ring."""
        return self.dimensions is not None or self.radii is not None

    @property
    def height(self) -> float:
        """Extent along z, m."""
        if self.upper is not None:
            return self.upper.height
        return self.thickness if self.dimensions is None else self.dimensions[2]

    @property
    def mass(self) -> float | None:
        """Mass of the body, kg; None without `dimensions`, `radii` and `upper`."""
        if self.radii is not None:
            return float(np.pi * (self.radii[1] ** 2 - self.radii[0] ** 2) * self.thickness * self.density)
        if self.upper is not None:
            return self.upper.volume * self.density
        return None if self.dimensions is None else float(np.prod(self.dimensions) * self.density)
