"""Poles and zeros of a fitted model with their joint covariance, sound ones separated from spurious ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import compress
from typing import TypeVar

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse.csgraph import connected_components

from femu_piezo.extraction.covariance import Spread
from femu_piezo.extraction.model import RationalModel
from femu_piezo.extraction.order import MAX_LOSS, MAX_PHASE
from femu_piezo.resonances import Kind, Resonance, ResonanceSet, effective_coupling
from femu_piezo.units import hertz

MAX_RELATIVE_STD_LOSS = 0.35  # a resonance has its loss known to better than this
MIN_RESIDUE_SIGMA = 4.0  # |residue| in units of its standard deviation
RESOLVED = 2 / np.sqrt(3)  # distance in half-widths from which two equal Lorentz curves show two peaks
_STRONG = 0.6  # share of the strongest coupling from which a pair may be the fundamental


@dataclass(frozen=True)
class Pair:
    """A pole with its zero.

    Attributes
    ----------
    pole, zero : the two resonances
    k_eff : sqrt(1 − Re λ_pole/Re λ_zero), IEEE 176 effective coupling; nan where the zero lies below
    std_k_eff : its standard deviation from the joint covariance of both, nan where k_eff is or no covariance
    coupling_phase : arg(1 − λ_pole/λ_zero), rad: the loss angle of k_eff². k² = d²/(s ε) has the angle
        tan δ + tan φ − 2 tan θ (dielectric, elastic, piezoelectric loss tangent), so the quality factor is
        higher at the zero than at the pole where the piezoelectric loss is above the mean of the other two
        (Zhuang, Ural, Tajima, Uchino et al., J. Appl. Phys. 105 (2009) 084110, for Q_A and Q_B). k_eff² is not
        proportional to k²: of fundamentals its angle is 1.0 (k31 bar) to 1.12 (k33 bar, k = 0.7) times that of k²
    std_coupling_phase : its standard deviation, nan as above
    """

    pole: Resonance
    zero: Resonance
    k_eff: float
    std_k_eff: float
    coupling_phase: float
    std_coupling_phase: float

    @property
    def remark(self) -> str | None:
        """Why the quality factors of pole and zero differ, where they do beyond three standard deviations."""
        if not abs(self.coupling_phase) > 3 * self.std_coupling_phase:
            return None
        above = self.coupling_phase < 0
        return (
            f"Q is {self.pole.quality_factor:.0f} at {hertz(self.pole.frequency_Hz)} Hz (pole) and "
            f"{self.zero.quality_factor:.0f} at {hertz(self.zero.frequency_Hz)} Hz (zero): the piezoelectric loss "
            f"tangent lies {'above' if above else 'below'} the mean of the dielectric and elastic ones, "
            f"2 tan θ − tan δ − tan φ is about {-self.coupling_phase:.2g}"
        )


@dataclass(frozen=True)
class Roots:
    """Sound resonances inside the sweep, the significant ones found outside it, and the doubtful ones inside.

    `outside` are extrapolations: their covariance holds only as far as the model does. `doubtful` are poles, then
    zeros, that the evidence asks for and whose loss or residue is not known well enough. `unphysical` are those of the
    model inside the sweep that no passive mode by itself has: of weak modes between a strong pole and its zero, and of
    the background. They serve the matching alone.
    """

    inside: ResonanceSet
    outside: tuple[Resonance, ...]
    doubtful: tuple[Resonance, ...] = ()
    unphysical: tuple[Resonance, ...] = ()

    def sound_and_doubtful(self, kind: Kind) -> tuple[Resonance, ...]:
        """The poles or zeros inside the sweep, sound and doubtful."""
        sound = self.inside.poles if kind == "pole" else self.inside.zeros
        return sound + tuple(r for r in self.doubtful if r.kind == kind)


@dataclass(frozen=True)
class _Root:
    """A pole or zero λ with its gradient (p,) over the parameters; of a pole also its strength Σ r and that gradient.

    `apart` is the rms distance of merged poles from their mean, rad²/s².
    """

    kind: Kind
    eigenvalue: complex
    gradient: np.ndarray
    residue: complex
    strength: complex = 0j
    strength_gradient: np.ndarray | None = None
    apart: float = 0.0


def resonances(model: RationalModel, spread: Spread, band: tuple[float, float], *, systematic: bool = False) -> Roots:
    """Poles and zeros of the model with their joint covariance (delta method).

    Parameters
    ----------
    spread : second moments of the errors of the model parameters
    band : lowest and highest frequency of the sweep, Hz
    systematic : whether the fit leaves more than noise: poles that show as one peak are then merged, without the zeros
        between them, since a systematic error may split one mode as well
    """
    groups = _merged_poles(model) if systematic else [[m] for m in range(model.poles.size)]
    spans = [np.sort(model.axis.eigenvalue(model.poles[members]).real)[[0, -1]] for members in groups]
    zeros = [one for one in _zeros(model) if not any(low < one.eigenvalue.real < high for low, high in spans)]
    roots = [_pole(model, members) for members in groups] + zeros
    passive = [_is_physical(root, model) for root in roots]
    physical = list(compress(roots, passive))
    sound = [root for root in physical if _is_settled(root, spread)]
    every = interlaced([r for r in physical if band[0] <= _frequency(r) <= band[1]], _frequency)
    lowest, highest = (2 * np.pi * np.array(band)) ** 2
    others = [r for r, ok in zip(roots, passive, strict=True) if not ok and lowest <= r.eigenvalue.real <= highest]
    settled = {id(root) for root in sound}  # by identity, as == would compare the arrays of roots
    inside = [r for r in every if id(r) in settled]
    doubtful = _with_covariance([r for r in every if id(r) not in settled], spread)
    inner_poles, inner_zeros, joint = _with_covariance(inside, spread)
    far = [r for r in sound if not band[0] <= _frequency(r) <= band[1]]
    outside = [r for r in far if band[0] / 1.5 <= _frequency(r) <= band[1] * 1.5]
    far_poles, far_zeros, _ = _with_covariance(sorted(outside, key=_frequency), spread)
    return Roots(
        ResonanceSet(inner_poles, inner_zeros, joint),
        far_poles + far_zeros,
        doubtful[0] + doubtful[1],
        tuple(Resonance(r.kind, r.eigenvalue, residue=r.residue) for r in others),
    )


def unsettled_modes(model: RationalModel, spread: Spread) -> list[int]:
    """Numbers of the modes of a model whose loss or residue is not known well enough to speak of a resonance."""
    return [m for m in range(model.poles.size) if not _is_settled(_pole(model, [m]), spread)]


def pair(roots: Roots) -> tuple[Pair, ...]:
    """Match poles with zeros so that Σ sqrt|s_zero − s_pole| is least, and tell the pairs of two sound ones.

    The concave cost pairs a weak mode with the zero right beside it even where it sits between the pole and
    the zero of a strong one, where "next zero above" would swap them. Doubtful and unphysical ones are matched too: the
    zero of a doubtful pole may be sound, and is that of no other pole. Only a pole that gains energy is of no mode and
    has no zero. Poles or zeros without partner stay single.
    """
    found = roots.inside
    poles = roots.sound_and_doubtful("pole") + tuple(r for r in roots.unphysical if r.kind == "pole" and r.loss > 0)
    zeros = roots.sound_and_doubtful("zero")
    if not poles or not zeros:
        return ()
    zeros += _missing_zeros(poles, zeros, [r for r in roots.unphysical if r.kind == "zero"])
    rows, columns = linear_sum_assignment(np.sqrt(_distances(poles, zeros)))
    sound = (rows < len(found.poles)) & (columns < len(found.zeros))
    return tuple(_coupled(found, i, j) for i, j in zip(rows[sound], columns[sound], strict=True))


def _missing_zeros(
    poles: Sequence[Resonance], zeros: Sequence[Resonance], unphysical: Sequence[Resonance]
) -> tuple[Resonance, ...]:
    """The unphysical zeros that make the zeros as many as the poles, those nearest to a pole first.

    A weak mode has its zero right beside its pole; the others are of the background.
    """
    if len(zeros) >= len(poles) or not unphysical:
        return ()
    order = np.argsort(_distances(poles, unphysical).min(axis=0))
    return tuple(unphysical[j] for j in order[: len(poles) - len(zeros)])


def _distances(poles: Sequence[Resonance], zeros: Sequence[Resonance]) -> np.ndarray:
    """|s_zero − s_pole|, rad/s, a row for each pole."""
    return np.abs(np.array([zero.pole_s for zero in zeros]) - np.array([pole.pole_s for pole in poles])[:, None])


def fundamental(pairs: tuple[Pair, ...]) -> Pair | None:
    """The lowest pair that is coupled at least 0.6 times as strongly as the strongest; None where there is no pair.

    Length modes lose coupling with the square of their order, but a width mode may be coupled as strongly as the
    fundamental; flexural and lateral intruders are weak.
    """
    sound = [pair for pair in pairs if np.isfinite(pair.k_eff)]
    if not sound:
        return None
    strongest = max(pair.k_eff for pair in sound)
    return min((pair for pair in sound if pair.k_eff >= _STRONG * strongest), key=lambda pair: pair.pole.frequency_Hz)


def _coupled(found: ResonanceSet, i: int, j: int) -> Pair:
    pole, zero = found.poles[i], found.zeros[j]
    k = effective_coupling(pole, zero)
    ratio = pole.eigenvalue / zero.eigenvalue
    phase = float(np.angle(1 - ratio))
    if found.covariance is None or not k > 0:
        return Pair(pole, zero, k, float("nan"), phase, float("nan"))
    at = [2 * i, 2 * i + 1, 2 * (len(found.poles) + j), 2 * (len(found.poles) + j) + 1]
    block = found.covariance[np.ix_(at, at)]
    real = pole.eigenvalue.real / zero.eigenvalue.real
    gradient = np.array([-1 / zero.eigenvalue.real, 0, real / zero.eigenvalue.real, 0]) / (2 * k)
    slope = np.array([-1, ratio]) / (zero.eigenvalue * (1 - ratio))  # d ln(1 − λp/λz)/d(λp, λz)
    phase_gradient = np.array([slope[0].imag, slope[0].real, slope[1].imag, slope[1].real])
    std, std_phase = (float(np.sqrt(g @ block @ g)) for g in (gradient, phase_gradient))
    return Pair(pole, zero, k, std, phase, std_phase)


def _pole(model: RationalModel, members: list[int]) -> _Root:
    """One mode, or several merged: the mean of their λ, weighted by |residue|, and the sum of their residues."""
    r, z, count, width = model.residues[members], model.poles[members], model.poles.size, model.axis.half_width
    share = np.abs(r) / np.abs(r).sum()
    mean = complex(share @ z)
    gradient, strengths = np.zeros((2, model.size), complex)
    gradient[members], strengths[[count + m for m in members]] = share, 1.0
    apart = float(width * np.sqrt(share @ np.abs(z - mean) ** 2))
    strength = complex(r.sum())
    # Y = s·Q and Q ≈ scale·width·r/(λ + s²) near s = p, λ = −p²: the residue of Y is scale·width·r/2
    residue = complex(model.scale * width * strength / 2)
    return _Root("pole", complex(model.axis.eigenvalue(mean)), width * gradient, residue, strength, strengths, apart)


def _merged_poles(model: RationalModel) -> list[list[int]]:
    """Indices of the poles in groups that show as one peak each: each is nearer than `RESOLVED` to another."""
    x, width = model.poles.real, model.poles.imag
    near = np.abs(x[:, None] - x) < RESOLVED * np.minimum(width[:, None], width)
    count, group = connected_components(near, directed=False)
    return [np.flatnonzero(group == number).tolist() for number in range(count)]


def _zeros(model: RationalModel) -> list[_Root]:
    out, width = [], model.axis.half_width
    for x in model.zeros():
        value = complex(model.axis.eigenvalue(x))
        if not 0 <= value.imag <= 2 * MAX_LOSS * value.real:
            continue
        # Z = 1/(s·Q): the residue at s = z is 1/(z dQ/ds), dQ/ds = −2z dQ/dλ, z² = −λ
        residue = 1 / (2 * value * model.scale * complex(model.charge_slope(np.array(x))) / width)
        out.append(_Root("zero", value, width * model.zero_derivative(x), residue))
    return out


def _frequency(root: _Root) -> float:
    return float(np.sqrt(root.eigenvalue.real) / (2 * np.pi))


Found = TypeVar("Found", Resonance, _Root)


def interlaced(roots: list[Found], frequency: Callable[[Found], float]) -> list[Found]:
    """Poles, then zeros, each by frequency; zeros beyond the number of poles are dropped, the weakest first.

    Foster's theorem: poles and zeros of a passive one-port alternate. A weak mode may sit in reversed order with its
    zero, so only the numbers are compared: as many zeros as poles, and one more where a zero lies below all poles.
    """
    poles = sorted((r for r in roots if r.kind == "pole"), key=frequency)
    zeros = sorted((r for r in roots if r.kind == "zero"), key=lambda r: -abs(r.residue or 0.0))
    first = frequency(poles[0]) if poles else np.inf
    below = any(frequency(z) < first for z in zeros)
    return poles + sorted(zeros[: len(poles) + below], key=frequency)


def _is_physical(root: _Root, model: RationalModel) -> bool:
    """In the right half plane of λ, lossy, not broader than a resonance, and with a passive residue."""
    real, imag = root.eigenvalue.real, root.eigenvalue.imag
    passive = abs(np.angle(root.residue * np.sign(model.scale))) <= MAX_PHASE
    return bool(real > 0 and 0 < imag <= MAX_LOSS * real and passive)


def _is_settled(root: _Root, spread: Spread) -> bool:
    """Loss and, for a pole, residue known well enough to speak of a resonance."""
    if spread.size(root.gradient) / np.sqrt(2) > MAX_RELATIVE_STD_LOSS * root.eigenvalue.imag:
        return False
    if root.strength_gradient is None:  # of a zero
        return True
    return abs(root.strength) >= MIN_RESIDUE_SIGMA * spread.size(root.strength_gradient)


def _with_covariance(
    roots: list[_Root], spread: Spread
) -> tuple[tuple[Resonance, ...], tuple[Resonance, ...], np.ndarray]:
    if not roots:
        return (), (), np.zeros((0, 0))
    joint = spread.covariance(np.array([root.gradient for root in roots]))
    joint += np.diag(np.repeat([root.apart**2 for root in roots], 2))
    made = [
        Resonance(root.kind, root.eigenvalue, joint[2 * i : 2 * i + 2, 2 * i : 2 * i + 2], root.residue)
        for i, root in enumerate(roots)
    ]
    poles = tuple(r for r in made if r.kind == "pole")
    return poles, tuple(r for r in made if r.kind == "zero"), joint
