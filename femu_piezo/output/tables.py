"""Tables for the terminal (rich)."""

from __future__ import annotations

from rich.console import Console, Group, RenderableType
from rich.table import Table

from femu_piezo.output.curves import PRINTED
from femu_piezo.study.identify import IdentifyResult
from femu_piezo.study.results import Outcome, UpdateResult


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
    for name, estimate in result.parameters.items():
        factor, unit = PRINTED[name]
        before = getattr(result.baseline, name).real * factor
        std = None if estimate.std is None else estimate.std * factor
        constants.add_row(
            name, unit, f"{before:.6g}", number(estimate.value * factor, std), number(estimate.tan, estimate.tan_std)
        )
    parts = [constants, *(_resonance_table(outcome) for outcome in result.outcomes)]
    lines = [f"method: {result.method}, {result.iterations} pole-zero iterations; eps33T: {result.permittivity_source}"]
    lines += [
        f"{outcome.measured.problem.specimen.name}: rms |Δ log Z| baseline {100 * outcome.rms_before:.3g} %, updated "
        f"{100 * outcome.rms_after:.3g} %; k_eff = {outcome.measured.pair.k_eff:.4f}; {outcome.unknowns} unknowns"
        for outcome in result.outcomes
    ]
    if result.provenance is not None and len(result.outcomes) > 1:
        lines += [f"{name} from {_shares(shares)}" for name, shares in result.provenance.items()]
    return Group(*parts, "\n".join(lines + [f"note: {note}" for note in result.notes]))


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
    import sys

    return Console() if sys.stdout.isatty() else Console(width=110, no_color=True, highlight=False)


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
    return Group(table, "\n".join(lines))
