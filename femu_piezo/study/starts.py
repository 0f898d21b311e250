"""Start values of an update from pole, zero and one more point of the sweep, by the thin-body formula of the shape."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from femu_piezo.extraction.roots import Pair
from femu_piezo.geometry.regions import Circle
from femu_piezo.geometry.shape import Shape, is_poled_along_field
from femu_piezo.geometry.shapes import Plate
from femu_piezo.geometry.slab import Slab
from femu_piezo.inference.starts.thin_body import bar_permittivity, bar_start, disk_permittivity, disk_start
from femu_piezo.material.constants import KINDS, PiezoConstants
from femu_piezo.study.problem import Problem

#: Loss tangent that a start value of ε33T is given: the level of the curve tells it better than one point.
_TANGENT = 0.01
#: Relative difference of electrode area times gap from the volume below which the field is uniform.
_UNIFORM = 1e-4
#: Least eigenvalue of the energy that start constants have, as a share of that of the file's, and the number of steps
#: on the way to the file's in which it is looked for.
_STABLE, _STEPS = 0.1, 20


def pair_names(shape: Shape) -> tuple[str, ...]:
    """The two constants that one pole and one zero of the fundamental determine; none for a body poled askew."""
    if not is_poled_along_field(shape):
        return ()
    return ("s11", "d31") if shape.poling == "thickness" else ("s33", "d33")


def has_uniform_field(shape: Shape) -> bool:
    """Whether the static field is uniform and along the poling, so that the capacitance is ε33T A/d (eqs 41, 42)."""
    full = abs(shape.electrode_area * shape.electrode_gap / shape.volume - 1) < _UNIFORM
    return full and is_poled_along_field(shape)


def solid_disk_radius(shape: Shape) -> float | None:
    """Radius of a disk without holes, m; None for every other shape."""
    if isinstance(shape, Slab) and isinstance(shape.outline, Circle) and not shape.holes:
        return shape.outline.diameter / 2
    return None


def start_values(problem: Problem, pair: Pair, eps33T: complex) -> dict[str, complex]:
    """Complex constants that pole and zero give by a thin-body formula; none where the body is poled askew.

    Bar: s and d. Disk: s11 and d31, and s12 at the specimen file's Poisson ratio. Others: as a bar whose first mode
    lies where that of the file's constants is expected.
    """
    shape, constants = problem.plate, problem.constants
    if not is_poled_along_field(shape):
        return {}
    pole, zero = (complex(np.sqrt(one.eigenvalue)) / (2 * np.pi) for one in (pair.pole, pair.zero))
    radius = solid_disk_radius(shape)
    if radius is not None:
        return disk_start(radius, problem.density, _poisson(problem), pole, zero, eps33T)
    if isinstance(shape, Plate):
        length = shape.length if shape.poling == "length" else max(shape.length, shape.width)
    else:
        length = float(1 / (2 * problem.expected_pole_Hz * np.sqrt(problem.density * constants.s11.real)))
    return bar_start(shape.poling, length, problem.density, pole, zero, eps33T)


def start_permittivity(problem: Problem, pair: Pair, frequency_Hz: float, admittance: complex) -> complex:
    """ε33T from one point of the sweep by thin-body formulas; that of the file where these give no positive value."""
    shape = problem.plate
    if not is_poled_along_field(shape):
        return problem.constants.eps33T
    point = (pair.pole.frequency_Hz, pair.zero.frequency_Hz, frequency_Hz, admittance)
    if solid_disk_radius(shape) is not None:
        eps = disk_permittivity(_poisson(problem), *point, shape.electrode_gap, shape.electrode_area)
    else:
        eps = bar_permittivity(shape.poling, *point, shape.electrode_gap, shape.electrode_area)
    return eps * (1 - 1j * _TANGENT) if eps > 0 else problem.constants.eps33T


def in_proportion(constants: PiezoConstants, values: Mapping[str, complex]) -> PiezoConstants:
    """The constants with other values of some; all others change as those of their kind do, by the mean of log ratios.

    Kinds are s, d and ε. With one ratio r for each, all squares of coupling factors change by a factor r_d²/(r_s r_ε).
    """
    changed = dict(values)
    for kind in KINDS:
        ratios = [(values[name] / getattr(constants, name)).real for name in kind if name in values]
        if ratios and min(ratios) > 0:
            mean = float(np.exp(np.mean(np.log(ratios))))
            changed |= {name: mean * getattr(constants, name) for name in kind if name not in values}
    return constants.with_values(**changed)


def is_hardly_stable(constants: PiezoConstants, of_file: PiezoConstants) -> bool:
    """Whether a basis cannot follow constants, as their energy is near that of an unstable material.

    A fit may end there that lacks an effect the sweep shows, or where the held constants are those of another material.
    """
    of_file_least = _least_energies(of_file)
    least = np.minimum(_STABLE * of_file_least, of_file_least)
    return bool(np.any(_least_energies(constants) < least))


def away_from_wall(constants: PiezoConstants, of_file: PiezoConstants) -> PiezoConstants:
    """The constants, or the nearest ones on the way to the file's that are not hardly stable."""
    if not is_hardly_stable(constants, of_file):
        return constants
    for share in np.linspace(0, 1, _STEPS + 1)[1:-1]:
        found = PiezoConstants.from_vector((1 - share) * constants.vector() + share * of_file.vector())
        if not is_hardly_stable(found, of_file):
            return found
    return of_file


def _least_energies(constants: PiezoConstants) -> np.ndarray:
    """Least eigenvalue of every block of the energy, scaled to a unit diagonal."""
    blocks = range(constants.block_count)
    return np.array([np.linalg.eigvalsh(constants.energy_block(block))[0] for block in blocks])


def _poisson(problem: Problem) -> float:
    return float(-(problem.constants.s12 / problem.constants.s11).real)
