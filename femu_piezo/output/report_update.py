"""The sections that an update brings to a report: what was found, how well, and what the data cannot tell."""

from __future__ import annotations

import html
from pathlib import Path

import numpy as np

from femu_piezo.material.constants import D_FORM
from femu_piezo.output.budget_chart import budget_figure, budget_shares
from femu_piezo.output.corner import corner_figure
from femu_piezo.output.curves import PRINTED
from femu_piezo.output.records import update_record
from femu_piezo.output.report import (
    Cell,
    Section,
    inputs_of,
    notes,
    paragraph,
    picture,
    provenance_section,
    table,
    write_report,
)
from femu_piezo.output.report_curves import curve_charts, sensitivity_chart
from femu_piezo.output.report_figures import standard_figures_html
from femu_piezo.output.report_modes import mode_section
from femu_piezo.output.tables import source_of_permittivity, source_words
from femu_piezo.output.temperature_chart import temperature_figure
from femu_piezo.specimen.geometry import Geometry
from femu_piezo.study.results import Outcome, UpdateResult
from femu_piezo.units import number, signed

#: What each constant is, for readers who do not have the notation by heart.
MEANING = {
    "s11": "elastic compliance across the poling",
    "s12": "cross compliance, both directions across the poling",
    "s13": "cross compliance, along and across the poling",
    "s33": "elastic compliance along the poling",
    "s44": "shear compliance in planes through the poling axis",
    "d31": "strain across the poling per field",
    "d33": "strain along the poling per field",
    "d15": "shear strain per field across the poling",
    "eps11T": "free permittivity across the poling",
    "eps33T": "free permittivity along the poling",
}
_VERDICT = {"well": "determined well", "weakly": "determined weakly", "not": "not determined"}


def write_update_report(path: Path, result: UpdateResult, command: str = "femu-piezo update") -> None:
    """Write the report of an update; the embedded record is that of update.json."""
    count = len(result.outcomes)
    subtitle = f"Complex material parameters from {'a measured sweep' if count == 1 else f'{count} measured sweeps'}"
    sections = [*update_sections(result), update_provenance(result, command)]
    write_report(path, result.name, subtitle, sections, update_record(result))


def update_sections(result: UpdateResult) -> list[Section]:
    """Summary, parameters, constants over temperature, samples of the posterior, curves, resonances, standard figures,
    identifiability, sensitivity, mode shapes."""
    many = len(result.outcomes) > 1
    curves, resonances, sensitivities, figures = "", "", "", ""
    for index, outcome in enumerate(result.outcomes):
        heading = f"<h3>{index + 1}: {_escaped(outcome)}</h3>" if many else ""
        curves += heading + "".join(chart.html() for chart in curve_charts(outcome))
        resonances += heading + _resonances(outcome, index)
        figures += heading + "".join(
            standard_figures_html(one, f"specimens.{index}.standard_figures.{mode}")
            for mode, one in enumerate(result.figures[index])
        )
        sensitivities += heading + sensitivity_chart(outcome).html()
    return [
        Section("summary", "Summary", _summary(result)),
        Section("parameters", "Parameters", _parameters(result)),
        *_further_sections(result),
        Section("curves", "Curves", curves),
        Section("resonances", "Poles and zeros", resonances),
        Section("figures", "Standard figures", figures),
        Section("identifiability", "What the data determine", _identifiability(result)),
        Section("sensitivity", "Sensitivity", sensitivities),
        mode_section(result),
    ]


def _further_sections(result: UpdateResult) -> list[Section]:
    """The constants over temperature, and samples of the posterior, where there are any."""
    found = []
    if (series := result.temperature) is not None:
        words = f"Constants over temperature; all other sections give the constants at {series.reference_C:.4g} °C"
        figure = temperature_figure(result.name, series)
        found.append(Section("temperature", "Over temperature", picture(figure, words)))
    if result.samples is not None:
        words = (
            "Samples of the posterior from fits to randomly drawn data; the lines are the stated standard deviations"
        )
        figure = corner_figure(result.name, result.samples, result.parameters)
        found.append(Section("samples", "Samples", picture(figure, words)))
    return found


def _escaped(outcome: Outcome) -> str:
    return html.escape(outcome.measured.problem.specimen.name)


def _frequency(value: float) -> str:
    return f"{value / 1e6:.6g} MHz" if value >= 1e6 else f"{value / 1e3:.6g} kHz" if value >= 1e3 else f"{value:.6g} Hz"


