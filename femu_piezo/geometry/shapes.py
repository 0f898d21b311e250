"""Rectangular plates and bars: dimensions, symmetry, and meshes fine enough for a required accuracy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.geometry.boxes import FACES, unit_box
from femu_piezo.geometry.domain import Domain
from femu_piezo.geometry.shape import (
    bending_wavenumber,
    check_unknowns,
    driven_mirrors,
    edge_error,
    fits,
    solution_cost,
    unit_direction,
    wave_error,
)
from femu_piezo.geometry.upper_face import UpperFace

#: Element orders to choose from.
ORDERS = range(2, 9)
#: Least order of elements that bend: thin ones of third order are too stiff, 1.6e-3 in λ where waves alone say 3e-4.
_BENDS_WELL = 4

#: Least number of elements along the length of a plate: long elements follow waves, but not a crack, which yields
#: within a thin slice.
LEAST_ALONG = 16
#: All three mirror planes: one eighth of the plate. () is the full plate; (1, 2) has no mirror plane across the length.
EIGHTH = (0, 1, 2)


@dataclass(frozen=True)
class Plate:
    """Rectangular plate, length × width × thickness along x, y, z (m), centred at the origin.

    poling "thickness" (k31): electrodes on the two large faces, poled along z.
    poling "length" (k33): electrodes on the two ends, poled along x.
    direction : poling direction where it differs from that of the field between the electrodes, e.g. (1, 0, 0) for a
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
    def field_direction(self) -> tuple[float, float, float]:
        """(3,) unit vector of the field between the electrodes."""
        return unit_direction(np.eye(3)[self.poling_axis])

    @property
    def element_order(self) -> int:
        """5, about the order that `elements` chooses."""
        return 5

    @property
    def volume(self) -> float:
        """Volume of the plate, m³."""
        return float(np.prod(self.dimensions))

    @property
    def mirrors(self) -> tuple[int, ...]:
        """Axes about whose mid-plane the driven field is symmetric: all three where poled along the field."""
        return driven_mirrors(EIGHTH, self.poling_direction, self.poling_axis)

    @property
    def upper_face(self) -> UpperFace | None:
        """The face where a mass may stick or a support stand; None with three mirror planes.

        Effects then use the dimensions of the plate.
        """
        if self.mirrors == EIGHTH:
            return None
        (x, y), body = self.dimensions[:2] / 2, (self.mirrors, self.volume, self.thickness)
        return UpperFace.within((-x, x, -y, y), *body, lambda x, y: np.ones(x.shape, dtype=bool))

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

    def part(self, symmetric_axes: tuple[int, ...]) -> np.ndarray:
        """(3,) extents of the part after cuts at the mid-planes of some axes, m."""
        return self.dimensions / np.where(np.isin(np.arange(3), symmetric_axes), 2.0, 1.0)

    def elements(
        self,
        accuracy: float,
        frequency_Hz: float,
        shear_speed: float,
        symmetric_axes: tuple[int, ...] = EIGHTH,
        order: int | None = None,
    ) -> tuple[int, tuple[int, int, int]]:
        """Order, and numbers along x, y, z, of the cheapest hexahedra that keep eigenvalues within `accuracy`.

        The length of a whole plate has at least `LEAST_ALONG` elements.

        Parameters
        ----------
        accuracy : relative error of λ at `frequency_Hz`; lower modes are far more accurate
        frequency_Hz : highest frequency of interest
        shear_speed : slowest shear wave, m/s
        order : of the elements; where None, the order of `ORDERS` that costs least of those whose model can be solved,
            in a plate that bends of those from `_BENDS_WELL` on
        """
        shear = 2 * np.pi * frequency_Hz / shear_speed
        waves = self._wavenumbers(shear)
        size, least = waves * self.part(symmetric_axes), _BENDS_WELL if np.any(waves > shear) else ORDERS[0]
        orders = range(least, ORDERS[-1] + 1) if order is None else (order,)
        least_along = LEAST_ALONG // (2 if 0 in symmetric_axes else 1)

        def used(choice: tuple[int, tuple[int, int, int]]) -> tuple[int, tuple[int, int, int]]:
            order, (along, *across) = choice
            return order, (max(along, least_along), *across)

        choices = [(p, fewest_divisions(p, size, accuracy)) for p in orders]
        found = used(min(choices, key=lambda choice: (not fits(*_unknowns(*used(choice))), _cost(*choice))))
        check_unknowns(*_unknowns(*found))
        return found

    def _wavenumbers(self, shear: float) -> np.ndarray:
        """(3,) largest wavenumbers along x, y, z, 1/m, where that of shear waves is given.

        Where no mirror plane is normal to an axis the plate bends across it, in waves that may be the shorter ones.
        """
        waves = np.full(3, shear)
        for axis in set(range(3)) - set(self.mirrors):
            bending = bending_wavenumber(shear, self.dimensions[axis])
            waves = np.where(np.arange(3) == axis, waves, np.maximum(waves, bending))
        return waves

    def domain_for(
        self,
        accuracy: float,
        frequency_Hz: float,
        shear_speed: float,
        symmetric: bool = True,
        order: int | None = None,
    ) -> Domain:
        """The computed part with elements fine enough; see `femu_piezo.geometry.shape.Shape`."""
        axes = self.mirrors if symmetric else ()
        order, divisions = self.elements(accuracy, frequency_Hz, shear_speed, axes, order)
        return self.domain(divisions, axes, order)

    def domain(
        self, divisions: tuple[int, int, int], symmetric_axes: tuple[int, ...] = EIGHTH, order: int = 2
    ) -> Domain:
        """The computed part, cut at the mid-plane of every axis in `symmetric_axes`.

        Parameters
        ----------
        divisions : hexahedra along x, y, z of the computed part
        symmetric_axes : axes about whose mid-plane the driven field is symmetric; () gives the full plate
        order : of the elements
        """
        if any(count < 1 for count in divisions):
            raise InputError(f"mesh divisions must be at least 1 along each axis, got {divisions}")
        if set(symmetric_axes) - set(self.mirrors):
            raise InputError(
                f"a plate with its field along axis {self.poling_axis} and poled along {self.poling_direction} has no "
                f"mirror planes normal to the axes {symmetric_axes}; it has those of {self.mirrors}"
            )
        origin = np.array(
            [0.0 if axis in symmetric_axes else -extent / 2 for axis, extent in enumerate(self.dimensions)]
        )
        mesh = unit_box(divisions).scaled(self.part(symmetric_axes)).translated(origin)
        hot, ground = FACES[2 * self.poling_axis + 1], FACES[2 * self.poling_axis]
        return Domain(
            mesh=mesh,
            hot=(hot,),
            ground=(ground,),
            symmetry={FACES[2 * axis]: axis for axis in symmetric_axes},
            copies=2 ** len(symmetric_axes),
            voltage_factor=2.0 if self.poling_axis in symmetric_axes else 1.0,
            poling=self.poling_direction,
            order=order,
        )


