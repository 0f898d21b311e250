"""`simulate`: specimen file → poles, zeros and a sweep."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from femu_piezo.effects.library import Maker
from femu_piezo.errors import InputError
from femu_piezo.forward.modal import ModalModel
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import reduce_model
from femu_piezo.forward.response import full_impedance
from femu_piezo.measurement.rational_curve import RationalCurve, visible
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.resonances import Resonance
from femu_piezo.specimen.file import Simulation, Specimen
from femu_piezo.study.effects import effects_as_simulated, model_with_effects, simulated_with_effects
from femu_piezo.study.problem import Problem, prepare
from femu_piezo.study.shapes import electrode_notes
from femu_piezo.threads import with_blas_limit

#: Of a specimen with effects: points of the noise-free curve, and how far beyond the sweep it goes.
_POINTS, _BEYOND = (801, 4001), 1.1


@dataclass(frozen=True)
class SimulationResult:
    """Simulated sweep and the driven resonances within it.

    Attributes
    ----------
    effects : names of the [effects] that the sweep includes
    of_sweep_alone : names of effects that poles and zeros leave out: those of how the sweep was taken, such as a high
        drive, under which resonances move from point to point
    """

    specimen: Specimen
    spectrum: ImpedanceSpectrum
    poles: tuple[Resonance, ...]
    zeros: tuple[Resonance, ...]
    unknowns: int
    effects: tuple[str, ...] = ()
    of_sweep_alone: tuple[str, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know of losses and accuracy, as sentences."""
        without_loss = any(pole.loss == 0 for pole in self.poles)
        told = (
            "no loss tangent is given, so the resonances have no width, as those of no measured sweep: give the "
            "material some, such as tan_s11 = 0.015",
        )
        names = " and ".join(self.of_sweep_alone)
        left_out = (f"the sweep includes {names}; poles and zeros do not, as they would move during the sweep",)
        return told * without_loss + left_out * bool(names) + electrode_notes(self.specimen)

    def to_json(self) -> dict:
        """Contents of simulation.json."""
        return {
            "specimen": self.specimen.name,
            "effects": list(self.effects),
            "poles": [resonance.to_json() for resonance in self.poles],
            "zeros": [resonance.to_json() for resonance in self.zeros],
            "unknowns": self.unknowns,
            "notes": list(self.notes),
        }


def sweep_frequencies(problem: Problem) -> np.ndarray:
    """The frequencies of [simulation]; by default 100 Hz to 3.5 times the fundamental, 801 points."""
    wish = problem.specimen.simulation or Simulation()
    stop = wish.stop or max(problem.usual_end_Hz, 2 * wish.lowest)
    spaced = np.geomspace if wish.spacing == "log" else np.linspace
    return spaced(wish.lowest, stop, wish.points)


def visible_resonances(modal: ModalModel, band_Hz: float) -> tuple[tuple[Resonance, ...], tuple[Resonance, ...]]:
    """Poles and zeros of a modal model up to a frequency, modes the terminals cannot see left out."""
    whole = modal.admittance_factor
    return (
        visible("pole", modal.eigenvalues, whole * modal.charges**2, band_Hz),
        visible("zero", modal.zeros[0], -(modal.zero_amplitudes**2) / whole, band_Hz),
    )


@with_blas_limit
def simulate(
    specimen: Specimen, *, full_order: bool = False, effects: Iterable[Maker] | None = None
) -> SimulationResult:
    """Simulate the specimen of a file.

    Parameters
    ----------
    full_order : solve the full model at every frequency instead of the reduced one
    effects : what [effects] may name in addition to the library

    Sweep, poles and zeros are those of the specimen with the effects of its [effects] table, and where a fit left it
    ([fitted]).
    """
    problem = prepare(specimen)
    frequency = sweep_frequencies(problem)
    known = effects_as_simulated(problem, frequency, effects)
    if known and full_order:
        raise InputError(
            f"{specimen.path or specimen.name}: a full-order simulation cannot include [effects] or [fitted]; leave "
            "these tables or --full-order out"
        )
    accuracy = specimen.update.accuracy if specimen.update else 1e-4
    model = problem.model(problem.equivalent_frequency(frequency[-1], accuracy), accuracy)
    if known:
        impedance, (poles, zeros) = _with_effects(problem, model, frequency, known)
    else:
        reduced = reduce_model(model, [problem.fitted], frequency[-1], accuracy=min(1e-6, accuracy / 10))
        e_form = problem.fitted.to_e_form()
        modal = reduced.modal(e_form)
        impedance = full_impedance(model, e_form, frequency) if full_order else modal.impedance(2 * np.pi * frequency)
        poles, zeros = visible_resonances(modal, frequency[-1])
    spectrum = _with_noise(specimen, frequency, impedance)
    alone = tuple(effect.name for effect, _ in known if effect.acquisition is not None)
    return SimulationResult(specimen, spectrum, poles, zeros, model.size, tuple(specimen.effects or ()), alone)


def _with_effects(problem: Problem, model: ElectroelasticModel, frequency: np.ndarray, known):
    """Z (k,) of the sweep, and (poles, zeros) up to its end."""
    low, high = min(frequency[0], 0.2 * problem.expected_pole_Hz), frequency[-1]
    even = np.linspace(low, _BEYOND * high, int(np.clip(2 * frequency.size, *_POINTS)))
    reduced = model_with_effects(problem, model, (low, float(even[-1])), known)
    lasting = [item for item in known if item[0].acquisition is None]
    curve = RationalCurve(even, simulated_with_effects(problem, reduced, even, lasting))
    resonances = curve.resonances("pole", high), curve.resonances("zero", high)
    return simulated_with_effects(problem, reduced, frequency, known), resonances


def _with_noise(specimen: Specimen, frequency: np.ndarray, impedance: np.ndarray) -> ImpedanceSpectrum:
    """Add the relative complex noise that [simulation] asks for."""
    wish = specimen.simulation or Simulation()
    if not wish.noise:
        return ImpedanceSpectrum(frequency, impedance, source=specimen.name)
    normal = np.random.default_rng(wish.seed).standard_normal((2, frequency.size))
    error = wish.noise * (normal[0] + 1j * normal[1]) / np.sqrt(2)
    return ImpedanceSpectrum(
        frequency, impedance * (1 + error), noise=wish.noise * np.abs(impedance), source=specimen.name
    )
