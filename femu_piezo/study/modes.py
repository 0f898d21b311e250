"""`modes`: the driven modes of a specimen in a band, poles and zeros, with their shapes and what they are in words."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from femu_piezo.effects.library import Maker
from femu_piezo.errors import InputError
from femu_piezo.forward.mode_family import family, real_phase
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import reduce_model
from femu_piezo.resonances import Resonance, effective_coupling
from femu_piezo.specimen.file import Specimen
from femu_piezo.study.effects import body_as_simulated, effects_as_simulated
from femu_piezo.study.problem import Problem, prepare
from femu_piezo.study.shapes import electrode_notes
from femu_piezo.study.simulate import visible_resonances
from femu_piezo.units import two_hertz

#: Share of the strongest mode's |a²/λ| below which a mode is not shown: the terminals hardly see it.
_VISIBLE = 1e-3
#: Largest estimated error of the reduced model from which the modes are taken.
_REDUCTION_ERROR = 1e-6


@dataclass(frozen=True)
class DrivenMode:
    """A pole and the zero that belongs to it.

    Attributes
    ----------
    pole, zero : short- and open-circuit resonance; zero None where none lies between this pole and the next
    pole_family, zero_family : what the body does, in words
    participation : share of the pole in the sum of |a²/λ| over the modes shown
    pole_vector, zero_vector : (m,) complex free unknowns of the model
    """

    pole: Resonance
    zero: Resonance | None
    pole_family: str
    zero_family: str | None
    participation: float
    pole_vector: np.ndarray = field(repr=False)
    zero_vector: np.ndarray | None = field(repr=False)

    @property
    def k_eff(self) -> float | None:
        """Effective coupling factor of the pair (IEEE 176); None without a zero."""
        return None if self.zero is None else effective_coupling(self.pole, self.zero)

    def to_json(self) -> dict:
        """Pole, zero, families and k_eff, JSON types only."""
        record = {
            "pole": _record(self.pole, self.pole_family),
            "zero": None if self.zero is None else _record(self.zero, self.zero_family),
            "k_eff": self.k_eff,
            "participation": self.participation,
        }
        return record


def _record(resonance: Resonance, words: str) -> dict:
    return {"frequency_Hz": resonance.frequency_Hz, "loss": resonance.loss, "family": words}


@dataclass(frozen=True)
class ModesResult:
    """The modes of a specimen in a band (Hz), and the model that their vectors belong to.

    left_out : names of those of its [effects] that are not in the constants, dimensions and density of the body
    weak : number of modes of the band that the terminals hardly see, which are not shown
    """

    specimen: Specimen
    model: ElectroelasticModel = field(repr=False)
    modes: tuple[DrivenMode, ...]
    band: tuple[float, float]
    left_out: tuple[str, ...] = ()
    weak: int = 0

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know of the accuracy, as sentences."""
        notes = electrode_notes(self.specimen)
        if self.left_out:
            notes += (f"{self.specimen.name}: the modes are those of the body without {', '.join(self.left_out)}",)
        if self.weak:
            modes = "one mode is" if self.weak == 1 else f"{self.weak} modes are"
            notes += (
                f"{self.specimen.name}: {modes} left out, with less than {100 * _VISIBLE:g} % of the participation of "
                "the strongest; `simulate` lists what a sweep shows of them",
            )
        return notes

    def to_json(self) -> dict:
        """Contents of modes.json."""
        return {
            "specimen": self.specimen.name,
            "band_Hz": list(self.band),
            "unknowns": self.model.size,
            "notes": list(self.notes),
            "modes": [mode.to_json() for mode in self.modes],
        }


