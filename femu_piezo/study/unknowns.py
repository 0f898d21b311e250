"""The unknowns of a fit of several sweeps, whether these are measured or planned."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from femu_piezo.effects.effect import Effect
from femu_piezo.errors import InputError
from femu_piezo.inference.readings import Reading
from femu_piezo.inference.unknowns import MaterialParameters, Unknowns, material_prior
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.study.starts import has_uniform_field
from femu_piezo.study.subjects import Subject, shared_library


def unknowns_of(several: Sequence[Subject], constants: PiezoConstants | None = None) -> Unknowns:
    """Unknowns of a fit: constants, tolerances and readings, the priors centred on the first specimen's file.

    constants : real parts of the free constants that are 1 in x; those of the file where None
    """
    problem = several[0].problem
    free, of_file = problem.free(constants or problem.constants), problem.free(problem.constants)
    material = problem.specimen.material
    return Unknowns(
        material=MaterialParameters.around(free, free.start),
        prior=material_prior(of_file, material.priors, material.tangent_priors),
        effects=tolerances_of(several),
        fixed=tuple({effect.key: (effect, values) for one in several for effect, values in one.fixed}.values()),
        readings=tuple(reading for one in _pieces(several) for reading in _readings(one)),
    )


def as_filed(several: Sequence[Subject], unknowns: Unknowns) -> np.ndarray:
    """(n_x,) start: constants at their start in `unknowns`, freed effects as the files say, all others at rest."""
    x = unknowns.prior_mean.copy()
    x[: unknowns.of_material] = unknowns.material.x_of(unknowns.material.free.start)
    for one in several:
        for effect, values in one.freed:
            own = one.owned(effect)
            if unknowns.has(own):
                x[unknowns.columns(unknowns.index(own.key))] = values / own.scale
    return x


def tolerances_of(several: Sequence[Subject]) -> tuple[Effect, ...]:
    """The effects that every fit has."""
    return tuple(effect for effect in shared_library(several) if effect.has_tolerance)


def effects_served(one: Subject, effects: Iterable[Effect]) -> list[Effect]:
    """The effects that the model of one specimen must serve: its own and shared ones, and those of its file."""
    own = [effect for effect in dict.fromkeys(effects) if one.share.has(effect)]
    return own + [effect for effect, _ in one.fixed]


def _pieces(several: Sequence[Subject]) -> list[Subject]:
    """The first sweep of every specimen."""
    return list({one.name: one for one in reversed(several)}.values())[::-1]


def _readings(one: Subject) -> list[Reading]:
    """The `[readings]` of its file as data of a fit; InputError where the body has no such reading."""
    problem, found = one.problem, []
    table, plate = problem.specimen.readings, problem.plate
    for name, (value, std) in (table.given if table is not None else {}).items():
        if name == "capacitance" and not has_uniform_field(plate):
            raise InputError(
                f"{problem.specimen.path or problem.specimen.name}: readings.capacitance needs a body with a uniform "
                "field, poled along it and with electrodes on the whole of two faces; leave it out"
            )
        along = 0 if plate.poling == "length" else 2
        found.append(
            Reading(
                name,
                value,
                std * abs(value),
                one.name,
                problem.density,
                plate.volume,
                plate.electrode_area,
                plate.electrode_gap,
                along,
            )
        )
    return found
