"""How well the numbers of a specimen file are known: what it states, or what a laboratory would say if it is silent.

Each is a standard deviation. The schema has the defaults (`Table.usual`); a result states those that it used.
"""

from __future__ import annotations

from femu_piezo.material.constants import D_FORM
from femu_piezo.specimen.file import Measurement, Residue, Update
from femu_piezo.specimen.geometry import LENGTHS, Geometry
from femu_piezo.study.problem import Problem

#: Relative standard deviation of a mass.
_MASS = 0.001
#: Relative standard deviation of resonances from sweep to sweep, as by some tenths of a kelvin.
_REPEATABILITY = 5e-5


def tolerances(problem: Problem) -> dict[str, float]:
    """Standard deviations by the names of `EffectContext.tolerances`; none where the file wants noise alone."""
    specimen = problem.specimen
    if (specimen.update or Update()).noise_only:
        return {}
    measurement, repeats = specimen.measurement, {}
    if specimen.sweep is not None:
        measurement, repeats = measurement or Measurement(), {"repeatability": _REPEATABILITY}
    return _geometry(specimen.geometry) | _held(problem) | _instrument(measurement) | repeats


def has_held_tolerances(problem: Problem) -> bool:
    """Whether the held constants may move in a fit."""
    return not (problem.specimen.update or Update()).noise_only and bool(_held(problem))


def _geometry(geometry: Geometry) -> dict[str, float]:
    found = {}
    for name in LENGTHS:
        size = getattr(geometry, name)
        if size is not None:
            found[name] = geometry.stated(f"std_{name}") / size
    if geometry.mass is not None:
        found["density"] = _MASS if geometry.std_mass is None else geometry.std_mass / geometry.mass
    else:
        found["density"] = geometry.stated("std_density")
    return found


def _held(problem: Problem) -> dict[str, float]:
    material = problem.specimen.material
    if material.simplified:  # the constants that are left out follow from those that are there
        return {}
    found = {}
    for name in D_FORM:
        if name not in material.free and getattr(problem.constants, name) != 0:
            found[name] = material.stated(f"std_{name}")
            found[f"tan_{name}"] = material.stated(f"std_tan_{name}")
    return found


def _instrument(measurement: Measurement | None) -> dict[str, float]:
    if measurement is None:
        return {}
    residue = measurement.residue or Residue()
    found = {name: residue.stated(name) for name in Residue.model_fields}
    found["accuracy"] = measurement.magnitude_std
    found["phase_accuracy"] = measurement.stated("phase_accuracy")
    return found
