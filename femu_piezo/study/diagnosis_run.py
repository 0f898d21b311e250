"""Mesh, basis and comparison of a diagnosis; the basis is made anew where the base fit leaves its range."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from femu_piezo.diagnosis.compare import Comparison, compare
from femu_piezo.diagnosis.evaluation import Evaluation
from femu_piezo.diagnosis.extended_model import ExtendedModel, extend_model
from femu_piezo.diagnosis.fitting import SweepData
from femu_piezo.diagnosis.joint import JointParameters
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.study.measured import Measured
from femu_piezo.updating.data import weak_prior
from femu_piezo.updating.parameters import FreeConstants, MaterialParameters

#: Mesh error (relative, of eigenvalues at the end of the sweep) and error of the reduced model, as shares of the noise,
#: and the ranges they are kept in.
_MESH_SHARE, _MESH_RANGE = 1 / 60, (5e-6, 1e-4)
_BASIS_SHARE, _BASIS_RANGE = 1 / 30, (5e-6, 5e-5)
#: Relative error of Z that the finest mesh leaves: sweeps are not taken to be more exact than the model.
LEAST_ERROR = 10 * _MESH_RANGE[0]
#: Relative range of the free and of the held constants that the basis is trained for, and how far a base fit may
#: leave the first before the basis is made anew.
_FREE_SPREAD, _HELD_SPREAD, _LEAVE = 0.05, 0.1, 0.08

Progress = Callable[[str], None]


class Run:
    """Mesh, basis and comparison; the basis is made anew where the base fit leaves its range."""

    def __init__(self, measured: Measured, noise: np.ndarray, fitted: np.ndarray, fixed, candidates) -> None:
        self._measured, self._fixed, self._candidates = measured, fixed, candidates
        self._noise = noise[fitted]
        typical = float(np.median(noise))
        self._accuracy = float(np.clip(typical * _MESH_SHARE, *_MESH_RANGE))
        self._basis_accuracy = float(np.clip(typical * _BASIS_SHARE, *_BASIS_RANGE))
        self.notes: tuple[str, ...] = ()
        if typical < 2 * LEAST_ERROR:
            self.notes = (
                f"the noise of the sweep is near or below the error of the model; errors of Z below {LEAST_ERROR:.0e} "
                "count as noise",
            )
        self.unknowns = 0

    def compare(
        self, start: PiezoConstants, tell: Progress, clock: dict[str, float], most: int
    ) -> tuple[Comparison, ExtendedModel]:
        """Compare from start constants, and the model it was done with; times go to `clock`."""
        began = time.perf_counter()
        problem, highest = self._measured.problem, self._measured.band_Hz
        tell("mesh and assemble")
        model = problem.model(problem.equivalent_frequency(highest, self._accuracy), self._accuracy)
        self.unknowns = model.size
        clock["mesh and assemble"], began = time.perf_counter() - began, time.perf_counter()
        constants = start
        for _ in range(3):
            tell(f"reduce {model.size} unknowns")
            free = problem.free(constants)
            effects = (*self._candidates, *(effect for effect, _ in self._fixed))
            extended = extend_model(model, _training(constants, free), effects, highest, accuracy=self._basis_accuracy)
            clock["reduce"] = clock.get("reduce", 0.0) + time.perf_counter() - began
            began = time.perf_counter()
            comparison = self._compared(extended, free, tell, most)
            clock["compare"] = clock.get("compare", 0.0) + time.perf_counter() - began
            began = time.perf_counter()
            material = comparison.base.parameters.material
            own = comparison.base.x[: 2 * material.scale.size]
            if np.max(np.abs(own[0::2] - 1)) <= _LEAVE:
                break
            constants = material.constants(own)
        return comparison, extended

    def _compared(self, extended: ExtendedModel, free: FreeConstants, tell: Progress, most: int) -> Comparison:
        material = MaterialParameters.around(free, free.start)
        prior = weak_prior(material, free.start)
        data = SweepData(self._measured.fitted.impedance, self._noise, self._measured.spectrum.noise is not None, prior)
        parameters = JointParameters(material, (), self._fixed)
        evaluation = Evaluation(extended, self._measured.fitted.omega)
        start = material.x_of(free.start)
        return compare(evaluation, data, parameters, start, self._candidates, most=most, progress=tell)


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
