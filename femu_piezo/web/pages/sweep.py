"""Sweep: drop a file, see the curve, its faults, its poles and zeros; leave points out by dragging."""

from __future__ import annotations

import json
from pathlib import Path
from urllib.parse import urlencode

import numpy as np
from nicegui import app, run, ui

from femu_piezo.errors import InputError
from femu_piezo.web import charts, results
from femu_piezo.web.pages.common import chart, figure_rows, notes, report_links
from femu_piezo.web.site import Site, complain, missing, nothing, table

_TEMPLATE = """# Description of the piece. Dimensions and material are examples: replace them by those of your piece.
name = {name}

[geometry]
shape = "plate"
length = "40 mm"
width = "5 mm"
thickness = "1 mm"
poling = "thickness"

[material]
base = "pzt-5h"

[measurement]
file = {file}
"""


def register(site: Site) -> None:
    """The page at /sweep."""

    @ui.page("/sweep")
    async def page(file: str = "", spec: str = "") -> None:
        names = site.workspace.sweeps()
        chosen = file or _of_specimen(site, spec, names) or (names[0] if names else "")
        with site.frame("sweep", {"file": chosen if chosen in names else "", "spec": spec}):
            if chosen in names or not chosen:
                await _Sweep(site, names, chosen, spec).build()
            else:
                site.choose(names, "", "Sweep", "sweep", "file")
                missing(f"This folder has no sweep {chosen}; choose another one.")


def _of_specimen(site: Site, spec: str, names: list[str]) -> str:
    """The sweep among `names` that a specimen file names, "" where there is none."""
    try:
        files = site.workspace.specimen(spec)[0].files if spec else ()
    except InputError:
        return ""
    return next((one for one in names for path in files if site.workspace.path(one) == path.resolve()), "")


