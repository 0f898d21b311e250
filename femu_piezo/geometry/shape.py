"""What every shape offers, and which mirror planes a driven specimen has."""

from __future__ import annotations

from collections.abc import Iterable
from math import factorial
from typing import Protocol

import numpy as np

from femu_piezo.errors import InputError, TooLargeError
from femu_piezo.geometry.domain import Domain

#: Unknowns of the largest model that is attempted, and entries of its operator.
MOST_UNKNOWNS, MOST_ENTRIES = 250_000, 100_000_000
#: Unknowns that a quadratic element adds to a large mesh.
UNKNOWNS = {"hexahedron": 32, "tetrahedron": 6}
#: Errors of eigenvalues from edges and corners fall with the order p as p^-EDGE_RATE.
EDGE_RATE = 9.6
#: Cosine of the angle between poling and field below which they count as perpendicular, and distance from 1 below which
#: they count as parallel.
_ACROSS, ALONG = 1e-6, 1e-9


class Shape(Protocol):
    """A specimen's body with its electrodes and poling, coordinates in m.

    Attributes
    ----------
    poling : "thickness" or "length": axis of the field between the electrodes, and of the poling where no direction
        is given for it; "thickness" for a mesh file, whatever its axes
    poling_direction, field_direction : (3,) unit vectors of the poling and of the field in specimen axes
    element_order : usual order p of its elements: the error of an eigenvalue grows with the power 2p of frequency
    volume : m³;  electrode_area : of the hot electrode, m²;  electrode_gap : distance between the electrodes, m
    """

    @property
    def poling(self) -> str: ...

    @property
    def poling_direction(self) -> tuple[float, float, float]: ...

    @property
    def field_direction(self) -> tuple[float, float, float]: ...

    @property
    def element_order(self) -> int: ...

    @property
    def volume(self) -> float: ...

    @property
    def electrode_area(self) -> float: ...

    @property
    def electrode_gap(self) -> float: ...

    def domain_for(
        self,
        accuracy: float,
        frequency_Hz: float,
        shear_speed: float,
        symmetric: bool = True,
        order: int | None = None,
    ) -> Domain:
        """The computed part, with elements fine enough for a relative eigenvalue error `accuracy`.

        Parameters
        ----------
        frequency_Hz : highest frequency of interest
        shear_speed : slowest shear wave, m/s
        symmetric : whether the part is cut at the mirror planes of the driven field; False for the whole body
        order : polynomial order of the elements; chosen by the shape where None
        """
        ...


def poling_along_field(shape: Shape) -> float:
    """|cos| of the angle between the poling and the field between the electrodes."""
    return float(abs(np.dot(shape.poling_direction, shape.field_direction)))


def is_poled_along_field(shape: Shape) -> bool:
    """Whether poling and field are parallel: then s and d of that direction drive the first mode."""
    return poling_along_field(shape) > 1 - ALONG


def is_poled_across_field(shape: Shape) -> bool:
    """Whether poling and field are perpendicular: then d15 drives the first mode, a shear of the thickness."""
    return poling_along_field(shape) < _ACROSS


def unit_direction(direction: Iterable[float]) -> tuple[float, float, float]:
    """A direction scaled to length one; InputError where its length is zero or not finite."""
    try:
        vector = np.array(tuple(direction), dtype=float)
    except (TypeError, ValueError):
        vector = np.zeros(0)
    length = np.linalg.norm(vector) if vector.shape == (3,) else 0.0
    if not (np.isfinite(length) and length > 0):
        raise InputError(f"a poling direction needs three numbers that are not all zero, got {direction}")
    return tuple(float(value) for value in vector / length)


def check_size(volumes: float, kind: str) -> None:
    """InputError where a model of quadratic elements would be too large for a few GB of memory.

    volumes : volume of the part over the cube of an element's edge;  kind : "hexahedron" or "tetrahedron"
    """
    # each cube is one hexahedron, or about eight tetrahedra
    check_unknowns(volumes * UNKNOWNS[kind] * (1 if kind == "hexahedron" else 8))


def fits(unknowns: float, entries: float = 0.0) -> bool:
    """Whether a model and the entries of its operator fit into a few GB of memory."""
    return unknowns <= MOST_UNKNOWNS and entries <= MOST_ENTRIES


def check_unknowns(unknowns: float, entries: float = 0.0) -> None:
    """InputError where a model, or the entries of its operator, would be too large for a few GB of memory."""
    if not fits(unknowns, entries):
        many = f"{unknowns:.2g} unknowns" if unknowns > MOST_UNKNOWNS else f"{entries:.2g} entries in its matrices"
        raise TooLargeError(
            f"the mesh would have about {many}, too many to be solved; lower the highest frequency (the end of the "
            "sweep, simulation.stop, --band of modes; is its unit right?), raise simulation.order where the file "
            "states a low one, or, of `simulate` and `modes`, ask for less accuracy (update.accuracy = 1e-3)"
        )


def wave_error(order: int, phase: np.ndarray | float) -> np.ndarray | float:
    """Relative eigenvalue error of a wave in elements of order p; phase : k h, the phase of the wave over one element.

    [p!/(2p)!]² (k h)^(2p) / (2p + 1), twice the relative error of the wavenumber (Ainsworth, SIAM J. Numer. Anal. 42,
    2004, 553).
    """
    return (factorial(order) / factorial(2 * order)) ** 2 * phase ** (2 * order) / (2 * order + 1)


def edge_error(order: int, phase: float, inertia: float) -> float:
    """Relative eigenvalue error from edges and corners in elements of order p, up to a factor that depends on the body.

    min(1, g/2)^4 (k h)^4.7 / p^9.6: the fields at edges and corners are not smooth, and grow with the inertia across
    the body.

    Parameters
    ----------
    phase : k h of the longest edge of an element;  inertia : g, the wavenumber k times a dimension across the body
    """
    return min(1.0, inertia / 2) ** 4 * phase**4.7 / order**EDGE_RATE


def bending_wavenumber(shear: float, thickness: float) -> float:
    """Wavenumber of bending waves of a thin plate, 1/m; shear : that of shear waves, 1/m.

    12^(1/4) √(c_shear/c_plate) √(k/t), with a plate wave 1.6 times as fast as the shear wave. Bending is driven where
    no mirror plane lies at mid-height.
    """
    return 1.47 * np.sqrt(shear / thickness)


def solution_cost(order: int, cells: int, unknowns: int) -> float:
    """Estimated seconds of a solution: for each element a factorisation ~ (p + 1)^8 and a constant, and per unknown."""
    return 5e-8 * cells * ((order + 1.0) ** 8 + 5e4) + 3e-4 * unknowns


def driven_mirrors(geometric: Iterable[int], poling: tuple[float, float, float], field_axis: int) -> tuple[int, ...]:
    """Axes about whose mid-plane the driven displacement is symmetric, out of those that mirror body and electrodes.

    A reflection keeps a poling that lies in the mirror plane and reverses a poling along its normal (e → −e). So a
    mirror plane that maps each electrode onto itself needs the poling in the plane. The mirror plane that exchanges
    the electrodes, normal to the field, needs the poling along its normal: then φ is antisymmetric.

    Parameters
    ----------
    geometric : axes (0, 1, 2) whose mid-plane mirrors the body; the reflection maps electrodes onto themselves, or
        onto each other for `field_axis`
    """
    component = np.abs(np.array(poling))
    along = [axis for axis in range(3) if component[axis] > 1 - 1e-12]
    return tuple(
        axis
        for axis in sorted(geometric)
        if (axis == field_axis and axis in along) or (axis != field_axis and component[axis] < 1e-12)
    )
