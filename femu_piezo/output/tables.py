"""Tables for the terminal (rich)."""

from __future__ import annotations

from rich.console import Console, Group, RenderableType
from rich.table import Table

from femu_piezo.output.curves import PRINTED
from femu_piezo.study.update import UpdateResult


def number(value: float, std: float | None) -> str:
    """A value with as many digits as its standard deviation deserves."""
    if std is None or not std > 0:
        return f"{value:.6g}"
    digits = max(0, -int(f"{std:.1e}".split("e")[1]) + 1)
    return f"{value:.{digits}f} ± {std:.{digits}f}"


def update_table(result: UpdateResult) -> RenderableType:
    """Parameters against the baseline, and poles and zeros measured against simulated."""
    constants = Table(title=f"{result.problem.specimen.name}: complex material parameters", title_justify="left")
    for heading, justify in (
        ("constant", "left"),
        ("unit", "left"),
        ("baseline", "right"),
        ("updated", "right"),
        ("loss tangent", "right"),
    ):
        constants.add_column(heading, justify=justify)
    for name, estimate in result.parameters.items():
        factor, unit = PRINTED[name]
        before = getattr(result.baseline, name).real * factor
        std = None if estimate.std is None else estimate.std * factor
        constants.add_row(
            name, unit, f"{before:.6g}", number(estimate.value * factor, std), number(estimate.tan, estimate.tan_std)
        )
    resonances = Table(title="pole and zero of the fundamental", title_justify="left")
    for heading in ("", "measured (Hz)", "simulated (Hz)", "measured loss", "simulated loss"):
        resonances.add_column(heading, justify="right")
    for measured, model in zip((result.pair.pole, result.pair.zero), result.model_pair, strict=True):
        resonances.add_row(
            measured.kind,
            number(measured.frequency_Hz, measured.std_Hz),
            f"{model.frequency_Hz:.2f}",
            number(measured.loss, measured.std_loss),
            f"{model.loss:.6f}",
        )
    return Group(constants, resonances, _summary(result))


def _summary(result: UpdateResult) -> str:
    lines = [
        f"method: {result.method}, {len(result.history) - 1} pole-zero iterations; eps33T: {result.permittivity_source}",
        f"rms |Δ log Z|: baseline {100 * result.rms_before:.3g} %, updated {100 * result.rms_after:.3g} %; "
        f"k_eff = {result.pair.k_eff:.4f}; {result.unknowns} unknowns",
    ]
    return "\n".join(lines + [f"note: {note}" for note in result.notes])


def console() -> Console:
    """Terminal output; plain and 110 wide where standard output is no terminal."""
    import sys

    return Console() if sys.stdout.isatty() else Console(width=110, no_color=True, highlight=False)
