"""The `[readings]` of specimen files as data of a fit."""

from __future__ import annotations

from collections.abc import Sequence

from femu_piezo.errors import InputError
from femu_piezo.inference.readings import Reading
from femu_piezo.study.starts import has_uniform_field
from femu_piezo.study.subjects import Subject


def readings_of(several: Sequence[Subject]) -> tuple[Reading, ...]:
    """Of all specimens; InputError where the body has no such reading."""
    return tuple(reading for one in several for reading in _readings(one))


def _readings(one: Subject) -> list[Reading]:
    problem, found = one.measured.problem, []
    table, plate = problem.specimen.readings, problem.plate
    for name, (value, std) in (table.given if table is not None else {}).items():
        if name == "capacitance" and not has_uniform_field(plate):
            raise InputError(
                f"{problem.specimen.path or problem.specimen.name}: readings.capacitance is of a body with a uniform "
                "field, poled along it and with electrodes on the whole of two faces; leave it out"
            )
        along = 0 if plate.poling == "length" else 2
        found.append(
            Reading(
                name, value, std * abs(value), one.name,
                problem.density, plate.volume, plate.electrode_area, plate.electrode_gap, along,
            )
        )
    return found
