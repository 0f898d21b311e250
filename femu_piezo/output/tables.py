"""Tables for the terminal (rich), and their conversion to plain text and HTML."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from femu_piezo.inference.readings import reading_words
from femu_piezo.inference.unknowns import Estimate
from femu_piezo.material.constants import EPS0
from femu_piezo.output.curves import PRINTED
from femu_piezo.units import decimals, number, signed

if TYPE_CHECKING:
    from femu_piezo.extraction import Extraction
    from femu_piezo.resonances import Resonance
    from femu_piezo.standards.figures import Figure, StandardFigures
    from femu_piezo.study.expectation import Expectation, Improvement
    from femu_piezo.study.identify import IdentifyResult
    from femu_piezo.study.measured import Measured
    from femu_piezo.study.modes import ModesResult
    from femu_piezo.study.noise_study import Setting
    from femu_piezo.study.plan import Plan
    from femu_piezo.study.results import Outcome, UpdateResult
    from femu_piezo.study.simulate import SimulationResult
    from femu_piezo.study.temperature import TemperatureSeries

#: Relative decrease of a deviation from which it is reported.
_WORTH = 0.05
#: Unit of SI → factor and unit in which a tolerance is written.
_WRITTEN = {
    "m": (1e3, "mm"),
    "kg": (1e6, "mg"),
    "rad": (1e3, "mrad"),
    "ohm": (1e3, "mohm"),
    "H": (1e9, "nH"),
    "F": (1e12, "pF"),
}
#: Unit of SI → factor and unit in which a data sheet writes a figure.
_DATA_SHEET = {
    "Hz": (1e-3, "kHz"),
    "1": (1.0, ""),
    "F": (1e12, "pF"),
    "Hz m": (1.0, "Hz m"),
    "m^2/N": (1e12, "10⁻¹² m²/N"),
    "Pa": (1e-9, "GPa"),
    "C/N": (1e12, "10⁻¹² C/N"),
    "F/m": (1 / EPS0, "ε₀"),
}
#: Standard figures that a table of an update states in addition to those by formulas.
_SHORT = ("fs", "fp", "k_eff", "Qm_3dB", "Qm_pole", "C_T", "tan_delta")
#: Width of text that is not written to a terminal, characters.
_WIDTH = 110
#: Names of specimens, sweeps and lots stand in tables as they are: [a] is no style, and :100: no picture.
_PLAIN = {"markup": False, "emoji": False}
_HTML = '<pre style="font-family: monospace; line-height: 1.2; white-space: pre">{code}</pre>'

#: Sources of a deviation in words, where these differ from the key in a record.
_SOURCES = {"held": "held constants", "geometry": "dimensions", "law": "law of a cause", "mesh": "mesh and basis"}


def interval_text(low: float, high: float) -> str:
    """The ends of an interval of 95 %, to the second digit of a quarter of its length."""
    size = max((high - low) / 4, 1e-7 * max(abs(low), abs(high)))
    digits = decimals(size) if size > 0 else 6
    return f"{low:z.{digits}f} to {high:z.{digits}f}"


def update_table(result: UpdateResult) -> RenderableType:
    """Parameters and baseline, poles and zeros measured and simulated, standard figures, method, misfit and notes."""
    constants = Table(title=f"{result.name}: complex material parameters", title_justify="left")
    for heading in ("constant", "unit"):
        constants.add_column(heading)
    for heading in ("baseline", "updated", "loss tangent"):
        constants.add_column(heading, justify="right")
    constants.add_column("± mostly from")
    for name, estimate in result.parameters.items():
        factor, unit = PRINTED[name]
        before = getattr(result.baseline, name).real * factor
        std = None if estimate.std is None else estimate.std * factor
        cells = (f"{before:.6g}", number(estimate.value * factor, std), number(estimate.tan, estimate.tan_std))
        constants.add_row(name, unit, *cells, _share_words(estimate))
    parts = [constants, *(_resonance_table(outcome) for outcome in result.outcomes)]
    for outcome, several in zip(result.outcomes, result.figures, strict=True):
        parts += [figures_table(one, outcome.measured.problem.specimen.name, short=True) for one in several]
    lines = [f"method: {result.method}, {result.iteration_words}{source_of_permittivity(result)}"]
    lines += [
        f"{outcome.measured.problem.specimen.name}: rms |Δ log Z| baseline {100 * outcome.rms_before:.3g} %, updated "
        f"{100 * outcome.rms_after:.3g} %; {_coupling_words(outcome.measured)}{outcome.unknowns} unknowns"
        for outcome in result.outcomes
    ]
    if result.temperature is not None:
        lines += _per_kelvin(result.temperature)
    if result.provenance is not None and len(result.outcomes) > 1:
        lines += [f"{name} from {_shares(shares)}" for name, shares in result.provenance.items()]
    return Group(*parts, text_of([*lines, *reading_words(result.fit), *note_lines(result.notes)]))


def _coupling_words(measured: Measured) -> str:
    """k_eff of the fundamental; nothing where another sweep of the specimen holds that."""
    return f"k_eff = {measured.pair.k_eff:.4f}; " if measured.holds_fundamental else ""


def _per_kelvin(series: TemperatureSeries) -> list[str]:
    """Lines with the temperature coefficients of constants (relative) and of tangents."""
    lines = [f"the constants above are those at {series.reference_C:.4g} °C; their temperature coefficients are"]
    for name, one in series.coefficients.items():
        real, tangent = number(1e6 * one.relative, 1e6 * one.std), number(1e6 * one.tangent, 1e6 * one.tangent_std)
        lines.append(f"  {name} ({real}) ppm/K, its tangent ({tangent}) · 10⁻⁶/K")
    return lines


def figures_table(figures: StandardFigures, name: str = "", *, short: bool = False) -> RenderableType:
    """Standard figures, those of the finite element model, and the errors of the formulas.

    short : without characteristic frequencies that are nearly fs and fp, and meanings; data sheet, report and JSON have
        the whole table
    """
    title = f"{name}: standard figures, {figures.title}" if name else f"standard figures, {figures.title}"
    table = Table(title=title, title_justify="left")
    shown = [one for one in figures.figures if not short or one.name in _SHORT or one.formula_error is not None]
    with_model = any(one.model is not None for one in shown)
    for heading in ("figure", "by standard", *(("finite elements", "deviation") if with_model else ())):
        table.add_column(heading, justify="left" if heading == "figure" else "right")
    if not short:
        table.add_column("meaning")
    for one in shown:
        cells = [one.name, figure_words(one)]
        if with_model:
            cells += [figure_words(one, model=True), deviation_percent(one.deviation)]
        table.add_row(*cells, *([] if short else [one.meaning]))
    sentences = [figures.formula_words] if figures.formula_words else []
    return Group(table, text_of([*sentences, *note_lines(figures.notes)]))


def figure_words(one: Figure, model: bool = False) -> str:
    """The value of a figure, or its value by the model, in the unit of a data sheet; "-" where there is none."""
    value, std = (one.model, None) if model else (one.value, one.std)
    if value is None:
        return "-"
    factor, unit = figure_unit(one)
    text = number(value * factor, None if std is None else std * factor)
    return f"({text}) {unit}" if unit and "±" in text else f"{text} {unit}".strip()


def figure_unit(one: Figure) -> tuple[float, str]:
    """Factor from SI and unit in which a data sheet writes a figure."""
    return figure_scale(one.name, one.unit)


def figure_scale(name: str, unit: str) -> tuple[float, str]:
    """Factor from SI and unit in which a data sheet writes the figure of a name and SI unit."""
    return PRINTED.get(name) or _DATA_SHEET[unit]


def deviation_percent(share: float | None) -> str:
    """A relative deviation in per cent, "" where there is none; below a ten-thousandth of a per cent it is 0 %."""
    if share is None:
        return ""
    if abs(share) < 1e-6:
        return "0 %"
    return f"{100 * share:+.0f} %" if abs(share) >= 1 else f"{100 * share:+.2g} %"


def source_of_permittivity(result: UpdateResult) -> str:
    """Where ε33T comes from, if it was found, or the paper's update took it as known."""
    needed = "eps33T" in result.parameters or result.method == "pole_zero"
    return f"; source of eps33T: {result.permittivity_source}" if needed else ""


