"""Lot: every specimen of a folder, in a table that sorts, with control charts; a row leads to the piece."""

from __future__ import annotations

import csv
from urllib.parse import urlencode

from nicegui import ui

from femu_piezo.errors import InputError
from femu_piezo.output.curves import PRINTED
from femu_piezo.web import charts, results
from femu_piezo.web.pages.common import chart, report_links
from femu_piezo.web.site import Site, missing, nothing, table
from femu_piezo.web.workspace import Outside, lot_of

_MOST = 10_000
_LINK = '<q-td :props="props"><a class="nicegui-link" :href="props.row.piece">{{ props.value }}</a></q-td>'


def register(site: Site) -> None:
    """The page at /lot."""

    @ui.page("/lot")
    def page(lot: str = "", spec: str = "", file: str = "") -> None:
        lots = site.workspace.lots()
        lot = lot or (lots[0] if lots else "")
        with site.frame("lot", {"spec": spec, "file": file, "lot": lot if lot in lots else ""}):
            site.choose(lots, lot if lot in lots else "", "Lot (a folder of specimen files)", "lot", "lot")
            if lot and lot not in lots:
                missing(f"This folder has no lot {lot}; choose another one.")
                return
            if not lot:
                nothing("A lot is a folder of specimen files inside this folder; there is none yet.")
                return
            _Lot(site, lot).build()


class _Lot:
    """One folder of specimens and its last table."""

    def __init__(self, site: Site, name: str) -> None:
        self._site, self._name = site, name
        self._folder = site.workspace.path(site.workspace.results(name, "batch"))
        self._outliers, self._quantity = False, ""

    def build(self) -> None:
        ui.switch("diagnose outliers as well", on_change=self._wish)
        self._site.job_card("batch", self._name, "Update every specimen", self._shown, self._arguments, self._check)
        self._body = ui.column().classes("w-full gap-4")
        self._shown()

    def _wish(self, event) -> None:
        self._outliers = event.value

    def _arguments(self) -> list[str]:
        return ["--diagnose-outliers"] if self._outliers else []

    def _check(self) -> None:
        for name in self._site.workspace.specimens():
            if lot_of(name) == self._name:
                try:
                    self._site.workspace.specimen(name)
                except Outside:
                    raise
                except InputError:
                    continue  # a row of the table, with its reason

    def _rows(self) -> list[dict[str, str]]:
        try:
            with open(self._folder / "table.csv", encoding="utf-8", newline="") as stream:
                return [row for row, _ in zip(csv.DictReader(stream), range(_MOST), strict=False)]
        except OSError:
            return []

    def _shown(self) -> None:
        self._body.clear()
        rows, lot = self._rows(), results.record(self._folder / "lot.json")
        with self._body:
            if not rows or lot is None:
                nothing("This lot has not been computed yet.")
                return
            names = [name for name in PRINTED if any(row.get(name) for row in rows)]
            headings = ["number", "specimen", "status", *(f"{name} ({PRINTED[name][1]})" for name in names)]
            told = [name for name in ("diagnosis", "reason") if any(row.get(name) for row in rows)]
            headings += ["k_eff", *told]
            cells = [
                [int(row["number"]), row["specimen"] or row["file"], row["status"]]
                + [_scaled(row.get(name), PRINTED[name][0]) for name in names]
                + [_scaled(row.get("k_eff"), 1.0), *(row[name] for name in told)]
                for row in rows
            ]
            found = table(headings, cells, "specimens of the lot", at_once=25)
            found.props("wrap-cells")
            for record, row in zip(found.rows, rows, strict=True):
                file = row["file"] if self._name == "." else f"{self._name}/{row['file']}"
                record["piece"] = f"/update?{urlencode({'spec': file})}"
            found.add_slot("body-cell-1", _LINK)  # the column of the specimens
            found.update()
            quantities = list(lot["quantities"])
            self._quantity = self._quantity if self._quantity in quantities else (quantities[0] if quantities else "")
            if quantities:
                choice = ui.select(quantities, value=self._quantity, label="Control chart of", on_change=self._choose)
                choice.props("outlined").classes("w-64")
                self._chart = chart(self._control(rows, lot), "control chart")
            report_links(self._site, self._folder)

    def _control(self, rows: list[dict[str, str]], lot: dict) -> dict:
        numbers, values = [], []
        for row in rows:
            if row.get(self._quantity):
                numbers.append(int(row["number"]))
                values.append(float(row[self._quantity]))
        factor, unit = PRINTED.get(self._quantity, (1.0, ""))
        limits = [factor * limit for limit in lot["quantities"][self._quantity].get("control_limits") or ()]
        values = [factor * value for value in values]
        return charts.control_chart(numbers, values, limits, f"{self._quantity} ({unit})" if unit else self._quantity)

    def _choose(self, event) -> None:
        self._quantity = event.value
        self._chart.update_figure(self._control(self._rows(), results.record(self._folder / "lot.json")))


def _scaled(text: str | None, factor: float) -> float | str:
    return float(f"{float(text) * factor:.6g}") if text else ""
