"""Poles, zeros and sensitivities of a specimen with everything that is on: effects, tolerances, leads."""

from __future__ import annotations

import numpy as np

from femu_piezo.errors import ConvergenceError
from femu_piezo.forward.fundamental import dominant_index
from femu_piezo.inference.matching import match
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.sensitivity import Sensitivity
from femu_piezo.inference.terminal_roots import terminal_roots
from femu_piezo.inference.unknowns import FreeConstants, MaterialParameters, Unknowns, material_prior
from femu_piezo.material.constants import D_FORM
from femu_piezo.resonances import Resonance
from femu_piezo.study.measured import Measured


def matched_resonances(
    one: Measured, evaluation: Evaluation, unknowns: Unknowns, x: np.ndarray
) -> tuple[tuple[Resonance, Resonance], ...]:
    """Every extracted resonance with the model's at x (n_x,); only the fundamental where the model has fewer modes.

    Nothing where it has fewer and the sweep does not hold the fundamental.
    """
    found, modal = one.extraction.resonances, evaluation.modal(unknowns, x)
    kinds = (
        ("pole", found.poles, modal.eigenvalues, modal.charges, one.pair.pole),
        ("zero", found.zeros, modal.zeros[0], modal.zero_amplitudes, one.pair.zero),
    )
    try:
        pairs = [(kind, data, values[match(data, values, amplitudes)]) for kind, data, values, amplitudes, _ in kinds]
    except ConvergenceError:
        if not one.holds_fundamental:
            return ()
        near = one.pair.pole.frequency_Hz
        pairs = [
            (kind, (data,), values[[dominant_index(values, amplitudes, near)]])
            for kind, _, values, amplitudes, data in kinds
        ]
    result, impedance = [], evaluation.terminals(unknowns, x, modal)
    for kind, data, values in pairs:
        roots = terminal_roots(impedance, kind, np.sqrt(values + 0j), data)
        result += [(r, Resonance(kind, complex(root**2))) for r, root in zip(data, roots, strict=True)]
    return tuple(result)


def sensitivity_with_effects(title: str, evaluation: Evaluation, unknowns: Unknowns, x: np.ndarray) -> Sensitivity:
    """∂log Z/∂log θ of all constants at x (n_x,), effects and tolerances kept; zero for constants that are zero."""
    constants = unknowns.material.constants(x[: unknowns.of_material])
    names = tuple(name for name in D_FORM if getattr(constants, name) != 0)
    free = FreeConstants.of(constants, names)
    material = MaterialParameters.around(free, free.start)
    fixed = (*unknowns.fixed, *zip(unknowns.effects, unknowns.values(x), strict=True))
    every = Unknowns(material, material_prior(free, {}, {}), fixed=fixed)
    z, slopes = evaluation.with_jacobian(every, material.x_of(free.start))
    values = np.zeros((z.size, len(D_FORM)), dtype=complex)
    for index, name in enumerate(names):
        values[:, D_FORM.index(name)] = slopes[:, 2 * index] / z
    return Sensitivity(title, evaluation.omega / (2 * np.pi), z, values)
