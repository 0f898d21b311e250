"""Rectangular plates and bars: dimensions, symmetry, and a mesh fine enough for an accuracy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.geometry.boxes import FACES, unit_box
from femu_piezo.geometry.domain import Domain
from femu_piezo.geometry.shape import check_size, driven_mirrors, unit_direction

#: Eigenvalue error of quadratic hexahedra of edge h at shear wavenumber k: about this times (k h)^4. Measured over
#: plates and bars of several proportions (tests/verification/test_convergence.py holds it to be an upper bound).
_ERROR_CONSTANT = 3e-3

#: All three mirror planes: one eighth of the plate. () is the full plate; (1, 2) leaves the length unsymmetric.
EIGHTH = (0, 1, 2)


@dataclass(frozen=True)
class Plate:
    """Rectangular plate, length × width × thickness along x, y, z (m), centred at the origin.

    poling "thickness" (k31): electrodes on the two large faces, poled along z.
    poling "length" (k33): electrodes on the two ends, poled along x.
    direction : poling direction where it is not that of the field between the electrodes, e.g. (1, 0, 0) for a
        thickness-shear plate poled along its length
    """

    length: float
    width: float
    thickness: float
    poling: Literal["thickness", "length"] = "thickness"
    direction: tuple[float, float, float] | None = None

    @property
    def poling_direction(self) -> tuple[float, float, float]:
        """(3,) unit vector of the poling."""
        along = np.eye(3)[self.poling_axis] if self.direction is None else self.direction
        return unit_direction(along)

    @property
    def volume(self) -> float:
        """m³"""
        return float(np.prod(self.dimensions))

    @property
    def mirrors(self) -> tuple[int, ...]:
        """Axes about whose mid-plane the driven field is symmetric: all three where poled along the field."""
        return driven_mirrors(EIGHTH, self.poling_direction, self.poling_axis)

    @property
    def dimensions(self) -> np.ndarray:
        """(3,) length, width, thickness, m."""
        return np.array([self.length, self.width, self.thickness])

    @property
    def poling_axis(self) -> int:
        """Axis of the field between the electrodes."""
        return 2 if self.poling == "thickness" else 0

    @property
    def electrode_area(self) -> float:
        """Area of one electrode, m²."""
        return float(np.prod(self.dimensions) / self.electrode_gap)

    @property
    def electrode_gap(self) -> float:
        """Distance between the electrodes, m."""
        return float(self.dimensions[self.poling_axis])

    def divisions(
        self,
        accuracy: float,
        frequency_Hz: float,
        shear_speed: float,
        symmetric_axes: tuple[int, ...] = EIGHTH,
    ) -> tuple[int, int, int]:
        """Hexahedra along x, y, z for quadratic elements that keep eigenvalues within `accuracy` of converged.

        Parameters
        ----------
        accuracy : relative error of λ at `frequency_Hz`; lower modes are more accurate by the fourth power
        frequency_Hz : highest frequency of interest
        shear_speed : slowest shear wave, m/s
        """
        edge = (accuracy / _ERROR_CONSTANT) ** 0.25 * shear_speed / (2 * np.pi * frequency_Hz)
        halves = np.array([2.0 if axis in symmetric_axes else 1.0 for axis in range(3)])
        return tuple(int(count) for count in np.ceil(self.dimensions / halves / edge))

    def domain_for(self, accuracy: float, frequency_Hz: float, shear_speed: float, symmetric: bool = True) -> Domain:
        """The computed part with elements fine enough; see `femu_piezo.geometry.shape.Shape`."""
        axes = self.mirrors if symmetric else ()
        divisions = self.divisions(accuracy, frequency_Hz, shear_speed, axes)
        check_size(float(np.prod(divisions)), "hexahedron")
        return self.domain(divisions, axes)

    def domain(self, divisions: tuple[int, int, int], symmetric_axes: tuple[int, ...] = EIGHTH) -> Domain:
        """The computed part, cut at the mid-plane of every axis in `symmetric_axes`.

        Parameters
        ----------
        divisions : hexahedra along x, y, z of the computed part
        symmetric_axes : axes about whose mid-plane the driven field is symmetric; () gives the full plate
        """
        if any(count < 1 for count in divisions):
            raise InputError(f"mesh divisions must be at least 1 along each axis, got {divisions}")
        if set(symmetric_axes) - set(self.mirrors):
            raise InputError(
                f"a plate with its field along axis {self.poling_axis} and poled along {self.poling_direction} has no "
                f"mirror planes normal to the axes {symmetric_axes}; it has those of {self.mirrors}"
            )
        size = np.array(
            [extent / 2 if axis in symmetric_axes else extent for axis, extent in enumerate(self.dimensions)]
        )
        origin = np.array(
            [0.0 if axis in symmetric_axes else -extent / 2 for axis, extent in enumerate(self.dimensions)]
        )
        mesh = unit_box(divisions).scaled(size).translated(origin)
        hot, ground = FACES[2 * self.poling_axis + 1], FACES[2 * self.poling_axis]
        return Domain(
            mesh=mesh,
            hot=(hot,),
            ground=(ground,),
            symmetry={FACES[2 * axis]: axis for axis in symmetric_axes},
            copies=2 ** len(symmetric_axes),
            voltage_factor=2.0 if self.poling_axis in symmetric_axes else 1.0,
            poling=self.poling_direction,
        )