def _summary(result: UpdateResult) -> str:
    found = "; ".join(_sentence(name, result) for name in result.parameters)
    parts = [paragraph(f"Found: {found}.", "key")]
    for outcome in result.outcomes:
        measured, pair = outcome.measured, outcome.measured.pair
        frequency = measured.spectrum.frequency
        fundamental = (
            f"series resonance (pole) at {_frequency(pair.pole.frequency_Hz)} with "
            f"Q = {pair.pole.quality_factor:.4g}, parallel resonance (zero) at {_frequency(pair.zero.frequency_Hz)} "
            f"with Q = {pair.zero.quality_factor:.4g}, effective coupling k_eff = {pair.k_eff:.4f}"
            if measured.holds_fundamental
            else "the fundamental is not in this sweep"
        )
        parts.append(
            paragraph(
                f"{measured.problem.specimen.name}: {len(measured.spectrum)} points from {_frequency(frequency[0])} to "
                f"{_frequency(frequency[-1])}; {fundamental}. The root mean square difference between simulated and "
                f"measured log Z is {100 * outcome.rms_before:.3g} % with the baseline and "
                f"{100 * outcome.rms_after:.3g} % with the updated constants."
            )
        )
    parts.append(paragraph(_method(result)))
    return "".join(parts) + notes(result.notes)


def _sentence(name: str, result: UpdateResult) -> str:
    estimate, (factor, unit) = result.parameters[name], PRINTED[name]
    std = None if estimate.std is None else estimate.std * factor
    return f"{name} = ({number(estimate.value * factor, std)}) {unit}, loss {number(estimate.tan, estimate.tan_std)}"


def _method(result: UpdateResult) -> str:
    if result.method == "pole_zero":
        fitted = (
            f"the first pole and zero of the finite element model were fitted to the measured ones in "
            f"{result.iteration_words} with exact sensitivities (Cong, Hu, Li 2022)"
            if result.iterations
            else "all poles and zeros of the finite element model that have a measured partner were fitted to it "
            "together (Cong, Hu, Li 2022, appendix A)"
        )
        return (
            f"Method: {fitted}{source_of_permittivity(result)}. The rest of the curve was not fitted and serves as a "
            "test."
        )
    return (
        f"Method: {result.iteration_words}, then a maximum-likelihood fit of the whole measured "
        f"curve{source_of_permittivity(result)}."
    )


def _parameters(result: UpdateResult) -> str:
    values, tangents = [], []
    for name, estimate in result.parameters.items():
        factor, unit = PRINTED[name]
        before = getattr(result.baseline, name).real
        std = None if estimate.std is None else estimate.std * factor
        key = f"parameters.{name}"
        values.append(
            (
                name,
                MEANING[name],
                unit,
                f"{before * factor:.6g}",
                Cell(number(estimate.value * factor, std), f"{key}.value", estimate.value),
                Cell(_interval(estimate.value, estimate.std, factor), f"{key}.std", estimate.std),
                f"{signed(100 * (estimate.value / before - 1), '.2f')} %" if before else "",
            )
        )
        tangents.append(
            (
                name,
                f"{result.baseline.tangent(name) + 0.0:.4g}",
                Cell(number(estimate.tan, estimate.tan_std), f"{key}.tan", estimate.tan),
                Cell(_interval(estimate.tan, estimate.tan_std, 1.0), f"{key}.tan_std", estimate.tan_std),
            )
        )
    words = (
        "A complex constant is value·(1 − j tan), time factor exp(jωt). ± is one standard deviation; the interval "
        "extends 1.96 standard deviations to either side. "
    ) + (
        "They include the noise of the sweep and the tolerances of the specimen file, as in the budget below."
        if any(estimate.budget for estimate in result.parameters.values())
        else "They include the noise of the sweep alone: errors of dimensions, density or held constants add to them."
    )
    interval = "95 % interval"
    return (
        table(("", "meaning", "unit", "baseline", "updated", interval, "change"), values, "Real parts", "parameters")
        + table(("", "baseline", "updated", interval), tangents, "Loss tangents")
        + paragraph(words)
        + _budget(result)
    )


def _budget(result: UpdateResult) -> str:
    """Where the uncertainty of each constant comes from: a chart of its variance, and the largest parts in words."""
    shares = budget_shares(result.parameters)
    if not shares:
        return ""
    largest = {label: max(parts, key=parts.__getitem__) for label, parts in shares.items()}
    words = ", ".join(
        f"{label} {source_words(source)} {100 * shares[label][source]:.0f} %" for label, source in largest.items()
    )
    figure = budget_figure("Uncertainty budget: shares of the variance by source", result.parameters)
    return picture(figure, f"Sources of the standard deviations, as shares of the variance; the largest: {words}.")


def _interval(value: float, std: float | None, factor: float) -> str:
    if std is None:
        return "unknown"
    low, high = (value - 1.96 * std) * factor, (value + 1.96 * std) * factor
    digits = max(0, 1 - int(np.floor(np.log10(abs(std * factor))))) if std > 0 else 6
    return f"{min(low, high):.{min(digits, 9)}f} … {max(low, high):.{min(digits, 9)}f}"


