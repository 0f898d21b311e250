"""Where the models and reduced bases of an update come from: made for one specimen, or shared by a lot of them.

A shared basis must not depend on which specimen came first, or a row of a lot would change with the order of work.
So everything it is built from is a function of the specimen file and of rounded values: the mesh and the band go up
to the next rung of a ladder of frequencies, the constants it is trained around are those of the specimen file, or
the nearest on a grid where the sweep says otherwise. Equal inputs give equal bits.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import ReducedModel, reduce_model
from femu_piezo.geometry.mesh_file import MeshFile
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.specimen import Update
from femu_piezo.study.inputs import Problem
from femu_piezo.study.measured import Measured
from femu_piezo.updating.parameters import FreeConstants

#: Relative range of the free constants that one reduced basis covers, and how far they may leave it.
SPREAD, LEAVE = 0.25, 0.3
#: A start within this of the specimen file's constants uses the basis around those.
_NEAR = 0.2
#: Rungs of the ladder of frequencies (relative to the expected first pole) and of the grid of free constants.
_RUNG, _GRID = 1.25, 1.1

Made = TypeVar("Made")


class Bases:
    """Models and reduced bases made for the specimens at hand, around their own start values; nothing is kept."""

    def model(self, one: Measured, whole_curve: bool) -> ElectroelasticModel:
        """Mesh within the specimen's accuracy to the end of the sweep, or (`whole_curve` False) to the zero."""
        return one.problem.model(one.model_frequency(whole_curve), _accuracy(one))

    def anchor(self, problem: Problem, free: FreeConstants) -> FreeConstants:
        """The free constants with the values that the bases are trained around."""
        return free

    def reduced(self, model: ElectroelasticModel, around: FreeConstants, one: Measured) -> ReducedModel:
        """Basis for the free constants within `SPREAD` of `around`."""
        return reduce_model(model, around.training_sets(around.start, SPREAD), one.band_Hz)

    def baseline(self, model: ElectroelasticModel, base: PiezoConstants, one: Measured) -> ReducedModel:
        """Basis for the curve of one set of constants."""
        return reduce_model(model, [base], one.band_Hz)


class SharedBases(Bases):
    """The same, shared by all specimens of equal geometry, density, fixed constants and accuracy in this process.

    Parameters
    ----------
    models, bases : how many are kept, the latest used; a basis takes some MB, a model up to some 100 MB

    Attributes
    ----------
    made, used : models and bases built, and asked for, so far
    """

    def __init__(self, models: int = 4, bases: int = 16) -> None:
        self._models: OrderedDict[Hashable, ElectroelasticModel] = OrderedDict()
        self._reduced: OrderedDict[Hashable, ReducedModel] = OrderedDict()
        self._keys: WeakKeyDictionary[ElectroelasticModel, Hashable] = WeakKeyDictionary()
        self._most_models, self._most_bases = models, bases
        self.made = self.used = 0

    def model(self, one: Measured, whole_curve: bool) -> ElectroelasticModel:
        frequency = self._rung(one.problem, one.model_frequency(whole_curve))
        key = (*_body(one.problem), one.problem.shear_speed, frequency, _accuracy(one))
        model = self._kept(self._models, key, lambda: one.problem.model(frequency, _accuracy(one)), self._most_models)
        self._keys[model] = key
        return model

    def anchor(self, problem: Problem, free: FreeConstants) -> FreeConstants:
        own = np.array([getattr(problem.constants, name).real for name in free.names])
        start = free.start.real
        rounded = np.sign(start) * _GRID ** np.round(np.log(np.abs(start)) / np.log(_GRID))
        near = np.all(np.abs(start / np.where(own == 0, np.inf, own) - 1) <= _NEAR)
        for values in (own, rounded) if near else (rounded,):
            constants = problem.constants.with_values(**dict(zip(free.names, values, strict=True)))
            around = problem.free(problem.simplified(constants.lossless()))
            if not around.constants(around.start).physical_faults():
                return around
        return free

    def reduced(self, model: ElectroelasticModel, around: FreeConstants, one: Measured) -> ReducedModel:
        band = self._rung(one.problem, one.band_Hz)
        key = (
            self._keys[model],
            band,
            around.names,
            _bits(around.start),
            _bits(around.constants(around.start).vector()),
        )
        return self._kept(
            self._reduced,
            key,
            lambda: reduce_model(model, around.training_sets(around.start, SPREAD), band),
            self._most_bases,
        )

    def baseline(self, model: ElectroelasticModel, base: PiezoConstants, one: Measured) -> ReducedModel:
        band = self._rung(one.problem, one.band_Hz)
        key = (self._keys[model], band, "baseline", _bits(base.vector()))
        return self._kept(self._reduced, key, lambda: reduce_model(model, [base], band), self._most_bases)

    @staticmethod
    def _rung(problem: Problem, frequency_Hz: float) -> float:
        """The next rung at or above a frequency, Hz; a share of 1e-9 above a rung still belongs to it."""
        unit = problem.expected_pole_Hz
        return float(unit * _RUNG ** np.ceil(np.log(frequency_Hz / unit) / np.log(_RUNG) - 1e-9))

    def _kept(self, shelf: OrderedDict[Hashable, Made], key: Hashable, make: Callable[[], Made], most: int) -> Made:
        self.used += 1
        if key not in shelf:
            self.made += 1
            shelf[key] = make()
            while len(shelf) > most:
                shelf.popitem(last=False)
        shelf.move_to_end(key)
        return shelf[key]


def _accuracy(one: Measured) -> float:
    return (one.problem.specimen.update or Update()).accuracy


def _body(problem: Problem) -> tuple[Hashable, ...]:
    """What tells one body from another: its shape, for a mesh file also that file's state, and its density."""
    state: tuple[Hashable, ...] = ()
    if isinstance(problem.plate, MeshFile):
        status = problem.plate.file.stat()
        state = (status.st_mtime_ns, status.st_size, status.st_ino)
    return (type(problem.plate), problem.plate, *state, problem.density)


def _bits(values: np.ndarray) -> bytes:
    return np.ascontiguousarray(values).tobytes()
