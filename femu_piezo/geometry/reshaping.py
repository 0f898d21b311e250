"""How a body changes where one of its dimensions is not as drawn and the others are: smooth maps x → x + p g(x).

    inner diameter   of a ring (1 + p) times as large:       g = a (R − r)/(R − a) r̂
    end width        of a trapezoid (1 + p) times as large:  g = y s b/w(x) ŷ,   w(x) = (1 − s) w₀ + s b

with a and R the radii, s = x/L + ½ and b the width at the end x = +L/2. All lie at the origin, as shapes are drawn.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from femu_piezo.geometry.regions import Circle, Trapezoid
from femu_piezo.geometry.slab import Slab


class Reshaping(Protocol):
    """A map of the body, of size p; equal ones are the same."""

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """∂g_a/∂x_b (3, 3, …) at points x (3, …), m."""

    def volume(self, p: float) -> tuple[float, float]:
        """Volume over that at p = 0, and its slope."""


@dataclass(frozen=True)
class InnerDiameter:
    """Of a ring of inner and outer radius, m."""

    inner: float
    outer: float

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """∂g_a/∂x_b (3, 3, …): g′ along r and g/r around the axis."""
        r = np.hypot(x[0], x[1])
        out = np.stack([x[0] / r, x[1] / r, np.zeros_like(r)])
        around = np.stack([-out[1], out[0], out[2]])
        share = self.inner / (self.outer - self.inner)
        along, across = -share, share * (self.outer - r) / r
        return along * out[:, None] * out + across * around[:, None] * around

    def volume(self, p: float) -> tuple[float, float]:
        """(R² − a²(1 + p)²)/(R² − a²), and its slope."""
        whole, hole = self.outer**2 - self.inner**2, self.inner**2
        return (self.outer**2 - hole * (1 + p) ** 2) / whole, -2 * hole * (1 + p) / whole


@dataclass(frozen=True)
class EndWidth:
    """Of a trapezoid of a length and a width at x = −length/2 and at x = +length/2, m."""

    length: float
    width: float
    width_end: float

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """∂g_a/∂x_b (3, 3, …): of g_y along y and, as w(x) changes, along x."""
        share = x[0] / self.length + 0.5
        here = self.width + (self.width_end - self.width) * share
        found = np.zeros((3, 3, *x[0].shape))
        found[1, 1] = share * self.width_end / here
        found[1, 0] = x[1] * self.width * self.width_end / (self.length * here**2)
        return found

    def volume(self, p: float) -> tuple[float, float]:
        """(w₀ + b (1 + p))/(w₀ + b), and its slope."""
        both = self.width + self.width_end
        return 1 + p * self.width_end / both, self.width_end / both


def reshapings(plate: object) -> dict[str, Reshaping]:
    """Name of a dimension → how the body changes with it, of the shape of a specimen."""
    if not isinstance(plate, Slab):
        return {}
    outline = plate.outline
    if isinstance(outline, Circle) and [hole.center for hole in plate.holes] == [(0.0, 0.0)]:
        return {"inner_diameter": InnerDiameter(plate.holes[0].diameter / 2, outline.diameter / 2)}
    if isinstance(outline, Trapezoid) and 0 not in outline.mirrors:
        return {"width_end": EndWidth(outline.length, outline.width, outline.width_end)}
    return {}
