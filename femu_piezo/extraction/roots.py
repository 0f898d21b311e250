"""From a fitted model to poles and zeros with joint covariance, sound ones told from spurious ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from femu_piezo.extraction.covariance import Spread
from femu_piezo.extraction.model import RationalModel
from femu_piezo.extraction.order import MAX_LOSS, MAX_PHASE
from femu_piezo.resonances import Kind, Resonance, ResonanceSet, effective_coupling

MAX_RELATIVE_STD_LOSS = 0.35  # a resonance has its loss known to better than this
MIN_RESIDUE_SIGMA = 4.0  # |residue| in units of its standard deviation
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
        (Zhuang, Ural, Tajima, Uchino et al., J. Appl. Phys. 105 (2009) 084110, for Q_A and Q_B)
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
            f"Q is {self.pole.quality_factor:.0f} at {self.pole.frequency_Hz:.6g} Hz (pole) and "
            f"{self.zero.quality_factor:.0f} at {self.zero.frequency_Hz:.6g} Hz (zero): the piezoelectric loss "
            f"tangent lies {'above' if above else 'below'} the mean of the dielectric and elastic ones, "
            f"2 tan θ − tan δ − tan φ = {-self.coupling_phase:.4f} ± {self.std_coupling_phase:.1g}"
        )


@dataclass(frozen=True)
class Roots:
    """Sound resonances inside the sweep, and the significant ones found outside it.

    `outside` are extrapolations: their covariance holds only as far as the model does.
    """

    inside: ResonanceSet
    outside: tuple[Resonance, ...]


@dataclass(frozen=True)
class _Root:
    kind: Kind
    eigenvalue: complex
    gradient: np.ndarray
    residue: complex


def resonances(model: RationalModel, fisher: Spread, spread: Spread, band: tuple[float, float]) -> Roots:
    """Poles and zeros of the model with their joint covariance (delta method).

    Parameters
    ----------
    fisher : second moments of the errors of the model parameters from the noise alone; decides what is sound
    spread : the ones to report, wider than `fisher` where systematic errors show. The strongest pole and zero
        are kept however wide
    band : lowest and highest frequency of the sweep, Hz
    """
    roots = _poles(model) + _zeros(model)
    sound = [root for root in roots if _is_physical(root, model) and _is_settled(root, model, fisher)]
    strongest = {r.kind: r for r in sorted(sound, key=lambda r: abs(r.residue))}.values()
    sound = [r for r in sound if r in strongest or _is_settled(r, model, spread)]
    inside = _interlaced([r for r in sound if band[0] <= _frequency(r) <= band[1]])
    poles, zeros, joint = _with_covariance(inside, spread)
    outside = [r for r in sound if r not in inside and band[0] / 1.5 <= _frequency(r) <= band[1] * 1.5]
    far_poles, far_zeros, _ = _with_covariance(sorted(outside, key=_frequency), spread)
    return Roots(ResonanceSet(poles, zeros, joint), far_poles + far_zeros)


def pair(found: ResonanceSet) -> tuple[Pair, ...]:
    """Match poles with zeros so that Σ sqrt|f_zero − f_pole| is least.

    The concave cost pairs a weak mode with the zero right beside it even where it sits between the pole and
    the zero of a strong one, where "next zero above" would swap them. Poles or zeros without partner stay
    single.
    """
    if not found.poles or not found.zeros:
        return ()
    gap = np.array([[z.frequency_Hz - p.frequency_Hz for z in found.zeros] for p in found.poles])
    rows, columns = linear_sum_assignment(np.sqrt(np.abs(gap)))
    return tuple(_coupled(found, i, j) for i, j in zip(rows, columns, strict=True))


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
    turning = np.array([slope[0].imag, slope[0].real, slope[1].imag, slope[1].real])
    std, std_phase = (float(np.sqrt(g @ block @ g)) for g in (gradient, turning))
    return Pair(pole, zero, k, std, phase, std_phase)


def _poles(model: RationalModel) -> list[_Root]:
    out, width = [], model.axis.half_width
    for m, x in enumerate(model.poles):
        # Y = s·Q and Q ≈ scale·width·r/(λ_m + s²) near s = p, λ_m = −p²: the residue of Y is scale·width·r/2
        residue = complex(model.scale * width * model.residues[m] / 2)
        out.append(_Root("pole", complex(model.axis.eigenvalue(x)), width * np.eye(model.size)[m], residue))
    return out


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


def _interlaced(roots: list[_Root]) -> list[_Root]:
    """Poles, then zeros, by frequency; of two zeros without a pole between them the weaker one is background.

    Foster's theorem: poles and zeros of a passive one-port alternate. A weak mode may sit in reversed order
    with its zero, so a zero is dropped only where there is no pole to pair it with.
    """
    poles = sorted((r for r in roots if r.kind == "pole"), key=_frequency)
    zeros = sorted((r for r in roots if r.kind == "zero"), key=lambda r: -abs(r.residue))
    first = _frequency(poles[0]) if poles else np.inf
    below = any(_frequency(z) < first for z in zeros)
    return poles + sorted(zeros[: len(poles) + below], key=_frequency)


def _is_physical(root: _Root, model: RationalModel) -> bool:
    """In the right half plane of λ, lossy, not broader than a resonance, and with a passive residue."""
    real, imag = root.eigenvalue.real, root.eigenvalue.imag
    passive = abs(np.angle(root.residue * np.sign(model.scale))) <= MAX_PHASE
    return bool(real > 0 and 0 < imag <= MAX_LOSS * real and passive)


def _is_settled(root: _Root, model: RationalModel, spread: Spread) -> bool:
    """Loss and, for a pole, residue known well enough to speak of a resonance."""
    if spread.size(root.gradient) / np.sqrt(2) > MAX_RELATIVE_STD_LOSS * root.eigenvalue.imag:
        return False
    if root.kind == "zero":
        return True
    m = int(np.argmax(np.abs(root.gradient)))
    k = model.poles.size + m
    return abs(model.residues[m]) >= MIN_RESIDUE_SIGMA * spread.size(np.eye(model.size)[k])


def _with_covariance(
    roots: list[_Root], spread: Spread
) -> tuple[tuple[Resonance, ...], tuple[Resonance, ...], np.ndarray]:
    if not roots:
        return (), (), np.zeros((0, 0))
    joint = spread.covariance(np.array([root.gradient for root in roots]))
    made = [
        Resonance(root.kind, root.eigenvalue, joint[2 * i : 2 * i + 2, 2 * i : 2 * i + 2], root.residue)
        for i, root in enumerate(roots)
    ]
    poles = tuple(r for r in made if r.kind == "pole")
    return poles, tuple(r for r in made if r.kind == "zero"), joint
