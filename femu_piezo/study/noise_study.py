"""What updates of planned sweeps would return: bias, deviation and coverage against the noise and the number of points.

Specimens are drawn whose dimensions, density, held constants and instrument are off by their tolerances, swept with
noise, and updated with the values of the file; readings of other instruments are those of the drawn specimen. The study
tells whether the deviations that an update states hold, also for few points and much noise. The sweeps come from the
model of the update, so it says nothing of errors of the model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from femu_piezo.errors import ConvergenceError
from femu_piezo.inference.ensemble import together
from femu_piezo.inference.fit import fit
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.inference.walls import Walls
from femu_piezo.measurement.sweeps import SweepData
from femu_piezo.study.subjects import Subject
from femu_piezo.study.unknowns import as_filed, unknowns_of

#: Multiples of the noise of the plan, at its number of points; multiples of the number of points, at its noise.
_NOISES, _POINTS = (0.1, 1.0, 10.0), (0.25, 4.0)
#: Fewest draws of which a study tells bias and coverage.
FEWEST_DRAWS = 20
#: Fewest points of a sweep, and most draws until a specimen is passive and within bounds.
_FEWEST, _ATTEMPTS = 21, 100


@dataclass(frozen=True)
class Setting:
    """Updates with one noise and number of points.

    Attributes
    ----------
    noise : relative, of a point;  points : of all sweeps together
    labels : "s11", "tan_s11", … of the free constants;  values : (n,) their truth, SI
    error : (m, n) of the estimates less the truth, SI;  stated : (m, n) standard deviations that were stated
    lost : draws whose fit did not settle
    """

    noise: float
    points: int
    labels: tuple[str, ...]
    values: np.ndarray
    error: np.ndarray
    stated: np.ndarray
    lost: int

    @property
    def bias(self) -> np.ndarray:
        """(n,) mean error over the deviation of that mean: below 2 to 3 where there is none."""
        return self.error.mean(axis=0) / (self.deviation / np.sqrt(len(self.error)))

    @property
    def deviation(self) -> np.ndarray:
        """(n,) rms distance of the estimates from the truth, SI."""
        return np.sqrt(np.mean(self.error**2, axis=0))

    def inside(self, sigma: float) -> np.ndarray:
        """(n,) share of the estimates within so many stated deviations of the truth."""
        return np.mean(np.abs(self.error) < sigma * self.stated, axis=0)

    def to_json(self) -> dict:
        """An item of "study" in identifiability.json; NaN where no fit settled."""
        keys = ("bias_over_its_std", "deviation", "stated", "inside_1_sigma", "inside_2_sigma")
        columns = [np.full(len(self.labels), np.nan)] * len(keys)
        if len(self.error):
            columns = [self.bias, self.deviation, np.median(self.stated, axis=0), self.inside(1), self.inside(2)]
        return {
            "noise": self.noise,
            "points": self.points,
            "draws": len(self.error),
            "lost": self.lost,
            "constants": {
                label: {key: float(column[index]) for key, column in zip(keys, columns, strict=True)}
                for index, label in enumerate(self.labels)
            },
        }


def noise_study(
    subjects: Sequence[Subject],
    evaluations: Sequence[Evaluation],
    noise: float,
    draws: int,
    *,
    seed: int = 0,
    progress: Callable[[str], None] = lambda words: None,
) -> tuple[Setting, ...]:
    """Updates of `draws` specimens at the noise and points of a plan, at a tenth and ten times of the noise, and at a
    quarter and four times the points.

    Parameters
    ----------
    subjects, evaluations : as for `femu_piezo.study.expectation.expect`
    noise : relative, of the plan

    Raises
    ------
    ConvergenceError : no fit settles at the noise and points of the plan
    """
    unknowns = unknowns_of(subjects, [one.model for one in evaluations])
    start, count = as_filed(subjects, unknowns), unknowns.of_material
    scale = unknowns.material.units
    rng, found = np.random.default_rng(seed), []
    for share, times in [(1.0, one) for one in _NOISES] + [(one, 1.0) for one in _POINTS]:
        swept = [_resampled(evaluation, share) for evaluation in evaluations]
        response = together([(one.share, evaluation) for one, evaluation in zip(subjects, swept, strict=True)])
        sizes = tuple(one.omega.size for one in swept)
        errors, stated, lost = [], [], 0
        for number in range(draws):
            progress(f"noise {times * noise:.2g}, {sum(sizes)} points: {number} of {draws}")
            truth = _specimen(unknowns, start, rng)
            z = response.impedance(unknowns, truth)
            error = rng.standard_normal((2, z.size)) * times * noise / np.sqrt(2)
            data = SweepData(
                frequency=response.omega / (2 * np.pi),
                impedance=z * (1 + error[0] + 1j * error[1]),
                relative_noise=np.full(z.size, times * noise),
                noise_known=False,
                sizes=sizes,
            )
            try:
                one = fit(response, data, _with_readings_of(unknowns, truth, rng), [start])
            except ConvergenceError:
                lost += 1
                continue
            errors.append((one.x - truth)[:count] * scale)
            stated.append(one.std[:count] * np.abs(scale))
        kept = (np.reshape(errors, (-1, count)), np.reshape(stated, (-1, count)))
        found.append(Setting(times * noise, sum(sizes), unknowns.material.names, start[:count] * scale, *kept, lost))
    if not len(found[1].error):
        raise ConvergenceError(
            f"the study: none of {draws} updates at a noise of {noise:g} and {found[1].points} points settled; check "
            "the tolerances of the file, or free fewer constants"
        )
    return tuple(found)


def _resampled(evaluation: Evaluation, share: float) -> Evaluation:
    """The evaluation with a share of its points, over the same band and spaced alike."""
    if share == 1.0:
        return evaluation
    count = max(_FEWEST, round(share * evaluation.omega.size))
    places = np.linspace(0, evaluation.omega.size - 1, count)
    return Evaluation(evaluation.model, np.interp(places, np.arange(evaluation.omega.size), evaluation.omega))


def _specimen(unknowns: Unknowns, start: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(n_x,) a passive specimen with the constants of the file, everything else off by its tolerance."""
    count, (low, high) = unknowns.of_material, unknowns.bounds.T
    for _ in range(_ATTEMPTS):
        x = start + unknowns.prior_std * rng.standard_normal(start.size)
        x[:count] = start[:count]
        if np.all((x > low) & (x < high)) and _is_passive(unknowns, x):
            return x
    raise ConvergenceError(
        "no passive specimen was drawn within the tolerances of the held tangents; state both, as tan_ and std_tan_"
    )


def _with_readings_of(unknowns: Unknowns, truth: np.ndarray, rng: np.random.Generator) -> Unknowns:
    """The unknowns with readings of a specimen (n_x,), each off by a draw of its deviation."""
    errors = rng.standard_normal(len(unknowns.readings))
    read = zip(unknowns.readings, errors, strict=True)
    return replace(
        unknowns,
        readings=tuple(replace(one, value=one.value + (one.row(unknowns, truth)[0] + e) * one.std) for one, e in read),
    )


def _is_passive(unknowns: Unknowns, x: np.ndarray) -> bool:
    return not Walls(unknowns, x).touched
