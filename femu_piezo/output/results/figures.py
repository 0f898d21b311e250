"""`Figures`: the standard figures of a sweep."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from rich.console import Group

from femu_piezo.output.folder import prepare_folder, write_figure, write_json
from femu_piezo.output.results.result import Result
from femu_piezo.output.tables import figures_table
from femu_piezo.standards.figures import Figure, StandardFigures

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Picture
    from rich.console import RenderableType


@dataclass(frozen=True, repr=False)
class Figures(Result):
    """What `standard_figures` returns: `modes`, the fundamental first; `figures["k31"].value` is one of its figures."""

    files: ClassVar[tuple[str, ...]] = ("figures.png",)

    modes: tuple[StandardFigures, ...]

    _index = "figure"

    def __getitem__(self, name: str) -> Figure:
        """The figure of a name, of the fundamental or else of the first mode that has one; KeyError where none has."""
        for one in self.modes:
            if any(figure.name == name for figure in one.figures):
                return one[name]
        raise KeyError(name)

    def table(self) -> RenderableType:
        """The figures of every mode."""
        return Group(*(figures_table(one) for one in self.modes))

    def plot(self, number: int | None = None) -> Picture:
        """Errors of the formulas for the piece in per cent, a bar for each figure."""
        from femu_piezo.output.formula_chart import formula_figure

        return formula_figure(self.modes[number or 0])

    def rows(self) -> list[dict[str, Any]]:
        """One row for each figure."""
        return [
            {
                "figure": figure.name,
                "mode": one.title,
                "value": figure.value,
                "std": figure.std,
                "unit": figure.unit,
                "model": figure.model,
                "deviation": figure.deviation,
                "formula_error": figure.formula_error,
            }
            for one in self.modes
            for figure in one.figures
        ]

    def save(self, folder: Path | str) -> Path:
        """Write figures.json, and figures.png where a formula of the body was used; the folder."""
        out = prepare_folder(folder)
        if self.modes[0].formula_words:
            write_figure(out / "figures.png", self.plot())
        write_json(out / "figures.json", {"modes": [one.to_json() for one in self.modes]})
        return out
