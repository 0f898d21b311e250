"""The content of diagnosis.json and curves.csv, and the picture of the residuals of base and final model."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
from matplotlib.figure import Figure

from femu_piezo.diagnosis.comparison import Comparison
from femu_piezo.diagnosis.verdict import Cause
from femu_piezo.effects.effect import Effect
from femu_piezo.inference.readings import read_beside
from femu_piezo.output.curves import BASELINE, GRID, MEASURED, UPDATED, frequency_axis
from femu_piezo.output.diagnosis_words import answer
from femu_piezo.output.picture import Picture, as_it_stands
from femu_piezo.study.diagnose import DiagnosedSweep, Diagnosis


def diagnosis_record(result: Diagnosis) -> dict:
    """The content of diagnosis.json, JSON types."""
    verdict, comparison = result.verdict, result.comparison
    return {
        "specimen": result.piece.name,
        "specimens": list(dict.fromkeys(sweep.measured.piece.name for sweep in result.sweeps)),
        "verdict": verdict.word,
        "answers": _answers(result),
        "causes": [_cause_record(cause) for cause in verdict.causes],
        "candidates": _candidates(result),
        "gain": result.gain,
        "parameters": {
            "before": {name: e.to_json() for name, e in result.before.items()},
            "after": {name: e.to_json() for name, e in result.after.items()},
        },
        **_pole_zero(result.sweeps[result.shown]),
        "sweeps": [
            {
                "specimen": sweep.specimen.name,
                **_pole_zero(sweep),
                "standard_figures": [one.to_json() for one in sweep.figures],
            }
            for sweep in result.sweeps
        ],
        "recommended_measurements": list(verdict.measurements),
        "separations": [one.to_json() for one in result.separations],
        "remaining": {
            "before": _remaining(verdict.before),
            "after": _remaining(verdict.after),
            "unexplained": verdict.unexplained,
        },
        "linear_body": None if result.linear_body is None else asdict(result.linear_body),
        "not_visible": [
            {"effect": effect.title, "indistinguishable_from": [constant]} for effect, constant in verdict.hidden
        ],
        "noise": {
            "relative": float(np.median(result.relative_noise)),
            "origin": "file" if comparison.base.data.noise_known else "estimated from the sweep",
            "correlations": [list(one.correlations) for one in comparison.base.data.noise_memory],
        },
        "discrepancy": _discrepancy(comparison),
        "forms": [_cause_record(form) for form in verdict.forms],
        "tolerances": _tolerances(result),
        "readings": read_beside(comparison.final),
        "rules": comparison.rules.to_json(),
        "model": {
            "unknowns": result.unknowns,
            "reduced": result.reduced_size,
            "mesh": {one.specimen.name: one.mesh for one in result.sweeps},
        },
        "notes": list(result.notes),
        "seconds": result.seconds,
    }


def _answers(result: Diagnosis) -> dict:
    """The headline and the four groups of sentences of the report."""
    said = answer(result)
    return {
        "headline": said.headline,
        "wrong": list(said.wrong),
        "sure": list(said.sure),
        "constants": list(said.constants),
        "measures": list(said.measures),
    }


def _cause_record(cause: Cause) -> dict:
    return {
        "effect": cause.effect.name,
        "specimen": cause.effect.owner or None,
        "parameters": _sizes(cause.effect, cause.values, cause.std),
        "probability": cause.probability,
        "indistinguishable_from": list(cause.indistinguishable_from),
        "sentence": cause.effect.sentence,
        "law": cause.effect.law or None,
    }


def _discrepancy(comparison: Comparison) -> dict | None:
    """Form, its parameter, size and log evidence of the discrepancy of the final fit; None where it has none."""
    discrepancy = comparison.final.discrepancy
    if discrepancy is None:
        return None
    key_of_form = {
        "smooth": "length",
        "of every resonance": "strength_over_frequency",
        "a resonance of its own": "frequency_Hz",
        "a step": "frequency_Hz",
    }
    return {
        "form": discrepancy.form,
        key_of_form[discrepancy.form]: discrepancy.place,
        "sigma": discrepancy.sigma,
        "log_evidence": discrepancy.log_evidence,
    }


def _tolerances(result: Diagnosis) -> list[dict]:
    """The effects that have a tolerance, with their values in the final fit."""
    final = result.comparison.final
    return [
        {"effect": effect.title, "tolerance": effect.tolerance.tolist(), "parameters": _sizes(effect, values, std)}
        for effect, values, std in zip(
            final.parameters.effects, final.parameters.values(final.x), final.std_of_effects, strict=True
        )
        if effect.key not in final.parameters.candidates
    ]


def _pole_zero(sweep: DiagnosedSweep) -> dict:
    """Every measured pole and zero with its differences from base and final model, and resonances without partner."""
    before, after = sweep.pole_zero
    record: dict = {
        kinds: [
            {"measured": old.measured.to_json(), "before": old.to_json(), "after": new.to_json()}
            for old, new in zip(getattr(before, kinds), getattr(after, kinds), strict=True)
        ]
        for kinds in ("poles", "zeros")
    }
    return record | {"unexplained": {"before": before.to_json(), "after": after.to_json()}}


def _remaining(remaining) -> dict:
    return {
        "structured": remaining.structured,
        "size": remaining.size,
        "p_size": remaining.p_size,
        "p_white": remaining.p_white,
        "worst_Hz": [list(band) for band in remaining.worst_Hz],
    }


def _candidates(result: Diagnosis) -> list[dict]:
    """Every candidate, fitted alone with constants and tolerances, best first; "evidence" is its log odds over none."""
    hidden = {effect.key: constant for effect, constant in result.verdict.hidden}
    records = []
    for trial in result.comparison.singles:
        effect, fit = trial.effect, trial.fit
        record = {
            "effect": effect.name,
            "variant": effect.variant or None,
            "law": effect.law or None,
            "converged": fit is not None,
            "indistinguishable_from": [hidden[effect.key]] if effect.key in hidden else [],
        }
        if fit is not None:
            record |= {
                "parameters": _sizes(effect, trial.values, trial.std),
                "evidence": trial.log_odds,
                "chi_square": fit.chi_square,
                "left_out_sigma": fit.held_out.rms,
                "on_bound": list(fit.on_bound),
            }
        records.append(record)
    return sorted(records, key=lambda record: -record.get("evidence", -np.inf))


def _sizes(effect: Effect, values: np.ndarray, std: np.ndarray) -> dict:
    """Parameter of an effect → value, standard deviation and unit."""
    return {
        p.name: {"value": float(value), "std": float(sigma), "unit": p.unit}
        for p, value, sigma in zip(effect.parameters, values, std, strict=True)
    }


def curves_text(result: Diagnosis) -> str:
    """CSV of the sweep shown: Z measured, of base and of final model, σ in ohm, and whether the fits used the point."""
    spectrum, (before, after) = result.spectrum, result.curves
    columns = {"frequency_Hz": spectrum.frequency}
    for name, z in (("measured", spectrum.impedance), ("before", before), ("after", after)):
        columns |= {f"{name}_resistance_ohm": z.real, f"{name}_reactance_ohm": z.imag}
    columns["noise_ohm"] = result.relative_noise * np.abs(spectrum.impedance)
    columns["fitted"] = result.fitted.astype(int)
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    return "\n".join([",".join(columns), *(",".join(map(repr, row)) for row in rows)]) + "\n"


def diagnosis_figure(result: Diagnosis) -> Figure:
    """|Z| measured and modelled, and the residuals of base and extended model in σ."""
    figure = Picture(figsize=(8.0, 8.5), layout="constrained")
    magnitude, before, after = figure.subplots(3, 1, sharex=True, height_ratios=[3, 2, 2])
    spectrum, sigma = result.spectrum, result.relative_noise / np.sqrt(2)
    factor, label, scale = frequency_axis(spectrum.frequency)
    x = spectrum.frequency * factor
    magnitude.semilogy(x, np.abs(spectrum.impedance), label="measured", **MEASURED)
    magnitude.semilogy(x, np.abs(result.curves[0]), label="base model, updated", **BASELINE)
    # the name of the specimen that has the effect stands in its title
    named = as_it_stands(" and ".join(one.effect.title.replace("_", " ") for one in result.verdict.extension))
    if named:
        magnitude.semilogy(x, np.abs(result.curves[1]), label="extended model", **UPDATED)
    panels = (
        (before, result.curves[0], "base model"),
        (after, result.curves[1], named and f"extended model, with {named}"),
    )
    for axes, curve, words in panels:
        error = np.log(curve / spectrum.impedance) / sigma
        axes.axhspan(-2, 2, color="#dfe8df", zorder=0)
        axes.plot(x, error.real, ".", color="#1f4e79", markersize=3, label="log |Z|")
        axes.plot(x, error.imag, ".", color="#d98032", markersize=3, label="phase")
        limit = max(5.0, 1.1 * float(np.max(np.abs([error.real, error.imag]))))
        axes.set(ylabel="residual (σ)", ylim=(-limit, limit), yscale="symlog" if limit > 30 else "linear")
        axes.set_title(words or "no effect named: final model is the base model", fontsize=10, loc="left")
    if not np.all(result.fitted):
        unseen = x[~result.fitted]
        for axes in (magnitude, before, after):
            axes.axvspan(unseen[0], unseen[-1], color="#f3e6c4", zorder=0)
    words = {"none": "explained within the noise", "effect": named, "unknown": "misfit that no candidate explains"}
    magnitude.set(
        ylabel="|Z| (Ω)", xscale=scale, title=f"{as_it_stands(result.specimen.name)}: {words[result.verdict.word]}"
    )
    magnitude.legend(frameon=False, fontsize=9)
    before.legend(frameon=False, fontsize=9, ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderpad=0.1)
    after.set_xlabel(label)
    for axes in (magnitude, before, after):
        axes.grid(True, **GRID)
    return figure
