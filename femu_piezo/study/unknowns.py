"""The unknowns of a fit of several sweeps, whether these are measured or planned."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from femu_piezo.effects.constant_factor import ConstantFactor
from femu_piezo.effects.effect import Effect
from femu_piezo.effects.extended_model import ExtendedModel
from femu_piezo.inference.coefficients import effects_on_constants, even_constants
from femu_piezo.inference.readings import Reading
from femu_piezo.inference.unknowns import MaterialParameters, Unknowns, material_prior
from femu_piezo.material.constants import D_FORM, PiezoConstants
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
    of_file, material = problem.free(problem.constants), problem.specimen.material
    start = of_file.start if constants is None else problem.free(constants).start
    return Unknowns(
        material=MaterialParameters.around(of_file.at(start), start, of_file.start),
        prior=material_prior(of_file, material.priors, material.tangent_priors),
        effects=tolerances_of(several),
        fixed=tuple({effect.key: (effect, values) for one in several for effect, values in one.fixed}.values()),
        readings=tuple(reading for one, model in _pieces(several, models) for reading in _readings(one, model)),
    )


def as_filed(several: Sequence[Subject], unknowns: Unknowns, constants: PiezoConstants | None = None) -> np.ndarray:
    """(n_x,) start: constants at their start in `unknowns`, freed effects as the files say, all others at rest.

    constants : where the held constants begin, as far as they are unknowns; those of the file where None
    """
    x = unknowns.prior_mean.copy()
    x[: unknowns.of_material] = unknowns.material.x_of(unknowns.material.free.start)
    if constants is not None:
        of_file = several[0].problem.constants
        for name, column, scale in _held(unknowns):
            x[column] = (getattr(constants, name).real / getattr(of_file, name).real - 1) / scale
    for one in several:
        for effect, values in one.freed:
            own = one.owned(effect)
            if unknowns.has(own):
                x[unknowns.columns(unknowns.index(own.key))] = values / own.scale
    return x


def constants_found(unknowns: Unknowns, x: np.ndarray) -> PiezoConstants:
    """The ten constants at x (n_x,): the free ones, and the held ones where file and fit move them."""
    held = [one for one in effects_on_constants(unknowns, x) if isinstance(one.effect.constants, ConstantFactor)]
    return even_constants(unknowns, x, held)


def _held(unknowns: Unknowns) -> Iterable[tuple[str, int, float]]:
    """Name, column of x and scale of the relative error of every held constant."""
    for number, effect in enumerate(unknowns.effects):
        if isinstance(effect.constants, ConstantFactor):
            yield D_FORM[effect.constants.index], unknowns.columns(number).start, effect.scale[0]


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
