"""What a sweep cannot give: each failure mode with a code and one sentence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femu_piezo.extraction.fit import NormalisedSweep
from femu_piezo.extraction.roots import Roots
from femu_piezo.measurement.discrepancy import Discrepancy
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.measurement.sweeps import SweepData
from femu_piezo.units import hertz

CLIPPED_RUN = 4  # so many equal extreme readings side by side are a clipped peak, not chance
NOISE_ALONE = 2.0  # ratio of the largest resistances of either sign, over |Z|, up to which both are noise
BANDS = 20  # most parts of a sweep, of two points at least, of which the one with the largest misfit is named


# Every code, the gravest first
CODES = (
    "too_few_points",
    "lossless",
    "no_resonance",
    "clipped",
    "zero_outside_sweep",
    "pole_outside_sweep",
    "negative_resistance",
    "noise_underestimated",
    "correlated_residual",
    "doubtful",
)


@dataclass(frozen=True)
class Finding:
    """One thing missing or doubtful: a code (one of `CODES`) for programs, a sentence for people."""

    code: str
    sentence: str


def find_lossless(spectrum: ImpedanceSpectrum) -> list[Finding]:
    """The finding of a sweep without any resistance, or with none beyond its noise, as a simulation without loss has.

    Of a body with losses the resistance is most of |Z| at a resonance; noise alone is as often negative.
    """
    cosine = spectrum.impedance.real / np.abs(spectrum.impedance)
    largest, resonant = (cosine.max(), -cosine.min()), spectrum.impedance.imag.max() > 0
    tangents = "give the material loss tangents such as tan_s11 = 0.015"
    if np.all(np.abs(cosine) <= 1e-9):
        words = f"at all, so its resonances have no width: it is simulated without loss; {tangents}"
    elif resonant and max(largest) < NOISE_ALONE * min(largest):
        words = (
            "beyond its noise, so its resonances are far narrower than the steps of the frequency, or it is simulated "
            f"without loss: measure closer points about a resonance, or {tangents}"
        )
    else:
        return []
    return [Finding("lossless", f"the sweep has no resistance {words}")]


def gravest_first(findings: list[Finding]) -> tuple[Finding, ...]:
    """The findings in the order of `CODES`."""
    return tuple(sorted(findings, key=lambda finding: CODES.index(finding.code)))


def too_few_points(spectrum: ImpedanceSpectrum, usable: int, needed: int) -> Finding:
    """The finding of a sweep with fewer usable points than a fit of one mode on a background needs."""
    return Finding(
        "too_few_points",
        f"{spectrum.source}: the sweep has {usable} usable points, and a fit of one resonance on a "
        f"background needs {needed}; measure more points",
    )


def find_clipping(spectrum: ImpedanceSpectrum) -> tuple[np.ndarray, list[Finding]]:
    """(n,) bool: readings at a largest or smallest |Z| that at least `CLIPPED_RUN` in a row share; and findings."""
    size = np.abs(spectrum.impedance)
    if size.size < CLIPPED_RUN:
        return np.zeros(size.size, bool), []
    clipped = np.zeros(size.size, bool)
    findings = []
    for extreme, name in ((size.max(), "largest"), (size.min(), "smallest")):
        flat = np.isclose(size, extreme, rtol=1e-12, atol=0)
        run = _longest_run(flat)
        if run >= CLIPPED_RUN:
            clipped |= flat
            findings.append(
                Finding(
                    "clipped",
                    f"{run} neighbouring readings have the same {name} |Z| = {extreme:.4g} ohm: the peak is "
                    "clipped; these points are left out of the fit; check the range of the instrument",
                )
            )
    return clipped, findings


def find_systematic(systematic: Discrepancy, error: np.ndarray, freedom: int, sweep: SweepData) -> list[Finding]:
    """The finding of a probable systematic error, which no passive linear body explains, and the band of most of it.

    Parameters
    ----------
    error : (n,) relative errors of the fitted Z;  freedom : 2n less the real parameters of the fit
    sweep : its points, with the noise estimated from neighbouring points
    """
    if not systematic.probable:
        return []
    missed = float(np.sqrt(2 * np.sum(np.abs(error) ** 2) / freedom))
    scatter = float(np.median(sweep.relative_noise))
    bands = np.array_split(np.arange(error.size), min(BANDS, error.size // 2))
    power = np.array([np.mean(np.abs(error[band]) ** 2) for band in bands])
    low, high = sweep.frequency[bands[int(np.argmax(power))][[0, -1]]]
    return [
        Finding(
            "correlated_residual",
            f"the best fit of a passive linear body differs from the sweep by {100 * missed:.2g} % rms, with a scatter "
            f"of {100 * scatter:.2g} % between neighbouring points; the misfit is largest between {hertz(low)} and "
            f"{hertz(high)} Hz; causes may be the drive level, a drift, a moving contact, the instrument, or modes "
            "too close to be separated; the standard deviations allow for it",
        )
    ]


def find_doubtful(roots: Roots) -> list[Finding]:
    """The finding of modes that the evidence asks for and whose loss or residue is not known well enough."""
    poles = [r.frequency_Hz for r in roots.doubtful if r.kind == "pole"]
    if not poles:
        return []
    what, verb = ("a mode", "is") if len(poles) == 1 else (f"{len(poles)} modes", "are")
    places = ", ".join(hertz(f) for f in poles)
    return [
        Finding(
            "doubtful",
            f"{what} at {places} Hz {verb} doubtful: the sweep shows a resonance there, but does not determine its "
            "loss or its strength",
        )
    ]


def find_reversed(data: NormalisedSweep) -> list[Finding]:
    """The finding of a sweep whose conductance is negative at most points: −Z was recorded."""
    if data.scale > 0:
        return []
    return [
        Finding(
            "negative_resistance",
            "the resistance is negative at most points: the terminals are reversed, or the phase is off by 180°; "
            "poles, zeros and k_eff do not depend on the sign",
        )
    ]


def find_missing(roots: Roots, spectrum: ImpedanceSpectrum) -> list[Finding]:
    """Findings of no resonance at all, or of poles without zeros and zeros without poles at the ends of the sweep."""
    low, high = spectrum.frequency[0], spectrum.frequency[-1]
    poles, zeros = roots.sound_and_doubtful("pole"), roots.sound_and_doubtful("zero")
    if not poles and not zeros:
        return [Finding("no_resonance", _nothing_inside(roots, low, high))]
    out = []
    if len(poles) > len(zeros):
        above = [one.frequency_Hz for one in roots.outside if one.kind == "zero" and one.frequency_Hz > high]
        out.append(
            Finding("zero_outside_sweep", _outside("antiresonance (zero)", "above", high, min(above, default=0)))
        )
    if len(zeros) > len(poles):
        below = [one.frequency_Hz for one in roots.outside if one.kind == "pole" and one.frequency_Hz < low]
        out.append(Finding("pole_outside_sweep", _outside("resonance (pole)", "below", low, max(below, default=0))))
    return out


def _nothing_inside(roots: Roots, low: float, high: float) -> str:
    """The sentence for a sweep without a pole or zero."""
    if not roots.outside:
        return (
            f"no resonance between {hertz(low)} and {hertz(high)} Hz can be distinguished from noise; "
            "measure another band, or average more"
        )
    nearest = min(roots.outside, key=lambda one: abs(np.log(one.frequency_Hz**2 / (low * high))))
    return (
        f"no pole or zero lies between {hertz(low)} and {hertz(high)} Hz; a {nearest.kind} is seen beyond, at "
        f"an extrapolated {hertz(nearest.frequency_Hz)} Hz: widen the sweep"
    )


def _outside(word: str, side: str, end: float, nearest: float) -> str:
    """nearest : frequency of the nearest extrapolated one on that side, Hz; 0 where there is none"""
    guess = f", at an extrapolated {hertz(nearest)} Hz, which is not reliable" if nearest else ""
    return f"a mode has its {word} outside the sweep, {side} {hertz(end)} Hz{guess}; widen the sweep"


def _longest_run(flags: np.ndarray) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return int((edges[1::2] - edges[0::2]).max()) if edges.size else 0
