"""`export`: the constants of an update as the material of another program."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.files import read_json
from femu_piezo.geometry.shape import unit_direction
from femu_piezo.material.constants import D_FORM, PiezoConstants
from femu_piezo.material.conversion import stress_charge
from femu_piezo.material.programs.writers import program

_LARGEST_FILE = 100_000_000
Axis = tuple[float, float, float]


def constants_of_record(path: Path) -> tuple[PiezoConstants, float | None, str, tuple[str, ...]]:
    """Constants, density (kg/m³, None where it is not there), name and free constants in an update.json.

    Raises InputError where it is none.
    """
    what = "the update.json of an update; give the file that `femu-piezo update` wrote"
    try:
        record = read_json(path, _LARGEST_FILE, what)
        found = {name: record["constants"][name] for name in D_FORM}
        values, tangents = ({name: one[key] for name, one in found.items()} for key in ("value", "tan"))
        constants = PiezoConstants.from_real(values, tangents)
        density = record["specimens"][0].get("density")
        known = None if density is None else float(density)
        if not np.all(np.isfinite([*constants.vector(), 0.0 if known is None else known])):
            raise ValueError("not finite")
        return constants, known, str(record["specimen"]), tuple(map(str, record.get("parameters", ())))
    except (ValueError, KeyError, TypeError, IndexError, AttributeError):
        raise InputError(f"{path}: this is not {what}") from None


def export_text(
    constants: PiezoConstants,
    density: float | None,
    name: str,
    to: str,
    poling: Axis = (0.0, 0.0, 1.0),
    found: Sequence[str] = (),
) -> str:
    """The text of a material for the program `to`, poled along a direction; InputError where something is missing.

    found : the constants that an update found; the text says so
    """
    target = program(to)
    if density is None:
        raise InputError(f"{name}: the density is not known; give it, such as --density 7800")
    if not density > 0:
        raise InputError(f"density = {density:g} is not above zero; give it in kg/m³")
    try:
        matrices = stress_charge(constants, "ieee", unit_direction(poling))
    except np.linalg.LinAlgError:
        raise InputError(f"{name}: the compliances of these constants have no inverse; update again") from None
    return target.write(matrices, float(density), name, _origin(constants, found))


def cautions(constants: PiezoConstants) -> list[str]:
    """Why these constants together are those of no stable material, which other programs may take without a word."""
    return [
        f"{fault}: results that a program computes with these constants are meaningless"
        for fault in constants.physical_faults(tolerance=1e-3, passive=False)
    ]


def _origin(constants: PiezoConstants, found: Sequence[str]) -> list[str]:
    """Which constants were found from a sweep, and which are no values at all."""
    sentences = [f"Caution: {one}." for one in cautions(constants)]
    if found:
        sentences.append(f"Found from a sweep: {', '.join(found)}. The others were given, or follow from these.")
        lossless = [name for name in D_FORM if getattr(constants, name) != 0 and constants.tangent(name) == 0]
        if lossless:
            sentences.append(f"No loss was given for {', '.join(lossless)}: they are lossless here.")
    empty = [name for name in D_FORM if getattr(constants, name) == 0]
    if empty:
        sentences.append(f"{', '.join(empty)} are set to zero by the simplified material; they were not measured.")
    return sentences
