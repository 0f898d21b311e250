"""`measure`: a sweep whose next frequencies follow from the points that there are.

1. watch: equally spaced points over the whole band;
2. locate: divide the intervals over which the curve changes most, until poles and zeros can be extracted;
3. refine: update, and take the frequencies that tell most of the constants asked for, or that tell the two best causes
   of what the model gets wrong apart (`femu_piezo.inference.design`, everything else marginalised); up to half of the
   points of a round go where points depart from the model unlike their neighbours (`femu_piezo.study.linearised`).

Points come from a function of frequencies: an instrument (`femu_piezo.instruments`) or a model.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from femu_piezo.diagnosis.rivals import Rivals, rivals
from femu_piezo.diagnosis.rules import Rules
from femu_piezo.errors import ConvergenceError, InputError
from femu_piezo.inference.fit import Fit
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.specimen.file import Simulation, Specimen
from femu_piezo.study.beginning import begin
from femu_piezo.study.comparing import compare_causes
from femu_piezo.study.identify import identify
from femu_piezo.study.linearised import Linearised, dividing_points
from femu_piezo.study.measured import measure_each
from femu_piezo.study.model_cache import Bases, SharedBases
from femu_piezo.study.plan import FEWEST, SPREAD
from femu_piezo.study.posterior import Posterior
from femu_piezo.study.problem import prepare, refuse_nothing_free
from femu_piezo.study.progress import Clock, Progress
from femu_piezo.study.simulate import sweep_frequencies
from femu_piezo.study.subjects import subjects
from femu_piezo.study.update import with_probable_discrepancy
from femu_piezo.threads import with_blas_limit
from femu_piezo.units import hertz

#: Points of a round, while resonances are located and afterwards.
_LOCATING, _REFINING = 8, 16
#: Largest share of the points of a round that go next to points that depart from the model.
_CLOSER = 0.5
#: Relative decrease that a round is to promise for one of the deviations asked for; with less the measurement ends.
_WORTH = 0.01

#: Frequencies (n,), Hz, rising → the sweep at these, or at a few more
Take = Callable[[np.ndarray], ImpedanceSpectrum]


@dataclass(frozen=True)
class Wish:
    """What a measurement is to reach.

    Attributes
    ----------
    points : most points, at least 32; those of a measurement that goes on count
    deviations : "s11", "tan_s11", … → standard deviation that is enough, relative of a constant, absolute of a tangent
    seconds : after which no further round begins; None for no limit
    band_Hz : lowest and highest frequency; that of [simulation] where None
    separate : tell the two best causes of a diagnosis apart before anything else; every round diagnoses
    """

    points: int = 200
    deviations: Mapping[str, float] = field(default_factory=dict)
    seconds: float | None = None
    band_Hz: tuple[float, float] | None = None
    separate: bool = False


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
    least_coupling : least k_eff of a further mode that is sure to show in the points
    rivals : the causes that are hardest to tell apart, where that was asked for and there are any
    """

    spectrum: ImpedanceSpectrum
    step: str
    reason: str = ""
    deviations: Mapping[str, float] = field(default_factory=dict)
    curve: tuple[np.ndarray, np.ndarray] | None = None
    departures: tuple[float, ...] = ()
    least_coupling: float | None = None
    rivals: Rivals | None = None


