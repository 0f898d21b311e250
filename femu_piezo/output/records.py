"""Machine-readable results: the JSON contracts of the commands."""

from __future__ import annotations

from femu_piezo.inference.readings import read_beside
from femu_piezo.resonances import Resonance
from femu_piezo.standards.figures import StandardFigures
from femu_piezo.study.results import Outcome, UpdateResult


def update_record(result: UpdateResult) -> dict:
    """The content of update.json, JSON types; poles and zeros are of the first specimen, under "specimens" of each."""
    first = result.outcomes[0]
    record = {
        "specimen": result.name,
        "parameters": {name: estimate.to_json() for name, estimate in result.parameters.items()},
        "poles": first.records("pole"),
        "zeros": first.records("zero"),
        "iterations": result.iterations,
        "converged": True,  # an update that does not converge raises ConvergenceError and writes nothing
        "method": result.method,
        "permittivity": result.permittivity_source,
        "constants": {
            name: {"value": value.real, "tan": result.constants.tangent(name)}
            for name, value in result.constants.as_dict().items()
        },
        "specimens": [
            _specimen_record(outcome, result, figures)
            for outcome, figures in zip(result.outcomes, result.figures, strict=True)
        ],
        "notes": list(result.notes),
        "seconds": result.seconds,
    }
    if result.fit is not None:
        record["fit"] = {
            "reduced_chi_square": result.fit.chi_square / result.fit.freedom,
            "noise_scale": result.fit.noise_scale,
            "discrepancy": None if result.fit.discrepancy is None else result.fit.discrepancy.sigma,
        }
        if result.fit.parameters.readings:
            record["readings"] = read_beside(result.fit)
    if result.samples is not None:
        record["samples"] = {
            "count": len(result.samples.values),
            "interval_68": {
                label: list(result.samples.interval(label))
                for name in result.parameters
                for label in (name, f"tan_{name}")
            },
        }
    if result.temperature is not None:
        record["temperature"] = result.temperature.to_json()
    if result.provenance is not None:
        record["provenance"] = result.provenance
    if result.known is not None:
        record["identifiability"] = {
            "unknowns": {name: result.known.verdict(name) for name in result.known.names},
            "singular_values": [float(value) for value in result.known.singular_values],
            "weakest_combinations": result.known.weakest(),
            "correlated": [list(pair) for pair in result.known.confounded()],
        }
    return record


def _specimen_record(outcome: Outcome, result: UpdateResult, figures: tuple[StandardFigures, ...]) -> dict:
    return {
        "name": outcome.measured.problem.specimen.name,
        "density": outcome.measured.problem.density,
        "poles": outcome.records("pole"),
        "zeros": outcome.records("zero"),
        "rms_log_error": {"baseline": outcome.rms_before, "updated": outcome.rms_after},
        "history": [
            {
                "constants": {
                    name: {"value": getattr(step.constants, name).real, "tan": step.constants.tangent(name)}
                    for name in result.parameters
                },
                "pole": _eigenvalue("pole", step.eigenvalues[0]),
                "zero": _eigenvalue("zero", step.eigenvalues[1]),
            }
            for step in outcome.history
            if len(outcome.history) > 1
        ],
        "unknowns": outcome.unknowns,
        "standard_figures": [one.to_json() for one in figures],
    }


def _eigenvalue(kind, eigenvalue: complex) -> dict[str, float]:
    resonance = Resonance(kind, complex(eigenvalue))
    return {"frequency_Hz": resonance.frequency_Hz, "loss": resonance.loss}
