"""What `update` returns: the constants, and what they say about each specimen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from femu_piezo.effects.extended_model import ExtendedModel
from femu_piezo.forward.modal import ModalModel
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.inference.fit import Fit
from femu_piezo.inference.identifiability import Identifiability
from femu_piezo.inference.sampling import Samples
from femu_piezo.inference.sensitivity import Sensitivity
from femu_piezo.inference.starts.pole_zero import Step
from femu_piezo.inference.unknowns import Estimate
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.measurement.autoregression import WHITE, Autoregression
from femu_piezo.resonances import Resonance
from femu_piezo.standards.figures import StandardFigures
from femu_piezo.study.measured import Measured
from femu_piezo.study.standard_figures import figures_of
from femu_piezo.study.temperature import TemperatureSeries
from femu_piezo.threads import made_once

#: rms |Δ log Z| of an updated model above which its constants are doubtful, and the same over the noise.
_POOR, _OF_NOISE = 0.01, 5.0


def rms(values: np.ndarray) -> float:
    """Root mean square of |values| (k,)."""
    return float(np.sqrt(np.mean(np.abs(values) ** 2)))


def rms_log_error(model: np.ndarray, data: np.ndarray) -> float:
    """Root mean square of |log Z_model − log Z_data| over a sweep (k,), dimensionless."""
    return rms(np.log(model / data))


def mesh_words(model: ElectroelasticModel, reduced: ExtendedModel) -> str:
    """What the mesh of a model is, in words."""
    mesh, copies = model.domain.mesh, model.domain.copies
    part = "the whole body" if copies == 1 else f"1/{copies} of the body, cut at its mirror planes"
    kind = "hexahedra" if "Hex" in type(mesh).__name__ else "tetrahedra"
    what = f"{mesh.nelements} {kind} of order {model.order} in {part}"
    error = reduced.mesh_error
    words = (
        "" if error is None else f", relative error of the eigenvalues {error.error.max():.0e} (from a change of order)"
    )
    return f"{what}; {model.size} unknowns, reduced to {reduced.size}{words}"


@dataclass(frozen=True)
class Outcome:
    """What the update says about one sweep of a specimen.

    Attributes
    ----------
    matched : (measured, simulated) resonances, poles then zeros; None for one that the model does not have
    base_curve, updated_curve : (n,) complex ohm at the sweep's frequencies
    history : pole-zero iterations on its fundamental
    to_sensitivity : computes `sensitivity`, which only pictures and reports ask for
    unknowns : number of those of the full model;  mesh : description of its mesh and of the reduced model
    constants : the ten constants under the conditions of this sweep
    noise : median relative noise;  noise_memory : autoregression of the errors of neighbouring points
    body : the constants on the body of the file, without what else was fitted (`body_alone`)
    capacitance : of the updated model (`capacitance_stated`)
    """

    measured: Measured
    matched: tuple[tuple[Resonance, Resonance | None], ...]
    base_curve: np.ndarray = field(repr=False)
    updated_curve: np.ndarray = field(repr=False)
    history: tuple[Step, ...] = field(repr=False)
    to_sensitivity: Callable[[], Sensitivity] = field(repr=False)
    unknowns: int
    mesh: str
    constants: PiezoConstants
    body: ModalModel = field(repr=False)
    capacitance: float | None
    noise: float
    noise_memory: Autoregression = WHITE

    @made_once
    def sensitivity(self) -> Sensitivity:
        """Of Z to each of the ten constants at the solution."""
        return self.to_sensitivity()

    @property
    def rms_before(self) -> float:
        """rms |Δ log Z| of the baseline over the whole sweep."""
        return rms_log_error(self.base_curve, self.measured.spectrum.impedance)

    @property
    def rms_after(self) -> float:
        """rms |Δ log Z| of the updated model over the whole sweep."""
        return rms_log_error(self.updated_curve, self.measured.spectrum.impedance)

    @property
    def doubt(self) -> str | None:
        """Why its constants are of little use, in words; None where the model follows the sweep."""
        if self.rms_after <= max(_POOR, _OF_NOISE * self.noise):
            return None
        return (
            f"the updated model differs from the sweep by {100 * self.rms_after:.3g} % rms, and the noise is "
            f"{100 * self.noise:.2g} %"
        )

    def records(self, kind: str) -> list[dict]:
        """The list of poles or zeros in update.json, kind "pole" or "zero"."""
        return [
            {
                "measured": data.to_json(),
                "model": model and {"frequency_Hz": model.frequency_Hz, "loss": model.loss},
            }
            for data, model in self.matched
            if data.kind == kind
        ]


@dataclass(frozen=True)
class UpdateResult:
    """Everything `update` found.

    Attributes
    ----------
    baseline, constants : the ten constants before and after
    parameters : free constant → estimate
    permittivity_source : how ε33T was obtained, in words
    fit : the curve fit, None where the poles and zeros alone were used
    known : what the data tell about each unknown, None without a curve fit
    provenance : constant → share of each sweep and of the prior in what is known of it, None without a curve fit
    seconds : step → time
    temperature : the constants over temperature, None where the sweeps are of one
    samples : samples of the posterior, where they were asked for
    """

    name: str
    baseline: PiezoConstants
    constants: PiezoConstants
    parameters: dict[str, Estimate]
    outcomes: tuple[Outcome, ...]
    permittivity_source: str
    method: str
    fit: Fit | None
    known: Identifiability | None
    provenance: dict[str, dict[str, float]] | None
    notes: tuple[str, ...]
    seconds: dict[str, float]
    temperature: TemperatureSeries | None = None
    samples: Samples | None = None

    @made_once
    def figures(self) -> tuple[tuple[StandardFigures, ...], ...]:
        """Standard figures of each specimen, one for each mode that the standards know; see `standard_figures`."""
        return tuple(
            figures_of(one.measured, one.constants, one.updated_curve, one.capacitance, one.body)
            for one in self.outcomes
        )

    @property
    def doubts(self) -> tuple[str, ...]:
        """`Outcome.doubt` of the sweeps that have one, with their names where there are several sweeps."""
        named = ((one.measured.problem.specimen.name, one.doubt) for one in self.outcomes if one.doubt is not None)
        return tuple(f"{name}: {doubt}" if len(self.outcomes) > 1 else doubt for name, doubt in named)

    @property
    def iterations(self) -> int:
        """Pole-zero iterations made, over all specimens."""
        return sum(len(outcome.history) - 1 for outcome in self.outcomes)

    @property
    def iteration_words(self) -> str:
        """Their number in words, such as "1 pole-zero iteration"."""
        return f"{self.iterations} pole-zero iteration{'' if self.iterations == 1 else 's'}"
