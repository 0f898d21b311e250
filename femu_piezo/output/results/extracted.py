"""`Extracted`: poles and zeros of a measured sweep."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from femu_piezo.extraction import Extraction
from femu_piezo.output.folder import prepare_folder, write_figure, write_json
from femu_piezo.output.results.result import Result, resonance_rows
from femu_piezo.output.tables import extraction_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType


class Extracted(Result, Extraction):
    """What `extract` returns: `resonances` and `pairs` of a sweep, found without any model."""

    files: ClassVar[tuple[str, ...]] = ("prony_ss.png",)

    def table(self) -> RenderableType:
        """Poles and zeros with standard deviations."""
        return extraction_table(self)

    def plot(self, number: int | None = None) -> Figure:
        """Curve and fit, residual, stabilization diagrams."""
        from femu_piezo.output.extraction_plots import extraction_figure

        return extraction_figure(self)

    def rows(self) -> list[dict[str, Any]]:
        """One row for each pole and zero; `doubtful` where the sweep does not determine its loss or strength."""
        sound = resonance_rows((*self.resonances.poles, *self.resonances.zeros))
        doubtful = resonance_rows(self.doubtful)
        return [{**row, "doubtful": False} for row in sound] + [{**row, "doubtful": True} for row in doubtful]

    def save(self, folder: Path | str) -> Path:
        """Write extraction.json, extraction.png and, where Prony-SS decomposed the sweep, prony_ss.png; the folder."""
        out = prepare_folder(folder)
        write_figure(out / "extraction.png", self.plot())
        if self.method == "prony_ss" and self.model is not None:
            from femu_piezo.output.extraction_plots import prony_figure

            write_figure(out / "prony_ss.png", prony_figure(self))
        write_json(out / "extraction.json", self.to_json())
        return out
