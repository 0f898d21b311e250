"""Which mode of the model is which measured resonance: by frequency and by how the terminals drive it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from femu_piezo.errors import ConvergenceError
from femu_piezo.resonances import Resonance

#: Cost of one e-fold of difference in strength, against one e-fold of difference in λ.
_STRENGTH_COST = 0.05


def match(
    measured: Sequence[Resonance], eigenvalues: np.ndarray, amplitudes: np.ndarray, farthest: float | None = None
) -> np.ndarray:
    """Index (k,) of the model mode of each measured resonance, one to one; λ and amplitudes a of the model (m,).

    Minimises Σ |log λ_model/λ_measured| + 0.05 |log strength ratio| over all assignments, where the strength
    |a²/λ| is relative to the strongest of each side; measured strengths come from the residues where known.

    farthest : summand above which a resonance has no mode, −1 in the result; where None, each has one

    Raises ConvergenceError where each has to have one and the model has fewer driven modes than were measured.
    """
    if not measured:
        return np.zeros(0, dtype=int)
    strength = np.abs(amplitudes**2 / eigenvalues)
    usable = np.flatnonzero((eigenvalues.real > 0) & (strength > 1e-9 * strength.max()))
    if usable.size < len(measured) and farthest is None:
        raise ConvergenceError(
            f"the model has {usable.size} driven modes in the band where {len(measured)} were measured: the sweep "
            "shows modes this symmetric plate does not have; check shape, electrodes and dimensions"
        )
    data = np.array([resonance.eigenvalue.real for resonance in measured])
    distance = np.abs(np.log(eigenvalues.real[usable][None, :] / data[:, None]))
    seen = [resonance.residue for resonance in measured]
    if all(residue is not None for residue in seen):
        # residue of Y at a pole ∝ a²/2, of Z at a zero ∝ a²/(2λ): the strength |a²/λ| up to a common factor
        weight = np.log(np.abs(np.array(seen)))
        if measured[0].kind == "pole":
            weight -= np.log(data)
        model = np.log(strength[usable])
        distance += _STRENGTH_COST * np.abs((model - model.max())[None, :] - (weight - weight.max())[:, None])
    if farthest is None:
        return usable[linear_sum_assignment(distance)[1]]
    partners = assigned(distance, farthest)
    return np.array([usable[place] if place >= 0 else -1 for place in partners])


def assigned(cost: np.ndarray, farthest: float) -> np.ndarray:
    """(k,) the column of a cost (k, m) that each row has in the assignment of least total cost; −1 for none.

    farthest : what a row without a column costs, so that a dearer pair is none
    """
    padded = np.hstack([cost, np.full((len(cost), len(cost)), farthest)])
    columns = linear_sum_assignment(padded)[1]
    return np.where(columns < cost.shape[1], columns, -1)