def eigenvalue_error(order: int, divisions: tuple[int, int, int], size: np.ndarray) -> float:
    """Bound of the relative error of λ of a box whose faces are free or electrodes.

    The sum of the error of waves of wavenumber k in elements of edges h (`wave_error`) and of the error from edges and
    corners (`edge_error`), with the inertia g across the two shorter sides:

        Σ_a wave_error(p, k h_a) + 1.2 min(1, g/2)^4 (k h)^4.7 / p^9.6

    The numbers of the second term are measured over plates and bars of several proportions
    (tests/verification/test_plate_elements.py).

    Parameters
    ----------
    size : (3,) extents of the box times the wavenumber k of the slowest shear wave; g is the geometric mean of the
        shorter two
    """
    edges = size / divisions
    waves = np.sum(wave_error(order, edges))
    across = np.sqrt(np.prod(np.sort(size)[:2]))
    return float(waves + 1.2 * edge_error(order, edges.max(), across))


def fewest_divisions(order: int, size: np.ndarray, accuracy: float) -> tuple[int, int, int]:
    """Numbers along x, y, z of the fewest elements within an accuracy, as close to cubes as possible.

    size : (3,) extents times the wavenumber, as in `eigenvalue_error`
    """
    count = 1
    while True:
        divisions = tuple(np.ceil(size / size.max() * count - 1e-9).astype(int).tolist())
        if eigenvalue_error(order, divisions, size) <= accuracy:
            return divisions
        count += max(1, count // 20)


def _unknowns(order: int, divisions: tuple[int, int, int]) -> tuple[int, int]:
    """Approximate numbers of unknowns and of entries of the operator."""
    return int(4 * np.prod(order * np.array(divisions) + 1)), int(16 * np.prod(divisions) * (order + 1) ** 6)


def _cost(order: int, divisions: tuple[int, int, int]) -> float:
    return solution_cost(order, int(np.prod(divisions)), _unknowns(order, divisions)[0])