def source_words(source: str) -> str:
    """A source of a deviation, a key of `Estimate.budget`, in words."""
    return _SOURCES.get(source, source)


def _share_words(estimate: Estimate) -> str:
    """The largest part of the variance, with its share."""
    source = estimate.largest_part
    share = 100 * (estimate.budget[source] / estimate.std) ** 2 if source else 0.0
    return f"{source_words(source)} {share:.0f} %" if source else ""


def _shares(shares: dict[str, float]) -> str:
    """Sources of the knowledge of a constant with their shares; those below 1 % are left out."""
    return ", ".join(f"{source} {100 * share:.0f} %" for source, share in shares.items() if share >= 0.01)


def _resonance_table(outcome: Outcome) -> Table:
    table = Table(title=f"{outcome.measured.problem.specimen.name}: poles and zeros", title_justify="left")
    for heading in ("", "measured (Hz)", "simulated (Hz)", "measured loss", "simulated loss"):
        table.add_column(heading, justify="right")
    for measured, model in outcome.matched:
        table.add_row(
            measured.kind,
            number(measured.frequency_Hz, measured.std_Hz),
            "not there" if model is None else f"{model.frequency_Hz:.2f}",
            number(measured.loss, measured.std_loss),
            "" if model is None else f"{model.loss:.6f}",
        )
    return table


