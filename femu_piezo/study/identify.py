"""`identify`: which constants a sweep can determine, how well, and what would determine them better.

Three questions before anything is measured: which of the ten constants a sweep determines if noise is its only error
(`known`); which further measurement would determine the others (`recommendations`); what an update of the free
constants would state with the tolerances of the file, and which tolerance to improve first (`expected`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from femu_piezo.effects.effect import Effect
from femu_piezo.effects.extended_model import extend_model
from femu_piezo.errors import InputError, TooLargeError
from femu_piezo.files import as_json
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.shapes import Plate
from femu_piezo.inference.free_constants import FreeConstants
from femu_piezo.inference.identifiability import Identifiability, identifiability
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.sensitivity import Sensitivity
from femu_piezo.inference.unknowns import TANGENT, Unknowns
from femu_piezo.material.constants import D_FORM
from femu_piezo.measurement.sweeps import SweepData
from femu_piezo.specimen.file import Specimen
from femu_piezo.study.expectation import Expectation, expect, planned
from femu_piezo.study.noise_study import FEWEST_DRAWS, Setting, noise_study
from femu_piezo.study.plan import Plan, plan_sweep
from femu_piezo.study.problem import Problem, prepare, refuse_nothing_free
from femu_piezo.study.progress import Progress
from femu_piezo.study.resonances_with_effects import sensitivity_with_effects
from femu_piezo.study.simulate import sweep_frequencies
from femu_piezo.study.unknowns import effects_served, tolerances_of
from femu_piezo.threads import with_blas_limit

#: Eigenvalue error of the mesh: sensitivities need not be better.
_ACCURACY = 1e-3
#: Unknowns of the model of a further measurement from which it is not compared: it would take minutes and gigabytes.
_MOST_UNKNOWNS = 50_000
#: Relative noise of a point where no file states it.
_NOISE = 1e-3
#: Points of a candidate sweep.
_POINTS = 801


@dataclass(frozen=True)
class Recommendation:
    """A further measurement and what it would add.

    Attributes
    ----------
    measurement : in words
    gained : constants the data would then determine to better than 5 % and did not before
    std : constant → joint relative standard deviation with it
    """

    measurement: str
    gained: tuple[str, ...]
    std: dict[str, float]


@dataclass(frozen=True)
class IdentifyResult:
    """Prediction for one or several sweeps of one material.

    Attributes
    ----------
    noise : relative standard deviation of every point
    known : how well all ten constants are determined, with noise alone and a prior of ±50 % for each
    expected : the free constants as an update would state them, and what every tolerance adds
    study : updates of drawn specimens, for each noise and number of points; the second is for the sweep as planned
    plan : where to measure, if asked for
    notes : what was assumed, in sentences
    """

    names: tuple[str, ...]
    noise: float
    known: Identifiability
    sensitivities: tuple[Sensitivity, ...]
    recommendations: tuple[Recommendation, ...]
    expected: Expectation
    study: tuple[Setting, ...] = ()
    plan: Plan | None = None
    notes: tuple[str, ...] = ()

    @property
    def advice(self) -> tuple[str, ...]:
        """Sentences on what none of the sweeps and recommendations can determine."""
        shear = [name for name in ("s44", "d15", "eps11T") if self.known.verdict_or_absent(name) == "not"]
        if not shear or any(set(item.gained) & set(shear) for item in self.recommendations):
            return ()
        return (
            f"{', '.join(shear)} have an effect only where the field is perpendicular to the poling: measure a shear "
            "plate, poled along its length and electroded on its large faces (k15: poling = [1, 0, 0] in its file)",
        )

    def to_json(self) -> dict:
        """Contents of identifiability.json; None for what is infinite or not known."""
        found = {
            "specimens": list(self.names),
            "relative_noise": self.noise,
            "constants": {
                name: {
                    "determined": self.known.verdict(name),
                    "relative_std": self.known.std[index],
                    "relative_std_if_all_else_known": self.known.std_alone[index],
                    "tan_std": self.known.std[index + 1],
                }
                for index, name in enumerate(self.known.names)
                if not name.startswith("tan_")
            },
            "weakest_combinations": self.known.weakest(),
            "recommendations": [
                {
                    "measurement": item.measurement,
                    "would_determine": list(item.gained),
                    "relative_std": dict(item.std),
                }
                for item in self.recommendations
            ],
            "advice": list(self.advice),
            "notes": list(self.notes),
            **self.expected.to_json(),
            **({"study": [one.to_json() for one in self.study]} if self.study else {}),
            **({} if self.plan is None else {"plan": self.plan.to_json()}),
        }
        return as_json(found)


@with_blas_limit
def identify(
    specimens: Specimen | Sequence[Specimen],
    noise: float | None = None,
    progress: Progress | None = None,
    *,
    recommend: bool = True,
    study: int = 0,
    plan: int = 0,
) -> IdentifyResult:
    """Predict the joint standard deviations of all ten constants from sweeps of one or more specimens of a material.

    Also those of the free constants with the tolerances of the files, as an update would state them.

    The constants are those of the first specimen's file; constants that are zero there cannot be free. The prior of the
    ten constants is the weak one of `femu_piezo.inference.unknowns.material_prior` (real parts ±50 %, tangents 0.05).

    Parameters
    ----------
    noise : relative standard deviation of every point; the one that the files state where None, 0.001 where they
        state none, or several
    progress : called with the name of each step
    recommend : compute what further measurements would add, which takes longer than the rest
    study : specimens that are drawn and updated for each of several noises and numbers of points; 0 for none
    plan : points of a sweep of one specimen whose frequencies are to be chosen; 0 for none

    Raises
    ------
    InputError : a specimen cannot be computed, the noise is no relative standard deviation, or a study is too small
    """
    specimens = [specimens] if isinstance(specimens, Specimen) else list(specimens)
    refuse_nothing_free(specimens)
    noise = _stated_noise(specimens) if noise is None else noise
    if not 0 < noise < 1:
        raise InputError(f"noise {noise:g} is not a relative standard deviation; give one such as 0.001")
    if study and study < FEWEST_DRAWS:
        raise InputError(f"study = {study} gives no statistics; give {FEWEST_DRAWS} specimens or more, or 0 for none")
    progress = progress or (lambda step: None)
    given = [prepare(specimen, check=False) for specimen in specimens]
    problems = [_lossy(problem) for problem in given]
    first = problems[0]
    sweeps = [sweep_frequencies(problem) for problem in problems]
    bands = [(float(sweep[0]), float(sweep[-1])) for sweep in sweeps]
    subjects = planned(problems, bands)
    blocks, pictures, evaluations = [], [], []
    for problem, frequency in zip(problems, sweeps, strict=True):
        progress(problem.specimen.name)
        own = [one for one in subjects if one.problem is problem]
        served = {effect.key: effect for one in own for effect in effects_served(one, tolerances_of(subjects))}
        model = problem.model(float(frequency[-1]), _ACCURACY)
        evaluation = _evaluation(model, first, frequency, tuple(served.values()))
        block, picture = _jacobian(evaluation, problem.specimen.name, first, noise)
        blocks += [block] * len(own)
        pictures.append(picture)
        evaluations += [evaluation] * len(own)
    expected = expect(subjects, evaluations, noise)
    where = None
    if plan:
        if len(problems) > 1:
            raise InputError(f"a plan takes one specimen, and {len(problems)} are given; give them one by one")
        progress("plan")
        alone = replace(first, specimen=first.specimen.model_copy(update={"sweep": None}))
        where = plan_sweep(*planned([alone], bands), evaluations[0], noise, plan)
    names, values, prior = _unknowns(first)
    blocks.append(prior)
    known = identifiability(np.concatenate(blocks), names, values)
    recommendations, notes = [], _assumed(given[0], first)
    for words, problem, frequency in _candidates(problems) if recommend else []:
        progress(words)
        model = _affordable_model(problem, float(frequency[-1]))
        if model is None:
            notes.append(f"{words} is not among the measurements compared: its model would take minutes and gigabytes")
            continue
        extra, _ = _jacobian(_evaluation(model, first, frequency), problem.specimen.name, first, noise)
        joint = identifiability(np.concatenate([*blocks, extra]), names, values)
        recommendations.append(_recommendation(words, known, joint))
    recommendations.sort(key=lambda item: (-len(item.gained), sum(np.log(list(item.std.values())))))
    names = tuple(problem.specimen.name for problem in problems)
    settings = noise_study(subjects, evaluations, noise, study, progress=progress) if study else ()
    return IdentifyResult(
        names=names,
        noise=noise,
        known=known,
        sensitivities=tuple(pictures),
        recommendations=tuple(recommendations),
        expected=expected,
        study=settings,
        plan=where,
        notes=tuple(notes),
    )


def _lossy(problem: Problem) -> Problem:
    """The problem with the usual loss tangent of free constants that have none; without losses all seem known too well.

    InputError where the constants are those of no stable, passive material.
    """
    free = problem.free(problem.constants)
    theta = np.where(free.start.imag == 0, free.start * (1 - 1j * TANGENT), free.start)
    constants = free.constants(theta)
    if constants.physical_faults():
        constants = problem.constants.check(f"{problem.specimen.path or problem.specimen.name}: material")
    return replace(problem, constants=constants)


def _assumed(given: Problem, used: Problem) -> list[str]:
    """A note on free constants whose loss the file does not state: what is taken for it."""
    free = given.free(given.constants)
    lossless = [name for name, value in zip(free.names, free.start, strict=True) if value.imag == 0]
    if not lossless:
        return []
    told, needed = f"the file states no loss tangent of {', '.join(lossless)}", f"give tan_{lossless[0]}"
    if used.constants.tangent(lossless[0]) == 0:
        return [
            f"{told}, and the usual {TANGENT:g} beside the constants that are lossless makes no passive material: none "
            f"is taken, and true deviations are larger; {needed} and the others"
        ]
    return [f"{told}: {TANGENT:g} is assumed, and the deviations depend on it; {needed} where it is known"]


def _stated_noise(specimens: Sequence[Specimen]) -> float:
    """The noise that the files state, where it is one value; else the default."""
    stated = {one.measurement.noise for one in specimens if one.measurement is not None} - {None}
    return stated.pop() if len(stated) == 1 else _NOISE


def _free(problem: Problem) -> FreeConstants:
    names = tuple(name for name in D_FORM if getattr(problem.constants, name) != 0)
    return FreeConstants.of(problem.constants, names)


def _unknowns(first: Problem) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Names and values (n_x,) of the unknowns, and the whitened Jacobian (n_x, n_x) of their weak prior."""
    unknowns, x = _material(first)
    return unknowns.names, x, np.diag(1 / unknowns.prior_std)


