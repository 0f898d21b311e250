"""From hidden effects to a sweep: effects change a `Build` one after another, and the build gives the body and its
Z.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from hidden_effects.body import Body
from hidden_effects.reduced import Plate
from hidden_effects.spectral import Axis, joined

Law = Callable[[np.ndarray, float], np.ndarray]  # (constants (10,), frequency in Hz) → constants
Circuit = Callable[[np.ndarray, np.ndarray], np.ndarray]  # (ω (k,), Z (k,)) → Z'
Profile = Callable[[np.ndarray], np.ndarray]

#: Degrees along x (for the whole length), y, z; and those where a surface covers only a part of a face.
_DEGREES, _FINE = (14, 10, 6), (16, 11, 6)


@dataclass(frozen=True)
class Grading:
    """Elements at the edge of an electrode, where the fields are singular.

    Attributes
    ----------
    along : distances of their ends from the edge, m
    degree : of these elements;  across : of the ones along y and z
    """

    along: tuple[float, ...]
    degree: int
    across: tuple[int, int]


#: Gradings of the displacements and of φ. Their errors have opposite signs; at these orders they cancel to 1e-4 in Z.
#: tests/hidden_effects/test_solver.py compares them with strongly graded elements.
_GRADING = Grading((0.05e-3,), 3, (8, 8)), Grading((0.015e-3, 0.1e-3), 4, (6, 14))


@dataclass(kw_only=True)
class Swept:
    """The steps from a body with constants `theta` to its sweep that plates and round bodies share.

    Attributes
    ----------
    admittance : of the specimen over that of the plates, for the sizes of what stands parallel to it
    warp : frequency (k,) → frequency at which the linear body answers, for what no linear body does
    """

    poling: int = 2
    admittance: float = 1.0
    surfaces: list = field(default_factory=list)
    laws: list[Law] = field(default_factory=list)
    relaxations: list[Law] = field(default_factory=list)
    circuits: list[Circuit] = field(default_factory=list)
    warp: Profile | None = None

    def body(self):
        """The body without its surfaces."""
        raise NotImplementedError

    def constants(self, frequency: float) -> np.ndarray:
        """(10,) d-form constants at a frequency in Hz."""
        return _followed((*self.laws, *self.relaxations), self.theta, frequency)

    def stated(self, frequency: float) -> np.ndarray:
        """(10,) d-form constants as tables state them: real parts at this frequency, loss tangents without the loss
        of a relaxation.
        """
        whole, without = self.constants(frequency).real, _followed(self.laws, self.theta, frequency)
        return whole * (1 + 1j * without.imag / without.real)

    def impedance(self, frequency: np.ndarray) -> np.ndarray:
        """Z (k,), ohm, as it would be measured without noise."""
        plate = Plate(self.body(), self.theta, float(frequency.max()), self.surfaces)
        answered = frequency if self.warp is None else self.warp(frequency)
        z = plate.impedance(self.constants if self.laws or self.relaxations else self.theta, answered)
        for circuit in self.circuits:
            z = circuit(2 * np.pi * frequency, z)
        return z


def _followed(laws: Iterable[Law], theta: np.ndarray, frequency: float) -> np.ndarray:
    """(10,) constants after all laws at a frequency in Hz."""
    for law in laws:
        theta = law(theta, frequency)
    return theta


@dataclass
class Build(Swept):
    """A specimen to be: the simple plate, changed by effects.

    Attributes
    ----------
    theta : (10,) true d-form constants
    fundamental : Hz, where laws over frequency are anchored: the first pole of the plate without effects
    elements, elements_across : further ends of elements along x, and along y, m
    """

    size: np.ndarray
    density: float
    theta: np.ndarray
    fundamental: float
    taper: float = 0.0
    wedge: float = 0.0
    margins: tuple[float, float] = (0.0, 0.0)
    stiffness: list[Profile] = field(default_factory=list)
    piezoelectric: list[Profile] = field(default_factory=list)
    heaviness: list[Profile] = field(default_factory=list)
    piezoelectric_across: list[Profile] = field(default_factory=list)
    soft: tuple[Profile, Profile] | None = None
    elements: list[float] = field(default_factory=list)
    elements_across: list[float] = field(default_factory=list)

    @property
    def area(self) -> float:
        """Area of one large face, m²."""
        return float(self.size[0] * self.size[1])

    @property
    def whole_face(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Ends of the large faces along x and y, m."""
        return (-self.size[0] / 2, self.size[0] / 2), (-self.size[1] / 2, self.size[1] / 2)

    def pole(self, near: float) -> float:
        """Frequency in Hz of the largest conductance of the body between 0.7 and 1.1 times `near`."""
        plate, frequency = Plate(self.body(), self.theta, 1.1 * near), np.linspace(0.7, 1.1, 161) * near
        for _ in range(3):
            conductance = (1 / plate.impedance(self.theta, frequency)).real
            at, step = frequency[np.argmax(conductance)], frequency[1] - frequency[0]
            frequency = np.linspace(at - step, at + step, 41)
        return float(at)

    def body(self) -> Body:
        """The body without its surfaces."""
        half = self.size / 2
        symmetric = (
            not (self.taper or self.wedge or self.stiffness or self.piezoelectric or self.heaviness or self.soft)
            and self.margins[0] == self.margins[1]
        )
        degrees = _FINE if any(not all(surface.keeps()[:2]) for surface in self.surfaces) else _DEGREES
        ends = joined((-half[0], half[0]), self.elements)
        axes = [self._along(ends, degrees[0]), *self._across(degrees[1:])]
        if self.elements_across:
            axes[1] = self._along(joined((-half[1], half[1]), self.elements_across), degrees[1])
        potential = axes
        if max(self.margins) > 0:
            axes, potential = ([self._margined(ends, g), *self._across(g.across)] for g in _GRADING)
        return Body(
            size=tuple(self.size),
            density=self.density,
            axes=tuple(axes),
            potential_axes=tuple(potential),
            poling=self.poling,
            margins=self.margins,
            profiles={
                "c": _product(self.stiffness),
                "e": _product(self.piezoelectric),
                "rho": _product(self.heaviness),
            },
            soft=self.soft,
            across=_product(self.piezoelectric_across),
            taper=self.taper,
            wedge=self.wedge,
            symmetric=symmetric,
        )

    def _along(self, ends: np.ndarray, degree: int, least: int = 3) -> Axis:
        """Elements along x or y with degrees by their length, at least `least`."""
        share = np.diff(ends) / np.ptp(ends)
        return Axis(tuple(ends), tuple(int(np.clip(round(degree * s) + 3, least, degree)) for s in share))

    def _across(self, degrees) -> list[Axis]:
        """One element along y and one along z."""
        return [Axis((-s / 2, s / 2), (p,)) for s, p in zip(self.size[1:], degrees, strict=True)]

    def _margined(self, ends: np.ndarray, grading: Grading) -> Axis:
        """Elements along x that grow away from the edges of the electrodes."""
        half = self.size[0] / 2
        edges = [-half + self.margins[0], half - self.margins[1]]
        fine = [e + s * g for e in edges for g in (0.0, *grading.along) for s in (-1, 1)]
        inside = [p for p in fine if abs(p) < half - 0.2 * min(grading.along)]
        return self._along(joined(ends, inside), _DEGREES[0], grading.degree)


def _product(profiles: list[Profile]) -> Profile:
    def whole(x: np.ndarray) -> np.ndarray:
        return np.prod([np.ones_like(x), *(profile(x) for profile in profiles)], axis=0)

    return whole