def _resonances(outcome: Outcome, index: int) -> str:
    rows, counts = [], {"pole": 0, "zero": 0}
    for data, model in outcome.matched:
        key = f"specimens.{index}.{data.kind}s.{counts[data.kind]}"
        counts[data.kind] += 1
        frequency: tuple[Cell | str, str] = ("not there", "")
        losses: tuple[Cell | str, str] = ("", "")
        if model is not None:
            difference, loss = model.frequency_Hz - data.frequency_Hz, model.loss - data.loss
            frequency = (
                Cell(f"{model.frequency_Hz:.2f}", f"{key}.model.frequency_Hz", model.frequency_Hz),
                f"{signed(1e6 * difference / data.frequency_Hz, '.1f')} ppm{_in_sigma(difference, data.std_Hz)}",
            )
            losses = (
                Cell(f"{model.loss:.6f}", f"{key}.model.loss", model.loss),
                f"{signed(100 * loss / data.loss, '.2f')} %{_in_sigma(loss, data.std_loss)}",
            )
        rows.append(
            (
                data.kind,
                Cell(number(data.frequency_Hz, data.std_Hz), f"{key}.measured.frequency_Hz", data.frequency_Hz),
                *frequency,
                Cell(number(data.loss, data.std_loss), f"{key}.measured.loss", data.loss),
                *losses,
                f"{data.quality_factor:.4g}",
            )
        )
    headings = (
        "", "measured (Hz)", "simulated (Hz)", "difference", "measured loss", "simulated loss", "difference", "Q",
    )  # fmt: skip
    words = (
        "Pole: pole of the admittance, series resonance, short circuit. Zero: zero of the admittance, parallel "
        "resonance, open circuit. λ = ω²(1 + jη): the frequency is √(Re λ)/2π, the loss η = 1/Q."
    )
    return table(headings, rows) + paragraph(words)


def _in_sigma(difference: float, std: float | None) -> str:
    return "" if not std else f" ({signed(difference / std, '.2g')} σ)"


def _identifiability(result: UpdateResult) -> str:
    parts = []
    known = result.known
    if known is None:
        parts.append(
            paragraph(
                "One complex pole and one complex zero determine two complex constants exactly, and the low-frequency "
                "capacitance determines the permittivity: only the rest of the curve can contradict them."
                if result.iterations
                else "The poles and zeros determine the constants together with the prior knowledge of the specimen "
                "file. Of a constant whose deviation comes mostly from the prior in the budget, they tell little."
            )
        )
    else:
        rows = [
            (name, _VERDICT[known.verdict(name)], _size(known.std[index]), _size(known.std_alone[index]))
            for index, name in enumerate(known.names)
        ]
        headings = ("unknown", "verdict", "std", "std with all others known")
        caption = "From the data with only a weak prior; real parts relative to their value, tangents absolute"
        parts.append(table(headings, rows, caption, "words"))
        parts += [paragraph(f"Least known combination: {sentence}.") for sentence in known.weakest(1)]
        parts += [
            paragraph(f"The errors of {first} and {second} are strongly correlated ({signed(value, '.3f')}).")
            for first, second, value in known.confounded()
        ]
    return "".join(parts) + _held_fixed(result)


def _size(std: float) -> str:
    return f"{std:.2g}" if std < 10 else "over 10"


def _held_fixed(result: UpdateResult) -> str:
    """The constants that were not free, and how much the sweep would notice an error in each."""
    fixed = [name for name in D_FORM if name not in result.parameters and getattr(result.constants, name) != 0]
    if not fixed:
        return ""
    rows = []
    for name in fixed:
        factor, unit = PRINTED[name]
        column = D_FORM.index(name)
        largest = max(float(np.max(np.abs(one.sensitivity.values[:, column]))) for one in result.outcomes)
        value = getattr(result.constants, name)
        rows.append((name, MEANING[name], f"{value.real * factor:.5g} {unit}", f"{largest:.2g} %"))
    headings = ("constant", "meaning", "held at", "largest change of Z by 1 % error")
    return table(headings, rows, "Constants held fixed: an error in them causes an error of the result", "words")


def update_provenance(result: UpdateResult, command: str) -> Section:
    """Inputs with checksums, density and dimensions as used, mesh, times."""
    inputs, facts = [], [("command", command)]
    for outcome in result.outcomes:
        problem = outcome.measured.problem
        specimen = problem.specimen
        inputs += inputs_of(specimen)
        given = {key: value for key, value in specimen.geometry if value is not None and key != "density"}
        words = ", ".join(f"{key} {_stated(key, value)}" for key, value in given.items())
        facts.append((f"body of {specimen.name}", f"{words}; density {problem.density:.6g} kg/m³"))
        facts.append((f"mesh of {specimen.name}", outcome.mesh))
    times = ", ".join(f"{step} {seconds:.3g} s" for step, seconds in result.seconds.items())
    return provenance_section(inputs, [*facts, ("times", times)])


def _stated(key: str, value: object) -> str:
    """A value of [geometry] with its unit."""
    factor, unit = {"m": (1e3, "mm"), "kg": (1e3, "g"), "1": (1e2, "%")}.get(Geometry.si_unit(key) or "", (1.0, ""))
    if isinstance(value, tuple):
        return f"({', '.join(f'{factor * part:.6g}' for part in value)}) {unit}".strip()
    return f"{factor * value:.6g} {unit}".strip() if isinstance(value, float) else str(value)
