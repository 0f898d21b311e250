"""Change of a body where a single dimension differs from the drawing: smooth maps x → x + p g(x).

    inner diameter   of a ring (1 + p) times as large:       g = a (R − r)/(R − a) r̂
    end width        of a trapezoid (1 + p) times as large:  g = y s b/w(x) ŷ,   w(x) = (1 − s) w₀ + s b

with a and R the radii, s = x/L + ½, w₀ and b the widths at the ends x = −L/2 and x = +L/2. Bodies are centred at the
origin, as shapes are drawn.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from femu_piezo.geometry.regions import Circle, Trapezoid
from femu_piezo.geometry.slab import Slab


class Reshaping(Protocol):
    """A map x → x + p g(x) of the body, of size p; maps with equal attributes compare equal."""

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """∂g_a/∂x_b (3, 3, …) at points x (3, …), m."""

    def volume(self, p: float) -> tuple[float, float]:
        """Volume over that at p = 0, and the derivative of this ratio by p."""


@dataclass(frozen=True)
class InnerDiameter:
    """Map of a ring with inner and outer radius, m, whose inner radius is (1 + p) times as large."""

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
        """(R² − a²(1 + p)²)/(R² − a²), and its derivative by p."""
        whole, hole = self.outer**2 - self.inner**2, self.inner**2
        return (self.outer**2 - hole * (1 + p) ** 2) / whole, -2 * hole * (1 + p) / whole


@dataclass(frozen=True)
class EndWidth:
    """Map of a trapezoid, `width` at x = −length/2, m, whose `width_end` at x = +length/2 is (1 + p) times as large."""

    length: float
    width: float
    width_end: float

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """∂g_a/∂x_b (3, 3, …): only ∂g_y/∂y and, as w depends on x, ∂g_y/∂x are not zero."""
        share = x[0] / self.length + 0.5
        here = self.width + (self.width_end - self.width) * share
        found = np.zeros((3, 3, *x[0].shape))
        found[1, 1] = share * self.width_end / here
        found[1, 0] = x[1] * self.width * self.width_end / (self.length * here**2)
        return found

    def volume(self, p: float) -> tuple[float, float]:
        """(w₀ + b (1 + p))/(w₀ + b), and its derivative by p."""
        total = self.width + self.width_end
        return 1 + p * self.width_end / total, self.width_end / total


def reshapings(plate: object) -> dict[str, Reshaping]:
    """Name of a dimension → map of the body when it changes, for the shape of a specimen; {} where there is none."""
    if not isinstance(plate, Slab):
        return {}
    outline = plate.outline
    if isinstance(outline, Circle) and [hole.center for hole in plate.holes] == [(0.0, 0.0)]:
        return {"inner_diameter": InnerDiameter(plate.holes[0].diameter / 2, outline.diameter / 2)}
    if isinstance(outline, Trapezoid) and 0 not in outline.mirrors:
        return {"width_end": EndWidth(outline.length, outline.width, outline.width_end)}
    return {}