class _Sweep:
    """One sweep, and others that it is compared with."""

    def __init__(self, site: Site, names: list[str], chosen: str, spec: str) -> None:
        self._site, self._names, self._chosen, self._spec = site, names, chosen, spec
        self._compared: list[str] = []
        self._mask: list[tuple[float, float]] = []
        self._view, self._logarithmic, self._masking = charts.VIEWS[0], False, False
        self._read: dict[str, tuple] = {}

    async def build(self) -> None:
        site = self._site
        with ui.row().classes("w-full gap-4 items-start"):
            site.drop("Drop a sweep (CSV, Touchstone, analyser export) or a specimen file", self._taken)
            with ui.column().classes("grow min-w-64 gap-2"):
                site.choose(self._names, self._chosen, "Sweep", "sweep", "file")
                others = [name for name in self._names if name != self._chosen]
                if others:
                    comparison = ui.select(others, multiple=True, label="Compare with", on_change=self._compare)
                    comparison.props("outlined use-chips").classes("w-full max-w-md")
                if self._chosen:
                    self._next_step(await run.io_bound(self._owners))
        if not self._chosen:
            nothing("This folder has no sweep yet: drop one into the field above, or choose a file with its button.")
            return
        problem = await self._load(self._chosen)
        if problem:
            ui.label(problem).classes("error").props('role="alert"')
            return
        self._mask = [tuple(band) for band in app.storage.user.get("masks", {}).get(self._chosen, [])]
        with ui.row().classes("items-center gap-4"):
            ui.toggle(list(charts.VIEWS), value=self._view, on_change=self._turn).props("no-caps")
            ui.switch("logarithmic", on_change=self._scale)
            ui.switch("mask by dragging", on_change=self._begin_mask)
        self._plot = chart(self._figure(), "impedance over frequency")
        self._plot.on("plotly_selected", self._selected)
        self._bands = ui.row().classes("gap-2 items-center")
        self._show_bands()
        notes(self._read[self._chosen][2])
        site.job_card("extract", self._chosen, "Find poles and zeros", self._extracted, self._arguments)
        self._found = ui.column().classes("w-full gap-4")
        self._extracted()

    def _taken(self, names: list[str]) -> None:
        name = names[0]
        if name.endswith(".toml"):
            ui.navigate.to(f"/specimen?{urlencode({'spec': name})}")
        else:
            ui.navigate.to(f"/sweep?{urlencode({'file': name})}")

    def _owners(self) -> list[str]:
        """The specimen files that name this sweep."""
        path, owners = self._site.workspace.path(self._chosen), []
        for name in self._site.workspace.specimens()[:200]:
            try:
                if any(path in [file.resolve() for file in one.files] for one in self._site.workspace.specimen(name)):
                    owners.append(name)
            except InputError:
                continue
        return owners

    def _next_step(self, owners: list[str]) -> None:
        """Links to the specimen files of this sweep, and a button to write a new one."""
        self._spec = self._spec or (owners[0] if owners else "")
        for name in owners[:4]:
            query = urlencode({"spec": name})
            with ui.row().classes("gap-3"):
                ui.label(f"specimen of this sweep: {name}")
                for page in ("specimen", "update", "diagnosis"):
                    ui.link(page, f"/{page}?{query}")

        def describe() -> None:
            workspace = self._site.workspace
            stem = Path(self._chosen).stem
            name = workspace.free_name(self._chosen.removesuffix(Path(self._chosen).suffix) + ".toml")
            draft = self._site.draft(name)
            if not draft.text:
                draft.set(_TEMPLATE.format(name=json.dumps(stem), file=json.dumps(Path(self._chosen).name)))
            ui.navigate.to(f"/specimen?{urlencode({'spec': name})}")

        button = ui.button(
            "Describe the specimen of this sweep", color=None if owners else "primary", on_click=describe
        )
        button.props("no-caps" + (" outline" if owners else ""))

    async def _load(self, name: str) -> str:
        """Read a sweep in another process; the sentence of an error, "" where there is none."""
        found = await run.cpu_bound(results.sweep, self._site.workspace.path(name))
        if isinstance(found, str):
            return found
        self._read[name] = found
        return ""

    def _figure(self) -> dict:
        curves = {name: self._read[name][0] for name in [self._chosen, *self._compared] if name in self._read}
        found = results.record(self._folder() / "extraction.json") or {}
        resonances = [{"kind": kind, **one} for kind in ("pole", "zero") for one in found.get(f"{kind}s", [])]
        figure = charts.impedance_chart(
            curves,
            self._view,
            logarithmic=self._logarithmic,
            resonances=resonances,
            faults=self._read[self._chosen][1],
            masked=self._mask,
            measured=self._chosen,
        )
        if self._masking:
            figure["layout"] |= {"dragmode": "select", "selectdirection": "h"}
        return figure

    def _folder(self) -> Path:
        return self._site.workspace.path(self._site.workspace.results(self._chosen, "extract"))

    def _draw(self) -> None:
        self._plot.update_figure(self._figure())

    def _turn(self, event) -> None:
        self._view = event.value
        self._draw()

    def _scale(self, event) -> None:
        self._logarithmic = event.value
        self._draw()

    def _begin_mask(self, event) -> None:
        self._masking = event.value
        self._draw()

    async def _compare(self, event) -> None:
        for name in event.value:
            if name not in self._read and (problem := await self._load(name)):
                complain(problem)
        self._compared = [name for name in event.value if name in self._read]
        self._draw()

    def _selected(self, event) -> None:
        span = ((event.args or {}).get("range") or {}).get("x")
        if not self._masking or self._view == charts.VIEWS[2] or not span:
            return
        low, high = (1e3 * value for value in sorted(span))  # kHz, on a logarithmic axis too
        frequency = self._read[self._chosen][0][0]
        inside = (frequency >= low) & (frequency <= high)
        if np.any(inside):
            self._mask.append((float(frequency[inside][0]), float(frequency[inside][-1])))
            self._keep_mask()

    def _keep_mask(self) -> None:
        app.storage.user["masks"] = {**app.storage.user.get("masks", {}), self._chosen: self._mask}
        self._show_bands()
        self._draw()

    def _show_bands(self) -> None:
        self._bands.clear()

        def drop(number: int) -> None:
            del self._mask[number]
            self._keep_mask()

        with self._bands:
            for number, (low, high) in enumerate(self._mask):
                words = f"left out: {low / 1e3:.6g} to {high / 1e3:.6g} kHz"
                chip = ui.chip(words, removable=True, color="grey-4", text_color="black")
                chip.on("remove", lambda _, number=number: drop(number))
            if self._mask and self._spec:
                ui.button(f"Write into {self._spec}", color=None, on_click=self._write_mask).props("flat no-caps")

    def _write_mask(self) -> None:
        """Write the mask into the draft of the specimen, not yet into its file."""
        try:
            draft = self._site.draft(self._spec)
            draft.put("measurement", "mask", [list(band) for band in self._mask])
        except InputError as error:
            complain(str(error))
            return
        ui.navigate.to(f"/specimen?{urlencode({'spec': self._spec})}")

    def _arguments(self) -> list[str]:
        return [word for low, high in self._mask for word in ("--mask", repr(low), repr(high))]

    def _extracted(self) -> None:
        """Show the results of the last extraction."""
        self._draw()
        self._found.clear()
        found = results.record(self._folder() / "extraction.json")
        with self._found:
            if found is None:
                nothing("The poles and zeros of this sweep have not been computed yet.")
                return
            rows = [row for kind in ("pole", "zero") for row in results.resonance_rows(found[f"{kind}s"], kind)]
            with ui.grid().classes("w-full grid-cols-1 lg:grid-cols-2 gap-4 items-start"):
                table(("", "frequency (Hz)", "Q"), rows, "poles and zeros")
                if found.get("standard_figures"):
                    table(
                        ("figure", "by standard", "meaning"), figure_rows(found["standard_figures"]), "standard figures"
                    )
            notes(note for note in found["notes"] if note not in self._read[self._chosen][2])
            for remark in found.get("remarks", []):
                ui.label(remark)
            report_links(self._site, self._folder())
