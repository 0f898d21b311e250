"""Parts of several pages."""

from __future__ import annotations

from pathlib import Path

from nicegui import ui

from femu_piezo.output.tables import figure_scale
from femu_piezo.units import number as printed
from femu_piezo.web.site import Site

#: Endings of the files of results that have a link.
_LINKED = (".html", ".json", ".csv", ".txt", ".png", ".pdf", ".toml", ".cir", ".s1p")


def figure_rows(figures: dict, model: bool = False) -> list[tuple[str, ...]]:
    """Rows (name, value, value of the finite elements where `model`, meaning) of standard figures of a JSON record."""
    rows = []
    for name, one in figures["figures"].items():
        factor, unit = figure_scale(name, one["unit"])
        std = None if one["std"] is None else one["std"] * factor
        cells = [name, "-" if one["value"] is None else f"{printed(one['value'] * factor, std)} {unit}".strip()]
        if model:
            cells.append("-" if one["model"] is None else f"{printed(one['model'] * factor, None)} {unit}".strip())
        rows.append((*cells, one["meaning"]))
    return rows


def chart(figure: dict, words: str) -> ui.plotly:
    """A figure whose height is reserved before it is drawn, so that the page below does not move."""
    found = ui.plotly(figure).classes("w-full").style(f"min-height: {figure['layout']['height']}px")
    return found.props(f'role="img" aria-label="{words}"')


def report_links(site: Site, folder: Path) -> None:
    """Links to what a command wrote."""
    if not folder.is_dir():
        return
    with ui.row().classes("gap-4 items-center"):
        ui.label("Files:")
        for path in sorted(folder.iterdir()):
            if path.suffix in _LINKED and not path.name.startswith("."):
                ui.link(path.name, site.address(site.workspace.name(path)), new_tab=True)


def framed(address: str, words: str) -> None:
    """A page of results in a sandboxed frame, without access to this page."""
    frame = ui.element("iframe").props(f'src="{address}" title="{words}" sandbox="allow-scripts allow-downloads"')
    frame.classes("w-full border rounded bg-white").style("height: 75vh")


def notes(sentences) -> None:
    """Show the notes of a result."""
    for sentence in sentences:
        ui.label(f"⚠ {sentence}")
