"""Faults inside a sweep: jumps (range switch), spikes, lines of the mains, quantised readings, interpolated points.

Spikes and jumps are found by comparison with local rational fits over windows of several sizes, of which a majority
must agree, so that resonances are not taken for them. A resonance narrower than the steps of the sweep is one point off
its neighbours and looks like a spike.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from femu_piezo.measurement.data_fault import DataFault
from femu_piezo.measurement.local_fits import left_out, stepped
from femu_piezo.measurement.noise import noise_at_points
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.measurement.straight_lines import interpolated

#: Standard deviations beyond which a point or a step is a fault; rms residual, in standard deviations, below which a
#: fit describes its window.
_OFF, _DESCRIBED = 7.0, 1.6
#: Windows: number of points, degrees of numerator and denominator. A majority must agree, since a function with a
#: free pole can hide a spike in one of them. The short window serves lines of the mains.
_SPIKE_WINDOWS = ((13, (3, 2)), (17, (4, 3)), (11, (2, 1)), (13, (2, 2)), (17, (3, 2)))
_JUMP_WINDOWS = ((14, (2, 1)), (16, (3, 2)), (22, (4, 3)), (16, (2, 2)), (22, (3, 2)))
_MAINS_WINDOW = ((9, (2, 1)),)
_FEWEST = 24
#: Kinds of faults whose points can be left out.
MASKABLE = ("jump", "spike", "mains", "not_passive")
#: Most points of one spike, points that are tested by fits, and searches for spikes.
_WIDEST_SPIKE, _MOST_CANDIDATES, _ROUNDS = 3, 200, 6
#: Standard deviation of a prediction over that of the noise of its point, below which the prediction counts.
_CERTAIN = 2.0
#: Relative standard deviation that every reading has at least, added in squares to the estimated noise.
_FINEST = 2e-5
#: Range of |Z|, ohm, in which local faults are looked for.
_SANE = 1e-12, 1e18
#: Frequency up to which lines of the mains are looked for, and frequencies of the mains, Hz.
_MAINS_TO, _MAINS = 1100.0, (50.0, 60.0)
#: Decimal steps of readings over the power of ten of the largest, (18, 1); and most significant digits of readings
#: whose number of digits is fixed; readings that a step must fit before all are looked at.
_DECIMAL_STEPS = np.outer(10.0 ** -np.arange(6), (5, 2, 1)).reshape(-1, 1)
_DIGITS, _SOME = 5, 8
#: Sum of jumps, over the smallest of them, below which they cancel.
_CANCELS = 0.25
_REMEDY = "measure again, or set mask_faults = true in [measurement] of the specimen file (or --mask-faults)"


def local_faults(spectrum: ImpedanceSpectrum) -> list[DataFault]:
    """Jumps, spikes, mains lines, quantised readings and interpolated points of a spectrum, none of them fatal."""
    magnitude = np.abs(spectrum.impedance)
    if not _SANE[0] < magnitude.min() <= magnitude.max() < _SANE[1]:
        return []
    quantised, quantum = _quantised(spectrum)
    found = [quantised] if quantised else []
    if len(spectrum) < _FEWEST:
        return found
    straight = None if quantised else interpolated(spectrum)
    if straight:
        return [straight]  # kinks are no spikes
    sigma = noise_at_points(spectrum) / np.abs(spectrum.impedance)
    sigma = np.sqrt(sigma**2 + quantum**2 + _FINEST**2)
    spikes, distance = _spikes(spectrum.frequency, spectrum.impedance, sigma)
    kept = np.delete(np.arange(len(spectrum)), sorted(spikes))
    jumps = [(int(kept[after]), step) for after, step in _jumps(spectrum.select(kept), sigma[kept], distance)]
    for after, _ in jumps:  # fits across a jump make spikes of the points beside it
        spikes = {point: off for point, off in spikes.items() if not -2 <= point - after <= 3}
    return [*_jump_faults(spectrum, jumps), *_spike_faults(spectrum, spikes), *found]


def without_faults(spectrum: ImpedanceSpectrum, faults: list[DataFault]) -> np.ndarray:
    """(n,) bool: the points outside every fault of a `MASKABLE` kind; between jumps the longest stretch stays."""
    keep = np.ones(len(spectrum), dtype=bool)
    for fault in faults:
        if fault.kind in MASKABLE:
            keep[fault.indices] = False
    return keep


def _candidates(f: np.ndarray, z: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """(n,) distance in standard deviations of each point from the prediction by its four neighbours.

    The result is the largest distance within two points, and inf at the ends. Two predictions interpolate the
    neighbours, and the smaller distance counts: a cubic in log Z, for where Z is smooth, and a quadratic over a
    straight line in Z, for resonances, only where its noise is low (`_CERTAIN`). With t = f_i − f, w_i the weights of
    the third divided difference, A = Σ w z, B = Σ w t z and P = Π t, the latter is −P Σ w z/t + P A²/B at the point.
    """
    inner, size = slice(2, -2), np.abs(z)
    t = _neighbours(f) - f[inner, None]
    w = 1 / np.prod(np.where(np.eye(4, dtype=bool), 1.0, t[:, :, None] - t[:, None, :]), axis=2)
    product = np.prod(t, axis=1)
    cubic = -product[:, None] * w / t
    logs = np.log(size) + 1j * np.unwrap(np.angle(z))
    off_cubic = np.abs(logs[inner] - np.sum(cubic * _neighbours(logs), axis=1))
    distance = off_cubic / (sigma[inner] * np.sqrt(1 + np.sum(cubic**2, axis=1)))
    values = _neighbours(z)
    a, b = np.sum(w * values, axis=1), np.sum(w * t * values, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = (a / b)[:, None]
        slopes = cubic + product[:, None] * (2 * ratio * w - ratio**2 * w * t)
        spread = np.sum(np.abs(slopes * _neighbours(sigma * size)) ** 2, axis=1)
        off = np.abs(z[inner] - np.sum(cubic * values, axis=1) - product * a**2 / b)
    noise = (sigma * size)[inner] ** 2
    certain = spread < _CERTAIN**2 * noise
    distance[certain] = np.minimum(distance[certain], off[certain] / np.sqrt((noise + spread)[certain]))
    # neighbours that are off together may agree with each other
    distance = np.max(sliding_window_view(np.pad(distance, _WIDEST_SPIKE - 1), 2 * _WIDEST_SPIKE - 1), axis=1)
    return np.concatenate([[np.inf] * 2, distance, [np.inf] * 2])


def _neighbours(values: np.ndarray) -> np.ndarray:
    """(n − 4, 4) the two values before and the two after each of the values (n,), without the two at either end."""
    return sliding_window_view(values, 5)[:, [0, 1, 3, 4]]


def _jumps(spectrum: ImpedanceSpectrum, sigma: np.ndarray, distance: np.ndarray) -> list[tuple[int, complex]]:
    """(index of the last point before, log of the factor by which Z is larger after) of every jump.

    distance : (n,) as by `_candidates`
    """
    z, f, size = spectrum.impedance, spectrum.frequency, len(spectrum)
    near = np.minimum(distance[:-1], distance[1:])  # a jump moves the points on both of its sides off
    near[:5] = near[size - 6 :] = 0.0  # too few points on one side
    after = np.sort(np.argsort(near)[::-1][:_MOST_CANDIDATES])
    after = after[near[after] > 2.5]
    if not after.size or size < max(width for width, _ in _JUMP_WINDOWS):
        return []
    votes, steps = np.zeros((len(_JUMP_WINDOWS), after.size)), np.zeros((len(_JUMP_WINDOWS), after.size), complex)
    for row, shape in enumerate(_JUMP_WINDOWS):
        hopeful = np.flatnonzero(np.sum(votes > _OFF, axis=0) >= row - 2)
        guess = steps[0, hopeful] if row else None  # from the function of lowest degree, which cannot imitate a step
        steps[row, hopeful], off, rest = stepped(f, z, sigma, after[hopeful], shape, guess)
        votes[row, hopeful] = np.where(rest < _DESCRIBED, off, 0.0)
    order = np.argsort(votes, axis=0)
    score = np.take_along_axis(votes, order[2:3], axis=0)[0]  # three of five windows reach it
    steps = np.take_along_axis(steps, order[2:3], axis=0)[0]
    found: list[tuple[int, complex]] = []
    for best in np.argsort(score)[::-1]:
        if score[best] > _OFF and all(abs(after[best] - other) > 8 for other, _ in found):
            found.append((int(after[best]), complex(steps[best])))
    return sorted(found)


def _spikes(f: np.ndarray, z: np.ndarray, sigma: np.ndarray) -> tuple[dict[int, float], np.ndarray]:
    """Point → distance in standard deviations of every spike, searched again and again without those found before.

    Also `_candidates` of all other points.
    """
    found: dict[int, float] = {}
    index = np.arange(f.size)
    for number in range(_ROUNDS + 1):
        distance = _candidates(f[index], z[index], sigma[index])
        if number == _ROUNDS or index.size < _FEWEST:
            break
        fresh = _spikes_once(f[index], z[index], sigma[index], distance)
        if not fresh:
            break
        found |= {int(index[k]): off for k, off in fresh.items()}
        index = np.delete(index, sorted(fresh))
    return found, distance


def _spikes_once(f: np.ndarray, z: np.ndarray, sigma: np.ndarray, distance: np.ndarray) -> dict[int, float]:
    """The spikes among points whose `_candidates` are given."""
    first = np.sort(np.argsort(distance)[::-1][:_MOST_CANDIDATES])
    first = first[distance[first] > 3]
    found: dict[int, float] = {}
    mains = _is_mains(f)
    for shapes, chosen in ((_SPIKE_WINDOWS, first), (_MAINS_WINDOW, first[mains[first] & (first >= 2)])):
        count, cases = np.repeat(np.arange(1, _WIDEST_SPIKE + 1), chosen.size), np.tile(chosen, _WIDEST_SPIKE)
        inside, trusted = cases + count <= f.size, sigma
        if shapes is _MAINS_WINDOW:  # other lines in the window may be off as well and get no weight
            if np.sum(mains) > 0.4 * np.sum(f < _MAINS_TO):
                continue
            inside &= mains[np.minimum(cases + count, f.size) - 1]
            trusted = np.where(mains, 1e3, 1.0) * sigma
        count, cases = count[inside], cases[inside]
        off = _agreed(f, z, sigma, trusted, cases, count, shapes)
        at_end = (cases < 2) | (cases + count > f.size - 2)  # where the prediction is an extrapolation
        for at in np.flatnonzero(off > np.where(at_end, 2 * _OFF, _OFF)):
            points = range(int(cases[at]), int(cases[at] + count[at]))
            if not any(point in found for point in points):
                found |= dict.fromkeys(points, float(off[at]))
    return found


def _agreed(f, z, sigma, trusted, cases: np.ndarray, count: np.ndarray, shapes) -> np.ndarray:
    """(k,) distance, in standard deviations, that a majority of the windows reaches.

    Case i leaves out the points cases[i] … cases[i] + count[i] − 1.
    """
    votes, majority = np.zeros((len(shapes), cases.size)), len(shapes) // 2 + 1
    for row, shape in enumerate(shapes):
        hopeful = np.flatnonzero(np.sum(votes > _OFF, axis=0) >= row - (len(shapes) - majority))
        if hopeful.size:
            distance, rest = left_out(f, z, sigma, trusted, cases[hopeful], count[hopeful], shape)
            votes[row, hopeful] = np.where(rest < _DESCRIBED, distance, 0.0)
    return np.sort(votes, axis=0)[len(shapes) - majority]


def _is_mains(frequency: np.ndarray) -> np.ndarray:
    """Whether frequencies lie on a multiple of 50 or 60 Hz, to 1.5 Hz."""
    near = [np.abs(frequency - line * np.maximum(1, np.round(frequency / line))) < 1.5 for line in _MAINS]
    return np.any(near, axis=0) & (frequency < _MAINS_TO)


def _jump_faults(spectrum: ImpedanceSpectrum, jumps: list[tuple[int, complex]]) -> list[DataFault]:
    """One fault per stretch between jumps whose readings are off those of most points, with the points of the stretch.

    Stretches between which the jumps cancel are alike.
    """
    edges = [0, *(after + 1 for after, _ in jumps), len(spectrum)]
    steps = np.array([step for _, step in jumps], dtype=complex)
    offsets = np.append(0.0, np.cumsum(steps))  # log of the factor on each stretch
    alike = np.abs(offsets[:, None] - offsets) < _CANCELS * np.min(np.abs(steps), initial=np.inf)
    most = int(np.argmax(alike @ np.diff(edges)))
    right = alike[most]
    faults = []
    for number in np.flatnonzero(~right).tolist():
        side = np.arange(edges[number], edges[number + 1])
        neighbours = {number - 1: number - 1, number: number + 1}  # jump → the stretch beyond it
        ends = [jump for jump, beyond in neighbours.items() if 0 <= beyond < right.size]
        level = [jump for jump in ends if right[neighbours[jump]]] or ends  # those from or to right readings
        told = [f"by {_size(steps[jump])} {_between(spectrum, jumps[jump][0])}" for jump in level]
        if len(level) == 2 and right[number - 1]:
            told[1] = f"back {_between(spectrum, jumps[number][0])}"
        message = (
            f"the impedance jumps {' and '.join(told)}, as a change of the instrument's range does; fix the range and "
            f"{_REMEDY}, which leaves out {side.size} points, {spectrum.frequency[side[0]]:.6g} to "
            f"{spectrum.frequency[side[-1]]:.6g} Hz"
        )
        faults.append(DataFault("jump", message, side, fatal=False))
    return faults


def _size(step: complex) -> str:
    """The factor of a jump, of which `step` is the logarithm, in words."""
    return f"{np.expm1(step.real):+.2%} and {np.degrees(step.imag):+.2f}°"


def _between(spectrum: ImpedanceSpectrum, after: int) -> str:
    """Where a jump behind a point is, in words."""
    low, high = spectrum.frequency[[after, after + 1]]
    return f"between {low:.6g} and {high:.6g} Hz"


def _spike_faults(spectrum: ImpedanceSpectrum, spikes: dict[int, float]) -> list[DataFault]:
    points = np.array(sorted(spikes), dtype=int)
    mains = _is_mains(spectrum.frequency[points])
    faults = []
    for kind, chosen, what in (
        ("mains", points[mains], "interference at multiples of the mains frequency"),
        ("spike", points[~mains], "faulty readings, or a resonance narrower than the steps of the frequency"),
    ):
        if chosen.size:
            shown = ", ".join(f"{f:.6g}" for f in spectrum.frequency[chosen[:5]])
            worst = max(spikes[int(point)] for point in chosen)
            message = (
                f"{chosen.size} point{'s differ' if chosen.size > 1 else ' differs'} from the neighbours by up to "
                f"{worst:.0f} standard deviations, at {shown}{' …' if chosen.size > 5 else ''} Hz: {what}; {_REMEDY}"
            )
            faults.append(DataFault(kind, message, chosen, fatal=False))
    return faults


def _quantised(spectrum: ImpedanceSpectrum) -> tuple[DataFault | None, np.ndarray]:
    """The fault of readings in steps coarser than their noise; and (n,) the relative step of Z, 0 for fine readings."""
    z, y = spectrum.impedance, 1 / spectrum.impedance
    zero = np.zeros(z.size)
    columns = {
        "|Z|": (np.abs(z), 1 / np.abs(z)),
        "resistance": (z.real, 1 / np.abs(z)),
        "reactance": (z.imag, 1 / np.abs(z)),
        "phase": (np.angle(z, deg=True), np.full(z.size, np.pi / 180)),
        "phase in radian": (np.angle(z), np.ones(z.size)),
        "|Y|": (np.abs(y), 1 / np.abs(y)),
        "conductance": (y.real, 1 / np.abs(y)),
        "susceptance": (y.imag, 1 / np.abs(y)),
    }
    if z.size < _FEWEST:
        return None, zero
    worst, told = zero, None
    for name, (values, relative) in columns.items():
        step = _resolution(values)
        if step is not None and np.median(step * relative) > np.median(worst):
            worst, told = step * relative, (name, float(np.median(step)))
    if told is None:
        return None, zero
    noise = noise_at_points(spectrum) / np.abs(z)
    equal = _repeats(columns[told[0]][0])
    if np.median(worst) < 2 * np.median(noise) and equal < 0.2:
        return None, worst
    message = (
        f"the {told[0]} is recorded in steps of {told[1]:.3g}, coarser than its noise ({equal:.0%} of the "
        f"neighbours are equal), which is a relative error of {np.median(worst) / np.sqrt(12):.1e} of |Z|; export more "
        f"digits, or give noise = {np.median(worst) / np.sqrt(12):.1g} in [measurement]"
    )
    return DataFault("quantised", message, np.array([], dtype=int), fatal=False), worst


def _repeats(values: np.ndarray) -> float:
    """Share of neighbouring readings that are equal."""
    return float(np.mean(np.abs(np.diff(values)) <= 1e-12 * np.abs(values[1:])))


def _resolution(values: np.ndarray) -> np.ndarray | None:
    """(n,) step of the readings (n,), decimal and fixed or that of a fixed number of digits; None for fine readings."""
    largest = float(np.max(np.abs(values)))
    some = values[:_SOME]
    if largest == 0 or (np.unique(some).size < 3 and np.unique(values).size < 3):
        return None
    fixed = 10.0 ** np.floor(np.log10(largest)) * _DECIMAL_STEPS

    def steps(readings: np.ndarray) -> np.ndarray:
        """(s, n) every step that readings (n,) may have."""
        leading = 10.0 ** np.floor(np.log10(np.maximum(np.abs(readings), 1e-300)))
        return np.concatenate([fixed * np.ones(leading.size), leading * 10.0 ** -np.arange(_DIGITS)[:, None]])

    # one reading between the steps excludes them, and the first few nearly always hold one
    hopeful = _on_steps(some / steps(some))
    if not np.any(hopeful):
        return None
    return next((step for step in steps(values)[hopeful] if _on_steps(values / step)), None)


def _on_steps(counts: np.ndarray) -> np.ndarray:
    """(…) bool: whether all n readings, in units of a step (…, n), are whole numbers."""
    return np.all(np.abs(counts - np.round(counts)) < 1e-7 * np.maximum(1, np.abs(counts)), axis=-1)