def std_percent(std: float) -> str:
    """A relative standard deviation in per cent."""
    return f"{100 * std:.2g} %" if std < 0.995 else f"{100 * std:.0f} %" if std < 10 else "> 1000 %"


def console() -> Console:
    """Terminal output; plain and 110 wide where standard output is no terminal."""
    return Console(**_PLAIN) if sys.stdout.isatty() else Console(width=_WIDTH, no_color=True, highlight=False, **_PLAIN)


def as_text(table: RenderableType) -> str:
    """A table as plain text, as the terminal shows it."""
    buffer = io.StringIO()
    Console(file=buffer, width=_WIDTH, no_color=True, highlight=False, **_PLAIN).print(table)
    return "\n".join(line.rstrip() for line in buffer.getvalue().splitlines())


def as_html(table: RenderableType) -> str:
    """A table as a piece of HTML, as the terminal shows it."""
    recorder = Console(file=io.StringIO(), width=_WIDTH, record=True, highlight=False, **_PLAIN)
    recorder.print(table)
    return recorder.export_html(inline_styles=True, code_format=_HTML)


def text_of(lines: Iterable[str]) -> Text:
    """Lines as plain text, whose brackets rich does not take for styles."""
    return Text("\n".join(lines))


def note_lines(notes: Iterable[str]) -> list[str]:
    """Notes as lines that begin with "note:"."""
    return [f"note: {note}" for note in notes]


def simulation_table(result: SimulationResult) -> RenderableType:
    """Poles and zeros, and notes."""
    lines = [f"{one.kind} {one.frequency_Hz:14.3f} Hz   loss {one.loss:z.6f}" for one in (*result.poles, *result.zeros)]
    if names := ", ".join(name for name in result.effects if name not in result.of_sweep_alone):
        lines.append(f"poles, zeros and sweep are those of the specimen with its effects ({names})")
    return text_of([*lines, *note_lines(result.notes)])


def extraction_table(result: Extraction) -> RenderableType:
    """Poles and zeros with standard deviations, notes, and standard figures where there are some."""
    sound = (*result.resonances.poles, *result.resonances.zeros)
    lines = [_resonance_words(one) for one in sound]
    lines += [f"{_resonance_words(one)}   doubtful" for one in result.doubtful]
    why_no_figures = result.remarks[-1:] if result.pairs and result.figures is None else ()  # why there are no figures
    text = text_of([*lines, *note_lines((*result.spectrum.notes, *result.notes, *why_no_figures))])
    return text if result.figures is None else Group(text, figures_table(result.figures))


