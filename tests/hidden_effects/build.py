"""From what is hidden to a sweep: effects change a `Build` one after another, the build makes the body and its Z."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from hidden_effects.body import Body, Surface
from hidden_effects.reduced import Plate
from hidden_effects.spectral import Axis, joined

Law = Callable[[np.ndarray, float], np.ndarray]  # (constants (10,), frequency in Hz) → constants
Circuit = Callable[[np.ndarray, np.ndarray], np.ndarray]  # (ω (k,), Z (k,)) → Z'
Profile = Callable[[np.ndarray], np.ndarray]

#: Degrees along x (for the whole length), y, z; with something on a small part of a face; of φ with bare margins.
_DEGREES, _FINE, _MARGIN = (14, 10, 6), (16, 11, 6), (8, 20)
#: Elements beside the edge of an electrode, m from it.
_GRADING = (0.05e-3, 0.3e-3)


@dataclass
class Build:
    """A specimen to be: the simple plate, changed by effects.

    Attributes
    ----------
    theta : (10,) true d-form constants
    fundamental : Hz, where laws over frequency are anchored
    elements : further ends of elements along x, m
    warp : frequency (k,) → frequency at which the linear body answers, for what no linear body does
    """

    size: np.ndarray
    density: float
    theta: np.ndarray
    fundamental: float
    poling: int = 2
    taper: float = 0.0
    margins: tuple[float, float] = (0.0, 0.0)
    stiffness: list[Profile] = field(default_factory=list)
    piezoelectric: list[Profile] = field(default_factory=list)
    elements: list[float] = field(default_factory=list)
    surfaces: list[Surface] = field(default_factory=list)
    laws: list[Law] = field(default_factory=list)
    circuits: list[Circuit] = field(default_factory=list)
    warp: Profile | None = None

    @property
    def area(self) -> float:
        """Of one large face, m²."""
        return float(self.size[0] * self.size[1])

    @property
    def whole_face(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Ends of the large faces along x and y, m."""
        return (-self.size[0] / 2, self.size[0] / 2), (-self.size[1] / 2, self.size[1] / 2)

    def constants(self, frequency: float) -> np.ndarray:
        """(10,) d-form constants at a frequency in Hz."""
        theta = self.theta
        for law in self.laws:
            theta = law(theta, frequency)
        return theta

    def body(self) -> Body:
        """The piece without what stands on its surfaces."""
        half = self.size / 2
        symmetric = not (self.taper or self.stiffness or self.piezoelectric) and self.margins[0] == self.margins[1]
        degrees = _FINE if any(not all(surface.keeps()[:2]) for surface in self.surfaces) else _DEGREES
        ends = joined((-half[0], half[0]), self.elements)
        axes = [self._along(ends, degrees[0]), *self._across(degrees[1:])]
        if max(self.margins) == 0:
            potential = axes
        else:
            edges = [-half[0] + self.margins[0], half[0] - self.margins[1]]
            axes[0] = self._along(
                joined(ends, *([e - g, e, e + g] for e in edges for g in (_GRADING[1:] if symmetric else (0.0,)))),
                degrees[0],
            )
            fine = [e + s * g for e in edges for g in (0.0, *_GRADING) for s in (-1, 1)]
            inside = [p for p in fine if abs(p) < half[0] - 0.2 * _GRADING[0]]
            potential = [self._along(joined(ends, inside), degrees[0]), *self._across(_MARGIN)]
        return Body(
            size=tuple(self.size),
            density=self.density,
            axes=tuple(axes),
            potential_axes=tuple(potential),
            poling=self.poling,
            margins=self.margins,
            profiles={"c": _product(self.stiffness), "e": _product(self.piezoelectric)},
            taper=self.taper,
            symmetric=symmetric,
        )

    def _along(self, ends: np.ndarray, degree: int) -> Axis:
        """Elements along x, their degrees by their length."""
        half = self.size[0] / 2
        ends = np.array([e for e in ends if abs(e) <= half + 1e-12])
        share = np.diff(ends) / (2 * half)
        return Axis(
            tuple(ends), tuple(int(np.clip(round(degree * s) + 3, 4 if s > 0.05 else 3, degree)) for s in share)
        )

    def _across(self, degrees) -> list[Axis]:
        return [Axis((-s / 2, s / 2), (p,)) for s, p in zip(self.size[1:], degrees, strict=True)]

    def impedance(self, frequency: np.ndarray) -> np.ndarray:
        """Z (k,), ohm, as it would be measured without noise."""
        plate = Plate(self.body(), self.theta, float(frequency.max()), self.surfaces)
        own = frequency if self.warp is None else self.warp(frequency)
        z = plate.impedance(self.constants if self.laws else self.theta, own)
        for circuit in self.circuits:
            z = circuit(2 * np.pi * frequency, z)
        return z


def _product(profiles: list[Profile]) -> Profile:
    def whole(x: np.ndarray) -> np.ndarray:
        return np.prod([np.ones_like(x), *(profile(x) for profile in profiles)], axis=0)

    return whole
