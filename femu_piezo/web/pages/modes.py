"""Modes: the scene of all driven modes, to be turned, animated and coloured, and their frequencies."""

from __future__ import annotations

from nicegui import ui

from femu_piezo.web import results
from femu_piezo.web.pages.common import framed, notes, report_links
from femu_piezo.web.pages.update import unsaved
from femu_piezo.web.site import Site, nothing, table


def register(site: Site) -> None:
    """The page at /modes."""

    def build(spec: str) -> None:
        unsaved(site, spec)
        folder = site.workspace.path(site.workspace.results(spec, "modes"))

        def shown() -> None:
            body.clear()
            found = results.record(folder / "modes.json")
            with body:
                if found is None:
                    nothing("The modes of this specimen have not been computed yet.")
                    return
                site.age(spec, folder / "modes.json")
                scene = folder / "modes.html"
                if scene.exists():
                    framed(site.address(site.workspace.name(scene)), "mode shapes, to be turned and animated")
                rows = [
                    (
                        number,
                        f"{mode['pole']['frequency_Hz']:.1f}",
                        f"{mode['zero']['frequency_Hz']:.1f}" if mode["zero"] else "-",
                        f"{mode['k_eff']:.4f}" if mode["k_eff"] is not None else "-",
                        mode["pole"]["family"],
                    )
                    for number, mode in enumerate(found["modes"], start=1)
                ]
                table(("mode", "pole (Hz)", "zero (Hz)", "k_eff", "motion"), rows, "modes")
                notes(found["notes"])
                report_links(site, folder)

        site.job_card(
            "modes", spec, "Compute the modes", shown, lambda: ["--html"], lambda: site.workspace.specimen(spec)
        )
        body = ui.column().classes("w-full gap-4")
        shown()

    site.page_of_specimen("modes", build)
