"""`simulate`: specimen file → poles, zeros and a sweep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.forward.modal import ModalModel
from femu_piezo.forward.reduction import reduce_model
from femu_piezo.forward.response import full_impedance
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.resonances import Resonance
from femu_piezo.specimen import Simulation, Specimen
from femu_piezo.study.effects import simulated_with_effects
from femu_piezo.study.inputs import Problem, prepare

#: Share of the strongest mode's |a²/λ| below which a mode is not listed: the terminals do not see it.
_VISIBLE = 1e-4


@dataclass(frozen=True)
class SimulationResult:
    """Simulated sweep and the driven resonances within it."""

    specimen: Specimen
    spectrum: ImpedanceSpectrum
    poles: tuple[Resonance, ...]
    zeros: tuple[Resonance, ...]
    unknowns: int

    def to_json(self) -> dict:
        """Contents of simulation.json."""
        return {
            "specimen": self.specimen.name,
            "poles": [resonance.to_json() for resonance in self.poles],
            "zeros": [resonance.to_json() for resonance in self.zeros],
            "unknowns": self.unknowns,
        }


def sweep_frequencies(problem: Problem) -> np.ndarray:
    """The frequencies of [simulation]; by default 100 Hz to 3.5 times the fundamental, 801 points."""
    wish = problem.specimen.simulation or Simulation()
    start = wish.start or 100.0
    stop = wish.stop or max(3.5 * problem.expected_pole_Hz, 2 * start)
    spaced = np.geomspace if wish.spacing == "log" else np.linspace
    return spaced(start, stop, wish.points)


def visible_resonances(modal: ModalModel, band_Hz: float) -> tuple[tuple[Resonance, ...], tuple[Resonance, ...]]:
    """Poles and zeros of a modal model up to a frequency, modes the terminals cannot see left out."""

    def listed(kind, values, amplitudes):
        weight = np.abs(amplitudes**2 / values)
        frequency = np.sqrt(np.abs(values.real)) / (2 * np.pi)
        inside = (frequency <= band_Hz) & (values.real > 0)
        strong = inside & (weight > _VISIBLE * weight[inside].max(initial=0.0))
        return tuple(Resonance(kind, complex(value)) for value in values[strong])

    return (
        listed("pole", modal.eigenvalues, modal.charges),
        listed("zero", modal.zeros[0], modal.zero_amplitudes),
    )


def simulate(specimen: Specimen, *, full_order: bool = False) -> SimulationResult:
    """Simulate the specimen of a file.

    Parameters
    ----------
    full_order : solve the full model at every frequency instead of the reduced one

    The effects of an [effects] table change the sweep; poles and zeros stay those of the bare body.
    """
    problem = prepare(specimen)
    if specimen.effects and full_order:
        raise InputError(f"{specimen.path or specimen.name}: a full-order simulation knows no [effects]; leave one out")
    frequency = sweep_frequencies(problem)
    accuracy = specimen.update.accuracy if specimen.update else 1e-4
    model = problem.model(problem.equivalent_frequency(frequency[-1], accuracy), accuracy)
    reduced = reduce_model(model, [problem.constants], frequency[-1], accuracy=min(1e-6, accuracy / 10))
    e_form = problem.constants.to_e_form()
    modal = reduced.modal(e_form)
    impedance = full_impedance(model, e_form, frequency) if full_order else modal.impedance(2 * np.pi * frequency)
    if specimen.effects:
        impedance = simulated_with_effects(problem, model, frequency)
    poles, zeros = visible_resonances(modal, frequency[-1])
    return SimulationResult(specimen, _with_noise(specimen, frequency, impedance), poles, zeros, model.size)


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
