"""`Simulated`: poles, zeros and the sweep of a specimen as described."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from femu_piezo.measurement.readers import write_spectrum
from femu_piezo.output.folder import prepare_folder, write_figure, write_json
from femu_piezo.output.results.result import Result, resonance_rows
from femu_piezo.output.tables import simulation_table
from femu_piezo.study.simulate import SimulationResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType


class Simulated(Result, SimulationResult):
    """What `simulate` returns: the sweep (`spectrum`), its `poles` and `zeros`."""

    def table(self) -> RenderableType:
        """Poles and zeros."""
        return simulation_table(self)

    def plot(self, number: int | None = None) -> Figure:
        """|Z| and phase with poles and zeros."""
        from femu_piezo.output.curves import simulation_figure

        return simulation_figure(self)

    def rows(self) -> list[dict[str, Any]]:
        """One row for each pole and zero."""
        return resonance_rows((*self.poles, *self.zeros))

    def save(self, folder: Path | str) -> Path:
        """Write simulation.json, impedance.csv and impedance.png; the folder."""
        out = prepare_folder(folder)
        write_spectrum(self.spectrum, out / "impedance.csv")
        write_figure(out / "impedance.png", self.plot())
        write_json(out / "simulation.json", self.to_json())
        return out