def _resonance_words(resonance: Resonance) -> str:
    frequency, loss = f"{resonance.frequency_Hz:.3f}", f"{resonance.loss:z.6f}"
    if resonance.std_Hz is not None:
        frequency, loss = with_deviations(resonance)
    return f"{resonance.kind} {frequency:>20} Hz   loss {loss:24}   Q {resonance.quality_factor:.4g}"


def with_deviations(resonance: Resonance) -> tuple[str, str]:
    """Frequency in Hz and loss of a resonance, each with its standard deviation."""
    return number(resonance.frequency_Hz, resonance.std_Hz), number(resonance.loss, resonance.std_loss)


def modes_table(result: ModesResult) -> RenderableType:
    """Each mode's pole, zero and coupling, and what the body does."""
    lines = []
    for mode in result.modes:
        zero = "" if mode.zero is None else f"   zero {mode.zero.frequency_Hz:14.3f} Hz   k_eff {mode.k_eff:.4f}"
        lines.append(f"pole {mode.pole.frequency_Hz:14.3f} Hz{zero}   {mode.pole_family}")
    return text_of([*lines, *note_lines(result.notes)])


def identifiability_table(result: IdentifyResult) -> RenderableType:
    """Predicted standard deviations of the ten constants, and what to measure next."""
    table = Table(
        title=f"{' + '.join(result.names)}: constants from a sweep with {100 * result.noise:g} % noise",
        title_justify="left",
    )
    table.add_column("constant")
    for heading in ("std, others ±50 %", "std, others known", "std of tangent", "determined"):
        table.add_column(heading, justify="right")
    known = result.known
    for index, name in enumerate(known.names):
        if name.startswith("tan_"):
            continue
        table.add_row(
            name,
            std_percent(known.std[index]),
            std_percent(known.std_alone[index]),
            f"{known.std[index + 1]:.2g}" if known.std[index + 1] < 10 else "> 10",
            known.verdict(name),
        )
    lines = [_sweep_words(one.title, one.frequency) for one in result.sensitivities]
    lines += [f"least known combination: {sentence}" for sentence in known.weakest()]
    useful = [item for item in result.recommendations if item.gained]
    lines += [f"measure {item.measurement}: determines {', '.join(item.gained)}" for item in useful]
    if result.recommendations and not useful:
        lines.append("no further sweep of another body that was tried would determine another constant")
    lines += [*result.advice, *(f"note: {note}" for note in result.notes), *_study_lines(result.study)]
    parts = [table, text_of(lines), *expectation_tables(result.expected)]
    return Group(*parts) if result.plan is None else Group(*parts, _plan_table(result.plan, result.expected))


def _plan_table(plan: Plan, expected: Expectation) -> Table:
    """Deviations that an update would state after the planned sweep, and after other sweeps to compare.

    With three digits, since tolerances of the specimen may hide most of the gain.
    """
    points = len(plan.frequency)
    words = {"equal": f"{points} equally spaced", "equal, four times": f"{4 * points} equally spaced"}
    words |= {"plan": f"plan, {points} points", "dense at resonances": f"{points}, half of them at resonances"}
    table = Table(title="planned sweep (plan.csv): standard deviations of an update", title_justify="left")
    table.add_column("sweep")
    for label in plan.expected["plan"]:
        table.add_column(label, justify="right")
    for name, std in plan.expected.items():
        table.add_row(words[name], *(deviation_words(label, expected, value, 3) for label, value in std.items()))
    return table


def _study_lines(settings: Sequence[Setting]) -> list[str]:
    """Deviations, bias and coverage that the study found, a line for each noise and number of points."""
    lines = (
        []
        if not settings
        else ["specimens drawn at random within the tolerances, updated with the values of the file:"]
    )
    for one in settings:
        setting = f"  noise {100 * one.noise:.2g} %, {one.points} points"
        if not len(one.error):
            lines.append(f"{setting}: none of {one.lost} fits converged")
            continue
        parts = []
        for index, label in enumerate(one.labels):
            if label.startswith("tan_"):
                continue
            size = abs(one.values[index])
            stated = float(np.median(one.stated[:, index]))
            parts.append(
                f"{label} {100 * one.deviation[index] / size:.2g} % (stated {100 * stated / size:.2g} %, bias "
                f"{signed(one.bias[index], '.1f')} σ of the mean)"
            )
        lost = f", {one.lost} fits did not converge" if one.lost else ""
        inside = " and ".join(f"{100 * np.mean(one.inside(sigma)):.0f} %" for sigma in (1, 2))
        lines.append(
            f"{setting}: {', '.join(parts)}; {inside} of the true values within 1 and 2 stated deviations{lost}"
        )
    return lines


