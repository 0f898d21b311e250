"""Meshes, reduced bases and the fit of a study; bases are made again where the fit leaves their range.

Several sweeps of one specimen have one mesh and one basis.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol, TypeVar

import numpy as np

from femu_piezo.effects.effect import Effect
from femu_piezo.effects.extended_model import ExtendedModel
from femu_piezo.errors import ConvergenceError, TooLargeError
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.inference.descent import COARSE
from femu_piezo.inference.ensemble import Ensemble, together
from femu_piezo.inference.fit import Fit, fit
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.starts.many_modes import ManyModes
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.material.constants import D_FORM, PiezoConstants
from femu_piezo.measurement.sweeps import SweepData
from femu_piezo.specimen.file import Update
from femu_piezo.study.model_cache import CLOSE, HELD_CLOSE, Bases, body_of
from femu_piezo.study.progress import Clock
from femu_piezo.study.starts import away_from_wall
from femu_piezo.study.subjects import LEAST_ERROR, Subject
from femu_piezo.study.tolerances import has_held_tolerances
from femu_piezo.study.unknowns import as_filed, constants_found, effects_served, tolerances_of, unknowns_of
from femu_piezo.threads import made_once

#: Mesh error (relative, of eigenvalues at the end of the sweep) and error of the reduced model, as shares of the noise,
#: and the ranges they are kept in.
_MESH_SHARE, _MESH_RANGE = 1 / 60, (LEAST_ERROR / 5, 1e-4)
_BASIS_SHARE, _BASIS_RANGE = 1 / 30, (5e-6, 5e-5)
#: The same errors of meshes and bases for estimates that are only a start.
COARSE_MESH, COARSE_BASIS = 5e-3, 1e-3
#: Relative range of the free constants that a basis is trained for; it serves results within `CLOSE`.
_FREE_SPREAD = 0.05
#: Growth of the range of the free constants with half the range of temperatures, relative, 1/K.
_PER_KELVIN = 3e-3
#: Most bases made: a fit that leaves the second one as well follows a misfit, and its constants are not the specimen's.
_REDUCTIONS = 2

Made = TypeVar("Made")


class Estimated(Protocol):
    """An estimate of unknowns."""

    @property
    def x(self) -> np.ndarray:
        """(n_x,) estimated unknowns."""


Found = TypeVar("Found", bound=Estimated)


class Posterior:
    """Models of all specimens, and fits of their sweeps.

    Parameters
    ----------
    several : the sweeps of all specimens; [material] and [update] are those of the first
    candidates : effects that the models must serve in addition to the tolerances
    coarse : meshes and bases of `COARSE_MESH` and `COARSE_BASIS`, for estimates that are only a start

    Attributes
    ----------
    models : the reduced model of each sweep; sweeps of equal bodies share a model
    tolerances : effects that every fit has
    bases : where models and bases come from
    """

    def __init__(
        self,
        several: Sequence[Subject],
        clock: Clock,
        bases: Bases,
        candidates: Sequence[Effect] = (),
        *,
        coarse: bool = False,
    ) -> None:
        self.several, self._coarse = tuple(several), coarse
        self._clock, self.bases, self._candidates = clock, bases, tuple(candidates)
        self.tolerances = tolerances_of(several)
        self.problem = several[0].problem
        self.models: tuple[ExtendedModel, ...] = ()
        self._around: PiezoConstants | None = None

    @made_once
    def _meshes(self) -> tuple[tuple[ElectroelasticModel, float], ...]:
        """The full model of each sweep, and the relative error of eigenvalues that its mesh was made for."""
        self._clock.step("mesh and assemble")
        return self._of_pieces(self._meshed)

    @property
    def full(self) -> tuple[ElectroelasticModel, ...]:
        """The full model of each sweep; sweeps of equal bodies share a model."""
        return tuple(model for model, _ in self._meshes)

    def mesh_error_at(self, index: int, frequency: np.ndarray) -> np.ndarray:
        """(k,) relative error of eigenvalues that the mesh of a sweep may have at frequencies (k,), Hz.

        That of `ExtendedModel.mesh_error` where the model has it; else what its mesh was made for at the end of the
        sweep, as ω⁴.
        """
        model, measured, accuracy = self.models[index], self.several[index].measured, self._meshes[index][1]
        if model.mesh_error is not None:
            return model.mesh_error.at(frequency)
        end = measured.problem.equivalent_frequency(measured.band_Hz, accuracy)
        return accuracy * (frequency / end) ** 4

    def mesh(self) -> None:
        """Make the full models before other work, which would be lost where one is too large (InputError)."""
        _ = self._meshes

    @property
    def unknowns(self) -> int:
        """Number of unknowns of all full models."""
        return sum(model.size for model in set(self.full))

    @property
    def loss(self) -> str:
        """Loss of the fits, as the file asks."""
        return (self.problem.specimen.update or Update()).loss

    def base(self, start: PiezoConstants, *, settled: bool = True) -> Fit:
        """The fit of constants and tolerances alone, from start constants.

        settled : whether the fit has to end at a minimum; else a coarse fit replaces one that does not settle

        Raises ConvergenceError where it has to settle and does not.
        """

        def estimate(unknowns: Unknowns, at: np.ndarray) -> Fit:
            try:
                return fit(self.evaluation, self.data, unknowns, [at], loss=self.loss)
            except ConvergenceError:
                if settled:
                    raise
                return fit(self.evaluation, self.data, unknowns, [at], loss=self.loss, gain=COARSE)

        return self.following(self._approached(start), estimate)

    def _approached(self, start: PiezoConstants) -> PiezoConstants:
        """The start; where the held constants are not the file's there, what a coarse fit makes of it.

        Such a start is of another material than the file's. The constants may be far from it, and a basis follows them
        at a great cost.
        """
        begun, of_file = (one.vector()[self._held] for one in (start, self.problem.constants))
        if self._coarse or np.allclose(begun, of_file, atol=0) or not has_held_tolerances(self.problem):
            return start
        try:
            found = Posterior(self.several, self._clock, self.bases, coarse=True).base(start, settled=False)
        except ConvergenceError:
            return start
        return constants_found(found.parameters, found.x)

    def following(self, start: PiezoConstants, estimate: Callable[[Unknowns, np.ndarray], Found]) -> Found:
        """The estimate from start constants, on models that are made again where it leaves their range.

        estimate : unknowns and where to begin (n_x,) → the estimate, with its `x` (n_x,)
        """
        of_file = unknowns_of(self.several)
        file_constants = constants_found(of_file, as_filed(self.several, of_file))
        constants, x, left = start, None, 1 if self._coarse else _REDUCTIONS
        while True:
            unknowns = unknowns_of(self.several, constants=constants)
            begin = as_filed(self.several, unknowns, constants)
            if x is not None:
                begin[unknowns.of_material :] = x[unknowns.of_material :]
            begin = np.clip(begin, *unknowns.bounds.T)
            self._prepare(away_from_wall(constants_found(unknowns, begin), file_constants))
            unknowns = unknowns_of(self.several, self.models, constants)
            self._clock.step("fit")
            found = estimate(unknowns, begin)
            constants = constants_found(unknowns, found.x)
            left -= 1
            if left == 0 or self._serves(constants):
                return found
            x = found.x
            del found, unknowns  # they hold models of these bases, and the next ones take as much memory

    @property
    def _held(self) -> np.ndarray:
        """(10,) bool: which constants are held."""
        return np.isin(D_FORM, self.problem.specimen.material.free, invert=True)

    def _prepare(self, constants: PiezoConstants) -> None:
        """Make the reduced models around given constants."""
        full = self.full
        self.models = ()
        self._clock.step("reduce")
        self._around = self.bases.around(self.problem, constants)
        spread = _FREE_SPREAD + _PER_KELVIN * max(one.context.conditions.span_K for one in self.several)
        training = self.problem.free(self._around).training_for_effects(self._around, spread)
        self.models = self._of_pieces(lambda number, several: self._reduced(full[number], number, several, training))

    def _serves(self, constants: PiezoConstants) -> bool:
        around, found = (one.vector().real for one in (self._around, constants))
        return bool(np.all(np.abs(found - around) <= np.where(self._held, HELD_CLOSE, CLOSE) * np.abs(around)))

    def _of_pieces(self, make: Callable[[int, Sequence[Subject]], Made]) -> tuple[Made, ...]:
        """For every sweep, what is made once for all sweeps of equal bodies.

        make : number of the sweep of a body that reaches highest, and all its sweeps → what is made
        """
        bodies = [body_of(one.problem) for one in self.several]
        made = {}
        for body in dict.fromkeys(bodies):
            numbers = [number for number, own in enumerate(bodies) if own == body]
            highest = max(numbers, key=lambda number: self.several[number].measured.band_Hz)
            made[body] = make(highest, [self.several[number] for number in numbers])
        return tuple(made[body] for body in bodies)

    def _meshed(self, number: int, several: Sequence[Subject]) -> tuple[ElectroelasticModel, float]:
        """The model of a body for the noise of its sweeps, or as exact as the file asks where that would be too large.

        Either way the error of its mesh counts in the deviations.

        Returns
        -------
        model, and the relative error of eigenvalues that its mesh was made for
        """
        measured = self.several[number].measured
        if self._coarse:
            return self.bases.model(measured, COARSE_MESH), COARSE_MESH
        wanted, asked = mesh_accuracy(several), _asked_accuracy(several)
        try:
            return self.bases.model(measured, wanted), wanted
        except TooLargeError:
            if not wanted < asked:
                raise
        return self.bases.model(measured, asked), asked

    def _reduced(
        self,
        full: ElectroelasticModel,
        number: int,
        several: Sequence[Subject],
        training: Sequence[PiezoConstants],
    ) -> ExtendedModel:
        offered = (*self.tolerances, *self._candidates)
        effects = list({effect.key: effect for one in several for effect in effects_served(one, offered)}.values())
        accuracy = COARSE_BASIS if self._coarse else _share_of_noise(several, _BASIS_SHARE, _BASIS_RANGE)
        return self.bases.extended(full, training, effects, self.several[number].measured, accuracy)

    @property
    def evaluation(self) -> Evaluation | Ensemble:
        """Z of the points that fits see."""
        pairs = zip(self.several, self.models, strict=True)
        return together([(one.share, Evaluation(model, one.measured.fitted.omega)) for one, model in pairs])

    @property
    def data(self) -> SweepData:
        """The points that fits see; the error of each basis counts as noise."""
        several = self.several
        noise = [
            np.hypot(one.noise[one.fitted], model.estimated_error)
            for one, model in zip(several, self.models, strict=True)
        ]
        return SweepData(
            frequency=np.concatenate([one.measured.fitted.frequency for one in several]),
            impedance=np.concatenate([one.measured.fitted.impedance for one in several]),
            relative_noise=np.concatenate(noise),
            noise_known=all(one.noise_known for one in several),
            sizes=tuple(len(one.measured.fitted) for one in several),
            model_share=np.concatenate(
                [(model.estimated_error / sigma) ** 2 for sigma, model in zip(noise, self.models, strict=True)]
            ),
            mesh_error=np.concatenate(
                [self.mesh_error_at(index, one.measured.fitted.frequency) for index, one in enumerate(several)]
            ),
            mesh_capacitance=np.concatenate(
                [
                    np.full(len(one.measured.fitted), 0.0 if model.mesh_error is None else model.mesh_error.capacitance)
                    for one, model in zip(several, self.models, strict=True)
                ]
            ),
            bodies=tuple(self.models.index(model) for model in self.models),
            noise_memory=tuple(one.noise_memory for one in several),
        )

    def curve(self, index: int, fit_: Fit | ManyModes) -> np.ndarray:
        """Z (k,), ohm, of sweep number `index` over all its points, by a fit; that of the fit where it saw them all."""
        one = self.several[index]
        if isinstance(fit_, Fit) and fit_.impedance is not None and np.all(one.fitted):
            return fit_.impedance[fit_.data.sweeps[index]]
        return self.impedance(index, fit_, one.measured.spectrum.frequency)

    def impedance(self, index: int, fit_: Fit | ManyModes, frequency: np.ndarray) -> np.ndarray:
        """Z (k,), ohm, under the conditions of sweep number `index` at any frequencies (k,), Hz, by a fit."""
        evaluation, unknowns, columns = self.whole_sweep(index, fit_)
        return replace(evaluation, omega=2 * np.pi * frequency).impedance(unknowns, fit_.x[columns])

    def log_slopes(self, index: int, fit_: Fit) -> np.ndarray:
        """(k, n_x) slopes of log Z of sweep number `index` over all its points, in all unknowns of a fit."""
        evaluation, unknowns, columns = self.whole_sweep(index, fit_)
        z, tangents = evaluation.with_jacobian(unknowns, fit_.x[columns])
        slopes = np.zeros((z.size, fit_.x.size), dtype=complex)
        slopes[:, columns] = tangents / z[:, None]
        return slopes

    def whole_sweep(self, index: int, fit_: Fit | ManyModes) -> tuple[Evaluation, Unknowns, np.ndarray]:
        """Z of sweep number `index` over all its points, the unknowns it has, and where they stand in x (n_x,)."""
        one = self.several[index]
        evaluation = Evaluation(self.models[index], one.measured.spectrum.omega)
        return evaluation, *one.share.of(fit_.parameters)


def mesh_accuracy(several: Sequence[Subject]) -> float:
    """Relative error of eigenvalues that the mesh may have: a share of the noise, no more than the file asks for."""
    return min(_asked_accuracy(several), _share_of_noise(several, _MESH_SHARE, _MESH_RANGE))


def _asked_accuracy(several: Sequence[Subject]) -> float:
    return (several[0].problem.specimen.update or Update()).accuracy


def _share_of_noise(several: Sequence[Subject], share: float, limits: tuple[float, float]) -> float:
    return float(np.clip(min(np.median(one.noise) for one in several) * share, *limits))
