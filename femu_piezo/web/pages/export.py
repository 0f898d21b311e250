"""Export: the material for another program, a data sheet, an equivalent circuit, a simulated sweep."""

from __future__ import annotations

from pathlib import Path

from nicegui import ui

from femu_piezo.errors import InputError
from femu_piezo.material.programs.writers import PROGRAMS
from femu_piezo.web import results
from femu_piezo.web.pages.common import report_links
from femu_piezo.web.site import Site, complain, nothing

_COMMANDS = {
    "datasheet": "Make a data sheet",
    "circuit": "Make an equivalent circuit",
    "simulate": "Simulate a sweep of the specimen as described",
}


def register(site: Site) -> None:
    """The page at /export."""

    def build(spec: str) -> None:
        _material(site, spec)
        for command, words in _COMMANDS.items():
            _command(site, spec, command, words)

    site.page_of_specimen("export", build)


def _material(site: Site, spec: str) -> None:
    """The constants of the last update as a material of another program, shown and offered for download."""
    record = site.workspace.path(site.workspace.results(spec, "update")) / "update.json"
    with ui.card().classes("w-full"):
        ui.label("Material for another program").classes("text-lg font-bold")
        if results.record(record) is None:
            nothing("The constants of this specimen have not been updated yet: update them first.")
            return
        site.age(spec, record)
        program = ui.select(list(PROGRAMS), value="comsol", label="Program").props("outlined").classes("w-64")
        text = (
            ui.codemirror("", theme="githubLight", line_wrapping=True)
            .classes("w-full border rounded")
            .props("readonly")
        )

        def shown() -> str:
            from femu_piezo.api import export

            try:
                return export(record, program.value)
            except InputError as error:
                complain(str(error))
                return ""

        def choose() -> None:
            text.value = shown()

        def take() -> None:
            name = f"{Path(spec).stem}.{PROGRAMS[program.value].suffix}"
            ui.download.content(shown().encode(), name)

        program.on_value_change(choose)
        ui.button("Download", on_click=take).props("no-caps")
        choose()


def _command(site: Site, spec: str, command: str, words: str) -> None:
    folder = site.workspace.path(site.workspace.results(spec, command))

    def shown() -> None:
        body.clear()
        with body:
            report_links(site, folder)
            for path in sorted(folder.glob("*.png")) if folder.is_dir() else ():
                address = site.address(site.workspace.name(path)) + f"?{path.stat().st_mtime_ns}"
                ui.image(address).classes("max-w-2xl").props(f'alt="{path.stem}"')

    site.job_card(command, spec, words, shown, check=lambda: site.workspace.specimen(spec))
    body = ui.column().classes("w-full gap-2")
    shown()
