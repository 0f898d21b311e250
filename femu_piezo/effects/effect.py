"""`Effect`: something a real specimen has and the base model leaves out, as data.

An effect changes the affine model A = Σ c_q A_q − ω² M at one or more of these places, each with exact slopes:

    constants   the ten d-form constants, over frequency or not         θ → θ'(ω, p)
    stretch     the dimensions along the axes                           s_a(p): ∂_a → ∂_a/s_a, dV → s_x s_y s_z dV
    density     the density                                             ρ → m(p) ρ
    reshaping   the body, by a smooth map                               x → x + p g(x)
    terms       further stiffness or inertia terms on the mesh          + c(ω, p) A_extra, − ω² m(p) M_extra
    local       terms at a place that is itself a parameter             + c(ω, p) A(p), on the reduced plate
    circuit     a two-port around the terminals                         Z → Z'(ω, p)
    acquisition how the sweep was taken                                 Z(·) → Z'(ω, p)

Effects compose in an order of their own (`Effect.place`), whatever list they stand in. Each file of
`femu_piezo.effects.library` holds one cause; it needs no change anywhere else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np
import scipy.sparse as sp

from femu_piezo.forward.electrodes import Faces, electrode_faces
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.threads import made_once

if TYPE_CHECKING:
    from femu_piezo.effects.local.operators import Places
    from femu_piezo.geometry.reshaping import Reshaping
    from femu_piezo.geometry.upper_face import UpperFace

#: (θ (k, 10), tangents (k, 10, n_x) = ∂θ/∂x, ω (k,), p (n,)) → (θ', its tangents, ∂θ'/∂p (k, 10, n)). The map may be
#: real-linear only (it may treat Re and Im apart); x and p are real.
ConstantsHook = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
#: p (n,) → factors s (3,) on the dimensions along x, y, z, and ∂s/∂p (3, n)
StretchHook = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
#: p (n,) → factor on the density, and its slopes ∂/∂p (n,)
DensityHook = Callable[[np.ndarray], tuple[float, np.ndarray]]
#: (ω (k,), p (n,)) → coefficient (k,) complex, and ∂/∂p (k, n)
CoefficientHook = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
#: (ω (k,), Z (k,), p (n,)) → Z' (k,), ∂Z'/∂Z (k,), ∂Z'/∂p (k, n)
CircuitHook = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]


class Reached(Protocol):
    """What an acquisition acts on: Z as it is inside of it, at any frequencies."""

    def __call__(
        self, omega: np.ndarray, *beside: tuple[Effect, np.ndarray], slopes: int | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Z (k,) and ∂Z/∂x (slopes, n_x) at frequencies (k,) rad/s, with further effects at given values beside.

        What costs most is asking again for another body, so many frequencies go into one call.

        slopes : how many of the frequencies, the first ones, these are wanted at; all where None
        """


