"""Where a diagnosis begins: constants near the solution, found on a coarse mesh that knows no effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from femu_piezo.errors import ConvergenceError
from femu_piezo.forward.reduction import reduce_model
from femu_piezo.inference.blocks import CurveData, rms_log_error, weak_prior
from femu_piezo.inference.least_squares import fit
from femu_piezo.inference.unknowns import MaterialParameters
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.specimen.file import Update
from femu_piezo.study.measured import Measured
from femu_piezo.study.model_cache import Bases
from femu_piezo.study.progress import Clock
from femu_piezo.study.update import update_measured

#: Mesh error of the first update, whose constants are only where to begin.
_FIRST_ACCURACY = 1e-3
#: rms |Δ log Z| of a fit from the constants of the file above which an update is tried as well.
_POOR = 0.05


def first_constants(measured: Sequence[Measured], bases: Bases | None = None) -> PiezoConstants:
    """Constants near the solution on a coarse mesh that knows no effects: by a fit from the file's, or by an update.

    The better of the two: the file's constants may be far away; the pole-zero update starts from thin-body formulas,
    which fail where the modes of two dimensions meet.
    """
    attempts = [lambda: _by_update(measured, bases)]
    if not measured[0].problem.constants.physical_faults():
        attempts.insert(0, lambda: _from_file(measured))
    found = []
    for attempt in attempts:
        try:
            found.append(attempt())
        except ConvergenceError as error:
            reason = error
            continue
        if found[-1][0] <= _POOR:
            break
    if not found:
        raise reason
    return min(found, key=lambda item: item[0])[1]


def _by_update(measured: Sequence[Measured], bases: Bases | None) -> tuple[float, PiezoConstants]:
    """rms |Δ log Z| and constants of an update on a coarse mesh."""
    result = update_measured([_plain(one) for one in measured], Clock(None), bases)
    return max(outcome.rms_after for outcome in result.outcomes), result.constants


def _plain(one: Measured) -> Measured:
    specimen = one.problem.specimen
    wish = (specimen.update or Update()).model_copy(update={"accuracy": _FIRST_ACCURACY})
    plain = specimen.model_copy(update={"update": wish, "effects": None})
    return replace(one, problem=replace(one.problem, specimen=plain))


def _from_file(measured: Sequence[Measured]) -> tuple[float, PiezoConstants]:
    """rms |Δ log Z| and constants of a fit of the curves that starts from the constants of the file."""
    free = measured[0].problem.free(measured[0].problem.constants)
    training = free.training_sets(free.start, 0.15)
    curves = []
    for one in measured:
        model = one.problem.model(one.problem.equivalent_frequency(one.band_Hz, _FIRST_ACCURACY), _FIRST_ACCURACY)
        reduced = reduce_model(model, training, one.band_Hz, accuracy=1e-4)
        curves.append(CurveData(one.problem.specimen.name, reduced, one.fitted, np.full(len(one.fitted), 1e-2)))
    material = MaterialParameters.around(free, free.start)
    solution = fit([*curves, weak_prior(material, free.start)], material, free.start, noise_known=False)
    x = material.x_of(solution.theta)
    rms = max(
        rms_log_error(curve.impedance(material, x, curve.spectrum.omega), curve.spectrum.impedance) for curve in curves
    )
    return rms, free.constants(solution.theta)
