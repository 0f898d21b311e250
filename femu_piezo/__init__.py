"""femu_piezo: complex material parameters of piezoceramic plates from impedance sweeps.

    import femu_piezo as fp

    specimen = fp.read_specimen("plate.toml")
    print(fp.update(specimen, fp.read_spectrum("impedance.csv")))

`femu_piezo.api` says what the functions take. Importing the package loads nothing: each name loads what it needs when
it is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

__version__ = "0.2.0"

if TYPE_CHECKING:
    from femu_piezo import effects
    from femu_piezo.api import circuit, diagnose, export, extract, identify, modes, simulate, standard_figures, update
    from femu_piezo.errors import ConvergenceError, InputError
    from femu_piezo.measurement.readers import read_spectrum, write_spectrum
    from femu_piezo.measurement.spectrum import ImpedanceSpectrum
    from femu_piezo.specimen.file import Specimen, read_specimen, read_specimens

__all__ = [
    "ConvergenceError",
    "ImpedanceSpectrum",
    "InputError",
    "Specimen",
    "circuit",
    "diagnose",
    "effects",
    "export",
    "extract",
    "identify",
    "modes",
    "read_specimen",
    "read_specimens",
    "read_spectrum",
    "simulate",
    "standard_figures",
    "update",
    "write_spectrum",
]

_HOMES = {
    "femu_piezo.api": (
        "circuit",
        "diagnose",
        "export",
        "extract",
        "identify",
        "modes",
        "simulate",
        "standard_figures",
        "update",
    ),
    "femu_piezo.errors": ("ConvergenceError", "InputError"),
    "femu_piezo.measurement.readers": ("read_spectrum", "write_spectrum"),
    "femu_piezo.measurement.spectrum": ("ImpedanceSpectrum",),
    "femu_piezo.specimen.file": ("Specimen", "read_specimen", "read_specimens"),
}


def __getattr__(name: str):
    if name == "effects":
        return import_module("femu_piezo.effects")
    home = next((module for module, names in _HOMES.items() if name in names), None)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(home), name)
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
