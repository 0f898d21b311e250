"""What is known of a sweep and its specimen before any fit: noise, tolerances, known and possible effects."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext
from femu_piezo.effects.library import Maker, effects_of, library, listed
from femu_piezo.errors import InputError
from femu_piezo.inference.ensemble import Share, is_common, with_owner
from femu_piezo.measurement.autoregression import WHITE, Autoregression
from femu_piezo.measurement.noise import estimate_noise
from femu_piezo.measurement.sweeps import noise_memory
from femu_piezo.study.effects import effect_context, known_effects
from femu_piezo.study.measured import Measured
from femu_piezo.study.problem import Problem
from femu_piezo.threads import made_once

#: Relative error of Z that meshes and bases leave at least: sweeps are not taken to be more exact than the model.
LEAST_ERROR = 1e-5


@dataclass(frozen=True)
class Subject:
    """One specimen and one sweep of it.

    Attributes
    ----------
    name : of the specimen where there are several, "" for the only one; several sweeps of it are under one name
    fixture : name of the fixture that held it, where the sweeps have several fixtures, else ""
    problem : the specimen as computed
    measured : its sweep; None before there is one (`femu_piezo.study.expectation`)
    noise : (k,) relative noise of the whole sweep, no less than the error of the model
    noise_memory : autoregression of the errors of neighbouring points
    fixed : effects of its file with their values;  freed : effects of its file that are unknowns, with start values
    effects : further effects that it may have; the library where None
    """

    name: str
    problem: Problem
    measured: Measured | None
    noise: np.ndarray
    context: EffectContext
    fixed: tuple[tuple[Effect, np.ndarray], ...]
    effects: tuple[Maker, ...] | None = None
    freed: tuple[tuple[Effect, np.ndarray], ...] = ()
    fixture: str = ""
    noise_memory: Autoregression = WHITE

    def owned(self, effect: Effect) -> Effect:
        """The effect, assigned to its owner: all specimens for a law of the material, the fixture, or the specimen."""
        if effect.owner or (is_common(effect) and effect.constants is not None):
            return effect
        return with_owner(effect, self.fixture if is_common(effect) else self.name)

    @made_once
    def share(self) -> Share:
        """Which unknowns of a fit concern this sweep."""
        every = (*self.library, *(effect for effect, _ in (*self.fixed, *self.freed)))
        forms = {self.owned(effect).key: self.owned(effect) for effect in every if effect.of_conditions}
        return Share((self.name, self.fixture), forms)

    @made_once
    def fitted(self) -> np.ndarray:
        """(k,) bool: the points of the sweep that fits see."""
        return np.isin(self.measured.spectrum.frequency, self.measured.fitted.frequency)

    @property
    def noise_known(self) -> bool:
        """Whether the noise came with the data."""
        return self.measured.noise_known

    @property
    def noise_notes(self) -> tuple[str, ...]:
        """A note where errors of neighbouring points are correlated."""
        if not self.noise_memory:
            return ()
        return (
            f"{self.name or self.problem.specimen.name}: the noise of neighbouring points is correlated "
            f"({self.noise_memory.correlations[0]:.2f}), as by filtering or smoothing, so each point counts for less",
        )

    @made_once
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
        unsized = tuple(effect for effect in every if (effect.name, effect.variant) not in taken)
        return (*unsized, *(effect for effect, _ in self.freed))


def subjects(measured: Sequence[Measured], effects: Iterable[Maker] | None = None) -> tuple[Subject, ...]:
    """What is known of each sweep; InputError where two specimens have one name, or a fixture that of a specimen.

    effects : what they may have in addition to the effects of their files; the library where None
    """
    effects = None if effects is None else listed(effects)
    pieces = [one.piece for one in measured if one.conditions.number == 0]
    names, fixtures = [piece.name for piece in pieces], {one.conditions.fixture for one in measured}
    double = next((name for index, name in enumerate(names) if name in names[:index]), None)
    if double is not None:
        raise InputError(
            f"{pieces[names.index(double)].path}: two specimens are named {double!r}; give each a name of its own, "
            "by which results refer to it"
        )
    ends = [one.spectrum.frequency[[0, -1]] for one in measured]
    band = float(min(low for low, _ in ends)), float(max(high for _, high in ends))
    if both := fixtures & set(names):
        raise InputError(f"{pieces[0].path}: {both.pop()!r} names a specimen and a fixture; give one another name")
    return tuple(
        _subject(
            one,
            band,
            one.piece.name if len(pieces) > 1 else "",
            one.conditions.fixture if len(fixtures) > 1 else "",
            effects,
        )
        for one in measured
    )


def _subject(
    measured: Measured, band: tuple[float, float], name: str, fixture: str, effects: tuple[Maker, ...] | None
) -> Subject:
    """band : lowest and highest frequency of all sweeps, Hz"""
    frequency = measured.spectrum.frequency
    typical = float(np.median(np.abs(measured.spectrum.impedance)))
    pole = measured.pair.pole.frequency_Hz
    context = effect_context(measured.problem, pole, typical, band, frequency, measured.conditions)
    noise = np.hypot(_relative_noise(measured), LEAST_ERROR)
    memory, louder = _noise_memory(measured, noise[np.isin(frequency, measured.fitted.frequency)])
    return subject(name, measured.problem, measured, noise * louder, context, effects, fixture, memory)


def subject(
    name: str,
    problem: Problem,
    measured: Measured | None,
    noise: np.ndarray,
    context: EffectContext,
    effects: tuple[Maker, ...] | None = None,
    fixture: str = "",
    noise_memory: Autoregression = WHITE,
) -> Subject:
    """The specimen with the effects of its file; arguments as the attributes of `Subject`."""
    known = known_effects(problem, context, effects)
    fixed = tuple(
        (effect if effect.owner else with_owner(effect, name), values) for effect, values in known if not effect.freed
    )
    freed = tuple(item for item in known if item[0].freed)
    return Subject(name, problem, measured, noise, context, fixed, effects, freed, fixture, noise_memory)


def shared_library(several: Sequence[Subject]) -> tuple[Effect, ...]:
    """Unknown effects common to all specimens (laws of the material, fixture), then those of single specimens.

    A free constant of the first is free for all, and so are the laws over frequency anchored at its fundamental.
    """
    if len(several) == 1:
        return several[0].library
    first = several[0]
    common = [effect for effect in first.library if is_common(effect) and not first.owned(effect).owner]
    found = {effect.key: effect for effect in common if all(_open(effect, one) for one in several)}
    for one in several:
        for effect in one.library:
            owned = one.owned(effect)
            if owned.owner or not is_common(effect):
                found.setdefault(owned.key, owned)
    return tuple(found.values())


def _open(effect: Effect, one: Subject) -> bool:
    """Whether the file of a specimen does not fix an effect."""
    return all((effect.name, effect.variant) != (known.name, known.variant) for known, _ in one.fixed)


def _relative_noise(measured: Measured) -> np.ndarray:
    """(k,) over the whole sweep: of the file, else estimated from the roughness of the fitted part alone."""
    impedance = measured.spectrum.impedance
    if measured.spectrum.noise is not None:
        return measured.spectrum.noise / np.abs(impedance)
    return estimate_noise(measured.fitted).std(impedance) / np.abs(impedance)


def _noise_memory(measured: Measured, noise: np.ndarray) -> tuple[Autoregression, float]:
    """Autoregression of neighbouring errors of a sweep, and the factor by which its noise exceeds `noise`.

    Both follow from the residual of the extraction, which needs no finite elements, if that may be noise
    (`femu_piezo.measurement.sweeps.noise_memory`). Else white noise and 1.

    noise : (k,) relative, of the fitted part
    """
    found = measured.extraction
    if found.model is None:
        return WHITE, 1.0
    residual = (np.log(found.impedance / measured.fitted.impedance) / noise)[found.used]
    memory, size = noise_memory(residual, found.model.size, measured.noise_known)
    return memory, 1.0 if measured.noise_known else size
