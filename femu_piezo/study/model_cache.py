"""Where the models and bases of updates and diagnoses come from: made for one specimen, or shared by a lot of them.

A shared basis must not depend on which specimen came first, or a row of a lot would change with the order of work.
So everything it is built from is a function of the specimen file and of rounded values: mesh, band and accuracy go to
the next rung of ladders, the constants it is trained around are those of the specimen file, or the nearest on a grid
where the sweep says otherwise. Equal inputs give equal bits.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, MutableMapping, Sequence
from threading import Lock
from typing import Any, Protocol, TypeVar
from weakref import WeakKeyDictionary, WeakValueDictionary

import numpy as np

from femu_piezo.effects.effect import Effect
from femu_piezo.effects.extended_model import ExtendedModel, Needs, extend_model
from femu_piezo.errors import ConvergenceError
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.mesh_file import MeshFile
from femu_piezo.inference.free_constants import FreeConstants
from femu_piezo.material.constants import D_FORM, PiezoConstants
from femu_piezo.study.problem import Problem
from femu_piezo.threads import Once

#: Relative range of the free constants that one reduced basis is trained for, how far from its centre a result may end,
#: and how many bases are made at most.
SPREAD, LEAVE, _BASES = 0.25, 0.3, 6
#: Number of curves that are kept with a basis.
_CURVES = 2
#: Relative distance from the constants of another basis, or of the specimen file, within which a start uses the basis
#: around these: for rough bases, and for those with effects, which are made again where a fit ends farther away.
_NEAR, CLOSE = 0.2, 0.08
#: The same for held constants, which the bases with effects are trained for in a wider range.
HELD_CLOSE = 0.15
#: Rungs of the ladders of frequencies (relative to the expected first pole) of an update and of a diagnosis, whose
#: meshes are costly; of accuracies (relative to 1); and of the grid of constants.
_RUNG, _FINE_RUNG, _ACCURACY_RUNG, _GRID = 1.25, 1.04, 1.5, 1.1

Made = TypeVar("Made")


class Swept(Protocol):
    """A body that was swept, or is to be, up to a frequency."""

    @property
    def problem(self) -> Problem:
        """The body and its constants."""

    @property
    def band_Hz(self) -> float:
        """The highest frequency."""


class Bases:
    """Models and reduced bases made for the specimens at hand, around their own start values.

    Rough bases are kept, for further starts in their range. Specimens of equal shape, density and band share models and
    bases with effects, which are kept as long as they are in use.
    """

    def __init__(self) -> None:
        self._anchors: list[FreeConstants] = []
        self._shelves: dict[str, MutableMapping[Hashable, Any]] = {
            "model": WeakValueDictionary(),
            "rough": {},
            "extended": WeakValueDictionary(),
        }

    def model(self, one: Swept, accuracy: float) -> ElectroelasticModel:
        """Mesh within `accuracy` (relative, of eigenvalues) to the end of the sweep."""
        problem, accuracy = one.problem, self._rung_below(accuracy)
        exact = problem.equivalent_frequency(one.band_Hz, accuracy)
        return self._model(problem, self._rung(problem, exact, _FINE_RUNG), accuracy)

    def anchor(self, problem: Problem, free: FreeConstants) -> FreeConstants:
        """The free constants that rough bases are trained around: those of an earlier start near by, else `free`."""
        for one in self._anchors:
            if one.names != free.names or not np.allclose(one.fixed, free.fixed, rtol=1e-9, atol=0):
                continue
            if np.max(np.abs(free.start.real / one.start.real - 1)) <= _NEAR:
                return one
        self._anchors.append(free)
        return free

    def around(self, problem: Problem, constants: PiezoConstants) -> PiezoConstants:
        """The constants that bases with effects are trained around, where a fit starts from `constants`."""
        return constants

    def rough(self, model: ElectroelasticModel, around: FreeConstants, one: Swept, accuracy: float) -> ExtendedModel:
        """Basis for the free constants within `SPREAD` of `around`, without effects."""
        band = self._rung(one.problem, one.band_Hz, _RUNG)
        key = (band, accuracy, around.names, _bits(around.start), _bits(around.constants(around.start).vector()))
        return self._basis(
            "rough",
            model,
            key,
            lambda: extend_model(model, around.training_sets(around.start, SPREAD), (), band, accuracy=accuracy),
        )

    def following(
        self,
        measured: Sequence[Swept],
        full: Sequence[ElectroelasticModel],
        start: PiezoConstants,
        accuracy: float,
        step: Callable[[FreeConstants, Sequence[ExtendedModel]], tuple[Made, PiezoConstants | None]],
    ) -> Made:
        """The result of a step on rough bases, made again around the constants found until these are in their range.

        Parameters
        ----------
        full : the model of each sweep
        step : free constants to begin at and the basis of each sweep → the result, and the constants found; None where
            no basis can follow them

        Raises
        ------
        ConvergenceError : the constants keep leaving the range of the bases
        """
        problem, constants = measured[0].problem, start
        for _ in range(_BASES):
            free = problem.free(constants)
            around = self.anchor(problem, free)
            models = tuple(self.rough(model, around, one, accuracy) for model, one in zip(full, measured, strict=True))
            found, constants = step(free, models)
            if constants is None:
                return found
            if np.max(np.abs(problem.free(constants).start.real / around.start.real - 1)) <= LEAVE:
                return found
        raise ConvergenceError(
            "the constants kept leaving the range of the reduced model; start from a closer base material or free "
            "fewer constants"
        )

    def extended(
        self,
        model: ElectroelasticModel,
        training: Sequence[PiezoConstants],
        effects: Sequence[Effect],
        one: Swept,
        accuracy: float,
    ) -> ExtendedModel:
        """Basis that serves all effects of a list, within `accuracy` of Z at the training constants."""
        band, accuracy = self._rung(one.problem, one.band_Hz, _FINE_RUNG), self._rung_below(accuracy)
        key = (band, accuracy, *(_bits(item.vector()) for item in training), Needs.of(effects))
        return self._basis(
            "extended",
            model,
            key,
            lambda: extend_model(model, training, effects, band, accuracy=accuracy),
        )

    def curve(
        self, model: ExtendedModel, omega: np.ndarray, free: FreeConstants, make: Callable[[], np.ndarray]
    ) -> np.ndarray:
        """Z (k,), ohm, of the constants `free.start` at ω (k,) by a basis, without effects, as `make` computes it."""
        return make()

    def _rung(self, problem: Problem, frequency_Hz: float, step: float) -> float:
        """The frequency, Hz, that is used in place of a given one; not lower."""
        return frequency_Hz

    def _rung_below(self, accuracy: float) -> float:
        """The accuracy that is used in place of a given one; not larger."""
        return accuracy

    def _model(self, problem: Problem, frequency_Hz: float, accuracy: float) -> ElectroelasticModel:
        key = _key_of_model(problem, frequency_Hz, accuracy)
        return self._kept("model", key, lambda: problem.model(frequency_Hz, accuracy))

    def _basis(
        self, kind: str, model: ElectroelasticModel, key: tuple[Hashable, ...], make: Callable[[], Made]
    ) -> Made:
        """The basis of a model with that kind and key, made where it is not kept."""
        return self._kept(kind, (model, *key), make)

    def _kept(self, kind: str, key: Hashable, make: Callable[[], Made]) -> Made:
        """What is kept under a key, made where there is nothing."""
        found = self._shelves[kind].get(key)
        if found is None:
            found = self._shelves[kind][key] = make()
        return found


class SharedBases(Bases):
    """Models and bases shared by all specimens of equal geometry, density, fixed constants and accuracy in a process.

    Parameters
    ----------
    models, bases, extended : how many are kept, the latest used; a basis takes some MB, a model up to some 100 MB, a
        basis with effects up to some 100 MB

    Attributes
    ----------
    made, used : models and bases built, and asked for, so far
    """

    def __init__(self, models: int = 6, bases: int = 16, extended: int = 8) -> None:
        super().__init__()
        self._most = {"model": models, "rough": bases, "extended": extended}
        self._shelves = {kind: OrderedDict() for kind in self._most}
        self._keys: WeakKeyDictionary[ElectroelasticModel, Hashable] = WeakKeyDictionary()
        self._curves: WeakKeyDictionary[ExtendedModel, Once] = WeakKeyDictionary()
        self._guard = Lock()
        self.made = self.used = 0

    def anchor(self, problem: Problem, free: FreeConstants) -> FreeConstants:
        near = _rounded(problem, free, _NEAR)
        return free if near is None else problem.free(problem.simplified(near.lossless()))

    def around(self, problem: Problem, constants: PiezoConstants) -> PiezoConstants:
        near = _rounded(problem, problem.free(constants), CLOSE)
        return constants if near is None else problem.simplified(near)

    def curve(
        self, model: ExtendedModel, omega: np.ndarray, free: FreeConstants, make: Callable[[], np.ndarray]
    ) -> np.ndarray:
        with self._guard:
            kept = self._curves.setdefault(model, Once(latest=_CURVES))
        key = (_bits(omega), free.names, *map(_bits, (free.start, free.fixed, free.directions)))
        found = kept.get(key, make)
        found.setflags(write=False)
        return found

    def _rung(self, problem: Problem, frequency_Hz: float, step: float) -> float:
        """The next rung at or above a frequency, Hz; a share of 1e-9 above a rung still belongs to it."""
        unit = problem.expected_pole_Hz
        return float(unit * step ** np.ceil(np.log(frequency_Hz / unit) / np.log(step) - 1e-9))

    def _rung_below(self, accuracy: float) -> float:
        """The next rung at or below an accuracy."""
        return float(_ACCURACY_RUNG ** np.floor(np.log(accuracy) / np.log(_ACCURACY_RUNG) + 1e-9))

    def _model(self, problem: Problem, frequency_Hz: float, accuracy: float) -> ElectroelasticModel:
        key = _key_of_model(problem, frequency_Hz, accuracy)
        model = self._kept("model", key, lambda: self._of_one_mesh(key[0], problem.model(frequency_Hz, accuracy)))
        self._keys.setdefault(model, key)
        return model

    def _of_one_mesh(self, body: Hashable, made: ElectroelasticModel) -> ElectroelasticModel:
        """The kept model of the body if it has the same mesh, as for neighbouring rungs; else the model `made`."""
        with self._guard:
            kept = [model for (of_body, *_), model in self._shelves["model"].items() if of_body == body]
        return next((model for model in kept if model.domain.has_mesh_of(made.domain)), made)

    def _basis(
        self, kind: str, model: ElectroelasticModel, key: tuple[Hashable, ...], make: Callable[[], Made]
    ) -> Made:
        return self._kept(kind, (self._keys[model], *key), make)

    def _kept(self, kind: str, key: Hashable, make: Callable[[], Made]) -> Made:
        shelf = self._shelves[kind]
        with self._guard:
            self.used += 1
            if key in shelf:
                shelf.move_to_end(key)
                return shelf[key]
        found = make()  # not under the lock: threads make several at once
        with self._guard:
            self.made += 1
            shelf[key] = found
            while len(shelf) > self._most[kind]:
                shelf.popitem(last=False)
        return found


def _rounded(problem: Problem, free: FreeConstants, near: float) -> PiezoConstants | None:
    """The constants, each that of the file or on the grid; None if unstable.

    All free constants are on the grid where one of them is not within `near` (relative) of the file's, each held one
    where it is not within `HELD_CLOSE`. The tangents are those of the file in either case.
    """
    of_file, start = problem.constants.vector(), free.constants(free.start).vector().real
    size = np.where(of_file.real == 0, np.inf, of_file.real)
    away, is_free = np.abs(start / size - 1), np.isin(D_FORM, free.names)
    with np.errstate(divide="ignore"):
        steps = np.round(np.log(np.abs(start)) / np.log(_GRID))
    on_grid = np.sign(start) * _GRID**steps * (1 + 1j * of_file.imag / size)
    held_moved = ~is_free & (away > HELD_CLOSE) & (not problem.specimen.material.simplified)
    held = np.where(held_moved, on_grid, of_file)
    moved = np.where(is_free, on_grid, held)
    for values in (held, moved) if np.all(away[is_free] <= near) else (moved,):
        constants = PiezoConstants.from_vector(values)
        around = problem.free(problem.simplified(constants.lossless()))
        if not around.constants(around.start).physical_faults():
            return constants
    return None


def body_of(problem: Problem) -> tuple[Hashable, ...]:
    """What tells one body from another: shape (of a mesh file also its state), density, order of elements."""
    state: tuple[Hashable, ...] = ()
    if isinstance(problem.plate, MeshFile):
        status = problem.plate.file.stat()
        state = (status.st_mtime_ns, status.st_size, status.st_ino)
    return (type(problem.plate), problem.plate, *state, problem.density, problem.order)


def _key_of_model(problem: Problem, frequency_Hz: float, accuracy: float) -> tuple[Hashable, ...]:
    """The body, and what else its mesh depends on."""
    return (body_of(problem), problem.shear_speed, frequency_Hz, accuracy)


def _bits(values: np.ndarray) -> bytes:
    return np.ascontiguousarray(values).tobytes()
