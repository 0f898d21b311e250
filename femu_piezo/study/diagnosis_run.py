"""Meshes, bases and comparison of a diagnosis; the bases are made anew where the base fit leaves their range."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from femu_piezo.diagnosis.compare import Comparison, compare
from femu_piezo.effects.effect import Effect
from femu_piezo.effects.extended_model import ExtendedModel
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.inference.blocks import weak_prior
from femu_piezo.inference.ensemble import Ensemble, own_parameters
from femu_piezo.inference.fit import JointFit, SweepData
from femu_piezo.inference.joint import JointParameters
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.unknowns import FreeConstants, MaterialParameters
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.study.diagnosis_subject import LEAST_ERROR, Subject
from femu_piezo.study.model_cache import Bases
from femu_piezo.study.progress import Clock

#: Mesh error (relative, of eigenvalues at the end of the sweep) and error of the reduced model, as shares of the noise,
#: and the ranges they are kept in.
_MESH_SHARE, _MESH_RANGE = 1 / 60, (LEAST_ERROR / 10, 1e-4)
_BASIS_SHARE, _BASIS_RANGE = 1 / 30, (5e-6, 5e-5)
#: Relative range of the free and of the held constants that the basis is trained for, and how far a base fit may
#: leave the first before the basis is made anew.
_FREE_SPREAD, _HELD_SPREAD, _LEAVE = 0.05, 0.1, 0.08


class Run:
    """A model of each specimen, and the comparison on all.

    Attributes
    ----------
    models : the reduced model of each specimen;  unknowns : of all full models
    notes : what is to be said about the accuracy
    """

    def __init__(self, several: Sequence[Subject], candidates: Sequence[Effect], clock: Clock, bases: Bases) -> None:
        self._several, self._candidates, self._clock, self._bases = several, tuple(candidates), clock, bases
        self.models: tuple[ExtendedModel, ...] = ()
        self.unknowns = 0
        self.notes: tuple[str, ...] = ()
        if min(float(np.median(one.noise)) for one in several) < 2 * LEAST_ERROR:
            self.notes = (
                f"the noise of the sweep is near or below the error of the model; errors of Z below {LEAST_ERROR:.0e} "
                "count as noise",
            )

    def compare(self, start: PiezoConstants, most: int) -> Comparison:
        """Compare from start constants."""
        self._clock.step("mesh and assemble")
        full = [
            self._bases.fine_model(one.measured, _share_of_noise(one, _MESH_SHARE, _MESH_RANGE))
            for one in self._several
        ]
        self.unknowns = sum(model.size for model in full)
        problem, constants = self._several[0].measured.problem, start
        for _ in range(3):
            self._clock.step("reduce")
            around = self._bases.around(problem, constants)
            training = _training(around, problem.free(around))
            self.models = tuple(
                self._reduced(one, model, training) for one, model in zip(self._several, full, strict=True)
            )
            comparison = self._compared(problem.free(constants), most)
            material = comparison.base.parameters.material
            own = comparison.base.x[: 2 * material.scale.size]
            moved = material.theta(own).real - problem.free(around).start.real
            if np.all(np.abs(moved) <= _LEAVE * np.abs(material.scale)):
                break
            constants = material.constants(own)
        return comparison

    @property
    def evaluation(self) -> Evaluation | Ensemble:
        """Of the points that fits see."""
        parts = [
            (one.name, Evaluation(model, one.measured.fitted.omega))
            for one, model in zip(self._several, self.models, strict=True)
        ]
        return Ensemble(tuple(parts)) if len(parts) > 1 else parts[0][1]

    def curve(self, index: int, fit: JointFit) -> np.ndarray:
        """Z (k,) of one specimen over its whole sweep, ohm."""
        evaluation, own, columns = self._whole_sweep(index, fit)
        return evaluation.impedance(own, fit.x[columns])

    def log_slopes(self, index: int, fit: JointFit) -> np.ndarray:
        """(k, n_x) slopes of log Z of one specimen over its whole sweep in all unknowns of a fit."""
        evaluation, own, columns = self._whole_sweep(index, fit)
        z, tangents = evaluation.with_jacobian(own, fit.x[columns])
        slopes = np.zeros((z.size, fit.x.size), dtype=complex)
        slopes[:, columns] = tangents / z[:, None]
        return slopes

    def _whole_sweep(self, index: int, fit: JointFit) -> tuple[Evaluation, JointParameters, np.ndarray]:
        one = self._several[index]
        return Evaluation(self.models[index], one.measured.spectrum.omega), *own_parameters(fit.parameters, one.name)

    def _reduced(self, one: Subject, model: ElectroelasticModel, training: Sequence[PiezoConstants]) -> ExtendedModel:
        effects = [effect for effect in self._candidates if effect.specimen in ("", one.name)]
        effects += [effect for effect, _ in one.fixed]
        accuracy = _share_of_noise(one, _BASIS_SHARE, _BASIS_RANGE)
        return self._bases.extended(model, training, effects, one.measured, accuracy)

    def _compared(self, free: FreeConstants, most: int) -> Comparison:
        self._clock.step("compare")
        several = self._several
        material = MaterialParameters.around(free, free.start)
        data = SweepData(
            impedance=np.concatenate([one.measured.fitted.impedance for one in several]),
            relative_noise=np.concatenate([one.noise[one.fitted] for one in several]),
            noise_known=all(one.noise_known for one in several),
            prior=weak_prior(material, free.start),
            sizes=tuple(len(one.measured.fitted) for one in several),
        )
        parameters = JointParameters(material, (), tuple(item for one in several for item in one.fixed))
        start = material.x_of(free.start)
        return compare(self.evaluation, data, parameters, start, self._candidates, most=most, progress=self._clock.tell)


def _share_of_noise(one: Subject, share: float, limits: tuple[float, float]) -> float:
    return float(np.clip(np.median(one.noise) * share, *limits))


def _training(constants: PiezoConstants, free: FreeConstants) -> list[PiezoConstants]:
    """The start with its losses, corners of the free constants, and every held constant moved.

    One way each: the reduction watches the point mirrored at the start by itself.
    """
    lossless = constants.lossless()
    sets = [constants, *free.training_sets(free.start, _FREE_SPREAD, 4)[1:]]
    for name, value in lossless.as_dict().items():
        if name not in free.names and value != 0:
            moved = (lossless.with_values(**{name: value * (1 + sign * _HELD_SPREAD)}) for sign in (1, -1))
            sets += [item for item in moved if not item.physical_faults()][:1]
    return sets
