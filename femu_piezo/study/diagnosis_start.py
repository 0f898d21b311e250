"""Where a diagnosis begins: constants near the solution, found on a coarse mesh that knows no effects."""

from __future__ import annotations

import numpy as np

from femu_piezo.errors import ConvergenceError
from femu_piezo.forward.reduction import reduce_model
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.specimen import Specimen, Update
from femu_piezo.study.measured import Measured
from femu_piezo.study.update import update
from femu_piezo.updating.data import CurveData, weak_prior
from femu_piezo.updating.least_squares import fit
from femu_piezo.updating.parameters import MaterialParameters

#: Mesh error of the first update, whose constants are only where to begin.
_FIRST_ACCURACY = 1e-3
#: rms |Δ log Z| of the first update above which a fit from the constants of the file is tried as well.
_POOR = 0.05


def first_constants(specimen: Specimen, measured: Measured) -> PiezoConstants:
    """Constants near the solution on a coarse mesh that knows no effects: by an update, or by a fit from the file's.

    The better of the two: the pole-zero update starts from thin-body formulas, which fail where the modes of two
    dimensions meet; the file's constants may be far away.
    """
    wish = (specimen.update or Update()).model_copy(update={"accuracy": _FIRST_ACCURACY})
    plain = specimen.model_copy(update={"update": wish, "effects": None})
    problem, found = measured.problem, []
    try:
        result = update(plain)
        found.append((result.outcomes[0].rms_after, result.constants))
    except ConvergenceError as error:
        reason = error
    if not found or found[0][0] > _POOR:
        highest = problem.equivalent_frequency(measured.band_Hz, _FIRST_ACCURACY)
        free = problem.free(problem.constants)
        training = free.training_sets(free.start, 0.15)
        reduced = reduce_model(problem.model(highest, _FIRST_ACCURACY), training, measured.band_Hz, accuracy=1e-4)
        curve = CurveData("first", reduced, measured.fitted, np.full(len(measured.fitted), 1e-2))
        material = MaterialParameters.around(free, free.start)
        try:
            solution = fit([curve, weak_prior(material, free.start)], material, free.start, noise_known=False)
            rms = float(np.sqrt(np.mean(solution.residual**2))) * 1e-2
            found.append((rms, free.constants(solution.theta)))
        except ConvergenceError as error:
            reason = error
    if not found:
        raise reason
    return min(found, key=lambda item: item[0])[1]
