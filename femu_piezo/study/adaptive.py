"""`measure`: a sweep whose next frequencies follow from the points that there are.

1. watch: equally spaced points over the whole band;
2. locate: divide the intervals over which the curve changes most, until poles and zeros can be extracted;
3. refine: update, and take the frequencies that tell most of the constants asked for (`femu_piezo.inference.design`,
   everything else marginalised); up to half of the points of a round go where the points depart from the model alone.

Far from its resonance a mode of coupling k² changes Z by k² f/(2 |f − f0|), whatever its Q: it is seen by its tail. In
the middle of a gap Δ between two points it moves both by k² f/Δ. What departs from its neighbours by more than
`DEPARTS` times the noise is looked at closely, so that no mode above k² = `DEPARTS` √1.5 σ Δ/f is missed.

Points come from a function of frequencies: an instrument (`femu_piezo.instruments`) or a model.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from femu_piezo.errors import ConvergenceError, InputError
from femu_piezo.inference.design import chosen, observed
from femu_piezo.inference.fit import Fit
from femu_piezo.measurement.segments import RESOLUTION
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.specimen.file import Specimen
from femu_piezo.study.beginning import begin
from femu_piezo.study.expectation import labels_of
from femu_piezo.study.measured import measure_each
from femu_piezo.study.model_cache import Bases, SharedBases
from femu_piezo.study.plan import FEWEST, SPREAD, candidate_frequencies, resonances_of
from femu_piezo.study.posterior import Posterior
from femu_piezo.study.problem import prepare
from femu_piezo.study.progress import Clock, Progress
from femu_piezo.study.simulate import sweep_frequencies
from femu_piezo.study.subjects import subjects
from femu_piezo.study.update import settled
from femu_piezo.threads import with_blas_limit

#: Points of a round, while resonances are located and afterwards.
_LOCATING, _REFINING = 8, 16
#: Multiple of its noise by which a point departs from its neighbours, both against the model, that is no chance:
#: exp(−16) for one point.
DEPARTS = 4.0
#: Largest share of a round that looks at departures, and how much sharper than those of the model a mode may be.
_CLOSER, _SHARPER = 0.5, 4.0
#: Share by which a round must shrink one of the deviations asked for, all else being as expected.
_WORTH = 0.01
#: Points of the curve that is shown.
_SHOWN = 1001

#: Frequencies (n,), Hz, rising → the sweep at these, or at a few more
Take = Callable[[np.ndarray], ImpedanceSpectrum]


@dataclass(frozen=True)
class Wish:
    """What a measurement is to reach.

    Attributes
    ----------
    points : most points, at least 32
    deviations : "s11", "tan_s11", … → standard deviation that is enough, relative of a constant, absolute of a tangent
    seconds : after which no further round begins; None for no limit
    band_Hz : lowest and highest frequency; that of [simulation] where None
    """

    points: int = 200
    deviations: Mapping[str, float] = field(default_factory=dict)
    seconds: float | None = None
    band_Hz: tuple[float, float] | None = None


@dataclass(frozen=True)
class State:
    """What the points so far say.

    Attributes
    ----------
    spectrum : all points so far
    step : "watch", "locate" or "refine"
    reason : why there is no update yet, "" where there is one
    deviations : label → standard deviation as in `Wish.deviations`, of all free constants and tangents
    curve : (m,) Hz and (m,) ohm of the updated model; None where there is none
    departures : frequencies about which the points depart from the model alone, Hz
    least_coupling : k_eff that a further mode would have to have to be sure to show
    """

    spectrum: ImpedanceSpectrum
    step: str
    reason: str = ""
    deviations: Mapping[str, float] = field(default_factory=dict)
    curve: tuple[np.ndarray, np.ndarray] | None = None
    departures: tuple[float, ...] = ()
    least_coupling: float | None = None


@dataclass(frozen=True)
class Adapted:
    """A measurement that has come to its end.

    Attributes
    ----------
    states : after every round
    ended : "deviations", "points", "time" or "tolerances" (more points would not bring the deviations asked for)
    """

    states: tuple[State, ...]
    ended: str

    @property
    def spectrum(self) -> ImpedanceSpectrum:
        """All points."""
        return self.states[-1].spectrum

    @property
    def sentence(self) -> str:
        """What ended it, and what would have been seen."""
        last, count = self.states[-1], len(self.spectrum)
        why = {
            "deviations": "the deviations asked for are reached",
            "points": "the points are spent",
            "time": "the time is over",
            "tolerances": "more points would not bring the deviations asked for: see the tolerances in budget.png",
        }
        seen = f"a further mode of k_eff above {100 * last.least_coupling:.2g} % would have shown"
        return f"{count} points: {why[self.ended]}; {seen}"

    def to_json(self) -> dict:
        """Contents of measure.json: how the deviations fell, and what ended it."""
        last = self.states[-1]
        return {
            "ended": self.ended,
            "points": len(last.spectrum),
            "rounds": [
                {"points": len(one.spectrum), "step": one.step, "reason": one.reason, "std": dict(one.deviations)}
                for one in self.states
            ],
            "departures_Hz": list(last.departures),
            "least_coupling": last.least_coupling,
        }


@with_blas_limit
def adapt(
    specimen: Specimen,
    take: Take,
    wish: Wish,
    begun: ImpedanceSpectrum | None = None,
    progress: Progress | None = None,
    shown: Callable[[State], None] | None = None,
    bases: Bases | None = None,
) -> Adapted:
    """Measure a specimen with frequencies that follow from the points before.

    Parameters
    ----------
    begun : points that there are already, of a measurement that was broken off
    shown : called after every round

    Raises
    ------
    InputError : a wish that cannot be, or points that do not hold a resonance with its zero when the budget is spent
    """
    band = band_of(specimen, wish)
    _check(specimen, wish, band)
    until = None if wish.seconds is None else time.monotonic() + wish.seconds
    planner = _Planner(specimen, wish, band, bases or SharedBases(), progress or (lambda step: None))
    states: list[State] = []
    spectrum = begun
    for frequency in planner.rounds(begun):
        spectrum = joined(spectrum, take(frequency)) if frequency.size else spectrum
        states.append(planner.look(spectrum))
        if shown is not None:
            shown(states[-1])
        if until is not None and time.monotonic() > until and planner.ended is None:
            planner.ended = "time"
    if states[-1].reason:
        raise InputError(f"{specimen.path or specimen.name}: {len(spectrum)} points: {states[-1].reason}")
    return Adapted(tuple(states), planner.ended or "points")


def next_frequencies(specimen: Specimen, spectrum: ImpedanceSpectrum, wish: Wish) -> np.ndarray:
    """Where to measure next (n,), Hz, after the points of a sweep, for an analyser without a connection.

    As many as `wish.points` leaves, a round at most; none where the deviations asked for are reached.
    """
    band = band_of(specimen, wish)
    _check(specimen, wish, band)
    planner = _Planner(specimen, wish, band, SharedBases(), lambda step: None)
    planner.look(spectrum)
    return planner.next()


def band_of(specimen: Specimen, wish: Wish) -> tuple[float, float]:
    """Lowest and highest frequency, Hz: as wished, else those of [simulation], within those of [limits]."""
    low, high = wish.band_Hz or sweep_frequencies(prepare(specimen, check=False))[[0, -1]]
    if specimen.limits.frequency is not None and wish.band_Hz is None:
        low, high = max(low, specimen.limits.frequency[0]), min(high, specimen.limits.frequency[1])
    return float(low), float(high)


def joined(one: ImpedanceSpectrum | None, other: ImpedanceSpectrum) -> ImpedanceSpectrum:
    """The points of two sweeps in order; the mean of those at one frequency."""
    if one is None:
        return other
    return merged(
        np.concatenate([one.frequency, other.frequency]), np.concatenate([one.impedance, other.impedance]), one.source
    )


def merged(frequency: np.ndarray, impedance: np.ndarray, source: str) -> ImpedanceSpectrum:
    """Points (n,), Hz and ohm, in any order as a sweep; the mean of those at one frequency."""
    own, place, times = np.unique(frequency, return_inverse=True, return_counts=True)
    total = np.zeros(own.size, dtype=complex)
    np.add.at(total, place, impedance)
    return ImpedanceSpectrum(own, total / times, source=source)


def watching(band_Hz: tuple[float, float], points: int) -> np.ndarray:
    """Equally spaced frequencies (n,), Hz, that watch the band in a measurement of so many points."""
    return np.linspace(*band_Hz, max(FEWEST, round(SPREAD * points)))


def _check(specimen: Specimen, wish: Wish, band: tuple[float, float]) -> None:
    where = specimen.path or specimen.name
    if wish.points < 2 * FEWEST:
        raise InputError(f"{wish.points} points do not show a resonance; give at least {2 * FEWEST}")
    if not band[0] < band[1]:
        raise InputError(f"{where}: {band[0]:g} to {band[1]:g} Hz is no band; give another, or change [limits]")
    free = specimen.material.free
    known = [*free, *(f"tan_{name}" for name in free)]
    for label, value in wish.deviations.items():
        if label not in known:
            raise InputError(f"a deviation of {label} is asked for, which is not free; known are {', '.join(known)}")
        if not 0 < value < 1:
            raise InputError(f"a deviation of {value:g} of {label} cannot be; give one such as 0.005")


class _Planner:
    """Where the next points go, after what those so far say."""

    def __init__(self, specimen: Specimen, wish: Wish, band: tuple[float, float], bases: Bases, progress: Progress):
        self._specimen, self._wish, self._band, self._bases, self._progress = specimen, wish, band, bases, progress
        self._spectrum: ImpedanceSpectrum | None = None
        self._readings = 0
        self._gap = float(np.diff(watching(band, wish.points)[:2])[0])
        self._next: Callable[[int], np.ndarray] = self._changing
        self.ended: str | None = None

    def rounds(self, begun: ImpedanceSpectrum | None) -> Iterator[np.ndarray]:
        """Frequencies of one round after another; the one before has been looked at when the next is asked for."""
        first = watching(self._band, self._wish.points)
        if begun is not None:
            near = np.min(np.abs(first[:, None] - begun.frequency), axis=1)
            first = first[near > 1e-3 * self._gap]
        self._readings = first.size + (0 if begun is None else len(begun))
        yield first
        while (wanted := self.next()).size:
            self._readings += wanted.size
            yield wanted

    def next(self) -> np.ndarray:
        """Frequencies (n,), Hz, after the points that were looked at last; none at the end."""
        left = self._wish.points - max(self._readings, len(self._spectrum))
        return self._next(left) if left > 0 and self.ended is None else np.zeros(0)

    def look(self, spectrum: ImpedanceSpectrum) -> State:
        """What the points say."""
        self._spectrum = spectrum
        try:
            posterior, found = _updated(self._specimen, spectrum, self._bases, self._progress)
        except (InputError, ConvergenceError) as error:
            self._next = self._changing
            watched = len(spectrum) <= watching(self._band, self._wish.points).size
            return State(spectrum, "watch" if watched else "locate", str(error))
        labels = labels_of(found.parameters.material)
        design = _Design(posterior, found, labels, self._gap / 2)
        self._next = lambda left: self._telling(design, left)
        deviations = design.relative(np.sqrt(np.diag(design.covariance)))
        missing = [name for name, goal in self._wish.deviations.items() if deviations[name] > goal]
        if self._wish.deviations and not missing:
            self.ended = "deviations"
        return State(
            spectrum,
            "refine",
            deviations=deviations,
            curve=design.curve(self._band),
            departures=design.departures(),
            least_coupling=design.least_coupling(),
        )

    def _changing(self, left: int) -> np.ndarray:
        """Within the intervals over which log(jωZ) changes most."""
        frequency = self._spectrum.frequency
        change = np.abs(_steps(np.log(self._spectrum.impedance * frequency)))
        return _between(frequency, change, min(_LOCATING, left))

    def _telling(self, design: _Design, left: int) -> np.ndarray:
        """Where the points depart from the model alone, and where the constants asked for gain most."""
        count = min(_REFINING, left)
        closer = design.closer(int(_CLOSER * count))
        goals = self._wish.deviations
        deviations = design.relative(np.sqrt(np.diag(design.covariance)))
        asked = [name for name, goal in goals.items() if deviations[name] > goal] or list(deviations)
        found, after = design.telling(self._band, asked, count - closer.size)
        gain = max(1 - design.relative(after)[name] / deviations[name] for name in asked)
        if goals and gain < _WORTH and not closer.size:
            self.ended = "tolerances"
            return np.zeros(0)
        return np.unique(np.concatenate([closer, found]))


class _Design:
    """An update, linearised about its solution.

    Attributes
    ----------
    covariance : (n_x, n_x) in units of the priors, of everything that the update counts
    """

    def __init__(self, posterior: Posterior, found: Fit, labels: Mapping[str, tuple[int, float]], reach: float):
        self._found, self._labels, self._reach = found, labels, reach
        self._evaluation, self._own, _ = posterior.whole_sweep(0, found)
        self._frequency = posterior.several[0].measured.fitted.frequency
        self._impedance = posterior.several[0].measured.fitted.impedance
        self._scale = found.parameters.prior_std
        self.covariance = found.covariance / np.outer(self._scale, self._scale)
        self._noise = found.data.relative_noise * min(1.0, found.level)  # a misfit is no noise
        self._resonances = resonances_of(self._evaluation, self._own, found.x)

    def relative(self, std: np.ndarray) -> dict[str, float]:
        """Deviations by label: of (n_x,) in units of the priors; relative of constants, absolute of tangents."""
        found = {}
        for label, (column, size) in self._labels.items():
            own = std[column] * self._scale[column] * size
            found[label] = float(own if label.startswith("tan_") else own / abs(self._value(label)))
        return found

    def _value(self, label: str) -> float:
        material = self._found.parameters.material
        return getattr(material.constants(self._found.x[: self._found.parameters.of_material]), label).real

    def curve(self, band: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
        """The model over the band and at every point: Hz (m,), ohm (m,)."""
        frequency = np.union1d(np.linspace(*band, _SHOWN), candidate_frequencies(self._resonances, *band))
        return frequency, self._at(frequency)[0]

    def _at(self, frequency: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return replace(self._evaluation, omega=2 * np.pi * frequency).with_jacobian(self._own, self._found.x)

    def telling(self, band: tuple[float, float], asked: list[str], count: int) -> tuple[np.ndarray, np.ndarray]:
        """`count` frequencies that tell most of what is asked for, and the deviations (n_x,) with them."""
        candidates = candidate_frequencies(self._resonances, *band)
        place = np.searchsorted(self._frequency, candidates).clip(1, self._frequency.size - 1)
        near = np.minimum(np.abs(candidates - self._frequency[place]), np.abs(candidates - self._frequency[place - 1]))
        candidates = candidates[near > RESOLUTION]
        z, slopes = self._at(candidates)
        white = slopes / z[:, None] * self._scale * (np.sqrt(2) / np.median(self._noise))
        rows = np.stack([white.real, white.imag], axis=1)
        wanted = np.array([self._labels[name][0] for name in asked])
        places = chosen(rows, self.covariance, wanted, count)
        after = observed(self.covariance, rows[places].reshape(-1, self._scale.size))
        return candidates[places], np.sqrt(np.diag(after))

    @cached_property
    def _left(self) -> np.ndarray:
        """(k,) log Z measured less that of the model."""
        return np.log(self._impedance / self._at(self._frequency)[0])

    @cached_property
    def _departing(self) -> np.ndarray:
        """(k,) bool: points that depart from those beside them, both against the model.

        From the nearest ones, which a mode between two points moves alone; and from those half a gap of the watching
        points away, since a mode that has been looked at closely is smooth from point to point.
        """
        return self._departing_from(0.0) | self._departing_from(self._reach)

    def _departing_from(self, reach: float) -> np.ndarray:
        """(k,) bool, the points to compare with being further than `reach` away, Hz."""
        f, left, noise = self._frequency, self._left, self._noise
        before = np.searchsorted(f, f - reach, side="left") - 1
        behind = np.searchsorted(f, f + reach, side="right")
        own = np.flatnonzero((before >= 0) & (behind < f.size))
        before, behind = before[own], behind[own]
        share = (f[own] - f[before]) / (f[behind] - f[before])
        apart = left[own] - (1 - share) * left[before] - share * left[behind]
        sigma = np.sqrt(noise[own] ** 2 + ((1 - share) * noise[before]) ** 2 + (share * noise[behind]) ** 2)
        times = np.abs(apart) / sigma
        usual = max(1.0, float(np.median(times)) / np.sqrt(np.log(2)))
        found = np.zeros(f.size, dtype=bool)
        found[own] = times > DEPARTS * usual
        return found

    def closer(self, count: int) -> np.ndarray:
        """At most `count` frequencies beside departing points, where what is left changes most, Hz."""
        alone = self._departing
        change = np.abs(np.diff(self._left)) * (alone[1:] | alone[:-1])
        change[change < DEPARTS * np.hypot(self._noise[1:], self._noise[:-1])] = 0.0
        sharpest = np.min(np.abs(self._resonances.imag / self._resonances.real)) / _SHARPER
        return _between(self._frequency, change, count, sharpest / 2 * self._frequency[1:])

    def departures(self) -> tuple[float, ...]:
        """The middle of every run of departing points, Hz."""
        places = np.flatnonzero(self._departing)
        runs = np.split(places, np.flatnonzero(np.diff(places) > 2) + 1) if places.size else []
        left = np.abs(self._left)
        return tuple(float(self._frequency[run[np.argmax(left[run])]]) for run in runs)

    def least_coupling(self) -> float:
        """k_eff of a mode in the widest gap, from half the lowest pole on, that moves its neighbours clearly."""
        lowest = np.sqrt(np.min(self._resonances.real)) / (2 * np.pi)
        above = self._frequency[1:] > lowest / 2
        gap = np.max((np.diff(self._frequency) / self._frequency[1:])[above])
        return float(np.sqrt(DEPARTS * np.sqrt(1.5) * np.median(self._noise) * gap))


def _updated(
    specimen: Specimen, spectrum: ImpedanceSpectrum, bases: Bases, progress: Progress
) -> tuple[Posterior, Fit]:
    measured = measure_each([specimen], [spectrum])
    posterior = Posterior(subjects(measured), Clock(progress), bases)
    return posterior, settled(posterior.base(begin(measured, bases).constants))


def _steps(logs: np.ndarray) -> np.ndarray:
    """Differences (n − 1,) of complex logarithms (n,), angles less than half a turn."""
    step = np.diff(logs)
    return step.real + 1j * np.angle(np.exp(1j * step.imag))


def _between(frequency: np.ndarray, change: np.ndarray, count: int, least: np.ndarray | float = 0.0) -> np.ndarray:
    """At most `count` points, equally spaced within intervals (n − 1,), so that the largest change of a part is small.

    least : width that no part falls below; intervals without any change get none
    """
    width, inside = np.diff(frequency), np.zeros(change.size, dtype=int)
    for _ in range(count):
        left = np.where(width / (inside + 2) >= least, change / (inside + 1), 0.0)
        best = int(np.argmax(left))
        if left[best] <= 0:
            break
        inside[best] += 1
    parts = [
        frequency[place] + width[place] * np.arange(1, inside[place] + 1) / (inside[place] + 1)
        for place in np.flatnonzero(inside)
    ]
    return np.concatenate(parts or [np.zeros(0)])
