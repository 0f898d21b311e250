"""Model order by evidence: which modes and how much background a sweep supports."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice

import numpy as np

from femu_piezo.extraction.covariance import fisher_spread
from femu_piezo.extraction.fit import Fit, NormalisedSweep, penalty, refit
from femu_piezo.extraction.model import RationalModel
from femu_piezo.extraction.vector_fitting import DEGREE, relocated_poles
from femu_piezo.measurement.spectrum import evenly

MAX_BACKGROUND = 12
MAX_LOSS = 0.3  # beyond η = 0.3 a term is background, not a resonance
KEEP_SIGMA = 10.0  # a mode whose residue is beyond so many standard deviations needs no removal test
MAX_PHASE = np.pi / 4  # of a passive residue: the loss angles of a material turn it by far less
CROWDS = (12, 24, 48)  # numbers of poles from which the search of a crowded sweep starts
PLACES = 3  # places for one more pole that are tried, until the model is passive
SCAN_FREQUENCIES = 160
SCAN_WIDTHS = 8
SCAN_STEP = 0.25  # largest distance between trial poles of one half-width, in half-widths
BEYOND, BEYOND_LOSS = np.geomspace(0.03, 4, 24), 0.02  # trial poles above the sweep: x − 1, and Im x over x + 1
STANDS_OUT = 10.0  # standard deviations by which the loss falls on both sides of a maximum that starts as a mode
_FOLLOWED = 1e-12  # share of an atom's square below which its part outside the model is rounding
MAX_SCAN_POINTS, MANY_POINTS = 2000, 1601  # most points that one scan, and that the first search of a sweep, use


@dataclass(frozen=True)
class Candidate:
    """One model order that was tried.

    Attributes
    ----------
    modes : number of poles M
    background_degree : degree d of the background polynomial
    misfit : Σ|residual|² at the end of the fit, which is given up early if it will not have the most evidence
    evidence : Bayesian information criterion (`Fit.evidence`) at the end of the fit, smaller is better
    poles : (M,) complex λ, rad²/s²
    """

    modes: int
    background_degree: int
    misfit: float
    evidence: float
    poles: np.ndarray


def _least(model: RationalModel, best: Fit) -> float:
    """Σ|residual|² above which a fit of `model` has less evidence than `best`; −∞ where every fit of it has less."""
    data, n = best.data, len(best.data)
    worth = (penalty(2 * best.model.size, n) - penalty(2 * model.size, n)) / (2 * n)
    found = max(best.misfit, data.negligible) * float(np.exp(worth))
    return found if found > data.negligible else -np.inf


def is_passive(model: RationalModel) -> bool:
    """No pole inside the sweep draws power the wrong way (`_active`)."""
    return not np.any(_active(model))


def _active(model: RationalModel) -> np.ndarray:
    """(M,) bool: poles inside the sweep with |arg| of the residue above `MAX_PHASE`.

    The residue of Y/(jω) in λ is a positive number turned by the loss angles of the material; a pole that only
    soaks up an error of the instrument has any phase. Broad terms (η > MAX_LOSS) are background and free.
    """
    return resonant(model) & (np.abs(np.angle(model.residues)) > MAX_PHASE)


def resonant(model: RationalModel) -> np.ndarray:
    """(M,) bool: poles in the sweep that are no broader than a resonance; the others are background."""
    value = model.axis.eigenvalue(model.poles)
    return (np.abs(model.poles.real) <= 1) & (value.imag > 0) & (value.imag < MAX_LOSS * value.real)


@dataclass(frozen=True)
class Search:
    """The result of a search.

    Attributes
    ----------
    best : the fit of most evidence;  tried : every order
    intermediate_fits : the successive fits of most evidence that led to `best`, among them those of fewer modes
    """

    best: Fit
    tried: tuple[Candidate, ...]
    intermediate_fits: tuple[Fit, ...]


def search(data: NormalisedSweep, max_modes: int, start: RationalModel | None = None) -> Search:
    """Grow modes and background while the evidence grows, then try to remove each mode and degree again.

    The search begins with the modes that stand out, or with those of `start`. At each step the moves "one more
    mode, where a scan of the residual finds most to explain" and "one, two or three more background degrees"
    compete by their evidence; models that are not passive are not considered. Where none gains and neighbouring
    residuals are correlated, single modes are split into two. Where residuals stay correlated and no `start` is given,
    modes may overlap too closely to be found one by one: fits that start from many poles at once (`relocated_poles`)
    then compete as well, with ever more poles as long as half of them become modes. Where residuals stay correlated
    although there are many modes, the search may have missed the best fit: the modes of a search on half of the points,
    which takes another way, then compete too. A sweep of more than `MANY_POINTS` is first searched on some of them.
    """
    tried: list[Candidate] = []
    way: list[Fit] = []
    if start is None and len(data) > MANY_POINTS:
        few = search(data.thinned(MANY_POINTS), max_modes)
        start, tried = few.best.model, list(few.tried)
        way = [refit(one.model, data) for one in few.intermediate_fits]
    first = _standing_out(data, max_modes) if start is None else start
    best = _grown(_record(_passive(refit(first, data), max_modes), tried), max_modes, tried, way)
    for count in CROWDS if start is None else ():
        if not best.is_correlated or 2 * count + DEGREE + 1 >= len(data) or count > 2 * max_modes:
            break
        crowd = _crowd(data, count, max_modes)
        if crowd is not None:
            rival = _grown(_prune(_record(crowd, tried), tried), max_modes, tried, way)
            best = min(best, rival, key=_evidence)
            if rival.model.poles.size < count / 2:  # most of the poles became no modes, and more poles would not either
                break
    if start is None and best.is_correlated and min(CROWDS) <= best.model.poles.size < len(data) / 8:
        other = _passive(refit(search(data.thinned(len(data) // 2), max_modes).best.model, data), max_modes)
        rival = _grown(_prune(_record(other, tried), tried), max_modes, tried, way)
        best = min(best, rival, key=_evidence)
    return Search(best, tuple(tried), (*way, best))


def _standing_out(data: NormalisedSweep, max_modes: int) -> RationalModel:
    """Start of a search: a mode at each of the highest maxima of the loss |Im Y/(jω)|; residues and background are 0.

    A maximum counts where the loss falls on both sides by `STANDS_OUT` standard deviations of its noise, estimated from
    second differences of neighbours. The half-width of a mode is that of its maximum at half the height.
    """
    loss, size = np.abs(data.charge.imag), np.abs(data.charge)
    noise = size * float(np.median(np.abs(np.diff(data.charge, 2)) / size[1:-1])) / np.sqrt(6)
    turns = _turns(loss, STANDS_OUT * noise)
    found = []
    for left, peak, right in zip(turns[:-2:2], turns[1:-1:2], turns[2::2], strict=True):
        base = max(loss[left], loss[right])
        above = data.x[left : right + 1][loss[left : right + 1] > (loss[peak] + base) / 2]
        found.append((loss[peak] - base, data.x[peak] + 0.5j * (above[-1] - above[0] + data.x[1] - data.x[0])))
    most = min(max_modes, (len(data) - 4) // 4)
    poles = np.array([pole for _, pole in sorted(found, key=lambda one: -one[0])[:most]], complex)
    return RationalModel(data.axis, data.scale, poles, np.zeros_like(poles), np.zeros(2, complex))


def _turns(values: np.ndarray, least: np.ndarray) -> list[int]:
    """Indices of a minimum, a maximum, a minimum … of values (n,), each more than `least` (n,) from the next."""
    turns, sign = [0], -1
    heights, apart = values.tolist(), least.tolist()
    for place, value in enumerate(heights):
        beyond = sign * (value - heights[turns[-1]])
        if beyond > 0:
            turns[-1] = place
        elif -beyond > apart[turns[-1]]:
            turns.append(place)
            sign = -sign
    return turns


def _passive(best: Fit, max_modes: int) -> Fit:
    """The fit without active modes (`_active`) and those beyond `max_modes`, removed one by one, the weakest first."""
    while np.any(active := _active(best.model)) or best.model.poles.size > max_modes:
        strength = np.where(active | ~np.any(active), _significance(best), np.inf)
        best = refit(without(best.model, int(np.argmin(strength))), best.data)
    return best


def _grown(best: Fit, max_modes: int, tried: list[Candidate], way: list[Fit]) -> Fit:
    """The fit with modes and degrees added while that raises its evidence, then pruned (`_prune`)."""
    while True:
        way.append(best)
        moves = [_record(f, tried) for f in _moves(best, max_modes)]
        top = min(moves, key=_evidence, default=best)
        if top.evidence >= best.evidence and best.is_correlated:
            top = min(_splits(best, max_modes, tried), key=_evidence, default=best)
        if top.evidence >= best.evidence:
            return _prune(best, tried)
        best = top


def _crowd(data: NormalisedSweep, count: int, max_modes: int) -> Fit | None:
    """A passive fit of at most `max_modes` that starts from `count` poles at once; None where no mode remains."""
    poles = relocated_poles(data, count)
    model = RationalModel(data.axis, data.scale, poles, np.zeros(count, complex), np.zeros(DEGREE + 1, complex))
    keep = resonant(model)
    best = _roughly(replace(model, poles=poles[keep], residues=model.residues[keep]), data)
    while best.model.poles.size:
        strength, active = _significance(best), _active(best.model) | ~resonant(best.model)
        surplus = best.model.poles.size > max_modes
        if not surplus and not np.any(active):
            return best
        weakest = int(np.argmin(np.where(active | surplus, strength, np.inf)))
        best = _roughly(without(best.model, weakest), data)
    return None


def _roughly(model: RationalModel, data: NormalisedSweep) -> Fit:
    """A fit of few steps, good enough to decide which mode is removed next."""
    return refit(model, data, tolerance=1e-2, max_steps=6)


def _evidence(one: Fit) -> float:
    """Key by which the best fit is chosen; less is better."""
    return one.evidence


def _with_pole(model: RationalModel, pole: complex) -> RationalModel:
    return replace(model, poles=np.append(model.poles, pole), residues=np.append(model.residues, 0j))


def without(model: RationalModel, mode: int) -> RationalModel:
    """The model without one of its modes."""
    return replace(model, poles=np.delete(model.poles, mode), residues=np.delete(model.residues, mode))


def widen(model: RationalModel, extra: int) -> RationalModel:
    """The same model with `extra` more background degrees, at zero."""
    return replace(model, background=np.concatenate([model.background, np.zeros(extra, complex)]))


def _moves(current: Fit, max_modes: int) -> list[Fit]:
    model, n = current.model, len(current.data)
    out: list[Fit] = []
    if model.poles.size < max_modes and model.size + 2 < n and current.is_visible:
        grown = (_rival(_with_pole(model, z), current) for z in _likely_poles(current))
        out += islice((f for f in grown if is_passive(f.model)), 1)
    for extra in (1, 2, 3):
        if model.background.size - 1 + extra <= MAX_BACKGROUND and model.size + extra < n:
            best = min((current, *out), key=_evidence)
            out.append(_rival(widen(model, extra), best))
    return [f for f in out if is_passive(f.model)]


def _rival(model: RationalModel, best: Fit) -> Fit:
    """The fit of a model, given up where it will not have more evidence than the best one."""
    return refit(model, best.data, least=_least(model, best))


def _splits(current: Fit, max_modes: int, tried: list[Candidate]) -> list[Fit]:
    """Passive fits with one mode split into two, for the `PLACES` modes where the linearised misfit drops most.

    Two modes at z ± δ of half the residue are r/(z − x) + r δ²/(z − x)³ + …, so the term of third power determines δ.
    A scan for one more pole does not find such pairs, since it keeps the first pole where it is.
    """
    model, data = current.model, current.data
    if model.poles.size >= max_modes or model.size + 2 >= len(data):
        return []
    row, r = data.weight / data.charge, current.residual
    basis, _ = np.linalg.qr(row[:, None] * model.jacobian(data.x))
    atoms = row[:, None] / (model.poles - data.x[:, None]) ** 3
    atoms = atoms - basis @ (basis.conj().T @ atoms)
    along, size = atoms.conj().T @ r, np.sum(np.abs(atoms) ** 2, axis=0)
    apart = np.sqrt(-along / size / model.residues)
    found: list[Fit] = []
    for mode in np.argsort(-(np.abs(along) ** 2) / size)[:PLACES]:
        pole, others = model.poles[mode], without(model, int(mode))
        split = _with_pole(_with_pole(others, pole + apart[mode]), pole - apart[mode])
        best = min((current, *found), key=_evidence)
        found.append(_record(_rival(split, best), tried))
    return [f for f in found if is_passive(f.model)]


def _prune(best: Fit, tried: list[Candidate]) -> Fit:
    while True:
        model = best.model
        fewer = [without(model, int(m)) for m in np.flatnonzero(_significance(best) < KEEP_SIGMA)]
        if model.background.size > 1:
            fewer.append(replace(model, background=model.background[:-1]))
        trials = [_record(_rival(m, best), tried) for m in fewer]
        trials = [f for f in trials if is_passive(f.model)]
        top = min(trials, key=_evidence, default=best)
        if top.evidence >= best.evidence:
            return best
        best = top


def _significance(result: Fit) -> np.ndarray:
    """(M,) |residue| in units of its standard deviation."""
    m = result.model.poles.size
    factor = fisher_spread(result.model, result.data, result.scale).factor
    return np.abs(result.model.residues) / np.linalg.norm(factor[m : 2 * m], axis=1)


def _likely_poles(current: Fit) -> list[complex]:
    """Up to `PLACES` places for one more pole, where the linearised misfit drops most first (a score scan).

    Every trial pole is an atom a = weight/(charge (z − x)). With Q the span of the Jacobian of the current model and a⊥
    the part of a outside it, the gain is |⟨a⊥, r⟩|²/‖a⊥‖² = |⟨a, r⟩|²/(‖a‖² − ‖Qᴴa‖²), as r ⊥ Q; it is 0 where a⊥ is
    rounding. Trial poles nearer to a place than its width are no further places.
    """
    model, data = current.model, current.data
    pick = evenly(len(data), MAX_SCAN_POINTS)
    x, row = data.x[pick], (data.weight / data.charge)[pick]
    basis, _ = np.linalg.qr(row[:, None] * model.jacobian(x))
    r = current.residual[pick]
    r = r - basis @ (basis.conj().T @ r)
    trials, atoms, power = _scan(np.ascontiguousarray(x).tobytes())
    whole = np.abs(row) ** 2 @ power
    left = row * np.column_stack([basis, r]).conj().T
    real, imaginary = (np.concatenate([left.real, left.imag]) @ atoms).reshape(2, len(left), 2, -1)
    squares = (real[:, 0] - imaginary[:, 1]) ** 2 + (real[:, 1] + imaginary[:, 0]) ** 2
    rest = whole - np.sum(squares[:-1], axis=0)
    gain = np.where(rest > _FOLLOWED * whole, squares[-1], 0.0) / np.maximum(rest, _FOLLOWED * whole)
    found: list[complex] = []
    while len(found) < PLACES and np.any(gain > 0):
        found.append(complex(trials[np.argmax(gain)]))
        gain = np.where(np.abs(trials - found[-1]) < 2 * np.maximum(trials.imag, found[-1].imag), 0.0, gain)
    return found


@lru_cache(maxsize=1)
def _scan(positions: bytes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Trial poles z (m,), and at x (n,) Re, then Im of 1/(z − x), (n, 2m), and its |·|² (n, m).

    Half-widths run from half the point spacing to a quarter of the sweep. Further trial poles lie above the sweep,
    where the next overtone is, since a pole that starts inside takes many steps to get there. Cached, since all scans
    of a sweep, and the sweeps of a lot, have the same x.
    """
    x = np.frombuffer(positions)
    spacing = float(np.median(np.diff(x)))
    parts = [1 + BEYOND + 1j * BEYOND_LOSS * (1 + BEYOND)]
    for width in np.geomspace(spacing / 2, 0.5, SCAN_WIDTHS):
        count = min(SCAN_FREQUENCIES, int(np.ceil(2 / (SCAN_STEP * width))))
        parts.append(np.interp(np.linspace(0, x.size - 1, count), np.arange(x.size), x) + 1j * width)
    trials = np.concatenate(parts)
    atoms = 1 / (trials - x[:, None])
    return trials, np.hstack([atoms.real, atoms.imag]), np.abs(atoms) ** 2


def _record(result: Fit, tried: list[Candidate]) -> Fit:
    model = result.model
    poles = result.data.axis.eigenvalue(model.poles)
    tried.append(Candidate(model.poles.size, model.background.size - 1, result.misfit, result.evidence, poles))
    return result