@dataclass(frozen=True)
class Adapted:
    """A finished measurement.

    Attributes
    ----------
    states : after every round
    ended : "deviations", "separated", "points", "time", "tolerances" (more points would not bring the deviations asked
        for) or "alike" (more points would not tell the causes apart)
    """

    states: tuple[State, ...]
    ended: str

    @property
    def spectrum(self) -> ImpedanceSpectrum:
        """All points."""
        return self.states[-1].spectrum

    @property
    def sentence(self) -> str:
        """What ended the measurement, and the least coupling of a further mode that would have shown.

        Where points depart from the model, the places where they do instead.
        """
        last, count = self.states[-1], len(self.spectrum)
        two = last.rivals
        first, second = (two.first, two.second) if two else ("", "")
        why = {
            "deviations": "the requested deviations are reached",
            "separated": f"{first} is distinguished from {second} and every other cause",
            "alike": f"more points would not distinguish {first} from {second}: see what the diagnosis recommends",
            "points": "the points are used up",
            "time": "the time is over",
            "tolerances": "more points would not reach the requested deviations: see the tolerances in budget.png",
        }
        if last.departures:
            places = ", ".join(hertz(frequency) for frequency in last.departures[:5])
            seen = f"the points depart from the model near {places} Hz: check that the piece is that of the file"
        else:
            seen = f"any further mode with k_eff above {100 * last.least_coupling:.2g} % would have been visible"
        return f"{count} points: {why[self.ended]}; {seen}"

    def to_json(self) -> dict:
        """Contents of measure.json: how the deviations fell, and what ended it."""
        last = self.states[-1]
        return {
            "ended": self.ended,
            "points": len(last.spectrum),
            "rounds": [
                {
                    "points": len(one.spectrum),
                    "step": one.step,
                    "reason": one.reason,
                    "std": dict(one.deviations),
                    **({} if one.rivals is None else {"rivals": one.rivals.to_json()}),
                }
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
    begun : points of a measurement that was broken off, to continue it
    shown : called after every round

    Raises
    ------
    InputError : an impossible wish, or points that do not hold a resonance with its zero when the budget is spent
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


def first_frequencies(specimen: Specimen, wish: Wish) -> np.ndarray:
    """Where to measure (n,), Hz, a specimen known by its file alone, for an analyser without a connection.

    As many as `wish.points` says, in the band of the wish (`femu_piezo.study.plan`).
    """
    band = band_of(specimen, wish)
    _check(specimen, wish, band)
    table = (specimen.simulation or Simulation()).model_copy(update={"start": band[0], "stop": band[1]})
    wanted = specimen.model_copy(update={"simulation": table})
    return identify(wanted, recommend=False, plan=wish.points).plan.frequency


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
    """The points of two sweeps in order of frequency; impedances at the same frequency are averaged."""
    if one is None:
        return other
    return merged(
        np.concatenate([one.frequency, other.frequency]), np.concatenate([one.impedance, other.impedance]), one.source
    )


def merged(frequency: np.ndarray, impedance: np.ndarray, source: str) -> ImpedanceSpectrum:
    """Points (n,), Hz and ohm, in any order as a sweep; impedances at the same frequency are averaged."""
    distinct, place, times = np.unique(frequency, return_inverse=True, return_counts=True)
    total = np.zeros(distinct.size, dtype=complex)
    np.add.at(total, place, impedance)
    return ImpedanceSpectrum(distinct, total / times, source=source)


def watching(band_Hz: tuple[float, float], points: int) -> np.ndarray:
    """Equally spaced frequencies (n,), Hz, that watch the band in a measurement of so many points."""
    return np.linspace(*band_Hz, max(FEWEST, round(SPREAD * points)))


def _check(specimen: Specimen, wish: Wish, band: tuple[float, float]) -> None:
    where = specimen.path or specimen.name
    if wish.points < 2 * FEWEST:
        raise InputError(f"{wish.points} points do not show a resonance; give at least {2 * FEWEST}")
    if not band[0] < band[1]:
        raise InputError(
            f"{where}: {band[0]:g} to {band[1]:g} Hz is no band of frequencies; give another, or change [limits]"
        )
    refuse_nothing_free([specimen])
    free = specimen.material.free
    known = [*free, *(f"tan_{name}" for name in free)]
    for label, value in wish.deviations.items():
        if label not in known:
            raise InputError(f"a deviation is requested of {label}, which is not free; give one of {', '.join(known)}")
        if not 0 < value < 1:
            raise InputError(f"the deviation {value:g} of {label} is not between 0 and 1; give one such as 0.005")


class _Planner:
    """Chooses the next frequencies by what the points so far say."""

    def __init__(self, specimen: Specimen, wish: Wish, band: tuple[float, float], bases: Bases, progress: Progress):
        self._specimen, self._wish, self._band, self._bases, self._progress = specimen, wish, band, bases, progress
        self._spectrum: ImpedanceSpectrum | None = None
        self._readings = 0
        self._gap = float(np.diff(watching(band, wish.points)[:2])[0])
        self._next: Callable[[int], np.ndarray] = self._changing
        self._looked = False  # whether a round was measured where the causes differ
        self.ended: str | None = None

    def rounds(self, begun: ImpedanceSpectrum | None) -> Iterator[np.ndarray]:
        """Frequencies of one round after another; `look` has to see the points of each before the next is asked for."""
        first = watching(self._band, self._wish.points)
        if begun is not None:
            near = np.min(np.abs(first[:, None] - begun.frequency), axis=1)
            farthest = np.argsort(-near, kind="stable")[: max(0, self._wish.points - len(begun))]
            first = first[np.sort(farthest[near[farthest] > 0.501 * self._gap])]
        self._readings = first.size + (0 if begun is None else len(begun))
        yield first
        while (wanted := self.next()).size:
            self._readings += wanted.size
            yield wanted

    def next(self) -> np.ndarray:
        """Frequencies (n,), Hz, after the points that were looked at last; none at the end."""
        remaining = self._wish.points - max(self._readings, len(self._spectrum))
        return self._next(remaining) if remaining > 0 and self.ended is None else np.zeros(0)

    def look(self, spectrum: ImpedanceSpectrum) -> State:
        """What the points say; also decides how the next frequencies are chosen, or that the measurement ends."""
        self._spectrum = spectrum
        try:
            posterior, found, two = self._fitted(spectrum)
        except (InputError, ConvergenceError) as error:
            self._next = self._changing
            watched = len(spectrum) <= watching(self._band, self._wish.points).size
            return State(spectrum, "watch" if watched else "locate", str(error))
        about = Linearised(posterior, found, self._gap / 2)
        deviations = about.relative(np.sqrt(np.diag(about.covariance)))
        missing = [name for name, goal in self._wish.deviations.items() if deviations[name] > goal]
        if two is not None and not (two.told_apart and self._looked):
            self._next = lambda remaining: self._separating(about, two, remaining)
        else:
            self._next = lambda remaining: self._telling(about, remaining)
            if self._wish.deviations and not missing:
                self.ended = "deviations"
            elif two is not None and not self._wish.deviations:
                self.ended = "separated"
        return State(
            spectrum,
            "refine",
            deviations=deviations,
            curve=about.curve(self._band),
            departures=about.departures(),
            least_coupling=about.least_coupling(),
            rivals=two,
        )

    def _fitted(self, spectrum: ImpedanceSpectrum) -> tuple[Posterior, Fit, Rivals | None]:
        """Posterior and fit of the points; where causes are to be told apart, the fit that has them, and rivals."""
        measured = measure_each([self._specimen], [spectrum])
        several, clock = subjects(measured), Clock(self._progress)
        if self._wish.separate:
            posterior, comparison = compare_causes(several, clock, self._bases, Rules())
            return posterior, comparison.final, rivals(comparison)
        posterior = Posterior(several, clock, self._bases)
        return posterior, with_probable_discrepancy(posterior.base(begin(measured, self._bases).constants)), None

    def _changing(self, remaining: int) -> np.ndarray:
        """Frequencies (n,), Hz, within the intervals over which log(jωZ) changes most."""
        frequency = self._spectrum.frequency
        change = np.abs(_steps(np.log(self._spectrum.impedance * frequency)))
        return dividing_points(frequency, change, min(_LOCATING, remaining))

    def _telling(self, about: Linearised, remaining: int) -> np.ndarray:
        """Frequencies next to points that depart from the model, and where the constants asked for gain most."""
        count = min(_REFINING, remaining)
        closer = about.next_to_departures(int(_CLOSER * count))
        goals = self._wish.deviations
        deviations = about.relative(np.sqrt(np.diag(about.covariance)))
        asked = [name for name, goal in goals.items() if deviations[name] > goal] or list(deviations)
        found, after = about.most_informative(self._band, asked, count - closer.size)
        gain = max(1 - about.relative(after)[name] / deviations[name] for name in asked)
        if goals and gain < _WORTH and not closer.size:
            self.ended = "tolerances"
            return np.zeros(0)
        return np.unique(np.concatenate([closer, found]))

    def _separating(self, about: Linearised, two: Rivals, remaining: int) -> np.ndarray:
        """Frequencies next to points that depart from the model, and where one cause misses what the other predicts.

        Such points are taken once even where the causes are told apart already, by points that were chosen otherwise.
        """
        count = min(_REFINING, remaining)
        closer = about.next_to_departures(int(_CLOSER * count))
        found, expected_odds = about.most_separating(self._band, two.fits, count - closer.size)
        if two.log_odds + expected_odds < two.enough and not closer.size:
            if self._wish.deviations:
                return self._telling(about, remaining)
            self.ended = "alike"
            return np.zeros(0)
        self._looked = True
        return np.unique(np.concatenate([closer, found]))


def _steps(logs: np.ndarray) -> np.ndarray:
    """Differences (n − 1,) of complex logarithms (n,), angles less than half a turn."""
    step = np.diff(logs)
    return step.real + 1j * np.angle(np.exp(1j * step.imag))
