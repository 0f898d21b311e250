"""From a specimen file to the objects of the calculation: constants, plate, model, measured sweep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.shape import Shape, is_poled_across_field, is_poled_along_field
from femu_piezo.inference.free_constants import FreeConstants
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.material.library import library_material
from femu_piezo.material.simplified import simplify
from femu_piezo.specimen.file import Material, Simulation, Specimen
from femu_piezo.study.shapes import first_mode_Hz, shape_of
from femu_piezo.threads import made_once
from femu_piezo.units import parse_quantity

#: The effect by which a file states errors of held constants.
_HELD = "wrong_insensitive_parameter"
#: End of a sweep that the file does not name, over the expected fundamental.
_USUAL_END = 3.5
#: Eigenvalue error allowed at the end of a sweep of shapes other than rectangular plates.
_ERROR_AT_END = 1e-3
#: kg/m³ that a weighed piece may have: composites with polymers lie above, no solid of lead oxides reaches the end.
_DENSITIES = (1000.0, 20000.0)


@dataclass(frozen=True)
class Problem:
    """A specimen ready to compute.

    Attributes
    ----------
    plate : the body with its electrodes; a `Plate`, or any other `Shape`
    constants : the ten constants of the specimen file, the paper's simplification applied where asked for
    density : kg/m³
    fitted : the constants where a fit left them, which simulations take and fits start from; those of the file where
        none did
    """

    specimen: Specimen
    plate: Shape
    constants: PiezoConstants
    density: float
    fitted: PiezoConstants

    @property
    def left(self) -> PiezoConstants:
        """`fitted`, the held constants with the errors that [effects] and [fitted] state; InputError for no number."""
        where, values = self.specimen.path or self.specimen.name, self.fitted.as_dict()
        for kind in ("effects", "fitted"):
            stated = (getattr(self.specimen, kind) or {}).get(_HELD, {})
            for name in values.keys() & stated.keys():
                values[name] *= 1 + parse_quantity(stated[name], "1", f"{where}: {kind}.{_HELD}.{name}")
        return PiezoConstants(**values)

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

    @property
    def order(self) -> int | None:
        """Order of the elements that the file asks for; None where the accuracy decides."""
        return (self.specimen.simulation or Simulation()).order

    def model(self, frequency_Hz: float, accuracy: float) -> ElectroelasticModel:
        """Model of the body whose eigenvalues are within `accuracy` of converged up to a frequency."""
        domain = self.plate.domain_for(accuracy, frequency_Hz, self.shear_speed, order=self.order)
        return ElectroelasticModel(domain, self.density)

    def equivalent_frequency(self, highest_Hz: float, accuracy: float) -> float:
        """Frequency up to which `accuracy` is asked of the mesh, for a sweep that ends at `highest_Hz`.

        The end itself where elements of high order follow the body. Other meshes cost more: they keep `accuracy` up to
        1.5 times the expected first pole, and 1e-3 at the end.
        """
        if self.plate.element_order > 2 and self.plate.direction is None:
            return highest_Hz
        first = min(1.5 * self.expected_pole_Hz, highest_Hz)
        return max(first, highest_Hz / self.reach(accuracy, _ERROR_AT_END))

    def reach(self, accuracy: float, allowed: float) -> float:
        """Frequency up to which λ is within `allowed`, over that up to which it is within `accuracy`; at least 1.

        The error grows with the power 2p of frequency, p the order of the elements.
        """
        return max(1.0, allowed / accuracy) ** (0.5 / self.plate.element_order)

    @made_once
    def expected_pole_Hz(self) -> float:
        """First driven mode in the thin limit, Hz: where to look for it before anything is measured."""
        return first_mode_Hz(self.plate, self.constants, self.density)

    @property
    def usual_end_Hz(self) -> float:
        """End of a sweep, or of a band of modes, where the file names none."""
        return _USUAL_END * self.expected_pole_Hz


def prepare(specimen: Specimen, *, check: bool = True) -> Problem:
    """Build the problem of a specimen; InputError with file and key where the specimen cannot be computed.

    check : refuse constants of no stable, passive material; False where they are only a start
    """
    where = str(specimen.path or specimen.name)
    try:
        base = library_material(specimen.material.base) if specimen.material.base else None
    except InputError as error:
        raise InputError(f"{where}: material.base: {error}") from None
    plate = shape_of(specimen)
    density = specimen.geometry.density or (base.density if base else None)
    if specimen.geometry.mass is not None:
        density = specimen.geometry.mass / plate.volume
        if not _DENSITIES[0] <= density <= _DENSITIES[1]:
            raise InputError(
                f"{where}: geometry.mass = {specimen.geometry.mass:g} kg in the {1e9 * plate.volume:.4g} mm^3 of these "
                f"dimensions is a density of {density:.3g} kg/m^3, outside {_DENSITIES[0]:g} … {_DENSITIES[1]:g}; is "
                "the unit of the mass or of a dimension wrong?"
            )
    if density is None:
        raise InputError(f'{where}: geometry.density is missing and there is no base material; write "7800 kg/m^3"')
    constants = fitted = _constants(specimen.material, base.constants if base else None)
    if specimen.fitted_constants:
        fitted = _constants(specimen.material.model_copy(update=specimen.fitted_constants), constants)
    if specimen.material.simplified:
        constants, fitted = (simplify(one, plate.poling).full() for one in (constants, fitted))
    charge = _driving_constant(plate)
    if getattr(constants, charge) == 0:
        raise InputError(
            f"{where}: material.{charge} is zero, so a body poled along {_named(plate)} has no electrical "
            f"response; give material.{charge}"
        )
    problem = Problem(specimen, plate, constants, float(density), fitted)
    if specimen.fitted_constants:  # a fit is passive within its tolerance, with the held constants where it left them
        problem.left.check(f"{where}: fitted.material", passive=False)
    elif check:
        constants.check(f"{where}: material")
    return problem


def refuse_nothing_free(specimens: Sequence[Specimen]) -> None:
    """InputError where the first of several specimens, whose [material] rules, has no free constant to find."""
    for first in specimens[:1]:
        if not first.material.free:
            raise InputError(
                f"{first.path or first.name}: material.free = [] leaves no constant to find, and at least one is "
                'needed here; name some, such as free = ["s11", "d31", "eps33T"], or take the key out for the default'
            )


def _constants(material: Material, base: PiezoConstants | None) -> PiezoConstants:
    values = base.as_dict() if base else {}
    values |= {name: complex(value) for name, value in material.values.items()}
    for name, tangent in material.tangents.items():
        values[name] = values[name].real * (1 - 1j * tangent)
    return PiezoConstants(**values)


def _driving_constant(shape: Shape) -> str:
    """The piezoelectric constant that drives the first mode: d15 where the field lies across the poling."""
    if is_poled_across_field(shape):
        return "d15"
    return "d31" if shape.poling == "thickness" else "d33"


def _named(shape: Shape) -> str:
    return f"its {shape.poling}" if is_poled_along_field(shape) else f"the direction {list(shape.poling_direction)}"
