"""What a sweep cannot give: each failure mode with a code and one sentence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femu_piezo.extraction.fit import SweepData
from femu_piezo.extraction.roots import Roots
from femu_piezo.measurement.spectrum import ImpedanceSpectrum

CLIPPED_RUN = 4  # so many equal extreme readings side by side are a clipped peak, not chance


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
)


@dataclass(frozen=True)
class Finding:
    """One thing missing or doubtful: a code (one of `CODES`) for programs, a sentence for people."""

    code: str
    sentence: str


def find_lossless(spectrum: ImpedanceSpectrum) -> list[Finding]:
    """A sweep without any resistance: a simulation of a material without loss, which no instrument can show."""
    if np.any(np.abs(spectrum.impedance.real) > 1e-9 * np.abs(spectrum.impedance.imag)):
        return []
    sentence = (
        "the sweep has no resistance at all, so its resonances have no width: it is simulated without loss; give the "
        "material loss tangents such as tan_s11 = 0.015"
    )
    return [Finding("lossless", sentence)]


def gravest_first(findings: list[Finding]) -> tuple[Finding, ...]:
    """The findings in the order of `CODES`."""
    return tuple(sorted(findings, key=lambda finding: CODES.index(finding.code)))


def too_few_points(spectrum: ImpedanceSpectrum, usable: int, needed: int) -> Finding:
    """Fewer points than the smallest model with one mode and a capacitance has unknowns."""
    return Finding(
        "too_few_points",
        f"{spectrum.source}: {usable} usable points are fewer than the {needed} that one resonance on a "
        "background needs; measure more points",
    )


def find_clipping(spectrum: ImpedanceSpectrum) -> tuple[np.ndarray, list[Finding]]:
    """(n,) bool: runs of at least `CLIPPED_RUN` equal readings at the largest or smallest |Z|."""
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
                    f"{run} readings side by side share the {name} |Z| = {extreme:.4g} ohm: the peak is "
                    "clipped; these points are left out of the fit, check the range of the instrument",
                )
            )
    return clipped, findings


def find_systematic(phi: complex) -> list[Finding]:
    """A residual that is correlated from point to point."""
    if phi == 0:
        return []
    return [
        Finding(
            "correlated_residual",
            f"neighbouring residuals are correlated ({abs(phi):.2f}): instrument or model err systematically "
            "beyond the noise; standard deviations are from leaving out parts of the sweep",
        )
    ]


def find_reversed(data: SweepData) -> list[Finding]:
    """A sweep whose conductance is negative at most points: −Z was recorded."""
    if data.scale > 0:
        return []
    return [
        Finding(
            "negative_resistance",
            "the resistance is negative at most points: terminals reversed, or 180° in the phase; poles, zeros and "
            "k_eff do not depend on the sign",
        )
    ]


def find_missing(roots: Roots, spectrum: ImpedanceSpectrum) -> list[Finding]:
    """No resonance at all, or poles without zeros and zeros without poles at the ends of the sweep."""
    low, high = spectrum.frequency[0], spectrum.frequency[-1]
    poles, zeros = roots.inside.poles, roots.inside.zeros
    if not poles and not zeros:
        return [
            Finding(
                "no_resonance",
                f"no resonance between {low:.6g} and {high:.6g} Hz stands out of the noise; "
                "measure another band, or average more",
            )
        ]
    out = []
    if len(poles) > len(zeros):
        out.append(Finding("zero_outside_sweep", _outside("antiresonance", "zero", roots, high)))
    if len(zeros) > len(poles):
        out.append(Finding("pole_outside_sweep", _outside("resonance", "pole", roots, low)))
    return out


def _outside(word: str, kind: str, roots: Roots, end: float) -> str:
    far = [r for r in roots.outside if r.kind == kind]
    guess = f"; extrapolated to {far[0].frequency_Hz:.6g} Hz, not to be relied on" if far else ""
    return f"a mode has its {word} ({kind}) outside the sweep, beyond {end:.6g} Hz{guess}; widen the sweep"


def _longest_run(flags: np.ndarray) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return int((edges[1::2] - edges[0::2]).max()) if edges.size else 0