def _sweep_words(name: str, frequency: np.ndarray) -> str:
    low, high = (f"{value:.6g} Hz" if value < 1e3 else f"{value / 1e3:.6g} kHz" for value in frequency[[0, -1]])
    return f"sweep of {name}: {frequency.size} points from {low} to {high} ([simulation] in its file)"


def expectation_tables(expected: Expectation) -> list[RenderableType]:
    """Deviations of the free constants that an update would state, and which tolerance to improve first."""
    stated = Table(
        title="standard deviations that an update would state, with the tolerances of the file", title_justify="left"
    )
    for heading in ("constant", "std", "mostly from", "std of tangent", "mostly from"):
        stated.add_column(heading, justify="right" if heading.startswith("std") else "left")
    for name, one in expected.parameters.items():
        cells = (deviation_words(label, expected) for label in (name, f"tan_{name}"))
        parts = (_parts_words(one.budget, one.std), _parts_words(one.tan_budget, one.tan_std))
        stated.add_row(name, *(word for pair in zip(cells, parts, strict=True) for word in pair))
    gains = Table(title="which tolerance to improve first: each halved by itself", title_justify="left")
    for heading in ("tolerance", "today -> halved", "constants", "loss tangents"):
        gains.add_column(heading)
    rows = [(one, _gain_words(one, expected, False), _gain_words(one, expected, True)) for one in expected.improvements]
    shrinking = [(one, *words) for one, *words in rows if any(words)]
    for one, *words in shrinking:
        of = f" of {one.specimen}" if one.specimen else ""
        sizes = f"{tolerance_words(one, one.today)} -> {tolerance_words(one, one.today / 2)}"
        gains.add_row(f"{one.tolerance}{of}", sizes, *words)
    rest = len(rows) - len(shrinking)
    more = (
        [f"halving any of the other {rest} tolerances reduces no standard deviation by {100 * _WORTH:g} % or more"]
        if rest
        else []
    )
    return [stated, gains, text_of(more)]


def deviation_words(label: str, expected: Expectation, std: float | None = None, digits: int = 2) -> str:
    """Deviation of a constant in % of its value, or of a tangent ("tan_s11"); the expected one where `std` is None."""
    one = expected.parameters[label.removeprefix("tan_")]
    if label.startswith("tan_"):
        return f"{one.tan_std if std is None else std:.{digits}g}"
    return f"{100 * (one.std if std is None else std) / abs(one.value):.{digits}g} %"


def _gain_words(improvement: Improvement, expected: Expectation, tangents: bool) -> str:
    """Lines for the deviations that halving a tolerance shrinks by `_WORTH` or more, the largest gain first."""
    labels = [
        label
        for label in improvement.before
        if label.startswith("tan_") == tangents and improvement.shrinks(label) >= _WORTH
    ]
    return "\n".join(
        f"{label} {deviation_words(label, expected)} -> {deviation_words(label, expected, improvement.halved[label])}"
        for label in sorted(labels, key=lambda label: -improvement.shrinks(label))
    )


def tolerance_words(one: Improvement, size: float) -> str:
    """A tolerance as one writes it in a specimen file: 0.02 mm, 0.5 %, 10 nH."""
    if one.unit == "1":
        return f"{size:.3g}" if one.tolerance.startswith("std_tan_") else f"{100 * size:.3g} %"
    factor, unit = _WRITTEN[one.unit]
    return f"{factor * size:.3g} {unit}"


def _parts_words(budget: Mapping[str, float], std: float) -> str:
    """The parts of a variance above a tenth, the largest first."""
    shares = sorted(((part / std) ** 2, source) for source, part in budget.items())[::-1]
    return ", ".join(f"{source_words(source)} {100 * share:.0f} %" for share, source in shares if share > 0.1)
