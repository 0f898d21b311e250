"""What a simulation gets wrong, resonance by resonance: Δf, ΔQ and Δk_eff of every pole and zero.

Measured and simulated curve pass through the same extraction, over the same frequencies and with the same noise, so
that both carry the same leads, stray capacitance and truncation; only then are they compared.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femu_piezo.extraction import Extraction, extract
from femu_piezo.inference.matching import assigned
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.resonances import Kind, Resonance

#: Two resonances are one mode where (Δ ln f / 0.05)² + (Δ ln |residue| / ln 10)² < 1.
_FREQUENCY, _RESIDUE = 0.05, np.log(10.0)
#: A resonance that has no partner counts where its half width is more than this times the σ of its frequency.
_CLEAR = 5.0


@dataclass(frozen=True)
class Coupling:
    """k_eff of a pole with its zero, and its standard deviation (None where unknown)."""

    value: float
    std: float | None


@dataclass(frozen=True)
class Difference:
    """One measured resonance against its simulated partner; simulated − measured.

    Attributes
    ----------
    model : None where the simulation has no such resonance
    couplings : (measured, simulated) k_eff of a pole; None where either has no zero beside it
    """

    measured: Resonance
    model: Resonance | None
    couplings: tuple[Coupling, Coupling] | None = None

    @property
    def frequency(self) -> tuple[float, float | None] | None:
        """Δf in % and in σ of the measurement."""
        return (
            None if self.model is None else _difference(self.model, self.measured, "frequency_Hz", self.measured.std_Hz)
        )

    @property
    def quality(self) -> tuple[float, float | None] | None:
        """ΔQ in % and in σ of the measurement."""
        loss, std = self.measured.loss, self.measured.std_loss
        return (
            None
            if self.model is None
            else _difference(self.model, self.measured, "quality_factor", None if std is None else std / loss**2)
        )

    @property
    def coupling(self) -> tuple[float, float | None] | None:
        """Δk_eff in % and in σ of the measurement."""
        if self.couplings is None:
            return None
        measured, model = self.couplings
        return _difference(model, measured, "value", measured.std)

    def to_json(self) -> dict | None:
        """Simulated resonance and differences; None where there is no partner."""
        if self.model is None:
            return None
        record: dict = {"frequency_Hz": self.model.frequency_Hz, "loss": self.model.loss}
        if self.couplings is not None:
            record["k_eff"] = self.couplings[1].value
        for name, change in (("frequency", self.frequency), ("Q", self.quality), ("k_eff", self.coupling)):
            if change is not None:
                record[f"{name}_percent"], record[f"{name}_sigma"] = change
        return record


@dataclass(frozen=True)
class PoleZeroResiduals:
    """A simulated curve against a measured one.

    Attributes
    ----------
    poles, zeros : every measured resonance, in order of frequency
    extra : clear resonances of the simulation that the measurement does not have
    """

    poles: tuple[Difference, ...]
    zeros: tuple[Difference, ...]
    extra: tuple[Resonance, ...]

    @property
    def unexplained(self) -> tuple[Resonance, ...]:
        """Clear measured resonances that the simulation does not have."""
        return tuple(d.measured for d in (*self.poles, *self.zeros) if d.model is None and _clear(d.measured))

    def to_json(self) -> dict:
        """Resonances without partner."""
        return {
            "measured_only": [{"kind": r.kind, **r.to_json()} for r in self.unexplained],
            "simulated_only": [{"kind": r.kind, "frequency_Hz": r.frequency_Hz, "loss": r.loss} for r in self.extra],
        }


def pole_zero_residuals(measured: Extraction, relative_noise: np.ndarray, curve: np.ndarray) -> PoleZeroResiduals:
    """Extract a simulated curve as the measured one was, and match the two.

    Parameters
    ----------
    measured : extraction of the measured sweep of k points
    relative_noise : (k,) least relative noise that the simulated curve is weighted by
    curve : (k,) simulated Z at the same frequencies, ohm
    """
    spectrum = measured.spectrum
    sigma = relative_noise
    if measured.noise is not None:
        sigma = np.maximum(sigma, measured.noise.std(spectrum.impedance) / np.abs(spectrum.impedance))
    simulated = ImpedanceSpectrum(spectrum.frequency, curve, sigma * np.abs(curve), "simulated curve")
    model = extract(simulated, start=measured.model)
    poles, extra_poles = _matched(measured, model, "pole")
    zeros, extra_zeros = _matched(measured, model, "zero")
    return PoleZeroResiduals(poles, zeros, tuple(r for r in (*extra_poles, *extra_zeros) if _clear(r)))


def _matched(
    measured: Extraction, model: Extraction, kind: Kind
) -> tuple[tuple[Difference, ...], tuple[Resonance, ...]]:
    """Differences of all measured resonances of a kind, and simulated ones inside the sweep that nothing matches."""
    wanted, inside = (getattr(one.resonances, f"{kind}s") for one in (measured, model))
    outside = tuple(r for r in model.outside if r.kind == kind)
    partners = match([*wanted], [*inside, *outside])
    # a simulated resonance at the end of the sweep may have its measured partner just outside
    beyond = match([*inside], [r for r in measured.outside if r.kind == kind])
    differences = []
    for resonance, place in zip(wanted, partners, strict=True):
        partner = None if place is None else (*inside, *outside)[place]
        differences.append(Difference(resonance, partner, _couplings(measured, model, resonance, partner)))
    extra = [r for i, r in enumerate(inside) if i not in partners and beyond[i] is None]
    return tuple(differences), tuple(extra)


def match(first: list[Resonance], second: list[Resonance]) -> list[int | None]:
    """For each resonance of the first list the index of its partner in the second, by least total distance."""
    if not first or not second:
        return [None] * len(first)
    cost = np.array([[_distance(a, b) for b in second] for a in first])
    partners = assigned(np.minimum(cost, 1e3), farthest=1.0)
    return [int(place) if place >= 0 else None for place in partners]


def _distance(a: Resonance, b: Resonance) -> float:
    far = (np.log(a.frequency_Hz / b.frequency_Hz) / _FREQUENCY) ** 2
    if a.residue and b.residue:
        far += (np.log(abs(a.residue) / abs(b.residue)) / _RESIDUE) ** 2
    return float(far)


def _couplings(
    measured: Extraction, model: Extraction, resonance: Resonance, partner: Resonance | None
) -> tuple[Coupling, Coupling] | None:
    found = [_coupling(measured, resonance), None if partner is None else _coupling(model, partner)]
    return None if None in found else (found[0], found[1])


def _coupling(extraction: Extraction, pole: Resonance) -> Coupling | None:
    for pair in extraction.pairs:
        if pair.pole is pole and np.isfinite(pair.k_eff):
            return Coupling(pair.k_eff, pair.std_k_eff if np.isfinite(pair.std_k_eff) else None)
    return None


def _clear(resonance: Resonance) -> bool:
    std = resonance.std_Hz
    return std is not None and resonance.frequency_Hz * abs(resonance.loss) / 2 > _CLEAR * std


def _difference(model, measured, name: str, std: float | None) -> tuple[float, float | None]:
    """Simulated less measured attribute `name`: in % of the measured one, and over its σ."""
    new, old = getattr(model, name), getattr(measured, name)
    return 100 * (new / old - 1), (new - old) / std if std else None