def modes(
    specimen: Specimen,
    *,
    band: tuple[float, float] | None = None,
    count: int | None = None,
    effects: Iterable[Maker] | None = None,
) -> ModesResult:
    """The driven modes of a specimen, its constants, dimensions and density as [effects] and [fitted] leave them.

    Parameters
    ----------
    band : (low, high) Hz; where None from zero to 3.5 times the expected fundamental, or to the end of the sweep that
        the file simulates where that is lower and not below all modes
    count : number of modes, the lowest ones; all where None
    effects : what [effects] may name in addition to the library

    Raises
    ------
    InputError : the specimen cannot be computed, or the band holds no driven mode
    """
    problem = prepare(specimen)
    if count is not None and count < 1:
        raise InputError(f"count = {count} is no number of modes; give 1 at least")
    usual, simulated = problem.usual_end_Hz, specimen.simulation.stop if specimen.simulation else None
    low, high = (0.0, min(usual, simulated or usual)) if band is None else two_hertz(band, "band")
    if not 0 <= low < high:
        raise InputError(f"{low:g} … {high:g} Hz is no band; give the lower frequency first")
    problem, hidden = body_as_simulated(problem, effects_as_simulated(problem, np.array([low, high]), effects))
    model = _model(problem, max(high, problem.expected_pole_Hz))
    reduced_to = max(1.3 * high, 1.5 * problem.expected_pole_Hz)
    reduced = reduce_model(model, [problem.constants], reduced_to, accuracy=_REDUCTION_ERROR)
    modal = reduced.modal(problem.constants.to_e_form())
    poles = _driven("pole", modal.eigenvalues, modal.charges, reduced.basis @ modal.states[:, 1:], reduced_to)
    open_states = reduced.basis @ modal.zero_states()
    zeros = _driven("zero", modal.zeros[0], modal.zero_amplitudes, open_states, reduced_to)
    pairs = [pair for pair in _pairs(poles, zeros) if low <= pair[0][0].frequency_Hz <= high][:count]
    if not pairs and band is None and high < usual:  # the file simulates less
        return modes(specimen, band=(0.0, usual), count=count, effects=effects)
    if not pairs:
        raise InputError(
            f"{specimen.path or specimen.name}: no driven mode lies between {low:.6g} and {high:.6g} Hz; the first is "
            f"expected near {problem.expected_pole_Hz:.4g} Hz, so give another band"
        )
    total = sum(pole[2] for pole, _ in pairs)
    found = tuple(_mode(model, pole, zero, total) for pole, zero in pairs)
    left_out = tuple(name for name in specimen.effects or () if name in hidden)
    seen = [one for one in visible_resonances(modal, high)[0] if low <= one.frequency_Hz <= high]
    weak = 0 if count is not None else max(len(seen) - len(pairs), 0)
    return ModesResult(specimen, model, found, (low, high), left_out, weak)


def _model(problem: Problem, high: float) -> ElectroelasticModel:
    accuracy = problem.specimen.update.accuracy if problem.specimen.update else 1e-4
    return problem.model(problem.equivalent_frequency(high, accuracy), accuracy)


#: Resonance, its vector (m,), |a²/λ|
_Found = tuple[Resonance, np.ndarray, float]


def _driven(kind, eigenvalues, amplitudes, vectors, highest: float) -> list[_Found]:
    """(resonance, vector, |a²/λ|) of the modes the terminals see, in order of frequency."""
    weight = np.abs(amplitudes**2 / eigenvalues)
    frequency = np.sqrt(np.abs(eigenvalues.real)) / (2 * np.pi)
    inside = (frequency <= highest) & (eigenvalues.real > 0)
    if not inside.any():
        return []
    chosen = np.flatnonzero(inside & (weight > _VISIBLE * weight[inside].max()))
    chosen = chosen[np.argsort(eigenvalues[chosen].real)]
    return [(Resonance(kind, complex(eigenvalues[i])), real_phase(vectors[:, i]), float(weight[i])) for i in chosen]


def _pairs(poles: list[_Found], zeros: list[_Found]) -> list[tuple[_Found, _Found | None]]:
    """Each pole with the strongest zero below the next pole: the others belong to modes that are not shown."""
    pairs = []
    for index, pole in enumerate(poles):
        above = poles[index + 1][0].frequency_Hz if index + 1 < len(poles) else np.inf
        between = [zero for zero in zeros if pole[0].frequency_Hz < zero[0].frequency_Hz <= above]
        pairs.append((pole, max(between, key=lambda zero: zero[2], default=None)))
    return pairs


def _mode(model: ElectroelasticModel, pole: _Found, zero: _Found | None, total: float) -> DrivenMode:
    return DrivenMode(
        pole=pole[0],
        zero=None if zero is None else zero[0],
        pole_family=family(model, pole[1]),
        zero_family=None if zero is None else family(model, zero[1]),
        participation=pole[2] / total,
        pole_vector=pole[1],
        zero_vector=None if zero is None else zero[1],
    )