def _material(first: Problem) -> tuple[Unknowns, np.ndarray]:
    """All constants of the first specimen as unknowns, and their values (n_x,)."""
    return Unknowns.of_constants(_free(first))


def _evaluation(
    model: ElectroelasticModel, first: Problem, frequency: np.ndarray, effects: Sequence[Effect] = ()
) -> Evaluation:
    """A predicted sweep of the first specimen's material, by a reduced model that serves some effects as well."""
    free, top = _material(first)[0].material.free, float(frequency[-1])
    reduced = extend_model(model, free.training_sets(free.start, 0.05), effects, top, accuracy=1e-4)
    return Evaluation(reduced, 2 * np.pi * frequency)


def _affordable_model(problem: Problem, top: float) -> ElectroelasticModel | None:
    """The model of a body up to a frequency, Hz; None where it has more than `_MOST_UNKNOWNS`."""
    try:
        model = problem.model(top, _ACCURACY)
    except TooLargeError:
        return None
    return model if model.size <= _MOST_UNKNOWNS else None


def _jacobian(evaluation: Evaluation, name: str, first: Problem, noise: float) -> tuple[np.ndarray, Sensitivity]:
    """Whitened Jacobian of one predicted sweep in the unknowns of the first specimen's material."""
    unknowns, x = _material(first)
    z, slopes = evaluation.with_jacobian(unknowns, x)
    data = SweepData(evaluation.omega / (2 * np.pi), z, np.full(z.size, noise), noise_known=True)
    return data.whitened(z, slopes)[1], sensitivity_with_effects(name, evaluation, unknowns, x)


