"""What an update of planned sweeps would state, and which tolerance to improve first.

Standard deviations of the free constants of the file count everything that an update counts: noise, readings,
dimensions, density, held constants, instrument. They are computed again with each tolerance halved, and removed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from femu_piezo.effects.effect import Effect, SweepConditions
from femu_piezo.inference.budget import estimates_of
from femu_piezo.inference.ensemble import together
from femu_piezo.inference.expectation import EXACT, expected_budget, expected_std
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.unknowns import Estimate, MaterialParameters, Unknowns
from femu_piezo.measurement.sweeps import SweepData
from femu_piezo.specimen.file import Measurement
from femu_piezo.study.effects import expected_context
from femu_piezo.study.measured import conditions_of, from_common_mean
from femu_piezo.study.problem import Problem
from femu_piezo.study.subjects import LEAST_ERROR, Subject, subject
from femu_piezo.study.unknowns import as_filed, unknowns_of


@dataclass(frozen=True)
class Improvement:
    """A tolerance, and what the deviations would be if it were smaller.

    Attributes
    ----------
    tolerance : its key in the specimen file ("std_length", "residue.resistance", "readings.std_d33"), or "noise"
    specimen : name of the specimen or fixture that has it, where there are several; "" where all share it
    today : standard deviation in `unit` of SI
    before, halved, exact : "s11", "tan_s11", … → standard deviation (SI) with the tolerance as today, halved, and zero;
        `exact` is empty for noise, without which there is no sweep
    """

    tolerance: str
    specimen: str
    today: float
    unit: str
    before: Mapping[str, float]
    halved: Mapping[str, float]
    exact: Mapping[str, float]

    def shrinks(self, label: str) -> float:
        """Share by which the deviation of "s11" or "tan_s11" falls if the tolerance is halved."""
        return 1 - self.halved[label] / self.before[label]

    def best(self, *, tangents: bool = False) -> tuple[str, float]:
        """The constant, or tangent, that gains most if the tolerance is halved, and the decrease of its deviation."""
        label = max((one for one in self.before if one.startswith("tan_") == tangents), key=self.shrinks)
        return label, self.shrinks(label)

    def to_json(self) -> dict:
        """An item of "improvements" in identifiability.json."""
        return {
            "tolerance": self.tolerance,
            "specimen": self.specimen,
            "unit": self.unit,
            "today": self.today,
            "halved": self.today / 2,
            "std": {
                label: {"today": std, "halved": self.halved[label], "exact": self.exact.get(label)}
                for label, std in self.before.items()
            },
        }


@dataclass(frozen=True)
class Expectation:
    """What an update would state.

    Attributes
    ----------
    parameters : free constant → value of the file with expected deviations and their budgets
    improvements : every tolerance, first the one whose halving shrinks the deviation of a constant most; the order for
        tangents, which depend on phase and noise, is another (`Improvement.best`)
    """

    parameters: dict[str, Estimate]
    improvements: tuple[Improvement, ...]

    def to_json(self) -> dict:
        """ "expected" and "improvements" of identifiability.json."""
        return {
            "expected": {name: one.to_json() for name, one in self.parameters.items()},
            "improvements": [one.to_json() for one in self.improvements],
        }


def planned(problems: Sequence[Problem], bands_Hz: Sequence[tuple[float, float]]) -> tuple[Subject, ...]:
    """What an update would know of each sweep before it is taken, those of one specimen one after another.

    Names of specimens are made different where two are alike.

    bands_Hz : lowest and highest frequency of the sweeps of each specimen
    """
    names = [problem.specimen.name for problem in problems]
    if len(set(names)) < len(names):
        names = [f"{name} ({number})" for number, name in enumerate(names, 1)]
    names = names if len(names) > 1 else [""]
    band = min(low for low, _ in bands_Hz), max(high for _, high in bands_Hz)
    each = [
        (*item, conditions)
        for item in zip(problems, names, bands_Hz, strict=True)
        for conditions in conditions_of(item[0].specimen)
    ]
    every = from_common_mean([conditions for *_, conditions in each])
    several = len({conditions.fixture for conditions in every}) > 1
    return tuple(
        _planned(problem, name, own, band, conditions, conditions.fixture if several else "")
        for (problem, name, own, _), conditions in zip(each, every, strict=True)
    )


def _planned(
    problem: Problem,
    name: str,
    band_Hz: tuple[float, float],
    of_all: tuple[float, float],
    conditions: SweepConditions,
    fixture: str,
) -> Subject:
    """band_Hz, of_all : lowest and highest frequency of its sweep, and of all sweeps"""
    specimen = problem.specimen
    measurement = specimen.measurement or Measurement()
    measured = replace(problem, specimen=specimen.model_copy(update={"measurement": measurement}))
    context = replace(expected_context(measured, np.array(band_Hz), conditions), band_Hz=of_all)
    return subject(name, problem, None, np.zeros(0), context, fixture=fixture)


def expect(subjects: Sequence[Subject], evaluations: Sequence[Evaluation], noise: float) -> Expectation:
    """Deviations of the free constants of the first specimen, and what every tolerance adds to them.

    Parameters
    ----------
    subjects : of `planned`
    evaluations : of each sweep, by a model that serves the tolerances of its specimen
        (`femu_piezo.study.unknowns.effects_served`)
    noise : relative standard deviation of every point
    """
    unknowns = unknowns_of(subjects, [one.model for one in evaluations])
    x = as_filed(subjects, unknowns)
    sweeps, readings = whitened_jacobian(unknowns, x, subjects, evaluations, noise)
    std = expected_std(np.concatenate([sweeps, readings]), unknowns.prior_std)
    labels = labels_of(unknowns.material)
    before = {label: float(std[column] * size) for label, (column, size) in labels.items()}

    def after(*, sweep: float = 1.0, read: np.ndarray | float = 1.0, prior: np.ndarray | float = 1.0) -> dict:
        """Deviations with the noise, the σ of the readings (m,) and of the priors (n_x,) multiplied by factors."""
        rows = np.concatenate([sweeps / sweep, (readings.T / read).T])
        smaller = expected_std(rows, unknowns.prior_std * prior)
        return {label: float(smaller[column] * size) for label, (column, size) in labels.items()}

    found = [Improvement("noise", "", noise, "1", before, after(sweep=_error(noise / 2) / _error(noise)), {})]
    for number, one in enumerate(unknowns.readings):
        halved, exact = (after(read=_times(len(unknowns.readings), [number], share)) for share in (0.5, EXACT))
        key, today = f"readings.std_{one.name}", one.std / abs(one.value)
        found.append(Improvement(key, one.specimen, today, "1", before, halved, exact))
    for (name, owner), columns in _columns(unknowns, subjects).items():
        halved, exact = (after(prior=_times(unknowns.count, columns, share)) for share in (0.5, EXACT))
        one = next((item for item in subjects if item.name == owner), subjects[0])
        key, today, unit = _in_file(name, one)
        found.append(Improvement(key, owner, today, unit, before, halved, exact))
    parameters = estimates_of(unknowns.material, x, std, expected_budget(sweeps, readings, unknowns))
    return Expectation(parameters, tuple(sorted(found, key=lambda one: -one.best()[1])))


def _times(count: int, places: list[int], share: float) -> np.ndarray:
    """(count,) ones, and a share at some places."""
    factors = np.ones(count)
    factors[places] = share
    return factors


def whitened_jacobian(
    unknowns: Unknowns, x: np.ndarray, subjects: Sequence[Subject], evaluations: Sequence[Evaluation], noise: float
) -> tuple[np.ndarray, np.ndarray]:
    """Whitened Jacobians of all sweeps, (2k, n_x), and of all readings, (m, n_x)."""
    response = together([(one.share, evaluation) for one, evaluation in zip(subjects, evaluations, strict=True)])
    z, slopes = response.with_jacobian(unknowns, x)
    data = SweepData(response.omega / (2 * np.pi), z, np.full(z.size, _error(noise)), noise_known=True)
    readings = [reading.row(unknowns, x)[1] for reading in unknowns.readings]
    return data.whitened(z, slopes)[1], np.reshape(readings, (-1, x.size))


def _error(noise: float) -> float:
    """Relative error of a point: of the noise, and of the model."""
    return float(np.hypot(noise, LEAST_ERROR))


def labels_of(material: MaterialParameters) -> dict[str, tuple[int, float]]:
    """ "s11", "tan_s11", … → its column in x, and the SI value of one unit there."""
    named = zip(material.names, np.abs(material.units), strict=True)
    return {name: (column, float(size)) for column, (name, size) in enumerate(named)}


def _columns(unknowns: Unknowns, subjects: Sequence[Subject]) -> dict[tuple[str, str], list[int]]:
    """(name in `EffectContext.tolerances`, specimen) → numbers of the unknowns with this tolerance."""
    found: dict[tuple[str, str], list[int]] = {}
    known = {name for one in subjects for name, std in one.context.tolerances.items() if std > 0}
    for number, effect in enumerate(unknowns.effects):
        for column, parameter in enumerate(effect.parameters, unknowns.columns(number).start):
            name = _tolerance_of(effect, parameter.name)
            # coefficients of temperature have the names of constants, and no key of the file
            if name in known and parameter.tolerance > 0 and not (effect.freed or effect.of_conditions):
                found.setdefault((name, effect.owner), []).append(column)
    return found


def _tolerance_of(effect: Effect, parameter: str) -> str:
    """The name in `EffectContext.tolerances` of the tolerance of a parameter."""
    if effect.name == "instrument":
        return "accuracy" if parameter.startswith("magnitude") else "phase_accuracy"
    return effect.name.removeprefix("wrong_") if parameter == "relative_error" and not effect.variant else parameter


def _in_file(name: str, one: Subject) -> tuple[str, float, str]:
    """Key, value and unit of a tolerance as the specimen file has them."""
    today, geometry = one.context.tolerances[name], one.problem.specimen.geometry
    if name in (*one.context.axes, *one.context.reshapings):
        return f"std_{name}", today * getattr(geometry, name), "m"
    if name == "density":
        weighed = geometry.mass is not None
        return ("std_mass", today * geometry.mass, "kg") if weighed else ("std_density", today, "1")
    if name in ("accuracy", "phase_accuracy"):
        return name, today, "rad" if name == "phase_accuracy" else "1"
    units = {"resistance": "ohm", "inductance": "H", "capacitance": "F"}
    return (f"residue.{name}", today, units[name]) if name in units else (f"std_{name}", today, "1")
