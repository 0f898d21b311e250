"""Poles, zeros and sensitivities of a specimen with everything that is on: effects, tolerances, leads."""

from __future__ import annotations

import numpy as np

from femu_piezo.inference.free_constants import FreeConstants
from femu_piezo.inference.matching import match
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.sensitivity import Sensitivity
from femu_piezo.inference.terminal_roots import terminal_roots
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.material.constants import D_FORM
from femu_piezo.resonances import Kind, Resonance
from femu_piezo.study.measured import Measured

#: Difference of log λ, a quarter of a frequency, beyond which a mode of the model is not that which was measured.
_FARTHEST = 0.5


def matched_resonances(
    one: Measured, evaluation: Evaluation, unknowns: Unknowns, x: np.ndarray
) -> tuple[tuple[Resonance, Resonance | None], ...]:
    """Every extracted resonance with the model's at x (n_x,); None where the model has none near it."""
    found, modal = one.extraction.resonances, evaluation.modal(unknowns, x)
    kinds: tuple[tuple[Kind, tuple[Resonance, ...], np.ndarray, np.ndarray], ...] = (
        ("pole", found.poles, modal.eigenvalues, modal.charges),
        ("zero", found.zeros, modal.zeros[0], modal.zero_amplitudes),
    )
    result: list[tuple[Resonance, Resonance | None]] = []
    impedance = evaluation.terminals(unknowns, x, modal)
    for kind, data, values, amplitudes in kinds:
        modes = match(data, values, amplitudes, _FARTHEST)
        there = np.flatnonzero(modes >= 0)
        roots = terminal_roots(impedance, kind, np.sqrt(values[modes[there]] + 0j), [data[place] for place in there])
        of_model = {place: Resonance(kind, complex(root**2)) for place, root in zip(there, roots, strict=True)}
        result += [(resonance, of_model.get(place)) for place, resonance in enumerate(data)]
    return tuple(result)


def sensitivity_with_effects(title: str, evaluation: Evaluation, unknowns: Unknowns, x: np.ndarray) -> Sensitivity:
    """∂log Z/∂log θ of all constants at x (n_x,), effects and tolerances kept; zero for constants that are zero."""
    constants = unknowns.material.constants(x[: unknowns.of_material])
    names = tuple(name for name in D_FORM if getattr(constants, name) != 0)
    free = FreeConstants.of(constants, names)
    fixed = (*unknowns.fixed, *zip(unknowns.effects, unknowns.values(x), strict=True))
    z, slopes = evaluation.with_jacobian(*Unknowns.of_constants(free, fixed))
    values = np.zeros((z.size, len(D_FORM)), dtype=complex)
    for index, name in enumerate(names):
        values[:, D_FORM.index(name)] = slopes[:, 2 * index] / z
    return Sensitivity(title, evaluation.omega / (2 * np.pi), z, values)
