"""Update: the constants with their deviations, where these come from, curves and residuals, and what to free."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import urlencode

import numpy as np
from nicegui import run, ui

from femu_piezo.errors import InputError
from femu_piezo.output.results.result import suffixes
from femu_piezo.specimen.file import CONSTANTS, Measurement, Specimen
from femu_piezo.web import charts, results
from femu_piezo.web.drafts import table_of
from femu_piezo.web.pages.common import chart, figure_rows, framed, notes, report_links
from femu_piezo.web.site import Site, complain, nothing, table


def register(site: Site) -> None:
    """The page at /update."""
    site.page_of_specimen("update", lambda spec: _Update(site, spec).build())


class _Update:
    """The last update of a specimen file."""

    def __init__(self, site: Site, name: str) -> None:
        self._site, self._name = site, name
        self._folder = site.workspace.path(site.workspace.results(name, "update"))

    def build(self) -> None:
        self._edits = ui.column().classes("w-full")
        self._unsaved()
        self._samples = ui.switch("draw samples of the posterior as well")
        self._site.job_card("update", self._name, "Update the constants", self._shown, self._arguments, self._check)
        self._body = ui.column().classes("w-full gap-4")
        self._shown()
        self._freeing()

    def _arguments(self) -> list[str]:
        return ["--report", *(["--sample", "400"] if self._samples.value else [])]

    def _unsaved(self) -> None:
        self._edits.clear()
        with self._edits:
            unsaved(self._site, self._name)

    def _check(self) -> None:
        self._site.workspace.specimen(self._name)

    def _shown(self) -> None:
        self._body.clear()
        found = results.record(self._folder / "update.json")
        with self._body:
            if found is None:
                nothing("The constants of this specimen have not been updated yet.")
                return
            self._site.age(self._name, self._folder / "update.json")
            headings = ("constant", "unit", "updated", "loss tangent", "± mostly from")
            table(headings, results.constant_rows(found["parameters"]), "constants")
            notes(found["notes"])
            for one in found["specimens"]:
                before, after = (100 * one["rms_log_error"][key] for key in ("baseline", "updated"))
                ui.label(f"{one['name']}: rms |Δ log Z| baseline {before:.3g} %, updated {after:.3g} %")
            shares = results.shares(found["parameters"])
            if shares:
                ui.label("Where the standard deviations come from").classes("text-lg font-bold")
                chart(charts.bar_chart(shares, "share of the variance (%)"), "budget of the standard deviations")
            self._places = self._reserved_places()
            ui.timer(0.05, self._draw, once=True)
            figures = [(one["name"], mode) for one in found["specimens"] for mode in one.get("standard_figures") or []]
            if figures:
                with ui.expansion("Standard figures").classes("w-full border rounded"):
                    for name, mode in figures:
                        ui.label(f"{name}: {mode['title']}").classes("font-bold")
                        headings = ("figure", "by standard", "finite elements", "meaning")
                        table(headings, figure_rows(mode, model=True), "standard figures")
            sensitivities = [f"sensitivity{suffix}.png" for suffix in suffixes(len(found["specimens"]))]
            samples = ["corner.png"] if found.get("samples") else []  # else it is of an earlier update
            for title, names in (("Sensitivity", sensitivities), ("Samples of the posterior", samples)):
                pictures = [self._folder / name for name in names if (self._folder / name).exists()]
                if pictures:
                    with ui.expansion(title).classes("w-full border rounded"):
                        for path in pictures:
                            address = f"{self._site.address(self._site.workspace.name(path))}?{path.stat().st_mtime_ns}"
                            ui.image(address).props(f'alt="{title.lower()}"').classes("max-w-3xl")
            if (self._folder / "report.html").exists():
                with ui.expansion("Report").classes("w-full border rounded"):
                    framed(self._site.address(self._site.workspace.name(self._folder / "report.html")), "report")
            report_links(self._site, self._folder)

    def _reserved_places(self) -> list[tuple[str, Measurement, Path, ui.column]]:
        """(name, sweep, file of the updated curve, column for the charts) of every updated sweep, height reserved."""
        sweeps, found = _sweeps(self._site, self._name), []
        for suffix, sweep in zip(suffixes(len(sweeps)), sweeps, strict=True):
            updated = self._folder / f"updated{suffix}.csv"
            if sweep is not None and sweep.file is not None and updated.exists():
                height = f"min-height: calc({charts.IMPEDANCE_HEIGHT + charts.RESIDUAL_HEIGHT}px + 1rem)"
                place = ui.column().classes("w-full gap-4").style(height)
                found.append((sweep.file.name if suffix else "measured", sweep, updated, place))
        return found

    async def _draw(self) -> None:
        """Draw measured and updated curves, and their residuals, into the reserved places."""
        for name, sweep, file, place in self._places:
            updated = results.curve(file)
            found = None if updated is None else await run.cpu_bound(results.measured, sweep, sweep.file)
            place.style("min-height: 0")  # charts reserve their own height
            with place:
                if isinstance(found, str):
                    ui.label(found).classes("error").props('role="alert"')
                elif found is not None:
                    _compare(name, found, updated)

    def _freeing(self) -> None:
        """Show which constants are free, and how well `identify` expects a sweep to determine each."""
        ui.label("Free constants").classes("text-lg font-bold")
        self._site.job_card(
            "identify", self._name, "Which constants can this sweep determine?", self._told, check=self._check
        )
        self._table = ui.column().classes("w-full")
        self._told()

    def _told(self) -> None:
        self._table.clear()
        folder = self._site.workspace.path(self._site.workspace.results(self._name, "identify"))
        known = results.record(folder / "identifiability.json") or {}
        determined, expected = known.get("constants", {}), known.get("expected", {})
        try:
            several = self._site.workspace.specimen(self._name)
        except InputError as error:
            with self._table:
                ui.label(str(error)).classes("error").props('role="alert"')
            return
        if len(several) > 1:
            with self._table:
                nothing("The first specimen file of a study says which constants are free.")
            return
        free = self._draft_free(several[0])
        with self._table, ui.element("div").classes("w-full grid grid-cols-1 sm:grid-cols-2 gap-x-6"):
            for name in CONSTANTS:
                one = determined.get(name)
                words = "zero in this material" if known and one is None else ""
                if one is not None:
                    words = "not determined" if one["determined"] == "not" else f"determined {one['determined']}"
                    if one["relative_std"] is not None:
                        words += f": ± {100 * one['relative_std']:.2g} % by noise alone"
                if name in expected and expected[name]["std"] is not None:
                    words += (
                        f"; ± {100 * abs(expected[name]['std'] / expected[name]['value']):.2g} % with the tolerances"
                    )
                with ui.row().classes("items-center gap-3 no-wrap"):
                    ui.switch(name, value=name in free, on_change=lambda e, name=name: self._free(name, e.value))
                    ui.label(words)

    def _draft_free(self, specimen: Specimen) -> list[str]:
        """The free constants of the draft; those of the saved file where the draft names none."""
        given = table_of(self._site.draft(self._name).tables(), "material").get("free")
        return list(given if isinstance(given, list) else specimen.material.free or ())

    def _free(self, name: str, wish: bool) -> None:
        """Free or hold a constant in the draft; the file changes when it is saved."""
        draft = self._site.draft(self._name)
        given = self._draft_free(self._site.workspace.specimen(self._name)[0])
        free = [one for one in CONSTANTS if (one in given and one != name) or (wish and one == name)]
        try:
            draft.put("material", "free", free)
        except InputError as error:
            complain(str(error))
            return
        self._unsaved()


def unsaved(site: Site, name: str) -> None:
    """Report edits that are not saved, and offer to save them."""
    draft = site.draft(name)
    if not draft.changed:
        return
    with ui.row().classes("items-center gap-3") as row:
        ui.label(f"{name} has edits that are not saved; the commands work with the saved file.")

        def save() -> None:
            try:
                draft.save()
            except InputError as error:
                complain(str(error))
                return
            row.delete()

        ui.button("Save them", color=None, on_click=save).props("flat no-caps")
        ui.link("see them", f"/specimen?{urlencode({'spec': name})}")


def _sweeps(site: Site, name: str) -> list[Measurement | None]:
    """The [measurement] table of every sweep of the specimens of a file."""
    try:
        return [sweep.measurement for one in site.workspace.specimen(name) for sweep in one.of_each_sweep]
    except InputError:
        return []


def _compare(name: str, measured: charts.Curve, updated: charts.Curve) -> None:
    """Charts of both curves, and of the residual where every updated frequency is a measured one."""
    curves = {name: measured, "updated": updated}
    chart(charts.impedance_chart(curves, charts.VIEWS[0], measured=name), "measured and updated impedance")
    common = np.isin(measured[0], updated[0])
    if np.count_nonzero(common) == updated[0].size:
        residual = 100 * np.log(updated[1] / measured[1][common])
        chart(charts.residual_chart(updated[0], {"updated": residual}, "updated/measured (%)"), "residual")
