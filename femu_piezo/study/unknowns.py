"""The unknowns of a fit of several sweeps, whether these are measured or planned."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from femu_piezo.effects.effect import Effect
from femu_piezo.effects.extended_model import ExtendedModel
from femu_piezo.inference.readings import Reading
from femu_piezo.inference.unknowns import MaterialParameters, Unknowns, material_prior
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.study.subjects import Subject, shared_library


def unknowns_of(
    several: Sequence[Subject],
    models: Sequence[ExtendedModel] | None = None,
    constants: PiezoConstants | None = None,
) -> Unknowns:
    """Unknowns of a fit: constants, tolerances and readings, the priors centred on the first specimen's file.

    Parameters
    ----------
    models : the model of each sweep, from which the capacitance of its specimen is predicted where it was read
    constants : real parts of the free constants that are 1 in x; those of the file where None
    """
    problem = several[0].problem
    free, of_file = problem.free(constants or problem.constants), problem.free(problem.constants)
    material = problem.specimen.material
    return Unknowns(
        material=MaterialParameters.around(free, free.start, of_file.start),
        prior=material_prior(of_file, material.priors, material.tangent_priors),
        effects=tolerances_of(several),
        fixed=tuple({effect.key: (effect, values) for one in several for effect, values in one.fixed}.values()),
        readings=tuple(reading for one, model in _pieces(several, models) for reading in _readings(one, model)),
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


def _pieces(
    several: Sequence[Subject], models: Sequence[ExtendedModel] | None
) -> Iterable[tuple[Subject, ExtendedModel | None]]:
    """The first sweep of every specimen with its model."""
    found: dict[str, tuple[Subject, ExtendedModel | None]] = {}
    for one, model in zip(several, models or [None] * len(several), strict=True):
        found.setdefault(one.name, (one, model))
    return found.values()


def _readings(one: Subject, model: ExtendedModel | None) -> list[Reading]:
    """The `[readings]` of its file as data of a fit."""
    problem, table = one.problem, one.problem.specimen.readings
    return [
        Reading(
            name,
            value,
            std * abs(value),
            one.name,
            problem.density,
            problem.plate.volume,
            problem.plate.electrode_area,
            model,
        )
        for name, (value, std) in (table.given if table is not None else {}).items()
    ]
