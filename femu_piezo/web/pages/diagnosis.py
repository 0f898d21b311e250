"""Diagnosis: four answers in words, the candidates, residuals before and after, what to measure next."""

from __future__ import annotations

from urllib.parse import urlencode

import numpy as np
from nicegui import ui

from femu_piezo.effects.words import readable
from femu_piezo.errors import InputError
from femu_piezo.output.results.result import suffixes
from femu_piezo.specimen.file import read_specimens, write_specimen, write_study
from femu_piezo.units import signed
from femu_piezo.web import charts, results
from femu_piezo.web.pages.common import chart, framed, notes, report_links
from femu_piezo.web.pages.update import unsaved
from femu_piezo.web.site import Site, complain, nothing, table

_ANSWERS = {
    "wrong": "What is wrong",
    "sure": "How sure",
    "constants": "What it means for the constants",
    "measures": "What to do",
}
_MOST = 12


def register(site: Site) -> None:
    """The page at /diagnosis."""
    site.page_of_specimen("diagnosis", lambda spec: _Diagnosis(site, spec).build())


class _Diagnosis:
    """The last diagnosis of a specimen file."""

    def __init__(self, site: Site, name: str) -> None:
        self._site, self._name = site, name
        self._folder = site.workspace.path(site.workspace.results(name, "diagnose"))

    def build(self) -> None:
        unsaved(self._site, self._name)
        self._site.job_card(
            "diagnose",
            self._name,
            "Diagnose",
            self._shown,
            lambda: ["--report"],
            lambda: self._site.workspace.specimen(self._name),
        )
        self._body = ui.column().classes("w-full gap-4")
        self._shown()

    def _shown(self) -> None:
        self._body.clear()
        found = results.record(self._folder / "diagnosis.json")
        with self._body:
            if found is None:
                nothing("This specimen has not been diagnosed yet.")
                return
            self._site.age(self._name, self._folder / "diagnosis.json")
            answers = found.get("answers") or {}
            ui.label(answers.get("headline", found["verdict"])).classes("text-xl font-bold")
            with ui.element("div").classes("w-full grid grid-cols-1 lg:grid-cols-2 gap-4"):
                for key, title in _ANSWERS.items():
                    with ui.column().classes("answer gap-1"):
                        ui.label(title).props('role="heading" aria-level="2"').classes("text-lg font-bold")
                        for sentence in answers.get(key, []):
                            ui.label(sentence)
            if found["causes"]:
                self._causes(found)
            notes(found["notes"])
            sweeps = found.get("sweeps") or [{}]
            files = list(zip(suffixes(len(sweeps)), (one.get("specimen", "") for one in sweeps), strict=True))
            for suffix, name in files:
                self._curves(suffix, name)
            self._candidates(found)
            headings = ("constant", "unit", "after", "loss tangent", "± mostly from")
            rows = results.constant_rows(found["parameters"]["after"])
            if found["verdict"] != "unknown":  # otherwise the constants absorb what the model lacks
                headings += ("95 %, averaged over causes", "tangent")
                ends = results.interval_rows(found["parameters"]["after"])
                rows = [(*row, *interval) for row, interval in zip(rows, ends, strict=True)]
            table(headings, rows, "constants with the causes in the model")
            with ui.expansion("What to measure next").classes("w-full border rounded"):
                for sentence in found["recommended_measurements"]:
                    ui.label(sentence)
                if found["separations"]:
                    rows = [
                        (one["measurement"], one["cause"], one["other"], f"{one['now']:.2g}", f"{one['expected']:.3g}")
                        for one in found["separations"]
                    ]
                    headings = ("measurement", "cause", "separated from", "now (σ)", "expected (σ)")
                    table(headings, rows, "separations by further measurements")
            for suffix, name in files:
                report = self._folder / f"report{suffix}.html"
                if report.exists():
                    with ui.expansion(f"Report: {name}" if suffix else "Report").classes("w-full border rounded"):
                        framed(self._site.address(self._site.workspace.name(report)), "report")
            report_links(self._site, self._folder)

    def _causes(self, found: dict) -> None:
        rows = [
            (
                cause["effect"].replace("_", " "),
                f"{cause['probability']:.3f}",
                _sizes(cause["parameters"]),
                cause["sentence"],
            )
            for cause in found["causes"]
        ]
        table(("cause", "probability", "size", "meaning"), rows, "named causes").props("wrap-cells")
        with ui.row().classes("items-center gap-3"):
            ui.button("Accept: keep the extended model as a specimen", on_click=self._accept).props("no-caps")
            self._accepted = ui.label().props('role="status" aria-live="polite"')

    def _accept(self) -> None:
        """Write a new specimen file with the named effects, or a study file with those of several specimens.

        The old files stay as they are.
        """
        workspace = self._site.workspace
        try:
            extended = read_specimens([self._folder / "extended.toml"])
            name = workspace.free_name(f"{self._name.removesuffix('.toml')}-extended.toml")
            files = [workspace.path(name)]
            if len(extended) > 1:
                stem = name.removesuffix(".toml")
                numbers = range(1, len(extended) + 1)
                files = [workspace.path(workspace.free_name(f"{stem}-{number}.toml")) for number in numbers]
                write_study([file.name for file in files], workspace.path(name))
            for specimen, file in zip(extended, files, strict=True):
                write_specimen(specimen, file)
        except InputError as error:
            complain(str(error))
            return
        ui.navigate.to(f"/diagnosis?{urlencode({'spec': name})}")

    def _curves(self, suffix: str, name: str) -> None:
        """The charts of one sweep, with its name where there are several."""
        found = results.columns(self._folder / f"curves{suffix}.csv")
        if found is None:
            return
        if suffix:
            ui.label(name).classes("text-lg font-bold")
        frequency = found["frequency_Hz"]
        z = {
            name: found[f"{name}_resistance_ohm"] + 1j * found[f"{name}_reactance_ohm"]
            for name in ("measured", "before", "after")
        }
        curves = {name: (frequency, one) for name, one in z.items()}
        figure = charts.impedance_chart(curves, charts.VIEWS[0], measured="measured")
        chart(figure, "measured, before and after")
        sigma = found["noise_ohm"] / np.abs(z["measured"]) / np.sqrt(2)
        residuals = {name: np.log(z[name] / z["measured"]) / sigma for name in ("before", "after")}
        figure = charts.residual_chart(frequency, residuals, "residual (σ)", band=2.0)
        chart(figure, "residual before and after")

    def _candidates(self, found: dict) -> None:
        rows = []
        for one in found["candidates"][:_MOST]:
            evidence = one.get("evidence")
            odds = "-" if evidence is None else signed(evidence, ".1f")
            rows.append((one["effect"].replace("_", " "), odds, _sizes(one.get("parameters") or {})))
        with ui.expansion("Candidates, each alone").classes("w-full border rounded"):
            table(("candidate", "log odds over none", "size"), rows, "candidates").props("wrap-cells")


def _sizes(parameters: dict) -> str:
    """The parameters of an effect in a record, with their names."""
    return ", ".join(
        f"{name.replace('_', ' ')} {readable(name, size['unit'], size['value'], size.get('std'))}"
        for name, size in parameters.items()
    )
