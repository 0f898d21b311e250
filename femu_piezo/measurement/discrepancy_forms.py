"""Forms that a misfit of no known cause may have: errors of log Z over frequency with normal coefficients.

Smooth, with complex Gaussian processes a and b over log f of one correlation length ℓ:

    a(f) + b(f) ∂log Z/∂log f,

an error of the impedance, and one of the frequency (Im: of the loss) of whatever resonates there. A share w of the
variance is due to b: a has the standard deviation σ √(1 − w), b has σ √w / g with g the rms of |∂log Z/∂log f| (up to Q
at a resonance, about 1 far from it). ℓ and w compete; w may be 0, 1 or, as neither is known to be the larger, ½. Each
process is the sum of its principal components (Karhunen-Loève).

Errors of every resonance, as of a body that is not uniform: with the resonances of the model

    C(ω) = Y/(jω) = Σ_k r_k/(λ_k − ω²) + the rest,    ΔC = Σ_k −r_k λ_k ε_k/(λ_k − ω²)² + κ √(r_k r_1) η_k/(λ_k − ω²),

ε_k and η_k complex, of the same standard deviation: modes that mix change their strengths r_k = a_k² by 2 a_k Δa_k,
with Δa_k of the same size for all, in proportion to the amplitude a_1 of the strongest. Ratios κ and shares of the
losses in both errors compete.

A further resonance λ ("of its own"), in a fixture or a loose part, of complex strength c: ΔC = c/(λ − ω²) where it is
in parallel with the piece, Δlog f = c/(λ − ω²) where it moves with it. Places λ over the sweep and quality factors
compete; a second column c' λ/(λ − ω²)², the slope in λ, serves the frequencies between the places.

A step, where an instrument changes its range or a contact moves: from a frequency f_0 of the sweep on log Z is off by a
complex c, or log f is. Places f_0 compete.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import product
from typing import Literal

import numpy as np

from femu_piezo.measurement.rational_curve import rational_curve
from femu_piezo.measurement.sweeps import SweepData, stacked
from femu_piezo.threads import Once, made_once

#: Correlation lengths, as shares of the sweep in log f, and shares of the variance that errors of frequency have.
LENGTHS, SHARES = (1 / 4, 1 / 12, 1 / 40), (0.0, 0.5, 1.0)
#: Ratios of errors of strength to errors of frequency, and of errors of loss to both.
STRENGTHS, LOSSES = (1.0, 10.0, 100.0), (0.1, 1.0)
#: Fewest resonances in a sweep of which each may have its own errors.
_FEWEST = 3
#: Quality factors of a further resonance, and the distance of its neighbouring places, in half widths.
QUALITIES, _APART = (10.0, 30.0, 100.0), 1.5
#: Places of a step in a sweep at most, and fewest points on either side.
_STEPS, _BESIDE = 64, 3
#: Number of curves whose smooth errors are kept.
_CURVES = 4
#: Most points of a sweep whose forms are kept: further resonances for the next sweep of the same frequencies, smooth
#: errors of a curve for the next fit.
_KEPT = 2000
#: Number of values kept for forms of the same rows: products of factors; ΦᵗΦ or its axes for each share w.
_PRODUCTS = 2 + len(SHARES)
#: Share of the largest variance below which a component is left out.
_NEGLIGIBLE = 1e-4
#: Share of C (median over the sweep) below which a pole of the rational function of a curve is due to rounding, and the
#: factor in f by which resonances may lie beyond the sweep.
_VISIBLE, _BEYOND = 1e-6, 1.5

Form = Literal["smooth", "of every resonance", "a resonance of its own", "a step"]
#: Prior probability of each form over that of a candidate cause. Errors of every resonance may stand for any cause that
#: acts on the body: a cause that explains as much is preferred by 100 to 1.
WEIGHTS: dict[Form, float] = {"smooth": 1.0, "of every resonance": 0.01, "a resonance of its own": 1.0, "a step": 1.0}
#: Correlation of a process at distances (…) in correlation lengths.
Kernel = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Sides:
    """The vectors V that the columns of forms are multiplied with.

    Attributes
    ----------
    share : (2k,) factor of a robust loss on the data, and so on the columns
    vectors : (2k, p) V, whitened, Re, then Im
    products : of rows and vectors, kept for the rows used last
    """

    data: SweepData
    share: np.ndarray
    vectors: np.ndarray
    products: Once = field(default_factory=lambda: Once(latest=1), init=False, repr=False, compare=False)

    @made_once
    def turned(self) -> np.ndarray | None:
        """(k, p) complex v with Φᵗ V = Re φᵗv, Φ the whitened errors φ; None where shares of Re and Im differ."""
        k = len(self.share) // 2
        if not np.array_equal(self.share[:k], self.share[k:]):
            return None
        return self.data.over_noise_transposed(self.share[:k, None] * (self.vectors[:k] - 1j * self.vectors[k:]))


@dataclass(frozen=True)
class Alternatives:
    """Errors of log Z of one form that compete, n of them, each the sum of m columns with complex normal coefficients.

    A column is the product of one of the s rows of an alternative and one of the t factors that act: m = t s.

    Attributes
    ----------
    rows : (n, s, k') over frequency, which do not depend on the model
    factors : (t', k') complex;  amounts : (t',) that multiply them; those with 0 do not act
    scale : (n,) that brings the error of each alternative to rms 1 of Re and Im over its sweep
    imaginary : deviation of the imaginary part of each coefficient over that of its real part
    points : (k',) indices of the points of the data where it is not zero: those of whole sweeps
    places : (n,) what tells the n apart: the correlation length as a share of the sweep in log f, the ratio κ, or the
        frequency in Hz
    pairs : (n, s, s, k') conj(row) row of every two rows, where they are kept: Re above and on the diagonal, Im below
    """

    form: Form
    rows: np.ndarray
    factors: np.ndarray
    scale: np.ndarray
    imaginary: float
    points: np.ndarray
    places: np.ndarray
    amounts: np.ndarray = field(default_factory=lambda: np.ones(1))
    pairs: np.ndarray | None = None
    _kept: Once = field(default_factory=lambda: Once(_PRODUCTS), repr=False, compare=False)

    def mixed(self, amounts: Sequence[float]) -> Alternatives:
        """These alternatives with other amounts (t',) of the factors; both share the kept products."""
        return replace(self, amounts=np.array(amounts))

    def one_by_one(self) -> Iterator[Alternatives]:
        """These alternatives with each factor alone, scaled to rms 1 of Re and Im over their sweep.

        All share the kept products.
        """
        squares = np.abs(self.rows) ** 2 if self.pairs is None else np.einsum("nssk->nsk", self.pairs)
        power = np.sum(squares @ np.abs(self.factors.T) ** 2, axis=1) / self.points.size  # (n, t')
        for amounts, own in zip(np.eye(len(self.factors)), power.T, strict=True):
            yield replace(self, amounts=amounts, scale=1 / np.sqrt(own))

    @made_once
    def _acting(self) -> np.ndarray:
        """Numbers (t,) of the factors that act."""
        return np.flatnonzero(self.amounts)

    @property
    def columns(self) -> np.ndarray:
        """(k', n, m) complex columns, not whitened."""
        factors = (self.amounts[:, None] * self.factors)[self._acting]
        every = self.rows[:, None] * factors[:, None] * self.scale[:, None, None, None]
        return every.reshape(len(self.rows), -1, self.points.size).transpose(2, 0, 1)

    def indices_in(self, data: SweepData) -> np.ndarray:
        """(2k',) indices of Re and Im at its points in a vector (2k,) of all data."""
        return np.concatenate([self.points, self.points + data.impedance.size])

    def chosen(self, which: int) -> Alternatives:
        """The alternative number `which` alone."""
        one = slice(which, which + 1)
        own = {"rows": self.rows[one].copy(), "scale": self.scale[one], "places": self.places[one], "pairs": None}
        return replace(self, **own, _kept=Once(_PRODUCTS))

    def whitened(self, data: SweepData) -> np.ndarray:
        """(2k', n, 2m) whitened columns, Re, then Im, of the real parts, then the imaginary parts, of coefficients."""
        white = self._white(data)
        return stacked(np.concatenate([white, 1j * self.imaginary * white], axis=2))

    def _white(self, data: SweepData) -> np.ndarray:
        """(k', n, m) complex whitened columns φ."""
        columns = self.columns
        whole = np.zeros((data.impedance.size, *columns.shape[1:]), dtype=complex)
        whole[self.points] = columns
        return data.over_noise(whole)[self.points]

    def products(self, sides: Sides) -> tuple[np.ndarray, np.ndarray]:
        """ΦᵗΦ (n, 2m, 2m) and Φᵗ V (n, 2m, p) of the whitened columns Φ times the share, and the vectors V.

        Where Re and Im have the same share, Φᵗ V follows from complex products of the rows with factors times v. ΦᵗΦ is
        the same for all fits of a sweep whose loss gives its points the same weights, and is kept for them.
        """
        if sides.turned is None:
            among = self.indices_in(sides.data)
            whole = self._whole(sides.data, sides.share[among])
            return whole @ whole.transpose(0, 2, 1), whole @ sides.vectors[among]
        key = ("squares", self.amounts.tobytes(), *self._key(sides))
        squares, along = self._kept.get(key, lambda: self._squares_of(sides)), self._along(sides)
        return squares, np.concatenate([along.real, -self.imaginary * along.imag], axis=1)

    def along_axes(self, sides: Sides) -> tuple[np.ndarray, np.ndarray]:
        """Eigenvalues (2m,) of ΦᵗΦ of a single alternative, and its ΦᵗV (2m, p) along the eigenvectors.

        Where Re and Im weigh the same, in coefficients and in data, those of φᴴφ, (m,) and complex (m, p): an
        eigenvalue then counts twice, for Re and Im along its eigenvector. Eigenvectors are kept as the products are.
        """
        if self.imaginary != 1 or sides.turned is None:
            squares, along = self.products(sides)
            values, axes = np.linalg.eigh(squares[0])
            return values, axes.T @ along[0]
        key = ("axes", self.amounts.tobytes(), *self._key(sides))
        values, axes = self._kept.get(key, lambda: np.linalg.eigh(_real_if_so(self._hermitian(sides)[0])))
        return values, axes.conj().T @ self._along(sides)[0].conj()

    def _along(self, sides: Sides) -> np.ndarray:
        """φᵗv (n, m, p)."""
        acting, amounts = self._acting, self.amounts[self._acting]
        along = sides.products.get(self._kept, lambda: self._along_of_every_factor(sides))[:, acting]
        along = along * (self.scale[:, None] * amounts)[:, :, None, None]
        return along.reshape(len(along), -1, along.shape[-1])

    def _along_of_every_factor(self, sides: Sides) -> np.ndarray:
        """Σ row · factor · v (n, t', s, p) over the points, without amounts and scale."""
        n, rows, size = len(self.rows), self.rows.shape[1], len(self.factors)
        along = self.factors[:, :, None] * sides.turned[self.points]  # (t', k', p)
        along = _times(self.rows.reshape(-1, self.points.size), along.transpose(1, 0, 2).reshape(self.points.size, -1))
        return along.reshape(n, rows, size, -1).transpose(0, 2, 1, 3)

    def _key(self, sides: Sides) -> tuple[Hashable, ...]:
        data, share = sides.data, sides.share[self.indices_in(sides.data)]
        return share.tobytes(), data.relative_noise.tobytes(), data.noise_memory

    def _squares_of(self, sides: Sides) -> np.ndarray:
        """ΦᵗΦ (n, 2m, 2m) where Re and Im have the same share."""
        inner = self._hermitian(sides)
        n, size = inner.shape[:2]
        found = np.empty((n, 2, size, 2, size))
        found[:, 0, :, 0], found[:, 1, :, 1] = inner.real, self.imaginary**2 * inner.real
        found[:, 1, :, 0], found[:, 0, :, 1] = self.imaginary * inner.imag, -self.imaginary * inner.imag
        return found.reshape(n, 2 * size, -1)

    def _hermitian(self, sides: Sides) -> np.ndarray:
        """φᴴφ (n, m, m) where Re and Im have the same share."""
        share = sides.share[self.indices_in(sides.data)]
        if any(sides.data.noise_memory):
            white = (self._white(sides.data) * share[: self.points.size, None, None]).transpose(1, 0, 2)
            return white.conj().transpose(0, 2, 1) @ white
        n, rows, size = len(self.rows), self.rows.shape[1], self._acting.size
        found = np.empty((n, size, rows, size, rows), dtype=complex)
        for row, first in enumerate(self._acting):
            for column, second in enumerate(self._acting[: row + 1]):
                amount = self.amounts[first] * self.amounts[second] * self.scale[:, None, None] ** 2
                block = amount * self._product(sides, share, first, second)
                found[:, row, :, column] = block
                found[:, column, :, row] = block.conj().transpose(0, 2, 1)
        return found.reshape(n, size * rows, -1)

    def _product(self, sides: Sides, share: np.ndarray, first: int, second: int) -> np.ndarray:
        """Σ conj(row · first) row · second (n, s, s) over the points, of two whitened factors; kept.

        Without amounts and scale.
        """

        def weight() -> np.ndarray:
            return (sides.data.weight[self.points] * share[: self.points.size]) ** 2

        def of_each() -> np.ndarray:
            """(t', n, s, s) of every factor with itself: |factor|² is real, without rounding."""
            return self._weighted(np.abs(self.factors) ** 2 * weight())

        def of_both() -> np.ndarray:
            across = self.factors[first].conj() * self.factors[second] * weight()
            real, imaginary = self._weighted(np.stack([across.real, across.imag]))
            return real + 1j * imaginary

        key = self._key(sides)
        if first == second:
            return self._kept.get(("of each", *key), of_each)[first]
        return self._kept.get(("of both", int(first), int(second), *key), of_both)

    def _whole(self, data: SweepData, share: np.ndarray) -> np.ndarray:
        """Φᵗ (n, 2m, 2k')."""
        return np.ascontiguousarray((self.whitened(data) * share[:, None, None]).transpose(1, 2, 0))

    def _weighted(self, weights: np.ndarray) -> np.ndarray:
        """Σ w conj(row) row (t, n, s, s) for real weights w (t, k')."""
        if self.pairs is None:
            return np.stack([(self.rows.conj() * weight) @ self.rows.transpose(0, 2, 1) for weight in weights])
        return _weighted_pairs(self.pairs, weights)


def _real_if_so(matrix: np.ndarray) -> np.ndarray:
    """A complex matrix, or its real part where there is no other."""
    return matrix if np.any(matrix.imag) else matrix.real


def _times(rows: np.ndarray, right: np.ndarray) -> np.ndarray:
    """rows (n, k) @ right (k, p) complex, whose parts real rows multiply: numpy would make these complex first."""
    return rows @ right if np.iscomplexobj(rows) else (rows @ np.ascontiguousarray(right).view(float)).view(complex)


def squared_exponential(distance: np.ndarray) -> np.ndarray:
    """(k, m) correlation exp(−d²/2) of a process without any roughness, d (k, m) in correlation lengths."""
    return np.exp(-0.5 * distance**2)


def matern(distance: np.ndarray) -> np.ndarray:
    """(k, m) correlation (1 + √3 d) exp(−√3 d) of a process with a slope and no curvature (Matérn, 3/2)."""
    return (1 + np.sqrt(3) * distance) * np.exp(-np.sqrt(3) * distance)


def components(log_frequency: np.ndarray, length: float, kernel: Kernel = squared_exponential) -> np.ndarray:
    """(k, m) values of the principal components of a process of unit variance at log f (k,), scaled by their σ."""
    return _components(np.ascontiguousarray(log_frequency, dtype=float).tobytes(), length, kernel)


@lru_cache(maxsize=32)
def _components(frequencies: bytes, length: float, kernel: Kernel) -> np.ndarray:
    """`components`, kept: the fits of a sweep need them again and again."""
    log_frequency = np.frombuffer(frequencies)
    low, high = float(log_frequency.min()), float(log_frequency.max())
    at = np.linspace(low, high, int(np.ceil(6 / length)) + 1)
    scale = length * (high - low)
    values, vectors = np.linalg.eigh(kernel(np.abs(at[:, None] - at) / scale))
    kept = values > _NEGLIGIBLE * values[-1]
    return kernel(np.abs(log_frequency[:, None] - at) / scale) @ vectors[:, kept] / np.sqrt(values[kept])


def smooth(
    data: SweepData,
    log_slope: np.ndarray,
    shares: Sequence[float] = SHARES,
    kernel: Kernel = squared_exponential,
) -> Iterator[Alternatives]:
    """The smooth form: both processes for every ℓ and w; each sweep has its own coefficients.

    Parameters
    ----------
    log_slope : (k,) complex ∂log Z/∂log f of the model
    shares : w;  kernel : correlation over distances in ℓ
    """
    steep = [np.sqrt(np.mean(np.abs(log_slope[sweep]) ** 2)) or 1.0 for sweep in data.sweeps]
    moved = np.concatenate([log_slope[sweep] / rms for sweep, rms in zip(data.sweeps, steep, strict=True)])
    for length in LENGTHS:
        rows = _of_sweeps(data, [components(np.log(data.frequency[sweep]), length, kernel) for sweep in data.sweeps])
        both = _alone("smooth", rows, np.array([np.ones_like(moved), moved]), 1.0, length)
        for share in shares:
            yield both.mixed([np.sqrt(1 - share), np.sqrt(share)])


def shared_smooth(data: SweepData, log_slope: np.ndarray) -> Sequence[Alternatives]:
    """`smooth` of a slope (k,), with its products kept for the latest slopes: fits by linearisation share them.

    Not kept for long sweeps, for which they would be large.
    """
    if data.impedance.size > _KEPT:
        return tuple(smooth(data, log_slope))
    key = data.frequency.tobytes(), data.sizes, log_slope.tobytes()
    return _of_curves.get(key, lambda: tuple(smooth(data, log_slope)))


#: Smooth forms of the latest curves.
_of_curves = Once(latest=_CURVES)


def of_every_resonance(data: SweepData, impedance: np.ndarray) -> Iterator[Alternatives]:
    """Errors of all resonances of the model, for every κ and part of the losses.

    Yields none where no sweep shows three resonances: errors of one or two are errors of the constants found from them.

    impedance : (k,) Z of the model, ohm
    """
    curves = [_resonances(data.frequency[sweep], impedance[sweep]) for sweep in data.sweeps]
    ends = [(2 * np.pi * np.max(data.frequency[sweep])) ** 2 for sweep in data.sweeps]
    if max(np.sum(poles.real < end) for (poles, *_), end in zip(curves, ends, strict=True)) < _FEWEST:
        return
    moved, mixed = [], []
    for (poles, strengths, charge), sweep in zip(curves, data.sweeps, strict=True):
        away = poles - (2 * np.pi * data.frequency[sweep, None]) ** 2
        moved.append(strengths * poles / away**2 / charge[:, None])
        mixed.append(-np.sqrt(strengths * np.max(np.abs(strengths), initial=0.0)) / away / charge[:, None])
    for ratio, loss in product(STRENGTHS, LOSSES):
        blocks = [np.hstack([one, ratio * other]) for one, other in zip(moved, mixed, strict=True)]
        blocks = [block / (_size(block, loss) or 1.0) for block in blocks]
        factor = np.ones((1, data.impedance.size))
        yield _alone("of every resonance", _of_sweeps(data, blocks), factor, loss, ratio)


def of_one_resonance(
    data: SweepData, impedance: np.ndarray, log_slope: np.ndarray, qualities: Sequence[float] = QUALITIES
) -> Iterator[Alternatives]:
    """A further resonance at every place of every sweep, in parallel with the piece or moving with it, for every Q.

    impedance : (k,) Z of the model, ohm;  log_slope : (k,) ∂log Z/∂log f
    """
    for sweep, quality in product(data.sweeps, qualities):
        points, frequency = np.arange(data.impedance.size)[sweep], data.frequency[sweep]
        if points.size <= _KEPT:
            places, rows, pairs = _kept_at_places(np.ascontiguousarray(frequency).tobytes(), quality)
        else:
            (places, rows), pairs = _resonances_at_places(frequency, quality), None
        factors, unit = np.array([1j * frequency * impedance[points], log_slope[points]]), np.ones(places.size)
        both = Alternatives("a resonance of its own", rows, factors, unit, 1.0, points, places, pairs=pairs)
        yield from both.one_by_one()


def of_one_step(data: SweepData, log_slope: np.ndarray) -> Iterator[Alternatives]:
    """A step at every place of every sweep, of log Z or of log f; log_slope : (k,) ∂log Z/∂log f."""
    for sweep in data.sweeps:
        points, frequency = np.arange(data.impedance.size)[sweep], data.frequency[sweep]
        stride = -(-points.size // _STEPS)
        first = np.arange(max(stride, _BESIDE), points.size - _BESIDE + 1, stride)
        rows = (np.arange(points.size) >= first[:, None]).astype(float)
        factors, unit = np.array([np.ones(points.size), log_slope[points]]), np.ones(first.size)
        both = Alternatives("a step", rows[:, None], factors, unit, 1.0, points, frequency[first])
        yield from both.one_by_one()


def _resonances_at_places(frequency: np.ndarray, quality: float) -> tuple[np.ndarray, np.ndarray]:
    """Places (n,) Hz of a quality factor over a sweep (k',), and both rows (n, 2, k') of a resonance there."""
    places = _thinned(frequency, _APART / (2 * quality))
    poles = (2 * np.pi * places[:, None]) ** 2 * (1 + 1j / quality)
    fraction = poles / (poles - (2 * np.pi * frequency) ** 2)
    return places, np.stack([fraction, fraction**2 / quality], axis=1)


@lru_cache(maxsize=2 * len(QUALITIES))
def _kept_at_places(frequencies: bytes, quality: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `_resonances_at_places`, and the pairs of rows; kept, as the sweeps of a lot have the same frequencies."""
    places, rows = _resonances_at_places(np.frombuffer(frequencies), quality)
    squares, both = np.abs(rows) ** 2, rows[:, 0].conj() * rows[:, 1]
    pairs = np.stack([squares[:, 0], both.real, both.imag, squares[:, 1]], axis=1)
    return places, rows, pairs.reshape(len(places), 2, 2, -1)


def _weighted_pairs(pairs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Σ w conj(row) row (t, n, s, s) of pairs (n, s, s, k') as in `Alternatives`, for real weights w (t, k')."""
    packed = (pairs.reshape(-1, weights.shape[1]) @ weights.T).T.reshape(-1, *pairs.shape[:3])
    turned, below = packed.transpose(0, 1, 3, 2), np.tri(packed.shape[-1], k=-1, dtype=bool)
    return np.where(below, turned, packed) + 1j * np.where(below, -packed, np.where(below.T, turned, 0.0))


def _size(columns: np.ndarray, imaginary: float) -> float:
    """rms over the points of Re and Im of the error that columns (k', m) with normal coefficients make."""
    return float(np.sqrt((1 + imaginary**2) / 2 * np.mean(np.sum(np.abs(columns) ** 2, axis=1))))


def _of_sweeps(data: SweepData, blocks: Sequence[np.ndarray]) -> np.ndarray:
    """(1, s, k) rows of one alternative: the columns (k', s') of every sweep, with coefficients of its own."""
    rows = np.zeros((1, sum(block.shape[1] for block in blocks), data.impedance.size), dtype=np.result_type(*blocks))
    begin = 0
    for sweep, block in zip(data.sweeps, blocks, strict=True):
        rows[0, begin : begin + block.shape[1], sweep] = block
        begin += block.shape[1]
    return rows


def _alone(form: Form, rows: np.ndarray, factors: np.ndarray, imaginary: float, place: float) -> Alternatives:
    """A single alternative of rows (1, s, k) over all points, with factors (t, k)."""
    return Alternatives(form, rows, factors, np.ones(1), imaginary, np.arange(rows.shape[2]), np.array([place]))


def _thinned(frequency: np.ndarray, apart: float) -> np.ndarray:
    """(n,) the first of the frequencies (k,) in each interval of log f of the length `apart`, rising."""
    cells = np.floor(np.log(frequency / frequency.min()) / apart)
    return np.sort(frequency[np.unique(cells, return_index=True)[1]])


def _resonances(frequency: np.ndarray, impedance: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """λ_k (m,) and r_k (m,) of a model's curve in and near its sweep, and C (k,) at its points."""
    square = (2 * np.pi * frequency) ** 2
    charge = 1 / (2j * np.pi * frequency * impedance)
    poles, strengths = rational_curve(frequency, impedance).poles
    near = (poles.real > square.min() / _BEYOND**2) & (poles.real < square.max() * _BEYOND**2)
    near &= np.abs(poles.imag) < 0.5 * np.abs(poles.real)
    near &= np.abs(strengths) > _VISIBLE * np.median(np.abs(charge)) * np.abs(poles)
    return poles[near], strengths[near], charge