def _candidates(problems: list[Problem]) -> list[tuple[str, Problem, np.ndarray]]:
    """Further measurements to compare (words, body, Hz): a wider band, the other poling direction, a square plate."""
    found = []
    for problem in problems:
        top = 2 * sweep_frequencies(problem)[-1]
        words = f"the same {problem.specimen.name} up to {top / 1e3:.0f} kHz"
        found.append((words, problem, np.linspace(100.0, top, _POINTS)))
    first = problems[0]
    polings = {problem.plate.poling for problem in problems}
    extent = float(min(first.plate.length, 20e-3))
    others = []
    if "length" not in polings:
        others.append((f"a k33 bar {extent * 1e3:.0f} × {extent * 150:.1f} × {extent * 150:.1f} mm", "length", 0.15))
    if "thickness" not in polings:
        others.append((f"a k31 plate {extent * 1e3:.0f} × {extent * 200:.1f} × {extent * 50:.1f} mm", "thickness", 0.2))
    for words, poling, share in others:
        plate = Plate(extent, share * extent, (0.05 if poling == "thickness" else share) * extent, poling)
        found.append(_other(words, first, plate, 3.5))
    square = Plate(extent, extent, 0.05 * extent)
    found.append(
        _other(f"a square plate {extent * 1e3:.0f} × {extent * 1e3:.0f} × {extent * 50:.1f} mm", first, square, 3.5)
    )
    return found


def _other(words: str, first: Problem, plate: Plate, reach: float) -> tuple[str, Problem, np.ndarray]:
    problem = replace(first, plate=plate)
    top = reach * problem.expected_pole_Hz
    return f"{words} up to {top / 1e3:.0f} kHz", problem, np.linspace(100.0, top, _POINTS)


def _recommendation(words: str, before: Identifiability, after: Identifiability) -> Recommendation:
    real = [name for name in before.names if not name.startswith("tan_")]
    gained = tuple(name for name in real if before.verdict(name) == "not" and after.verdict(name) != "not")
    return Recommendation(words, gained, {name: float(after.std[after.names.index(name)]) for name in real})
