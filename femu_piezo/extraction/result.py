"""`Extraction`: what a sweep says about the resonances of a specimen."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from femu_piezo.extraction.covariance import Spread
from femu_piezo.extraction.limitations import Finding
from femu_piezo.extraction.model import RationalModel
from femu_piezo.extraction.noise_level import NoiseUsed
from femu_piezo.extraction.order import Candidate
from femu_piezo.extraction.roots import Pair, fundamental
from femu_piezo.files import as_json
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.resonances import Resonance, ResonanceSet
from femu_piezo.standards.figures import StandardFigures, read_curve, standard_figures
from femu_piezo.standards.piece import Piece
from femu_piezo.threads import made_once

Method = Literal["maximum_likelihood", "prony_ss"]


@dataclass(frozen=True)
class Extraction:
    """What a sweep says about the resonances of a specimen.

    Attributes
    ----------
    spectrum : the sweep that was analysed, unchanged
    used : (n,) bool, points that entered the fit (clipped ones do not)
    resonances : poles and zeros inside the sweep, joint covariance over (Re λ, Im λ)
    pairs : poles with their zeros, k_eff and its standard deviation
    outside : significant poles and zeros the fit places outside the sweep, extrapolated
    doubtful : poles, then zeros, inside the sweep whose loss or residue is not known well enough for `resonances`
    impedance : (n,) complex ohm, the fitted Z at the sweep's frequencies
    residual : (n,) complex, (Z_data − Z_fit)/σ_Z, E|·|² = 1 for a right model; nan where not used
    noise : the noise the fit used
    reduced_chi_square : Σ|residual|²/(n − p), about 1 for a right model and a right noise
    model : the fitted rational function, None where nothing could be fitted
    orders : every model order tried, with its evidence
    findings : what is missing or doubtful, each a code and a sentence
    method : how the resonances were obtained
    spread : of the parameters of `model`, None where no covariance is known
    """

    spectrum: ImpedanceSpectrum
    used: np.ndarray = field(repr=False)
    resonances: ResonanceSet
    pairs: tuple[Pair, ...]
    outside: tuple[Resonance, ...]
    impedance: np.ndarray = field(repr=False)
    residual: np.ndarray = field(repr=False)
    noise: NoiseUsed | None
    reduced_chi_square: float
    model: RationalModel | None = field(repr=False)
    orders: tuple[Candidate, ...] = field(repr=False)
    findings: tuple[Finding, ...]
    method: Method = "maximum_likelihood"
    spread: Spread | None = field(default=None, repr=False)
    doubtful: tuple[Resonance, ...] = ()

    @property
    def fundamental(self) -> Pair | None:
        """The pair of the fundamental; None without a fitted function, or where no pole has a zero above it."""
        return None if self.model is None else fundamental(self.pairs)

    @made_once
    def figures(self) -> StandardFigures | None:
        """Standard figures of the `fundamental` that need no shape of the body; None without it."""
        pair = self.fundamental
        if pair is None or self.model is None:
            return None
        piece = Piece("other", 1.0, None, None, 1.0)
        sweep = self.spectrum.select(self.used)
        points, noise = (sweep.frequency, sweep.impedance), self.relative_noise_of(sweep)
        reading = read_curve(self.model.admittance, points, pair.pole, pair.zero, piece, noise=noise)
        return standard_figures(piece, reading, pair.pole, pair.zero).with_coupling_std(pair.std_k_eff)

    def relative_noise_of(self, spectrum: ImpedanceSpectrum) -> np.ndarray:
        """(n,) standard deviation of the relative error of a part of the sweep, sqrt(E|δZ/Z|²).

        That of the file, else as it was learned, else 0.1 %.
        """
        if spectrum.noise is not None:
            sigma = spectrum.noise
        elif self.noise is not None:
            sigma = self.noise.std(spectrum.impedance)
        else:
            sigma = 1e-3 * np.abs(spectrum.impedance)
        return sigma / np.abs(spectrum.impedance)

    @property
    def status(self) -> str:
        """ "ok", or the code of the gravest finding."""
        return self.findings[0].code if self.findings else "ok"

    @property
    def notes(self) -> tuple[str, ...]:
        """The findings as sentences."""
        return tuple(finding.sentence for finding in self.findings)

    @property
    def remarks(self) -> tuple[str, ...]:
        """A sentence for each pair whose quality factors differ; and why there are no figures, where there are none."""
        told = tuple(p.remark for p in self.pairs if p.remark)
        if self.pairs and self.fundamental is None:
            told += (
                "no pole of this sweep was paired with a zero above it (as where an admittance is given as an "
                "impedance), so there are no standard figures and no k_eff",
            )
        return told

    def to_json(self) -> dict:
        """Poles and zeros, and all that qualifies them, in JSON types; None for what is not known."""
        found = {
            "poles": [r.to_json() for r in self.resonances.poles],
            "zeros": [r.to_json() for r in self.resonances.zeros],
            "pairs": [
                {
                    "pole_Hz": p.pole.frequency_Hz,
                    "zero_Hz": p.zero.frequency_Hz,
                    "k_eff": p.k_eff,
                    "std_k_eff": p.std_k_eff,
                    "Q_pole": p.pole.quality_factor,
                    "Q_zero": p.zero.quality_factor,
                    "coupling_phase": p.coupling_phase,
                    "std_coupling_phase": p.std_coupling_phase,
                }
                for p in self.pairs
            ],
            "covariance": None
            if self.resonances.covariance is None
            else {
                "order": "Re λ, Im λ of the poles, then of the zeros, rad^4/s^4",
                "matrix": self.resonances.covariance.tolist(),
            },
            "doubtful": [{"kind": r.kind, **r.to_json()} for r in self.doubtful],
            "outside_sweep": [{"kind": r.kind, **r.to_json()} for r in self.outside],
            "noise": None
            if self.noise is None
            else {
                "relative": self.noise.relative,
                "additive_ohm": self.noise.additive,
                "origin": self.noise.origin,
            },
            "reduced_chi_square": self.reduced_chi_square,
            "model": None
            if self.model is None
            else {"modes": int(self.model.poles.size), "background_degree": int(self.model.background.size) - 1},
            "evidence": [
                {"modes": c.modes, "background_degree": c.background_degree, "evidence": c.evidence}
                for c in self.orders
            ],
            "points": len(self.spectrum),
            "points_used": int(np.count_nonzero(self.used)),
            "method": self.method,
            "status": self.status,
            "standard_figures": None if self.figures is None else self.figures.to_json(),
            "notes": [*self.spectrum.notes, *self.notes],
            "remarks": list(self.remarks),
        }
        return as_json(found)