#: (Z inside, ω (k,), p (n,)) → Z' (k,), ∂Z'/∂x (k, n_x), ∂Z'/∂p (k, n)
AcquisitionHook = Callable[[Reached, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class LocalTerm:
    """One term of the reduced plate at given parameters: value · matrix, and its slopes in the parameters.

    Attributes
    ----------
    kind : "stiffness" adds value · matrix to the operator, "inertia" −ω² value · matrix (value must not depend on ω)
    matrix : (r, r) real for stiffness, (u, u) on the displacement unknowns for inertia
    value : (k,) over frequency;  slopes : (k, n) ∂value/∂p
    constant : number of the e-form constant that multiplies it, where one does
    """

    kind: Literal["stiffness", "inertia"]
    matrix: np.ndarray
    value: np.ndarray
    slopes: np.ndarray
    constant: int | None = None


#: (places of the reduced plate, ω (k,), p (n,)) → its terms
LocalHook = Callable[["Places", np.ndarray, np.ndarray], list[LocalTerm]]


@dataclass(frozen=True)
class EffectParameter:
    """One real parameter of an effect.

    Attributes
    ----------
    unit : in words of SI, "1" for a pure number
    low, high : bounds of a fit; 0 (or `rest`) lies between: there the effect vanishes
    scale : a usual size, the unit of the fit
    spread : how far from `rest` such effects usually are where there is one: the standard deviation of the prior of a
        candidate; of a size the largest one of its prior, which is a mixture (`femu_piezo.inference.priors`)
    tolerance : how far from `rest` it may be without being an effect (a calliper's deviation, the residue of a
        fixture): the standard deviation of the prior that every fit has; 0 where it is exactly at rest
    starts : further values to start a fit from, beside the one that linearisation at `rest` gives
    rest : the value at which the effect vanishes
    optional : whether a specimen file may leave it out; it is at `rest` then
    law_error : standard deviation, relative to the value, by which the law's own approximations miss the parameter; of
        the first one, the size, also the share of the effect's change of log Z that they miss in each band by itself
    law_detuning : of the first one, where the law ends with the square of the size: relative standard deviation of the
        frequencies of modes of other classes than the driven one, in each band by itself, over that square
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
    law_error: float = 0.0
    law_detuning: float = 0.0
    tolerance: float = 0.0

    @property
    def after_number(self) -> str:
        """The unit as it follows a number: " kg", and nothing for a pure number."""
        return "" if self.unit == "1" else f" {self.unit}"


@dataclass(frozen=True)
class ExtraTerm:
    """A further term of the affine model; builds A, (4n, 4n) sparse over all degrees of freedom, fields in turn.

    Attributes
    ----------
    kind : "stiffness" adds c A to the operator, "inertia" adds −ω² c A (c must not depend on ω then)
    matrix : A on a mesh; the Fourier orders of a body of revolution, which have none, go without it
    coefficient : c(ω, p) with slopes
    training : values of c that the reduced basis must serve
    on_electrodes : A of something that lies on the electrodes, instead of `matrix`
    """

    name: str
    kind: Literal["stiffness", "inertia"]
    matrix: Callable[[ElectroelasticModel], sp.spmatrix] | None
    coefficient: CoefficientHook
    training: tuple[float, ...] = ()
    on_electrodes: Callable[[Faces], sp.spmatrix] | None = None

    def of(self, model: ElectroelasticModel) -> sp.spmatrix:
        """(4n, 4n) on the mesh of a model."""
        return self.matrix(model) if self.on_electrodes is None else self.on_electrodes(electrode_faces(model))


@dataclass(frozen=True, eq=False, repr=False)
class Effect:
    """A candidate cause of a misfit.

    Attributes
    ----------
    name : as in results and in the [effects] table of a specimen file
    sentence : what it is, in physical words
    variant : the constant that is meant, where one name has several candidates
    law : another formula of the same cause, where it has several
    specimen : name of the specimen that has the effect, of several diagnosed together; "" where all share it
    confusable_with : names of effects and constants it may be hard to tell from
    advice : further measurements that separate it from those
    reshaping : map of the body whose size is the first parameter, of a dimension that no stretch along an axis changes
    dispersive : whether `constants` or a coefficient depends on ω
    sectors : groups of unknowns beyond the driven ones that the terms couple
        (`femu_piezo.effects.local.sectors`)
    sites : (m, n) parameters to start a fit from: the size, then where it sits. How Z moves with a small size tells
        how promising each is and what size it asks for
    start_sizes : where the constants make up for what a small size does, so that it shows in second order first: sizes
        to start from, over that in `sites`; linearisation at one holds to a few times of it
    onset : terms whose slopes in the size hold at size zero, where those of `local` do not
    outward : place of the circuit or acquisition on the way from the body to the instrument, the lowest first
    freed : whether every fit has it with the prior of a cause, as the specimen file asks
    of_unknown : whether it is a form that what no cause describes may have: it competes as causes do, and where it is
        needed the verdict is unknown
    of_conditions : whether its law holds the conditions of a sweep (`EffectContext.taken`), so that each of several
        sweeps of a specimen has its own form of it, with the same parameters
    """

    name: str
    sentence: str
    parameters: tuple[EffectParameter, ...]
    variant: str = ""
    law: str = ""
    specimen: str = ""
    confusable_with: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()
    constants: ConstantsHook | None = None
    stretch: StretchHook | None = None
    density: DensityHook | None = None
    reshaping: Reshaping | None = None
    terms: tuple[ExtraTerm, ...] = ()
    local: LocalHook | None = None
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
    of_conditions: bool = False

    def __repr__(self) -> str:
        return f"Effect({self.key!r}: {', '.join(parameter.name for parameter in self.parameters)})"

    @property
    def within_tolerance(self) -> Effect:
        """The same as no candidate: no larger than its tolerance."""
        return replace(self, parameters=tuple(replace(one, spread=0.0) for one in self.parameters))

    @property
    def within_spread(self) -> Effect:
        """The same as an unknown of every fit, with the prior of a cause."""
        wide = zip(self.parameters, self.spread, strict=True)
        return replace(
            self,
            parameters=tuple(replace(one, spread=0.0, tolerance=float(spread)) for one, spread in wide),
            freed=True,
        )

    @property
    def resizes(self) -> bool:
        """Whether it is about a dimension of the body."""
        return self.stretch is not None or self.reshaping is not None

    @made_once
    def sizes(self) -> np.ndarray:
        """Numbers of the parameters of an effect at a place that say how large it is: those that vanish with it."""
        optional = np.array([parameter.optional for parameter in self.parameters])
        placed = optional if self.sites is None else optional | (np.ptp(self.sites, axis=0) > 0)
        return np.flatnonzero(~placed)

    @property
    def on_constants(self) -> bool:
        """Whether it changes the constants alike at all frequencies."""
        return self.constants is not None and not self.dispersive

    @made_once
    def place(self) -> tuple[float, bool]:
        """Where it stands among the effects of a body: laws over frequency act on the constants as they are, circuits
        follow outward, the instrument is last."""
        return self.outward, self.dispersive

    @made_once
    def key(self) -> str:
        """Name, variant, specimen and law, unique in the library."""
        return f"{self.title}/{self.law}" if self.law else self.title

    @made_once
    def title(self) -> str:
        """The cause in words of the library: its name, with the constant it is about and the specimen that has it."""
        name = f"{self.name}:{self.variant}" if self.variant else self.name
        return f"{name} ({self.specimen})" if self.specimen else name

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
        """(n,) prior standard deviation of each parameter where it is not."""
        return np.array([parameter.tolerance for parameter in self.parameters])

    @property
    def has_tolerance(self) -> bool:
        """Whether every fit has it, within its tolerance."""
        return bool(np.any(self.tolerance > 0))

    @property
    def is_candidate(self) -> bool:
        """Whether it may be larger than its tolerance, and so be a cause."""
        return bool(np.any(self.spread > self.tolerance))

    @property
    def bounds(self) -> np.ndarray:
        """(n, 2) lower and upper bounds."""
        return np.array([[parameter.low, parameter.high] for parameter in self.parameters])


@dataclass(frozen=True)
class Taken:
    """How a sweep was taken, among all of its specimen.

    Attributes
    ----------
    number, count : which of how many it is
    rising : whether its frequency rose in time
    drive : its amplitude over the largest of all
    fixture : what held the specimen, by name; "" where that is not said
    warmer_K : temperature of the specimen above the mean of all;  span_K : half the range of all, 0 where unknown
    """

    number: int = 0
    count: int = 1
    rising: bool = True
    drive: float = 1.0
    fixture: str = ""
    warmer_K: float = 0.0
    span_K: float = 0.0


@dataclass(frozen=True)
class EffectContext:
    """What the library must know of a specimen to make its candidates.

    Attributes
    ----------
    fundamental_Hz : pole of the fundamental, where laws over frequency are anchored
    free : names of the free constants; all others are held
    constants : the ten constants of the base model
    axes : the dimensions that the specimen has, by name, as the axes (0, 1, 2) along which they lie
    reshapings : further ones, by name, as maps of the body
    density : kg/m³
    thickness : extent along the electrodes' normal, m
    impedance : typical |Z| of the sweep, ohm
    tolerances : standard deviations by name: relative of dimensions, of the density and of held constants ("s12"),
        absolute of their tangents ("tan_s12"), SI of the fixture's "resistance", "inductance" and "capacitance";
        relative "accuracy" and "phase_accuracy" (rad) of the instrument. What has none is known exactly.
    weighed : whether the density follows from a mass, so that a larger body is a lighter material
    band_Hz : lowest and highest frequency of the sweep
    pace_Hz : frequencies of the sweep after even shares of its time, rising; `band_Hz` at an even pace where empty
    dimensions : length, width, thickness of a plate with three mirror planes, m; None for other bodies
    radii : inner and outer radius of a disk or ring with covered faces, poled along its axis, m; None for others
    upper : the face of any other body where something may stick or stand; None for those
    poling : "thickness" (k31) or "length" (k33)
    taken : how the sweep was taken
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
    weighed: bool = False
    pace_Hz: tuple[float, ...] = ()
    taken: Taken = field(default_factory=Taken)
    upper: UpperFace | None = None

    @property
    def is_regular(self) -> bool:
        """Whether it is a plate with three mirror planes, a disk or a ring."""
        return self.dimensions is not None or self.radii is not None

    @property
    def mass(self) -> float | None:
        """Of the body, kg; None where its dimensions are not known."""
        if self.radii is not None:
            return float(np.pi * (self.radii[1] ** 2 - self.radii[0] ** 2) * self.thickness * self.density)
        if self.upper is not None:
            return self.upper.volume * self.density
        return None if self.dimensions is None else float(np.prod(self.dimensions) * self.density)
