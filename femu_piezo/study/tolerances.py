"""How well the numbers of a specimen file are known: what it states, or what a laboratory would say if it is silent.

Each is a standard deviation. README.md lists the defaults; a result states those that it used.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.material.constants import D_FORM
from femu_piezo.specimen.file import Measurement, Residue, Update
from femu_piezo.specimen.geometry import Geometry
from femu_piezo.study.problem import Problem

#: Calliper and micrometer, m; density and mass, relative.
_LENGTH, _THICKNESS, _DENSITY, _MASS = 20e-6, 5e-6, 0.005, 0.001
#: Held constants, relative, and their tangents: the spread of a library between lots.
_HELD, _TANGENT = 0.03, 0.005
#: Instrument: relative of |Z|, phase in rad; fixture after compensation in ohm, H, F.
_ACCURACY, _PHASE = 0.0008, 0.0008
#: Resonances from sweep to sweep, relative: some tenths of a kelvin.
_REPEATABILITY = 5e-5
_RESIDUE = {"resistance": 0.02, "inductance": 10e-9, "capacitance": 0.1e-12}


def tolerances(problem: Problem) -> dict[str, float]:
    """Standard deviations by the names of `EffectContext.tolerances`; none where the file wants noise alone."""
    specimen = problem.specimen
    if (specimen.update or Update()).noise_only:
        return {}
    measurement, repeats = specimen.measurement, {}
    if specimen.sweep is not None:
        measurement, repeats = measurement or Measurement(), {"repeatability": _REPEATABILITY}
    return _geometry(specimen.geometry) | _held(problem) | _instrument(measurement) | repeats


def _geometry(geometry: Geometry) -> dict[str, float]:
    usual = {"length": _LENGTH, "width": _LENGTH, "thickness": _THICKNESS, "diameter": _LENGTH}
    found = {}
    for name, default in usual.items():
        size, std = getattr(geometry, name), getattr(geometry, f"std_{name}")
        if size is not None:
            found[name] = (default if std is None else std) / size
    if geometry.mass is not None:
        found["density"] = _MASS if geometry.std_mass is None else geometry.std_mass / geometry.mass
    else:
        found["density"] = _DENSITY if geometry.std_density is None else geometry.std_density
    return found


def _held(problem: Problem) -> dict[str, float]:
    material = problem.specimen.material
    if material.simplified:  # the constants that are left out follow from those that are there
        return {}
    found = {}
    for name in D_FORM:
        if name not in material.free and getattr(problem.constants, name) != 0:
            found[name] = material.priors.get(name, _HELD)
            found[f"tan_{name}"] = material.tangent_priors.get(name, _TANGENT)
    return found


def _instrument(measurement: Measurement | None) -> dict[str, float]:
    if measurement is None:
        return {}
    residue = measurement.residue or Residue()
    found = {
        name: default if getattr(residue, name) is None else getattr(residue, name)
        for name, default in _RESIDUE.items()
    }
    own = _ACCURACY if measurement.accuracy is None else measurement.accuracy
    load = 0.0 if measurement.load is None else measurement.load.std or 0.0
    found["accuracy"] = float(np.hypot(own, load))  # |Z| is as good as the load that it is compared with
    found["phase_accuracy"] = _PHASE if measurement.phase_accuracy is None else measurement.phase_accuracy
    return found
