"""Tables for the terminal (rich), and the same as plain text and as HTML."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING

from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from femu_piezo.inference.unknowns import Estimate
from femu_piezo.output.curves import PRINTED

if TYPE_CHECKING:
    from femu_piezo.extraction import Extraction
    from femu_piezo.study.identify import IdentifyResult
    from femu_piezo.study.modes import ModesResult
    from femu_piezo.study.results import Outcome, UpdateResult
    from femu_piezo.study.simulate import SimulationResult

#: Width of text that goes to no terminal, characters.
_WIDTH = 110
_HTML = '<pre style="font-family: monospace; line-height: 1.2; white-space: pre">{code}</pre>'


def number(value: float, std: float | None) -> str:
    """A value with as many digits as its standard deviation deserves; eight where that is below 1e-7 of it."""
    if std is None or not std > 0:
        return f"{value:.6g}"
    if std < 1e-7 * abs(value):
        return f"{value:.8g}"
    digits = max(0, -int(f"{std:.1e}".split("e")[1]) + 1)
    return f"{value:.{digits}f} ± {std:.{digits}f}"


def update_table(result: UpdateResult) -> RenderableType:
    """Parameters against the baseline, poles and zeros measured against simulated, and what to know about them."""
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
    lines = [f"method: {result.method}, {result.iterations} pole-zero iterations; eps33T: {result.permittivity_source}"]
    lines += [
        f"{outcome.measured.problem.specimen.name}: rms |Δ log Z| baseline {100 * outcome.rms_before:.3g} %, updated "
        f"{100 * outcome.rms_after:.3g} %; k_eff = {outcome.measured.pair.k_eff:.4f}; {outcome.unknowns} unknowns"
        for outcome in result.outcomes
    ]
    if result.provenance is not None and len(result.outcomes) > 1:
        lines += [f"{name} from {_shares(shares)}" for name, shares in result.provenance.items()]
    return Group(*parts, text_of([*lines, *told(result.notes)]))


def _share_words(estimate: Estimate) -> str:
    """The largest part of the variance, with its share."""
    source = estimate.largest_part
    return f"{source} {100 * (estimate.budget[source] / estimate.std) ** 2:.0f} %" if source else ""


def _shares(shares: dict[str, float]) -> str:
    """Where a constant is known from, shares below 1 % left out."""
    return ", ".join(f"{source} {100 * share:.0f} %" for source, share in shares.items() if share >= 0.01)


def _resonance_table(outcome: Outcome) -> Table:
    table = Table(title=f"{outcome.measured.problem.specimen.name}: poles and zeros", title_justify="left")
    for heading in ("", "measured (Hz)", "simulated (Hz)", "measured loss", "simulated loss"):
        table.add_column(heading, justify="right")
    for measured, model in outcome.matched:
        table.add_row(
            measured.kind,
            number(measured.frequency_Hz, measured.std_Hz),
            f"{model.frequency_Hz:.2f}",
            number(measured.loss, measured.std_loss),
            f"{model.loss:.6f}",
        )
    return table


def _percent(std: float) -> str:
    return f"{100 * std:.2g} %" if std < 10 else "> 1000 %"


def console() -> Console:
    """Terminal output; plain and 110 wide where standard output is no terminal."""
    return Console() if sys.stdout.isatty() else Console(width=_WIDTH, no_color=True, highlight=False)


def as_text(table: RenderableType) -> str:
    """A table as plain text, as the terminal shows it."""
    buffer = io.StringIO()
    Console(file=buffer, width=_WIDTH, no_color=True, highlight=False).print(table)
    return "\n".join(line.rstrip() for line in buffer.getvalue().splitlines())


def as_html(table: RenderableType) -> str:
    """A table as a piece of HTML, as the terminal shows it."""
    recorder = Console(file=io.StringIO(), width=_WIDTH, record=True, highlight=False)
    recorder.print(table)
    return recorder.export_html(inline_styles=True, code_format=_HTML)


def text_of(lines: Iterable[str]) -> Text:
    """Lines as they stand: a bracket in them is no style."""
    return Text("\n".join(lines))


def told(notes: Iterable[str]) -> list[str]:
    """Notes as lines."""
    return [f"note: {note}" for note in notes]


def simulation_table(result: SimulationResult) -> RenderableType:
    """Poles and zeros, and what to know about them."""
    lines = [
        f"{one.kind} {one.frequency_Hz:14.3f} Hz   loss {one.loss:.6f}" for one in (*result.poles, *result.zeros)
    ]
    if result.effects:
        names = ", ".join(result.effects)
        lines.append(f"poles, zeros and sweep are those of the specimen with its effects ({names})")
    return text_of([*lines, *told(result.notes)])


def extraction_table(result: Extraction) -> RenderableType:
    """Poles and zeros with standard deviations, and what to know about them."""
    lines = []
    for one in (*result.resonances.poles, *result.resonances.zeros):
        std = "" if one.std_Hz is None else f" ± {one.std_Hz:.3g}"
        std_loss = "" if one.std_loss is None else f" ± {one.std_loss:.2g}"
        lines.append(
            f"{one.kind} {one.frequency_Hz:14.3f}{std} Hz   loss {one.loss:.6f}{std_loss}   Q {one.quality_factor:.4g}"
        )
    return text_of([*lines, *told((*result.spectrum.notes, *result.notes))])


def modes_table(result: ModesResult) -> RenderableType:
    """Each mode's pole, zero and coupling, and what the body does."""
    lines = []
    for mode in result.modes:
        zero = "" if mode.zero is None else f"   zero {mode.zero.frequency_Hz:14.3f} Hz   k_eff {mode.k_eff:.4f}"
        lines.append(f"pole {mode.pole.frequency_Hz:14.3f} Hz{zero}   {mode.pole_family}")
    return text_of([*lines, *told(result.notes)])


def identifiability_table(result: IdentifyResult) -> RenderableType:
    """Predicted standard deviations of the ten constants, and what to measure next."""
    table = Table(
        title=f"{' + '.join(result.names)}: what a sweep with {100 * result.noise:g} % noise tells",
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
            _percent(known.std[index]),
            _percent(known.std_alone[index]),
            f"{known.std[index + 1]:.2g}" if known.std[index + 1] < 10 else "> 10",
            known.verdict(name),
        )
    lines = [f"least known: {sentence}" for sentence in known.weakest()]
    for item in result.recommendations:
        gained = ", ".join(item.gained) or "no further constant"
        lines.append(f"measure {item.measurement}: determines {gained}")
    lines += result.advice
    return Group(table, text_of(lines))
