"""What is known of one specimen before any fit: sweep, noise, tolerances, known and possible effects."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext
from femu_piezo.effects.library import Maker, effects_of, library
from femu_piezo.errors import InputError
from femu_piezo.inference.ensemble import belonging_to, is_common
from femu_piezo.measurement.noise import estimate_noise
from femu_piezo.study.effects import effect_context, known_effects
from femu_piezo.study.measured import Measured
from femu_piezo.study.problem import Problem

#: Relative error of Z that meshes and bases leave at least: sweeps are not taken to be more exact than the model.
LEAST_ERROR = 1e-5


@dataclass(frozen=True)
class Subject:
    """One specimen.

    Attributes
    ----------
    name : of the specimen where there are several, "" for the only one
    problem : the specimen as computed
    measured : its sweep; None before there is one (`femu_piezo.study.expectation`)
    noise : (k,) relative noise of the whole sweep, no less than the error of the model
    fixed : the effects of its file with their values;  freed : those whose values are where a fit starts
    effects : what it may have beside those; the library where None
    """

    name: str
    problem: Problem
    measured: Measured | None
    noise: np.ndarray
    context: EffectContext
    fixed: tuple[tuple[Effect, np.ndarray], ...]
    effects: tuple[Maker, ...] | None = None
    freed: tuple[tuple[Effect, np.ndarray], ...] = ()

    @cached_property
    def fitted(self) -> np.ndarray:
        """(k,) bool: the points of the sweep that fits see."""
        return np.isin(self.measured.spectrum.frequency, self.measured.fitted.frequency)

    @property
    def noise_known(self) -> bool:
        """Whether the noise came with the data."""
        return self.measured.spectrum.noise is not None

    @cached_property
    def library(self) -> tuple[Effect, ...]:
        """Every effect whose size is not known: tolerances, candidates and those that the file frees.

        The tolerances are those of the library also where `effects` lacks them.
        """
        known = library(self.context)
        offered = known if self.effects is None else effects_of(self.context, self.effects)
        given = {effect.key for effect in offered}
        held = (effect for effect in known if effect.has_tolerance and effect.key not in given)
        taken = {(effect.name, effect.variant) for effect, _ in (*self.fixed, *self.freed)}
        every = (*offered, *(effect.within_tolerance for effect in held))
        own = tuple(effect for effect in every if (effect.name, effect.variant) not in taken)
        return (*own, *(effect for effect, _ in self.freed))


def subjects(measured: Sequence[Measured], effects: Iterable[Maker] | None = None) -> tuple[Subject, ...]:
    """What is known of each specimen; InputError where two of several have one name.

    effects : what they may have beside the effects of their files; the library where None
    """
    effects = None if effects is None else tuple(effects)
    specimens = [one.problem.specimen for one in measured]
    names = [specimen.name for specimen in specimens]
    double = next((name for index, name in enumerate(names) if name in names[:index]), None)
    if double is not None:
        raise InputError(
            f"{specimens[names.index(double)].path}: two specimens are named {double!r}; results say by name which "
            "specimen they are about, so give each its own"
        )
    many = len(measured) > 1
    return tuple(_subject(one, one.problem.specimen.name if many else "", effects) for one in measured)


def _subject(measured: Measured, name: str, effects: tuple[Maker, ...] | None) -> Subject:
    frequency = measured.spectrum.frequency
    typical = float(np.median(np.abs(measured.spectrum.impedance)))
    band = (float(frequency[0]), float(frequency[-1]))
    context = effect_context(measured.problem, measured.pair.pole.frequency_Hz, typical, band, frequency)
    noise = np.hypot(_relative_noise(measured), LEAST_ERROR)
    return subject(name, measured.problem, measured, noise, context, effects)


def subject(
    name: str,
    problem: Problem,
    measured: Measured | None,
    noise: np.ndarray,
    context: EffectContext,
    effects: tuple[Maker, ...] | None = None,
) -> Subject:
    """The specimen with the effects of its file; arguments as the attributes of `Subject`."""
    known = known_effects(problem, context, effects)
    fixed = tuple((belonging_to(effect, name), values) for effect, values in known if not effect.freed)
    freed = tuple(item for item in known if item[0].freed)
    return Subject(name, problem, measured, noise, context, fixed, effects, freed)


def shared_library(several: Sequence[Subject]) -> tuple[Effect, ...]:
    """What is common to all (laws of the material, fixture), then what each specimen may have of its own.

    A free constant of the first is free for all, and so are the laws over frequency anchored at its fundamental.
    """
    if len(several) == 1:
        return several[0].library
    shared = [e for e in several[0].library if is_common(e) and all(_open(e, one) for one in several)]
    own = [belonging_to(effect, one.name) for one in several for effect in one.library if not is_common(effect)]
    return (*shared, *own)


def _open(effect: Effect, one: Subject) -> bool:
    return all((effect.name, effect.variant) != (known.name, known.variant) for known, _ in one.fixed)


def _relative_noise(measured: Measured) -> np.ndarray:
    """(k,) over the whole sweep: of the file, else estimated from the roughness of the fitted part alone."""
    impedance = measured.spectrum.impedance
    if measured.spectrum.noise is not None:
        return measured.spectrum.noise / np.abs(impedance)
    return estimate_noise(measured.fitted).std(impedance) / np.abs(impedance)
