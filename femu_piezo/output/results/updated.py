"""`Updated`: the constants that explain the measured sweeps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from femu_piezo.files import write_atomically
from femu_piezo.measurement.readers import write_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.output.folder import prepare_folder, write_binary, write_figure, write_json
from femu_piezo.output.results.result import Result, suffixes
from femu_piezo.output.tables import update_table
from femu_piezo.study.results import UpdateResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType


class Updated(Result, UpdateResult):
    """What `update` returns: `parameters["s11"].value`, `.std`, `.tan`, `.tan_std`, `.budget`; `outcomes`."""

    files: ClassVar[tuple[str, ...]] = (
        "impedance.png",
        "iterations.png",
        "updated.csv",
        "sensitivity.png",
        "budget.png",
        "corner.png",
        "samples.csv",
        "temperature.png",
        "report.html",
    )

    _index = "constant"

    def table(self) -> RenderableType:
        """Parameters against the baseline, poles and zeros."""
        return update_table(self)

    def plot(self, number: int | None = None) -> Figure:
        """Measured, baseline and updated curve of one sweep, and the misfit of both models."""
        from femu_piezo.output.curves import impedance_figure

        return impedance_figure(self.outcomes[number or 0])

    def rows(self) -> list[dict[str, Any]]:
        """One row for each free constant; columns budget_… hold the parts of its standard deviation."""
        return [
            {
                "constant": name,
                "baseline": getattr(self.baseline, name).real,
                "value": one.value,
                "std": one.std,
                "tan": one.tan,
                "tan_std": one.tan_std,
                **{f"budget_{source}": part for source, part in one.budget.items()},
                **{f"tan_budget_{source}": part for source, part in one.tan_budget.items()},
            }
            for name, one in self.parameters.items()
        ]

    def save(self, folder: Path | str, *, report: bool = False) -> Path:
        """Write update.json, and impedance.png, iterations.png, sensitivity.png and updated.csv of every sweep.

        Also budget.png where the deviations have a budget, temperature.png where sweeps are at several temperatures,
        corner.png and samples.csv where samples were drawn.

        report : write report.html as well, which holds all of it
        """
        from femu_piezo.output.budget_chart import budget_figure, budget_shares
        from femu_piezo.output.curves import iteration_figure
        from femu_piezo.output.records import update_record
        from femu_piezo.output.sensitivity import sensitivity_figure

        out = prepare_folder(folder)
        for number, (suffix, outcome) in enumerate(zip(suffixes(len(self.outcomes)), self.outcomes, strict=True)):
            write_figure(out / f"impedance{suffix}.png", self.plot(number))
            if len(outcome.history) > 1:
                write_figure(out / f"iterations{suffix}.png", iteration_figure(outcome, tuple(self.parameters)))
            updated = ImpedanceSpectrum(outcome.measured.spectrum.frequency, outcome.updated_curve)
            write_spectrum(updated, out / f"updated{suffix}.csv")
            write_figure(out / f"sensitivity{suffix}.png", sensitivity_figure(outcome.sensitivity))
        if budget_shares(self.parameters):
            title = f"{self.name}: where the deviations come from"
            write_figure(out / "budget.png", budget_figure(title, self.parameters))
        if self.samples is not None:
            from femu_piezo.output.corner import corner_figure

            write_figure(out / "corner.png", corner_figure(self.name, self.samples, self.parameters))
            lines = [",".join(self.samples.names), *(",".join(map(repr, row)) for row in self.samples.values.tolist())]
            write_atomically(out / "samples.csv", "\n".join(lines) + "\n")
        if self.temperature is not None:
            from femu_piezo.output.temperature_chart import temperature_figure

            write_figure(out / "temperature.png", temperature_figure(self.name, self.temperature))
        write_json(out / "update.json", update_record(self))
        if report:
            from femu_piezo.output.report_update import write_update_report

            write_update_report(out / "report.html", self)
        return out

    def save_data_sheet(self, folder: Path | str) -> Path:
        """Write datasheet.pdf, one page, and datasheet.png of every sweep, and update.json; the folder."""
        from femu_piezo.output.data_sheet import as_pdf, data_sheet
        from femu_piezo.output.records import update_record

        out = prepare_folder(folder)
        for number, suffix in enumerate(suffixes(len(self.outcomes))):
            page = data_sheet(self, number)
            write_binary(out / f"datasheet{suffix}.pdf", as_pdf(page))
            write_figure(out / f"datasheet{suffix}.png", page)
        write_json(out / "update.json", update_record(self))
        return out
