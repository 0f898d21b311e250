"""From a specimen file to the objects of the calculation: constants, plate, model, measured sweep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.shapes import EIGHTH, Plate
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.material.library import library_material
from femu_piezo.material.simplified import simplify
from femu_piezo.specimen import Specimen
from femu_piezo.updating.parameters import FreeConstants


@dataclass(frozen=True)
class Problem:
    """A specimen ready to compute.

    Attributes
    ----------
    constants : the ten constants of the specimen file, the paper's simplification applied where asked for
    density : kg/m³
    """

    specimen: Specimen
    plate: Plate
    constants: PiezoConstants
    density: float

    @property
    def shear_speed(self) -> float:
        """Slowest shear wave of the start material, m/s."""
        return float(1 / np.sqrt(self.density * max(self.constants.s44.real, self.constants.s66.real)))

    def free(self, constants: PiezoConstants) -> FreeConstants:
        """The free constants of the specimen around given constants."""
        return FreeConstants.of(
            constants,
            self.specimen.material.free,
            simplified=self.specimen.material.simplified,
            poling=self.plate.poling,
        )

    def simplified(self, constants: PiezoConstants) -> PiezoConstants:
        """The paper's simplification of the constants where the specimen asks for it, else themselves."""
        return simplify(constants, self.plate.poling).full() if self.specimen.material.simplified else constants

    def model(
        self, frequency_Hz: float, accuracy: float, symmetric_axes: tuple[int, ...] = EIGHTH, order: int = 2
    ) -> ElectroelasticModel:
        """Model of the plate whose eigenvalues are within `accuracy` of converged up to a frequency."""
        divisions = self.plate.divisions(accuracy, frequency_Hz, self.shear_speed, symmetric_axes)
        return ElectroelasticModel(self.plate.domain(divisions, symmetric_axes), self.density, order)

    @property
    def expected_pole_Hz(self) -> float:
        """Fundamental of the thin bar, Hz: where to look for the first mode before anything is measured."""
        s = self.constants.s11 if self.plate.poling == "thickness" else self.constants.s33
        return float(1 / (2 * self.plate.length * np.sqrt(self.density * s.real)))


def prepare(specimen: Specimen) -> Problem:
    """Build the problem of a specimen; InputError with file and key where the specimen cannot be computed."""
    where = str(specimen.path or specimen.name)
    base = library_material(specimen.material.base) if specimen.material.base else None
    density = specimen.geometry.density or (base.density if base else None)
    if density is None:
        raise InputError(f'{where}: geometry.density is missing and there is no base material; write "7800 kg/m^3"')
    constants = _constants(specimen, base.constants if base else None)
    plate = _plate(specimen, where)
    if specimen.material.simplified:
        constants = simplify(constants, plate.poling).full()
    charge = "d31" if plate.poling == "thickness" else "d33"
    if getattr(constants, charge) == 0:
        raise InputError(
            f"{where}: material.{charge} is zero, so a plate poled along its {plate.poling} has no electrical "
            f"response; give material.{charge}"
        )
    return Problem(specimen, plate, constants.check(f"{where}: material"), float(density))


def _constants(specimen: Specimen, base: PiezoConstants | None) -> PiezoConstants:
    values = base.as_dict() if base else {}
    values |= {name: complex(value) for name, value in specimen.material.values.items()}
    for name, tangent in specimen.material.tangents.items():
        values[name] = values[name].real * (1 - 1j * tangent)
    return PiezoConstants(**values)


def _plate(specimen: Specimen, where: str) -> Plate:
    geometry = specimen.geometry
    if geometry.shape != "plate":
        raise InputError(f'{where}: geometry.shape = "{geometry.shape}" cannot be computed yet; a "plate" can')
    return Plate(geometry.length, geometry.width, geometry.thickness, geometry.poling)
